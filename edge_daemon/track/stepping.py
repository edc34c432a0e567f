"""A spring, mass and damper with dry friction, step by step: exact but for the friction, which is a straight line
over a step; first in steps that carry the friction round, then all fine ones at once around what these gave.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, lapack

from edge_daemon.records import Array

NEWTON_STEPS = 30
ROUGH = 0.02
"""of the twist rate at which friction has turned round: where the first ride stops looking, for it is refined"""
STIFFEST = 3.0
"""friction that turns round much faster than this many steps is carried as straight lines only"""
REFINEMENTS = 8
SETTLED = 1e-2
"""of the same rate: the next refinement would change a ten-thousandth of it"""


@dataclass(frozen=True, slots=True)
class FrictionGear:
    """What the prediction takes from the estimates so far."""

    inertia: float
    stiffness: float
    damping: float
    friction: float
    smoothing: float
    """twist rate [rad/s] at which the friction has turned round"""
    error_rad: Array
    """sine and cosine of each order of the kinematic error"""
    zero_rad: float
    """what the encoders' zeros hide of the twist"""


@dataclass(frozen=True, slots=True)
class Steps:
    """One step of [twist, rate]."""

    step_s: float
    moved: Array
    """(2, 2) transition"""
    start: Array
    """(2,) what a torque at the start of the step adds"""
    end: Array
    """(2,) at its end"""


def steps_of(gear: FrictionGear, step_s: float) -> Steps:
    """Of the linear part of a gear."""
    moved = moved_by(np.array([gear.stiffness]), np.array([gear.damping]), gear.inertia, step_s)[0]
    return Steps(step_s, moved[:, :2], moved[:, 2] - moved[:, 3], moved[:, 3])


def moved_by(stiffness: Array, damping: Array, inertia: float, step_s: float) -> Array:
    """(s, 2, 4) one step of [twist, rate] of springs, masses and dampers: what the state moves, what a torque adds that
    stays, and what one adds that grows from nothing to one. By a matrix exponential (Van Loan, IEEE TAC 23 (1978))."""
    grow = np.zeros((len(stiffness), 4, 4))
    grow[:, 0, 1] = step_s
    grow[:, 1, 0] = -stiffness / inertia * step_s
    grow[:, 1, 1] = -damping / inertia * step_s
    grow[:, 1, 2] = step_s / inertia
    grow[:, 2, 3] = 1.0
    moved: Array = expm(grow)[:, :2]
    return moved


def lagrange(at: float, reach: int) -> list[float]:
    """Weights of the samples -reach .. reach + 1 for the instant `at`."""
    nodes = range(-reach, reach + 2)
    return [math.prod((at - other) / (node - other) for other in nodes if other != node) for node in nodes]


def ride(push: list[float], start: tuple[float, float], steps: Steps, gear: FrictionGear) -> tuple[Array, Array]:
    """(m,) twist and rate at every step, the start included. Scalar by scalar: a step needs the one before."""
    (p00, p01), (p10, p11) = steps.moved.tolist()
    (a0, a1), (b0, b1) = steps.start.tolist(), steps.end.tolist()
    size, width, tanh = gear.friction, gear.smoothing, math.tanh
    pull, stiff, reach, enough = b1 * size, b1 * size / width, 3 * width, ROUGH * width
    x, v = start
    guess = v
    turn = tanh(v / width)
    twist, speed = [x], [v]
    before = push[0]
    for here in push[1:]:
        torque = before - size * turn
        free = p10 * x + p11 * v + a1 * torque + b1 * here
        at = guess
        for _ in range(NEWTON_STEPS):
            turn = tanh(at / width)
            step = (at - free + pull * turn) / (1 + stiff * (1 - turn * turn))
            if -enough < step < enough:
                break
            at -= step if -reach < step < reach else math.copysign(reach, step)
        x = p00 * x + p01 * v + a0 * torque + b0 * (here - size * turn)
        guess, v = at + at - v, at
        before = here
        twist.append(x)
        speed.append(v)
    return np.array(twist), np.array(speed)


def refined(
    push: Array, start: tuple[float, float], steps: Steps, gear: FrictionGear, speed: Array
) -> tuple[Array, Array] | None:
    """(m,) twist and rate at every step, from a guess of the rate: Newton's method for all steps at once. None where
    it does not settle, as for a friction that turns round at once."""
    width, (a0, a1), (b0, b1) = gear.smoothing, steps.start, steps.end
    curved = b1 * gear.friction < STIFFEST * width
    speed[0] = start[1]
    twist = None
    for _ in range(REFINEMENTS):
        turn = np.tanh(speed / width)
        slope = gear.friction / width * (1 - turn**2)
        force = push - gear.friction * turn
        linear = force + slope * speed
        right = np.empty(2 * len(push) - 2)
        right[0::2] = a1 * linear[:-1] + b1 * linear[1:]
        right[1::2] = a0 * linear[:-1] + b0 * linear[1:]
        if curved and twist is not None:
            bend = slope * (force - gear.stiffness * twist - gear.damping * speed)
            arch = steps.step_s / (12 * gear.inertia) * (bend[1:] - bend[:-1])
            right[0::2] += (a1 + b1) * arch
            right[1::2] += (a0 + b0) * arch
        solved = solve(steps, slope, right[:, None], np.array([[start[0]], [start[1]]]))[:, 0]
        twist, before = np.concatenate((start[:1], solved[1::2])), speed
        speed = np.concatenate((start[1:], solved[0::2]))
        if float(np.abs(speed - before).max()) < SETTLED * width:
            return twist, speed
    return None


def solve(steps: Steps, slope: Array, right: Array, start: Array) -> Array:
    """(2 m, k) rate and twist in turn after each of m steps, from a (2, k) twist and rate at the start and what pushes,
    (2 m, k), under a friction of `slope` (m + 1,) torque per rate: one triangular banded system."""
    (p00, p01), (p10, p11) = steps.moved
    (a0, a1), (b0, b1) = steps.start, steps.end
    x, v = start
    right[0] += p10 * x + (p11 - a1 * slope[0]) * v
    right[1] += p00 * x + (p01 - a0 * slope[0]) * v
    band = np.zeros((4, len(right)))
    band[0, 0::2] = 1 + b1 * slope[1:]
    band[0, 1::2] = 1.0
    band[1, 0::2] = b0 * slope[1:]
    band[1, 1::2] = -p10
    band[2, 0::2] = a1 * slope[1:] - p11
    band[2, 1::2] = -p00
    band[3, 0::2] = a0 * slope[1:] - p01
    solved: Array = lapack.dtbtrs(band, right, uplo="L")[0]
    return solved
