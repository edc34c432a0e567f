"""A gear with dry friction predicted block by block: the twist, and how it changes with every parameter.

The measured twist rate is too coarse to tell when friction turns round; a simulated one is not. So the torsion
J d2phi + B dphi + K phi + F_c tanh(dphi / v_s) = J d2(theta_in / R + e), driven by the motor angle alone, is carried
from block to block, and its derivatives with it (the sensitivity equations; Ljung, System Identification, 1999,
section 10.3). Measured minus predicted twist then holds encoder noise and the parameters' errors, nothing else: what
a Kalman filter wants of it (an extended one in prediction-error form; Ljung, IEEE TAC 24 (1979)).

The spring, mass and damper are integrated exactly, the friction as straight lines over a sixth of a sample: a sign
that turns round a tenth of a millisecond late makes a damping that is not there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge_daemon.motion.motor_angle import waves_of
from edge_daemon.motion.streaming import ORDERS
from edge_daemon.records import Array
from edge_daemon.track.stepping import FrictionGear, Steps, lagrange, refined, ride, solve, steps_of

SUBSTEPS = 3
"""of a sample: how finely derivatives are carried"""
FINER = 2
"""of a substep: at 1 kHz the twist errs by a twentieth of the noise of a 24-bit encoder"""
REACH = 2
"""samples before, and one more after, that the interpolation wants"""
BEFORE, AFTER = REACH + 1, REACH + 2
"""and one beyond, for the curvature at the ends"""
SETTLING = 40
"""samples after a start before the prediction counts: a torsion forgets how it began in about ten milliseconds"""


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
    friction_Nm: Array
    """mean about the sample before each: friction that turns round within a sample is not what a sample of it says"""
    settled: bool


class FrictionTwist:
    """Carries the prediction from block to block."""

    def __init__(self, ratio: float) -> None:
        self._ratio = ratio
        self.forget()

    def forget(self) -> None:
        """Start from the measured twist with the next samples."""
        self._tail = np.empty((0, 4))
        self._state: tuple[float, float] | None = None
        self._slopes = np.zeros((2, 3 + 2 * len(ORDERS)))
        self._turn = np.empty(0)
        self._samples = 0

    def predict(self, new: Array, rate_hz: float, gear: FrictionGear) -> Predicted | None:
        """The samples that (n, 4) motor angle, its rate and acceleration and the measured twist make known; None while
        there are too few to interpolate."""
        known = np.concatenate((self._tail, new))
        self._tail = known[-(BEFORE + AFTER) :]
        if len(known) <= BEFORE + AFTER:
            return None
        coarse = _interpolated(known[:, :3])
        waves, lifts = waves_of(coarse)
        push = gear.inertia * (coarse[:, 2] / self._ratio + lifts @ gear.error_rad)
        waves, lifts = waves[SUBSTEPS:-SUBSTEPS], _rounded(lifts[SUBSTEPS - 1 : 1 - SUBSTEPS])
        seen = known[BEFORE + 1 : len(known) - AFTER + 1, 3]
        if self._state is None:
            self._state = float(known[BEFORE, 3] + waves[0] @ gear.error_rad + gear.zero_rad), 0.0
        steps = steps_of(gear, 1 / (rate_hz * SUBSTEPS))
        twist, speed = self._integrated(push, self._state, steps, gear)
        turn = np.tanh(speed / gear.smoothing)
        slopes = self._sensitivities(twist, speed, turn, gear.inertia * lifts, steps, gear)
        self._state = float(twist[-1]), float(speed[-1])
        self._samples += len(seen)
        at = slice(SUBSTEPS, None, SUBSTEPS)
        return Predicted(
            seen,
            twist[at] - waves[at] @ gear.error_rad - gear.zero_rad,
            slopes[at, 0],
            slopes[at, 1],
            slopes[at, 2],
            slopes[at, 3:] - waves[at],
            gear.friction * self._about(turn),
            self._samples > len(seen) + SETTLING,
        )

    @staticmethod
    def _integrated(push: Array, start: tuple[float, float], steps: Steps, gear: FrictionGear) -> tuple[Array, Array]:
        """(m,) twist and rate at every substep, SUBSTEPS after the first of `push` to as many before its last."""
        rough = ride(_rounded(push[SUBSTEPS - 1 : 1 - SUBSTEPS]).tolist(), start, steps, gear)
        at = np.arange(FINER * (len(rough[1]) - 1) + 1) / FINER
        guess = np.interp(at, at[::FINER], rough[1])
        fine = refined(_rounded(_finer(push)), start, steps_of(gear, steps.step_s / FINER), gear, guess)
        return rough if fine is None else (fine[0][::FINER], fine[1][::FINER])

    def _about(self, turn: Array) -> Array:
        """(n,) mean over a sample's time about each sample but the newest, of (m,) values at every substep."""
        before, self._turn = self._turn if len(self._turn) else turn[:1], turn[-2:-1]
        joined = np.concatenate((before, turn[:-2]))
        mean: Array = joined.reshape(-1, SUBSTEPS).mean(axis=1)
        return mean

    def _sensitivities(
        self, twist: Array, speed: Array, turn: Array, lifts: Array, steps: Steps, gear: FrictionGear
    ) -> Array:
        """(m, 3 + waves) derivatives of the twist."""
        force = np.column_stack((-twist, -speed, -turn, lifts))
        right = np.empty((2 * len(twist) - 2, force.shape[1]))
        right[0::2] = steps.start[1] * force[:-1] + steps.end[1] * force[1:]
        right[1::2] = steps.start[0] * force[:-1] + steps.end[0] * force[1:]
        solved = solve(steps, gear.friction / gear.smoothing * (1 - turn**2), right, self._slopes)
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


def _finer(push: Array) -> Array:
    """(m,) between the nodes of (n,), FINER to each, from SUBSTEPS after the first to as many before the last, and one
    more at either end."""
    count = len(push) - 2 * SUBSTEPS + 1
    out = np.empty((count, FINER))
    for i, weights in enumerate(FINER_WEIGHTS):
        out[:, i] = sum(w * push[j : j + count] for j, w in enumerate(weights))
    return out.ravel()[FINER - 1 : 2 - FINER or None]


def _rounded(force: Array) -> Array:
    """(m - 2, k) nodes of the straight lines that push as much as the curve through (m, k) does: straight lines lose
    (omega h)^2 / 12 of a force."""
    nodes: Array = force[1:-1] - (force[2:] - 2 * force[1:-1] + force[:-2]) / 12
    return nodes


WEIGHTS = [lagrange(i / SUBSTEPS, REACH) for i in range(SUBSTEPS)]
FINER_WEIGHTS = [lagrange(i / FINER, REACH) for i in range(FINER)]
