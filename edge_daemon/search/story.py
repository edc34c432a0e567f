"""The whole story of a joint with one encoder, where neither one effect nor two are enough.

What several laws do together may show in none of them alone: a drag that grows cold hides a ripple, and a wave hides
both. So effects are built up one on another although no step is sure, and then each is left out again: what the rest
does as well without was never there (forward selection with backward elimination; Efroymson 1960, in Ralston & Wilf,
Mathematical Methods for Digital Computers). What came first may have stood in for another that was not looked for yet:
so the place of each is searched anew among all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from functools import partial

from edge_daemon.effects.effect import Effect
from edge_daemon.identify.torque_lag import STEADY
from edge_daemon.search.belief import SHOWN, outbids, surpasses
from edge_daemon.search.free_orders import offered
from edge_daemon.search.grid_fit import grid_fit, refined, rested, tried, with_own_load
from edge_daemon.search.hypotheses import LOAD_FRICTION, LOADS, NEAR_FLOOR, DiagnosisProblem, Hypothesis, distinct, rank
from edge_daemon.search.order import improves, insists, likely
from edge_daemon.search.order import refined as refined_of
from edge_daemon.search.thresholds import EXACT_FLOORS, LEAST_GAIN, LIKELY_GAIN

LONGEST = 8
"""Effects that are built up at the most (guess)."""
ROUNDS = 3
"""So often what was left out may make room for another (guess)."""
SURE = 10.0
"""Error over that of the story from which on what was left out is needed, whatever the others' shapes do (guess)."""
HOPELESS = 3.0
"""Error in noise floors of a story that was built up above which no more than its next effect is told: those that ended
well had at most 1.6 (guess)."""
RIVALS = 3.0
"""Error of a pair on the grid over that of another up to which it is a rival of that (guess)."""
ALIKE = 1.1
"""Error with a more usual or a rarer effect in the place of another, on the grid, up to which it may be it (guess)."""
EXCHANGED = 3
"""So many of the nearest on the grid are searched in the place of a law: each costs as much as a fit (guess)."""
WIDTH = "width"
"""The shape of a drive's presliding."""
IDLE_STEPS = 2
"""So many steps in a row that the data do not insist on end a story: what two laws show together only is found by the
second (guess)."""
STEP_GAIN = 0.99
"""Error after over before below which a story goes on, if that is worth the numbers too (guess)."""


