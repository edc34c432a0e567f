"""Test motions of the motor as arrays: smooth start, smooth stop, and a mark for each part.

All are closed formulas, so speed and acceleration are exact derivatives of the position. Marks: 0 before and after,
then counted from 1; `PlannedMotion.parts` names them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.config.settings import Profile
from edge_daemon.errors import BadInput
from edge_daemon.records import Array


class ProfileError(BadInput):
    """One line: which profile, which key, what was expected."""


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """What the motor shall do, from zero. Arrays (n,), one row per cycle."""

    time_s: Array
    position_rad: Array
    velocity_rad_s: Array
    acceleration_rad_s2: Array
    phase: NDArray[np.int16]
    parts: tuple[str, ...]
    """name of each mark; index 0 is rest"""

    def __len__(self) -> int:
        return len(self.time_s)


def planned_motion(profile: Profile, cycle_s: float) -> PlannedMotion:
    """The motion of a profile, one row per cycle. Raises `ProfileError`."""
    if profile.kind in ("steps", "slow_reversal"):
        return _moves(profile, cycle_s)
    nyquist_hz = fastest_tone_hz(cycle_s)
    wanted = {"sine": (1, 1), "multi_tone": (2, 64), "chirp": (2, 2)}[profile.kind]
    if not wanted[0] <= len(profile.frequency_hz) <= wanted[1]:
        few = f"{wanted[0]}" if wanted[0] == wanted[1] else f"{wanted[0]} to {wanted[1]}"
        raise ProfileError(f"profile {profile.name!r}: frequency_hz: expected {few} for a {profile.kind}")
    if max(profile.frequency_hz) > nyquist_hz:
        raise ProfileError(f"profile {profile.name!r}: frequency_hz: expected at most {nyquist_hz:g} at this cycle_s")
    if profile.share and len(profile.share) != len(profile.frequency_hz):
        raise ProfileError(f"profile {profile.name!r}: share: expected one for each frequency_hz")
    time_s = _grid(0, math.ceil((profile.seconds + 2 * profile.fade_s) / cycle_s), cycle_s)
    tones = _chirp(profile, time_s) if profile.kind == "chirp" else _tones(profile, time_s)
    shape = _fade(profile, time_s)
    angle, speed, acceleration = _product(shape, tones)
    # fading adds speed of its own: scale so that the fastest instant is the one asked for
    gain = profile.speed_rad_s / float(np.abs(speed).max())
    phase = np.where(time_s < profile.fade_s, 1, np.where(time_s <= profile.fade_s + profile.seconds, 2, 3))
    phase[[0, -1]] = 0
    parts = ("rest", "fade_in", "steady", "fade_out")
    return PlannedMotion(time_s, gain * angle, gain * speed, gain * acceleration, phase.astype(np.int16), parts)


def fastest_tone_hz(cycle_s: float) -> float:
    """Ten targets a period: the drive draws straight lines between them."""
    return 0.1 / cycle_s


def _grid(first: int, last: int, cycle_s: float) -> Array:
    return np.arange(first, last + 1, dtype=np.float64) * cycle_s


Three = tuple[Array, Array, Array]
"""A function of time and its first two derivatives."""


def _product(a: Three, b: Three) -> Three:
    return a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2 * a[1] * b[1] + a[0] * b[2]


def _fade(profile: Profile, time_s: Array) -> Three:
    """0 to 1 to 0 without a jump in acceleration: x^4 (35 - 84 x + 70 x^2 - 20 x^3) at either end."""
    end_s = profile.seconds + 2 * profile.fade_s
    x = np.clip(np.minimum(time_s, end_s - time_s) / profile.fade_s, 0.0, 1.0)
    side = np.where(time_s < end_s / 2, 1.0, -1.0) / profile.fade_s
    value = x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)
    first = 140 * x**3 * (1 - x) ** 3
    second = 420 * x**2 * (1 - x) ** 2 * (1 - 2 * x)
    return value, first * side, second / profile.fade_s**2


def _tones(profile: Profile, time_s: Array) -> Three:
    """Tones of equal speed, or of their shares; phases after Schroeder 1970 keep the sum's peak low."""
    count = len(profile.frequency_hz)
    total = [np.zeros(len(time_s)) for _ in range(3)]
    for i, (frequency_hz, share) in enumerate(zip(profile.frequency_hz, profile.share or [1.0] * count, strict=True)):
        omega, phase = 2 * math.pi * frequency_hz, -math.pi * i * (i - 1) / count
        sine, cosine = np.sin(omega * time_s + phase), np.cos(omega * time_s + phase)
        for part, term in zip(total, (sine / omega, cosine, -omega * sine), strict=True):
            part += share * term
    return total[0], total[1], total[2]


