"""How each indicator grows with exposure and at which level gears failed: a forecast by first passage.

What an indicator has grown by since the gear was new, y, follows dy/du = k S (1 + y / S)^q over the exposure u, so
y = S ((1 + (1 - q) k u)^(1 / (1 - q)) - 1). q is below zero for wear that settles, zero for steady wear, one for wear
that feeds on itself and above one for a crack (Paris and Erdogan 1963). Damage may also begin after a healthy time
only, such as a race's first spall: u then counts from that onset. q is the same for all gears of a kind; k, S and the
onset are each gear's own, lognormal over gears and learned from the failed ones by expectation maximisation (random
coefficients: Lu and Meeker 1993). Whichever indicator is first at its level ends the gear (competing risks); of the
others failed gears only tell that theirs is higher.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri

from edge_daemon.prognose.courses import CLOCKS, INDICATORS, LEAST, LifeCourse, Scales, exposure, load_to_come
from edge_daemon.records import Array
from edge_daemon.usage.evidence import WANDER_SPAN
from edge_daemon.usage.ledger import Ledger

POWERS = np.array([-1.5, -0.5, 0.001, 0.5, 0.75, 1.001, 1.25, 1.5, 2.0, 3.0])
"""The power q is one of these: settling wear to a crack's last growth; it may not be zero or one exactly."""
EDGES = np.array([0.0, 0.12, 0.25, 0.38, 0.5, 0.6, 0.68, 0.75, 0.81, 0.86, 0.9, 0.935, 0.965, 0.985, 1.0])
"""Damage began within these shares of the exposure so far; they are finer where little growth was seen."""
LEAST_RATE, MOST_RATE, RATES, LATE_RATES = math.log(0.03), math.log(60.0), 90, 45
"""Logarithms of k, per usual exposure at failure, go from a straight line over all of life to a hundredth of it; a
curve from a late onset is seen too briefly for fine steps."""
_STEPS = [RATES, *[LATE_RATES] * len(EDGES)]
LOG_RATES = np.concatenate([np.linspace(LEAST_RATE, MOST_RATE, n) for n in _STEPS])
"""(k,) of every curve: those that begin with the gear, those of each onset, and those that are still to begin."""
ONSETS = np.repeat([0.0, *(0.5 * (EDGES[1:] + EDGES[:-1])), math.inf], _STEPS)
"""(k,) share of the exposure so far at which each curve began; infinite where it has not."""
_FIRST = np.concatenate(([0], np.cumsum(_STEPS)[:-1]))
START_ONSET = (0.3, math.log(0.5), 0.7)
"""Before failures teach otherwise a healthy time has this chance and its logarithm, over the usual exposure at failure,
this mean and sd (guess); they weigh as one gear."""
LEAST_ONSET_SD = 0.1
"""No few gears are held to begin to fail at more alike exposures than this, in logarithms (guess)."""
WANDERS = (0.003, 0.01, 0.03, 0.1)
"""No trend follows a formula: by one of these shares of its size at failure it wanders about it."""
MOST = 14.0
"""Growth beyond the exponential of this is a crack that has broken through."""
ROUNDS, NEWTON_STEPS, LIMIT_ROUNDS = 30, 6, 60
START_VARIANCE, FEW_VARIANCE, LEAST_VARIANCE = 2.25, 0.25, 0.005
"""Of the logarithms of k and S: at first next to nothing is known; one more gear than were seen has the second; and no
few gears are held to be more alike than the third (guess)."""
WEARING = ("stiffness", "noise")
"""Warmth follows the season and the work as well, which over a life look like growth."""
COUNTS_FROM = 4.0
"""An indicator counts whose upper values at failure are so many times those early in life (guess)."""
EARLY = (0.04, 0.08)
"""At these shares of life hardly anything has worn yet: what is read there is noise."""
UPPER = 0.8
"""Of gears that fail in several ways a fifth is taken to reach the level of one of them (guess)."""
UNSEEN, UNSEEN_SD = 0.3, 0.3
"""Before any failure by an indicator was seen its level at failure is a little above the highest seen, which weighs as
much as so many gears and has this sd in its logarithm (guess)."""
LIMIT_SD = (0.03, 1.0)
"""Levels at failure of a kind of gear differ at least and at most by this, in logarithms."""
LEVEL_SD = 10.0
"""The level of a new gear is unknown by so many times its size at failure, which is as good as flat."""
SEED = 1963