class Story:
    """One story under way."""

    def __init__(self, problem: DiagnosisProblem) -> None:
        self.problem, self.regression, self.known = problem, problem.regression, problem.known
        self.plainer: list[Hypothesis] = []
        """What was searched without an effect, or with a plainer form of it, and may be what it is confused with"""
        self.idle: set[str] = set()
        """Effects without which a story did as well: where they take as little again, a later one ends before them"""

    def told(self, found: Sequence[Hypothesis], finer: Sequence[Hypothesis] = ()) -> list[Hypothesis]:
        """What was found, and what becomes of the best of it, or of the `finer` forms that wait: several effects where
        the data insist on them."""
        stories = self._stories(min((*found, *finer), default=self.problem.base, key=rank))
        several = [h for h in (*stories, *self._near_in_plainer_form(stories[-1])) if self._several(h)]
        told = [h for h in several if outbids(h, [*found, *stories], self.problem)]
        alike = self._as_usual(stories[-1]) if stories[-1] in told else []
        return distinct([*told, *alike, *found])

    def _near_in_plainer_form(self, story: Hypothesis) -> list[Hypothesis]:
        """Plainer forms of a story that come near it."""
        alike = (h for h in self.plainer if len(h.added) == len(story.added))
        return [h for h in alike if h.error < RIVALS * story.error]

    def _as_usual(self, story: Hypothesis) -> list[Hypothesis]:
        """A story with what is more usual, or rarer, in the place of one of its effects, as far as that does as well:
        a motion may tell neither from the other."""
        yields_to = {name: self.problem.yields_to(name) for name in self.known}
        pairs = [(name, other) for name, other in itertools.product(story.added, self.known)
                 if other not in story.added and (other in yields_to[name] or name in yields_to[other])]  # fmt: skip
        tries = [grid_fit(self.problem, self._cut(story, name), self.known[other]) for name, other in pairs]
        settled = map(self._settled, [h for h in tries if h.error < ALIKE * story.error])
        return [h for h in settled if h is not None]

    def _stories(self, start: Hypothesis) -> list[Hypothesis]:
        """How a story goes on from its start: other laws in the place of its own, then as many more as are needed; only
        one more where all together do not explain what there is."""
        stories, known = [self._exchanged(start)], {frozenset(start.added)}
        for _ in range(ROUNDS):
            steps = self._built_up(stories[-1])
            hopeless = steps[-1].level > HOPELESS
            longer = self.needed(steps[:2][-1] if hopeless else steps[-1])
            self.idle |= {*steps[-1].added} - {*longer.added}
            if {frozenset(longer.added)} & {*known, frozenset(stories[-1].added)}:
                break
            known.add(frozenset(longer.added))
            longer = self._exchanged(refined(self.problem, longer))
            if set(longer.added) == set(stories[-1].added):
                break
            stories.append(longer)
            if hopeless:
                break
        return stories

    def _several(self, story: Hypothesis) -> bool:
        """Whether it tells more than one law."""
        rows = [self.known[name] for name in story.added]
        return len(rows) > 1 and not any(same_dry_friction(*two) for two in itertools.combinations(rows, 2))

    def rivals(self, pair: Hypothesis) -> list[Hypothesis]:
        """What may be in the place of either effect of a pair: what waited for its plain law was not tried before."""
        settled = [h for name in pair.added for h in self._instead(pair, name)]
        refines = {name: row.refines for name, row in self.known.items()}
        return [h for h in settled if not (refined_of(h, pair, refines) and not self._told(pair, h))]

    def in_plainer_forms(self, pair: Hypothesis) -> list[Hypothesis]:
        """A pair with a plainer form of either effect, as far as that comes near it."""
        for name in pair.added:
            self._without(pair, name)
        return [h for h in self._near_in_plainer_form(pair) if self._several(h)]

    def _instead(self, story: Hypothesis, name: str, within: float = RIVALS, most: int = SHOWN) -> list[Hypothesis]:
        """The story with other effects in the place of one, as far as they come near it."""
        rest = self._cut(story, name)
        self.regression.learn(story.solution)
        share = within * story.error / rest.error
        effects = offered(self._free(rest, name), rest.solution, self.regression, share)
        tries = [grid_fit(self.problem, rest, effect) for effect in effects]
        self.regression.restore(self.problem.start)
        near = sorted((h for h in tries if h.error < within * story.error), key=rank)
        return [h for h in map(self._settled, near[:most]) if h is not None]

    def _built_up(self, story: Hypothesis) -> list[Hypothesis]:
        """The story, and how it goes on: each step the best, however little it takes, as long as the error falls and
        more than noise is left; not on and on by steps that the data do not insist on."""
        steps, idle = [story], 0
        while len(steps[-1].added) < LONGEST and steps[-1].level > NEAR_FLOOR and idle < IDLE_STEPS:
            self.problem.progress("a whole story", 0.95)
            better = self._next(steps[-1])
            if better is None:
                break
            idle = 0 if self._misses(steps[-1], better) else idle + 1
            if idle and better.added[-1] in self.idle:
                break
            steps.append(better)
        return steps

    def _next(self, story: Hypothesis) -> Hypothesis | None:
        """The story with one more effect; None where none takes anything."""
        for within in (1.0, math.inf):
            self.regression.learn(story.solution)
            tries = [*tried(self.problem, story, self._free(story), within), *self._as_load(story)]
            self.regression.restore(self.problem.start)
            gains = (h for h in tries if h.error < STEP_GAIN * story.error and rank(h) < rank(story))
            worth = sorted(gains, key=rank)
            settled = next((h for h in map(self._settled, worth) if h is not None), None)
            if settled is not None or not worth:
                return settled
        return None

    def _as_load(self, story: Hypothesis) -> list[Hypothesis]:
        """The story with its steady torque as a load that makes friction: neither shows without the other."""
        steady, friction = (self.known.get(name) for name in (STEADY, LOAD_FRICTION[0]))
        loaded = any(term.effect.loaded for term in story.solution.terms)
        if steady is None or friction is None or loaded or set(steady.refines).isdisjoint(story.solution.names):
            return []
        return [with_own_load(self.problem, grid_fit(self.problem, grid_fit(self.problem, story, friction), steady))]

    def _settled(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """The same with its shapes searched, where one of its laws is none any more beside the others in a plainer form
        of that; None where it is no explanation."""
        if not self.problem.carried(hypothesis):
            return None
        settled = refined(self.problem, hypothesis)
        if self.problem.carried(settled):
            return settled
        plainer = (h for name in settled.added for h in self._plainer(settled, name))
        searched = map(partial(refined, self.problem), filter(self.problem.carried, plainer))
        return min(filter(self.problem.carried, searched), default=None, key=rank)

    def _plainer(self, story: Hypothesis, name: str) -> list[Hypothesis]:
        """The story with plainer forms of one of its effects, on the grid."""
        rest = self._cut(story, name)
        rows = [self.known[row] for row in self.known[name].refines if row in self.known and row not in rest.added]
        return [grid_fit(self.problem, rest, row) for row in rows]

    def _free(self, story: Hypothesis, instead: str = "") -> list[Effect]:
        """Effects that the story may go on with, in the place of another that was taken out: whatever waits for nothing
        that it lacks."""
        beside = [self.known[name] for name in story.added]
        rows = [row for name, row in self.known.items() if name not in (*story.solution.names, instead)]
        rows = [row for row in rows if self._ready(row, story.added, instead)]
        return [row for row in rows if not any(same_dry_friction(row, other) for other in beside)]

    def _ready(self, effect: Effect, beside: Collection[str], instead: str) -> bool:
        """Whether an effect waits for nothing that some effects lack, themselves or in another form; what takes the
        place of another need not wait for its plain forms."""
        rows = [self.known[other] for other in beside]
        held = {*beside, instead, *(plain for row in rows for plain in row.refines + row.yields_to)}
        held |= set(LOADS) if any(row.carried for row in rows) else set()
        held |= set(LOAD_FRICTION) if any(row.loaded for row in rows) else set()
        held |= set(effect.refines) if instead else set()
        return set(self.problem.waiting.get(effect.name, ())) <= held

    def needed(self, story: Hypothesis) -> Hypothesis:
        """The story without what the rest does as well without: finer forms first, then the least needed. What was
        needed once is looked at again at the end: beside fewer laws it hardly ever becomes idle."""
        settled: set[str] = set()
        while len(story.added) > 1:
            rests = {name: self._without(story, name) for name in story.added if name not in settled}
            idle = {name: rest for name, rest in rests.items() if rest is not None}
            if idle:
                settled |= rests.keys() - idle.keys()
                story = idle[min(idle, key=lambda name: (not self.known[name].refines, rank(idle[name])))]
            elif len(rests) == len(story.added):
                break
            else:
                settled = set()
        return story

    def _exchanged(self, story: Hypothesis) -> Hypothesis:
        """The story with each law exchanged for the one that the data insist on in its place."""
        for name in story.added if len(story.added) > 1 else ():
            if name not in story.added:  # gone with the load that it was a friction of
                continue
            near = story.level <= EXACT_FLOORS
            other = min(self._instead(story, name, 1.0 if near else RIVALS, EXCHANGED), key=rank, default=story)
            other = rested(self.problem, other) if other.error < story.error else other
            if (self._told if near else self._misses)(story, other) and self._explains(other, story):
                story = other
        return story

    def _explains(self, other: Hypothesis, story: Hypothesis) -> bool:
        """Whether it is near the noise, or far nearer to it: of what much is left of, any law mends a part."""
        return other.level <= HOPELESS or surpasses(other, story, self.problem)

    def _misses(self, rest: Hypothesis, story: Hypothesis) -> bool:
        """Whether the rest leaves more than chance would, and so much that it is worth a name, or a finer name."""
        more = [self.known[name] for name in set(story.added) - set(rest.added)]
        finer = any(row.refines or row.yields_to for row in more)
        if story.error > (LIKELY_GAIN if finer else 1 - LEAST_GAIN) * rest.error:
            return False
        return improves(rest, story) or likely(rest, story, self.regression) or self._told(rest, story)

    def _told(self, plain: Hypothesis, finer: Hypothesis) -> bool:
        """Whether samples that count for what they tell insist on one story rather than the other."""
        return finer.error < plain.error and insists(plain, finer, self.regression)

    def _without(self, story: Hypothesis, name: str) -> Hypothesis | None:
        """The story fitted without one of its effects, or with a plainer form of it; None where it is needed."""
        tries = [self._cut(story, name), *self._plainer(story, name)]
        return next((h for h in map(partial(self._does, story), tries) if h is not None), None)

    def _does(self, story: Hypothesis, rest: Hypothesis) -> Hypothesis | None:
        """The rest, its shapes searched where it needs that, if it does as well. A lighter load rubs less."""
        if rest.error > SURE * story.error:
            return None
        lighter = any(self.known[name].carried for name in set(story.added) - set(rest.added))
        lighter &= any(term.effect.loaded for term in rest.solution.terms)
        rest = refined(self.problem, rest) if lighter or self._misses(rest, story) else rest
        if not self.problem.carried(rest):
            return None
        self.plainer.append(rest)
        return None if self._misses(rest, story) else rest

    def _cut(self, story: Hypothesis, name: str) -> Hypothesis:
        """The story without one of its effects and what is none without it, the shapes of the others as they are."""
        names = tuple(other for other in story.added if other != name)
        if not any(self.known[other].carried for other in names):
            names = tuple(other for other in names if set(LOADS).isdisjoint(self.problem.waiting.get(other, ())))
        return self.problem.keeping(story, names)


def same_dry_friction(one: Effect, other: Effect) -> bool:
    """Whether one is a form of presliding that holds the other, dry friction that knows no load, or both are."""
    if one.slips and other.slips:
        return True
    pairs = ((one, other), (other, one))
    return any(WIDTH in row.start and dry.name in row.refines and not dry.loaded for row, dry in pairs)
