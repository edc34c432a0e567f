"""What histories of failed gears teach: the prior of the forecast, and the constants of the damage law.

`learn_life` keeps their courses (`experience`) beside the physical prior, and weighs both and the maker's by how well
each forecasts the gears that were left out. The physical prior is learned by expectation maximisation over gears
(empirical Bayes): each failed gear's posterior is weighed with the prior so far and its known end; the pooled mean and
spread are the next prior.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import msgspec
import numpy as np
from scipy.special import log_ndtr, ndtr

from edge_daemon.errors import BadInput
from edge_daemon.prognose.courses import LifeCourse
from edge_daemon.prognose.experience import (
    BASE_SHARE,
    LEFT,
    MOST_LIFE_H,
    STAGES,
    ExperienceFile,
    experience_file,
    experience_of,
    learn_courses,
    noise_weights,
    weighed,
)
from edge_daemon.prognose.forecast import BROAD, CLOCKS, MAKERS, NAMES, Ends, FailureKind, Fits, Prior, forecast
from edge_daemon.prognose.growth import Growth, first_passage_h, learn_growth, learned_again
from edge_daemon.prognose.wear import SHAPES, Belief, Curves, Weights, log_sum, weigh
from edge_daemon.records import Array
from edge_daemon.usage.damage import CYCLES_PER_TURN, MOST_LOSS
from edge_daemon.usage.evidence import Evidence, evidence_of
from edge_daemon.usage.gears import Gear
from edge_daemon.usage.ledger import Ledger, rows_of

ROUNDS = 20
BEYOND = 0.8
"""This share of a step of expectation maximisation is added to it: see `_further`."""
LEAST_SD = 0.03
"""No belief is held more firmly than this, however alike the few gears were."""
DOUBT_LEARNED = 0.03
"""A new gear is unlike all that were learned from with this chance (guess)."""
FEWEST = 5
"""Fewer failed gears mislead more than they teach."""
LEAST_OWN = 1e9
"""A covariance of a larger condition number leaves a parameter no scatter of its own within rounding."""
UNSEEN = 0.03
"""What is believed before any failure has been seen weighs as much as this many failures."""
UNKNOWN_LIFE = (0.0, 3.0)
"""The logarithm of the fatigue life over the maker's has this mean and sd to begin with: next to nothing is known."""
END_NOW = np.zeros(1)
FOLDS, FOLD_ROUNDS = 3, 4
"""The law is weighed on gears that it did not learn from, in so many parts; a few rounds come close enough for that."""
MOST_WEIGHED = 15
"""Members of the forecast are weighed on so many gears, each at every one of `STAGES`."""
LEVELS, DRAWN = (np.arange(24) + 0.5) / 24, 480
"""Forecasts are compared as quantiles at these levels, of so many draws."""


class LearnError(BadInput):
    """One line: what is missing or wrong with the histories."""


@dataclass(frozen=True, slots=True)
class FailedGear:
    """A history, hourly, to its end: failure, or for the damage law also the end of observation."""

    time_h: Array
    columns: Mapping[str, Array]
    failed: bool = True
    """by fatigue of the flexspline, where the damage law is learned"""


def _ledgers(gear: Gear, lives: Sequence[FailedGear]) -> list[Ledger]:
    """Of those that failed."""
    failed = [life for life in lives if life.failed]
    if len(failed) < FEWEST:
        raise LearnError(f"{len(failed)} failed gears: expected at least {FEWEST} to learn from")
    return [rows_of(gear, life.time_h, _hours(life.time_h), life.columns) for life in failed]


