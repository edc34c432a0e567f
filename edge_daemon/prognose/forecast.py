"""How long a gear still lives: one posterior from the maker's data, the load so far and the observed wear.

Two risks compete: fatigue of the flexspline and wear of the wave generator bearing, each a clock of use that ends at
an unknown capacity. Fatigue shows as stiffness lost, bearing wear as noise gained; in some gears one wear shows in
both. Each end between now and a century is weighed by the maker's law and by how well curves of wear that reach it fit
the trends (`wear`); the posterior over both ends is drawn as an ensemble of equally likely gears.
"""

from __future__ import annotations

import functools
import tomllib
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.random import Generator
from scipy.special import ndtr, ndtri

from edge_daemon.prognose.courses import LifeCourse
from edge_daemon.prognose.experience import MOST_LIFE_H, Experience, grown_h, outlived_h, remaining_h, weights_now
from edge_daemon.prognose.wear import Belief, Curves, curves_of, log_sum, weigh
from edge_daemon.records import Array
from edge_daemon.usage.bearing import Weibull, bearing_law
from edge_daemon.usage.evidence import Evidence, TrendEvidence
from edge_daemon.usage.gears import Gear
from edge_daemon.usage.ledger import EXPONENTS, Ledger

PARTICLES = 2000
FEWEST_DRAWN = 20
"""A member that would be drawn less often, by a weight of a hundredth between two stages, is left out (guess)."""
SEED = 1993
SOONEST, LATEST = 0.01, 100.0
"""Between these ratios of remaining to used life the ends stand close."""
ENDS, LATER_ENDS = 52, 10
"""An end a step is a fifth of the remaining life; beyond `LATEST` a trend says nothing more."""
CLOCKS = tuple(EXPONENTS.index(m) for m in (3.0, 5.0, 9.0))
"""These exponents of torque in fatigue are held possible, equally: a soft contact, the bearing's kind, steel."""
SAME_CLOCK = 0.005
"""Clocks that never differ by more than this share of the life so far are one."""
FATIGUE_NOISE, FATIGUE_NOISE_SD = 1.0, 0.7
"""Each unit of relative stiffness loss brings this logarithm of noise where the bearing is another wear (guess)."""
SMOOTHED_OVER = 5
"""The stiffness trend is averaged over so many rows where it explains noise."""


@dataclass(frozen=True, slots=True)
class FailureKind:
    """A kind of gear and how its wear shows."""

    fatigue: tuple[float, float]
    """mean and sd of the logarithm of its fatigue life over that of the maker's law"""
    stiffness: Belief
    noise: Belief
    alone: float
    """chance that one wear shows in stiffness and noise alike"""
    name: str = "learned"


@dataclass(frozen=True, slots=True)
class Prior:
    """What is believed of a gear before its own history speaks."""

    kinds: tuple[FailureKind, ...]
    doubt: float
    """chance, for each part, that these beliefs say nothing of this gear's life; see `DOUBT_AFTER_H`"""
    experience: Experience | None = None
    """courses of failed gears, pooled with these beliefs by `foresee`"""


NAMES = ("feedback", "log_rise", "log_size")
"""A `Belief` holds these numbers, in this order."""
FATIGUE = (0.0, 0.8)
"""The fatigue life over the maker's is believed so before histories of one's own teach otherwise (guess; see
`learn`)."""
DOUBT = 0.9
DOUBT_AFTER_H = 1000.0
"""For each part there is a chance that the maker's law says nothing of this gear (mounting, lubricant, an unknown
load): 0 for a new gear, `DOUBT` for an old one, half of it at this age, and only if its condition is measured. Then
nothing is known but the age, and a life twice the present age is as likely as not (Gott 1993): density ~ T^-2 (guess,
checked by the coverage that the bench of life measures over unlike families of gears)."""


def _belief(mean: Array, sd: Array) -> Belief:
    return Belief(np.asarray(mean, dtype=float), np.diag(np.square(np.asarray(sd, dtype=float))))


BROAD = Prior(
    (
        FailureKind(
            FATIGUE,
            _belief(np.array([1.5, 0.5, -1.65]), np.array([2.0, 0.6, 0.5])),
            _belief(np.array([1.0, 0.5, 0.1]), np.array([2.0, 0.6, 0.7])),
            0.5,
        ),
    ),
    DOUBT,
)
"""Learning from failed gears begins with one wide kind of gear."""


