"""A sound from a file: WAV or FLAC, a waveform as CSV (time_s, sound), a spectrum (frequency_hz, psd, averages)."""

from __future__ import annotations

import csv
import io
import math
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.records import Array
from edge_daemon.sound.noise_model import NoiseError, NoiseFit, fit_noise
from edge_daemon.sound.recorded_sound import STRETCH, SUFFIXES, RecordedSound, open_sound
from edge_daemon.sound.spectrum import MIN_SEGMENT, Spectrum, averaged

REFERENCE_HZ = 300.0
"""In the geometric middle of the band the terms are least alike."""
LOW_HZ, HIGH_HZ = 10.0, 10_000.0
"""The noise model holds in this band."""
NYQUIST_SHARE = 0.45
"""Above this share of the sampling rate a recorder's own filter shapes the spectrum."""
BINS_BELOW_BAND = 8.0
"""A file is long enough to resolve the band's lower end well with so many bins below it."""
SEGMENTS = 6
"""... unless it is shorter than so many segments: fewer waste its ends, for the window fades there"""
SHORTEST_S = 2 / LOW_HZ
OFF_GRID = 0.5
"""A time this far from its place, in sampling intervals, belongs to another place: the waveform is not even."""
LARGEST_SOUND = 1e100
"""A sample is at most this, whatever its unit: its square must be a number."""
LARGEST_PSD = 1e60
"""A density of power is below this and above its reciprocal, whatever its unit: beyond, squares are no numbers."""
FASTEST_STEP_S = 1e-12
"""No sound is sampled faster: a smaller step is a wrong column."""
MOST_MISSING = 10
"""So many times the rows that are there may be missing between them."""
WHOLE_SHARE = 0.5
"""Segments with a lost or clipped sample are left out as long as this share of them is whole."""
FULL_SCALE = 1.0
WAVEFORM = ("time_s", "sound")
SPECTRUM = ("frequency_hz", "psd", "averages")
WAV_UNIT, CSV_UNIT = "FS^2/Hz", "unit^2/Hz"


class SoundError(BadInput):
    """One line: file, field, what is wrong, what was expected."""


class FittedSound(NamedTuple):
    """What a file gave."""

    fit: NoiseFit
    unit: str
    """of its coefficients"""
    notes: tuple[str, ...]
    """what was wrong with the sound and what was done about it"""


@dataclass(slots=True)
class _Waveform:
    """A sound that can be gone through as often as needed."""

    rate_hz: float
    size: int
    parts: Iterable[Array]
    step: float = 0.0
    """of its counts; 0 where unknown"""
    limit: float = math.inf
    """a sample this large was clipped"""


class _FileParts:
    """A sound file as a waveform's parts."""

    def __init__(self, wav: RecordedSound) -> None:
        self._wav = wav

    def __iter__(self) -> Iterator[Array]:
        return self._wav.stretches(STRETCH)


def fit_sound_file(path: str | Path) -> FittedSound:
    """The noise model of a file. Raises `BadInput`."""
    path = Path(path)
    spectrum, unit, rounding, notes = _spectrum(path)
    try:
        fit = fit_noise(spectrum, REFERENCE_HZ)
    except (NoiseError, np.linalg.LinAlgError) as error:
        raise SoundError(f"{path}: cannot be fitted: {error}") from error
    # the rounding of counts is white noise of known density, and none of the sound's own
    fit = replace(fit, value=fit.value - np.array([rounding, 0, 0, 0, 0]))
    return FittedSound(fit, unit, notes)


def _spectrum(path: Path) -> tuple[Spectrum, str, float, tuple[str, ...]]:
    """The averaged spectrum of any of the three kinds of file, its unit, what rounding adds to it, and notes."""
    if path.suffix.lower() in SUFFIXES:
        wav = open_sound(path)
        # the largest positive count lies one step below full scale
        limit = math.inf if wav.floating else FULL_SCALE - wav.step
        waveform = _Waveform(wav.rate_hz, wav.frames, _FileParts(wav), wav.step, limit)
        spectrum, notes = _averaged(path, waveform)
        if wav.channels > 1:
            notes = (f"{wav.channels} channels: the first is used", *notes)
        if wav.frames < wav.promised:
            notes = (f"cut off: {wav.frames} of {wav.promised} samples are there", *notes)
        return spectrum, WAV_UNIT, wav.step**2 / 12 * 2 / wav.rate_hz, notes
    table = _read_csv(path)
    if set(SPECTRUM) <= set(table):
        return _given(path, table), CSV_UNIT, 0.0, ()
    if set(WAVEFORM) <= set(table):
        value, rate_hz = _evenly(path, table["time_s"], table["sound"])
        spectrum, notes = _averaged(path, _Waveform(rate_hz, len(value), [value]))
        return spectrum, CSV_UNIT, 0.0, notes
    expected = f"{','.join(WAVEFORM)} or {','.join(SPECTRUM)}"
    raise SoundError(f"{path}: header: {','.join(table)}: expected {expected}")


