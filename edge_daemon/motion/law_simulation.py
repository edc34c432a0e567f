"""A gear with friction, hysteresis or a gap predicted block by block: the twist, and how it changes with every number.

The measured twist rate is too coarse to tell when friction turns round; a simulated one is not. So the torsion
J d2phi + B dphi + K phi + laws(phi, dphi) = J d2(theta_in / R + e), driven by the motor angle alone, is carried from
block to block by the integrator that recordings are fitted with, and its derivatives with it (the sensitivity
equations; Ljung, System Identification, 1999, section 10.3). Measured minus predicted twist then holds encoder noise
and the parameters' errors, nothing else: what a Kalman filter wants of it (an extended one in prediction-error form;
Ljung, IEEE TAC 24 (1979)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from edge_daemon.integrator import twist
from edge_daemon.motion.motor_angle import waves_of
from edge_daemon.records import Array

STEPS = 16
"""Steps per sample, an even number: at 1 kHz the twist errs by a hundredth of the noise of a 24-bit encoder, and with
half as many the damping by two standard deviations after a minute."""
REACH = 2
"""Samples before an interval, and after it, that the interpolation wants."""
BEFORE, AFTER = REACH + 1, REACH + 2
"""Samples that the prediction wants at either end: one step beyond the interpolated ones tells the curvature."""
SETTLING = 150
"""Samples after a start before the prediction counts: at 1 kHz four time constants of a torsion of 100 Hz whose damping
ratio is 0.04."""


@dataclass(frozen=True, slots=True)
class LawGear:
    """What the prediction takes from the estimates so far."""

    inertia: float
    stiffness: float
    damping: float
    elements: Array
    """(e, 5) of the laws"""
    changes: Array
    """(a, e, 4) what each amplitude of the laws changes in them"""
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
    by_spring: Array
    """(n, 2) its derivatives to stiffness and damping [rad per unit]"""
    by_laws: Array
    """(n, a) to the amplitudes of the laws"""
    by_error: Array
    """(n, 2 * len(ORDERS)) to the kinematic error [rad/rad]"""
    laws_Nm: Array
    """torque of the laws, mean about the sample before each: friction that turns round within a sample is not what a
    sample of it says"""
    settled: bool


class LawSimulation:
    """Carries the prediction from block to block."""

    def __init__(self, ratio: float) -> None:
        self._ratio = ratio
        self.forget()

    def forget(self) -> None:
        """Start from the measured twist with the next samples."""
        self._tail = np.empty((0, 4))
        self._motion: twist.TwistState | None = None
        self._torque = np.empty(0)
        self._samples = 0

    @property
    def remembered(self) -> Array:
        """(e,) what the laws remember at the newest sample; NaN before the prediction counts."""
        known = self._motion is not None and self._samples > SETTLING
        return self._motion.z if known and self._motion is not None else np.full(1, math.nan)

    def predict(self, new: Array, rate_hz: float, gear: LawGear) -> Predicted | None:
        """The samples that (n, 4) motor angle, its rate and acceleration and the measured twist make known; None while
        there are too few to interpolate."""
        known = np.concatenate((self._tail, new))
        self._tail = known[-(BEFORE + AFTER) :]
        count = len(known) - BEFORE - AFTER
        if count <= 0:
            return None
        at = slice(BEFORE, BEFORE + count + 1)
        waves, (driven, lifts) = waves_of(known[at, :3])[0], self._driven(known[:, :3])
        numbers = _numbers(gear, gear.inertia * lifts.T)
        if self._motion is None:
            twist_rad = float(known[BEFORE, 3] + waves[0] @ gear.error_rad + gear.zero_rad)
            self._motion = twist.at_rest(twist_rad, 0.0, len(gear.elements), len(numbers.springs))
        push, step_s = gear.inertia * (driven + lifts @ gear.error_rad), 1 / (rate_hz * STEPS)
        still = np.zeros(len(push))
        forcing = twist.Forcing(push, still, still, 0.0, step_s, STEPS)
        spring = twist.TorsionGear(gear.inertia, gear.stiffness, gear.damping, gear.elements)
        found = twist.simulate(spring, forcing, numbers, self._motion)
        slopes, laws = found.end_changes.T, 2 + len(gear.changes)
        self._samples += count
        return Predicted(
            known[at, 3][1:],
            found.ends - waves[1:] @ gear.error_rad - gear.zero_rad,
            slopes[:, :2],
            slopes[:, 2:laws],
            slopes[:, laws:] - waves[1:],
            self._about(found.torque),
            self._samples > count + SETTLING,
        )

    def _driven(self, motor: Array) -> tuple[Array, Array]:
        """Mean acceleration (m,) of the motor seen from the output, and of the waves (m, 2 * len(ORDERS)), of every
        step, from (n, 3) angle, rate and acceleration."""
        fine = middles(motor, STEPS)
        driven = held(np.column_stack((fine[:, 2] / self._ratio, waves_of(fine)[1])), STEPS)
        return driven[:, 0], driven[:, 1:]

    def _about(self, torque: Array) -> Array:
        """(n,) mean over a sample's time about each sample but the newest, of (n * STEPS,) means of the steps."""
        half = STEPS // 2
        before = self._torque if len(self._torque) else torque[:half]
        self._torque = torque[-half:]
        mean: Array = np.concatenate((before, torque[:-half])).reshape(-1, STEPS).mean(axis=1)
        return mean


def _numbers(gear: LawGear, pushes: Array) -> twist.Numbers:
    """Stiffness, damping, the amplitudes of the laws and the kinematic error's, which push by (q, n) each."""
    laws, q = 2 + len(gear.changes), 2 + len(gear.changes) + len(pushes)
    springs, elements = np.zeros((q, 2)), np.zeros((q, len(gear.elements), 4))
    springs[0, 0] = springs[1, 1] = 1.0
    elements[2:laws] = gear.changes
    driven = np.zeros((q, pushes.shape[1] + 1))
    driven[laws:, :-1], driven[laws:, -1] = pushes, pushes[:, -1]
    return twist.Numbers(springs, elements, driven, np.zeros((q, 1)))


def middles(known: Array, steps: int) -> Array:
    """(steps (n - 2 REACH - 1), k) in the middle of so many steps to a sample, between the samples REACH from the start
    and one more from the end of (n, k)."""
    count = len(known) - 2 * REACH - 1
    out = np.empty((steps * count, known.shape[1]))
    for i in range(steps):
        weights = lagrange((i + 0.5) / steps, REACH)
        out[i::steps] = sum(w * known[j : j + count] for j, w in enumerate(weights))
    return out


def held(fine: Array, steps: int) -> Array:
    """(m - 2 steps, k) torques that stay for a step each and move the twist at its ends as the curve through (m, k)
    values in their middles does: a mean is (h omega)^2 / 24 less, and a torque that stays moves it by twice as much
    more. Those of the first and last sample are given up."""
    inside = fine[steps - 1 : len(fine) - steps + 1]
    values: Array = inside[1:-1] - (inside[2:] - 2 * inside[1:-1] + inside[:-2]) / 24
    return values


@cache
def lagrange(at: float, reach: int) -> tuple[float, ...]:
    """Weights of the samples -reach .. reach + 1 for the instant `at`."""
    nodes = range(-reach, reach + 2)
    return tuple(math.prod((at - other) / (node - other) for other in nodes if other != node) for node in nodes)
