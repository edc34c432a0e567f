"""Two effects at once, where one is not enough: a second one added to the best singles, and what it may be confused
with."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from edge_daemon.effects.effect import Effect, twin
from edge_daemon.identify.structure import lawful
from edge_daemon.search.grid_fit import grid_fit, moves_with_fit, refined, tried
from edge_daemon.search.hypotheses import NEAR_FLOOR, UNSOLVED, DiagnosisProblem, Hypothesis, distinct, rank
from edge_daemon.search.simulated_ranking import SimulatedRanking
from edge_daemon.search.thresholds import TIE

BEAMS = 3
HELPFUL = 0.97
"""A second effect is added to a single one that leaves less than this share of the model's error."""
ENOUGH_FLOORS, ENOUGH_SHARE = 4.0, 0.05
"""A second effect is added to the best single alone below this error in noise floors, and over that of the model."""
ALIKE = 0.999
"""A second effect is added to one only of two effects whose leavings correlate by more than this."""
POLISHES = 2
"""A variation of the best pair may take its place so often."""
CLOSE = 1.6
"""A beam whose second best pair on the grid errs by this many times the best is not refined."""
SIBLING_WITHIN = 1.5
"""A variation of the best pair is kept within this factor of its error."""
HIDDEN_BY = 2
"""So many effects are looked for beside an error of the angles that hides the spring (guess)."""
WORTH = 0.9
"""A pair on the grid is not pursued that leaves more than this share of its first effect's error."""


