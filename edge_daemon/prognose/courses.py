"""What a gear's course so far looks like in few numbers, whatever law it follows.

The load carried, and how each indicator went since the gear's own beginning, at shares of its exposure so far: a fast
and a slow life look alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array
from edge_daemon.usage.evidence import FUTURE_H, FUTURE_SHARE, WARMTH_SD
from edge_daemon.usage.ledger import EXPONENTS, NOISE, Ledger

INDICATORS = ("stiffness", "noise", "warmth", *NOISE)
"""Stiffness lost and noise gained, weighed over its coefficients and of each, as logarithms less what warmth and load
do; and kelvins gained. One coefficient may tell of one way to fail: of fifteen sets of fifteen simulated gears, with
each read by itself 60 % instead of 58 % of forecasts at 70 % of life were within 20 %."""
WINDOWS = ((0.45, 0.55), (0.8, 0.88), (0.95, 1.0))
"""An indicator is averaged over these shares of the exposure so far: where it is, and how it got there. Of nine
windows tried on six sets of simulated gears these told the remaining life best at 70 % of it."""
APART = 6
"""Rows so far apart tell what warmth and load do to an indicator: wear changes nothing in between (guess)."""
DRIVERS_SD = (1.0, 1.0)
"""Before the rows tell what they do, e times the speed or the torque may change the logarithm of an indicator by this
sd: the power of a sound that goes with a speed's square or its root."""
SLOWEST = 0.05
"""A speed or torque below this share of its mean is counted as it."""
MOST_SLOPES = 500
"""What drives an indicator is told anew so many times over a history: it changes slowly."""

CLOCKS = (0.0, 3.0, 5.0, 9.0)
"""Exponents of torque in the exposure that are tried: 0 counts turns, the others are of `EXPONENTS`."""


FEATURES = (
    *("turns", "exposure 3", "exposure 9", "load", "speed"),
    *(f"{name} {part}" for name in INDICATORS for part in ("now", "of late", "before", "end", "end of late")),
)
"""Logarithms of exposures by `TOLD_EXPONENTS`, of the second per turn and of turns an hour; of each indicator its
level, two steps, and when straight lines through the windows reach the level at which gears failed."""
TOLD_EXPONENTS = (0.0, 3.0, 9.0)
"""Exponents of torque: turns alone, rolling contacts (ISO 281), and steel in bending."""
OF_LOAD = 5
"""So many of `FEATURES` are there without any indicator."""
FARTHEST, FLAT = 20.0, 0.02
"""A line is followed over so many times the exposure so far; slopes and distances below this share of the level at
failure are nothing (guess)."""
BASE_SHARE = 0.3
"""The gear's own beginning is at most this share of its exposure so far (guess)."""


@dataclass(frozen=True, slots=True)
class Scales:
    """What must be known of a kind of gear before a course can be read."""

    exponent: float
    """of torque in the exposure, one of `CLOCKS`"""
    base: float
    """exposure over which the gear's own beginning is averaged"""
    noise: Array
    """(5,) weight of each noise coefficient"""
    level: Array
    """(8,) size of an indicator that counts; below it is noise"""
    end: Array
    """(8,) level of each indicator at which half of the gears had failed"""
    steady: float = 0.0
    """share of the load of the whole life, against that of late, in what is expected to come (of the logarithm)"""


