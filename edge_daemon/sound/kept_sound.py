"""What a gear sounded like, kept for months: an average spectrum per hour and speed, and a burst at every alarm.

A spectrum is kept in steps of a twelfth of an octave and of half a decibel: enough to look for an order that nobody
thought of when it was heard. Days are slots of a ring, and so are bursts: what is kept never grows past them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import msgspec
import numpy as np

from edge_daemon.config.settings import Sound
from edge_daemon.records import Array, Bands, Burst
from edge_daemon.sound.spectrum import SpectrumAverage

HOUR_S, DAY_HOURS = 3600.0, 24
DAYS, BURSTS = 400, 16
"""A year and a month are kept at most, so that a season can be held against the same one before; and so many alarms
(guess)."""
DAY_BYTES = 12_000
"""A day of three speeds takes so much."""
STEPS_PER_OCTAVE = 12
"""Two lines a twelfth of an octave apart are told apart, as are the orders of a bearing's inner and outer ring."""
STEP_DB, LOWEST_DB = 0.5, -110.0
"""A byte holds levels of 1/Hz from here on in these steps, which is finer than the scatter of an hour's average."""
STANDS_RAD_S = 1.0
"""A motor slower than this stands; above it each octave of speed is a regime of its own (guess)."""
MOST_SAMPLES = 32_768
"""So much of a burst is kept: 64 kB, or four seconds at 8 kHz (guess)."""
TOLD_EVERY_S = 300.0
"""The day that goes on is written so often, so that a power cut costs a twelfth of an hour and a card is spared."""
MOST_VALUE = 32_000
"""The largest value of a kept burst in its own steps, within 16 bits."""
CURRENT = "heard"
"""Checkpoint of the day that goes on; those of past days and of bursts have a slot behind it."""


_Kind = TypeVar("_Kind")


class _Row(msgspec.Struct, array_like=True):
    """One hour at one regime of speed."""

    hour: int
    regime: int
    speed_rad_s: float
    averages: float
    low_hz: float
    levels: bytes


class _KeptBurst(msgspec.Struct, array_like=True):
    time_s: float
    rate_hz: float
    why: str
    scale: float
    values: bytes


@dataclass(frozen=True, slots=True)
class HourSpectrum:
    """An hour's average spectrum at one regime of speed."""

    time_s: float
    """middle of the hour"""
    speed_rad_s: float
    """mean of the wave generator's; NaN where it was not known"""
    averages: float
    frequency_hz: Array
    psd: Array
    """(n,) per hertz, as of the sensor; NaN where the band holds no bin"""


@dataclass(slots=True)
class _Regime:
    """What was heard at one regime of speed in the hour that goes on."""

    average: SpectrumAverage
    speeds: float = 0.0
    """sum of the magnitudes [rad/s]"""
    sounds: int = 0


