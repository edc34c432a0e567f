"""Samples onto a block's time base: placed as they are, interpolated, or held. A gap is never bridged."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array, Flags, Flaw

GAP_PERIODS = 1.5
"""No value is interpolated between readings further apart than this many of their periods."""
LOCK_RMS = 0.2
"""Samples are taken to be the grid's own up to this scatter of their stamps about it, in periods (guess)."""
LOCK_DRIFT = 0.25
"""The rates are the same up to this drift of stamps against the grid over one block, in periods."""
STENCIL = 4
DOUBT_STEPS = 0.5
"""An interpolated value may be in doubt by this part of a step: the rounding of the readings adds another half."""
MISSING, STALE = np.uint8(Flaw.MISSING), np.uint8(Flaw.STALE)

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
    first = (float(time_s[0]) - start_s) * rate_hz
    relative = (time_s - time_s[0]) * rate_hz
    error = relative - np.rint(relative)
    n, half = len(error), len(error) // 2
    total, early = float(error.sum()), float(error[:half].sum())
    mean = total / n
    drift = 2.0 * ((total - early) / (n - half) - early / half) / n if half else 0.0
    rms = math.sqrt(max(float(error @ error) / n - mean * mean, 0.0))
    shift = first + mean
    shift -= round(shift)
    slots = np.rint(relative + (first - shift)).astype(np.intp)
    fits = bool(slots[0] >= 0 and slots[-1] < size and ascending(slots))
    return Fit(slots, shift / rate_hz, rms <= LOCK_RMS and abs(drift) * size <= LOCK_DRIFT, fits)


def ascending(values: NDArray[Any]) -> bool:
    """Whether each value is above the one before it; False for NaN between others."""
    return bool(np.count_nonzero(values[1:] > values[:-1]) == len(values) - 1)


def largest(values: Array) -> float:
    """The largest magnitude in (n,) values, n >= 1; a quarter of the cost of numpy's `max`, which adds up here."""
    return abs(float(values[np.abs(values).argmax()]))


def place(values: Array, flaws: Flags, slots: NDArray[np.intp], size: int) -> Aligned:
    """The samples themselves in their slots, to the last bit; empty slots are NaN and MISSING."""
    if len(slots) == size:
        return values.copy(), flaws.copy()
    placed = np.full(size, math.nan)
    marks = np.full(size, MISSING)
    placed[slots], marks[slots] = values, flaws
    return placed, marks


def interpolate(
    time_s: Array, values: Array, flaws: Flags, period_s: float, grid_s: Array, step: float = math.inf
) -> Aligned:
    """Cubic through the four nearest readings on the same side of every gap; MISSING inside gaps, at loose ends, and
    where a fifth reading beside them would change the result by half a `step` or more: they do not tell the motion.

    A flaw of any of the four readings marks the result. Lagrange's formula on the true, uneven times.
    """
    size = len(grid_s)
    last = len(time_s) - 1
    if last < STENCIL - 1:
        return np.full(size, math.nan), np.full(size, MISSING)
    left = time_s.searchsorted(grid_s, side="right") - 1
    first, missing = _stencils(left, np.flatnonzero(time_s[1:] - time_s[:-1] > GAP_PERIODS * period_s), last)
    nodes = first + np.arange(STENCIL)[:, None]
    base = values[nodes[1]]
    x = (time_s[nodes] - grid_s) / period_s
    result = base + _cubic(x, values[nodes] - base)
    marks = np.bitwise_or.reduce(flaws[nodes]) if np.count_nonzero(flaws) else np.zeros(size, dtype=np.uint8)
    if step < math.inf:
        missing |= ~(_fourth(time_s / period_s, values)[first] * np.abs(x.prod(axis=0)) < DOUBT_STEPS * step)
    if np.count_nonzero(missing):
        result[missing], marks[missing] = math.nan, MISSING
    exact = grid_s == time_s[np.maximum(left, 0)]
    if np.count_nonzero(exact):
        result[exact], marks[exact] = values[left[exact]], flaws[left[exact]]
    return result, marks


def _stencils(left: NDArray[np.intp], gaps: NDArray[np.intp], last: int) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """(n,) the first reading of each instant's stencil, and (n,) where none lies on one side of every gap.

    `left` (n,): the reading at or before each instant; `gaps`: readings that a gap follows; `last`: the newest one.
    """
    outside = (left < 0) | (left >= last)
    if not len(gaps):
        return np.minimum(np.maximum(left - 1, 0), last - STENCIL + 1), outside
    run = gaps.searchsorted(left, side="left")
    run_first = np.concatenate(([0], gaps + 1))[run]
    run_last = np.append(gaps, last)[run]
    first = np.minimum(np.maximum(left - 1, run_first), np.maximum(run_last - STENCIL + 1, run_first))
    missing = outside | (run_last - run_first < STENCIL - 1) | (left == run_last)
    return np.minimum(first, last - STENCIL + 1), missing


def _cubic(x: Array, y: Array) -> Array:
    """(n,) value at 0 of the cubics through (4, n) nodes x, y, by Newton's divided differences."""
    once = (y[1:] - y[:-1]) / (x[1:] - x[:-1])
    twice = (once[1:] - once[:-1]) / (x[2:] - x[:-2])
    thrice = (twice[1] - twice[0]) / (x[3] - x[0])
    result: Array = y[0] - x[0] * (once[0] - x[1] * (twice[0] - x[2] * thrice))
    return result


def _fourth(x: Array, y: Array) -> Array:
    """(n,) largest divided difference of fourth order among those that share a reading with the four from each on.

    Times the product of the distances to the four it is the remainder of their cubic (Newton)."""
    if len(x) <= STENCIL:
        return np.full(len(x), math.inf)
    for k in range(1, STENCIL + 1):
        y = (y[1:] - y[:-1]) / (x[k:] - x[:-k])
    around = np.pad(np.abs(y), (STENCIL, 2 * STENCIL - 1))
    largest_near: Array = np.lib.stride_tricks.sliding_window_view(around, 2 * STENCIL).max(axis=1)
    return largest_near


def hold(
    time_s: Array,
    values: Array,
    flaws: Flags,
    stale_after_s: float,
    grid_s: Array,
    lost_s: tuple[float, float] = (math.inf, math.inf),
) -> Aligned:
    """The newest reading at or before each instant; STALE when older than allowed, MISSING before the first.

    `lost_s`: MISSING where readings were lost, between two that lie further apart than the first of these, and so long
    after the newest as the second.
    """
    newest = time_s.searchsorted(grid_s, side="right") - 1
    if newest[-1] < 0:
        return np.full(len(grid_s), math.nan), np.full(len(grid_s), MISSING)
    held, marks = values[newest], flaws[newest]
    age_s = grid_s - time_s[newest]
    if grid_s[-1] - time_s[max(newest[0], 0)] > stale_after_s:  # else none of them is
        marks[age_s > stale_after_s] |= STALE
    if lost_s[0] < math.inf:
        apart_s = np.append(time_s[1:] - time_s[:-1], 0.0)
        marks[(apart_s[newest] > lost_s[0]) | ((newest == len(time_s) - 1) & (age_s > lost_s[1]))] |= MISSING
    if newest[0] < 0:
        held[newest < 0], marks[newest < 0] = math.nan, MISSING
    return held, marks
