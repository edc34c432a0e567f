"""Many gears with dry friction simulated side by side, one per column: the same motion, other parameters.

The torsion J d2phi + B dphi + K phi + friction(dphi) = J d2(theta_in / R + e), driven by the motor angle alone. Spring,
mass and damper are carried exactly from substep to substep, the friction as straight lines between them; its value at
the end of a substep is found by Newton's method. The law is that of the catalogue's Stribeck friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge_daemon.records import Array
from edge_daemon.track.stepping import lagrange, moved_by

SUBSTEPS = 4
"""of a sample: at 1 kHz the twist is then right to a per cent where friction turns round within a third of a sample"""
NEWTON_STEPS = 2
"""from a start that goes on as before, and never further than `FARTHEST` widths each: more change nothing"""
FARTHEST = 3.0
LIGHTEST = 0.01
"""damping ratio that a gear has at least"""
SMALLEST = 60.0
"""exponent beyond which a bump is nothing; smaller numbers make the processor slow"""


@dataclass(frozen=True, slots=True)
class Gears:
    """(s,) of each."""

    inertia: float
    """[kg m^2], one for all"""
    stiffness: Array
    damping: Array
    friction: Array
    """Coulomb level [N m]"""
    excess: Array
    """static level above it [N m]"""
    stribeck_speed: Array
    """[rad/s]"""
    smoothing: Array
    """twist rate at which the sign has reached tanh(1) [rad/s]"""


def ride(push: Array, twist: Array, rate: Array, gears: Gears, step_s: float) -> Array:
    """(n, s, p) twist [rad] at every `SUBSTEPS`-th of the substeps of p stretches of motion, for s gears.

    `push` (SUBSTEPS (n - 1) + 1, s, p) is inertia times acceleration of what drives the spring [N m]; `twist` and
    `rate` (s, p) are those at the start.
    """
    (p00, p01), (p10, p11), (a0, a1), (b0, b1) = _steps(gears, step_s)
    level, excess = gears.friction[:, None], gears.excess[:, None]
    bend, turning = gears.stribeck_speed[:, None] ** -2, 1 / gears.smoothing[:, None]
    most, reach = b1 * (level + excess), FARTHEST * gears.smoothing[:, None]
    x, v, before = twist, rate, rate
    friction = (level + excess * _bump(v, bend)) * np.tanh(v * turning)
    course = [x]
    for i in range(1, len(push)):
        torque = push[i - 1] - friction
        free = p10 * x + p11 * v + a1 * torque + b1 * push[i]
        at = np.minimum(np.maximum(2 * v - before, free - most), free + most)
        for _ in range(NEWTON_STEPS):
            bump, turn = excess * _bump(at, bend), np.tanh(at * turning)
            size = level + bump
            slope = size * (1 - turn * turn) * turning - 2 * bend * at * bump * turn
            step = (at - free + b1 * size * turn) / np.maximum(1 + b1 * slope, 0.5)
            at = at - np.minimum(np.maximum(step, -reach), reach)
        friction = (level + excess * _bump(at, bend)) * np.tanh(at * turning)
        x = p00 * x + p01 * v + a0 * torque + b0 * (push[i] - friction)
        v, before = at, v
        if i % SUBSTEPS == 0:
            course.append(x)
    return np.array(course)


def _bump(speed: Array, bend: Array) -> Array:
    return np.exp(-np.minimum(speed * speed * bend, SMALLEST))


def _steps(gears: Gears, step_s: float) -> tuple[tuple[Array, Array], ...]:
    """One substep of [twist, rate] of each gear, (s, 1) each: the two rows of the transition, and what a torque at its
    start and at its end adds."""
    damping = np.maximum(gears.damping, 2 * LIGHTEST * np.sqrt(gears.stiffness * gears.inertia))
    moved = moved_by(gears.stiffness, damping, gears.inertia, step_s).transpose(1, 2, 0)[..., None]
    start, end = moved[:, 2] - moved[:, 3], moved[:, 3]
    return (moved[0, 0], moved[0, 1]), (moved[1, 0], moved[1, 1]), (start[0], start[1]), (end[0], end[1])


def finer(signal: Array) -> Array:
    """(SUBSTEPS (n - 1) + 1, k) cubics through (n, k), SUBSTEPS steps to a sample (Lagrange)."""
    ends = np.concatenate((2 * signal[:1] - signal[1:2], signal, 2 * signal[-1:] - signal[-2:-1]))
    n = len(signal) - 1
    out = np.empty((SUBSTEPS * n + 1, *signal.shape[1:]))
    for i in range(SUBSTEPS):
        out[i:-1:SUBSTEPS] = sum(weight * ends[j : j + n] for j, weight in enumerate(lagrange(i / SUBSTEPS, 1)))
    out[-1] = signal[-1]
    return out
