"""What a residual tells beyond chance: its independent samples, and the fall of squared errors over blocks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from edge_daemon.records import Array

MEMORY_S = 0.25
"""Reach of a residual's autocorrelation that is counted: longer lags add noise only, in blocks of 1.25 s."""
LOOKS = 10.0
"""A recording gives so many independent looks at the error of a law (calibrated on friction and hysteresis fitted with
other laws: errors over their sd scatter by about one)."""


def lags_at(rate_hz: float) -> int:
    """How many lags of a residual of so many rows a second are counted."""
    return max(2, round(MEMORY_S * rate_hz))


def independent(residual: Array, block: NDArray[np.intp], lags: int) -> float:
    """How many independent samples tell the scatter of a residual (m,), whose blocks do not know each other."""
    power = float(residual @ residual)
    if not power > 0:
        return float(len(residual))
    parts = np.split(residual, np.flatnonzero(np.diff(block)) + 1)
    lengths = np.array([len(part) for part in parts])
    table = np.zeros((len(parts), fft.next_fast_len(int(lengths.max()) + lags, real=True)))
    for row, part in zip(table, parts, strict=True):
        row[: len(part)] = part
    spectrum = np.sum(np.abs(fft.rfft(table, axis=1)) ** 2, axis=0)
    products = fft.irfft(spectrum, table.shape[1])[1:lags]
    pairs = np.maximum(lengths[:, None] - np.arange(1, lags), 0).sum(axis=0)
    known = pairs > 0
    square = float(np.sum((products[known] / power * len(residual) / pairs[known]) ** 2))
    return len(residual) / (1.0 + 2.0 * square)


def surely(before: Array, after: Array) -> float:
    """t of the fall of squared errors (b,), paired over blocks."""
    return max(_t(before - after), _t(np.log(before / after)))


def _t(fall: Array) -> float:
    """Mean over its standard error: of squared errors, where busy blocks rule, or of logarithms, where all count."""
    return float(fall.mean()) / (float(fall.std(ddof=1)) / math.sqrt(len(fall)) + 1e-300)
