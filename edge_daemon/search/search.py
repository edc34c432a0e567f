"""The search for what is missing: single effects, then pairs, each fitted and judged on held-out blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from edge_daemon.effects.catalogue import find
from edge_daemon.effects.effect import Balance, Effect
from edge_daemon.effects.presliding import builds_up
from edge_daemon.identify.fit import fit_terms, refitted
from edge_daemon.identify.heard_noise import heard_noise
from edge_daemon.identify.solution import Term
from edge_daemon.identify.torque_lag import STEADY
from edge_daemon.motion.corrected import senses
from edge_daemon.search.belief import says_all, surpasses
from edge_daemon.search.free_orders import further, in_order, offered, with_orders
from edge_daemon.search.grid_fit import grid_fit, refined, rested, with_own_load
from edge_daemon.search.hypotheses import NEAR_FLOOR, DiagnosisProblem, Hypothesis, distinct, rank
from edge_daemon.search.order import insists, likely
from edge_daemon.search.pairs import Pairs
from edge_daemon.search.several import MOST_EFFECTS, Several
from edge_daemon.search.simulated_ranking import Rivals, SimulatedRanking
from edge_daemon.search.story import Story
from edge_daemon.search.thresholds import BELOW_SD, EXACT_FLOORS, FLOOR_DOUBT, TIE, UNDERCUT

REFINE_WITHIN = 1.7
"""Singles this close to the best on the grid are refined."""
LEAST_REFINED = 4
"""So many singles are refined in any case."""
GROWN_WITHIN = 0.8
"""Error of an effect that repeats over that of the model above which further orders are not looked for (guess)."""
MOST_RESTED = 3
"""So many of the best singles are searched on to the end at most: it costs as much as a fit (guess)."""
MOST_MOVED = 6
"""So many single explanations, and of several effects, are fitted on where a channel was moved (guess)."""
FAR_OFF = 0.55
"""Error of a finer form over that of its plainer one below which it need not wait for that: 0.04 to 0.5 where it was
the joint's own, 0.6 to 1 where other laws were missing."""
ALONE = 0.9
"""Error of a form beside its plainer one over its own below which it stood in for both (guess)."""
REACHED = 0.9
"""Nothing undercuts this error over the noise floor."""
NOT_QUITE = math.sqrt(1.0 + FLOOR_DOUBT)
"""Error over the noise floor above which a finer form of one law may stand in for two: so well is the floor known."""


