"""What failed gears looked like on their way, and how long they still lived: a forecast that assumes no law.

Courses of failed gears at many instants teach a forest the exposure that remains; how far it errs on gears that its
trees have not seen is its spread. It is pooled with the forecasts by the physical law, each by how well it forecast the
failed gears that were left out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge_daemon.prognose.courses import CLOCKS, FEATURES, INDICATORS, LEAST, OF_LOAD, LifeCourse, Scales, exposure
from edge_daemon.prognose.forest import Forest, grow
from edge_daemon.prognose.ledger import Ledger
from edge_daemon.records import Array

LEFT = np.geomspace(10.0, 0.03, 16)
"""Remaining over used life of the instants at which a failed gear is looked at."""
BASE_SHARE, EARLY_ROWS = 0.03, (3, 4)
"""A gear's beginning is this share of a usual life; the instants whose scatter is taken for noise."""
COUNTS_FROM = 0.03
"""An indicator counts from this share of its size at failure, or from its early scatter if that is larger (guess)."""
ALIKE = 0.5
"""Errors count fully for a forecast with the same logarithm of remaining over used life; this is the sd (guess)."""
WIDTH = (len(FEATURES) - OF_LOAD) // len(INDICATORS)
"""So many features tell of one indicator."""
MOST_ALIKE, MOVES = 3, 0.1
"""So many gears are named; an indicator drives the forecast that would move its logarithm this far by not having
changed (guess)."""
MEMBERS = ("courses", "law", "makers")
VERSION = 3
"""Of the file; another one is refused."""
PLANNED = 3.0
"""A plan of another torque shortens life by at least the exponent of rolling contacts (ISO 281), even where the failed
gears all ran at much the same load and turns alone tell their age."""
LONGEST = 30.0
"""No logarithm of a remaining life in hours is larger: a file can say anything."""
MONTH_H = 720.0
"""A technician comes by about once a month, thirty days of running."""
SHARES = 10
"""Weights of members are tried in steps of one over this."""
SURE = 0.25
"""Weights are the mean of all whose score is within so many standard errors of the best: a few gears cannot tell them
apart, and a mean forecasts better than a pick (guess)."""
SPREADS = np.linspace(0.9, 1.3, 9)
"""A pool of calibrated forecasts is too wide (Gneiting and Ranjan 2013, theorem 3.1): its logarithms are drawn together
about their median by one of these factors. With 0.7, which gears left out often asked for, fifteen gears covered 0.69
of others where 0.8 was promised, over eight families."""


@dataclass(frozen=True, slots=True)
class Experience:
    """Failed gears at instants of their lives: n rows of `FEATURES`, and what remained."""

    gear: str
    names: tuple[str, ...]
    """of the failed gears' histories"""
    scales: Scales
    x: Array
    """(n, 20)"""
    target: Array
    """(n,) logarithm of remaining over used exposure"""
    unit: Array
    """(n,) logarithm of the hours that the used exposure would take at the load of late"""
    left_h: Array
    """(n,)"""
    group: NDArray[np.intp]
    """(n,) which gear"""
    known: NDArray[np.bool_]
    """(gears, 3) whether each of `INDICATORS` was measured"""
    weights: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """of `MEMBERS` in the forecast"""
    spread: float = 1.0
    """of `SPREADS`"""
    _grown: dict[tuple[bool, ...], Taught] = field(default_factory=dict, repr=False, compare=False)

    def taught(self, known: Sequence[bool]) -> Taught:
        """What the gears teach that have these indicators; one that few of them have is left aside."""
        least = max(len(self.names) / 2, min(5, len(self.names)))
        used = tuple(bool(one and many >= least) for one, many in zip(known, self.known.sum(axis=0), strict=True))
        if used not in self._grown:
            self._grown[used] = Taught(self, used, least)
        return self._grown[used]


