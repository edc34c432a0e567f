"""Power spectral density of a sound, averaged as it arrives (Welch 1967, Hann window, half overlap).

Older segments fade with a time constant, so that the number of averages behind each value stays known: it decides
how far a fit to the spectrum may be trusted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.records import Array, Bands

OVERLAP_CORRELATION = 1 / 36
"""power correlation of neighbouring Hann segments at half overlap (Welch 1967, with the window's own lag product)"""
HANN_BIN_CORRELATION = 1 + 2 * (2 / 3) ** 2 + 2 * (1 / 6) ** 2
"""variance of a sum over neighbouring Hann bins against that of independent bins"""
BINS_BELOW_BAND = 2.0
"""the lowest frequency of interest lies at least this many bins above zero, clear of the window's main lobe"""
MIN_SEGMENT = 64
"""shorter waveforms give no spectrum worth fitting"""


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided density: its integral over frequency is the mean square."""

    frequency_hz: Array
    psd: Array
    averages: float
    """effective number of independent averages behind each value"""
    bin_correlation: float = 1.0
    """variance of a sum over bins, against independent ones"""


def segment_length(samples: int, rate_hz: float, low_hz: float) -> int:
    """Samples per segment, a power of two: long enough to resolve `low_hz`, short enough to average; 0 if too few."""
    wanted = 2.0 ** math.ceil(math.log2(BINS_BELOW_BAND * rate_hz / low_hz) - 0.5)
    fits = 2 ** int(math.log2(samples)) if samples >= MIN_SEGMENT else 0
    return int(min(wanted, fits))


def welch(value: Array, rate_hz: float, length: int) -> tuple[Array, Array, int]:
    """(m,) frequencies [Hz], (m,) sum of the periodograms [unit^2/Hz] and their number; 0 and NaN are left out."""
    hop = max(length // 2, 1)
    window = np.hanning(length + 1)[:-1]
    pieces = np.lib.stride_tricks.sliding_window_view(value, length)[::hop]
    pieces = pieces[np.isfinite(pieces).all(axis=1)]
    centred = (pieces - pieces.mean(axis=1, keepdims=True)) * window
    transform = np.fft.rfft(centred, axis=1)
    power = (transform.real**2 + transform.imag**2).sum(axis=0) * (2 / (rate_hz * (window @ window)))
    return np.asarray(np.fft.rfftfreq(length, 1 / rate_hz)), power, len(pieces)


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

    def add_waveform(self, time_s: float, value: Array, rate_hz: float) -> bool:
        """Take in a burst; False when it is too short or holds nothing finite."""
        length = segment_length(len(value), rate_hz, self._low_hz)
        if length == 0:
            return False
        frequency, power, pieces = welch(value, rate_hz, length)
        if pieces == 0:
            return False
        self._add(time_s, frequency, power, float(pieces), pieces * (1 + 2 * OVERLAP_CORRELATION))
        self._bin_correlation = HANN_BIN_CORRELATION
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
        inside = (self._frequency_hz >= self._low_hz) & (self._frequency_hz <= self._high_hz) & (self._sum > 0)
        averages = self._weight**2 / self._weight_squared
        return Spectrum(self._frequency_hz[inside], self._sum[inside] / self._weight, averages, self._bin_correlation)
