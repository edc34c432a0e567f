"""A gear without friction predicted by its impulse response: the twist, and how it changes with every parameter.

The torsion J d2phi + B dphi + K phi = J d2(theta_in / R + e) turns motor angle and kinematic error into a twist through
P(s) = J s^2 / (J s^2 + B s + K). Measured minus predicted twist holds the encoders' rounding and nothing else, equally
at all frequencies: weighed alike, its samples give the least possible variance (output error; Ljung, System
Identification, 1999, section 10.3). The balance of torques sees the same noise through J s^2 + B s + K, small near the
resonance, where most of what is to be known of the damping lies, and above the cut-off of its filter.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from edge_daemon.effects.model import Model
from edge_daemon.motion.excitation import SensorNoise
from edge_daemon.motion.kinematics import FirSet, filters
from edge_daemon.motion.motor_angle import MotorAngle, waves_of
from edge_daemon.motion.noise_level import ColumnNoise
from edge_daemon.motion.regressors import (
    DAMPING,
    KINEMATIC,
    STIFFNESS,
    Equation,
    Linearisation,
    Regressors,
    TorqueNoise,
)
from edge_daemon.motion.streaming import ARGUMENT_SHARE, ORDERS, Stretch
from edge_daemon.records import Array

Gains = NDArray[np.complex128]

FADED = 9.0
"""An impulse counts no more after so many time constants: a ten-thousandth of it is left."""
LONGEST_S = 0.25
"""A gear whose impulse response is longer is left to the balance of torques."""
NEAR = np.array([0.05, 0.5])
"""Below this sd over value of stiffness and damping the answer is linear in what is not yet known of them (guess)."""
SPARE = 1.25
"""So many times the samples needed are kept, so that estimates may wander without a new length."""
TRANSFORM = 2048
"""The transfer function is turned into a kernel over so many samples."""
WAVES = slice(2, 2 + 2 * len(ORDERS))
LIFTS = slice(WAVES.stop, WAVES.stop + 2 * len(ORDERS))
"""Places of the kinematic error's waves and their second derivatives."""
DRIVEN = [1, *range(LIFTS.start, LIFTS.stop)]
"""The motor's acceleration and those drive the twist."""


def is_linear(model: Model, torque_measured: bool) -> bool:
    """Whether the twist of this model follows from the motor angle by an impulse response."""
    names = {effect.name for effect in model.effects} - {KINEMATIC}
    return model.balance == "torsion" and not torque_measured and names == {STIFFNESS[0], DAMPING[0]}


