"""A sound from a file: a WAV, a waveform as CSV (time_s, sound) or a spectrum as CSV (frequency_hz, psd, averages)."""

from __future__ import annotations

import csv
import wave
from pathlib import Path

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.estimate.noise import NoiseError, NoiseFit, fit_spectrum
from edge_daemon.estimate.spectrum import Spectrum, SpectrumAverage
from edge_daemon.records import Array

REFERENCE_HZ = 300.0
"""geometric middle of the band: the terms are then least alike"""
LOW_HZ, HIGH_HZ = 10.0, 10_000.0
"""the band of the noise model"""
NYQUIST_SHARE = 0.45
"""of the sampling rate: above it a recorder's own filter shapes the spectrum"""
FOREVER_S = 1e12
"""a file is averaged as a whole: nothing in it is forgotten"""
JITTER = 0.01
"""largest deviation of a waveform's sampling interval, share of it"""
WAVEFORM = ("time_s", "sound")
SPECTRUM = ("frequency_hz", "psd", "averages")
WAV_UNIT, CSV_UNIT = "FS^2/Hz", "unit^2/Hz"


class SoundError(BadInput):
    """One line: file, field, what is wrong, what was expected."""


def fit_sound_file(path: str | Path, reference_hz: float = REFERENCE_HZ) -> tuple[NoiseFit, str]:
    """The noise model of a file and the unit of its coefficients. Raises `SoundError`."""
    path = Path(path)
    spectrum, unit = read_spectrum(path)
    try:
        return fit_spectrum(spectrum, reference_hz), unit
    except (NoiseError, np.linalg.LinAlgError) as error:
        raise SoundError(f"{path}: cannot be fitted: {error}") from error


def read_spectrum(path: Path) -> tuple[Spectrum, str]:
    """The averaged spectrum of any of the three kinds of file, and its unit. Raises `SoundError`."""
    if path.suffix.lower() in (".wav", ".wave"):
        value, rate_hz = read_wav(path)
        return _averaged(path, value, rate_hz), WAV_UNIT
    table = _read_csv(path)
    if set(SPECTRUM) <= set(table):
        return _given(path, table), CSV_UNIT
    if set(WAVEFORM) <= set(table):
        return _averaged(path, table["sound"], _rate_hz(path, table["time_s"])), CSV_UNIT
    expected = f"{','.join(WAVEFORM)} or {','.join(SPECTRUM)}"
    raise SoundError(f"{path}: header: {','.join(table)}: expected {expected}")


def read_wav(path: Path) -> tuple[Array, float]:
    """(n,) first channel of a PCM file in parts of full scale, and the sampling rate [Hz]. Raises `SoundError`."""
    try:
        with wave.open(str(path), "rb") as file:
            channels, width, rate_hz = file.getnchannels(), file.getsampwidth(), float(file.getframerate())
            data = file.readframes(file.getnframes())
    except OSError as error:
        raise SoundError(f"{path}: cannot read: {error.strerror}") from error
    except (wave.Error, EOFError) as error:
        raise SoundError(f"{path}: not a PCM WAV file: {error or 'it ends early'}") from error
    frame = channels * width
    if rate_hz <= 0 or frame == 0 or width not in (1, 2, 3, 4):
        raise SoundError(f"{path}: header: {rate_hz:g} Hz, {8 * width} bits: expected 8, 16, 24 or 32 bits")
    raw = np.frombuffer(data[: len(data) // frame * frame], dtype=np.uint8).reshape(-1, channels, width)[:, 0]
    if width == 1:
        return (raw[:, 0].astype(float) - 128.0) / 128.0, rate_hz
    wide = np.zeros((len(raw), 4), dtype=np.uint8)
    wide[:, 4 - width :] = raw
    return wide.view("<i4")[:, 0] / 2.0**31, rate_hz


def _read_csv(path: Path) -> dict[str, Array]:
    """Columns by name; an empty field is NaN."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except OSError as error:
        raise SoundError(f"{path}: cannot read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise SoundError(f"{path}: not a CSV text file: {error}") from error
    if not rows:
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


def _rate_hz(path: Path, time_s: Array) -> float:
    steps = np.diff(time_s)
    step = float(np.median(steps)) if len(steps) else np.nan
    if not step > 0:
        raise SoundError(f"{path}: time_s: does not grow: expected an even sampling interval")
    uneven = np.abs(steps - step) > JITTER * step
    if np.any(uneven | ~np.isfinite(steps)):
        line = int(np.argmax(uneven | ~np.isfinite(steps))) + 3
        raise SoundError(f"{path}: line {line}, time_s: uneven: expected {step:g} s between samples")
    return (len(time_s) - 1) / float(time_s[-1] - time_s[0])


def _averaged(path: Path, value: Array, rate_hz: float) -> Spectrum:
    average = SpectrumAverage(LOW_HZ, min(HIGH_HZ, NYQUIST_SHARE * rate_hz), FOREVER_S)
    spectrum = average.spectrum if average.add_waveform(0.0, value, rate_hz) else None
    if spectrum is None:
        raise SoundError(f"{path}: {len(value)} samples: too short, or nothing finite: expected a second or more")
    return spectrum


def _given(path: Path, table: dict[str, Array]) -> Spectrum:
    frequency, psd, averages = (table[name] for name in SPECTRUM)
    inside = (frequency >= LOW_HZ) & (frequency <= HIGH_HZ) & np.isfinite(psd) & (psd > 0)
    order = np.argsort(frequency[inside], kind="stable")
    behind = float(np.nanmedian(averages[inside])) if inside.any() else np.nan
    if not behind > 0:
        raise SoundError(
            f"{path}: averages: {behind:g}: expected a positive number in rows of {LOW_HZ:g}-{HIGH_HZ:g} Hz"
        )
    return Spectrum(frequency[inside][order], psd[inside][order], behind)