def learn_life(gear: Gear, lives: Sequence[FailedGear], names: Sequence[str] = (), rounds: int = ROUNDS) -> Prior:
    """The prior with the failed gears' courses, each member weighed. Raises `LearnError` for fewer than five."""
    ledgers = _ledgers(gear, lives)
    ended = [Ended(gear, evidence_of(ledger)) for ledger in ledgers]
    kind = learn_kind(ended, rounds)
    past = learn_courses(gear.name, names or [str(i + 1) for i in range(len(ledgers))], ledgers)
    growth = learn_growth(ledgers, noise_weights(ledgers), BASE_SHARE)
    taught = [[i for i in range(len(ledgers)) if i % FOLDS != fold] for fold in range(FOLDS)]
    folds = [
        Prior((_maximised([ended[i] for i in some], FOLD_ROUNDS, kind.alone)[0],), DOUBT_LEARNED) for some in taught
    ]
    grown = [None if growth is None else learned_again(growth, [ledgers[i] for i in some]) for some in taught]
    chosen = np.unique(np.linspace(0, len(ledgers) - 1, MOST_WEIGHED).astype(int))
    at = [int(np.argmin(np.abs(np.log(LEFT) - stage))) for stage in STAGES]
    rows = [len(LEFT) * int(i) + instant for i in chosen for instant in at]
    told: list[list[Array]] = [[], [], [], []]
    for row in rows:
        gear_at = row // len(LEFT)
        ledger = _until(ledgers[gear_at], float(past.left_h[row]))
        told[0].append(_grown_h(grown[gear_at % FOLDS], ledger))
        course = LifeCourse(ledger, past.scales)
        told[1].append(past.lives.left_h(course, len(course.clock) - 1, LEVELS, gear_at))
        evidence = evidence_of(ledger)
        for quantiles, prior in zip(told[2:], (folds[gear_at % FOLDS], MAKERS), strict=True):
            quantiles.append(np.quantile(forecast(gear, evidence, prior).remaining_h, LEVELS))
    return Prior((kind,), DOUBT_LEARNED, weighed(replace(past, growth=growth), told, rows, LEVELS))


def _grown_h(growth: Growth | None, ledger: Ledger) -> Array:
    """Remaining hours at `LEVELS` by the growth of each indicator; a century where none was known."""
    if growth is None:
        return np.full(LEVELS.size, MOST_LIFE_H)
    course = LifeCourse(ledger, growth.scales)
    hours, _ = first_passage_h(growth, course, len(course.clock) - 1, DRAWN)
    return np.quantile(hours, LEVELS) if hours.size else np.full(LEVELS.size, MOST_LIFE_H)


def _until(ledger: Ledger, left_h: float) -> Ledger:
    """The ledger as it stood so many hours before its end."""
    rows = max(int(np.sum(np.cumsum(ledger.hours) <= float(np.sum(ledger.hours)) - left_h + 1e-6)), 1)
    return Ledger(*(getattr(ledger, field.name)[..., :rows] for field in fields(Ledger)))


def learn_kind(ended: Sequence[Ended], rounds: int = ROUNDS) -> FailureKind:
    """The kind of gear that explains these lives best: with one wear that shows in both conditions, or with two."""
    kinds = [_maximised(ended, rounds, alone) for alone in (0.0, 1.0)]
    apart, one = (score for _, score in kinds)
    return kinds[one > apart][0]


def _maximised(ended: Sequence[Ended], rounds: int, alone: float) -> tuple[FailureKind, float]:
    """A kind by expectation maximisation, and its log likelihood.

    Which part failed and what its curve was are weighed by the kind so far for every gear; the weighted mean and spread
    are the next one.
    """
    start = BROAD.kinds[0]
    kind = replace(start, fatigue=UNKNOWN_LIFE, alone=alone)
    score = -np.inf
    for _ in range(rounds):
        sums = [_Sum(len(NAMES)) for _ in range(2)]
        for part, belief in zip(sums, (start.stiffness, start.noise), strict=True):
            part.believe(belief)
        life = _Sum(1)
        score = sum(one.add(kind, (sums[0], sums[1]), life) for one in ended)
        stiffness, noise = (
            _further(old, Belief(part.mean, part.cover))
            for old, part in zip((kind.stiffness, kind.noise), sums, strict=True)
        )
        mean, sd = float(life.mean[0]), float(np.sqrt(life.cover[0, 0]))
        kind = FailureKind((mean, sd), stiffness, noise, alone)
    return kind, score


def _further(old: Belief, new: Belief) -> Belief:
    """A step of expectation maximisation lengthened by `BEYOND`: it converges slowly where gears are more alike than
    each of them is known."""
    mean, cover = new.mean + BEYOND * (new.mean - old.mean), new.cover + BEYOND * (new.cover - old.cover)
    sound = float(np.min(np.linalg.eigvalsh(cover))) > 0.5 * float(np.min(np.linalg.eigvalsh(new.cover)))
    return Belief(mean, cover) if sound else new


