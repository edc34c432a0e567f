"""The whole story of a joint with one encoder, where neither one effect nor two are enough.

What several laws do together may show in none of them alone: a drag that grows cold hides a ripple, and a wave hides
both. So effects are built up one on another although no step is sure, and then each is left out again: what the rest
does as well without was never there (forward selection with backward elimination; Efroymson 1960, in Ralston & Wilf,
Mathematical Methods for Digital Computers).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial

from edge_daemon.effects.effect import Effect
from edge_daemon.search.free_orders import offered
from edge_daemon.search.grid_fit import grid_fit, refined
from edge_daemon.search.hypotheses import LOADS, NEAR_FLOOR, DiagnosisProblem, Hypothesis, distinct, rank
from edge_daemon.search.order import improves, insists, likely
from edge_daemon.search.order import refined as refined_of
from edge_daemon.search.thresholds import EXACT_FLOORS, LEAST_GAIN, LIKELY_GAIN, PAIR_GAIN, SURE_PAIR_GAIN

LONGEST = 8
"""Effects that are built up at the most (guess)."""
ROUNDS = 3
"""So often what was left out may make room for another (guess)."""
SURE = 30.0
"""Error over that of the story from which on what was left out is needed, whatever the others' shapes do (guess)."""
HOPELESS = 3.0
"""Error in noise floors of a story that was built up above which it ends in none: those that ended well had at most 1.6
(guess)."""
RIVALS = 3.0
"""Error of a pair on the grid over that of another up to which it is a rival of that (guess)."""
STEP_GAIN = 0.99
"""Error after over before below which a story goes on (guess)."""


