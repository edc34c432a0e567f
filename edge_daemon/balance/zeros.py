"""Zeros of several recordings of one joint: of encoders that were switched off between them, or of a torque sensor that
was zeroed anew."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion, from_torque_zero, from_zero
from edge_daemon.effects.algebra import stop_operators
from edge_daemon.motion.corrected import senses
from edge_daemon.motion.residual_statistics import LOOKS, independent, lags_at
from edge_daemon.records import Array, Motion


class Beside(NamedTuple):
    """What zeros are looked for beside."""

    powers: int = 1
    """highest power of the twist"""
    weight: bool = False
    """whether one hangs on an output without a torque sensor"""
    gap: bool = False
    own_spring: bool = False
    """whether each recording has one"""
    loops: bool = False
    """whether elements slip"""


LEFT_BY_ZEROS = 0.5
"""Each recording has a zero of its own where these leave less than this share of the squared error (guess)."""
ZERO_ROUNDS = 4
"""So often zeros are looked for again with the twist from those found, since a spring that bends moves them."""
BESIDE_ZEROS = (
    Beside(),
    Beside(weight=True),
    Beside(3, True),
    Beside(weight=True, gap=True),
    Beside(5, True, True, True),
    Beside(5, True, True, loops=True),
)
"""The plainest first."""
PLAIN = 1.05
"""Zeros are read beside the plainest of these that leaves at most so many times the least squared error: what a finer
one takes then moves no zero by a quarter of what is left (guess)."""
GAPS = (0.1, 0.2, 0.4)
"""Half widths of a gap over the rms of the twist (guesses)."""
LOOPS = (0.1, 0.3, 1.0)
"""Twists after which elements slip, over its rms (guesses)."""
WAVES, LEAST_TURNS = (1.0, 2.0, 4.0), 2.0
"""Per turn of the motor, that a wave generator makes, and so many turns tell them from a zero."""
OF_TORQUE = 0.9
"""Zeros are those of a torque sensor where these leave less than this share of what those of the encoders leave: beside
a straight spring the two are the same (guess)."""


def with_their_zeros(trials: Sequence[PreparedMotion], beside: Sequence[Array]) -> Sequence[PreparedMotion]:
    """Recordings that each count from a zero of their own, where that takes most of the error that a spring of any
    curve, a gap, a loop, a weight, waves of the motor, frictions of each recording and what else is `beside` them,
    (m, k) each, leave."""
    beside = [np.hstack(pair) for pair in zip(beside, _waves(trials), strict=True)]
    one = min(_beside_zeros(trials, beside, structure, apart=False).left for structure in BESIDE_ZEROS)
    read, moved = _plainest(trials, beside), trials
    found = read
    for _ in range(ZERO_ROUNDS):
        if not found.left < LEFT_BY_ZEROS * one or not (found.stiffness > 0).all():
            return trials
        moved = [from_zero(row, row.zero_rad + zero) for row, zero in zip(moved, found.zeros_rad, strict=True)]
        found = _plainest(moved, beside)
    sensed = senses(trials[0].motion)
    if sensed and read.left < OF_TORQUE * found.left:
        moved = list(map(from_torque_zero, trials, read.steady_Nm.tolist()))
        return _remarked(moved, "torque sensor", read.steady_Nm, read.sd_Nm, "N m")
    whose = "encoders" if sensed else "encoders (or their steady loads over the stiffness)"
    zeros_rad = np.array([trial.zero_rad for trial in moved])
    return _remarked(moved, whose, zeros_rad, found.sd_Nm / found.stiffness, "rad")


def _remarked(moved: Sequence[PreparedMotion], whose: str, zeros: Array, sd: Array, unit: str) -> list[PreparedMotion]:
    """The recordings, the first with the line that says how far their zeros (r,) were apart."""
    apart = f"{np.ptp(zeros):.2g} +- {math.hypot(*sd[[zeros.argmin(), zeros.argmax()]]):.1g} {unit}"
    told = f"the zeros of the {whose} differ by {apart} between the recordings: taken out"
    return [replace(moved[0], remarks=(*moved[0].remarks, told)), *moved[1:]]


class _Zeros(NamedTuple):
    """Zeros of recordings, as a steady torque."""

    left: float
    """squared error beside them"""
    steady_Nm: Array
    """(r,)"""
    sd_Nm: Array
    stiffness: Array
    """(r,) of each recording, or of all [N m/rad]"""

    @property
    def zeros_rad(self) -> Array:
        """(r,) of the encoders, that would make those torques."""
        return -self.steady_Nm / self.stiffness


def _plainest(trials: Sequence[PreparedMotion], beside: Sequence[Array]) -> _Zeros:
    """Of each recording, beside the plainest structure that does."""
    found = [_beside_zeros(trials, beside, structure) for structure in BESIDE_ZEROS]
    least = min(row.left for row in found)
    return next(row for row in found if row.left <= PLAIN * least)


def _beside_zeros(
    trials: Sequence[PreparedMotion], beside: Sequence[Array], structure: Beside, apart: bool = True
) -> _Zeros:
    """One zero of all or one of each recording."""
    rows = []
    for i, (trial, more) in enumerate(zip(trials, beside, strict=True)):
        own, shared = _of_recording(trial.motion), _of_all(trial.motion, structure)
        placed = np.zeros((len(trial.rows), len(trials), own.shape[1]))
        placed[:, i] = trial.project(own)
        zero = np.zeros((len(placed), len(trials) if apart else 1))
        zero[:, i if apart else 0] = 1.0
        stiff = np.zeros((len(placed), len(trials) if structure.own_spring else 1))
        stiff[:, i if structure.own_spring else 0] = trial.project(trial.motion.twist_rad[:, None])[:, 0]
        rows.append(np.hstack((zero, stiff, placed.reshape(len(placed), -1), trial.project(shared), more)))
    x, y = np.vstack(rows), np.concatenate([trial.target for trial in trials])
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-300
    found = np.linalg.lstsq(x / size, y, rcond=1e-9)[0] / size
    steady, stiffness = np.split(found, [zero.shape[1], zero.shape[1] + stiff.shape[1]])[:2]
    left, inverse = y - x @ found, np.linalg.pinv((x / size).T @ (x / size), rcond=1e-12, hermitian=True)
    lags = lags_at(trials[0].motion.rate_hz / trials[0].step)
    power = float(np.mean(left**2))
    whole = power * len(y) / independent(left, np.concatenate([trial.block for trial in trials]), lags)
    sd = np.hypot(np.sqrt(np.maximum(np.diagonal(inverse), 0.0) * whole) / size, math.sqrt(power / LOOKS))
    return _Zeros(float(left @ left), steady, sd[: len(steady)], stiffness)


def _of_recording(motion: Motion) -> Array:
    """(n, 4) what a recording has of its own: another temperature gives other frictions."""
    rate, speed = motion.twist_rate_rad_s, motion.velocity_out_rad_s
    return np.stack((rate, np.sign(rate), speed, np.sign(speed)), axis=1)


def _of_all(motion: Motion, structure: Beside) -> Array:
    """(n, k) of a spring that bends, of a gap, of elements that slip and of a weight."""
    size = float(np.std(motion.twist_rad)) + 1e-300
    columns = [(motion.twist_rad / size) ** power for power in range(2, structure.powers + 1)]
    if structure.gap:
        columns += [np.clip(motion.twist_rad / size, -half, half) for half in GAPS]
    if structure.loops:
        columns += [z for z, _ in stop_operators(motion.twist_rad / size, LOOPS, (None,) * len(LOOPS))]
    if structure.weight and not senses(motion):
        columns += [np.sin(motion.theta_out_rad), np.cos(motion.theta_out_rad)]
    return np.stack(columns, axis=1) if columns else np.empty((len(motion), 0))


def _waves(trials: Sequence[PreparedMotion]) -> list[Array]:
    """(m, k) of each recording, the waves of a wave generator; none where one of them does not turn far enough."""
    if min(float(np.ptp(trial.motion.theta_in_rad)) for trial in trials) < 2 * math.pi * LEAST_TURNS:
        return [np.empty((len(trial.rows), 0)) for trial in trials]
    angles = [np.outer(trial.motion.theta_in_rad, WAVES) for trial in trials]
    columns = (np.hstack((np.cos(angle), np.sin(angle))) for angle in angles)
    return [trial.project(column) for trial, column in zip(trials, columns, strict=True)]