class Taught:
    """A forest of the features that are known, and its errors on gears that its trees had not seen."""

    def __init__(self, past: Experience, used: tuple[bool, ...], least: float) -> None:
        gears = np.all(past.known | ~np.array(used), axis=1)
        if gears.sum() < least:
            gears[:] = True
        rows = gears[past.group]
        self.gears = np.flatnonzero(gears)
        self.columns = np.concatenate((np.full(OF_LOAD, True), np.repeat(used, WIDTH)))
        self.group = np.searchsorted(self.gears, past.group[rows])
        x = past.x[np.ix_(rows, self.columns)]
        self.x = x
        self.forest: Forest = grow(x, past.target[rows], self.group)
        unseen = self.forest.unseen[:, self.group]
        self.told = np.sum(self.forest.told(x) * unseen, axis=0) / unseen.sum(axis=0)
        """(n,) by the trees that had not seen the gear"""
        self.middle = self.told + past.unit[rows]
        self.error = np.log(np.maximum(past.left_h[rows], LEAST)) - self.middle

    def left_h(self, told: float, unit: float, levels: Array, without: int = -1) -> Array:
        """Remaining hours at probability levels (n,), by errors made where much the same was told.

        Errors of `without`, a gear, do not count. That there are few gears widens the levels.
        """
        near = np.exp(-0.5 * ((self.told - told) / ALIKE) ** 2) * (self.group != without) + LEAST
        order = np.argsort(self.error)
        below = (np.cumsum(near[order]) - 0.5 * near[order]) / np.sum(near)
        few = len(self.gears)
        wide = 0.5 + (levels - 0.5) * (few + 1) / few
        return np.asarray(np.exp(np.minimum(told + unit + np.interp(wide, below, self.error[order]), LONGEST)))


def remaining_h(past: Experience, course: LifeCourse, load_factor: float, levels: Array) -> Array:
    """Remaining life [h] at probability levels (n,), as courses of failed gears tell it."""
    last = len(course.clock) - 1
    taught = past.taught(tuple(course.known(last)))
    told = float(np.mean(taught.forest.told(course.features(last)[None, taught.columns])))
    unit = _unit(course, last) - max(past.scales.exponent, PLANNED) * np.log(max(load_factor, 1e-3))
    return taught.left_h(told, unit, levels)


def explained(past: Experience, course: LifeCourse) -> str:
    """How much each member counts, which failed gears this one was most like, and which indicator says so."""
    last = len(course.clock) - 1
    taught = past.taught(tuple(course.known(last)))
    now = course.features(last)
    quiet = np.repeat(now[None], 1 + len(INDICATORS), axis=0)
    for i in range(len(INDICATORS)):
        quiet[1 + i, OF_LOAD + WIDTH * i : OF_LOAD + WIDTH * (i + 1)] = 0.0
    leaves = taught.forest.leaves(quiet[:, taught.columns])
    told = np.mean(taught.forest.value[leaves], axis=0)
    moved = np.abs(told[1:] - told[0])
    same = taught.forest.leaves(taught.x) == leaves[:, :1]
    like = np.bincount(taught.group, np.mean(same / np.maximum(same.sum(axis=1, keepdims=True), 1), axis=0))
    names = ", ".join(f"{past.names[taught.gears[i]]} ({like[i]:.0%})" for i in np.argsort(-like)[:MOST_ALIKE])
    driver = INDICATORS[int(np.argmax(moved))] if np.max(moved) > MOVES else "load"
    weights = ", ".join(f"{name} {w:.0%}" for name, w in zip(MEMBERS, past.weights, strict=True) if w)
    told_by = f"the forecast is by {weights}; driven by {driver}"
    return f"{told_by}; of {len(past.names)} failed gears it is most like {names}; {_narrower(past, course)}"


def _narrower(past: Experience, course: LifeCourse) -> str:
    """What a month more of data would do to the interval that the courses give, if the gear goes on as forecast."""
    last = len(course.clock) - 1
    taught = past.taught(tuple(course.known(last)))
    told, unit = float(np.mean(taught.forest.told(course.features(last)[None, taught.columns]))), _unit(course, last)
    left = math.exp(min(told + unit, LONGEST)) - MONTH_H
    if left <= 0.0:
        return "it is not expected to last a month"
    used = math.log(math.exp(min(unit, LONGEST)) + MONTH_H)
    edges = np.array([0.1, 0.9])
    now, later = (
        float(np.ptp(taught.left_h(*state, edges))) for state in ((told, unit), (math.log(left) - used, used))
    )
    return f"a month more of data would narrow the 80 % interval of the courses from {now:.0f} to {later:.0f} h"


def learn_courses(gear: str, names: Sequence[str], ledgers: Sequence[Ledger]) -> Experience:
    """Experience of gears that failed at the end of their ledgers, on the clock on which they look most alike."""
    tables = [_table(gear, names, ledgers, exponent) for exponent in CLOCKS]
    return min(tables, key=lambda past: float(np.mean(np.abs(past.taught((True,) * len(INDICATORS)).error))))


