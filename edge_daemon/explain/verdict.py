"""What is said of the explanations that were found: the verdict, how far each is believed, and what would tell them
apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from edge_daemon.effects.model import Model
from edge_daemon.explain import order
from edge_daemon.explain.axes import where
from edge_daemon.explain.compare import error_of
from edge_daemon.explain.creep import creeping
from edge_daemon.explain.hypotheses import TIE, Hypothesis
from edge_daemon.explain.order import SUGGESTIVE, beyond_noise, improves, insists, outdone, refined, takes_all
from edge_daemon.explain.plan import next_experiment
from edge_daemon.explain.results import Candidate, Diagnosis, Experiment
from edge_daemon.explain.search import Search
from edge_daemon.identify.fit import fitted_model, numbers
from edge_daemon.identify.motion_richness import RICH_TONES, tones
from edge_daemon.identify.regression import RegressionProblem

EXPLAINED_FLOORS = 3.0
"""error over the noise floor that still counts as explained: simulation and filters are not exact"""
PLAIN_FLOORS = 2.0
"""the same where no finer form of the law is in question (guess: what was right left up to 1.5, what was wrong over
2.2, where neither reached `EXPLAINED_SHARE`; a handful of each)"""
WORTH_SHARE = 0.7
"""near the floor, an error that no effect brings below this share of itself is of the model's exactness, not its
structure (guess: an effect that is really missing takes more)"""
EXPLAINED_SHARE = 0.1
"""error left over the error before that still counts as explained, where the floor is out of reach: 99 % of its
variance. What an effect leaves for its law's being a little other than real is less (on simulated gears up to 0.08
where the right effect left more than two floors, 0.03 as a rule); a wrong one that takes 90 %, as dry friction does of
nearly any loop, leaves more (0.12 where creep was called a loop)"""
SHARPNESS = 12.0
"""probability falls with the error to this power: half the blocks of 30 s, since neighbours are not independent"""
PRICE = 0.1
"""logarithm of the probability that a number costs"""
IDLE = 0.05
"""weight of a refinement that gains nothing over its simpler form (guess)"""
SHY = 0.25
"""weight of one that gains, but not so much that the data insist on it (guess)"""
SHOWN = 8
POOR_BELIEF = 0.8
"""most that is believed of any cause after such a motion (guess: one in five is another cause of the same shape)"""
LEAST_BELIEF = 0.3
"""belief in the first cause, with what it is confused with, below which nothing is named (guess)"""
UNEXPLAINED_BELIEF = 0.4
"""most that is believed of a cause that leaves structure (guess)"""
LAW_DOUBT = 0.4
"""belief that a cause loses when all that it leaves is more than noise: something of its law is wrong, and another may
be meant. It loses half of it at 1.5 noise floors, so that no more than 0.8 is believed there; of 26 findings on
simulated gears that left more than that, 22 were right"""


@dataclass(frozen=True)
class Verdict:
    """On the explanations that one search found."""

    model: Model
    problem: RegressionProblem
    search: Search

    @cached_property
    def outside(self) -> Hypothesis | None:
        """What else it may be, and no effect of the catalogue is: nothing in a balance without a twist."""
        return None if self.model.balance == "drive" else creeping(self.search)

    def diagnosis(self, found: Sequence[Hypothesis], warnings: Sequence[str]) -> Diagnosis:
        base = self.search.base
        error = error_of(fitted_model(self.model, base.solution, self.problem))
        ordered = self.ordered(found)
        verdict = self.verdict(ordered)
        if verdict == "adequate":
            return Diagnosis(verdict, error, (), None, (), tuple(warnings))
        left = where(base.solution.held_out_residual(self.problem), self.problem)
        candidates = self.candidates(ordered, verdict)
        if verdict == "missing" and self.model.balance != "drive" and believed(candidates) < LEAST_BELIEF:
            verdict = "unexplained"
        experiment = self.experiment(ordered, candidates) if verdict == "missing" else None
        return Diagnosis(verdict, error, candidates, experiment, left, tuple(warnings))

    def improves(self, hypothesis: Hypothesis) -> bool:
        """Whether the fall of the held-out error is beyond chance and worth a name."""
        return improves(self.search.base, hypothesis)

    def ordered(self, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What improves the model, best first; a pair before its parts only where it gains enough, a refinement before
        its simpler form too."""
        return [h for h in order.ordered(found, self.search) if self.improves(h)]

    def verdict(self, ordered: Sequence[Hypothesis]) -> str:
        base = self.search.base
        if not ordered:
            return "adequate" if base.level < EXPLAINED_FLOORS else "unexplained"
        best = ordered[0].level
        if self.model.balance != "drive":
            inexact = ordered[0].error > WORTH_SHARE * base.error and not takes_all(base, ordered[0])
            if base.level < EXPLAINED_FLOORS and inexact:
                return "adequate"
            if self.outside is not None and outdone(ordered[0], self.outside):
                return "unexplained"
        share = ordered[0].error / base.error
        most = EXPLAINED_FLOORS if self.in_doubt(ordered[0]) else PLAIN_FLOORS
        if best < most or share < EXPLAINED_SHARE or self.model.balance == "drive":
            return "missing"
        return "unexplained"

    def in_doubt(self, hypothesis: Hypothesis) -> bool:
        """Whether a refinement of its law does as well: what it leaves may be the law's form, no other cause."""
        return any(simple == hypothesis.name for simple, _ in self.search.rivals)

    def candidates(self, ordered: Sequence[Hypothesis], verdict: str) -> tuple[Candidate, ...]:
        worth = ordered[:SHOWN]
        least = 0.0 if self.model.balance == "drive" else 1.0  # below the noise nothing is better than anything else
        levels = np.minimum.accumulate([max(h.level, least) for h in reversed(worth)])[::-1] if worth else np.ones(0)
        dearer = np.array([math.exp(-PRICE * h.parameters) * self.modesty(h, worth) for h in worth])
        best = levels.min(initial=math.inf)
        weights = (best / levels) ** SHARPNESS * np.minimum.accumulate(dearer)
        believed = self.belief(ordered[0], verdict) if worth else 0.0
        probabilities = believed * weights / max(weights.sum() + self.unlisted(best), 1e-300)
        rms = self.problem.rms
        rows = []
        for hypothesis, probability in zip(worth, probabilities, strict=True):
            confused = tuple(h.name for h in worth if h is not hypothesis and self.tied(hypothesis, h))
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

    def unlisted(self, best: float) -> float:
        """Weight of what is no candidate beside a best of some level."""
        if self.outside is None or not math.isfinite(best):
            return 0.0
        nearness = min(best / max(self.outside.level, 1.0), 1.0)
        return math.exp(SHARPNESS * math.log(nearness) - PRICE * self.outside.parameters)

    def modesty(self, hypothesis: Hypothesis, worth: Sequence[Hypothesis]) -> float:
        """Small for a refinement that gains little over its simpler form: it says nearly the same at greater length."""
        refines = {effect.name: effect.refines for effect in self.search.candidates}
        weights = [1.0]
        for simple in worth:
            if refined(hypothesis, simple, refines) and not insists(simple, hypothesis):
                weights.append(SHY if hypothesis.error <= SUGGESTIVE * simple.error else IDLE)
        return min(weights)

    def belief(self, best: Hypothesis, verdict: str) -> float:
        """How far the best explanation goes: 1 at the noise floor, less the more of what is left is not noise."""
        left = max(best.level - 1, 0.0)
        gone = 1 - (best.level / self.search.base.level) ** 2
        most = UNEXPLAINED_BELIEF if verdict == "unexplained" else 1.0
        if self.model.balance != "drive":  # there friction is built up step by step, and every step leaves the next
            most = min(most, 1 - LAW_DOUBT * beyond_noise(best.level))
        if tones(self.problem.trials) < RICH_TONES:
            most = min(most, POOR_BELIEF)
        return most * gone / (1 + 0.02 * left)

    def tied(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether two explanations cannot be told apart. A refinement that gains nothing over its simpler form is
        no rival of it where that leaves noise: every motion would leave them level. Where more is left, the law itself
        is in doubt, and with it which of its forms is real."""
        refines = {effect.name: effect.refines for effect in self.search.candidates}
        if refined(other, one, refines):
            doubtful = (one.name, other.name) in self.search.rivals
            return (doubtful or other.error <= SUGGESTIVE * one.error) and not insists(one, other)
        return order.tied(one, other)

    def experiment(self, ordered: Sequence[Hypothesis], candidates: Sequence[Candidate]) -> Experiment | None:
        """The motion that tells the first explanation from what it is confused with."""
        first = candidates[0]
        if not first.confused_with:
            return None
        other = next(h for h in ordered if h.name == first.confused_with[0])
        one = next(h for h in ordered if h.name == first.effect)
        if (one.name, other.name) in self.search.rivals and other.error > TIE * one.error:
            other = self.search.rivals[one.name, other.name]
        return next_experiment(self.model, self.problem, one, other)


def believed(candidates: Sequence[Candidate]) -> float:
    """Probability of the first cause and of what cannot be told from it."""
    first = candidates[0]
    return sum(row.probability for row in candidates if row is first or row.effect in first.confused_with)


def deviation(hypothesis: Hypothesis) -> float:
    """sd of the held-out error, unit of the balance, from its scatter over blocks."""
    held_out, count = hypothesis.solution.held_out, hypothesis.solution.count
    mean = float(held_out.sum() / count.sum())
    scatter = float(np.sum((held_out - mean * count) ** 2)) * len(count) / max(len(count) - 1, 1)
    return 0.5 * math.sqrt(scatter) / float(count.sum()) / math.sqrt(max(mean, 1e-300))


def values(hypothesis: Hypothesis) -> dict[str, float]:
    """`effect.parameter` -> value of what was added."""
    return {
        f"{term.effect.name}.{row.name}": value
        for term, row, value in numbers(hypothesis.solution)
        if term.effect.name in hypothesis.added
    }
