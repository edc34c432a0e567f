"""What the motor does: prescribed angle, speed and acceleration of the wave generator at any instant.

All motions are closed formulas, so their derivatives carry no differentiation noise and a live rig may ask for any
stretch of time, in any order, for ever.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge_daemon.records import Array

MAX_MOTOR_RAD_S = 3000 * math.pi / 30
"""3000 rpm, the motor speed of the articles' table"""
SPEED_MARGIN = 0.97
"""The peak found on a grid may lie slightly below the true one."""


class MotorCourse(NamedTuple):
    """Angle [rad], speed [rad/s] and acceleration [rad/s^2], each (n,)."""

    angle: Array
    speed: Array
    acceleration: Array


MotionTone = Callable[[Array], MotorCourse]
"""From time_s (n,) to the motor's course."""


@dataclass(frozen=True, slots=True)
class MotorMotion:
    """A sum of terms, scaled to a peak speed; `course(time_s)` is the motor's."""

    name: str
    terms: tuple[MotionTone, ...]
    gain: float = 1.0
    offset_rad: float = 0.0

    def course(self, time_s: Array) -> MotorCourse:
        """The motor's angle, speed and acceleration at `time_s` (n,) [s]."""
        parts = [term(time_s) for term in self.terms]
        angle, speed, acceleration = (self.gain * np.sum([part[i] for part in parts], axis=0) for i in range(3))
        return MotorCourse(angle + self.offset_rad, speed, acceleration)

    def scaled(self, peak_rad_s: float, seconds: float) -> MotorMotion:
        """The same shape with its fastest instant within `seconds` at `peak_rad_s` [rad/s]."""
        grid = np.arange(0.0, max(seconds, 1.0), 1e-3)
        fastest = float(np.abs(self.course(grid).speed).max())
        return MotorMotion(self.name, self.terms, self.gain * peak_rad_s / fastest, self.offset_rad)


def tone(frequency_hz: float, speed_rad_s: float, phase_rad: float) -> MotionTone:
    """A sine in angle whose speed has the amplitude `speed_rad_s`."""
    omega = 2 * math.pi * frequency_hz

    def term(time_s: Array) -> MotorCourse:
        sine, cosine = np.sin(omega * time_s + phase_rad), np.cos(omega * time_s + phase_rad)
        return MotorCourse(speed_rad_s / omega * sine, speed_rad_s * cosine, -speed_rad_s * omega * sine)

    return term


def sweep(low_hz: float, high_hz: float, seconds: float, speed_rad_s: float) -> MotionTone:
    """A sine of constant angle amplitude whose frequency grows linearly; `speed_rad_s` is its peak, at the end."""
    rate = 2 * math.pi * (high_hz - low_hz) / seconds
    amplitude = speed_rad_s / (2 * math.pi * high_hz)

    def term(time_s: Array) -> MotorCourse:
        omega = 2 * math.pi * low_hz + rate * time_s
        phase = 2 * math.pi * low_hz * time_s + 0.5 * rate * time_s**2
        sine, cosine = np.sin(phase), np.cos(phase)
        return MotorCourse(
            amplitude * sine, amplitude * omega * cosine, amplitude * (rate * cosine - omega * omega * sine)
        )

    return term


def faded(term: MotionTone, small: float, at_s: float) -> MotionTone:
    """`term` at full size before `at_s`, at `small` of it from a second later on, with a smooth way between."""

    def shaped(time_s: Array) -> MotorCourse:
        x = np.clip(time_s - at_s, 0.0, 1.0)
        depth = small - 1.0
        gain = 1.0 + depth * x * x * x * (10 - 15 * x + 6 * x * x)
        gain1 = depth * 30 * x * x * (1 - x) * (1 - x)
        gain2 = depth * 60 * x * (1 - x) * (1 - 2 * x)
        angle, speed, acceleration = term(time_s)
        return MotorCourse(
            gain * angle,
            gain1 * angle + gain * speed,
            gain2 * angle + 2 * gain1 * speed + gain * acceleration,
        )

    return shaped