def _table(gear: str, names: Sequence[str], ledgers: Sequence[Ledger], exponent: float) -> Experience:
    base = BASE_SHARE * float(np.median([np.sum(exposure(ledger, exponent)) for ledger in ledgers]))
    noise = _noise_weights(ledgers)
    one = np.ones(len(INDICATORS))
    raw = [LifeCourse(ledger, Scales(exponent, base, noise, one, one)) for ledger in ledgers]
    ends = np.array([course.read(len(course.clock) - 1)[:, -1] for course in raw])
    scales = Scales(exponent, base, noise, _levels(raw, ends), np.median(ends, axis=0))
    courses = [LifeCourse(ledger, scales) for ledger in ledgers]
    cases = [(i, course, row) for i, course in enumerate(courses) for row in instants(course)]
    return Experience(
        gear,
        tuple(names),
        scales,
        np.array([course.features(row) for _, course, row in cases]),
        np.log(np.maximum([course.clock[-1] / max(course.clock[row], LEAST) - 1.0 for _, course, row in cases], LEAST)),
        np.array([_unit(course, row) for _, course, row in cases]),
        np.array([course.age_h[-1] - course.age_h[row] for _, course, row in cases]),
        np.array([i for i, _, _ in cases]),
        np.array([course.known(len(course.clock) - 1) for course in courses]),
    )


def instants(course: LifeCourse) -> list[int]:
    """Rows of a failed gear's course at which it is looked at, `LEFT` before its end."""
    at = course.age_h[-1] / (1.0 + LEFT)
    return [int(row) for row in np.clip(np.searchsorted(course.age_h, at), 0, max(len(course.age_h) - 2, 0))]


def _unit(course: LifeCourse, row: int) -> float:
    return float(np.log(max(course.clock[row] * course.hours_a_unit(row), LEAST)))


def _levels(courses: Sequence[LifeCourse], ends: Array) -> Array:
    """(3,) sizes from which the indicators count; `ends` (gears, 3) are their levels at failure."""
    early = np.array([np.abs(course.read(instants(course)[i])[:, -1]) for course in courses for i in EARLY_ROWS])
    return np.asarray(
        np.maximum(np.maximum(COUNTS_FROM * np.max(np.abs(ends), axis=0), np.median(early, axis=0)), 1e-4)
    )


