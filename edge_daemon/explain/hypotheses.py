"""The search for what is missing: single effects, then pairs, each fitted and judged on held-out blocks.

Measurement effects correct the twist before torque effects are computed from it; friction is simulated in the loop
before it is compared with its rivals, since the measured twist rate cannot carry its sign.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from edge_daemon.effects.effect import Effect
from edge_daemon.effects.laws import LOADED, SIGN
from edge_daemon.estimate.fit import MEASUREMENT_ROUNDS
from edge_daemon.estimate.settle import LEAD_S, ROUGHLY, SETTLED, STRETCH_S, Loop, lawful, on_stretch
from edge_daemon.estimate.workbench import (
    DAMPING,
    START_DAMPING_NMS_PER_RAD,
    START_STIFFNESS_NM_PER_RAD,
    STIFFNESS,
    Solution,
    Term,
    Workbench,
    sub_bench,
)
from edge_daemon.explain.transparency import transparency

Tried = tuple[float, "Hypothesis", Loop]
"""estimated level in the loop, of what, and where it was reached"""
Progress = Callable[[str, float], None]
Floor = Callable[[Solution], float]

NEAR_FLOOR = 1.25
"""error over the noise floor at which nothing is left to explain"""
ROUGH_FLOOR = 1.4
"""error on a stretch over the noise floor at which nothing finer is tried"""
REFINE_WITHIN = 1.7
"""singles this close to the best on the grid are refined"""
LOOP_WITHIN = 6.0
"""what the loop can carry is tried in it this close to the best (friction gains a factor of 5 to 50 there)"""
LOOP_GAIN = 0.85
"""error over that of the model above which nothing is simulated in the loop"""
UNSOLVED = 3.0
"""error over the noise floor of the best equation error above which dry friction is tried in the loop regardless"""
DRY = (SIGN, LOADED)
"""laws whose columns the measured twist rate cannot carry at all"""
FULL_WITHIN = 1.6
"""estimated error over the best of them within which the loop is run on all"""
MOST_TRIED = 10
MOST_FULL = 2
BEGINNINGS = (0.1, 0.5)
"""of the simpler form's amplitude, what a refinement's further amplitudes start from"""
OBVIOUS = 1.5
"""equation error of a simpler form over that of its refinement above which the latter is not deferred to the former"""
ESTIMATED = 1.3
"""error on a stretch over that on all that is put down to chance"""
IDLE = 1.2
"""error of a simpler form over that of its refinement on the stretch up to which the refinement is not run on all"""
FULL_ROUNDS = 3
LAST_ROUNDS = 6
DOUBTFUL = 1.5
"""error over the noise floor above which a law is in doubt, and so which of its refinements is real"""
TIE = 1.12
"""errors closer than this factor cannot be told apart"""
LAW_SHARE = 0.12
"""error left over the error before below which it may be that a real law is not quite the simulated one (guess: real
friction keeps its law to some per cent)"""
PAIR_GAIN, LAW_GAIN = 0.7, 0.4
"""error of a pair over that of the best single below which a second effect is believed; the latter where a law is all
but enough: a second law mends the first by half, a second effect takes nearly all"""
REACHED = 0.9
"""error over the noise floor that nothing undercuts"""
BEAMS = 3
ALIKE = 0.999
"""correlation of what two effects leave above which a second effect is added to one of them only"""
STIFFER = 1.6
"""largest noise floor of an explanation over that of the model: more stiffness than that is an escape, no finding"""
SPRING_SHARE = 0.4
"""least rms of stiffness times measured twist over that of the torque: below it an effect has taken the place of the
spring (a hysteresis that never slips, friction of nine tenths of the load), which explains nothing"""
WIDEST = 4.0
"""width of a loop or gap over the rms twist above which the motion never goes through it: it acts as a spring"""
USUAL_DAMPING_S = START_DAMPING_NMS_PER_RAD / START_STIFFNESS_NM_PER_RAD
"""damping over stiffness that an error of the angles is first fitted with: what the model has without it may be that of
its own error, hundreds of times as much, and never find back"""
OPAQUE = 0.3
"""transparency below which an explanation would swallow any torque, and is none"""
LEAST_FLOOR = 1e-9
"""where sensors are free of noise: rounding of the arithmetic"""
PARAMETER_PRICE = 0.002
"""relative error that a parameter must remove to leave the order as it is; held-out blocks charge the rest"""
POLISHES = 2
"""how often a variation of the best pair may take its place"""
CLOSE = 1.6
"""error of the second best rough pair of a beam over that of the best above which it is not refined"""
SIBLING_WITHIN = 1.5
"""error over that of the best pair below which a variation of it is kept"""
WORTH = 0.9
"""error of a rough pair over that of its first effect above which it is not pursued"""


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """The model plus some effects, fitted."""

    added: tuple[str, ...]
    solution: Solution
    floor: float
    """rms that sensor noise would leave with this solution's own stiffness: a model that explains the torque away
    needs little stiffness and must not win by hearing less of the noise"""
    transparency: float = 1.0
    """how much of an unknown torque shows in what it leaves"""

    @property
    def rmse(self) -> float:
        """Held-out, unit of the balance."""
        return self.solution.rmse

    @property
    def level(self) -> float:
        """Held-out error over the noise floor, its part beyond the noise as large as it would show if nothing were
        taken up: what explanations are compared by."""
        return shown(self.solution.rmse / self.floor, self.transparency)

    @property
    def name(self) -> str:
        """Effects joined with `+`, measurement effects first, else by name."""
        kinds = {term.effect.name: term.effect.kind for term in self.solution.terms}
        return "+".join(sorted(self.added, key=lambda name: (kinds.get(name) != "measurement", name)))

    @property
    def parameters(self) -> int:
        """Numbers that were fitted for the added effects."""
        rows = [term.effect for term in self.solution.terms if term.effect.name in self.added]
        return sum(len(effect.amplitudes) + len(effect.free_shapes) for effect in rows)


class Search:
    """One diagnosis under way."""

    def __init__(
        self, bench: Workbench, base: Solution, candidates: Sequence[Effect], floor: Floor, progress: Progress
    ) -> None:
        self.bench, self.candidates, self.floor, self.progress = bench, tuple(candidates), floor, progress
        self.base = self._hypothesis((), base)
        self.start = bench.state
        self.twist_rad = self._twist(base)
        self.rivals: dict[tuple[str, str], Hypothesis] = {}
        """by the names of a doubtful law and of a refinement that does as well on a stretch: the latter as it was"""

    def _hypothesis(self, added: tuple[str, ...], solution: Solution, shows: float = 1.0) -> Hypothesis:
        floor = self.floor(solution)
        most = STIFFER * self.base.floor if added else math.inf
        return Hypothesis(added, solution, max(min(floor, most), LEAST_FLOOR), shows)

    @cached_property
    def part(self) -> Workbench:
        """The stretch on which the loop is tried first."""
        return sub_bench(self.bench, STRETCH_S, LEAD_S)

    def _twist(self, base: Solution) -> float:
        """rms of the measured twist [rad]; infinite in a balance without one."""
        if STIFFNESS[0] not in base.names:
            return math.inf
        twist = self.bench.columns(effect_of(base, STIFFNESS[0]), {})
        return math.sqrt(float(np.mean(twist**2)))

    def run(self) -> list[Hypothesis]:
        """Singles and, where one is not enough, pairs; best first."""
        singles = self._finished(self._singles())
        single = singles[0].level if singles else math.inf
        if not singles or self.pair_gain(singles[0]) * single <= REACHED:
            return singles
        found = distinct([*singles, *self._pairs(singles)])
        for _ in range(POLISHES):
            best = next((h for h in found if len(h.added) > 1), None)
            if best is None or best.level > self.pair_gain(singles[0], best) * single:
                break
            siblings = sorted(self._siblings([best]), key=rank)
            found = distinct([*found, *siblings])
            if not siblings or siblings[0].level > WORTH * best.level:
                break
            found = distinct([*found, *self._looped([self._refined(siblings[0])])])
        return found

    def _finished(self, ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best, where it is in the loop and short of the floor, fitted on to the end."""
        if not ranked or ranked[0].solution.design is None or ranked[0].level <= NEAR_FLOOR:
            return list(ranked)
        done = self._rested(ranked[0], Loop(self.bench, ranked[0].solution), LAST_ROUNDS)
        return sorted([done, *ranked[1:]], key=rank)

    def pair_gain(self, single: Hypothesis, pair: Hypothesis | None = None) -> float:
        """Error of a pair over that of the best single below which the second effect is believed: lower where what is
        left may be the roughness of a simulated law rather than another effect, and where both are laws of the twist,
        of which one may only mend the other."""
        rough = single.solution.design is not None and single.level < LAW_SHARE * self.base.level
        laws = pair is not None and all(effect_of(pair.solution, name).in_loop for name in pair.added)
        return LAW_GAIN if rough or laws else PAIR_GAIN

    def _siblings(self, pairs: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best pair with one part replaced by another effect: what it may be confused with."""
        out = []
        for pair in pairs:
            self.bench.learn(pair.solution)
            for kept in pair.added:
                onto = self._kept(pair, kept)
                for effect in self.candidates:
                    if effect.name not in pair.added and not overlap(effect, onto, self.candidates):
                        sibling = self._rough(onto, effect)
                        sprung = self._sprung(sibling.solution.terms, stiffness_of(sibling))
                        if sprung and sibling.level < SIBLING_WITHIN * pair.level:
                            out.append(sibling)
            self.bench.restore(self.start)
        return out

    def _kept(self, pair: Hypothesis, kept: str) -> Hypothesis:
        """The pair with only one of its effects, its columns as they are."""
        terms, parts, i = [], [], 0
        for term in pair.solution.terms:
            width = len(term.effect.amplitudes)
            if term.effect.name not in pair.added or term.effect.name == kept:
                terms.append(term)
                parts.append(pair.solution.columns[:, i : i + width])
            i += width
        return self._hypothesis((kept,), self.bench.solution(terms, np.hstack(parts)), pair.transparency)

    def _singles(self) -> list[Hypothesis]:
        rough = []
        for i, effect in enumerate(self.candidates):
            self.progress(effect.name, 0.4 * i / len(self.candidates))
            rough.append(self._rough(self.base, effect))
        rough = sorted((h for h in rough if self._sprung(h.solution.terms, stiffness_of(h))), key=rank)
        best = rough[0].level if rough else 0.0
        out = []
        for i, hypothesis in enumerate(rough):
            if i < 3 or (hypothesis.level < REFINE_WITHIN * best and self.base.level > NEAR_FLOOR):
                hypothesis = self._refined(hypothesis)
            out.append(hypothesis)
        return self._looped(sorted(out, key=rank))

    def _rough(self, onto: Hypothesis, effect: Effect) -> Hypothesis:
        """One more effect, at the best point of its grid of shapes."""
        terms = onto.solution.terms
        state = self.bench.state
        if effect.kind == "measurement" and not lawful(terms):
            self.bench.tied[DAMPING] = self.bench.tied[STIFFNESS] * USUAL_DAMPING_S
            solution = self.bench.fit([*terms, Term(effect, effect.start)], search=False, rounds=MEASUREMENT_ROUNDS)
            self.bench.restore(state)
        else:
            known = onto.solution.columns
            tries = []
            for shapes in grid(effect, self.bench):
                term = Term(effect, shapes)
                tries.append(self.bench.solution([*terms, term], np.hstack((known, self._columns(term)))))
            solution = min(tries, key=lambda s: s.rmse / max(self.floor(s), LEAST_FLOOR))
        return self._hypothesis((*onto.added, effect.name), solution, onto.transparency)

    def _columns(self, term: Term) -> np.ndarray:
        return self.bench.columns(term.effect, term.shapes)

    def _refined(self, hypothesis: Hypothesis) -> Hypothesis:
        """Shapes searched, ties and corrections repeated; never worse than before. What the loop can carry waits."""
        state = self.bench.state
        terms = hypothesis.solution.terms
        if lawful(terms):
            return hypothesis
        repeated = any(term.effect.tied for term in terms)
        if repeated:
            self.bench.learn(hypothesis.solution)
        solution = self.bench.fit(terms, rounds=4 if repeated else 1)
        self.bench.restore(state)
        return min(
            hypothesis, self._hypothesis(hypothesis.added, solution, hypothesis.transparency), key=lambda h: h.level
        )

    def _looped(
        self, ranked: Sequence[Hypothesis], reserve: Sequence[Hypothesis] = (), single: Hypothesis | None = None
    ) -> list[Hypothesis]:
        """What the loop can carry, simulated in it: tried on a stretch, the best then on all; ranked again. What
        refines the best is tried from where that came to rest, be it among the ranked or in reserve. Pairs must
        promise to be believed beside the best `single`."""
        best = ranked[0].level if ranked else 0.0
        able = [h for h in ranked if self._promising(h, best)][:MOST_TRIED]
        able += [h for h in ranked if h not in able and any(self._simplifies(h, other) for other in able)]
        able = [h for h in able if not any(self._simplifies(o, h) and h.level > o.level / OBVIOUS for o in able)]
        tried = [self._on_stretch(h) for h in able]
        tried = [row for row in tried if math.isfinite(row[0]) and self._sprung(*spring_of(row[2]))]
        tried = [row for row in tried if self._believable(row, single)]
        tried = once(sorted(tried, key=lambda row: row[0] * 1.02 ** row[1].parameters))
        if not tried:
            return list(ranked)
        least = min(tried[0][0], best)
        tried = [row for row in tried if not self._idle(row, tried)]
        worth = [(h, start) for level, h, start in tried if level < FULL_WITHIN * least][:MOST_FULL]
        full = [self._in_loop(h, start) for h, start in worth]
        others = [h for h in [*ranked, *reserve] if h not in able]
        full += [finer for h in list(full) for finer in self._finer(h, others)]
        full = distinct([h for h in full if self._sprung(h.solution.terms, stiffness_of(h))])
        done = {frozenset(h.added) for h in full}
        return sorted([*full, *(h for h in ranked if frozenset(h.added) not in done)], key=rank)

    def _believable(self, row: Tried, single: Hypothesis | None) -> bool:
        """Whether what was tried on a stretch may be believed beside a single effect."""
        return single is None or row[0] < ESTIMATED * self.pair_gain(single, row[1]) * single.level

    def _finer(self, simple: Hypothesis, others: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The refinement of what the loop has fitted, where that leaves something and it does better on a stretch."""
        if simple.level <= NEAR_FLOOR or simple.solution.design is None:
            return []
        tried: list[Tried] = []
        for finer in sorted((h for h in others if self._simplifies(simple, h)), key=lambda h: h.parameters):
            tried.append(self._on_stretch(finer, simple))
            self._doubt(simple, tried[-1])
            if tried[-1][0] < ROUGH_FLOOR:
                break
        tried = [row for row in tried if IDLE * row[0] < simple.level and self._sprung(*spring_of(row[2]))]
        return [self._in_loop(h, start) for _, h, start in sorted(tried, key=lambda row: row[0])[:1]]

    def _doubt(self, simple: Hypothesis, row: Tried) -> None:
        """Remembers a refinement that does as well as a law that leaves more than noise."""
        level, finer, loop = row
        if simple.level > DOUBTFUL and level < TIE * simple.level:
            terms, amplitudes = loop.split(loop.point)
            at = replace(finer.solution, terms=tuple(terms), amplitudes=amplitudes)
            self.rivals[simple.name, finer.name] = replace(finer, solution=at)

    def _simplifies(self, hypothesis: Hypothesis, other: Hypothesis) -> bool:
        """Whether it has a simpler form of one effect of another: only the loop tells the two apart."""
        known = {effect.name: effect.refines for effect in self.candidates}
        less, more = set(hypothesis.added) - set(other.added), set(other.added) - set(hypothesis.added)
        return len(less) == len(more) == 1 and next(iter(less)) in known[next(iter(more))]

    def _idle(self, row: Tried, tried: Sequence[Tried]) -> bool:
        """Whether a simpler form did as well on the stretch."""
        return any(self._simplifies(simple, row[1]) and level < IDLE * row[0] for level, simple, _ in tried)

    def _promising(self, hypothesis: Hypothesis, best: float) -> bool:
        """Whether the loop is worth its time. The measured twist rate may carry nothing of a sign at all, so that dry
        friction is tried wherever nothing else explains what is left."""
        gains = hypothesis.level < LOOP_GAIN * self.base.level or (best > UNSOLVED and self._dry(hypothesis))
        gains &= hypothesis.level < LOOP_WITHIN * best
        new = any(t.effect.in_loop and t.effect.name in hypothesis.added for t in hypothesis.solution.terms)
        done = hypothesis.solution.design is not None
        return gains and new and not done

    def _sprung(self, terms: Sequence[Term], stiffness: float) -> bool:
        """Whether the spring still carries a part of the torque, and no loop or gap is so wide that it acts as one."""
        wide = WIDEST * self.twist_rad
        narrow = all(
            term.shapes.get(row.name, 0.0) < wide
            for term in terms
            for row in term.effect.free_shapes
            if row.scale == "twist_rad"
        )
        return narrow and stiffness * self.twist_rad > SPRING_SHARE * self.bench.rms

    def _dry(self, hypothesis: Hypothesis) -> bool:
        """Whether the last effect added is friction that only knows the direction."""
        effect = next(row for row in self.candidates if row.name == hypothesis.added[-1])
        laws = effect.in_loop(effect.start, np.ones(len(effect.amplitudes)).tolist()) if effect.in_loop else ()
        return bool(laws) and all(law.kind in DRY for law in laws)

    def _on_stretch(self, hypothesis: Hypothesis, simple: Hypothesis | None = None) -> Tried:
        """Estimated level in the loop, and where it was reached; begun where a simpler form came to rest."""
        self.progress(f"{hypothesis.name} in the loop", 0.6)
        start = hypothesis.solution if simple is None else self._begun(hypothesis, simple)
        loop = on_stretch(self.bench, start)
        return shown(loop.rms / hypothesis.floor, self._transparency(hypothesis, loop)), hypothesis, loop

    def _transparency(self, hypothesis: Hypothesis, loop: Loop) -> float:
        """At the point where a loop came to rest, on the stretch; 1 in a balance without a spring."""
        terms, amplitudes = loop.split(loop.point)
        at = replace(hypothesis.solution, terms=tuple(terms), amplitudes=amplitudes)
        return transparency(self.part, at)

    def _begun(self, hypothesis: Hypothesis, simple: Hypothesis) -> Solution:
        """The best on a stretch of what a refinement may start from: the numbers of its simpler form, the further ones
        over their grids. The equation error that it was first fitted to knows nothing of them."""
        effect = next(row for row in self.candidates if row.name in set(hypothesis.added) - set(simple.added))
        starts = [
            begun(hypothesis.solution, simple.solution, shapes, share)
            for shapes in grid(effect, self.bench)
            for share in BEGINNINGS
        ]

        def error(start: Solution) -> float:
            loop = Loop(self.part, start)
            return float(np.sum((self.part.target - loop.modelled(loop.point, derive=False)[0]) ** 2))

        return min(starts, key=error)

    def _in_loop(self, hypothesis: Hypothesis, start: Loop) -> Hypothesis:
        """Fitted in the loop on all, from where a stretch led."""
        loop = Loop(self.bench, hypothesis.solution)
        loop.point = start.point
        return self._rested(hypothesis, loop, FULL_ROUNDS, ROUGHLY)

    def _rested(self, hypothesis: Hypothesis, loop: Loop, rounds: int, settled: float = SETTLED) -> Hypothesis:
        """What a loop comes to within some rounds, unless that is worse."""
        solution = loop.solution(*loop.descend(rounds, settled))
        done = self._hypothesis(hypothesis.added, solution, self._transparency(hypothesis, loop))
        return min(hypothesis, done, key=lambda h: h.level)

    def _pairs(self, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
        beams = self._beams(singles)
        found: dict[tuple[str, ...], Hypothesis] = {}
        reserve: list[Hypothesis] = []
        for i, beam in enumerate(beams):
            self.progress(f"{beam.name} and another", 0.7 + 0.25 * i / len(beams))
            self.bench.learn(beam.solution)
            rough = [
                self._rough(beam, effect) for effect in self.candidates if not overlap(effect, beam, self.candidates)
            ]
            self.bench.restore(self.start)
            rough = [h for h in rough if self._sprung(h.solution.terms, stiffness_of(h))]
            reserve += [h for h in rough if lawful(h.solution.terms)]
            found |= {h.added: self._refined(h) for h in self._seconds(rough, beam)}
        ranked = sorted(found.values(), key=rank)
        best = min([*(h.level for h in ranked), *(h.level for h in singles)])
        if best <= NEAR_FLOOR:
            return ranked
        return self._looped(ranked, reserve, singles[0])

    def _seconds(self, rough: Sequence[Hypothesis], beam: Hypothesis) -> list[Hypothesis]:
        """The pairs of a beam that are pursued: the best two that differ, their plainer forms, and dry friction where
        none of them explains what is left."""
        worthy = [h for h in sorted(rough, key=rank) if h.level < WORTH * beam.level]
        others = [h for h in worthy[1:] if h.level < CLOSE * worthy[0].level and not self._alike(h, worthy[0])]
        chosen = [*worthy[:1], *others[:1]]
        chosen += self._plainer(chosen, rough)
        if not worthy or worthy[0].level > UNSOLVED:
            chosen += [h for h in rough if self._dry(h) and h not in chosen]
        return chosen

    def _plainer(self, chosen: Sequence[Hypothesis], rough: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The rough pairs with a simpler form of the effect that a chosen one has as its second."""
        known = {effect.name: effect.refines for effect in self.candidates}
        simple = {name for h in chosen for name in known[h.added[-1]]}
        return [h for h in rough if h.added[-1] in simple and h not in chosen and lawful(h.solution.terms)]

    def _beams(self, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What a second effect is added to: the best singles, and any measurement effect that helps."""
        helpful = [h for h in singles if h.level < 0.97 * self.base.level]
        if helpful and helpful[0].level < min(4, 0.05 * self.base.level):
            return helpful[:1]
        measuring = [h for h in helpful if kind(h, self.candidates) == "measurement"]
        known = {effect.name: effect for effect in self.candidates}
        chosen: list[Hypothesis] = []
        for hypothesis in [*helpful[:2], *measuring[:2], *helpful[2:]]:
            relatives = {*known[hypothesis.added[0]].refines, hypothesis.added[0]}
            relatives |= {h.added[0] for h in chosen if hypothesis.added[0] in known[h.added[0]].refines}
            new = relatives.isdisjoint(h.added[0] for h in chosen)
            if new and not any(self._alike(hypothesis, h) for h in chosen):
                chosen.append(hypothesis)
        return chosen[:BEAMS]

    def _alike(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether two explanations leave the same behind: one function of this motion under two names."""
        a, b = (h.solution.held_out_residual(self.bench) for h in (one, other))
        return float(a @ b) > ALIKE * math.sqrt(float(a @ a) * float(b @ b))


def shown(level: float, transparency: float) -> float:
    """An error in noise floors with its part beyond the noise as it would show if nothing of it were taken up."""
    if transparency < OPAQUE:
        return math.inf
    return math.sqrt(level**2 + max(level**2 - 1.0, 0.0) * (min(transparency, 1.0) ** -2 - 1.0))


def distinct(found: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Best first, each set of effects once."""
    best: dict[frozenset[str], Hypothesis] = {}
    for hypothesis in sorted(found, key=rank):
        best.setdefault(frozenset(hypothesis.added), hypothesis)
    return list(best.values())


def rank(hypothesis: Hypothesis) -> float:
    """What to sort by: the logarithm of the held-out error, a little dearer for each parameter."""
    return math.log(max(hypothesis.level, 1e-300)) + PARAMETER_PRICE * hypothesis.parameters


def once(tried: Sequence[Tried]) -> list[Tried]:
    """Best first, each set of effects once: what was begun from two sides has come to rest twice."""
    best: dict[frozenset[str], Tried] = {}
    for row in tried:
        best.setdefault(frozenset(row[1].added), row)
    return list(best.values())


def stiffness_of(hypothesis: Hypothesis) -> float:
    """Of the spring; infinite in a balance without one."""
    return hypothesis.solution.amplitude(*STIFFNESS, math.inf)


def spring_of(loop: Loop) -> tuple[Sequence[Term], float]:
    """The terms and the stiffness at which a loop came to rest."""
    terms, amplitudes = loop.split(loop.point)
    return terms, float(amplitudes[STIFFNESS[0]][0])


def kind(hypothesis: Hypothesis, candidates: Sequence[Effect]) -> str:
    """Kind of the first effect added."""
    return next(effect.kind for effect in candidates if effect.name == hypothesis.added[0])


def overlap(effect: Effect, hypothesis: Hypothesis, candidates: Sequence[Effect]) -> bool:
    """Whether an effect is part of a hypothesis, or a refinement or simplification of a part."""
    known = {row.name: row for row in candidates}
    names = {term.effect.name for term in hypothesis.solution.terms}
    related = {simple for name in names if name in known for simple in known[name].refines}
    return effect.name in names | related or bool(names & set(effect.refines))


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


def effect_of(solution: Solution, name: str) -> Effect:
    """The effect of that name in a solution."""
    return next(term.effect for term in solution.terms if term.effect.name == name)


def grid(effect: Effect, bench: Workbench) -> list[dict[str, float]]:
    """Where the search for an effect's free shapes looks first."""
    rows = effect.free_shapes
    axes = []
    for row in rows:
        unit = 1.0
        if row.scale:
            column = getattr(bench.motions[0], row.scale)
            unit = math.sqrt(float(np.mean(column**2)))
        axes.append([min(max(unit * g, row.lower), row.upper) for g in row.grid] or [row.start])
    return [dict(zip([row.name for row in rows], point, strict=True)) for point in itertools.product(*axes)]
