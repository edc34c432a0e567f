"""What failed gears looked like on their way, and how long they still lived: a forecast that assumes no law.

Courses of failed gears at many instants teach a forest the exposure that remains; how far it errs on gears that its
trees have not seen is its spread. It is pooled with the forecasts by the growth of each indicator (`growth`), by the
lives of the failed gears alone (`lives`) and by the physical law, each by how well it forecast the failed gears that
were left out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge_daemon.prognose.courses import (
    CLOCKS,
    FEATURES,
    INDICATORS,
    LEAST,
    OF_LOAD,
    LifeCourse,
    Scales,
    exposure,
    load_to_come,
)
from edge_daemon.prognose.forest import Forest, grow
from edge_daemon.prognose.growth import Growth, first_passage_h
from edge_daemon.prognose.lives import Lives, learn_lives
from edge_daemon.records import Array
from edge_daemon.usage.ledger import Ledger

LEFT = 1.0 / np.linspace(0.09, 0.975, 30) - 1.0
"""Remaining over used life of the instants at which a failed gear is looked at: at even steps of its life. Of fifteen
sets of fifteen simulated gears 65 % of the forecasts at 70 % of life were within 20 %, where sixteen instants that
stood close at the beginning gave 60 %."""
BASE_SHARE, EARLY_ROWS = 0.03, (2, 3, 4)
"""A gear's beginning is this share of a usual life; the instants whose scatter is taken for noise."""
COUNTS_FROM = 0.03
"""An indicator counts from this share of its size at failure, or from its early scatter if that is larger (guess)."""
ALIKE = 0.5
"""Errors count fully for a forecast with the same logarithm of remaining over used life; this is the sd (guess)."""
WIDTH = (len(FEATURES) - OF_LOAD) // len(INDICATORS)
"""So many features tell of one indicator."""
TOLD = 0.005
"""A member of a smaller weight would be told with 0 %."""
MOST_ALIKE, MOVES = 3, 0.1
"""So many gears are named; an indicator drives the forecast that would move its logarithm this far by not having
changed (guess)."""
MEMBERS = ("courses", "growth", "lives", "law", "makers")
STAGES = np.log((7.0 / 3.0, 1.0, 3.0 / 7.0, 1.0 / 9.0))
"""Members are weighed at these logarithms of remaining over used life: at 30, 50, 70 and 90 % of it."""
SAME_STAGE, ANY_STAGE = 0.6, 0.02
"""A forecast counts for a stage by how near to it the courses have the gear, with this sd, and a little everywhere
(guess: of five simulated families of fourteen gears three had a lower CRPS than with one set of weights for all of
life, one the same and one a higher one by 2 %)."""
VERSION = 7
"""Of the file; another one is refused."""
PLANNED = 3.0
"""A plan of another torque shortens life by at least the exponent of rolling contacts (ISO 281), even where the failed
gears all ran at much the same load and turns alone tell their age."""
LARGEST_TOLD = 1e9
"""No logarithm, share or number of hours that gears tell comes near it, and squares of it are finite."""
MOST_LIFE_H = 1e6
"""A longer life is told as this one: a century, beyond any use."""
LONGEST = math.log(MOST_LIFE_H)
MONTH_H = 720.0
"""A technician comes by about once a month, thirty days of running."""
SHARES = 10
"""Weights of members are tried in steps of one over this."""
SURE = 0.25
"""Weights are the mean of all whose score is within so many standard errors of the best: a few gears cannot tell them
apart, and a mean forecasts better than a pick (guess)."""
PARTS = np.array([p for p in itertools.product(range(SHARES + 1), repeat=len(MEMBERS)) if sum(p) == SHARES]) / SHARES
"""Weights of the members that are tried."""
USUAL, UNUSUAL = (0.6, 0.3, 0.05, 0.05, 0.0), 5.0
"""Before gears tell, members are believed to weigh so: a pool by other weights must have a CRPS that is lower by this
share, over the number of gears and times the squared distance of the weights. Of 442 forecasts by five taught gears of
thirteen simulated families 64 % at 70 % of life were within 20 %, where the gears alone gave 60 %: five that chance to
fail at one age make age the best member. By fifteen gears it changed nothing."""
HELD, EDGES = 0.8, (0.1, 0.5, 0.9)
"""The interval that is told holds this share of gears, between these levels."""
NARROWEST, WIDEST = 0.4, 4.0
"""A pool is drawn together or widened by these factors at most (guess)."""
USUAL_SPREAD, AS_WIDE = 0.8, 5
"""A pool of members that each hold what they promise is too wide, for they differ as well (Gneiting and Ranjan 2013):
before gears tell, this much, which is believed as if so many gears had shown it (guess: of 884 forecasts each by five
and by fifteen gears of thirteen simulated families the 80 % intervals held 86 and 84 %)."""


