"""The noise of a drive's motion, and the motion of least noise: its angle and a measured speed weighed by frequency.

Noise of an angle grows with the frequency when it is differentiated, that of a measured speed does not: where the two
cross, the better one changes. Weighed by their powers (Wiener), the angle's own rate passes a filter
1 / (1 + (f / f_x)^2) and the speed the rest of it, so that both together are never noisier than either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from edge_daemon.balance.sensor_noise import LEAST_OF_A_SPEED, LEAST_RESTS, SPEEDS, power_by_speed
from edge_daemon.motion.kinematics import FirSet, UniformColumns, filters
from edge_daemon.records import Array, Motion

SPEED = "velocity_out_rad_s"
TRANSFORM = 4096
"""Samples over which noise through a filter is laid out."""
RATE_SHARE = 0.4
"""Cut-off of the angle's own rate over the sampling rate."""
ROUNDED = 1e-9
"""Two samples over the range of all that interpolation at even instants leaves apart, and nothing else."""


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """What is not known of a motion, by the sensors that tell it."""

    rate_hz: float
    angle_rad: float
    """sd of a sample of the angle"""
    speed_rad_s: float
    """the same of a measured speed; infinite where none is measured"""

    @property
    def crossing_hz(self) -> float:
        """Up to this frequency the angle tells the speed better than the measured speed does."""
        return self.speed_rad_s / (2 * math.pi * self.angle_rad) if self.angle_rad else math.inf

    def speed_power(self, frequency_hz: Array) -> Array:
        """(n,) power of the speed's noise by frequency, as white noise of that power per sample would have it."""
        by_angle = (2 * math.pi * frequency_hz * self.angle_rad) ** 2
        if not math.isfinite(self.speed_rad_s):
            return by_angle
        return by_angle / (1 + by_angle / max(self.speed_rad_s, 1e-300) ** 2)

    def acceleration_power(self, frequency_hz: Array) -> Array:
        """(n,) the same of the acceleration."""
        return (2 * math.pi * frequency_hz) ** 2 * self.speed_power(frequency_hz)

    def speed_sd(self, fir: FirSet) -> float:
        """sd of the speed behind a filter."""
        frequency = np.asarray(np.fft.rfftfreq(TRANSFORM, 1 / fir.rate_hz), dtype=float)
        gain = np.abs(np.fft.rfft(fir.value, TRANSFORM)) ** 2
        return math.sqrt(float(np.mean(gain * self.speed_power(frequency))))

    def cutoff_hz(self, sure_rad_s: float, least_hz: float, most_hz: float) -> float:
        """Highest cut-off behind which the sd of the speed stays below a value."""
        frequency = np.linspace(0.0, most_hz, TRANSFORM)
        power = np.cumsum(self.speed_power(frequency)) * 2 * (frequency[1] / self.rate_hz)
        return max(least_hz, float(frequency[np.searchsorted(power, sure_rad_s**2, side="right") - 1]))

    def drawn_acceleration(self, fir: FirSet, unit: Array) -> Array:
        """(n,) noise of the acceleration behind a filter, of white noise (n,) of one unit."""
        spectrum = fft.rfft(unit)
        power = self.acceleration_power(fft.rfftfreq(len(unit), 1 / self.rate_hz))
        return fir.apply(fir.value, np.asarray(fft.irfft(spectrum * np.sqrt(power), len(unit))))


def share_by_speed(angle_rad: Array, motion: Motion, fir: FirSet) -> Array:
    """(n,) sd of an angle's noise at each sample over its sd in all, at most 1: a stamp that errs moves a fast joint
    far, and a slow one hardly. `angle_rad` (n,) at even instants, which `fir` made the motion of."""
    square = motion.velocity_out_rad_s**2
    left = (angle_rad - motion.theta_out_rad) ** 2
    seen = np.flatnonzero(np.isfinite(left) & np.isfinite(square))
    if len(seen) < SPEEDS * LEAST_OF_A_SPEED:
        return np.ones(len(motion))
    groups = np.array_split(seen[np.argsort(square[seen])], SPEEDS)
    rests = np.abs(np.diff(angle_rad, prepend=math.nan)) < ROUNDED * float(np.ptp(angle_rad[seen]))
    if np.mean(rests[groups[0]]) > LEAST_RESTS:  # a coarse step is no small noise
        return np.ones(len(motion))
    power = np.array([np.median(left[rows]) for rows in groups])
    resting, growing = power_by_speed(power, np.array([np.median(square[rows]) for rows in groups]))
    near = np.convolve(np.nan_to_num(square), np.full(2 * fir.delay + 1, 1.0 / (2 * fir.delay + 1)), mode="same")
    usual = resting + growing * float(np.mean(square[seen]))
    if not usual > 0:
        return np.ones(len(motion))
    return np.asarray(np.sqrt(np.minimum(1.0, (resting + growing * near) / usual)))


def measured_speed(even: UniformColumns) -> Array | None:
    """(n,) the speed from a channel of its own, if that is whole."""
    column = even.columns.get(SPEED)
    return column if column is not None and np.isfinite(column).all() else None


def with_measured_speed(motion: Motion, even: UniformColumns, fir: FirSet, noise: MotionNoise) -> Motion:
    """The motion with speed and acceleration from the angle up to where a measured speed tells more, and from that
    above; as it is where none is measured."""
    speed = measured_speed(even)
    if speed is None:
        return motion
    wide = filters(motion.rate_hz, RATE_SHARE * motion.rate_hz)
    own = wide.apply(wide.first, even.columns["theta_out_rad"])
    both = speed + _below(own - speed, noise.crossing_hz, motion.rate_hz)
    return replace(
        motion,
        velocity_out_rad_s=fir.apply(fir.value, both),
        acceleration_out_rad_s2=fir.apply(fir.first, both),
    )


def _below(signal: Array, corner_hz: float, rate_hz: float) -> Array:
    """(n,) what passes a filter 1 / (1 + (f / corner)^2) without delay; the signal goes on mirrored beyond its ends."""
    if not math.isfinite(corner_hz):
        return signal
    whole = np.concatenate((signal, signal[::-1]))
    gain = 1 / (1 + (fft.rfftfreq(len(whole), 1 / rate_hz) / max(corner_hz, 1e-300)) ** 2)
    return np.asarray(fft.irfft(fft.rfft(whole) * gain, len(whole)))[: len(signal)]
