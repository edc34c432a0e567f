"""Three and four effects at once, with two encoders, where two leave far more than noise.

Each stage adds an effect to the best explanations so far, as pairs are made of singles, and goes on only where the data
insist on it; what was named first and is idle beside the others is taken out at the end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edge_daemon.effects.effect import Effect
from edge_daemon.identify.block_least_squares import free_sums, held_out
from edge_daemon.identify.fit import fit_terms, refitted
from edge_daemon.identify.solution import Term
from edge_daemon.identify.structure import lawful
from edge_daemon.identify.torque_lag import STEADY
from edge_daemon.motion.corrected import senses
from edge_daemon.search.belief import believable_level
from edge_daemon.search.free_orders import further, in_order, with_orders
from edge_daemon.search.grid_fit import grid, grid_fit, refined
from edge_daemon.search.hypotheses import (
    NEAR_FLOOR,
    UNSOLVED,
    DiagnosisProblem,
    Hypothesis,
    added,
    distinct,
    effect_of,
    rank,
)
from edge_daemon.search.pairs import Pairs
from edge_daemon.search.simulated_ranking import SimulatedRanking
from edge_daemon.search.thresholds import TIE

MOST_EFFECTS = 4
"""Effects at once at the most: of more no data of one recording are sure (guess)."""
BEAMS = 3
"""So many explanations are gone on from: the best may hold one law in the place of two."""
NEXT = 2
"""So many further effects are tried on each, and their plainer forms."""


class Several:
    """Explanations of more than two effects."""

    def __init__(self, problem: DiagnosisProblem, ranking: SimulatedRanking, pairs: Pairs) -> None:
        self.problem, self.regression, self.ranking, self.pairs = problem, problem.regression, ranking, pairs

    def run(self, found: Sequence[Hypothesis], most: int = MOST_EFFECTS) -> list[Hypothesis]:
        """What was found, and what goes on from the best of it to nothing but noise; best first."""
        best, every = min(found, key=rank), list(found)
        if len(best.added) < 2 or best.level <= UNSOLVED or most <= len(best.added):
            return every
        far = best.level > believable_level(self.problem.base) and lawful(best.solution.terms)
        rested = self.ranking.roughly(best) if far else self._rested(best)
        if self.problem.carried(rested):  # else what follows would only mend a lost spring
            best = rested
        every = distinct([best, *every])
        zeroed = [
            *self._with_zero(best),
            *(h for row in self._in_plainer_form(best, every) for h in self._with_zero(row)),
        ]
        best, every = min([best, *zeroed], key=rank), [*zeroed, *every]
        while best.level > (NEAR_FLOOR if len(every) > len(found) else UNSOLVED) and len(best.added) < most:
            every = distinct([*map(self._wider, self._beams(every, best)), *every])
            best = self._beams(every, best)[0]
            longer = self._longer(every, best)
            if not longer:
                break
            best = longer[0]
            every += longer
        if best.level > believable_level(self.problem.base):
            return list(found)
        every += self._twins(best, every)
        rivals = [h for h in every if len(h.added) == len(best.added) and h.error < TIE * best.error]
        return distinct([*every, *(rest for h in rivals for rest in self.needed(h))])

    def _with_zero(self, best: Hypothesis) -> list[Hypothesis]:
        """An explanation with the zero of a torque sensor, which any has, where that takes a good part: beside a spring
        that bends it is no zero of the twist, and the loop's derivative does not foretell it."""
        zero = self.problem.known.get(STEADY)
        if zero is None or STEADY in best.added or not senses(self.regression.motions[0]):
            return []
        solution = fit_terms(self.regression, [*best.solution.terms, Term(zero, zero.start)])
        self.regression.restore(self.problem.start)
        done = self.problem.hypothesis((*best.added, zero.name), solution, best.identifiability)
        if any(set(effect.later) - set(effect.waves) for effect in added(best)):  # either hides beside the other
            done = self._wider(done)
        good = self.problem.carried(done) and done.error < self.problem.pair_gain(best, done) * best.error
        return [done] if good else []

    def _in_plainer_form(self, best: Hypothesis, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What has a plainer form of one of its effects and does as well."""
        return [h for h in found if self.problem.simplifies(h, best) and h.error < TIE * best.error]

    def _beams(self, found: Sequence[Hypothesis], best: Hypothesis) -> list[Hypothesis]:
        """The best that are as long as one, best first, of those that leave the same behind the first."""
        chosen: list[Hypothesis] = []
        for hypothesis in sorted(found, key=rank):
            if len(chosen) < BEAMS and len(hypothesis.added) == len(best.added):
                chosen += [] if any(self.pairs.alike(hypothesis, h) for h in chosen) else [hypothesis]
        return chosen

    def _longer(self, found: Sequence[Hypothesis], best: Hypothesis) -> list[Hypothesis]:
        """The best explanations with one more effect, best first; none where none takes a good part."""
        beams = self._beams(found, best)
        tries = {beam.added: self._next(beam) for beam in beams}
        every = [h for row in tries.values() for h in row]
        done = self.ranking.run([refined(self.problem, h) for h in distinct(every)], (), best)
        foretold = {h.added for beam in beams if beam.solution.design is not None for h in tries[beam.added]}
        done = [h for h in done if h.solution.design is not None or h.added not in foretold]
        wanted = [self.problem.pair_gain(best, h) * best.rmse for h in done[:BEAMS]]
        rested = [*map(self._rested, done, wanted), *done[BEAMS:]]
        good = [h for h in rested if h.error < self.problem.pair_gain(best, h) * best.error]
        return sorted(filter(self.problem.carried, good), key=rank)

    def _wider(self, best: Hypothesis) -> Hypothesis:
        """The same with orders of its effects that show only beside its other parts, where they tell."""
        tries = []
        for name in best.added:
            effect = effect_of(best.solution, name)
            if effect.over is None:
                continue
            self.regression.learn(best.solution)
            more = with_orders(further(effect), best.solution, self.regression)
            self.regression.restore(self.problem.start)
            if more is not None:
                rest = self.problem.keeping(best, tuple(other for other in best.added if other != name))
                tries.append(grid_fit(self.problem, rest, effect.over(in_order((*effect.waves, *more.waves), effect))))
        done = [self._rested(refined(self.problem, h)) for h in tries]
        good = (h for h in done if self.problem.carried(h) and TIE * h.error < best.error)
        return min(good, default=best, key=rank)

    def _rested(self, hypothesis: Hypothesis, wanted: float = math.inf) -> Hypothesis:
        """The same where a fit of it ends, unless that is worse, or an rms that is `wanted` is out of reach: beside
        several others a shape or a correction of the twist comes to rest slowly."""
        if hypothesis.level <= NEAR_FLOOR:
            return hypothesis
        solution = refitted(self.regression, hypothesis.solution, wanted)
        self.regression.restore(self.problem.start)
        done = self.problem.hypothesis(hypothesis.added, solution, hypothesis.identifiability)
        return min(hypothesis, done, key=lambda h: h.error)

    def _twins(self, best: Hypothesis, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best with what it may be taken for in the place of each part."""
        tries = [(name, effect) for name in best.added for effect in self.pairs.instead(best, name)]
        known = {frozenset(h.added) for h in found if h.error < TIE * best.error}
        new = [row for row in tries if frozenset({*best.added, row[1].name} - {row[0]}) not in known]
        made = [refined(self.problem, self.pairs.exchanged(best, *row)) for row in new]
        done = [self._rested(h, TIE * best.rmse) for twin in made for h in self.ranking.run([twin], rival=best)]
        return [h for h in done if self.problem.carried(h)]

    def _next(self, beam: Hypothesis) -> list[Hypothesis]:
        """One explanation with the effects that promise most beside it."""
        self.problem.progress(f"{beam.name} and another", 0.95)
        self.regression.learn(beam.solution)
        new = [effect for effect in self.problem.offered(beam) if not self.problem.overlap(effect, beam)]
        tries = [self._with(beam, effect) for effect in new]
        self.regression.restore(self.problem.start)
        worth = sorted((h for h in tries if h.error < self.problem.pair_gain(beam, h) * beam.error), key=rank)[:NEXT]
        simple = {name for h in worth for name in self.problem.known[h.added[-1]].refines}
        return worth + [h for h in tries if h.added[-1] in simple and h not in worth]

    def _with(self, beam: Hypothesis, effect: Effect) -> Hypothesis:
        """One more effect: on the measured motion, or on what the loop left, as its derivative foretells."""
        solution, design = beam.solution, beam.solution.design
        if design is None:
            return grid_fit(self.problem, beam, effect)
        left = self.regression.target - solution.modelled
        tries = []
        for shapes in grid(effect, self.regression):
            columns = self.regression.kept_columns(effect, shapes)
            sums = free_sums(np.hstack((design, columns)), left, self.regression.block)
            tries.append((float(held_out(sums, self.regression.fold).sum()), shapes, columns, sums))
        _, shapes, columns, sums = min(tries, key=lambda row: row[0])
        terms = (*solution.terms, Term(effect, shapes))
        made = replace(
            self.regression.solution(terms, np.hstack((solution.columns, columns)), whole=True),
            amplitudes={**solution.amplitudes, effect.name: sums.fit()[-columns.shape[1] :]},
            held_out=held_out(sums, self.regression.fold),
            count=sums.count,
        )
        return self.problem.hypothesis((*beam.added, effect.name), made, beam.identifiability)

    def needed(self, longest: Hypothesis) -> list[Hypothesis]:
        """An explanation without each effect that the others can do without, and what it was before."""
        out = [longest]
        for name in longest.added[:-1]:
            fewer = tuple(other for other in out[-1].added if other != name)
            rest = self._fitted(self.problem.keeping(out[-1], fewer), out[-1])
            if self.problem.carried(rest) and out[-1].error > self.problem.pair_gain(rest, out[-1]) * rest.error:
                out.append(rest)
        return out

    def _fitted(self, rest: Hypothesis, whole: Hypothesis) -> Hypothesis:
        """Some effects of an explanation fitted on from where they are in it."""
        if whole.solution.design is None:
            return refined(self.problem, rest)
        return self.ranking.alone(rest, whole)