@dataclass(frozen=True, slots=True)
class Experience:
    """Failed gears at instants of their lives: n rows of `FEATURES`, and what remained."""

    gear: str
    names: tuple[str, ...]
    """of the failed gears' histories"""
    scales: Scales
    x: Array
    """(n, 45)"""
    target: Array
    """(n,) logarithm of remaining over used exposure"""
    unit: Array
    """(n,) logarithm of the hours that the used exposure would take at the load of late"""
    left_h: Array
    """(n,)"""
    group: NDArray[np.intp]
    """(n,) which gear"""
    known: NDArray[np.bool_]
    """(gears, 8) whether each of `INDICATORS` was measured"""
    lives: Lives
    stages: tuple[tuple[float, ...], ...] = ((1.0, *[0.0] * (len(MEMBERS) - 1)),) * len(STAGES)
    """weights of `MEMBERS` in the forecast at each of `STAGES`"""
    spread: float = 1.0
    """the pool is so many times as wide as its members are, in logarithms, so that its interval holds other gears"""
    growth: Growth | None = None
    """of the indicators; None where none of them told of failure"""
    _grown: dict[tuple[bool, ...], Taught] = field(default_factory=dict, repr=False, compare=False)

    @property
    def weights(self) -> tuple[float, ...]:
        """Of `MEMBERS`, over the whole life."""
        return tuple(np.mean(self.stages, axis=0).tolist())

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

        Errors of `without`, a gear, do not count.
        """
        near = np.exp(-0.5 * ((self.told - told) / ALIKE) ** 2) * (self.group != without) + LEAST
        order = np.argsort(self.error)
        below = (np.cumsum(near[order]) - 0.5 * near[order]) / np.sum(near)
        return np.asarray(np.exp(np.minimum(told + unit + np.interp(levels, below, self.error[order]), LONGEST)))


def weights_now(past: Experience, course: LifeCourse) -> tuple[float, ...]:
    """Of `MEMBERS`, for a gear as far in its life as its course tells."""
    return tuple(_staged(np.array(past.stages), np.array([_as_of_now(past, course)[2]]))[0].tolist())


def _staged(stages: Array, told: Array) -> Array:
    """(n, members) weights at logarithms of remaining over used life (n,), between those of the stages."""
    return np.column_stack([np.interp(-told, -STAGES, column) for column in stages.T])


def remaining_h(past: Experience, course: LifeCourse, load_factor: float, levels: Array) -> Array:
    """Remaining life [h] at probability levels (n,), as courses of failed gears tell it."""
    taught, _, told, unit = _as_of_now(past, course)
    unit -= max(past.scales.exponent, PLANNED) * math.log(max(load_factor, 1e-3))
    return taught.left_h(told, unit, levels)


def outlived_h(past: Experience, course: LifeCourse, load_factor: float, levels: Array) -> Array:
    """Remaining life [h] at probability levels (n,), by the lives of the failed gears alone."""
    factor = max(load_factor, 1e-3) ** max(past.lives.exponent, PLANNED)
    return np.asarray(np.minimum(past.lives.left_h(course, len(course.clock) - 1, levels) / factor, MOST_LIFE_H))


def grown_h(past: Experience, ledger: Ledger, before_h: float, load_factor: float, count: int) -> tuple[Array, Array]:
    """(count,) remaining hours by the growth of each indicator, and which of them ends the gear; or nothing."""
    if past.growth is None:
        return np.empty(0), np.empty(0)
    course = LifeCourse(ledger, past.growth.scales, before_h)
    hours, first = first_passage_h(past.growth, course, len(course.clock) - 1, count)
    factor = max(load_factor, 1e-3) ** max(past.growth.exponent, PLANNED)
    return np.minimum(hours / factor, MOST_LIFE_H), first


def _as_of_now(past: Experience, course: LifeCourse) -> tuple[Taught, Array, float, float]:
    """What the gears alike in sensors teach, the features now, and what is told of them: as `target` and `unit`."""
    last = len(course.clock) - 1
    taught, now = past.taught(tuple(course.known(last))), course.features(last)
    return taught, now, float(np.mean(taught.forest.told(now[None, taught.columns]))), _unit(course, last)


def explained(past: Experience, course: LifeCourse) -> str:
    """How much each member counts, which failed gears this one was most like, and which indicator says so."""
    taught, now, *_ = _as_of_now(past, course)
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
    weights = ", ".join(
        f"{name} {w:.0%}" for name, w in zip(MEMBERS, weights_now(past, course), strict=True) if w >= TOLD
    )
    told_by = f"the forecast is by {weights}; driven by {driver}"
    return f"{told_by}; of {len(past.names)} failed gears it is most like {names}; {_narrower(past, course)}"


def _narrower(past: Experience, course: LifeCourse) -> str:
    """What a month more of data would do to the interval that the courses give, if the gear goes on as forecast."""
    taught, _, told, unit = _as_of_now(past, course)
    left = math.exp(min(told + unit, LONGEST)) - MONTH_H
    if left <= 0.0:
        return "it is not expected to last a month"
    used = math.log(math.exp(min(unit, LONGEST)) + MONTH_H)
    edges = np.array([0.1, 0.9])
    now, later = (
        float(np.ptp(taught.left_h(*state, edges))) for state in ((told, unit), (math.log(left) - used, used))
    )
    if later >= now:
        return "another month of data would hardly narrow the 80 % interval of the courses"
    return f"a month more of data would narrow the 80 % interval of the courses from {now:.0f} to {later:.0f} h"


def learn_courses(gear: str, names: Sequence[str], ledgers: Sequence[Ledger]) -> Experience:
    """Experience of gears that failed at the end of their ledgers, on the clock on which they look most alike."""
    tables = [_table(gear, names, ledgers, exponent) for exponent in CLOCKS]
    return min(tables, key=lambda past: float(np.mean(np.abs(past.taught((True,) * len(INDICATORS)).error))))


def _table(gear: str, names: Sequence[str], ledgers: Sequence[Ledger], exponent: float) -> Experience:
    base = BASE_SHARE * float(np.median([np.sum(exposure(ledger, exponent)) for ledger in ledgers]))
    noise = noise_weights(ledgers)
    one = np.ones(len(INDICATORS))
    courses = [LifeCourse(ledger, Scales(exponent, base, noise, one, one)) for ledger in ledgers]
    steady, _ = load_to_come(courses)
    ends = np.array([course.read(len(course.clock) - 1)[:, -1] for course in courses])
    scales = Scales(exponent, base, noise, _levels(courses, ends), np.median(ends, axis=0), steady)
    for course in courses:
        course.scales = scales
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
        learn_lives(courses),
    )


def instants(course: LifeCourse) -> list[int]:
    """Rows of a failed gear's course at which it is looked at, `LEFT` before its end."""
    at = course.age_h[-1] / (1.0 + LEFT)
    return [int(row) for row in np.clip(np.searchsorted(course.age_h, at), 0, max(len(course.age_h) - 2, 0))]