def _makers() -> Prior:
    """The kinds of `kinds.toml`, equally likely; the fatigue life is the maker's law's, in doubt."""
    table = tomllib.loads(resources.files(__package__).joinpath("kinds.toml").read_text())
    kinds = []
    for name, row in table.items():
        stiffness, noise = (
            Belief(np.array(row[part]["mean"]), np.array(row[part]["cover"])) for part in ("stiffness", "noise")
        )
        kinds.append(FailureKind(FATIGUE, stiffness, noise, row["alone"], name))
    return Prior(tuple(kinds), DOUBT)


MAKERS = _makers()
"""This is believed of a gear whose like has never been seen to fail."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """The posterior as equally likely gears, (n,) each."""

    remaining_h: Array
    fatigue_used: Array
    """share of the flexspline's capacity that is used"""
    bearing_used: Array
    bearing_first: Array
    """1 where the bearing fails before the flexspline"""

    def quantile_h(self, probability: float) -> float:
        """Remaining life [h] that the fraction `probability` of such gears does not reach."""
        return float(np.quantile(self.remaining_h, probability))

    def failure_probability(self, within_h: float) -> float:
        """Chance of failure in the next `within_h` hours."""
        return float(np.mean(self.remaining_h <= within_h))


@dataclass(frozen=True, slots=True)
class _Case:
    """One explanation of what is seen, with its posterior over each part's end, (ends,) log weights."""

    log_weight: float
    kind: FailureKind
    clock: int
    """which of `EXPONENTS`"""
    fatigue: Array | None
    """None where only the prior speaks"""
    bearing: Array | None


def forecast(
    gear: Gear, evidence: Evidence, prior: Prior = MAKERS, seed: int = SEED, particles: int = PARTICLES
) -> Forecast:
    """The posterior of a gear's end. Deterministic for a given seed."""
    ends = Ends(gear, evidence, prior.doubt)
    rng = np.random.default_rng(seed)
    cases = _cases(ends, Fits(evidence, ends.left), prior)
    log_weight = np.array([case.log_weight for case in cases])
    share = np.exp(log_weight - log_sum(log_weight, 0))
    counts = np.diff(np.floor(np.cumsum(np.concatenate(([rng.uniform()], particles * share)))).astype(int))
    drawn = [_draw(ends, case, int(count), rng) for case, count in zip(cases, counts, strict=True) if count]
    fatigue_h, bearing_h, rate = (np.concatenate(column) for column in zip(*drawn, strict=True))
    fatigue_left = np.minimum(fatigue_h / np.maximum(rate, 1e-9), 2.0 * MOST_LIFE_H)
    bearing_left = np.minimum(bearing_h / max(evidence.rated_rate, 1e-9), MOST_LIFE_H)
    return Forecast(
        np.maximum(np.minimum(fatigue_left, bearing_left), 0.0),
        evidence.age_h / (evidence.age_h + fatigue_h),
        evidence.rated_now_h / (evidence.rated_now_h + bearing_h),
        np.asarray(bearing_left < fatigue_left, dtype=float),
    )


def foresee(
    gear: Gear, ledger: Ledger, evidence: Evidence, prior: Prior, before_h: float = 0.0, load_factor: float = 1.0
) -> Forecast:
    """The forecast by a prior with experience: ensembles of its members, pooled by their weights.

    Which part fails first, and what is used of the other, only the physical members can tell.
    """
    past = prior.experience
    if past is None or not len(ledger):
        return forecast(gear, evidence, prior)
    course = LifeCourse(ledger, past.scales, before_h)
    courses, growth, lives, law, makers = weights_now(past, course)
    physical = forecast(gear, evidence, prior if law >= makers else MAKERS)
    parts = [(round(law * PARTICLES), prior), (round(makers * PARTICLES), MAKERS)]
    left = [forecast(gear, evidence, one, particles=n).remaining_h for n, one in parts if n >= FEWEST_DRAWN]
    if growth * PARTICLES >= FEWEST_DRAWN:
        grown, _ = grown_h(past, ledger, before_h, load_factor, round(growth * PARTICLES))
        left.append(grown)
        courses += 0.0 if grown.size else growth
    for weight, told in ((courses, remaining_h), (lives, outlived_h)):
        if (count := round(weight * PARTICLES)) >= FEWEST_DRAWN:
            left.append(told(past, course, load_factor, (np.arange(count) + 0.5) / count))
    pool = np.maximum(np.concatenate(left), 1e-9)
    middle = float(np.median(pool))
    return _coupled(physical, np.clip(middle * (pool / middle) ** past.spread, 0.0, MOST_LIFE_H), evidence)