def _read_csv(path: Path) -> dict[str, Array]:
    """Columns by name; an empty field is NaN. Cells stand between commas, tabs, or semicolons (decimal commas then)."""
    try:
        head, _, body = path.read_text(encoding="utf-8-sig").partition("\n")
    except OSError as error:
        raise SoundError(f"{path}: cannot read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SoundError(f"{path}: not a CSV text file: {error}") from error
    between = next((mark for mark in ";\t" if mark in head), ",")
    if between != ",":
        body = body.replace(",", ".")
    names = [name.strip() for name in head.split(between)]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of a file without rows
            whole = np.loadtxt(io.StringIO(body), delimiter=between, ndmin=2, comments=None)
        if whole.shape[1] == len(names) and len(whole):
            return dict(zip(names, whole.T, strict=True))
    except (ValueError, UserWarning):
        pass  # read it again line by line, to say what and where, or to take an empty field
    return _line_by_line(path, head + "\n" + body, between)


def _line_by_line(path: Path, text: str, between: str) -> dict[str, Array]:
    """Columns by name. Raises `SoundError` with the line that is wrong."""
    try:
        rows = list(csv.reader(io.StringIO(text), delimiter=between))
    except csv.Error as error:
        raise SoundError(f"{path}: not a CSV text file: {error}") from error
    if not rows or not any(rows[0]):
        raise SoundError(f"{path}: empty: expected a header and rows")
    header = [name.strip() for name in rows[0]]
    body = [(i, row) for i, row in enumerate(rows[1:], start=2) if row]
    for line, row in body:
        if len(row) != len(header):
            raise SoundError(f"{path}: line {line}: {len(row)} fields: expected {len(header)}")
    return {name: _column(path, name, j, body) for j, name in enumerate(header)}


def _column(path: Path, name: str, j: int, body: list[tuple[int, list[str]]]) -> Array:
    try:
        return np.array([float(row[j]) if row[j].strip() else np.nan for _, row in body])
    except ValueError:
        line, text = next((line, row[j]) for line, row in body if not _is_number(row[j]))
        raise SoundError(f"{path}: line {line}, {name}: {text!r}: expected a number") from None


def _is_number(text: str) -> bool:
    try:
        float(text or "nan")
    except ValueError:
        return not text.strip()
    return True


def _evenly(path: Path, time_s: Array, value: Array) -> tuple[Array, float]:
    """(n,) samples on an even grid, NaN where one is missing, and the rate [Hz]. Raises `SoundError`.

    Times may be rounded, as long as they tell which sample they belong to.
    """
    known = np.flatnonzero(np.isfinite(time_s))
    steps = np.diff(time_s[known])
    step = float(np.median(steps)) if len(steps) else np.nan
    if not FASTEST_STEP_S < step < np.inf or not float(np.max(steps)) < MOST_MISSING * len(value) * step:
        raise SoundError(f"{path}: time_s: does not grow evenly: expected one sampling interval")
    line = np.polynomial.polynomial.polyfit(known, time_s[known], 1) if len(known) > 2 else (time_s[known[0]], step)
    if np.all(np.abs(time_s[known] - line[0] - line[1] * known) < OFF_GRID * step):
        return value, 1 / float(line[1])  # one row a sample: the common case, whatever the rounding of its times
    alike = steps[np.abs(steps - step) < OFF_GRID * step]
    step = float(alike.mean()) if len(alike) else step  # the middle of an even number of steps may be like none
    place = np.concatenate(([0.0], np.cumsum(np.rint(steps / step))))
    step = float(time_s[known[-1]] - time_s[known[0]]) / max(float(place[-1]), 1.0)
    off = np.abs(time_s[known] - time_s[known[0]] - place * step) > OFF_GRID * step
    off |= np.diff(place, prepend=-1) < 1
    if np.any(off) or place[-1] > MOST_MISSING * len(value):
        row = int(known[np.argmax(off)]) + 2
        raise SoundError(f"{path}: line {row}, time_s: uneven: expected {step:g} s between samples")
    even = np.full(int(place[-1]) + 1, np.nan)
    even[place.astype(np.intp)] = value[known]
    return even, 1 / step


def _averaged(path: Path, sound: _Waveform) -> tuple[Spectrum, tuple[str, ...]]:
    """The average over the whole sound, and what had to be done for it."""
    if sound.size < max(MIN_SEGMENT, SHORTEST_S * sound.rate_hz):
        said = f"{sound.size} samples at {sound.rate_hz:g} Hz"
        raise SoundError(f"{path}: {said}: too short: expected {SHORTEST_S:g} s at least, better minutes")
    most = 2.0 ** math.ceil(math.log2(BINS_BELOW_BAND * sound.rate_hz / LOW_HZ))
    length = int(min(most, 2.0 ** math.floor(math.log2(max(sound.size / SEGMENTS, MIN_SEGMENT)))))
    high_hz = min(HIGH_HZ, NYQUIST_SHARE * sound.rate_hz)
    lost, clipped, low, high = _flaws(sound)
    if lost == sound.size:
        raise SoundError(f"{path}: {sound.size} samples, none of them a number: expected a sound")
    if max(abs(low), abs(high)) > LARGEST_SOUND:
        raise SoundError(f"{path}: samples from {low:g} to {high:g}: expected at most {LARGEST_SOUND:g}")
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        raise SoundError(f"{path}: all samples are {low:g}: expected a sound")
    spectrum, whole = averaged(_without_flaws(sound), sound.rate_hz, length, LOW_HZ, high_hz)
    notes: tuple[str, ...] = ()
    if whole < WHOLE_SHARE * (sound.size / (length // 2) - 1):
        # too few segments without a flaw: take them all, flaws mended
        spectrum, _ = averaged(_mended(sound), sound.rate_hz, length, LOW_HZ, high_hz)
        if lost:
            notes += (f"{lost} of {sound.size} samples missing: bridged by straight lines, which lowers a_0 as much",)
        if clipped:
            notes += (
                f"{clipped} of {sound.size} samples clipped: their distortion is part of the noise; record softer",
            )
    elif lost or clipped:
        notes += (f"{lost} samples missing, {clipped} clipped: segments with them left out",)
    if spectrum is None:
        raise SoundError(f"{path}: {sound.size} samples: too short: expected a second or more")
    return spectrum, notes


def _flaws(sound: _Waveform) -> tuple[int, int, float, float]:
    """Samples that are no number, clipped samples, the smallest and the largest sample."""
    lost = clipped = 0
    low, high = math.inf, -math.inf
    for part in sound.parts:
        good = part[np.isfinite(part)]
        lost += len(part) - len(good)
        if len(good):
            clipped += int(np.count_nonzero((good >= sound.limit) | (good <= -FULL_SCALE))) if sound.step else 0
            low, high = min(low, float(good.min())), max(high, float(good.max()))
    return lost, clipped, low, high


def _without_flaws(sound: _Waveform) -> Iterator[Array]:
    """The parts, clipped samples as NaN."""
    for part in sound.parts:
        yield np.where((part >= sound.limit) | (part <= -FULL_SCALE), np.nan, part) if sound.step else part


def _mended(sound: _Waveform) -> Iterator[Array]:
    """The parts, straight lines over what is no number."""
    for part in sound.parts:
        bad = ~np.isfinite(part)
        if bad.any() and not bad.all():
            index = np.arange(len(part))
            yield np.interp(index, index[~bad], part[~bad])
        else:
            yield part


def _given(path: Path, table: dict[str, Array]) -> Spectrum:
    frequency, psd, averages = (table[name] for name in SPECTRUM)
    inside = (frequency >= LOW_HZ) & (frequency <= HIGH_HZ) & (psd > 1.0 / LARGEST_PSD) & (psd < LARGEST_PSD)
    inside &= (averages > 0) & (averages < LARGEST_PSD)
    if not inside.any():
        raise SoundError(
            f"{path}: no row of {LOW_HZ:g}-{HIGH_HZ:g} Hz with a positive psd and positive averages: expected some"
        )
    order = np.argsort(frequency[inside], kind="stable")
    return Spectrum(frequency[inside][order], psd[inside][order], averages[inside][order])