def _unit(course: LifeCourse, row: int) -> float:
    return float(np.log(max(course.clock[row] * course.hours_a_unit(row), LEAST)))


def _levels(courses: Sequence[LifeCourse], ends: Array) -> Array:
    """(8,) sizes from which the indicators count; `ends` (gears, 8) are their levels at failure."""
    early = np.array([np.abs(course.read(instants(course)[i])[:, -1]) for course in courses for i in EARLY_ROWS])
    return np.asarray(
        np.maximum(np.maximum(COUNTS_FROM * np.max(np.abs(ends), axis=0), np.median(early, axis=0)), 1e-4)
    )


def noise_weights(ledgers: Sequence[Ledger]) -> Array:
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


def weighed(past: Experience, others: Sequence[Sequence[Array]], rows: Sequence[int], levels: Array) -> Experience:
    """The experience with its members weighed by how well they forecast: the least CRPS of the pool, over life.

    `others` hold, of every member but the first, quantiles (levels,) of remaining hours at `rows` of the experience.
    """
    taught = past.taught((True,) * len(INDICATORS))
    at = {int(row): i for i, row in enumerate(np.flatnonzero(np.isin(past.group, taught.gears)))}
    cases = [(row, i) for i, row in enumerate(rows) if row in at]
    used = [row for row, _ in cases]
    told = [taught.left_h(taught.told[at[r]], past.unit[r], levels, taught.group[at[r]]) for r, _ in cases]
    members = np.array([[one, *(other[i] for other in others)] for one, (_, i) in zip(told, cases, strict=True)])
    members, truth, gear = np.clip(members, LEAST, MOST_LIFE_H), np.maximum(past.left_h[used], LEAST), past.group[used]
    life = truth * (1.0 + np.exp(-past.target[used]))
    scores = _scores(members / life[:, None, None], truth / life)
    stage = taught.told[[at[row] for row in used]]
    gears = len(np.unique(gear))
    apart = [(gear == one, _weights(scores[:, gear != one], stage[gear != one], gears - 1)) for one in np.unique(gear)]
    errors = np.concatenate(
        [
            _errors(np.log(members[[case]]), np.log(truth[[case]]), weights)
            for own, stages in apart
            for case, weights in zip(np.flatnonzero(own), _staged(stages, stage[own]), strict=True)
        ]
    )
    found = tuple(tuple(row) for row in _weights(scores, stage, gears).tolist())
    return replace(past, stages=found, spread=_wide_enough(errors, gears))