class LifeCourse:
    """A ledger as running sums, to be read as it stood at any of its rows."""

    def __init__(self, ledger: Ledger, scales: Scales, before_h: float = 0.0) -> None:
        self.scales = scales
        before = before_h / max(float(np.sum(ledger.hours)), 1e-9)
        used = exposure(ledger, scales.exponent)
        self.age_h = before_h + np.cumsum(ledger.hours)
        self.clock = _grown(used, before)
        self.start = float(self.clock[0] - used[0])
        self._exposures = [_grown(exposure(ledger, exponent), before) for exponent in TOLD_EXPONENTS]
        self._sums = _Sums(_indicators(ledger, scales), _drivers(ledger))

    def uses(self) -> list[Array]:
        """(n,) hours, turns, and exposures by the other `TOLD_EXPONENTS`, up to each row."""
        return [self.age_h, *self._exposures]

    def hours_a_unit(self, row: int, clock: Array | None = None) -> float:
        """Hours in which the exposure, or another clock, grows by one: the load to come is told by `Scales.steady`."""
        clock = self.clock if clock is None else clock
        whole = float(self.age_h[row] / max(clock[row], LEAST))
        late = self._late_hours_a_unit(row, clock) if self.scales.steady < 1.0 else whole
        return float(whole**self.scales.steady * late ** (1.0 - self.scales.steady))

    def _late_hours_a_unit(self, row: int, clock: Array) -> float:
        since = self.age_h[row] - max(FUTURE_H, FUTURE_SHARE * (self.age_h[row] - self.age_h[0]))
        first = min(int(np.searchsorted(self.age_h, since)), max(row - 1, 0))
        if first == row:
            return float(self.age_h[row] / max(clock[row], LEAST))
        return float((self.age_h[row] - self.age_h[first]) / max(clock[row] - clock[first], LEAST))

    def known(self, row: int) -> NDArray[np.bool_]:
        """(8,) whether each indicator was measured often enough to be read."""
        return np.asarray(self._sums.count[:, row + 1] >= LEAST_VALUES)

    def read(self, row: int) -> Array:
        """(8, windows) each indicator's level in each window, less that of its beginning; 0 where unknown."""
        sums, now, begun = self._sums, self.clock[row], self.start
        slope = sums.slopes(row)
        first = np.minimum(sums.first, row)
        seen = np.where(first > 0, self.clock[first], begun)
        until = [self._row(one + min(self.scales.base, BASE_SHARE * (now - one)), row) for one in seen]
        base = sums.means(first, np.array(until), slope)
        last, levels = np.zeros(len(INDICATORS)), []
        for since, to in WINDOWS:
            start, end = self._row(begun + since * (now - begun), row), self._row(begun + to * (now - begun), row) + 1
            level = sums.means(np.full(len(first), start), np.full(len(first), end), slope) - base
            last = np.where(np.isnan(level), last, level)
            levels.append(last)
        return np.where(self.known(row)[:, None], np.column_stack(levels), 0.0)

    def _row(self, clock: float, last: int) -> int:
        return min(int(np.searchsorted(self.clock, clock)), last)

    def binned(self, row: int, indicator: int) -> tuple[Array, Array, Array]:
        """(k,) exposure, level and its sd of one of `INDICATORS`, averaged over `BINS` equal stretches up to a row."""
        sums, edges = self._sums, np.linspace(self.start, self.clock[row], BINS + 1)
        at = np.minimum(np.searchsorted(self.clock, edges), row)
        at[-1] = row + 1
        count = np.diff(sums.count[indicator, at])
        filled = np.flatnonzero(count > 0.0)
        slope = sums.slopes(row)
        level = np.array([sums.means(at[[i] * len(slope)], at[[i + 1] * len(slope)], slope)[indicator] for i in filled])
        middle = 0.5 * (self.clock[at[filled]] + self.clock[at[filled + 1] - 1])
        return middle, level, sums.scatter(indicator, row) / np.sqrt(count[filled])

    def features(self, row: int) -> Array:
        """(45,) `FEATURES` as they stood at a row."""
        read = self.read(row)
        levels = np.arcsinh(read / self.scales.level[:, None])
        turns, cubic, high = (float(one[row]) for one in self._exposures)
        load = (turns, cubic, high, cubic / max(turns, LEAST), turns / max(self.age_h[row], LEAST))
        told = np.column_stack((levels[:, -1], levels[:, -1] - levels[:, -2], levels[:, -2] - levels[:, 0]))
        told = np.column_stack((told, self._lines(read)))
        return np.concatenate((np.log(np.maximum(load, LEAST)), told.ravel()))

    def _lines(self, read: Array) -> Array:
        """(8, 2) logarithm of the exposure, over `FARTHEST` times that so far, until each line reaches the end."""
        middle = np.mean(WINDOWS, axis=1)
        sign, size = np.where(self.scales.end < 0.0, -1.0, 1.0)[:, None], np.abs(self.scales.end)[:, None] + LEAST
        slope = sign * (read[:, -1:] - read[:, :-1]) / (middle[-1] - middle[:-1])
        ahead = np.maximum(size - sign * read[:, -1:], FLAT * size) / np.maximum(slope, FLAT * size)
        return np.asarray(np.log(np.clip(ahead / FARTHEST, FLAT / FARTHEST, 1.0)))


def load_to_come(courses: Sequence[LifeCourse]) -> tuple[float, float]:
    """`Scales.steady` that told the later load of failed gears best, and the sd of the logarithm that it left."""
    best = (0.0, math.inf)
    for steady in STEADY:
        errors = []
        for course in courses:
            course.scales = replace(course.scales, steady=steady)
            end, clock = float(course.age_h[-1]), course.clock
            for row in np.searchsorted(course.age_h, np.linspace(FROM, UNTIL, 7) * end):
                later = (end - course.age_h[row]) / max(clock[-1] - clock[row], LEAST)
                errors.append(math.log(max(later, LEAST) / max(course.hours_a_unit(int(row)), LEAST)))
        sd = float(np.sqrt(np.mean(np.square(errors))))
        best = min(best, (steady, sd), key=lambda one: one[1])
    return best


LEAST = 1e-12
"""No exposure is smaller where its logarithm is taken."""
LEAST_VALUES = 10
"""An indicator with fewer values is not read (guess)."""
STEADY = (0.0, 0.5, 1.0)
"""The load to come is that of late, that of the whole life or between them, whichever told it best of failed gears."""
FROM, UNTIL = 0.3, 0.9
"""Between these shares of failed gears' lives the load to come is compared with what was expected."""
BINS = 30
"""A trend of so many points shows its curvature, and averaging has removed the noise of an hour."""
_NOISE_SD = (WARMTH_SD["noise"], *DRIVERS_SD)
_SLOPE_SD = np.array([(WARMTH_SD["stiffness"], *DRIVERS_SD), _NOISE_SD, (1e-9,) * 3, *[_NOISE_SD] * len(NOISE)])
"""(8, 3) per kelvin, and per logarithm of speed and torque; warmth itself is told as it is: the load of a new gear
warms it less than that of a worn one."""