class Pairs:
    """The pairs of one diagnosis."""

    def __init__(self, problem: DiagnosisProblem, ranking: SimulatedRanking) -> None:
        self.problem, self.regression, self.ranking = problem, problem.regression, ranking

    def polished(self, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Singles and pairs, best first; the best pair's variations among them."""
        found = distinct([*singles, *self._found(self._beams(singles), singles)])
        if found[0].level > UNSOLVED and (bent := self._bent(singles)):
            found = distinct([*found, *self._found(bent, singles)])
        for _ in range(POLISHES):
            best = next((h for h in found if len(h.added) > 1), None)
            if best is None or best.error > self.problem.pair_gain(singles[0], best) * singles[0].error:
                break
            siblings = sorted(self._siblings(best), key=rank)
            found = distinct([*found, *siblings])
            if not siblings or siblings[0].error > WORTH * best.error:
                break
            found = distinct([*found, *self.ranking.run([refined(self.problem, siblings[0])])])
        return self._alone(self._with_twins(found))

    def _alone(self, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """With the parts of the best pair that it would be preferred to fitted on from where they are in it: a law in
        the loop that all but explains may have stopped in a valley that the second effect led out of."""
        pair = next((h for h in found if len(h.added) > 1), None)
        if pair is None:
            return list(found)
        parts = [h for h in found if len(h.added) == 1 and h.added[0] in pair.added and self.problem.inexact(h)]
        parts = [h for h in parts if pair.error < self.problem.pair_gain(h, pair) * h.error]
        return distinct([*found, *(self.ranking.alone(h, pair) for h in parts)])

    def _with_twins(self, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best pair with a part replaced by its twin, simulated as the pair was: on the measured motion the form
        with more numbers always does better, and what is simulated does better than what is not."""
        best = next((h for h in found if len(h.added) > 1), None)
        if best is None or best.solution.design is None:
            return list(found)
        tries = [(name, effect) for name in best.added for effect in self.instead(best, name)]
        twins = [
            self.exchanged(best, name, effect) for name, effect in tries if self._unheard(best, name, effect, found)
        ]
        return distinct([*found, *(h for twin in twins for h in self.ranking.run([twin], rival=best))])

    def instead(self, pair: Hypothesis, name: str) -> list[Effect]:
        """Effects that a part may be taken for, or that refine it; where nothing is left, only those that no motion
        tells from it."""
        others = [effect for effect in self.problem.candidates if effect.name not in pair.added]
        facts = [(effect, twin(self.problem.known[name], effect)) for effect in others]
        left = pair.level > NEAR_FLOOR
        return [
            effect for effect, fact in facts if (fact and fact.parted_by) or (left and (fact or name in effect.refines))
        ]

    def _unheard(self, pair: Hypothesis, name: str, other: Effect, found: Sequence[Hypothesis]) -> bool:
        """Whether an effect was not simulated in the place of a part."""
        names = {other.name, *pair.added} - {name}
        return not any(set(h.added) == names and h.solution.design is not None for h in found)

    def exchanged(self, pair: Hypothesis, name: str, other: Effect) -> Hypothesis:
        """The pair, or what has more parts, with another effect in the place of one."""
        self.regression.learn(pair.solution)
        kept = self.problem.keeping(pair, tuple(part for part in pair.added if part != name))
        made = grid_fit(self.problem, kept, other)
        self.regression.restore(self.problem.start)
        return self._at_its_own(made)

    def in_place(self, finer: Hypothesis, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Two effects in the place of a finer form of one, which may stand in for both, best first."""
        plainer = self.problem.plainer(finer.added[0])
        beams = [h for h in singles if h.added[0] in plainer and h.error < HELPFUL * self.problem.base.error]
        return self._found(beams[:BEAMS], singles) if beams else []

    def _found(self, beams: Sequence[Hypothesis], singles: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What a second effect on some singles comes to, best first."""
        found: dict[tuple[str, ...], Hypothesis] = {}
        reserve: list[Hypothesis] = []
        for i, beam in enumerate(beams):
            self.problem.progress(f"{beam.name} and another", 0.7 + 0.25 * i / len(beams))
            tries = self._on_grid(beam)
            reserve += [h for h in tries if lawful(h.solution.terms)]
            chosen = self._seconds(tries, beam)
            chosen += self._on_plainer(chosen, beam, singles)
            found |= {h.added: refined(self.problem, h) for h in chosen}
        ranked = sorted(found.values(), key=rank)
        best = min([*(h.level for h in ranked), *(h.level for h in singles)])
        if best <= NEAR_FLOOR:
            return ranked
        return self.ranking.run(ranked, reserve, singles[0])

    def _on_grid(self, beam: Hypothesis) -> list[Hypothesis]:
        """Every effect on top of one that may be pursued."""
        self.regression.learn(beam.solution)
        new = [effect for effect in self.problem.candidates if not self.problem.overlap(effect, beam)]
        tries = tried(self.problem, beam, new, CLOSE)
        self.regression.restore(self.problem.start)
        return [h for h in tries if self.problem.carried(h)]

    def _seconds(self, tries: Sequence[Hypothesis], beam: Hypothesis) -> list[Hypothesis]:
        """The pairs of a beam that are pursued: the best two that differ, their plainer forms, and dry friction where
        none of them explains what is left."""
        worthy = [h for h in sorted(tries, key=rank) if h.error < WORTH * beam.error]
        others = [h for h in worthy[1:] if h.error < CLOSE * worthy[0].error and not self.alike(h, worthy[0])]
        chosen = [*worthy[:1], *others[:1]]
        chosen += self._plainer(chosen, tries)
        if not worthy or worthy[0].level > UNSOLVED:
            chosen += [h for h in tries if self.problem.dry(h) and h not in chosen]
        return chosen

    def _plainer(self, chosen: Sequence[Hypothesis], tries: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The pairs on the grid with a simpler form of the effect that a chosen one has as its second."""
        simple = {name for h in chosen for name in self.problem.known[h.added[-1]].refines}
        return [h for h in tries if h.added[-1] in simple and h not in chosen and lawful(h.solution.terms)]

    def _on_plainer(
        self, chosen: Sequence[Hypothesis], beam: Hypothesis, singles: Sequence[Hypothesis]
    ) -> list[Hypothesis]:
        """The chosen pairs with a simpler form of their first effect: alone the finer one may take a little of the
        second, beside which it says no more."""
        simple = [h for h in singles if self.problem.simplifies(h, beam) and lawful(h.solution.terms)]
        pairs = [(h, self.problem.known[pair.added[-1]]) for h in simple for pair in chosen]
        tries = [grid_fit(self.problem, h, effect) for h, effect in pairs if not self.problem.overlap(effect, h)]
        return [h for h in tries if self.problem.carried(h)]

    def hidden(self, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What leaves least of two or three effects with an error of the angles, where no single helps that the spring
        carries: a skew of a fast joint moves the twist by more than its torque does, until all that turns the joint is
        known."""
        base, problem = self.problem.base, self.problem
        if any(h.error < HELPFUL * base.error for h in singles):
            return []
        read = [effect for effect in problem.candidates if effect.kind == "measurement" and effect.over is None]
        beams = [refined(problem, grid_fit(problem, base, effect)) for effect in read]
        for _ in range(HIDDEN_BY):
            beams = [h for h in sorted(beams, key=rank) if h.error < HELPFUL * base.error][:BEAMS]
            tries = [(h, new) for h in beams for new in problem.candidates if not problem.overlap(new, h)]
            beams = distinct([refined(problem, grid_fit(problem, *row)) for row in tries])
            if beams and problem.carried(beams[0]):
                return [h for h in beams if problem.carried(h)]
        return []

    def _beams(self, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What a second effect is added to: the best singles, and any measurement effect that helps."""
        base, known = self.problem.base, self.problem.known
        helpful = [h for h in singles if h.error < HELPFUL * base.error]
        if helpful and helpful[0].level < ENOUGH_FLOORS and helpful[0].error < ENOUGH_SHARE * base.error:
            return helpful[:1]
        measuring = [h for h in helpful if known[h.added[0]].kind == "measurement"]
        chosen: list[Hypothesis] = []
        for hypothesis in [*helpful[:2], *measuring[:2], *helpful[2:]]:
            chosen = [hypothesis if self._usually(h, hypothesis) else h for h in chosen]
            relatives = {*known[hypothesis.added[0]].refines, hypothesis.added[0]}
            relatives |= {h.added[0] for h in chosen if hypothesis.added[0] in known[h.added[0]].refines}
            new = relatives.isdisjoint(h.added[0] for h in chosen)
            if new and not any(self.alike(hypothesis, h) for h in chosen):
                chosen.append(hypothesis)
        return chosen[:BEAMS]

    def _bent(self, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best law of the twist that alone helps nothing: beside a damper that imitates a loop, and a spring that
        is bent, friction of the twist shows only once the bend is there."""
        laws = (h for h in singles if h.error >= HELPFUL * self.problem.base.error and lawful(h.solution.terms))
        return list(itertools.islice(laws, 1))

    def _usually(self, rarer: Hypothesis, usual: Hypothesis) -> bool:
        """Whether what leaves the same behind is the more usual of the two."""
        return usual.added[0] in self.problem.yields_to(rarer.added[0]) and self.alike(rarer, usual)

    def alike(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether two explanations leave the same behind: one function of this motion under two names."""
        a, b = (self.regression.held_out_residual(h.solution) for h in (one, other))
        return float(a @ b) > ALIKE * math.sqrt(float(a @ a) * float(b @ b))

    def _siblings(self, pair: Hypothesis) -> list[Hypothesis]:
        """A pair with one part replaced by another effect: what it may be confused with; or by itself over the waves
        that it shows beside the other part, which first were heard together."""
        out = []
        self.regression.learn(pair.solution)
        for kept in pair.added:
            onto = self.problem.keeping(pair, (kept,))
            for effect in self.problem.offered(onto, SIBLING_WITHIN * pair.error / onto.error):
                if self._is_new(effect, pair) and not self.problem.overlap(effect, onto):
                    sibling = grid_fit(self.problem, onto, effect)
                    if self.problem.carried(sibling) and sibling.error < SIBLING_WITHIN * pair.error:
                        out.append(sibling)
        self.regression.restore(self.problem.start)
        return [self._simulated(self._at_its_own(sibling), pair) for sibling in out]

    def _is_new(self, effect: Effect, pair: Hypothesis) -> bool:
        """Whether a pair has no such effect, or over other waves."""
        return all(term.effect.name != effect.name or term.effect.waves != effect.waves for term in pair.solution.terms)

    def _simulated(self, sibling: Hypothesis, pair: Hypothesis) -> Hypothesis:
        """A sibling that comes near the pair, simulated as that was where it corrects the twist: its law is still that
        of the pair's twist, which would be another."""
        moved = lawful(sibling.solution.terms) and moves_with_fit(sibling.solution.terms)
        if not moved or pair.solution.design is None or sibling.error > TIE * pair.error:
            return sibling
        return self.ranking.at_its_own(sibling)

    def _at_its_own(self, made: Hypothesis) -> Hypothesis:
        """A pair whose load or twist is its own, not that of the pair which it is a variation of."""
        return refined(self.problem, made) if moves_with_fit(made.solution.terms) else made