class Story:
    """One story under way."""

    def __init__(self, problem: DiagnosisProblem) -> None:
        self.problem, self.regression, self.known = problem, problem.regression, problem.known

    def told(self, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What was found, and before it the story where that leaves no more than noise, and much less than the rest; or
        two effects of it that leave far less than any two that were found."""
        best = min((h.error for h in found), default=self.problem.base.error)
        story, steps = self.problem.base, list[Hypothesis]()
        for _ in range(ROUNDS):
            steps += self._built_up(story)
            if steps[-1].level > HOPELESS:
                break
            longer = self._exchanged(self._needed(steps[-1]))
            if set(longer.added) == set(story.added):
                break
            story = longer
        if self._several(story) and story.level < NEAR_FLOOR and story.error < PAIR_GAIN * best:
            return [story, *found]
        pairs = [h for h in (*steps, story) if len(h.added) == 2 and self._several(h)]
        return distinct([*(pair for pair in pairs if pair.error < SURE_PAIR_GAIN * best), *found])

    def _several(self, story: Hypothesis) -> bool:
        """Whether it tells more than one law: two forms of one are no two effects."""
        if len(story.added) != 2:
            return len(story.added) > 2
        one, other = (self.known[name] for name in story.added)
        finer = (one.name,) == other.refines or (other.name,) == one.refines
        return not finer and not (one.slips and other.slips)

    def rivals(self, pair: Hypothesis, plain: str) -> list[Hypothesis]:
        """What a plain law may go with, or be a form of, rather than what it has beside it in a pair: what waited for
        it was not tried before."""
        beside = next(name for name in pair.added if name != plain)
        alone, rest = self._cut(pair, beside), self._cut(pair, plain)
        self.regression.learn(pair.solution)
        tries = [grid_fit(self.problem, alone, effect) for effect in self._offered(alone) if effect.name != beside]
        tries += [grid_fit(self.problem, rest, form) for form in self._forms(plain, pair)]
        self.regression.restore(self.problem.start)
        settled = (self._settled(h) for h in tries if h.error < RIVALS * pair.error)
        refines = {name: row.refines for name, row in self.known.items()}
        return [h for h in settled if h is not None and not (refined_of(h, pair, refines) and not self._told(pair, h))]

    def _built_up(self, story: Hypothesis) -> list[Hypothesis]:
        """The story, and how it goes on: each step the best, however little it takes, as long as the error falls and
        more than noise is left."""
        steps = [story]
        while len(steps[-1].added) < LONGEST and steps[-1].level > EXACT_FLOORS:
            self.problem.progress("a whole story", 0.95)
            better = self._next(steps[-1])
            if better is None:
                break
            steps.append(better)
        return steps

    def _next(self, story: Hypothesis) -> Hypothesis | None:
        """The story with one more effect; None where none takes anything."""
        self.regression.learn(story.solution)
        tries = [grid_fit(self.problem, story, effect) for effect in self._offered(story)]
        self.regression.restore(self.problem.start)
        worth = sorted((h for h in tries if h.error < STEP_GAIN * story.error), key=rank)
        return next((h for h in map(self._settled, worth) if h is not None), None)

    def _settled(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """The same with its shapes searched; None where it is no explanation."""
        if not self.problem.carried(hypothesis):
            return None
        settled = refined(self.problem, hypothesis)
        return settled if self.problem.carried(settled) else None

    def _offered(self, story: Hypothesis) -> list[Effect]:
        """Effects that the story may go on with."""
        free = [row for name, row in self.known.items() if name not in story.added and self._ready(name, story.added)]
        return [e for e in offered(free, story.solution, self.regression) if e.name not in story.solution.names]

    def _ready(self, name: str, beside: Collection[str]) -> bool:
        """Whether an effect waits for nothing that some effects lack, themselves or in another form."""
        rows = [self.known[other] for other in beside]
        held = {*beside, *(plain for row in rows for plain in row.refines + row.yields_to)}
        held |= set(LOADS) if any(row.carried for row in rows) else set()
        return set(self.problem.waiting.get(name, ())) <= held

    def _needed(self, story: Hypothesis) -> Hypothesis:
        """The story without what the rest does as well without: finer forms first, then the least needed."""
        while len(story.added) > 1:
            rests = {name: self._without(story, name) for name in story.added}
            idle = {name: rest for name, rest in rests.items() if rest is not None}
            if not idle:
                break
            story = idle[min(idle, key=lambda name: (not self.known[name].refines, rank(idle[name])))]
        return story

    def _exchanged(self, story: Hypothesis) -> Hypothesis:
        """The story with each law in the form that the data insist on."""
        for name in story.added:
            if name not in story.added:  # gone with the load that it was a friction of
                continue
            rest = self._cut(story, name)
            self.regression.learn(story.solution)
            forms = [grid_fit(self.problem, rest, form) for form in self._forms(name, story)]
            self.regression.restore(self.problem.start)
            better = min((h for h in forms if h.error < story.error), key=rank, default=None)
            other = None if better is None else self._settled(better)
            insists_on = self._told if story.level <= EXACT_FLOORS else self._misses
            story = other if other is not None and insists_on(story, other) else story
        return story

    def _forms(self, name: str, story: Hypothesis) -> list[Effect]:
        """What may have been taken for an effect: other forms of the same law, and what is rarer or more usual."""
        own = self.known[name]
        plain = {name, *own.refines}
        rows = [row for row in self.known.values() if row.name not in story.solution.names]
        kin = [row for row in rows if plain & {row.name, *row.refines} or name in row.yields_to]
        kin += [row for row in rows if row.name in own.yields_to and row not in kin]
        return [row for row in kin if self._ready(row.name, story.added)]

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
        rest = self._cut(story, name)
        plainer = [self.known[row] for row in self.known[name].refines if row in self.known and row not in rest.added]
        tries = [rest, *(grid_fit(self.problem, rest, form) for form in plainer)]
        return next((h for h in map(partial(self._does, story), tries) if h is not None), None)

    def _does(self, story: Hypothesis, rest: Hypothesis) -> Hypothesis | None:
        """The rest, its shapes searched where it needs that, if it does as well."""
        if rest.error > SURE * story.error:
            return None
        rest = refined(self.problem, rest) if self._misses(rest, story) else rest
        return rest if self.problem.carried(rest) and not self._misses(rest, story) else None

    def _cut(self, story: Hypothesis, name: str) -> Hypothesis:
        """The story without one of its effects and what is none without it, the shapes of the others as they are."""
        names = tuple(other for other in story.added if other != name)
        if not any(self.known[other].carried for other in names):
            names = tuple(other for other in names if set(LOADS).isdisjoint(self.problem.waiting.get(other, ())))
        return self.problem.keeping(story, names)