class _Sum:
    """Weighted mean and covariance."""

    def __init__(self, size: int) -> None:
        self.weight, self.first, self.second = 0.0, np.zeros(size), np.zeros((size, size))

    def believe(self, belief: Belief) -> None:
        """Takes in what is believed before, as `UNSEEN` gears."""
        self.weight += UNSEEN
        self.first = self.first + UNSEEN * belief.mean
        self.second = self.second + UNSEEN * (belief.cover + np.outer(belief.mean, belief.mean))

    def add(self, weight: Array, x: Array, variance: Array) -> None:
        """Rows `x` (n, size) with the variance (n,) of their last value."""
        self.weight += float(weight.sum())
        self.first = self.first + weight @ x
        self.second = self.second + (weight[:, None] * x).T @ x
        self.second[-1, -1] += float(weight @ variance)

    @property
    def mean(self) -> Array:
        return np.asarray(self.first / self.weight)

    @property
    def cover(self) -> Array:
        spread = self.second / self.weight - np.outer(self.mean, self.mean)
        return np.asarray(spread + LEAST_SD**2 * np.eye(len(self.first)))


class Ended:
    """A gear that failed at the end of its evidence, and its curves of wear."""

    def __init__(self, gear: Gear, evidence: Evidence) -> None:
        self.ends = Ends(gear, evidence, 0.0)
        self.now, self.later = Fits(evidence, END_NOW), Fits(evidence, self.ends.left)
        self._known: dict[int, tuple[Belief, Weights]] = {}

    def add(self, kind: FailureKind, sums: tuple[_Sum, _Sum], life: _Sum) -> float:
        """Adds what this gear teaches of stiffness, noise and life; the log likelihood of its end and its trends."""
        ends = self.ends
        cases = [case for clock in CLOCKS for case in self._cases(kind, clock)]
        log = np.array([case[0] + _evidence(case[1]) + _evidence(case[2]) for case in cases])
        total = float(log_sum(log, 0))
        told = float(np.log(ends.age_h / ends.fatigue_h))
        for chance, (_, soft, loud, fatigued) in zip(np.exp(log - total), cases, strict=True):
            for part, into in zip((soft, loud), sums, strict=True):
                if part is not None:
                    _teach(float(chance), part, into)
            if fatigued:
                life.add(np.array([chance]), np.array([[told]]), np.zeros(1))
            elif soft is not None:
                weight = float(chance) * np.exp(soft.ends() - _evidence(soft))
                life.add(weight, told + np.log1p(ends.left)[:, None], np.zeros(ends.left.size))
        return total

    def _cases(self, kind: FailureKind, clock: int) -> Iterator[tuple[float, Weights | None, Weights | None, bool]]:
        """Log chance of each way to have ended, what stiffness and noise say then, and whether fatigue ended it."""
        ends, (mean, sd) = self.ends, kind.fatigue
        told = float(np.log(ends.age_h / ends.fatigue_h))
        fatigue_ends = -0.5 * ((told - mean) / sd) ** 2 - float(np.log(sd))
        soft = self._weigh(self.now.stiffness(clock), kind.stiffness)
        if kind.alone > 0.0:
            both = self._weigh(self.now.noise_of_fatigue(clock), kind.noise)
            yield fatigue_ends + float(np.log(kind.alone)), soft, both, True
        if kind.alone < 1.0:
            apart = float(np.log1p(-kind.alone))
            hum = self._weigh(self.later.noise_of_bearing, kind.noise, ends.log_bearing())
            yield fatigue_ends + apart, soft, hum, True
            power = (ends.rated_h / ends.bearing.scale_h) ** ends.bearing.shape
            bearing_ends = float(np.log(ends.bearing.shape * power))
            survives = float(np.log(max(np.sqrt(2.0 * np.pi) * ndtr((mean - told) / sd), 1e-300)))
            loud = self._weigh(self.now.noise_of_bearing, kind.noise)
            soft_later = self._weigh(self.later.stiffness(clock), kind.stiffness, ends.log_fatigue(kind))
            yield bearing_ends + survives + apart, soft_later, loud, False

    def _weigh(self, curves: Curves | None, belief: Belief, ends: Array | None = None) -> Weights | None:
        """Curves weighed by a belief and, where given, by the chance (ends,) of each end; each only once."""
        if curves is None:
            return None
        known = self._known.get(id(curves))
        if known is None or known[0] is not belief:
            known = self._known[id(curves)] = (belief, weigh(curves, belief))
        weights = known[1]
        return weights if ends is None else Weights(weights.log + ends[:, None], weights.log_size, weights.variance)


def _evidence(part: Weights | None) -> float:
    return 0.0 if part is None else float(log_sum(part.ends(), 0))