def _grown(used: Array, before: float) -> Array:
    """(n,) running sum; `before`: share of the whole that was used before the first row."""
    return np.asarray(before * float(np.sum(used)) + np.cumsum(used))


def exposure(ledger: Ledger, exponent: float) -> Array:
    """(n,) turns of each row, weighed by torque over rated torque to the exponent."""
    return ledger.turns if exponent == 0.0 else ledger.strain[EXPONENTS.index(exponent)]


def _indicators(ledger: Ledger, scales: Scales) -> Array:
    """(8, n) `INDICATORS`; NaN where not measured."""
    noise = ledger.log_mean[1:6]
    weight = np.abs(scales.noise)[:, None] * np.isfinite(noise)
    level = np.array([np.nanmean(row) if np.isfinite(row).any() else 0.0 for row in noise])[:, None]
    total = weight.sum(axis=0)
    mean = np.sum(np.nan_to_num(noise - level) * weight * np.sign(scales.noise)[:, None], axis=0)
    heard = mean / np.where(total > 0.0, total, np.nan)
    return np.vstack((-ledger.log_mean[0], heard, ledger.temperature_degC, noise))


def _drivers(ledger: Ledger) -> Array:
    """(3, n) what moves an indicator without wear: warmth and the logarithms of speed and torque, less their means."""
    warm, speed = ledger.temperature_degC, ledger.turns / np.maximum(ledger.hours, LEAST)
    heat = np.where(np.isfinite(warm), warm, np.nanmean(warm) if np.isfinite(warm).any() else 0.0)
    torque = np.cbrt(ledger.cubic_Nm3_h / np.maximum(ledger.turns, LEAST))
    load = [np.log(np.maximum(one, SLOWEST * np.mean(one) + LEAST)) for one in (speed, torque)]
    drivers = np.vstack((heat, *load))
    return np.asarray(drivers - np.mean(drivers, axis=1, keepdims=True))


class _Sums:
    """The indicators' running sums, and what warmth and load alone do to each."""

    def __init__(self, values: Array, drivers: Array) -> None:
        known = np.isfinite(values)
        filled = np.where(known, values, 0.0)
        self.count, self.sum = _running(known.astype(float)), _running(filled)
        self.first = np.argmax(known, axis=1)
        """(8,) row in which each is first known"""
        self.drivers = _running(known[:, None] * drivers)
        self.stride = max(values.shape[1] // MOST_SLOPES, 1)
        each = zip(filled, known, _SLOPE_SD, strict=True)
        self._slopes = np.stack([_slopes(row, seen, drivers, sd, self.stride) for row, seen, sd in each], axis=1)

    def slopes(self, row: int) -> Array:
        """(8, 3) what each driver does to each indicator, as known up to `row`."""
        return np.asarray(self._slopes[row // self.stride])

    def scatter(self, indicator: int, row: int) -> float:
        """Sd of one row's value as known up to `row`, by steps between neighbours; NaN if there are few."""
        sums, count = self.sum[indicator, : row + 2], self.count[indicator, : row + 2]
        values = np.diff(sums)[np.diff(count) > 0.0]
        few = len(values) < LEAST_VALUES
        return math.nan if few else float(1.4826 * np.median(np.abs(np.diff(values))) / math.sqrt(2.0))

    def means(self, start: NDArray[np.intp], end: NDArray[np.intp], slope: Array) -> Array:
        """(8,) of each indicator's rows from start to before end, less what its drivers did; NaN if there is none."""
        at, end = np.arange(len(slope)), np.maximum(end, start + 1)
        count = self.count[at, end] - self.count[at, start]
        moved = np.sum(slope * (self.drivers[at, :, end] - self.drivers[at, :, start]), axis=1)
        level = self.sum[at, end] - self.sum[at, start] - moved
        return np.asarray(level / np.where(count > 0.0, count, np.nan))


def _slopes(values: Array, known: NDArray[np.bool_], drivers: Array, slope_sd: Array, stride: int) -> Array:
    """(k, 3) regression of an indicator's steps on those of its drivers, up to every `stride`th row."""
    rows = len(values)
    apart = min(APART, rows)
    both = known[apart:] & known[: rows - apart]
    step = np.where(both, values[apart:] - values[: rows - apart], 0.0)
    driven = np.where(both, drivers[:, apart:] - drivers[:, : rows - apart], 0.0)
    noise = float(np.var(step[both])) if both.any() else 0.0
    lead = np.zeros((3, apart))
    cross = _running(np.hstack((lead, step * driven)))[:, ::stride]
    square = [_running(np.hstack((lead, one * driven)))[:, ::stride] for one in driven]
    least = np.diag((noise + LEAST) / slope_sd**2 + LEAST)
    return np.asarray(np.linalg.solve(np.moveaxis(np.array(square), 2, 0) + least, cross.T[:, :, None])[:, :, 0])


def _running(values: Array) -> Array:
    """Sums along the last axis, from 0."""
    return np.concatenate((np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)), axis=-1)