def _chirp(profile: Profile, time_s: Array) -> Three:
    """Logarithmic sweep of constant speed amplitude: angle = sin(phase) / omega."""
    low, high = profile.frequency_hz
    length_s = profile.seconds + 2 * profile.fade_s
    rate = math.log(high / low) / length_s
    omega = 2 * math.pi * low * np.exp(rate * time_s)
    phase = 2 * math.pi * low * time_s if rate == 0 else (omega - 2 * math.pi * low) / rate
    sine, cosine = np.sin(phase), np.cos(phase)
    envelope = (1 / omega, -rate / omega, rate**2 / omega)
    wave = (sine, omega * cosine, rate * omega * cosine - omega**2 * sine)
    return _product(envelope, wave)


def _moves(profile: Profile, cycle_s: float) -> PlannedMotion:
    """Straight moves between rests: a staircase up and down, or slow reversals."""
    if profile.travel_rad is None:
        raise ProfileError(f"profile {profile.name!r}: travel_rad: missing: expected for {profile.kind}")
    if profile.kind == "steps":
        ways: Sequence[float] = [1.0] * profile.repeats + [-1.0] * (2 * profile.repeats) + [1.0] * profile.repeats
        rest_s, names = profile.dwell_s, ("step", "dwell")
    else:
        ways = [0.5] + [-1.0, 1.0] * (profile.repeats - 1) + [-1.0, 0.5]
        rest_s, names = 0.0, ("forward", "backward")
    pieces, marks, at_rad = [], [], 0.0
    for i, way in enumerate(ways):
        angle, speed, acceleration = _move(abs(way) * profile.travel_rad, profile, cycle_s)
        sign = math.copysign(1.0, way)
        rest = round(rest_s / cycle_s)
        pieces.append(
            [_held(at_rad + sign * angle, rest), _padded(sign * speed, rest), _padded(sign * acceleration, rest)]
        )
        mark = 2 * i + 1 if rest else (1 if way > 0 else 2)
        marks.append(np.concatenate((np.full(len(angle), mark), np.full(rest, 2 * i + 2))))
        at_rad += way * profile.travel_rad
    angle, speed, acceleration = (np.concatenate([piece[k] for piece in pieces]) for k in range(3))
    phase = np.concatenate(marks).astype(np.int16)
    phase[[0, -1]] = 0
    parts = ("rest", *(f"{name}_{i + 1}" for i in range(len(ways)) for name in names)) if rest_s else ("rest", *names)
    return PlannedMotion(_grid(0, len(angle) - 1, cycle_s), angle, speed, acceleration, phase, parts)


def _held(values: Array, rest: int) -> Array:
    return np.concatenate((values, np.full(rest, values[-1])))


def _padded(values: Array, rest: int) -> Array:
    return np.concatenate((values, np.zeros(rest)))


def _move(distance_rad: float, profile: Profile, cycle_s: float) -> Three:
    """From rest to rest: smooth ramp to the speed, cruise, smooth ramp down; slower where the way is too short."""
    ramp_s = profile.fade_s
    speed = min(profile.speed_rad_s, distance_rad / ramp_s)
    cruise_s = distance_rad / speed - ramp_s
    total_s = 2 * ramp_s + cruise_s
    count = math.ceil(total_s / cycle_s)
    time_s = _grid(1, count, cycle_s)
    rising = np.clip(time_s / ramp_s, 0, 1)
    falling = np.clip((time_s - ramp_s - cruise_s) / ramp_s, 0, 1)
    cruising = np.clip(time_s - ramp_s, 0, cruise_s)
    ramped = ramp_s * (_ramp_way(rising) + falling - _ramp_way(falling))
    velocity = speed * (_ramp(rising) - _ramp(falling))
    acceleration = speed / ramp_s * (_ramp_slope(rising) - _ramp_slope(falling))
    return speed * (ramped + cruising), velocity, acceleration


def _ramp(x: Array) -> Array:
    return x**3 * (10 - 15 * x + 6 * x**2)


def _ramp_slope(x: Array) -> Array:
    return 30 * x**2 * (1 - x) ** 2


def _ramp_way(x: Array) -> Array:
    return x**4 * (2.5 - 3 * x + x**2)