class KeptSound:
    """`hear` every sound, `alarm` when one rises; `state` with every checkpoint."""

    def __init__(self, settings: Sound, most_bytes: float = math.inf) -> None:
        """Days take three quarters of `most_bytes`, bursts the rest; a day and a burst are kept in any case."""
        self._settings = settings
        self._days = int(max(min(0.75 * most_bytes / DAY_BYTES, DAYS), 1))
        self._slots = int(max(min(0.25 * most_bytes / (2 * MOST_SAMPLES), BURSTS), 1))
        self._hour = -1
        self._heard_s = self._told_s = -math.inf
        self._open: dict[int, _Regime] = {}
        self._rows: list[_Row] = []
        self._done: dict[str, bytes] = {}
        self._bursts = 0
        self._last: Burst | None = None

    def hear(self, sound: Burst | Bands, speed_in_rad_s: float) -> None:
        """Take a sound in, and the speed at which it was heard, NaN if not known."""
        if not math.isfinite(sound.time_s):
            return
        self._turn_to(int(sound.time_s // HOUR_S))
        self._heard_s = sound.time_s
        fresh = _Regime(SpectrumAverage(self._settings.low_hz, self._settings.high_hz, math.inf))
        now = self._open.setdefault(regime_of(speed_in_rad_s), fresh)
        if isinstance(sound, Burst):
            self._last = sound
            taken = now.average.add_waveform(sound.time_s, np.asarray(sound.value, dtype=float), sound.rate_hz)
        else:
            taken = now.average.add_bands(sound)
        now.sounds += taken
        now.speeds += abs(speed_in_rad_s) if taken else 0.0

    def alarm(self, why: str) -> None:
        """Keep the newest burst."""
        if self._last is None:
            return
        value = np.nan_to_num(np.asarray(self._last.value, dtype=float))[-MOST_SAMPLES:]
        scale = max(float(np.max(np.abs(value), initial=0.0)) / MOST_VALUE, 1e-300)
        begun_s = self._last.time_s + (len(self._last.value) - len(value)) / self._last.rate_hz
        kept = _KeptBurst(begun_s, self._last.rate_hz, why, scale, np.rint(value / scale).astype("<i2").tobytes())
        self._done[f"{CURRENT}/burst {self._bursts % self._slots}"] = msgspec.msgpack.encode(kept)
        self._bursts, self._last = self._bursts + 1, None

    def state(self) -> dict[str, bytes]:
        """Checkpoints by part: the day that goes on where it is due, and once each what has been completed."""
        done, self._done = self._done, {}
        if not done and abs(self._heard_s - self._told_s) < TOLD_EVERY_S:
            return {}
        self._told_s = self._heard_s
        return {CURRENT: msgspec.msgpack.encode((self._bursts, [*self._rows, *self._so_far()])), **done}

    def restore(self, blob: bytes) -> bool:
        """Take the day up again; False, and nothing changed, when it is broken. Its last hour begins anew beside."""
        try:
            self._bursts, self._rows = msgspec.msgpack.decode(blob, type=tuple[int, list[_Row]])
        except msgspec.MsgspecError:
            return False
        self._hour = self._rows[-1].hour if self._rows else -1
        return True

    def _turn_to(self, hour: int) -> None:
        if hour == self._hour:
            return
        self._rows += self._so_far()
        self._open = {}
        day, before = hour // DAY_HOURS, self._hour // DAY_HOURS
        if day != before and self._rows:
            self._done[f"{CURRENT}/{before % self._days}"] = msgspec.msgpack.encode((0, self._rows))
            self._rows = []
        self._hour = hour

    def _so_far(self) -> list[_Row]:
        """The hour that goes on, by regime."""
        rows = []
        low_hz, high_hz = self._settings.low_hz, self._settings.high_hz
        for regime, told in self._open.items():
            spectrum = told.average.spectrum
            if spectrum is not None and len(spectrum.frequency_hz):
                levels = _levels(spectrum.frequency_hz, spectrum.psd, low_hz, high_hz)
                speed, count = told.speeds / told.sounds, float(np.mean(spectrum.averages))
                rows.append(_Row(self._hour, regime, speed, count, low_hz, levels))
        return rows


def heard(blobs: Mapping[str, bytes]) -> list[HourSpectrum]:
    """The spectra in checkpoints of `KeptSound`, in order of time; what is broken is left out."""
    found = []
    for name, blob in blobs.items():
        if "burst" not in name:
            _, rows = _decoded(blob, tuple[int, list[_Row]]) or (0, [])
            found += [_heard(row) for row in rows]
    return sorted(found, key=lambda one: one.time_s)


def bursts(blobs: Mapping[str, bytes]) -> list[tuple[str, Burst]]:
    """Why each burst was kept, and the burst, in order of time."""
    kept = (_decoded(blob, _KeptBurst) for name, blob in blobs.items() if "burst" in name)
    found = [
        (one.why, Burst("", "", one.time_s, one.rate_hz, one.scale * np.frombuffer(one.values, dtype="<i2")))
        for one in kept
        if one is not None
    ]
    return sorted(found, key=lambda one: one[1].time_s)


def order_level(spectra: Sequence[HourSpectrum], order: float) -> Array:
    """(n,) decibels of an order per turn of the wave generator above the median of the octave around it; NaN where it
    cannot be told, as of a gear that stands."""
    return np.array([_order_level(one, order * one.speed_rad_s / (2.0 * math.pi)) for one in spectra])


def _order_level(one: HourSpectrum, line_hz: float) -> float:
    if not line_hz > 0.0:
        return math.nan
    octaves = np.abs(np.log2(one.frequency_hz / line_hz))
    near = (octaves < 0.5) & np.isfinite(one.psd)
    line = near & (octaves <= 0.75 / STEPS_PER_OCTAVE)
    if not line.any() or near.sum() <= 2 * line.sum():
        return math.nan
    return 10.0 * math.log10(float(np.max(one.psd[line])) / float(np.median(one.psd[near])))


def regime_of(speed_rad_s: float) -> int:
    """-1 for an unknown speed, 0 for standing, else the octave of the speed."""
    if not math.isfinite(speed_rad_s):
        return -1
    return max(1 + int(math.log2(max(abs(speed_rad_s), 1e-9) / STANDS_RAD_S)), 0)


def _levels(frequency_hz: Array, psd: Array, low_hz: float, high_hz: float) -> bytes:
    """A byte per step of frequency: 0 where no bin lies, else the mean's level."""
    steps = max(math.ceil(STEPS_PER_OCTAVE * math.log2(high_hz / low_hz)), 1)
    place = (STEPS_PER_OCTAVE * np.log2(frequency_hz / low_hz)).astype(int)
    inside = (place >= 0) & (place < steps)
    count = np.bincount(place[inside], minlength=steps)
    mean = np.bincount(place[inside], weights=psd[inside], minlength=steps) / np.maximum(count, 1)
    level = (10.0 * np.log10(np.maximum(mean, 1e-300)) - LOWEST_DB) / STEP_DB
    return np.where(count > 0, np.clip(np.rint(level), 1, 255), 0).astype(np.uint8).tobytes()


def _heard(row: _Row) -> HourSpectrum:
    level = np.frombuffer(row.levels, dtype=np.uint8)
    middle = row.low_hz * 2.0 ** ((np.arange(level.size) + 0.5) / STEPS_PER_OCTAVE)
    psd = np.where(level > 0, 10.0 ** ((LOWEST_DB + STEP_DB * level) / 10.0), np.nan)
    return HourSpectrum((row.hour + 0.5) * HOUR_S, row.speed_rad_s, row.averages, middle, psd)


def _decoded(blob: bytes, kind: type[_Kind]) -> _Kind | None:
    try:
        return msgspec.msgpack.decode(blob, type=kind)
    except msgspec.MsgspecError:
        return None