def _teach(chance: float, part: Weights, into: _Sum) -> None:
    weight = chance * np.exp(part.log - _evidence(part))
    known = weight > 1e-9
    shape = np.broadcast_to(SHAPES, (*weight.shape, 2))[known]
    into.add(weight[known], np.column_stack((shape, part.log_size[known])), part.variance[known])


class _PriorFile(msgspec.Struct, forbid_unknown_fields=True):
    parameters: list[str]
    fatigue: tuple[float, float]
    stiffness_mean: list[float]
    stiffness_cover: list[list[float]]
    noise_mean: list[float]
    noise_cover: list[list[float]]
    alone: float
    doubt: float
    experience: ExperienceFile | None = None


def prior_to_bytes(prior: Prior) -> bytes:
    """A learned prior, of one kind of gear, as JSON, to keep beside the configuration."""
    (kind,) = prior.kinds
    stiffness, noise = kind.stiffness, kind.noise
    saved = _PriorFile(
        list(NAMES),
        kind.fatigue,
        stiffness.mean.tolist(),
        stiffness.cover.tolist(),
        noise.mean.tolist(),
        noise.cover.tolist(),
        kind.alone,
        prior.doubt,
        None if prior.experience is None else experience_file(prior.experience),
    )
    return msgspec.json.encode(saved)


