"""The motor angle for a simulation, filtered as far as the motor's motion allows.

What drives a simulated torsion near its resonance it magnifies, the rounding of the motor encoder too. A motor that
moves within the balance filter's band, as all but a badly tuned or hard-worked one does, is smoothed by that filter;
where there is more above the band than the encoder's noise, only by the lightest that differentiates. Both delay alike.
"""

from __future__ import annotations

import numpy as np

from edge_daemon.motion.kinematics import FirSet, filters
from edge_daemon.motion.streaming import ARGUMENT_SHARE, MOTOR, ORDERS, TWIST
from edge_daemon.records import Array

ROUGH, SMOOTH = 2.0, 1.5
"""Times the variance that the encoder's noise gives the band between the filters: above the first the motor moves in
it, below the second it does so no more (guess)."""
LOOK_S, MEMORY_LOOKS = 0.3, 7
"""Time from one look at that band to the next, and looks over which it is averaged: about two seconds."""
CALM, CALM_LOOKS = 1.05, 60
"""Up to this many times that variance there is nothing but noise to be taken out of the angle itself, averaged over so
many looks: of motion the joint would make several times as much near its resonance."""


class MotorAngle:
    """Carries the samples that the filters still need from block to block."""

    def __init__(self, fir: FirSet) -> None:
        self.delay = fir.delay
        light = filters(fir.rate_hz, ARGUMENT_SHARE * fir.rate_hz)
        self.lag = light.delay
        """samples by which the lightly filtered motion of a stretch is behind the newest"""
        self._smooth, self._light = _kernels(fir, fir.delay), _kernels(light, fir.delay)
        self._between = self._light[0] - self._smooth[0]
        self._rough, self._looks, self.is_rough = 0.0, 0, False
        self._long, self.is_calm = 0.0, False
        self._look_samples = LOOK_S * fir.rate_hz
        self._unseen = self._look_samples
        self.forget()

    def forget(self) -> None:
        """The next samples do not follow the last ones."""
        self._tail = np.empty((2, 0))

    def follow(self, unfiltered: Array, noise_rad2: float, whole: bool = True) -> Array | None:
        """(n, 5) angle, rate, acceleration of the motor, measured twist, and what the filter took out of the angle, of
        samples `delay` ago; None while there are too few. `unfiltered` as in `Stretch`; `noise_rad2`: the motor
        encoder's, per sample. Where samples were bridged it is not `whole`: the kinks of bridges are no motion."""
        known = np.concatenate((self._tail, unfiltered[[MOTOR, TWIST]]), axis=1)
        self._tail = known[:, -2 * self.delay :]
        n = known.shape[1] - 2 * self.delay
        if n <= 0:
            return None
        start = float(known[0, 0])
        angle = known[0] - start
        self._unseen += n
        if whole and self._unseen >= self._look_samples:
            self._judge(np.convolve(angle, self._between, "valid"), noise_rad2)
            self._unseen = 0.0
        out = np.empty((n, 5))
        for i, kernel in enumerate(self._light if self.is_rough else self._smooth):
            out[:, i] = np.convolve(angle, kernel, "valid")
        out[:, 0] += start
        out[:, 3] = known[1, self.delay : self.delay + n]  # as it is: smoothed, its noise would not be white
        out[:, 4] = known[0, self.delay : self.delay + n] - out[:, 0]
        return out

    def left(self, samples: int) -> Array:
        """(samples // 2 + 1,) share of the variance of the encoder's noise that a calm motor's filter leaves at each
        frequency."""
        return np.asarray(np.abs(np.fft.rfft(self._smooth[0], samples)) ** 2)

    def _judge(self, between: Array, noise_rad2: float) -> None:
        """(n,) what the motor angle holds between the two filters."""
        power = float(between @ between) / len(between)
        self._looks = min(self._looks + 1, CALM_LOOKS)
        self._rough += (power - self._rough) / min(self._looks, MEMORY_LOOKS)
        self._long += (power - self._long) / self._looks
        expected = noise_rad2 * float(self._between @ self._between)
        self.is_calm = self._looks >= MEMORY_LOOKS and max(self._long, self._rough / SMOOTH) < CALM * expected
        self.is_rough = self._rough > (SMOOTH if self.is_rough else ROUGH) * expected


def _kernels(fir: FirSet, delay: int) -> tuple[Array, Array, Array]:
    """Value, first and second derivative, filled up to the same delay."""
    wide = max(delay - fir.delay, 0)
    value, first, second = (np.pad(kernel, wide) for kernel in (fir.value, fir.first, fir.second))
    return value, first, second


def waves_of(motor: Array) -> tuple[Array, Array]:
    """(m, 2 * len(ORDERS)) sine and cosine of each order of the motor angle, and their second derivatives in time, from
    (m, 3) angle, rate and acceleration."""
    angle, rate, acceleration = motor.T
    square = rate * rate
    waves, lifts = np.empty((len(motor), 2 * len(ORDERS))), np.empty((len(motor), 2 * len(ORDERS)))
    sine, cosine = np.sin(angle), np.cos(angle)
    for i, order in enumerate(ORDERS):
        if i:  # each order is twice the one before
            sine, cosine = 2 * sine * cosine, 1 - 2 * sine * sine
        bend, tilt = order**2 * square, order * acceleration
        waves[:, 2 * i], waves[:, 2 * i + 1] = sine, cosine
        lifts[:, 2 * i], lifts[:, 2 * i + 1] = tilt * cosine - bend * sine, -tilt * sine - bend * cosine
    return waves, lifts