def _noise_weights(ledgers: Sequence[Ledger]) -> Array:
    """(5,) a coefficient weighs by what it gained until failure over its scatter's square; all sum to one."""
    gain, scatter = np.zeros(5), np.zeros(5)
    for ledger in ledgers:
        for i, row in enumerate(ledger.log_mean[1:6]):
            known = row[np.isfinite(row)]
            few = max(len(known) // 20, 1)
            if len(known) >= 2:
                gain[i] += float(np.mean(known[-few:]) - np.mean(known[:few]))
                scatter[i] += float(np.median(np.abs(np.diff(known))))
    weight = gain / np.maximum(scatter, 1e-3) ** 2
    total = float(np.sum(np.abs(weight)))
    return weight / total if total > 0.0 else np.full(5, 0.2)


def weighed(
    past: Experience, law: Sequence[Array], makers: Sequence[Array], rows: Sequence[int], levels: Array
) -> Experience:
    """The experience with its members weighed by how well they forecast: the least mean CRPS of the pooled logarithms.

    `law` and `makers` hold quantiles (levels,) of remaining hours at `rows` of the experience.
    """
    taught = past.taught((True,) * len(INDICATORS))
    at = {int(row): i for i, row in enumerate(np.flatnonzero(np.isin(past.group, taught.gears)))}
    cases = [(row, i) for i, row in enumerate(rows) if row in at]
    told = [taught.left_h(taught.told[at[r]], past.unit[r], levels, taught.group[at[r]]) for r, _ in cases]
    members = np.log(np.maximum([[one, law[i], makers[i]] for one, (_, i) in zip(told, cases, strict=True)], LEAST))
    truth = np.log(np.maximum(past.left_h[[row for row, _ in cases]], LEAST))
    parts = [np.array(p) / SHARES for p in itertools.product(range(SHARES + 1), repeat=3) if sum(p) == SHARES]
    each = np.array([np.min(_scores(members, truth, part).mean(axis=1)) for part in parts])
    best = _scores(members, truth, parts[int(np.argmin(each))])
    sure = np.std(np.min(best, axis=0)) / math.sqrt(len(cases))
    close = each <= np.min(each) + SURE * sure
    weights = np.mean(np.array(parts)[close], axis=0)
    spread = SPREADS[int(np.argmin(_scores(members, truth, weights).mean(axis=1)))]
    return replace(past, weights=(float(weights[0]), float(weights[1]), float(weights[2])), spread=float(spread))


def _scores(members: Array, truth: Array, weights: Array) -> Array:
    """(spreads, cases) CRPS of pools of members (cases, 3, levels) drawn together about their medians."""
    used = weights > 0.0
    flat = members[:, used].reshape(len(members), -1)
    order = np.argsort(flat, axis=1)
    pool = np.take_along_axis(flat, order, axis=1)
    share = np.repeat(weights[used] / members.shape[2], members.shape[2])[order]
    below = np.cumsum(share, axis=1) - 0.5 * share
    middle = np.array([np.interp(0.5, level, row) for level, row in zip(below, pool, strict=True)])
    apart = np.sum(share * pool * (2.0 * below - 1.0), axis=1)
    off = truth - middle
    around = pool - middle[:, None]
    return np.array([np.sum(share * np.abs(s * around - off[:, None]), axis=1) - s * apart for s in SPREADS])


def drawn_together(past: Experience, left_h: Array) -> Array:
    """A pool's remaining lives [h] with the spread at which such pools forecast best."""
    middle = max(float(np.median(left_h)), LEAST)
    return np.asarray(middle * (np.maximum(left_h, LEAST) / middle) ** past.spread)


class ExperienceFile(msgspec.Struct, forbid_unknown_fields=True):
    """Experience as it is written beside the physical prior."""

    version: int
    gear: str
    names: list[str]
    features: list[str]
    exponent: float
    base: float
    noise: list[float]
    level: list[float]
    end: list[float]
    weights: tuple[float, float, float]
    spread: float
    known: list[tuple[bool, bool, bool]]
    group: list[int]
    target: list[float]
    unit: list[float]
    left_h: list[float]
    x: list[list[float]]


def experience_file(past: Experience) -> ExperienceFile:
    """To be written; numbers to six decimals."""
    columns = {name: np.round(getattr(past, name), 6).tolist() for name in ("x", "target", "unit", "left_h")}
    whole = {"known": past.known.tolist(), "group": past.group.tolist(), "features": FEATURES, "version": VERSION}
    scales = {name: getattr(past.scales, name).tolist() for name in ("noise", "level", "end")}
    told = {name: getattr(past, name) for name in ("gear", "names", "weights", "spread")}
    told |= {name: getattr(past.scales, name) for name in ("exponent", "base")}
    return msgspec.convert(columns | whole | scales | told, ExperienceFile)


def experience_of(saved: ExperienceFile) -> Experience:
    """What was written. Raises ValueError if it does not fit this program or itself."""
    if saved.version != VERSION or saved.features != list(FEATURES):
        raise ValueError(f"experience of version {saved.version}: expected {VERSION}; learn again")
    group, x = np.array(saved.group, dtype=np.intp), np.array(saved.x)
    numbers = np.array((saved.target, saved.unit, saved.left_h))
    scales = Scales(saved.exponent, saved.base, *(np.array(part) for part in (saved.noise, saved.level, saved.end)))
    fits = (
        x.shape == (group.size, len(FEATURES))
        and numbers.shape == (3, group.size)
        and len(saved.known) == len(saved.names)
    )
    fits = fits and set(group.tolist()) == set(range(len(saved.names))) and saved.exponent in CLOCKS
    fits = fits and scales.noise.shape == (5,) and scales.level.shape == scales.end.shape == (len(INDICATORS),)
    fits = fits and bool(np.all(scales.level > 0.0) and np.all(numbers[2] >= 0.0))
    fits = fits and SPREADS[0] - 1e-6 <= saved.spread <= SPREADS[-1] + 1e-6
    if not fits or abs(sum(saved.weights) - 1.0) > 1e-6 or min(saved.weights) < 0.0:
        raise ValueError("experience: rows, gears, scales or weights do not fit each other")
    known = np.array(saved.known, dtype=bool)
    target, unit, left_h = numbers
    told = (x, target, unit, left_h, group, known, saved.weights, saved.spread)
    return Experience(saved.gear, tuple(saved.names), scales, *told)