def prior_from_bytes(blob: bytes) -> Prior:
    """The prior of `prior_to_bytes`. Raises `LearnError` if it is broken or has other parameters."""
    try:
        saved = msgspec.json.decode(blob, type=_PriorFile)
        beliefs = (
            _believed(saved.stiffness_mean, saved.stiffness_cover),
            _believed(saved.noise_mean, saved.noise_cover),
        )
        past = None if saved.experience is None else experience_of(saved.experience)
    except (msgspec.MsgspecError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
        raise LearnError(f"learned prior: {error}") from error
    if saved.parameters != list(NAMES):
        raise LearnError(f"learned prior: expected the parameters {', '.join(NAMES)}")
    if not (0.0 <= saved.doubt < 1.0 and 0.0 <= saved.alone <= 1.0 and saved.fatigue[1] > 0.0):
        raise LearnError("learned prior: expected chances from 0 to 1 and an sd above 0")
    return Prior((FailureKind(saved.fatigue, *beliefs, saved.alone),), saved.doubt, past)


def _believed(mean: list[float], cover: list[list[float]]) -> Belief:
    belief = Belief(np.array(mean), np.array(cover))
    size = len(NAMES)
    if belief.mean.shape != (size,) or belief.cover.shape != (size, size):
        raise ValueError(f"expected {size} means and a {size} x {size} covariance")
    np.linalg.cholesky(belief.cover)
    if np.linalg.cond(belief.cover) > LEAST_OWN:
        raise ValueError("expected a covariance in which no parameter is told by the others")
    return belief


def _hours(time_h: Array) -> Array:
    steps = np.diff(time_h)
    return np.concatenate(([float(np.median(steps)) if steps.size else 1.0], steps))


@dataclass(frozen=True, slots=True)
class LearnedLaw:
    """Damage law of a kind of gear: weighted grid over (m, gamma, log C, scatter), (n,) each."""

    m: Array
    gamma: Array
    log_C: Array
    scatter: Array
    """sd of the logarithm of C between gears"""
    weight: Array
    ultimate_Nm: float

    def interval(self, name: str) -> tuple[float, float]:
        """Central `INTERVAL` of `m`, `gamma`, `log_C` or `scatter`."""
        edge = (1.0 - INTERVAL) / 2.0
        return self.quantile(name, edge), self.quantile(name, 1.0 - edge)

    def quantile(self, name: str, probability: float) -> float:
        """Quantile of one parameter's marginal."""
        values = getattr(self, name)
        order = np.argsort(values, kind="stable")
        above = np.cumsum(self.weight[order])
        levels, last = np.unique(values[order][::-1], return_index=True)
        mass = above[len(above) - 1 - last]
        # a grid value stands for a cell: half of its mass lies below it
        middle = mass - 0.5 * np.diff(mass, prepend=0.0)
        return float(np.interp(probability, middle, levels))


INTERVAL = 0.9
M_GRID = np.arange(3.0, 16.01, 0.25)
GAMMA_GRID = np.arange(0.0, 3.01, 0.25)
SCATTER_GRID = np.geomspace(0.05, 1.5, 16)
LEVEL_GRID = np.linspace(-5.0, 5.0, 41)
"""The logarithm of C is looked at on this grid around its best value, in standard errors."""
TORQUE_CELLS, LOSS_CELLS = 60, 24


def learn_law(gear: Gear, lives: Sequence[FailedGear]) -> LearnedLaw:
    """C, m, gamma and the scatter of C between gears, with uncertainty, from flat priors on a grid.

    A gear fails when its own damage reaches 1; one that still runs, or failed otherwise, counts as censored.
    Raises `LearnError` for fewer than five failures.
    """
    _ledgers(gear, lives)
    failed = np.array([life.failed for life in lives])
    ultimate = gear.buckling_Nm or gear.momentary_peak_Nm or 4.0 * gear.rated_torque_Nm
    use = np.array([_log_use(life, ultimate) for life in lives])
    count = int(failed.sum())
    middle = use[failed].mean(axis=0)
    spread = use[failed].std(axis=0)
    scatter = SCATTER_GRID[:, None]
    error = np.sqrt(SCATTER_GRID**2 + np.mean(spread) ** 2)[:, None] / math.sqrt(count)
    log_weight = np.empty((len(M_GRID), len(GAMMA_GRID), len(SCATTER_GRID), len(LEVEL_GRID)))
    log_C = np.empty_like(log_weight)
    for i, j in np.ndindex(len(M_GRID), len(GAMMA_GRID)):
        level = middle[i, j] + LEVEL_GRID * error
        total = np.log(error) - np.log(scatter)
        for life in range(len(lives)):
            z = (use[life, i, j] - level) / scatter
            total = total + (-0.5 * z**2 - np.log(scatter) if failed[life] else log_ndtr(-z))
        log_weight[i, j] = total
        log_C[i, j] = -level
    weight = np.exp(log_weight - log_weight.max())
    grids = np.meshgrid(M_GRID, GAMMA_GRID, SCATTER_GRID, indexing="ij")
    m, gamma, width = (np.repeat(grid[..., None], len(LEVEL_GRID), axis=-1).ravel() for grid in grids)
    return LearnedLaw(m, gamma, log_C.ravel(), width, weight.ravel() / weight.sum(), ultimate)


def _log_use(life: FailedGear, ultimate_Nm: float) -> Array:
    """(m, gamma) grid of log sum of cycles * (tau / (tau_ult (1 - gamma dK)))^m over a life."""
    torque = np.abs(life.columns["torque_cubic_mean_Nm"])
    cycles = CYCLES_PER_TURN * 60.0 * np.abs(life.columns["speed_in_rpm"]) * _hours(life.time_h)
    stiffness = life.columns.get("stiffness_Nm_per_rad")
    loss = _loss(stiffness) if stiffness is not None else np.zeros_like(torque)
    log_torque = np.log(np.maximum(torque, 1e-6) / ultimate_Nm)
    good = np.isfinite(log_torque) & np.isfinite(cycles) & np.isfinite(loss) & (cycles > 0.0)
    cells, edges_t, edges_s = np.histogram2d(
        log_torque[good], loss[good], bins=(TORQUE_CELLS, LOSS_CELLS), weights=cycles[good]
    )
    t, s = (0.5 * (edges[1:] + edges[:-1]) for edges in (edges_t, edges_s))
    weaker = 1.0 - np.clip(GAMMA_GRID[:, None] * s, 0.0, MOST_LOSS)
    answer = np.empty((len(M_GRID), len(GAMMA_GRID)))
    for i, m in enumerate(M_GRID):
        by_loss = np.exp(m * t) @ cells
        answer[i] = np.log(weaker**-m @ by_loss)
    return answer


def _loss(stiffness: Array) -> Array:
    """Relative loss of stiffness, smoothed over a fortieth of the life; the first twentieth is the baseline."""
    known = np.isfinite(stiffness)
    if known.sum() < 40:
        return np.zeros_like(stiffness)
    index = np.arange(len(stiffness))
    filled = np.interp(index, index[known], stiffness[known])
    width = max(len(filled) // 40, 1)
    padded = np.pad(filled, (width // 2, width - 1 - width // 2), mode="edge")
    smooth = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    base = float(np.mean(filled[: max(len(filled) // 20, 1)]))
    return np.asarray(np.clip(1.0 - smooth / base, 0.0, MOST_LOSS))