class Growth(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What failed gears teach of their indicators' growth."""

    exponent: float
    """of torque in the exposure"""
    base: float
    noise: list[float]
    steady: float
    """these are of `Scales`"""
    unit: float
    """usual exposure at failure"""
    load_sd: float
    """of the logarithm of the load to come over that expected"""
    laws: list[GrowthLaw]

    @property
    def scales(self) -> Scales:
        """As courses are read for it."""
        one = np.ones(len(INDICATORS))
        return Scales(self.exponent, self.base, np.array(self.noise), one, one, self.steady)

    def fits(self) -> bool:
        """Whether it is one that this program can use."""
        sizes = (self.base, self.unit, *(law.wander for law in self.laws), *(law.limit[1] for law in self.laws))
        sound = min(sizes) > 0.0 and self.load_sd >= 0.0 and 0.0 <= self.steady <= 1.0
        return sound and len(self.noise) == 5 and self.exponent in CLOCKS and all(law.fits() for law in self.laws)


class GrowthLaw(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Of one indicator, told over its size at failure."""

    indicator: int
    size: float
    """its upper level at failure, negative if it falls"""
    wander: float
    log_weight: list[float]
    """of each of `POWERS`"""
    mean: list[tuple[float, float]]
    """of the logarithms of k and S, for each of `POWERS`"""
    cover: list[tuple[float, float, float]]
    """variance of the first, covariance, variance of the second"""
    onset: list[tuple[float, float, float]]
    """chance of a healthy time, mean and sd of its logarithm over `Growth.unit`, for each of `POWERS`"""
    limit: tuple[float, float] = (0.0, 1.0)
    """mean and sd of the logarithm of the level at failure"""

    def fits(self) -> bool:
        """Whether it is one that this program can use."""
        cover = np.array(self.cover)
        rows = {len(self.log_weight), len(self.mean), len(self.cover), len(self.onset)}
        sound = rows == {len(POWERS)} and bool(np.all(cover[:, 0] * cover[:, 2] > cover[:, 1] ** 2))
        least, most = np.min(cover[:, ::2], initial=math.inf), np.max(np.abs([*self.mean, self.limit]), initial=0.0)
        usual = least > LEAST_VARIANCE / 2 and np.max(cover) < MOST and most < MOST and self.limit[1] >= LIMIT_SD[0] / 2
        begins = all(
            0.0 <= p <= 1.0 and abs(mean) < MOST and LEAST_ONSET_SD / 2 < sd < MOST for p, mean, sd in self.onset
        )
        return sound and bool(usual) and begins and 0 <= self.indicator < len(INDICATORS) and self.size != 0.0

    @property
    def belief(self) -> _OverGears:
        """Over gears."""
        return _OverGears(np.array(self.mean), np.array(self.cover), np.array(self.onset))


@dataclass(frozen=True, slots=True)
class _OverGears:
    """Normal over gears in (log k, log S) for each power: (q, 2) means; (q, 3) variance, covariance, variance; (q, 3)
    chance of a healthy time, mean and sd of its logarithm."""

    mean: Array
    cover: Array
    onset: Array

    def log_onset(self, now: float) -> Array:
        """(q, groups) logarithm of the chance of no healthy time, of its end between `EDGES`, and of its end later."""
        chance, mean, sd = (self.onset[:, i, None] for i in range(3))
        below = ndtr((np.log(np.maximum(EDGES, LEAST) * now) - mean) / sd)
        healthy = chance * np.column_stack((np.diff(below), 1.0 - below[:, -1:]))
        return np.asarray(np.log(np.maximum(np.column_stack((1.0 - chance, healthy)), 1e-30)))


def _grown(rate: Array) -> Array:
    """(q, ...) growth over S at k u (...) for every power."""
    power = POWERS.reshape(-1, *[1] * rate.ndim)
    log = np.log(np.maximum(1.0 + (1.0 - power) * rate, 1e-9)) / (1.0 - power)
    return np.asarray(np.expm1(np.minimum(log, MOST)))


class GrowthTrend:
    """One indicator of one gear against every curve: (q, k) each."""

    def __init__(self, course: LifeCourse, row: int, law: GrowthLaw, unit: float, late: bool = True) -> None:
        """Without `late` every curve begins with the gear."""
        count = len(ONSETS) if late else RATES
        self.rates, self.onsets = LOG_RATES[:count], ONSETS[:count]
        clock, level, sd = course.binned(row, law.indicator)
        now, x = float(course.clock[row]) / unit, clock / unit
        gap = np.abs(x[:, None] - x) / (WANDER_SPAN * now)
        cover = np.diag((sd / law.size) ** 2 + 1e-8) + law.wander**2 * np.exp(-gap) + LEVEL_SD**2
        whitener = np.linalg.inv(np.linalg.cholesky(cover))
        seen = whitener @ (level / law.size - np.mean(level / law.size))
        self.now = now
        since = np.maximum(x - np.where(self.onsets < 1.0, self.onsets, 1.0)[:, None] * now, 0.0)
        curves = _grown(np.exp(self.rates)[:, None] * since) @ whitener.T
        self.dot = curves @ seen
        self.precision = np.maximum(np.sum(curves**2, axis=-1), LEAST)
        self.constant = float(np.sum(np.log(np.diagonal(whitener))) - 0.5 * seen @ seen)
        aged = np.exp(self.rates) * np.maximum(1.0 - self.onsets, 0.0) * now
        self.log_grown = np.log(np.maximum(_grown(aged), LEAST))
        speed = self.rates + math.log(now) + POWERS[:, None] * np.logaddexp(0.0, self.log_grown) - self.log_grown
        self.log_speed = np.minimum(speed, MOST)
        """logarithm of d log y / d log u"""

    def weigh(self, belief: _OverGears) -> tuple[Array, Array, Array]:
        """Log weight of each curve, and mean and variance of log S on it (Laplace's approximation)."""
        first, both, second = (belief.cover[:, i, None] for i in range(3))
        off, rest = self.rates - belief.mean[:, :1], second - both**2 / first
        mean = belief.mean[:, 1:] + both / first * off
        fitted = np.maximum(self.dot / self.precision, 1e-6)
        known = self.precision * fitted**2 * (self.dot > 0.0)
        log_size = (known * np.log(fitted) + mean / rest) / (known + 1.0 / rest)
        for _ in range(NEWTON_STEPS):
            size = np.exp(log_size)
            pull = (self.dot - self.precision * size) * size - (log_size - mean) / rest
            log_size = log_size + np.clip(pull / (self.precision * size**2 + 1.0 / rest), -1.0, 1.0)
        size = np.exp(log_size)
        least = self.precision * size**2 + 1.0 / rest
        bend = np.maximum(least - (self.dot - self.precision * size) * size, 0.3 * least)
        log = (self.dot - 0.5 * self.precision * size) * size - 0.5 * (log_size - mean) ** 2 / rest
        rate = -0.5 * off**2 / first
        groups = len(_STEPS) if len(self.rates) > RATES else 1
        total = np.log(np.add.reduceat(np.exp(rate), _FIRST[:groups], axis=1) + 1e-300)
        rate = rate + np.repeat(belief.log_onset(self.now)[:, :groups] - total, _STEPS[:groups], axis=1)
        return log - 0.5 * np.log(rest * bend) + self.constant + rate, log_size, 1.0 / bend


def learn_growth(ledgers: Sequence[Ledger], noise: Array, base_share: float) -> Growth | None:
    """Growth on the clock on which the failed gears' trends are most likely; None if no indicator tells of failure.

    The clock is found by curves that begin with the gear: a free onset makes up for a wrong one.
    """
    best: tuple[float, Growth, list[LifeCourse]] | None = None
    used: list[tuple[int, float]] = []
    for exponent in CLOCKS:
        unit = float(np.median([np.sum(exposure(ledger, exponent)) for ledger in ledgers]))
        empty = Growth(exponent, base_share * unit, noise.tolist(), 0.0, unit, 0.0, [])
        courses = [LifeCourse(ledger, empty.scales) for ledger in ledgers]
        used = used or _telling(courses)
        score = sum(_likeliest(courses, i, size, unit, late=False)[0] for i, size in used)
        if used and (best is None or score > best[0]):
            best = score, empty, courses
    if best is None:
        return None
    _, empty, courses = best
    laws = [_likeliest(courses, i, size, empty.unit)[1] for i, size in used]
    return _finished(msgspec.structs.replace(empty, laws=laws), ledgers)


def _likeliest(
    courses: Sequence[LifeCourse], indicator: int, size: float, unit: float, late: bool = True
) -> tuple[float, GrowthLaw]:
    laws = [GrowthLaw(indicator, size, wander, [], [], [], []) for wander in WANDERS]
    return max((_learned(courses, law, unit, late) for law in laws), key=lambda one: one[0])


def learned_again(growth: Growth, ledgers: Sequence[Ledger]) -> Growth:
    """The same indicators on the same clock, learned from other gears."""
    courses = [LifeCourse(ledger, growth.scales) for ledger in ledgers]
    laws = [_learned(courses, law, growth.unit)[1] for law in growth.laws]
    return _finished(msgspec.structs.replace(growth, laws=laws), ledgers)


def _finished(growth: Growth, ledgers: Sequence[Ledger]) -> Growth:
    """With levels at failure, and with what the past tells of the load to come."""
    courses = [LifeCourse(ledger, growth.scales) for ledger in ledgers]
    steady, load_sd = load_to_come(courses)
    laws = [
        msgspec.structs.replace(law, limit=limit)
        for law, limit in zip(growth.laws, _limits(courses, growth), strict=True)
    ]
    return msgspec.structs.replace(growth, laws=laws, steady=steady, load_sd=load_sd)


def _telling(courses: Sequence[LifeCourse]) -> list[tuple[int, float]]:
    """Places in `INDICATORS` of those that all gears have and that tell of failure, each with its upper level there."""
    last = [len(course.clock) - 1 for course in courses]
    known = np.all([course.known(row) for course, row in zip(courses, last, strict=True)], axis=0)
    ends = np.array([course.read(row)[:, -1] for course, row in zip(courses, last, strict=True)])
    early = [course.read(int(share * row))[:, -1] for course, row in zip(courses, last, strict=True) for share in EARLY]
    sign = np.where(np.mean(ends, axis=0) < 0.0, -1.0, 1.0)
    size = np.quantile(sign * ends, UPPER, axis=0)
    wears = np.array([name in WEARING for name in INDICATORS])
    tells = wears & known & (size > COUNTS_FROM * np.quantile(np.abs(early), UPPER, axis=0)) & (size > 1e-4)
    return [(int(i), float(sign[i] * size[i])) for i in np.flatnonzero(tells)]


def _learned(courses: Sequence[LifeCourse], law: GrowthLaw, unit: float, late: bool = True) -> tuple[float, GrowthLaw]:
    """How likely the trends are, and the law with its belief over gears and the weight of each power."""
    trends = [GrowthTrend(course, len(course.clock) - 1, law, unit, late) for course in courses]
    count, powers = len(trends), len(POWERS)
    start = np.tile(START_ONSET, (powers, 1))
    belief = _OverGears(np.zeros((powers, 2)), np.tile([START_VARIANCE, 0.0, START_VARIANCE], (powers, 1)), start)
    likely = np.zeros(powers)
    for _ in range(ROUNDS):
        mean, second, likely = np.zeros((powers, 2)), np.zeros((powers, 3)), np.zeros(powers)
        begun = start[:, :1] * np.column_stack((np.ones(powers), start[:, 1], start[:, 1] ** 2 + start[:, 2] ** 2))
        for trend in trends:
            log, size, variance = trend.weigh(belief)
            top = np.max(log, axis=1)
            weight = np.exp(log - top[:, None])
            total = np.sum(weight, axis=1)
            likely += top + np.log(total)
            weight /= total[:, None]
            begun += _begun(weight, trend.onsets, trend.now)
            rate = np.broadcast_to(trend.rates, size.shape)
            mean += np.stack([np.sum(weight * part, axis=1) for part in (rate, size)], axis=1) / count
            parts = (rate**2, rate * size, size**2 + variance)
            second += np.stack([np.sum(weight * part, axis=1) for part in parts], axis=1) / count
        spread = second - np.stack((mean[:, 0] ** 2, mean[:, 0] * mean[:, 1], mean[:, 1] ** 2), axis=1)
        sound = np.array([1.0, 0.0, 1.0])
        cover = (count * spread + FEW_VARIANCE * sound) / (count + 1) + LEAST_VARIANCE * sound
        belief = _OverGears(mean, cover, _onset(begun, count + 1))
    told = msgspec.structs.replace(
        law,
        log_weight=(likely - np.max(likely)).tolist(),
        mean=[(float(a), float(b)) for a, b in belief.mean],
        cover=[(float(a), float(b), float(c)) for a, b, c in belief.cover],
        onset=[(float(a), float(b), float(c)) for a, b, c in belief.onset],
    )
    return float(np.max(likely)), told


def _begun(weight: Array, onsets: Array, now: float) -> Array:
    """(q, 3) chance that a failed gear had a healthy time, and of its logarithm the first two moments times that."""
    seen = (onsets > 0.0) & (onsets < 1.0)
    log, share = np.log(onsets[seen] * now), weight[:, seen]
    return np.stack([np.sum(share * log**n, axis=1) for n in range(3)], axis=1)


def _onset(begun: Array, count: int) -> Array:
    """(q, 3) as `GrowthLaw.onset`, of sums over gears."""
    mean = begun[:, 1] / begun[:, 0]
    spread = np.maximum(begun[:, 2] / begun[:, 0] - mean**2, 0.0)
    return np.column_stack((begun[:, 0] / count, mean, np.sqrt(spread + LEAST_ONSET_SD**2)))


def _limits(courses: Sequence[LifeCourse], growth: Growth) -> list[tuple[float, float]]:
    """Mean and sd of each indicator's logarithmic level at failure, where any of them may have ended the gear."""
    ends = np.array([[_end(course, law, growth.unit) for law in growth.laws] for course in courses])
    level, speed = ends[..., 0], ends[..., 1]
    mean, sd = np.quantile(level, UPPER, axis=0), np.full(len(growth.laws), UNSEEN_SD)
    before = np.max(level, axis=0) + UNSEEN_SD * UNSEEN
    for _ in range(LIMIT_ROUNDS):
        off = (level - mean) / sd
        alive = log_ndtr(-off)
        log = -0.5 * off**2 - np.log(sd) + speed - alive
        chance = np.exp(log - np.max(log, axis=1, keepdims=True))
        chance /= np.sum(chance, axis=1, keepdims=True)
        hazard = np.exp(-0.5 * off**2 - alive) / math.sqrt(2.0 * math.pi)
        beyond, around = mean + sd * hazard, sd**2 * np.maximum(1.0 + off * hazard - hazard**2, 1e-3)
        first = np.sum(chance * level + (1.0 - chance) * beyond, axis=0) + UNSEEN * before
        second = np.sum(chance * level**2 + (1.0 - chance) * (beyond**2 + around), axis=0)
        second += UNSEEN * (before**2 + UNSEEN_SD**2)
        mean = first / (len(level) + UNSEEN)
        sd = np.clip(np.sqrt(np.maximum(second / (len(level) + UNSEEN) - mean**2, 0.0)), *LIMIT_SD)
    return [(float(a), float(b)) for a, b in zip(mean, sd, strict=True)]


def _weighed(trend: GrowthTrend, law: GrowthLaw) -> tuple[Array, Array, Array]:
    log, size, variance = trend.weigh(law.belief)
    return log + np.array(law.log_weight)[:, None], size, variance


def _end(course: LifeCourse, law: GrowthLaw, unit: float) -> tuple[float, float]:
    """Logarithms of the level that a failed gear had reached, and of how fast it grew there."""
    trend = GrowthTrend(course, len(course.clock) - 1, law, unit)
    log, size, _ = _weighed(trend, law)
    weight = np.exp(log - np.max(log))
    weight /= np.sum(weight)
    return float(np.sum(weight * (size + trend.log_grown))), float(np.sum(weight * trend.log_speed))


def first_passage_h(growth: Growth, course: LifeCourse, row: int, count: int) -> tuple[Array, Array]:
    """(count,) remaining hours of an ensemble, and which of `INDICATORS` ends it; empty if none of them is known.

    The course is read by `Growth.scales`.
    """
    rng, now = np.random.default_rng(SEED), float(course.clock[row]) / growth.unit
    known = course.known(row)
    laws = [law for law in growth.laws if known[law.indicator]]
    if not laws:
        return np.empty(0), np.empty(0)
    ends = np.array([_drawn_ends(rng, GrowthTrend(course, row, law, growth.unit), law, count) for law in laws])
    left = np.maximum(np.min(ends, axis=0) - now, 1e-3 * now) * growth.unit * course.hours_a_unit(row)
    left *= np.exp(growth.load_sd * ndtri((rng.permutation(count) + 0.5) / count))
    return left, np.array([law.indicator for law in laws])[np.argmin(ends, axis=0)]


def _drawn_ends(rng: np.random.Generator, trend: GrowthTrend, law: GrowthLaw, count: int) -> Array:
    """(count,) exposures at which one indicator reaches its level at failure, given that it has not."""
    log, size, variance = _weighed(trend, law)
    mean, sd = law.limit
    log = log + log_ndtr((mean - size - trend.log_grown) / sd)
    below = np.cumsum(np.exp(log - np.max(log)).ravel())
    picked = np.searchsorted(below, (rng.permutation(count) + rng.uniform(size=count)) / count * below[-1])
    power, rate = np.unravel_index(np.minimum(picked, below.size - 1), log.shape)
    log_size = size[power, rate] + np.sqrt(variance[power, rate]) * rng.normal(size=count)
    alive = ndtr((mean - log_size - trend.log_grown[power, rate]) / sd)
    limit = mean - sd * ndtri(np.maximum(alive * rng.uniform(size=count), 1e-300))
    q, grown = POWERS[power], np.minimum(limit - log_size, 2.0 * MOST)
    since = np.expm1((1.0 - q) * np.logaddexp(0.0, grown)) / (1.0 - q) / np.exp(LOG_RATES[rate])
    _, middle, spread = law.belief.onset[power].T
    passed = ndtr((math.log(trend.now) - middle) / spread)
    later = np.exp(middle + spread * ndtri(np.minimum(passed + (1.0 - passed) * rng.uniform(size=count), 1.0 - 1e-9)))
    return np.asarray(since + np.where(ONSETS[rate] < 1.0, ONSETS[rate] * trend.now, later))
