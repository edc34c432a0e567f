"""Samples onto a block's time base: placed as they are, interpolated, or held. A gap is never bridged."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array, Flags, Flaw

GAP_PERIODS = 1.5
"""no value is interpolated between readings further apart than this many of their periods"""
LOCK_RMS = 0.2
"""scatter of stamps about the grid, in periods, up to which samples are taken to be the grid's own (guess)"""
LOCK_DRIFT = 0.25
"""drift of stamps against the grid over one block, in periods, up to which the rates are the same"""
STENCIL = 4

Aligned = tuple[Array, Flags]


@dataclass(frozen=True, slots=True)
class Fit:
    """How well samples lie on a grid of the nominal rate."""

    slots: NDArray[np.intp]
    """(n,) which slot each sample takes"""
    shift_s: float
    """the samples lie this much later than the grid"""
    same_rate: bool
    """little scatter and drift: but for `shift_s` the samples make the grid"""
    fits: bool
    """every sample has a slot of its own inside the block"""


def fit(time_s: Array, start_s: float, rate_hz: float, size: int) -> Fit:
    """Slots of (n,) ascending times, n >= 1, in a block of `size` samples from `start_s`."""
    position = (time_s - start_s) * rate_hz
    relative = position - position[0]
    error = relative - np.rint(relative)
    mean = float(error.mean())
    half = len(error) // 2
    drift = 2.0 * float(error[half:].mean() - error[:half].mean()) / len(error) if half else 0.0
    rms = math.sqrt(max(float(error @ error) / len(error) - mean * mean, 0.0))
    shift = float(position[0]) + mean
    shift -= round(shift)
    slots = np.rint(position - shift).astype(np.intp)
    fits = slots[0] >= 0 and slots[-1] < size and bool((slots[1:] > slots[:-1]).all())
    return Fit(slots, shift / rate_hz, rms <= LOCK_RMS and abs(drift) * size <= LOCK_DRIFT, bool(fits))


def place(values: Array, flaws: Flags, slots: NDArray[np.intp], size: int) -> Aligned:
    """The samples themselves in their slots, to the last bit; empty slots are NaN and MISSING."""
    if len(slots) == size:
        return values.copy(), flaws.copy()
    placed = np.full(size, math.nan)
    marks = np.full(size, int(Flaw.MISSING), dtype=np.uint8)
    placed[slots], marks[slots] = values, flaws
    return placed, marks


def interpolate(time_s: Array, values: Array, flaws: Flags, period_s: float, grid_s: Array) -> Aligned:
    """Cubic through the four nearest readings on the same side of every gap; MISSING inside gaps and at loose ends.

    A flaw of any of the four readings marks the result. Lagrange's formula on the true, uneven times.
    """
    size = len(grid_s)
    last = len(time_s) - 1
    if last < STENCIL - 1:
        return np.full(size, math.nan), np.full(size, int(Flaw.MISSING), dtype=np.uint8)
    left = np.searchsorted(time_s, grid_s, side="right") - 1
    left -= (left == last) & (grid_s == time_s[last])
    gaps = np.flatnonzero(np.diff(time_s) > GAP_PERIODS * period_s)
    run = np.searchsorted(gaps, left, side="left")
    run_first = np.concatenate(([0], gaps + 1))[run]
    run_last = np.append(gaps, last)[run]
    missing = (left < 0) | (left >= last) | (run_last - run_first < STENCIL - 1) | (left == run_last)
    first = np.clip(left - 1, run_first, np.maximum(run_last - STENCIL + 1, 0))
    first = np.clip(first, 0, last - STENCIL + 1)
    nodes = first[:, None] + np.arange(STENCIL)
    base = values[nodes[:, 1]]
    exact = grid_s == time_s[np.maximum(left, 0)]
    result = base + _lagrange((time_s[nodes] - grid_s[:, None]) / period_s, values[nodes] - base[:, None])
    marks = np.bitwise_or.reduce(flaws[nodes], axis=1)
    result[missing] = math.nan
    marks[missing] = Flaw.MISSING
    result[exact], marks[exact] = values[left[exact]], flaws[left[exact]]
    return result, marks


def _lagrange(x: Array, y: Array) -> Array:
    """(n,) value at 0 of the cubics through (n, 4) nodes x, y."""
    total = np.zeros(len(x))
    for i in range(STENCIL):
        weight = np.ones(len(x))
        for j in range(STENCIL):
            if j != i:
                weight *= x[:, j] / (x[:, j] - x[:, i])
        total += weight * y[:, i]
    return total


def hold(time_s: Array, values: Array, flaws: Flags, stale_after_s: float, grid_s: Array) -> Aligned:
    """The newest reading at or before each instant; STALE when older than allowed, MISSING before the first."""
    newest = np.searchsorted(time_s, grid_s, side="right") - 1
    if newest[-1] < 0:
        return np.full(len(grid_s), math.nan), np.full(len(grid_s), int(Flaw.MISSING), dtype=np.uint8)
    held, marks = values[newest], flaws[newest]
    marks[grid_s - time_s[newest] > stale_after_s] |= np.uint8(Flaw.STALE)
    if newest[0] < 0:
        held[newest < 0], marks[newest < 0] = math.nan, Flaw.MISSING
    return held, marks
