"""Where the zero of a twist is: encoders that were switched on apart do not agree, and a recording may tell by how
much."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edge_daemon.motion.corrected import senses
from edge_daemon.records import Array, Mask, Motion

LARGEST_TWIST_RAD = 0.015
"""No gear stands so far under load (sizes 14 to 32 reach 0.007 to 0.012 rad at their momentary limit)."""
ZERO_TIMES = 10.0
"""A mean twist counts as a difference of the encoders' zeros from this many times its own variation."""
LOCKED = 0.3
"""Travel of an output over that of its motor, seen from there, below which it is held (guess)."""
NEAR_ZERO, LEAST_NEAR = 0.3, 200
"""A zero on a stand is looked for up to this torque over its rms, among so many samples (guesses)."""
ONE_SIDED = 0.02
"""Share of a signal beyond zero up to which it never passes zero, but for noise (guess)."""


def locked(twist_rad: Array, theta_out_rad: Array) -> bool:
    """Whether a motor moves no further than a twist (n,), and the output (n,) far less: a stand that loads a gear at
    rest."""
    seen = np.isfinite(twist_rad) & np.isfinite(theta_out_rad)
    if not seen.any():
        return False
    moved = float(np.ptp((twist_rad + theta_out_rad)[seen]))
    return moved < 2 * LARGEST_TWIST_RAD and float(np.ptp(theta_out_rad[seen])) < LOCKED * moved


def twist_zero(motion: Motion, valid: Mask) -> float:
    """`zero_difference`, sharper: the twist at no torque and rest, on the straight line of twist over torque beside
    what a motor or its friction takes of that. Beside a measured torque that passes zero, a twist that never does has
    its zero elsewhere: no steady load explains that, nor is there any on a stand that holds the output."""
    seen = valid & np.isfinite(motion.torque_Nm) & np.isfinite(motion.twist_rad)
    twist, torque = motion.twist_rad[seen], motion.torque_Nm[seen]
    held = locked(twist, motion.theta_out_rad[seen])
    elsewhere = senses(motion) and _passes_zero(torque) and (held or not _passes_zero(twist))
    if not elsewhere and not zero_difference(motion.twist_rad[valid]):
        return 0.0
    speed = (motion.twist_rate_rad_s if held else motion.velocity_out_rad_s)[seen]
    acceleration = motion.acceleration_out_rad_s2[seen]
    columns = np.stack((np.ones_like(torque), torque, np.sign(speed), speed, acceleration), axis=1)
    near = np.abs(torque) < NEAR_ZERO * math.sqrt(float(np.mean(torque**2)))
    if held and np.count_nonzero(near) > LEAST_NEAR:  # beyond it a spring may bend
        columns, twist = columns[near], twist[near]
    size = np.sqrt(np.mean(columns**2, axis=0)) + 1e-300
    return float(np.linalg.lstsq(columns / size, twist, rcond=1e-9)[0][0] / size[0])


def _passes_zero(signal: Array) -> bool:
    """Whether a good part of a signal (n,) lies on either side of zero."""
    return len(signal) > 0 and bool(ONE_SIDED < float(np.mean(signal > 0)) < 1 - ONE_SIDED)


def zero_difference(twist_rad: Array) -> float:
    """How far the encoders' zeros are apart, seen from the output: the middle of a twist that no load explains, else 0.

    Smaller differences are not told from a steady load: `constant_load` stands for either.
    """
    seen = twist_rad[np.isfinite(twist_rad)]
    if not len(seen):
        return 0.0
    middle = float(np.median(seen))
    return middle if abs(middle) > max(LARGEST_TWIST_RAD, ZERO_TIMES * float(seen.std())) else 0.0


def one_zero(zeros_rad: Sequence[float]) -> list[float]:
    """Zeros of recordings of one joint, of whose twists each was taken: one of all that no twist sets apart, since an
    encoder that was switched off between them would not come back so near; none where one of these needs none."""
    order = sorted(range(len(zeros_rad)), key=lambda i: zeros_rad[i])
    ranked = np.array([zeros_rad[i] for i in order])
    common = list(zeros_rad)
    for group in np.split(np.arange(len(ranked)), np.flatnonzero(np.diff(ranked) > LARGEST_TWIST_RAD) + 1):
        own = ranked[group]
        zero = float(own.mean()) if own.all() else 0.0
        for i in group:
            common[order[i]] = zero
    return common
