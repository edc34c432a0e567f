"""A gear with dry friction predicted block by block: the twist, and how it changes with every parameter.

The measured twist rate is too coarse to tell when friction turns round; a simulated one is not. So the torsion
J d2phi + B dphi + K phi + F_c tanh(dphi / v_s) = J d2(theta_in / R + e), driven by the motor angle alone, is carried
from block to block, and its derivatives with it (the sensitivity equations; Ljung, System Identification, 1999,
section 10.3). Measured minus predicted twist then holds encoder noise and the parameters' errors, nothing else: what
a Kalman filter wants of it (an extended one in prediction-error form; Ljung, IEEE TAC 24 (1979)).

The spring, mass and damper are integrated exactly, the friction as straight lines over a third of a sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, lapack

from edge_daemon.estimate.streaming import ORDERS, Arguments
from edge_daemon.records import Array

SUBSTEPS = 3
"""of a sample: at 1 kHz the error is then a fifth of the steps of a 24-bit encoder"""
REACH = 2
"""samples before, and one more after, that the interpolation wants"""
BEFORE, AFTER = REACH + 1, REACH + 2
"""and one beyond, for the curvature at the ends"""
SETTLING = 40
"""samples after a start before the prediction counts: a torsion forgets how it began in about ten milliseconds"""
NEWTON_STEPS = 30
TOLERANCE_RAD_S = 1e-8
STIFFEST = 3.0
"""friction that turns round much faster than this many steps is carried as straight lines only"""
LIGHTEST = 0.05
"""damping ratio that a prediction has at least: an estimate that strays must not make it ring for ever"""


@dataclass(frozen=True, slots=True)
class Gear:
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
class Predicted:
    """(n,) samples each."""

    seen_rad: Array
    """measured twist"""
    twist_rad: Array
    """as the encoders would show it"""
    by_stiffness: Array
    """its derivatives [rad per unit]"""
    by_damping: Array
    by_friction: Array
    by_error: Array
    """(n, 2 * len(ORDERS)) [rad/rad]"""
    settled: bool


class DryTwist:
    """Carries the prediction from block to block."""

    def __init__(self, ratio: float) -> None:
        self._ratio = ratio
        self.forget()

    def forget(self) -> None:
        """Start from the measured twist with the next samples."""
        self._tail = np.empty((0, 4))
        self._state: tuple[float, float] | None = None
        self._slopes = np.zeros((2, 3 + 2 * len(ORDERS)))
        self._samples = 0
        self._friction = np.empty(0)

    def predict(self, arguments: Arguments, gear: Gear) -> Predicted | None:
        """The samples that these make known; None while there are too few to interpolate."""
        motion = arguments.motion
        rate = (motion.velocity_out_rad_s + motion.twist_rate_rad_s) * self._ratio
        acceleration = (motion.acceleration_out_rad_s2 + arguments.twist_acceleration_rad_s2) * self._ratio
        new = np.stack((motion.theta_in_rad, rate, acceleration, arguments.twist_unfiltered_rad), axis=1)
        known = np.concatenate((self._tail, new))
        self._tail = known[-(BEFORE + AFTER) :]
        if len(known) <= BEFORE + AFTER:
            return None
        fine = _interpolated(known[:, :3])[SUBSTEPS - 1 : 1 - SUBSTEPS or None]
        waves, lifts = _waves(fine)
        waves, lifts = waves[1:-1], _rounded(lifts)
        push = gear.inertia * (_rounded(fine[:, 2:])[:, 0] / self._ratio + lifts @ gear.error_rad)
        seen = known[BEFORE + 1 : len(known) - AFTER + 1, 3]
        if self._state is None:
            self._state = float(known[BEFORE, 3] + waves[0] @ gear.error_rad + gear.zero_rad), 0.0
        step_s = 1 / (motion.rate_hz * SUBSTEPS)
        steps = _steps(gear, step_s)
        twist, speed = _ride(push.tolist(), self._state, steps, gear, step_s)
        slopes = self._sensitivities(twist, speed, gear.inertia * lifts, steps, gear)
        self._state = float(twist[-1]), float(speed[-1])
        self._samples += len(seen)
        self._friction = np.append(self._friction, gear.friction * np.tanh(speed[SUBSTEPS::SUBSTEPS] / gear.smoothing))
        at = slice(SUBSTEPS, None, SUBSTEPS)
        return Predicted(
            seen,
            twist[at] - waves[at] @ gear.error_rad - gear.zero_rad,
            slopes[at, 0],
            slopes[at, 1],
            slopes[at, 2],
            slopes[at, 3:] - waves[at],
            self._samples > len(seen) + SETTLING,
        )

    def friction_Nm(self, balance: Array) -> Array | None:
        """(n,) friction torque behind a filter, given as a matrix (n, reach); None before so much is known. Its
        outermost taps, a millionth, meet the last sample known."""
        ahead = np.full(AFTER - 1, self._friction[-1]) if len(self._friction) else np.empty(0)
        self._friction = self._friction[-balance.shape[1] :]
        joined = np.append(self._friction, ahead)[-balance.shape[1] :]
        return np.asarray(balance @ joined) if len(joined) == balance.shape[1] else None

    def _sensitivities(
        self, twist: Array, speed: Array, lifts: Array, steps: tuple[Array, Array, Array], gear: Gear
    ) -> Array:
        """(m, 3 + waves) derivatives of the twist, by one triangular banded system over [rate, twist] of all steps."""
        turn = np.tanh(speed / gear.smoothing)
        slope = gear.friction / gear.smoothing * (1 - turn**2)
        force = np.column_stack((-twist, -speed, -turn, lifts))
        (p00, p01), (p10, p11) = steps[0]
        (a0, a1), (b0, b1) = steps[1], steps[2]
        m = len(twist) - 1
        right = np.empty((2 * m, force.shape[1]))
        right[0::2] = a1 * force[:-1] + b1 * force[1:]
        right[1::2] = a0 * force[:-1] + b0 * force[1:]
        x, v = self._slopes
        right[0] += p10 * x + (p11 - a1 * slope[0]) * v
        right[1] += p00 * x + (p01 - a0 * slope[0]) * v
        band = np.zeros((4, 2 * m))
        band[0, 0::2] = 1 + b1 * slope[1:]
        band[0, 1::2] = 1.0
        band[1, 0::2] = b0 * slope[1:]
        band[1, 1::2] = -p10
        band[2, 0::2] = a1 * slope[1:] - p11
        band[2, 1::2] = -p00
        band[3, 0::2] = a0 * slope[1:] - p01
        solved = lapack.dtbtrs(band, right, uplo="L")[0]
        self._slopes = solved[:-3:-1].copy()
        slopes: Array = np.concatenate((np.zeros((1, force.shape[1])), solved[1::2]))
        return slopes


def _interpolated(known: Array) -> Array:
    """(SUBSTEPS (n - 2 REACH - 1) + 1, k) between the samples REACH from the start and one more from the end."""
    count = len(known) - 2 * REACH - 1
    out = np.empty((SUBSTEPS * count + 1, known.shape[1]))
    for i, weights in enumerate(WEIGHTS):
        out[i : SUBSTEPS * count : SUBSTEPS] = sum(w * known[j : j + count] for j, w in enumerate(weights))
    out[-1] = known[REACH + count]
    return out


def _rounded(force: Array) -> Array:
    """(m - 2, k) nodes of the straight lines that push as much as the curve through (m, k) does: straight lines lose
    (omega h)^2 / 12 of a force."""
    nodes: Array = force[1:-1] - (force[2:] - 2 * force[1:-1] + force[:-2]) / 12
    return nodes


def _lagrange(at: float) -> list[float]:
    """Weights of the samples -REACH .. REACH + 1 for the instant `at`."""
    nodes = range(-REACH, REACH + 2)
    return [math.prod((at - other) / (node - other) for other in nodes if other != node) for node in nodes]


WEIGHTS = [_lagrange(i / SUBSTEPS) for i in range(SUBSTEPS)]


def _waves(fine: Array) -> tuple[Array, Array]:
    """(m, 2 * len(ORDERS)) sine and cosine of each order of the motor angle, and their second derivatives in time."""
    angle, rate, acceleration = fine.T
    waves, lifts = np.empty((len(fine), 2 * len(ORDERS))), np.empty((len(fine), 2 * len(ORDERS)))
    for i, order in enumerate(ORDERS):
        sine, cosine = np.sin(order * angle), np.cos(order * angle)
        bend, tilt = (order * rate) ** 2, order * acceleration
        waves[:, 2 * i], waves[:, 2 * i + 1] = sine, cosine
        lifts[:, 2 * i], lifts[:, 2 * i + 1] = tilt * cosine - bend * sine, -tilt * sine - bend * cosine
    return waves, lifts


def _damping(gear: Gear) -> float:
    return max(gear.damping, 2 * LIGHTEST * math.sqrt(gear.stiffness * gear.inertia))


def _steps(gear: Gear, step_s: float) -> tuple[Array, Array, Array]:
    """One step of [twist, rate]: (2, 2) transition, and (2,) what a torque at its start and at its end adds
    (Van Loan, IEEE TAC 23 (1978): by one matrix exponential)."""
    k, j, damping = gear.stiffness, gear.inertia, _damping(gear)
    grow = np.zeros((4, 4))
    grow[0, 1], grow[1, 0], grow[1, 1], grow[1, 2], grow[2, 3] = (
        step_s,
        -k / j * step_s,
        -damping / j * step_s,
        step_s / j,
        1,
    )
    moved = expm(grow)
    return moved[:2, :2], moved[:2, 2] - moved[:2, 3], moved[:2, 3]


def _ride(
    push: list[float], start: tuple[float, float], steps: tuple[Array, Array, Array], gear: Gear, step_s: float
) -> tuple[Array, Array]:
    """(m,) twist and rate at every substep, the start included. Scalar by scalar: a step needs the one before."""
    (p00, p01), (p10, p11) = steps[0].tolist()
    (a0, a1), (b0, b1) = steps[1].tolist(), steps[2].tolist()
    size, width, tanh = gear.friction, gear.smoothing, math.tanh
    k, damping, j = gear.stiffness, _damping(gear), gear.inertia
    third, curved = step_s / 12, b1 * size < STIFFEST * width
    pull, stiff, reach, level = b1 * size, b1 * size / width, 3 * width, size / width
    x, v = start
    guess = v
    turn = tanh(v / width)
    bend = level * (1 - turn * turn) * (push[0] - size * turn - k * x - damping * v) / j
    twist, speed = [x], [v]
    before = push[0]
    for here in push[1:]:
        torque = before - size * turn
        free = p10 * x + p11 * v + a1 * torque + b1 * here
        at, guess = guess, v
        for _ in range(NEWTON_STEPS):
            turn = tanh(at / width)
            step = (at - free + pull * turn) / (1 + stiff * (1 - turn * turn))
            if -TOLERANCE_RAD_S < step < TOLERANCE_RAD_S:
                break
            at -= step if -reach < step < reach else math.copysign(reach, step)
        x = p00 * x + p01 * v + a0 * torque + b0 * (here - size * turn)
        v = at
        bent = bend
        bend = level * (1 - turn * turn) * (here - size * turn - k * x - damping * v) / j
        if curved:
            arch = third * (bend - bent)
            x += (a0 + b0) * arch
            v += (a1 + b1) * arch
        guess = v + v - guess
        before = here
        twist.append(x)
        speed.append(v)
    return np.array(twist), np.array(speed)
