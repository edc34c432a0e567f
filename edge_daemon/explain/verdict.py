"""What is said of the explanations that were found: the verdict, how far each is believed, and what would tell them
apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from edge_daemon.effects.hysteresis import CREEP
from edge_daemon.effects.model import Model
from edge_daemon.effects.torque_source import MOTOR_SIDE
from edge_daemon.explain.axes import where
from edge_daemon.explain.compare import error_of
from edge_daemon.explain.plan import MotionLimits, next_experiment
from edge_daemon.explain.results import Candidate, Diagnosis, Error, Experiment, none_of
from edge_daemon.identify.deviations import numbers
from edge_daemon.identify.fit import fitted_model, refitted
from edge_daemon.identify.problem import RICH_TONES, tones
from edge_daemon.records import Array
from edge_daemon.search import order
from edge_daemon.search.belief import (
    SHOWN,
    beliefs,
    left_where_it_is,
    log_weights,
    none_log_weight,
    outside_log_weight,
    samples,
    says_all,
    step_log_weight,
)
from edge_daemon.search.free_orders import plain
from edge_daemon.search.grid_fit import grid_fit, moves_with_fit, refined
from edge_daemon.search.hypotheses import MODEL_TORQUE, Hypothesis, added, rank
from edge_daemon.search.order import improves, insists, likely, takes_all
from edge_daemon.search.search import Search
from edge_daemon.search.thresholds import (
    EXACT_FLOORS,
    EXPLAINED_FLOORS,
    IDLE,
    LEAST_T,
    LIKELY_SD,
    LITTLE_GAIN,
    PROMISED,
    SHY,
    STEP_TEMPER,
    SUGGESTIVE,
    TEMPER,
    TIE,
    TOLD,
    WORTH_SHARE,
)


@dataclass(frozen=True)
class Verdict:
    """On the explanations that one search found."""

    model: Model
    search: Search
    limits: MotionLimits | None = None

    @cached_property
    def outside(self) -> Hypothesis | None:
        """What else it may be, and no effect of the catalogue is: nothing in a balance without a twist."""
        if self.model.balance == "drive":
            return None
        return refined(self.search, grid_fit(self.search, self.search.base, CREEP))

    @property
    def built_up(self) -> bool:
        """Whether a machine is told step by step, each of which leaves the next: wherever a motor's torque is all that
        is known of the torque, its friction is never quite what any law says."""
        return self.model.balance == "drive" or MOTOR_SIDE.name in self.search.base.solution.names

    def diagnosis(self, found: Sequence[Hypothesis], warnings: Sequence[str]) -> Diagnosis:
        base = self.search.base
        fitted = fitted_model(self.model, base.solution, self.search.regression)
        error = error_of(replace(fitted, floor=self.search.within(fitted.floor)))
        ordered = self.ordered(found)
        left = where(self.search.regression.held_out_residual(base.solution), self.search.regression, self.model.teeth)
        if self.adequate(ordered, error):
            return Diagnosis("adequate", error, (), None, left, tuple(warnings))
        worth = self.kept(ordered)
        candidates = self.candidates(worth)
        verdict = "missing" if self.named(candidates) else "unexplained"
        told = (*warnings, *(self.rest(worth[0]) if verdict == "missing" else ()))
        experiment = self.experiment(worth, candidates)
        return Diagnosis(verdict, error, candidates, experiment, left, told, with_first=self.with_first(worth))

    def with_first(self, worth: Sequence[Hypothesis]) -> Model | None:
        """The model with the best explanation; None where that is more of what the model has."""
        if not worth or any(plain(name) != name for name in worth[0].added):
            return None
        return fitted_model(self.model, worth[0].solution, self.search.regression).model

    def rest(self, best: Hypothesis) -> tuple[str, ...]:
        """What is not explained by what is there: that an effect is missing does not say that it is all."""
        drive, told = self.model.balance == "drive", []
        if best.level >= (EXPLAINED_FLOORS if drive else EXPLAINED_FLOORS / 2):
            told = [left_by(best.name, best.error / self.search.base.error, best.level)]
        loads = "+".join(row.name for row in added(best) if row.carried)
        if loads and MODEL_TORQUE[0] in self.search.base.solution.names:
            told += [f"{loads} beside {MODEL_TORQUE[0]}: a payload, or the controller's own loads are off or late"]
        return tuple(told)

    def named(self, candidates: Sequence[Candidate]) -> bool:
        """Whether the first cause may be named: it is believed rather than that it is none of them."""
        return bool(candidates) and believed(candidates) >= none_of(candidates)

    def adequate(self, ordered: Sequence[Hypothesis], error: Error) -> bool:
        """Whether nothing is left to name: below the noise nothing is, and a few floors above it nothing where no
        effect takes what the model's own exactness leaves, or no step of a story is believed."""
        base = self.search.base
        if base.level >= EXPLAINED_FLOORS or not error.nrmse < 1:
            return False
        if not ordered or base.level <= 1:
            return True
        if self.model.balance == "drive":
            little = base.level <= EXACT_FLOORS and ordered[0].error > LITTLE_GAIN * base.error
            return little or not self.named(self.candidates(ordered[:SHOWN]))
        return ordered[0].error > WORTH_SHARE * base.error and not takes_all(base, ordered[0])

    def kept(self, ordered: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What is listed, each that may be believed fitted on to the end as `add` does it: its error is a promise."""
        worth = list(ordered[:SHOWN])
        if self.model.balance == "drive":
            return worth
        beliefs = self.beliefs(worth) if worth else ()
        refits = [self.refit(h) if p >= PROMISED else h for h, p in zip(worth, beliefs, strict=True)]
        return self.ordered(refits)

    def refit(self, hypothesis: Hypothesis) -> Hypothesis:
        """The same explanation where a fit of it ends."""
        solution = refitted(self.search.regression, hypothesis.solution)
        self.search.regression.restore(self.search.start)
        done = self.search.hypothesis(hypothesis.added, solution, hypothesis.identifiability)
        better = done.error < hypothesis.error or moves_with_fit(solution.terms)
        return done if better and self.search.carried(done) else hypothesis

    def improves(self, hypothesis: Hypothesis) -> bool:
        """Whether the fall of the held-out error is beyond chance and worth a name, and a spring is left, which a fit
        that goes on may lose."""
        base = self.search.base
        told = self.model.balance == "drive" and likely(base, hypothesis, self.search.regression)
        return (told or improves(base, hypothesis)) and self.search.carried(hypothesis)

    def ordered(self, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What improves the model, best first; a pair before its parts only where it gains enough, a refinement before
        its simpler form too. A law that finer forms wait for is named alone where it can, unless all of them were
        weighed: beside a pair that says all."""
        alone = {h.added[0] for h in found if len(h.added) == 1 and self.improves(h)}
        best = next((h for h in sorted(found, key=rank) if len(h.added) > 1), None)
        if best is not None and self.search.awaited(best) in alone and not says_all(best, found, self.search):
            found = [h for h in found if len(h.added) == 1]
        rows = [h for h in order.ordered(found, self.search) if self.improves(h)]
        return self.waves_first(rows) if self.model.balance == "drive" else rows

    def waves_first(self, rows: list[Hypothesis]) -> list[Hypothesis]:
        """What repeats comes before what takes more of slower errors, but less of what is left where it is."""

        def left(hypothesis: Hypothesis) -> float:
            return left_where_it_is(hypothesis, self.search.base, self.search.regression)

        waves = next((h for h in rows if all(effect.is_ripple for effect in added(h))), None)
        if waves is None or left(waves) >= left(rows[0]):
            return rows
        return [waves, *(h for h in rows if h is not waves)]

    def candidates(self, worth: Sequence[Hypothesis]) -> tuple[Candidate, ...]:
        rms = self.search.regression.rms
        rows = []
        for hypothesis, probability in zip(worth, self.beliefs(worth) if worth else (), strict=True):
            rivals = worth if probability >= TOLD else ()
            confused = tuple(h.name for h in rivals if h is not hypothesis and self.tied(hypothesis, h))
            rows.append(
                Candidate(
                    hypothesis.name,
                    self.search.base.rmse / rms,
                    hypothesis.rmse / rms,
                    float(probability),
                    confused,
                    values(hypothesis),
                    deviation(hypothesis) / rms,
                )
            )
        return tuple(rows)

    def beliefs(self, worth: Sequence[Hypothesis]) -> Array:
        """(k,) probabilities of explanations, best first; the rest is that of none of them."""
        shy = np.log([self.complexity_weight(h, worth) for h in worth])
        if self.built_up:
            temper = STEP_TEMPER if self.model.balance == "drive" else TEMPER
            weights = self.with_fewer(worth, log_weights(worth, shy, self.search.regression, temper))
            named = [h is worth[0] or self.tied(worth[0], h) for h in worth]  # one explanation by several names
            names = math.log(float(np.exp(weights)[named].sum()))
            return beliefs(weights, [names + self.is_none(worth[0], self.search.base)])
        weights = log_weights(worth, shy, self.search.regression)
        count, poor = samples(worth[0], self.search.regression), tones(self.search.regression.trials) < RICH_TONES
        none = [none_log_weight(worth[0], self.search.base, poor, count)]
        if self.outside is not None and self.outside.error < self.search.base.error:
            none.append(outside_log_weight(worth[0], self.outside, self.search.regression))
        return beliefs(weights, none)

    def with_fewer(self, worth: Sequence[Hypothesis], weights: Array) -> Array:
        """The log weights (k,) of explanations, that of the best with fewer effects no less than its odds that what is
        more is none."""
        fewer = next((i for i, h in enumerate(worth) if len(h.added) < len(worth[0].added)), None)
        if fewer is None:
            return weights
        odds = self.is_none(worth[0], worth[fewer])
        return np.array([max(weight, odds) if i == fewer else weight for i, weight in enumerate(weights)])

    def is_none(self, more: Hypothesis, fewer: Hypothesis) -> float:
        """Log odds that a step of a story is none."""
        return step_log_weight(more, fewer, self.search.regression, foretold=not self.search.noise)

    def complexity_weight(self, hypothesis: Hypothesis, worth: Sequence[Hypothesis]) -> float:
        """Small for a refinement, or a form of ripple, that gains little over its simpler form: it says nearly the same
        at greater length."""
        refines = {effect.name: (*effect.refines, effect.waves_of) for effect in self.search.known.values()}
        plainer = (simple for simple in worth if order.refined(hypothesis, simple, refines))
        return min((self.weight_beside(hypothesis, simple) for simple in plainer), default=1.0)

    def weight_beside(self, finer: Hypothesis, simple: Hypothesis) -> float:
        """The same beside one simpler form: with one encoder it grows with what the samples tell, up to where they
        insist."""
        if insists(simple, finer, self.search.regression):
            return 1.0
        weight = SHY if finer.error <= SUGGESTIVE * simple.error else IDLE
        if self.model.balance != "drive" or finer.error >= simple.error:
            return weight
        every, rest = order.apart_sd(simple, finer, self.search.regression)
        told_sd = min(every, LIKELY_SD / LEAST_T * rest)  # the least of what insisting would ask of either
        return max(weight, min(IDLE * math.exp(STEP_TEMPER * told_sd), 1.0))

    def tied(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether two explanations cannot be told apart. A refinement that gains nothing over its simpler form is
        no rival of it where that leaves noise: every motion would leave them level. Where more is left, the law itself
        is in doubt, and with it which of its forms is real."""
        refines = {effect.name: effect.refines for effect in self.search.known.values()}
        if order.refined(other, one, refines):
            doubtful = (one.name, other.name) in self.search.rivals
            close = doubtful or other.error <= SUGGESTIVE * one.error
            return close and not insists(one, other, self.search.regression)
        return order.tied(one, other)

    def experiment(self, worth: Sequence[Hypothesis], candidates: Sequence[Candidate]) -> Experiment | None:
        """The motion that tells the first explanation from what it is confused with; from the next best, or from what
        is no candidate, where none of them is more probable than any."""
        if not candidates:
            return None
        first, one = candidates[0], worth[0]
        if first.confused_with:
            other: Hypothesis | None = next(h for h in worth if h.name == first.confused_with[0])
        elif none_of(candidates) > first.probability:
            other = worth[1] if len(worth) > 1 else self.outside
        else:
            return None
        if other is None:
            return None
        if (one.name, other.name) in self.search.rivals and other.error > TIE * one.error:
            other = self.search.rivals[one.name, other.name]
        return next_experiment(self.model, self.search.regression, one, other, self.limits)


def left_by(name: str, share: float, level: float) -> str:
    """A line on what a cause leaves: over the error of the model, and over the noise floor."""
    return f"{name} leaves {share:.0%} of the error, {level:.1f} times the noise: that is not explained"


def believed(candidates: Sequence[Candidate]) -> float:
    """Probability of the first cause, of what cannot be told from it, and of what holds one of its effects: of two that
    are missing one may be sure, and of the other only what family it is."""
    first = candidates[0]
    names = set(first.effect.split("+"))
    same = (row for row in candidates if row.effect in first.confused_with or names & set(row.effect.split("+")))
    return sum(row.probability for row in same)


def deviation(hypothesis: Hypothesis) -> float:
    """sd of the held-out error, unit of the balance, from its scatter over blocks."""
    held_out, count = hypothesis.solution.held_out, hypothesis.solution.count
    mean = float(held_out.sum() / count.sum())
    scatter = float(np.sum((held_out - mean * count) ** 2)) * len(count) / max(len(count) - 1, 1)
    return 0.5 * math.sqrt(scatter) / float(count.sum()) / math.sqrt(max(mean, 1e-300))


def values(hypothesis: Hypothesis) -> dict[str, float]:
    """`effect.parameter` -> value of what was added."""
    return {
        f"{plain(term.effect.name)}.{row.name}": value
        for term, row, value in numbers(hypothesis.solution)
        if term.effect.name in hypothesis.added
    }