class Search(DiagnosisProblem):
    """One diagnosis under way."""

    @cached_property
    def finer(self) -> list[Hypothesis]:
        """What waits for a plainer form, fitted in the place of that."""
        return []

    @cached_property
    def rivals(self) -> Rivals:
        """Refinements that do as well in the loop as the simpler form of a pair of names."""
        return {}

    @cached_property
    def tried(self) -> list[Hypothesis]:
        """Every effect that was fitted alone; none of a search that resumed another."""
        return []

    def run(self, most: int = MOST_EFFECTS, known: Sequence[Hypothesis] = ()) -> list[Hypothesis]:
        """Singles and, where one is not enough, pairs, and with two encoders up to so many at once; best first. Of
        effects that are `known` from another search of the same what that found is taken."""
        ranking = SimulatedRanking(
            self, self.rivals
        )  # not kept: a search that holds itself would hold its recordings for long
        singles = self._at_rest(ranking.finished(ranking.run(self._singles(known))))
        pairs = Pairs(self, ranking)
        if not singles or self.pair_gain(singles[0]) * singles[0].level <= REACHED:
            two = pairs.in_place(singles[0], singles) if singles and self._lacks(singles) else []
            return self._with_finer(self._heard(distinct([*singles, *two])))
        found = pairs.polished(singles)
        if self.drive:
            two = pairs.in_place(singles[0], singles) if self._lacks(found) and self._slides(singles[0]) else []
            return self._told(self._heard(distinct([*found, *two])))
        several = Several(self, ranking, pairs)
        found = distinct([*found, *pairs.hidden(singles)])
        return self._told(self._heard(self._with_zero(several.run(found, most))))

    def _lacks(self, found: Sequence[Hypothesis]) -> bool:
        """Whether nothing that was found explains all of a joint with one encoder."""
        return self.drive and min(h.level for h in found) > NOT_QUITE

    def _slides(self, single: Hypothesis) -> bool:
        """Whether a single is a finer form of presliding and of what builds up with it: no pair held these two."""
        return builds_up([self.known[name] for name in self.plainer(single.added[0]) if name in self.known])

    def _with_zero(self, found: list[Hypothesis]) -> list[Hypothesis]:
        """With a plainer form and the zero of a torque sensor in the place of a finer form that the best explanation
        has: the two look like it, and any sensor has a zero."""
        best = min(found, key=rank)
        zero = None if STEADY in best.added else self.known.get(STEADY)
        sensed = best.solution.design is None and senses(self.regression.motions[0])
        if (zero is None and STEADY not in best.added) or not sensed:
            return found
        self.regression.learn(best.solution)
        rows = [(term, self.known[name]) for term in best.solution.terms if term.effect.name in best.added
                for name in term.effect.refines if name in self.known and name not in best.added]  # fmt: skip
        plainer = [{*best.added, plain.name} - {term.effect.name} for term, plain in rows]
        begun = [*(h for h in found if set(h.added) in plainer), *(self._in_place(best, *row) for row in rows)]
        tries = begun if zero is None else [grid_fit(self, h, zero) for h in begun]
        tries = [min(h, refined(self, h), key=rank) for h in tries]
        self.regression.restore(self.start)
        near = (h for h in tries if h.error < REFINE_WITHIN * best.error)
        tries = [self._to_rest(h, TIE * best.error) for h in near]
        return distinct([*found, *(h for h in tries if self.carried(h) and h.error < TIE * best.error)])

    def _to_rest(self, hypothesis: Hypothesis, wanted: float) -> Hypothesis:
        """The same where a fit of it ends, and where that explains nothing, or leaves more than is wanted, one from
        where its effects begin: widths of a finer form may be a valley of the plainer one. Never worse."""
        terms = hypothesis.solution.terms
        begun = [Term(t.effect, t.effect.start) if t.effect.name in hypothesis.added else t for t in terms]
        best = hypothesis
        for fitted in (partial(refitted, solution=hypothesis.solution), partial(fit_terms, terms=begun)):
            if best.error > wanted or not self.carried(best):
                made = self.hypothesis(best.added, fitted(self.regression), best.identifiability)
                best = min(best, made, key=lambda h: (not self.carried(h), h.error))
                self.regression.restore(self.start)
        return best

    def _in_place(self, hypothesis: Hypothesis, finer: Term, plain: Effect) -> Hypothesis:
        """A hypothesis with a plainer effect in the place of one of its terms, as far as they have shapes in common."""
        rest = self.keeping(hypothesis, tuple(name for name in hypothesis.added if name != finer.effect.name))
        shapes = plain.start | {name: value for name, value in finer.shapes.items() if name in plain.start}
        columns = np.hstack((rest.solution.columns, self.regression.kept_columns(plain, shapes)))
        solution = self.regression.solution([*rest.solution.terms, Term(plain, shapes)], columns)
        return self.hypothesis((*rest.added, plain.name), solution, hypothesis.identifiability)

    def resumed(self, earlier: Search, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The same of recordings of which another search knows most, before a channel was moved by a part of a sample:
        its explanations are fitted on from where they were, without what made up for that part of a sample, and the
        story is told anew; all of it where that found nothing."""
        if not found:
            return self.run()
        self.waiting = dict(earlier.waiting)
        self.finer.extend(filter(self.carried, map(self._moved, earlier.finer)))
        rows = [[h for h in found if (len(h.added) > 1) == more][:MOST_MOVED] for more in (False, True)]
        alone, several = (list(map(self._moved, row)) for row in rows)
        moved = [*alone, *(rested(self, h) for h in several[:MOST_RESTED]), *several[MOST_RESTED:]]
        moved = self._at_rest(sorted(filter(self.carried, moved), key=rank))
        if not moved:
            return []
        needed = Story(self).needed(moved[0])
        moved = [needed, *(h for h in moved if len(h.added) <= len(needed.added) or surpasses(h, needed, self))]
        return self._told(self._heard(distinct(moved)))

    def _moved(self, hypothesis: Hypothesis) -> Hypothesis:
        """An explanation of another search, fitted here."""
        terms = [term for term in hypothesis.solution.terms if term.effect.name in hypothesis.added]
        solution = self.regression.fit([*self.base.solution.terms, *terms], search=False)
        self.regression.restore(self.start)
        return refined(self, self.hypothesis(hypothesis.added, solution))

    def _told(self, found: list[Hypothesis]) -> list[Hypothesis]:
        """What was found, with a whole story where it leaves more than noise, and what each may be taken for."""
        found = self._heard(Story(self).told(found, self.finer)) if self._unsolved([*found, *self.finer]) else found
        return self._with_finer(self._with_rivals(found))

    def _with_rivals(self, found: list[Hypothesis]) -> list[Hypothesis]:
        """With what waited for the plain law of a pair that says all: the two are one explanation only beside what may
        take the place of either; and with the plainer forms of a finer law, which a pair found without them."""
        best = min((h for h in found if len(h.added) > 1), key=rank, default=None)
        if best is None or len(best.added) > 2 or not self.drive or not says_all(best, found, self):
            return found
        story = Story(self)
        return distinct([*found, *(story.rivals(best) if self.awaited(best) else story.in_plainer_forms(best))])

    def _heard(self, found: list[Hypothesis]) -> list[Hypothesis]:
        """The same against the noise that the best of all leaves, where with one encoder that is nothing else: a
        current's noise may be of any colour, and no floor knows it then. Nor is noise more than the best leaves."""
        best = min([self.base, *found], key=rank)
        self.noise = max(self.noise, heard_noise(self.regression, best.solution, best.floor))
        best = min([best, *self.finer], key=rank)
        if not self.drive:  # the most that the model's own floor allows was none of this noise
            self.most_floor = max(self.most_floor, self.noise)
        elif self._undercuts(best):
            self.most_floor = min(self.most_floor, best.rmse)
        self.finer[:] = [replace(h, floor=self.within(h.floor)) for h in self.finer]
        self.base, *found = (replace(h, floor=self.within(h.floor)) for h in (self.base, *found))
        return found

    def _undercuts(self, best: Hypothesis) -> bool:
        """Whether a floor was taken too high: an explanation leaves far less, or samples below it insist on it."""
        return best.level < UNDERCUT or (best.level < 1.0 and likely(self.base, best, self.regression, BELOW_SD))

    def _with_finer(self, found: list[Hypothesis]) -> list[Hypothesis]:
        """With the finer forms of the best single that waited for it and do better, where it needs no second effect:
        what the samples tell of the two decides how far either is believed."""
        best = min((h for h in found if len(h.added) == 1), key=rank, default=None)
        if best is None:
            return found
        if any(len(h.added) > 1 and h.error < self.pair_gain(best, h) * best.error for h in found):
            return found
        rows = [h for h in self.finer if best.added[0] in self.known[h.added[0]].refines and h.error < best.error]
        for hypothesis in rows:
            self.waiting.pop(hypothesis.added[0], None)
        return distinct([*found, *rows])

    def _at_rest(self, ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best singles with their shapes searched to the end: what a search that stopped short leaves would seem to
        be a second effect, and a hundredth of it decides between two names."""
        near = [h for h in ranked[:MOST_RESTED] if h.error < REFINE_WITHIN * ranked[0].error]
        done = {h.added: rested(self, h) for h in near if near[-1].level > NEAR_FLOOR or len(near) > 1}
        done = {name: h for name, h in done.items() if self.carried(h)}
        return sorted((done.get(h.added, h) for h in ranked), key=rank)

    def _unsolved(self, found: list[Hypothesis]) -> bool:
        """Whether a balance that is built up step by step is left with more than noise."""
        return self.drive and min(h.level for h in found) > EXACT_FLOORS

    @property
    def drive(self) -> bool:
        """Whether the joint has one encoder."""
        return any(effect.balance == "drive" for effect in self.known.values())

    def _singles(self, known: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Every effect on the measured motion, best first."""
        self._release()
        tries = [h for h in known if h.added[0] not in self.waiting]
        done = {h.added for h in tries}
        lacking = [effect for effect in self.candidates if (effect.name,) not in done]
        effects = offered(lacking, self.base.solution, self.regression)
        for i, effect in enumerate(effects):
            self.progress(effect.name, 0.4 * i / len(effects))
            tries.append(with_own_load(self, self._grown(effect, grid_fit(self, self.base, effect))))
        tries = sorted((h for h in tries if self.carried(h)), key=rank)
        best = tries[0].error if tries else 0.0
        near = [h.error < REFINE_WITHIN * best and self.base.level > NEAR_FLOOR for h in tries]
        worth = (i < LEAST_REFINED or close for i, close in enumerate(near))
        rows = (refined(self, h) if more and h not in known else h for h, more in zip(tries, worth, strict=True))
        singles = sorted(rows, key=rank)
        self.tried[:] = [*singles, *(h for h in self.finer if h.added[0] in self.waiting)]
        return singles

    def _grown(self, effect: Effect, hypothesis: Hypothesis) -> Hypothesis:
        """The same with the orders that are seen only now, the stiffness beside an error of the angles being found."""
        if effect.over is None or hypothesis.error > GROWN_WITHIN * self.base.error:
            return hypothesis
        more = with_orders(further(effect), hypothesis.solution, self.regression)
        if more is None:
            return hypothesis
        wider = effect.over(in_order((*effect.waves, *more.waves), effect))
        return min(hypothesis, grid_fit(self, self.base, wider), key=lambda h: h.level)

    def _release(self) -> None:
        """What waits for plainer forms is weighed with the rest where those are far off: a joint that slipping elements
        explain has no dry friction first, and a drag with the root of speed no viscous one. What lies between two
        forms, as powers of the speed do, stands in for both where it only comes nearer, or takes less than with them.
        """
        for name, plainer in list(self.waiting.items()):
            effect = self.known.get(name)
            if effect is None or effect.carried or any(find(row, effect.balance).carried for row in plainer):
                continue
            plain = self._with(self.base, plainer, effect.balance)
            fine = refined(self, grid_fit(self, self.base, effect))
            exact = fine.level <= NEAR_FLOOR and insists(plain, fine, self.regression)
            ready = exact or fine.error < FAR_OFF * plain.error
            forms = [*plainer, *self._plainer_still(plainer)]
            if ready and len({*forms, *effect.refines}) > 1:
                fine = rested(self, fine)
                ready = refined(self, self._with(fine, forms, effect.balance)).error > ALONE * fine.error
            if self.carried(fine):
                self.finer.append(fine)
                if ready:
                    del self.waiting[name]

    def _plainer_still(self, names: Sequence[str]) -> list[str]:
        """The plain forms that some of these refine in their turn and the model lacks."""
        rows = [self.known[name] for name in names if name in self.known]
        return [simple for row in rows for simple in row.refines if simple in self.known and simple not in names]

    def _with(self, onto: Hypothesis, names: Sequence[str], balance: Balance) -> Hypothesis:
        """A hypothesis with more effects, each at the best point of its grid."""
        for name in names:
            onto = grid_fit(self, onto, find(name, balance))
        return onto