def _coupled(physical: Forecast, left_h: Array, evidence: Evidence) -> Forecast:
    """Remaining lives beside the physical ensemble, rank by rank; what fails first is used as its age says."""
    order = np.argsort(physical.remaining_h)
    pick = order[(np.arange(left_h.size) * order.size) // left_h.size]
    left_h = np.sort(left_h)
    used, bearing = evidence.age_h / np.maximum(evidence.age_h + left_h, 1e-9), physical.bearing_first[pick] > 0.5
    return Forecast(
        left_h,
        np.where(bearing, np.minimum(physical.fatigue_used[pick], used), used),
        np.where(bearing, used, np.minimum(physical.bearing_used[pick], used)),
        physical.bearing_first[pick],
    )


class Ends:
    """The ends held possible, as remaining over used life, and how likely the maker's law has each."""

    def __init__(self, gear: Gear, evidence: Evidence, doubt: float) -> None:
        self.evidence = evidence
        self.bearing: Weibull = bearing_law(gear)
        self.fatigue_h = 1.0 / max(evidence.fatigue_rate, 0.1 / MOST_LIFE_H)
        """fatigue life by the maker's law"""
        self.age_h = max(evidence.age_h, 1e-3)
        self.rated_h = max(evidence.rated_now_h, 1e-6)
        last = max(10.0 * LATEST, MOST_LIFE_H / self.age_h)
        near = np.geomspace(SOONEST, LATEST, ENDS)
        self.left = np.concatenate((near, np.geomspace(LATEST, last, LATER_ENDS + 1)[1:]))
        middle = np.sqrt(self.left[1:] * self.left[:-1])
        self.edges = np.concatenate(([SOONEST / 100.0], middle, [2.0 * last]))
        """(ends + 1,) between them"""
        self.doubt = doubt * evidence.age_h / (evidence.age_h + DOUBT_AFTER_H)

    def log_fatigue(self, kind: FailureKind) -> Array:
        """(ends,) logarithm of the chance of each, given the life so far."""
        mean, sd = self._fatigue(kind)
        z = (mean + np.log(self.fatigue_h / self.age_h) - np.log1p(self._edges)) / sd
        alive = ndtr(z)
        law = -np.diff(alive) / max(float(alive[0]), 1e-300)
        return self._doubted(law)

    def log_bearing(self) -> Array:
        """(ends,) the same of the bearing."""
        power = (self.rated_h / self.bearing.scale_h) ** self.bearing.shape
        alive = np.exp(-power * np.expm1(self.bearing.shape * np.log1p(self._edges)))
        return self._doubted(-np.diff(alive))

    @property
    def _edges(self) -> Array:
        return np.concatenate(([0.0], self.edges[1:-1], [np.inf]))

    def _doubted(self, law: Array) -> Array:
        short = -np.diff(1.0 / (1.0 + self._edges))
        return np.log(np.maximum((1.0 - self.doubt) * law + self.doubt * short, 1e-300))

    def _fatigue(self, kind: FailureKind) -> tuple[float, float]:
        """Mean and sd of the logarithm of the fatigue life over that of the maker's law at this gear's stiffness."""
        return kind.fatigue[0], float(np.hypot(kind.fatigue[1], self.evidence.fatigue_log_sd))

    def draw_fatigue(self, kind: FailureKind, uniform: Array) -> Array:
        """(n,) hours left to a flexspline of which only the maker's law tells."""
        mean, sd = self._fatigue(kind)
        mean += np.log(self.fatigue_h)
        alive = ndtr((mean - np.log(self.age_h)) / sd)
        life = np.exp(mean - sd * ndtri(np.maximum(alive * uniform, 1e-300)))
        return np.asarray(np.maximum(life - self.evidence.age_h, 1e-6 * self.age_h))

    def draw_bearing(self, uniform: Array) -> Array:
        """(n,) rated hours left to a bearing of which only the maker's law tells."""
        return np.maximum(self.bearing.remaining(self.evidence.rated_now_h, uniform), 1e-9)


class Fits:
    """The curves of wear beside the trends of a gear, each computed once."""

    def __init__(self, evidence: Evidence, left: Array) -> None:
        self.evidence = evidence
        self.left = left
        self._known: list[tuple[Array, dict[str, Curves]]] = []

    def stiffness(self, clock: int) -> Curves | None:
        """By fatigue, on the clock of one of `EXPONENTS`."""
        trend = self.evidence.stiffness
        return None if trend is None else self._curves("stiffness", trend, self._strain(clock))

    def noise_of_fatigue(self, clock: int) -> Curves | None:
        """Noise as the same wear makes it."""
        trend = self.evidence.noise
        return None if trend is None else self._curves("noise", trend, self._strain(clock))

    @functools.cached_property
    def noise_of_bearing(self) -> Curves | None:
        """Noise as the bearing makes it, beside some that fatigue makes."""
        trend, used = self.evidence.noise, self.evidence.rated_h
        if trend is None or self.evidence.rated_now_h <= 0.0:
            return None
        lost = self._lost(trend)
        apart = TrendEvidence(trend.rows, trend.y - FATIGUE_NOISE * lost, trend.whitener, trend.relative)
        return curves_of(apart, used / self.evidence.rated_now_h, self.left, lost, FATIGUE_NOISE_SD)

    def _lost(self, trend: TrendEvidence) -> Array:
        """(k,) smoothed stiffness loss at the rows of another trend; 0 where it is not known."""
        stiffness = self.evidence.stiffness
        if stiffness is None:
            return np.zeros(trend.rows.size)
        half = SMOOTHED_OVER // 2
        padded = np.pad(stiffness.y, half, mode="edge")
        smooth = np.convolve(padded, np.full(SMOOTHED_OVER, 1.0 / SMOOTHED_OVER), mode="valid")
        return np.asarray(np.interp(trend.rows, stiffness.rows, smooth))

    def _strain(self, clock: int) -> Array:
        return np.asarray(self.evidence.strain_h[clock] / max(self.evidence.age_h, 1e-9))

    def _curves(self, name: str, trend: TrendEvidence, used: Array) -> Curves:
        for other, curves in self._known:
            if np.max(np.abs(other - used)) < SAME_CLOCK:
                if name not in curves:
                    curves[name] = curves_of(trend, other, self.left)
                return curves[name]
        self._known.append((used, {name: curves_of(trend, used, self.left)}))
        return self._known[-1][1][name]


def _cases(ends: Ends, fits: Fits, prior: Prior) -> list[_Case]:
    """All explanations of what is seen with their posteriors, for every kind of gear and every clock."""
    bearing_prior = ends.log_bearing()
    known: dict[tuple[int, int], Array] = {}

    def told_by(curves: Curves | None, belief: Belief) -> Array | None:
        if curves is None:
            return None
        key = (id(curves), id(belief))
        if key not in known:
            known[key] = weigh(curves, belief).ends()
        return known[key]

    cases = []
    for kind in prior.kinds:
        fatigue_prior = ends.log_fatigue(kind)
        noise = told_by(fits.noise_of_bearing, kind.noise)
        bearing = None if noise is None else bearing_prior + noise
        heard = 0.0 if bearing is None else float(log_sum(bearing, 0))
        for clock in CLOCKS:
            seen = told_by(fits.stiffness(clock), kind.stiffness)
            fatigue = None if seen is None else fatigue_prior + seen
            worn = 0.0 if fatigue is None else float(log_sum(fatigue, 0))
            if kind.alone < 1.0:
                cases.append(_Case(np.log(1.0 - kind.alone) + worn + heard, kind, clock, fatigue, bearing))
            same = told_by(fits.noise_of_fatigue(clock), kind.noise)
            if kind.alone > 0.0:
                both = fatigue_prior + (0.0 if seen is None else seen) + (0.0 if same is None else same)
                alone = None if seen is None and same is None else both
                told = 0.0 if alone is None else float(log_sum(alone, 0))
                cases.append(_Case(np.log(kind.alone) + told, kind, clock, alone, None))
    return cases


def _draw(ends: Ends, case: _Case, count: int, rng: Generator) -> tuple[Array, Array, Array]:
    """Hours left to the flexspline at the load so far and rated hours left to the bearing, and the rate of the strain
    clock to come, (count,) each."""
    first, second = ((rng.permutation(count) + rng.uniform(size=count)) / count for _ in range(2))
    if case.fatigue is None:
        fatigue_h = ends.draw_fatigue(case.kind, first)
    else:
        fatigue_h = ends.age_h * _spread(case.fatigue, ends.edges, first)
    bearing_h = ends.draw_bearing(second)
    if case.bearing is not None:
        bearing_h = ends.rated_h * _spread(case.bearing, ends.edges, second)
    return fatigue_h, bearing_h, np.full(count, ends.evidence.strain_rate[case.clock])


def _spread(log_weight: Array, edges: Array, uniform: Array) -> Array:
    """(n,) draws of remaining over used life from the ends' weights, evenly spread between edges."""
    weight = np.exp(log_weight - log_weight.max())
    below = np.concatenate(([0.0], np.cumsum(weight)))
    return np.exp(np.interp(uniform, below / below[-1], np.log(edges)))