class LinearPrediction:
    """Measures each stretch against the predicted twist."""

    def __init__(self, regressors: Regressors, fir: FirSet) -> None:
        self._regressors, self._rate_hz = regressors, fir.rate_hz
        self._places = [regressors.keys.index(key) for key in (STIFFNESS, DAMPING)]
        self._motor, self._light = MotorAngle(fir), filters(fir.rate_hz, ARGUMENT_SHARE * fir.rate_hz)
        self._longest = math.ceil(LONGEST_S * fir.rate_hz) + 2 * self._light.delay
        self._length = 0
        self._made: tuple[Linearisation, int, int] | None = None
        self._gains: Gains = np.empty((3, 0), dtype=np.complex128)
        self.balanced: tuple[Stretch, Array | None] | None = None
        """the newest stretch, and that no torque in it is other than the spring's and the damper's"""
        self.forget()

    def forget(self) -> None:
        """The next samples do not follow the last ones."""
        self._motor.forget()
        self._known = np.empty((0, LIFTS.stop))

    def is_ready(self, value: Array, sd: Array, point: Linearisation) -> bool:
        """Whether the amplitudes (k,) are known well enough to be linear around, and the impulse response is short."""
        sure = sd[self._places] < NEAR * value[self._places]
        return bool(sure.all()) and self._needed(point) <= self._longest

    def _needed(self, point: Linearisation) -> float:
        """Samples of the kernel: the light filter's on either side, and the ringing."""
        inertia = self._regressors.model.output_inertia_kg_m2
        half = point.damping_s * point.stiffness / (2 * inertia)
        slow = half - math.sqrt(max(half**2 - point.stiffness / inertia, 0.0))
        return 2 * self._light.delay + FADED * self._rate_hz / slow if slow > 0 else math.inf

    def equation(self, stretch: Stretch, _: Array, point: Linearisation, noise: SensorNoise) -> Equation:
        """Rows linear around the `point`."""
        usable, k = stretch.valid, len(self._regressors.keys)
        if not usable.all():
            self.forget()
        self.balanced = stretch, None
        sensors_rad2 = noise.out_rad2 + noise.motor_rad2 / self._regressors.model.ratio**2
        white = TorqueNoise(ColumnNoise(np.zeros((k, k)), np.zeros(k)), point.stiffness**2 * sensors_rad2)
        needed = min(self._needed(point), self._longest)
        if not needed <= self._length <= 2 * needed:
            self._length = math.ceil(SPARE * needed)
        known = self._follow(stretch, noise)
        n = len(known) - self._length + 1
        if n <= 0:
            return Equation(stretch.motion, np.zeros((0, k)), np.zeros(0), np.zeros(0, dtype=bool), usable, white)
        columns, torque = self._rows(known, n, point)
        self._known = known[n:]
        return Equation(stretch.motion, columns, torque, np.isfinite(torque), usable, white)

    def _follow(self, stretch: Stretch, noise: SensorNoise) -> Array:
        """(n, 2 + 4 * len(ORDERS)) measured twist, motor's acceleration seen from the output, waves and their second
        derivatives: what is kept and what is new."""
        motor = self._motor.follow(stretch.unfiltered, noise.motor_rad2, bool(stretch.valid.all()))
        if motor is not None:
            driven = motor[:, 2:3] / self._regressors.model.ratio
            new = np.concatenate((motor[:, 3:4], driven, *waves_of(motor[:, :3])), axis=1)
            self._known = np.concatenate((self._known, new))
        return self._known

    def _rows(self, known: Array, n: int, point: Linearisation) -> tuple[Array, Array]:
        """(n, k) columns and (n,) torque: measured minus predicted twist, times the stiffness."""
        newest = self._length - 1 - self._light.delay
        seen, waves = known[newest : newest + n, 0], known[newest : newest + n, WAVES]
        lifted, twist, by_stiffness, by_damping = self._answers(known[:, DRIVEN], n, point)
        columns = np.ones((n, len(self._regressors.keys)))
        columns[:, self._regressors.kinematic] = waves - lifted.T
        columns[:, self._places[0]] = by_stiffness - point.zero_rad
        columns[:, self._places[1]] = by_damping
        around = np.zeros(columns.shape[1])
        around[self._regressors.kinematic] = point.stiffness * point.error_rad
        around[self._places] = point.stiffness, point.stiffness * point.damping_s
        if (offset := self._regressors.offset) is not None:
            around[offset] = point.stiffness * point.zero_rad
        predicted = twist - waves @ point.error_rad - point.zero_rad
        return columns, columns @ around - point.stiffness * (seen - predicted)

    def _answers(self, driven: Array, n: int, point: Linearisation) -> tuple[Array, Array, Array, Array]:
        """The twist that follows from what drives it, (n + length - 1, 1 + 2 * len(ORDERS)) acceleration and second
        derivatives of the waves: (2 * len(ORDERS), n) that of each wave, (n,) that of all together, and minus the
        stiffness times its derivatives to stiffness and damping."""
        size = _quick_length(len(driven))
        gains = self._kernels(point, size)
        pushes = np.fft.rfft(driven.T, size)
        push = pushes[0] + point.error_rad @ pushes[1:]
        answers = np.fft.irfft(np.concatenate((gains[0] * pushes[1:], gains * push)), size)
        answers = answers[:, self._length - 1 : self._length - 1 + n]
        return answers[:-3], answers[-3], answers[-2], answers[-1]

    def _kernels(self, point: Linearisation, size: int) -> Gains:
        """(3, size / 2 + 1) from acceleration to twist, and to minus the stiffness times its derivatives."""
        made = point, size, self._length
        if self._made is None or self._made[0] is not point or self._made[1:] != made[1:]:
            s = 2j * math.pi * np.fft.rfftfreq(TRANSFORM, 1 / self._rate_hz)
            inertia = self._regressors.model.output_inertia_kg_m2
            answer = inertia * s**2 + point.stiffness * (point.damping_s * s + 1)
            twisted = np.fft.rfft(self._light.value, TRANSFORM) * inertia / answer
            slope = point.stiffness * twisted / answer
            kernels = np.fft.irfft(np.stack((twisted, slope, s * slope)), TRANSFORM)[:, : self._length]
            self._made, self._gains = made, np.fft.rfft(kernels, size)
        return self._gains


@cache
def _quick_length(samples: int) -> int:
    """A length that is quickly transformed."""
    return int(fft.next_fast_len(samples, real=True))
