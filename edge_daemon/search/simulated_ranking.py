"""What the loop can carry, simulated in it: tried on a stretch, the best of them then on all.

Friction is simulated before it is compared with its rivals, since the measured twist rate cannot carry its sign.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from edge_daemon.identify.fit import carried_as_measured
from edge_daemon.identify.gauss_newton import ROUGHLY, SETTLED, LoopProblem, on_stretch
from edge_daemon.identify.identifiability import identifiability
from edge_daemon.identify.pilot_stretch import stretch_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import STIFFNESS, Solution, Term
from edge_daemon.search.belief import believable_level
from edge_daemon.search.grid_fit import grid
from edge_daemon.search.hypotheses import (
    NEAR_FLOOR,
    UNSOLVED,
    DiagnosisProblem,
    Hypothesis,
    distinct,
    effect_of,
    rank,
    shown,
)
from edge_daemon.search.thresholds import TIE

Tried = tuple[float, Hypothesis, LoopProblem]
"""Estimated level in the loop, of what, and where it was reached."""
Rivals = dict[tuple[str, str], Hypothesis]
"""By the names of a doubtful law and of a refinement that does as well on a stretch: the latter as it was."""

ROUGH_FLOOR = 1.4
"""At this error on a stretch over the noise floor nothing finer is tried."""
LOOP_WITHIN = 6.0
"""What the loop can carry is tried in it this close to the best (friction gains a factor of 5 to 50 there)."""
LOOP_GAIN = 0.85
"""Above this error over that of the model nothing is simulated in the loop."""
FULL_WITHIN = 1.6
"""The loop is run on all for what is estimated within this factor of the best."""
MOST_TRIED, MOST_PAIRS = 10, 6
"""So many single effects and pairs are tried in the loop, the best on the measured motion first: of 45 simulated pairs
the right one was the third at the worst."""
MOST_FULL = 2
BROKEN, MOST_FULL_RUNS = 0.5, 4
"""A stretch promises something better after all below this share of the error that others reached on all: a wrong law
may follow a stretch as well as a right one; so many are run at the most."""
BEGINNINGS = (0.1, 0.5)
"""A refinement's further amplitudes start from these shares of the simpler form's amplitude."""
FAR = 20.0
"""A refinement is not searched for whose error at its best beginning is this many times that of its simpler form: it
contains that form, but nowhere near its grid (what became a better law began below, what did not at 2 to 240 times)."""
OBVIOUS = 1.5
"""A refinement is not deferred to a simpler form whose equation error is this many times its own."""
ESTIMATED = 1.3
"""An error on a stretch within this factor of that on all is put down to chance."""
IDLE_FINER = 1.2
"""A refinement is not run on all where its simpler form errs by no more than this many times as much on the stretch."""
HOPELESS_SHARE, FEW = 0.4, 8
"""Above this error over that of the model nothing more is spent on the last per cent, nor anything on running so many
numbers on all of the recording: it is no explanation, and no other effect beside it makes it one by them."""
FULL_ROUNDS = 3
LAST_ROUNDS = 6
DOUBTFUL = 1.5
"""Above this error over the noise floor a law is in doubt, and so which of its refinements is real."""


class SimulatedRanking:
    """The hypotheses of one diagnosis against each other in the loop."""

    def __init__(self, problem: DiagnosisProblem, rivals: Rivals) -> None:
        self.problem, self.regression, self.rivals = problem, problem.regression, rivals
        self.promised: dict[str, float] = {}
        """Level on a stretch of what was run on all, by its name."""

    @cached_property
    def part(self) -> RegressionProblem:
        """The stretch on which the loop is tried first."""
        return stretch_of(self.regression)

    def run(
        self,
        ranked: Sequence[Hypothesis],
        reserve: Sequence[Hypothesis] = (),
        single: Hypothesis | None = None,
        rival: Hypothesis | None = None,
    ) -> list[Hypothesis]:
        """All of `ranked`, ranked again. What refines the best is tried from where that came to rest, be it among the
        ranked or in reserve. Pairs must promise to be believed beside the best `single`, and any to come near a `rival`
        of the same kind, and to undercut what that promised and broke, and what is known from `elsewhere`."""
        best = ranked[0].level if ranked else 0.0
        able = self._able(ranked, best)
        best = min(best, rival.level if rival else math.inf)
        everything = [*ranked, *reserve]
        most = {h.name: min(self._most(h, single, everything), self._broken(rival), self._elsewhere(h)) for h in able}
        tried = once(sorted(self._tried(able, best, most), key=lambda row: row[0] * 1.02 ** row[1].parameters))
        if not tried:
            return list(ranked)
        least = min(tried[0][0], best)
        tried = [row for row in tried if not self._idle(row, tried)]
        full, begun = self._full(tried, least)
        others = [h for h in everything if h not in able]
        levels = {h.name: level for level, h, _ in tried}
        full += [finer for h in begun for finer in self._finer(h, levels[h.name], others)]
        full = distinct([h for h in full if self.problem.carried(h)])
        done = {frozenset(h.added) for h in full if h.solution.design is not None}
        return distinct([*full, *(h for h in ranked if frozenset(h.added) not in done)])

    def _full(self, tried: Sequence[Tried], least: float) -> tuple[list[Hypothesis], list[Hypothesis]]:
        """The best of what was tried, run on all; and while that breaks its promise, the next. Beside them what a finer
        form may begin from: these, and pairs that could not be believed, where the stretch left them."""
        full, begun = list[Hypothesis](), list[Hypothesis]()
        believable = ESTIMATED * believable_level(self.problem.base)
        for level, hypothesis, start in tried[:MOST_FULL_RUNS]:
            if hypothesis.parameters > FEW and level > HOPELESS_SHARE * self.problem.base.level:
                continue
            reached = min((h.level for h in full), default=math.inf)
            if not ((level < FULL_WITHIN * least and len(begun) < MOST_FULL) or level < BROKEN * reached < math.inf):
                continue
            if len(hypothesis.added) > 1 and level > believable:
                begun.append(replace(hypothesis, solution=at_rest(hypothesis.solution, start)))
                continue
            full.append(self._in_loop(hypothesis, start))
            self.promised[hypothesis.name] = level
            begun += full[-1:]
        return full, [h for h in begun if h not in full or h.solution.design is not None]

    def _elsewhere(self, made: Hypothesis) -> float:
        """Level on a stretch above which another reading of the recordings does better."""
        return FULL_WITHIN * self.problem.elsewhere / made.floor

    def _broken(self, rival: Hypothesis | None) -> float:
        """What a rival promised on a stretch, where it came to much more on all: whatever does no better there is the
        same law under another name. Infinite where it kept its promise."""
        promised = self.promised.get(rival.name, math.inf) if rival else math.inf
        return promised / TIE if rival and rival.level > FULL_WITHIN * promised else math.inf

    def finished(self, ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best, where it is in the loop and short of the floor, fitted on to the end, if that can explain it."""
        if not ranked or ranked[0].solution.design is None or ranked[0].level <= NEAR_FLOOR:
            return list(ranked)
        if ranked[0].level > min(HOPELESS_SHARE * self.problem.base.level, self._most(ranked[0], None, ())):
            return list(ranked)
        done = self._rested(ranked[0], LoopProblem(self.regression, ranked[0].solution), LAST_ROUNDS)
        return sorted([done, *ranked[1:]], key=rank)

    def alone(self, single: Hypothesis, pair: Hypothesis) -> Hypothesis:
        """A single effect fitted on from its numbers in a pair, where it may not have come to itself; never worse."""
        own = single.solution.names
        terms = tuple(term for term in pair.solution.terms if term.effect.name in own)
        start = replace(single.solution, terms=terms, amplitudes={name: pair.solution.amplitudes[name] for name in own})
        return self._rested(single, LoopProblem(self.regression, start), LAST_ROUNDS)

    def _able(self, ranked: Sequence[Hypothesis], best: float) -> list[Hypothesis]:
        """Those worth the loop's time, with their simpler forms, and without what waits for a simpler form."""
        simplifies = self.problem.simplifies
        most = MOST_PAIRS if ranked and len(ranked[0].added) > 1 else MOST_TRIED
        able = [h for h in ranked if self._promising(h, best)][:most]
        able += [h for h in ranked if h not in able and any(simplifies(h, other) for other in able)]
        return [h for h in able if not any(simplifies(o, h) and h.level > o.level / OBVIOUS for o in able)]

    def _tried(self, able: Sequence[Hypothesis], best: float, limit: Mapping[str, float]) -> list[Tried]:
        """What came of them on a stretch, where that is an explanation; those that cannot win, or not come below their
        limit, are given up early."""
        tried: list[Tried] = []
        for hypothesis in able:
            least = min([best, *(level for level, *_ in tried)])
            most = min(FULL_WITHIN * least, limit[hypothesis.name])
            tried.append(self._on_stretch(hypothesis, most=most))
        tried = [row for row in tried if math.isfinite(row[0]) and self.problem.sprung(*spring_of(row[2]))]
        return [row for row in tried if row[0] < limit[row[1].name]]

    def _most(self, made: Hypothesis, single: Hypothesis | None, others: Sequence[Hypothesis]) -> float:
        """Level on a stretch below which a pair may be believed beside a single effect; and at all, where it leads to
        nothing else: as a law of few numbers does beside another, and any of the others that goes on from it."""
        beside = math.inf if single is None else ESTIMATED * self.problem.pair_gain(single, made) * single.level
        leads_on = len(made.added) < 2 and made.parameters <= FEW
        leads_on |= any(self.problem.simplifies(made, h) for h in others)
        return beside if leads_on else min(beside, ESTIMATED * believable_level(self.problem.base))

    def _finer(self, simple: Hypothesis, level: float, others: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The refinement of what the loop has fitted, where that leaves something and it does better on a stretch than
        the simpler form did there; and that form from where the refinement came to rest."""
        if simple.level <= NEAR_FLOOR:
            return []
        tried: list[Tried] = []
        most = self._most(simple, None, ())
        finer_forms = (h for h in others if self.problem.simplifies(simple, h))
        for finer in sorted(finer_forms, key=lambda h: h.parameters):
            if any(set(finer.added) == set(row[1].added) for row in tried):
                continue
            tried.append(self._on_stretch(finer, simple, min(TIE * simple.level, most)))
            self._doubt(simple, tried[-1])
            if tried[-1][0] < ROUGH_FLOOR:
                break
        least = min(level / IDLE_FINER, simple.level / IDLE_FINER, most)
        tried = [row for row in tried if row[0] < least and self.problem.sprung(*spring_of(row[2]))]
        found = [self._in_loop(h, start) for _, h, start in sorted(tried, key=lambda row: row[0])[:1]]
        return [*found, *(self._simply(simple, finer) for finer in found if finer.error < simple.error)]

    def _simply(self, simple: Hypothesis, finer: Hypothesis) -> Hypothesis:
        """The simpler form fitted on from the numbers of its refinement, which may only have come to rest in a better
        place; never worse."""
        start = begun(simple.solution, finer.solution, {}, 0.0)
        return self._rested(simple, LoopProblem(self.regression, start), LAST_ROUNDS)

    def _doubt(self, simple: Hypothesis, row: Tried) -> None:
        """Remembers a refinement that does as well as a law that leaves more than noise."""
        level, finer, loop = row
        if simple.level > DOUBTFUL and level < TIE * simple.level:
            self.rivals[simple.name, finer.name] = replace(finer, solution=at_rest(finer.solution, loop))

    def _idle(self, row: Tried, tried: Sequence[Tried]) -> bool:
        """Whether a simpler form did as well on the stretch."""
        return any(
            self.problem.simplifies(simple, row[1]) and level < IDLE_FINER * row[0] for level, simple, _ in tried
        )

    def _promising(self, hypothesis: Hypothesis, best: float) -> bool:
        """Whether the loop is worth its time. The measured twist rate may carry nothing of a sign at all, so that dry
        friction is tried wherever nothing else explains what is left."""
        gains = hypothesis.level < LOOP_GAIN * self.problem.base.level
        gains |= best > UNSOLVED and self.problem.dry(hypothesis)
        gains &= hypothesis.level < LOOP_WITHIN * best
        new = any(t.effect.in_loop and t.effect.name in hypothesis.added for t in hypothesis.solution.terms)
        done = hypothesis.solution.design is not None or carried_as_measured(self.regression, hypothesis.solution.terms)
        return gains and new and not done

    def _on_stretch(self, hypothesis: Hypothesis, simple: Hypothesis | None = None, most: float = math.inf) -> Tried:
        """Estimated level in the loop, and where it was reached; begun where a simpler form came to rest. Above a level
        of `most` nothing depends on it."""
        self.problem.progress(f"{hypothesis.name} in the loop", 0.6)
        start, rms = (hypothesis.solution, 0.0) if simple is None else self._begun(hypothesis, simple)
        if rms > FAR * most * hypothesis.floor:
            return rms / hypothesis.floor, hypothesis, LoopProblem(self.part, start)
        loop = on_stretch(self.part, start, most * hypothesis.floor)
        level = loop.rms / hypothesis.floor
        if level < most:
            level = shown(level, self._identifiability(hypothesis, loop))
        return level, hypothesis, loop

    def _identifiability(self, hypothesis: Hypothesis, loop: LoopProblem) -> float:
        """At the point where a loop came to rest, on the stretch."""
        return identifiability(self.part, at_rest(hypothesis.solution, loop))

    def _begun(self, hypothesis: Hypothesis, simple: Hypothesis) -> tuple[Solution, float]:
        """The best on a stretch of what a refinement may start from, and its rms: where it is itself, and the numbers
        of its simpler form, the further ones over their grids. The equation error that it was first fitted to knows
        nothing of those; and where the simpler form is wrong, it has nothing to start from."""
        effect = next(row for row in self.problem.candidates if row.name in set(hypothesis.added) - set(simple.added))
        starts = [
            begun(hypothesis.solution, simple.solution, shapes, share)
            for shapes in grid(effect, self.regression)
            for share in BEGINNINGS
        ] + [hypothesis.solution]

        def error(start: Solution) -> float:
            loop = LoopProblem(self.part, start)
            return float(np.mean((self.part.target - loop.modelled(loop.point, derive=False)[0]) ** 2))

        least, start = min(((error(start), start) for start in starts), key=lambda row: row[0])
        return start, math.sqrt(least)

    def _in_loop(self, hypothesis: Hypothesis, start: LoopProblem) -> Hypothesis:
        """Fitted in the loop on all, from where a stretch led."""
        loop = LoopProblem(self.regression, hypothesis.solution)
        loop.begin_where(start, hypothesis.solution)
        return self._rested(hypothesis, loop, FULL_ROUNDS, ROUGHLY)

    def _rested(self, hypothesis: Hypothesis, loop: LoopProblem, rounds: int, settled: float = SETTLED) -> Hypothesis:
        """What a loop comes to within some rounds, unless that is worse."""
        return min(hypothesis, self._descended(hypothesis, loop, rounds, settled), key=lambda h: h.error)

    def roughly(self, hypothesis: Hypothesis) -> Hypothesis:
        """What the loop comes to within a few rounds where nothing but a further effect can make an explanation of it;
        never worse."""
        return min(hypothesis, self.at_its_own(hypothesis), key=lambda h: h.error)

    def at_its_own(self, hypothesis: Hypothesis) -> Hypothesis:
        """What a variation of something simulated comes to in the loop, better or worse: till then its law was that of
        another twist."""
        return self._descended(hypothesis, LoopProblem(self.regression, hypothesis.solution), FULL_ROUNDS, ROUGHLY)

    def _descended(self, hypothesis: Hypothesis, loop: LoopProblem, rounds: int, settled: float) -> Hypothesis:
        solution = loop.solution(*loop.descend(rounds, settled))
        return self.problem.hypothesis(hypothesis.added, solution, self._identifiability(hypothesis, loop))


def once(tried: Sequence[Tried]) -> list[Tried]:
    """Best first, each set of effects once: what was begun from two sides has come to rest twice."""
    best: dict[frozenset[str], Tried] = {}
    for row in tried:
        best.setdefault(frozenset(row[1].added), row)
    return list(best.values())


def at_rest(solution: Solution, loop: LoopProblem) -> Solution:
    """A solution with the numbers at which a loop came to rest."""
    terms, amplitudes = loop.split(loop.point)
    return replace(solution, terms=tuple(terms), amplitudes=amplitudes)


def spring_of(loop: LoopProblem) -> tuple[Sequence[Term], float]:
    """The terms and the stiffness at which a loop came to rest."""
    terms, amplitudes = loop.split(loop.point)
    return terms, float(amplitudes[STIFFNESS[0]][0])


def begun(solution: Solution, simple: Solution, shapes: Mapping[str, float], share: float) -> Solution:
    """The solution with every number that a simpler form has too, by name, at that form's value; of the further ones
    the shapes as given, the amplitudes a share of the simpler form's largest."""
    own = {term.effect.name for term in simple.terms}
    extra = {term.effect.name for term in solution.terms} - own
    less = next(iter(own - {term.effect.name for term in solution.terms}), "")
    known = {term.effect.name: term.shapes for term in simple.terms}
    terms, amplitudes = [], {}
    for term in solution.terms:
        name = term.effect.name
        source = less if name in extra else name
        sizes = simple.amplitudes[source].tolist()
        at = dict(zip((row.name for row in effect_of(simple, source).amplitudes), sizes, strict=True))
        amplitudes[name] = np.array([at.get(row.name, share * max(sizes)) for row in term.effect.amplitudes])
        further = {**term.shapes, **shapes} if name in extra else term.shapes
        terms.append(replace(term, shapes={**further, **{k: v for k, v in known[source].items() if k in further}}))
    return replace(solution, terms=tuple(terms), amplitudes=amplitudes)