RICH_TONES_HZ = (0.31, 1.27, 3.7, 7.9, 13.1, 21.3)
"""No two are in a whole-number ratio; torque grows with frequency, so the upper ones load the gear."""
WIDE_TONES_HZ = (0.06, 0.31, 1.1, 3.3, 7.1)
LIVE_TONES_HZ = (0.23, 1.13, 4.7, 9.7, 19.3)
LIVE_WEIGHTS = (0.10, 0.12, 0.16, 0.24, 0.38)
"""These shares of the speed limit sum to 1."""
RICH_SMALL = 0.4
"""The second amplitude of the rich motion is this share of the first."""


def _tones(
    frequencies_hz: Sequence[float], speeds_rad_s: Sequence[float], rng: np.random.Generator
) -> list[MotionTone]:
    jitter = rng.uniform(0.96, 1.04, len(frequencies_hz))
    phases = rng.uniform(0, 2 * math.pi, len(frequencies_hz))
    return [tone(f * j, v, p) for f, j, v, p in zip(frequencies_hz, jitter, speeds_rad_s, phases, strict=True)]


def rich(seconds: float, rng: np.random.Generator) -> MotorMotion:
    """Six tones, full size then small, and a slow sweep: excites everything that the catalogue holds."""
    weights = rng.uniform(0.8, 1.2, len(RICH_TONES_HZ)).tolist()
    tones = MotorMotion("tones", tuple(_tones(RICH_TONES_HZ, weights, rng)))
    terms = [faded(tones.course, RICH_SMALL, 0.6 * seconds), sweep(0.05, 2.0, seconds, 0.7)]
    return _placed("rich", terms, seconds, rng)


def wide(seconds: float, rng: np.random.Generator) -> MotorMotion:
    """Five slower tones over more than an output turn: for the drive balance, where friction and gravity rule."""
    weights = rng.uniform(0.8, 1.2, len(WIDE_TONES_HZ)).tolist()
    return _placed("wide", _tones(WIDE_TONES_HZ, weights, rng), seconds, rng)


def poor(seconds: float, rng: np.random.Generator) -> MotorMotion:
    """One sine between 2 and 8 Hz."""
    return _placed("poor", [tone(rng.uniform(2.0, 8.0), 1.0, rng.uniform(0, 2 * math.pi))], seconds, rng)


def slow(seconds: float, rng: np.random.Generator) -> MotorMotion:
    """Slow reversals: one sine at about 0.3 Hz, almost no inertia torque."""
    return _placed("slow", [tone(rng.uniform(0.25, 0.35), 1.0, rng.uniform(0, 2 * math.pi))], seconds, rng)


def live(rng: np.random.Generator) -> MotorMotion:
    """Endless multi-tone up to 20 Hz, most of it fast, for a good torque; the sum never exceeds the speed limit."""
    speeds = [weight * MAX_MOTOR_RAD_S * SPEED_MARGIN for weight in LIVE_WEIGHTS]
    terms = _tones(LIVE_TONES_HZ, speeds, rng)
    return MotorMotion("live", tuple(terms), 1.0, rng.uniform(-20.0, 20.0))


def custom(frequencies_hz: Sequence[float], speeds_rad_s: Sequence[float]) -> MotorMotion:
    """Tones of given motor speed amplitudes [rad/s], unscaled: an experiment that a planner asked for."""
    return MotorMotion("custom", tuple(tone(f, v, 0.0) for f, v in zip(frequencies_hz, speeds_rad_s, strict=True)))


def _placed(name: str, terms: list[MotionTone], seconds: float, rng: np.random.Generator) -> MotorMotion:
    """Scaled to the speed limit and started at a random angle."""
    start = MotorMotion(name, tuple(terms), 1.0, rng.uniform(-20.0, 20.0))
    return start.scaled(MAX_MOTOR_RAD_S * SPEED_MARGIN, seconds)


MOTIONS: dict[str, Callable[[float, np.random.Generator], MotorMotion]] = {
    "rich": rich,
    "wide": wide,
    "poor": poor,
    "slow": slow,
}