def _weights(scores: Array, told: Array, gears: int) -> Array:
    """(stages, members) the mean of those `PARTS` whose CRPS (parts, cases) there can hardly be told from the best.

    `told` (cases,) is where in its life each case was held to be.
    """
    found = []
    for stage in STAGES:
        near = np.exp(-0.5 * ((told - stage) / SAME_STAGE) ** 2) + ANY_STAGE
        near /= np.sum(near)
        mean = scores @ near
        mean += UNUSUAL / gears * np.min(mean) * np.sum((PARTS - USUAL) ** 2, axis=1)
        best = int(np.argmin(mean))
        sure = math.sqrt(float(near @ (scores[best] - mean[best]) ** 2) * float(near @ near))
        found.append(np.mean(PARTS[mean <= mean[best] + SURE * sure], axis=0))
    return np.array(found)


def _pool(members: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Values of the members' pool (cases, n) in rising order, the share of each and the level that it stands at."""
    used = weights > 0.0
    flat = members[:, used].reshape(len(members), -1)
    order = np.argsort(flat, axis=1)
    share = np.repeat(weights[used] / members.shape[2], members.shape[2])[order]
    return np.take_along_axis(flat, order, axis=1), share, np.cumsum(share, axis=1) - 0.5 * share


def _scores(members: Array, truth: Array) -> Array:
    """(parts, cases) CRPS of pools by `PARTS` of members (cases, members, levels): of the distances of its values from
    the truth and from each other (Gneiting and Raftery 2007, eq. 21), so that those of the members tell all pools'."""
    off = np.mean(np.abs(members - truth[:, None, None]), axis=2)
    apart = np.mean(np.abs(members[:, :, None, :, None] - members[:, None, :, None, :]), axis=(3, 4))
    return np.asarray(PARTS @ off.T - 0.5 * np.einsum("pi,cij,pj->pc", PARTS, apart, PARTS, optimize=True))


def _errors(members: Array, truth: Array, weights: Array) -> Array:
    """(cases,) how far from a pool's median the truth lies, over how far that side of the interval reaches."""
    pool, _, below = _pool(members, weights)
    low, middle, high = np.array([np.interp(EDGES, level, row) for level, row in zip(below, pool, strict=True)]).T
    return np.asarray(np.abs(truth - middle) / np.maximum(np.where(truth > middle, high - middle, middle - low), 1e-6))


def _wide_enough(errors: Array, gears: int) -> float:
    """The factor at which intervals would have held the gears that neither weights nor members knew, of few gears drawn
    towards `USUAL_SPREAD` (partial pooling; without that and with `HELD` raised it is cross-validated conformal
    prediction: Barber et al. 2021, eq. 3, whose guarantee five gears pay with intervals that say nothing)."""
    level = (np.arange(errors.size) + 0.5) / errors.size
    wide = float(np.interp(HELD, level, np.sort(errors)))
    share = gears / (gears + AS_WIDE)
    return float(np.clip(wide**share * USUAL_SPREAD ** (1.0 - share), NARROWEST, WIDEST))


class ExperienceFile(msgspec.Struct, forbid_unknown_fields=True):
    """Experience as it is written beside the physical prior."""

    version: int
    gear: str
    names: list[str]
    features: list[str]
    exponent: float
    base: float
    steady: float
    noise: list[float]
    level: list[float]
    end: list[float]
    stages: list[list[float]]
    spread: float
    known: list[list[bool]]
    group: list[int]
    target: list[float]
    unit: list[float]
    left_h: list[float]
    x: list[list[float]]
    lives: Lives
    growth: Growth | None


def experience_file(past: Experience) -> ExperienceFile:
    """To be written; numbers to six decimals."""
    columns = {name: np.round(getattr(past, name), 6).tolist() for name in ("x", "target", "unit", "left_h")}
    whole = {"known": past.known.tolist(), "group": past.group.tolist(), "features": FEATURES, "version": VERSION}
    scales = {name: getattr(past.scales, name).tolist() for name in ("noise", "level", "end")}
    told = {name: getattr(past, name) for name in ("gear", "names", "stages", "spread", "growth", "lives")}
    told |= {name: getattr(past.scales, name) for name in ("exponent", "base", "steady")}
    return msgspec.convert(columns | whole | scales | told, ExperienceFile)


def experience_of(saved: ExperienceFile) -> Experience:
    """What was written. Raises ValueError if it does not fit this program or itself."""
    if saved.version != VERSION or saved.features != list(FEATURES):
        raise ValueError(f"experience of version {saved.version}: expected {VERSION}; learn again")
    group, x = np.array(saved.group, dtype=np.intp), np.array(saved.x)
    numbers = np.array((saved.target, saved.unit, saved.left_h))
    noise, level, end = (np.array(part) for part in (saved.noise, saved.level, saved.end))
    scales = Scales(saved.exponent, saved.base, noise, level, end, saved.steady)
    fits = (
        x.shape == (group.size, len(FEATURES))
        and numbers.shape == (3, group.size)
        and np.shape(saved.known) == (len(saved.names), len(INDICATORS))
    )
    fits = fits and set(group.tolist()) == set(range(len(saved.names))) and saved.exponent in CLOCKS
    fits = fits and scales.noise.shape == (5,) and scales.level.shape == scales.end.shape == (len(INDICATORS),)
    fits = fits and bool(np.all(scales.level > 0.0) and np.all(numbers[2] >= 0.0))
    fits = fits and all(float(np.max(np.abs(part), initial=0.0)) < LARGEST_TOLD for part in (x, numbers, noise, end))
    fits = fits and NARROWEST <= saved.spread <= WIDEST and 0.0 <= saved.steady <= 1.0
    fits = fits and (saved.growth is None or saved.growth.fits()) and saved.lives.fits(len(saved.names))
    stages = np.array(saved.stages)
    fits = fits and stages.shape == (len(STAGES), len(MEMBERS)) and bool(np.all(stages >= 0.0))
    if not fits or bool(np.any(np.abs(stages.sum(axis=1) - 1.0) > 1e-6)):
        raise ValueError("experience: rows, gears, scales or weights do not fit each other")
    known = np.array(saved.known, dtype=bool)
    told = (x, *numbers, group, known, saved.lives, tuple(map(tuple, saved.stages)), saved.spread, saved.growth)
    return Experience(saved.gear, tuple(saved.names), scales, *told)
