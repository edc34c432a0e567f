"""Power spectral density of a sound, averaged as it arrives (Welch 1967, Hann window, half overlap).

Older segments fade with a time constant, so that the number of averages behind each value stays known: it decides
how far a fit to the spectrum may be trusted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array, Bands

OVERLAP_CORRELATION = 1 / 36
"""Powers of neighbouring Hann segments at half overlap are correlated by this (Welch 1967, with the window's own lag
product)."""
BINS_BELOW_BAND = 2.0
"""The lowest frequency of interest lies at least this many bins above zero, clear of the window's main lobe."""
EDGE_BINS = 2.5
"""Bins this near an end of the band see what lies beyond it, of which nothing is known."""
LOWEST_BIN = 5.0
"""Below, the window blurs f^-4 by more than its curvature: the second moment of the window no longer tells how much."""
MIN_SEGMENT = 64
"""Shorter waveforms give no spectrum worth fitting."""
BLUR = np.array([1 / 6, 2 / 3, 1 / 6])
"""A Hann window makes this of a line, by bins: right up to the second moment, 1/3 of a squared bin."""


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided density: its integral over frequency is the mean square."""

    frequency_hz: Array
    psd: Array
    averages: float | Array
    """effective number of independent averages behind each value, or behind all"""
    bin_correlation: float = 1.0
    """variance of a sum over bins, against independent ones"""
    bin_hz: float = 0.0
    """width of the bins of a Hann window, which blurs what it sees; 0 where values stand for their frequency alone"""


def segment_length(samples: int, rate_hz: float, low_hz: float) -> int:
    """Samples per segment, a power of two: long enough to resolve `low_hz`, short enough to average; 0 if too few."""
    wanted = 2.0 ** math.ceil(math.log2(BINS_BELOW_BAND * rate_hz / low_hz) - 0.5)
    fits = 2 ** int(math.log2(samples)) if samples >= MIN_SEGMENT else 0
    return int(min(wanted, fits))


def sum_correlation(pieces: float) -> float:
    """Variance of a sum over bins against that of independent ones, for so many Hann segments at half overlap.

    Such a sum weighs the sound's square by the sum of the squared windows, v; its variance goes with the integral of
    v^2 over the square of that of v. Lies between 35/18 for one segment and 2 for many.
    """
    return (38 * pieces - 3) / (19 * pieces - 1)


def welch(value: Array, rate_hz: float, length: int) -> tuple[Array, Array, int]:
    """(m,) frequencies [Hz], (m,) sum of the periodograms [unit^2/Hz] and their number; segments with NaN are left out.

    Each segment loses its straight line: a drift slower than the segment would leak into the lowest bins.

    A sine of amplitude 2 has a mean square of 2, which the density integrates to:

    >>> time_s = np.arange(8000) / 8000.0
    >>> frequency_hz, total, count = welch(2.0 * np.sin(2 * np.pi * 500.0 * time_s), 8000.0, 1024)
    >>> round(float(np.sum(total / count) * frequency_hz[1]), 3), float(frequency_hz[np.argmax(total)])
    (2.0, 500.0)
    """
    hop = max(length // 2, 1)
    window = np.hanning(length + 1)[:-1]
    pieces = np.lib.stride_tricks.sliding_window_view(value, length)[::hop]
    pieces = pieces[np.isfinite(pieces).all(axis=1)]
    line = np.linspace(-1.0, 1.0, length)
    slope = pieces @ (line / (line @ line))
    level = pieces.mean(axis=1)
    centred = pieces - level[:, None]
    centred -= slope[:, None] * line
    centred *= window
    transform = np.fft.rfft(centred, axis=1)
    power = (transform.real**2 + transform.imag**2).sum(axis=0) * (2 / (rate_hz * (window @ window)))
    return np.asarray(np.fft.rfftfreq(length, 1 / rate_hz)), power, len(pieces)


def averaged(
    chunks: Iterable[Array], rate_hz: float, length: int, low_hz: float, high_hz: float
) -> tuple[Spectrum | None, int]:
    """The plain average over a whole sound that comes in chunks, and how many of its segments were whole.

    None where none was, or where nothing moves.
    """
    hop = max(length // 2, 1)
    left, total, whole = np.zeros(0), np.zeros(length // 2 + 1), 0
    for chunk in chunks:
        joined = np.concatenate((left, chunk))
        count = max(0, (len(joined) - length) // hop + 1)
        if count:
            _, power, pieces = welch(joined[: (count - 1) * hop + length], rate_hz, length)
            total, whole = total + power, whole + pieces
        left = joined[count * hop :]
    frequency: Array = np.fft.rfftfreq(length, 1 / rate_hz).astype(np.float64)
    if not whole:
        return None, 0
    averages = whole / (1 + 2 * OVERLAP_CORRELATION * (1 - 1 / whole))
    inside = _inside(frequency, low_hz, high_hz) & (total > 0)
    found = Spectrum(frequency[inside], total[inside] / whole, averages, sum_correlation(whole), float(frequency[1]))
    return found, whole


def _inside(frequency: Array, low_hz: float, high_hz: float) -> NDArray[np.bool_]:
    """Bins that see the band only."""
    edge = EDGE_BINS * frequency[1]
    lowest = max(low_hz + edge, LOWEST_BIN * frequency[1])
    inside: NDArray[np.bool_] = (frequency >= lowest) & (frequency <= high_hz - edge)
    return inside


class SpectrumAverage:
    """Exponentially forgotten average of periodograms or of band levels. A changed grid starts it anew."""

    def __init__(self, low_hz: float, high_hz: float, forget_s: float) -> None:
        self._low_hz, self._high_hz, self._forget_s = low_hz, high_hz, forget_s
        self._time_s = math.nan
        self._clear(np.zeros(0))

    def _clear(self, frequency_hz: Array) -> None:
        self._frequency_hz = frequency_hz
        self._sum = np.zeros(len(frequency_hz))
        self._weight = 0.0
        self._weight_squared = 0.0
        self._bin_correlation = 1.0
        self._bin_hz = 0.0

    def add_waveform(self, time_s: float, value: Array, rate_hz: float) -> bool:
        """Take in a burst; False when it is too short or holds nothing finite."""
        length = segment_length(len(value), rate_hz, self._low_hz)
        if length == 0:
            return False
        frequency, power, pieces = welch(value, rate_hz, length)
        if pieces == 0:
            return False
        self._add(time_s, frequency, power, float(pieces), pieces + 2 * (pieces - 1) * OVERLAP_CORRELATION)
        self._bin_correlation, self._bin_hz = sum_correlation(pieces), rate_hz / length
        return True

    def add_bands(self, bands: Bands) -> bool:
        """Take in a spectrum that the sensor computed; False when nothing in it is usable."""
        good = np.isfinite(bands.psd) & np.isfinite(bands.frequency_hz) & (bands.psd > 0)
        if not good.any() or not bands.averages > 0:
            return False
        psd = np.where(good, bands.psd, 0.0)
        self._add(bands.time_s, bands.frequency_hz, psd * bands.averages, bands.averages, bands.averages)
        return True

    def _add(self, time_s: float, frequency: Array, power: Array, weight: float, weight_squared: float) -> None:
        if len(frequency) != len(self._frequency_hz) or not np.array_equal(frequency, self._frequency_hz):
            self._clear(frequency)
        else:
            fade = math.exp(-max(time_s - self._time_s, 0.0) / self._forget_s)
            self._sum *= fade
            self._weight *= fade
            self._weight_squared *= fade**2
        self._time_s = time_s
        self._sum += power
        self._weight += weight
        self._weight_squared += weight_squared

    @property
    def spectrum(self) -> Spectrum | None:
        """The average within the band; None before the first burst."""
        if self._weight <= 0:
            return None
        frequency = self._frequency_hz
        if self._bin_hz:
            inside = _inside(frequency, self._low_hz, self._high_hz)
        else:
            inside = (frequency >= self._low_hz) & (frequency <= self._high_hz)
        inside &= self._sum > 0
        averages = self._weight**2 / self._weight_squared
        psd = self._sum[inside] / self._weight
        return Spectrum(frequency[inside], psd, averages, self._bin_correlation, self._bin_hz)
