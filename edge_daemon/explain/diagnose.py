"""What is missing: every catalogued effect tried on held-out blocks, with what cannot be told apart.

The verdict is `adequate` when nothing improves the held-out error beyond chance, `missing` when an effect or a pair
does and most of the error goes, `unexplained` when structure is left that no effect removes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from edge_daemon.effects import plugin
from edge_daemon.effects.catalogue import measured, of_balance
from edge_daemon.effects.effect import Effect
from edge_daemon.effects.model import Model, ModelError
from edge_daemon.estimate.balance import Trial
from edge_daemon.estimate.fit import Recorded, bench_of, fit_terms, fitted_model, floor_of, numbers, terms_of
from edge_daemon.estimate.gram import folds
from edge_daemon.estimate.workbench import Solution, Workbench
from edge_daemon.explain.axes import where
from edge_daemon.explain.compare import error_of
from edge_daemon.explain.creep import creeping
from edge_daemon.explain.hypotheses import TIE, Hypothesis, rank
from edge_daemon.explain.pairs import USUAL
from edge_daemon.explain.plan import NO_MOTION, next_experiment
from edge_daemon.explain.records import Candidate, Diagnosis, Experiment
from edge_daemon.explain.search import Search
from edge_daemon.explain.suspicion import examine
from edge_daemon.records import Array

Progress = Callable[[str, float], None]
"""what is being tried, and how much of the work is done (0 to 1)"""

LEAST_GAIN = 0.015
"""relative fall of the held-out error below which an effect is not worth its name"""
LEAST_T = 4.0
"""block-wise t of the fall: one in ten thousand by chance, for some twenty candidates and their shapes"""
EXPLAINED_FLOORS = 3.0
"""error over the noise floor that still counts as explained: simulation and filters are not exact"""
PLAIN_FLOORS = 2.0
"""the same where no finer form of the law is in question (guess: what was right left up to 1.5, what was wrong over
2.2, where neither reached `EXPLAINED_SHARE`; a handful of each)"""
WORTH_SHARE = 0.7
"""near the floor, an error that no effect brings below this share of itself is of the model's exactness, not its
structure (guess: an effect that is really missing takes more)"""
WORTH_EXCESS = 0.45
"""of the error beyond the noise: an effect that leaves less takes all that there is of structure, however little that
is (a model's inexactness is no effect's shape; guess)"""
OUTDONE_T = 3.0
"""t of the fall of the error from the best candidate to what is none: one in a thousand by chance, of one comparison"""
EXPLAINED_SHARE = 0.1
"""error left over the error before that still counts as explained, where the floor is out of reach: 99 % of its
variance. What an effect leaves for its law's being a little other than real is less (on simulated gears up to 0.08
where the right effect left more than two floors, 0.03 as a rule); a wrong one that takes 90 %, as dry friction does of
nearly any loop, leaves more (0.12 where creep was called a loop)"""
TIE_FLOORS = 0.25
"""errors closer than this many noise floors cannot be told apart"""
TWIN_TIE = 1.3
"""errors of twins closer than this factor: what a search stopped at, not what the motion tells (guess)"""
SHARPNESS = 12.0
"""probability falls with the error to this power: half the blocks of 30 s, since neighbours are not independent"""
PRICE = 0.1
"""logarithm of the probability that a number costs"""
SHOWN = 8
RICH_TONES = 2.0
"""effective number of tones in the motor speed below which a motion ties causes that other motions part"""
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


def diagnose(recordings: Sequence[Recorded], model: Model, on_progress: Progress | None = None) -> Diagnosis:
    """What the model lacks on these recordings. Raises `BadInput` in one line.

    Several recordings share one structure and one set of parameters; selection then leaves one recording out.
    """
    warnings = examine(recordings, model)
    if not model.effects:
        raise ModelError("effect: missing: expected at least one [[effect]] to start from")
    progress = on_progress or (lambda what, share: None)
    bench = bench_of(recordings, model)
    if len(bench.trials) > 1:
        bench = _arranged(recordings, model, bench)
    terms = terms_of(model, bench)
    base = fit_terms(bench, terms)

    def floor(solution: Solution) -> float:
        return floor_of(bench, model, solution)

    search = Search(bench, base, missing_effects(model, bench), floor, progress)
    with np.errstate(over="ignore", invalid="ignore"):  # a step too far in the loop is seen by its error
        found = search.run()
    bench.restore(search.start)
    return _Judge(model, bench, search).diagnosis(found, warnings)


def _arranged(recordings: Sequence[Recorded], model: Model, bench: Workbench) -> Workbench:
    """The richest motion first, since the loop is brought to rest on it; blocks are held out instead of whole
    recordings where the others alone would not determine a model."""
    numbers = [tones_of(trial) for trial in bench.trials]
    best = sorted(range(len(numbers)), key=lambda i: -numbers[i])
    if best != list(range(len(best))):
        bench = bench_of([recordings[i] for i in best], model)
    if sorted(numbers)[-2] < RICH_TONES:
        bench.fold = folds(len(np.unique(bench.block)))
    return bench


def missing_effects(model: Model, bench: Workbench) -> tuple[Effect, ...]:
    """The effects that the model lacks and the recordings could show, plugins included.

    In a drive balance a refinement waits for what it refines: friction there is built up from simple to fine.
    """
    known = {row.name for row in model.effects}
    rows = [*of_balance(model.balance), *(plugin.load(name) for name in plugin.plugins())]
    motion = bench.trials[0].motion
    return tuple(
        effect
        for effect in rows
        if effect.balance == model.balance
        and effect.name not in known
        and all(measured(motion, need) for need in effect.needs)
        and all(source[0] in known for source in effect.tied.values())
        and _varies(effect, bench)
        and (model.balance == "torsion" or known.issuperset(effect.refines))
    )


def _varies(effect: Effect, bench: Workbench) -> bool:
    """A temperature effect needs a temperature that is not the same throughout."""
    if "temperature_degC" not in effect.needs:
        return True
    spread = [float(np.ptp(trial.motion.temperature_degC)) for trial in bench.trials]
    means = [float(np.mean(trial.motion.temperature_degC)) for trial in bench.trials]
    return max(max(spread), float(np.ptp(means))) > LEAST_WARMING_K


LEAST_WARMING_K = 1.0


@dataclass(frozen=True)
class _Judge:
    model: Model
    bench: Workbench
    search: Search

    @cached_property
    def outside(self) -> Hypothesis | None:
        """What else it may be, and no effect of the catalogue is: nothing in a balance without a twist."""
        return None if self.model.balance == "drive" else creeping(self.search)

    def diagnosis(self, found: Sequence[Hypothesis], warnings: Sequence[str]) -> Diagnosis:
        base = self.search.base
        error = error_of(fitted_model(self.model, base.solution, self.bench))
        ordered = self.ordered(found)
        verdict = self.verdict(ordered)
        if verdict == "adequate":
            return Diagnosis(verdict, error, (), None, (), tuple(warnings))
        left = where(base.solution.held_out_residual(self.bench), self.bench)
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
        return [h for h in order(found, self.search) if self.improves(h)]

    def verdict(self, ordered: Sequence[Hypothesis]) -> str:
        base = self.search.base
        if not ordered:
            near = base.level < EXPLAINED_FLOORS or self.model.balance == "drive"
            return "adequate" if near else "unexplained"
        best = ordered[0].level
        if self.model.balance != "drive":
            inexact = best > WORTH_SHARE * base.level and not takes_all(base, ordered[0])
            if base.level < EXPLAINED_FLOORS and inexact:
                return "adequate"
            if self.outside is not None and outdone(ordered[0], self.outside):
                return "unexplained"
        share = min(best / base.level, ordered[0].rmse / base.rmse)
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
        rms = self.bench.rms
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
            if _refined(hypothesis, simple, refines) and not insists(simple, hypothesis):
                weights.append(SHY if hypothesis.level <= SUGGESTIVE * simple.level else IDLE)
        return min(weights)

    def belief(self, best: Hypothesis, verdict: str) -> float:
        """How far the best explanation goes: 1 at the noise floor, less the more of what is left is not noise."""
        left = max(best.level - 1, 0.0)
        gone = 1 - (best.level / self.search.base.level) ** 2
        most = UNEXPLAINED_BELIEF if verdict == "unexplained" else 1.0
        if self.model.balance != "drive":  # there friction is built up step by step, and every step leaves the next
            most = min(most, 1 - LAW_DOUBT * beyond_noise(best.level))
        if tones(self.bench) < RICH_TONES:
            most = min(most, POOR_BELIEF)
        return most * gone / (1 + 0.02 * left)

    def tied(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether two explanations cannot be told apart. A refinement that gains nothing over its simpler form is
        no rival of it where that leaves noise: every motion would leave them level. Where more is left, the law itself
        is in doubt, and with it which of its forms is real."""
        refines = {effect.name: effect.refines for effect in self.search.candidates}
        if _refined(other, one, refines):
            doubtful = (one.name, other.name) in self.search.rivals
            return (doubtful or other.level <= SUGGESTIVE * one.level) and not insists(one, other)
        return tied(one, other)

    def experiment(self, ordered: Sequence[Hypothesis], candidates: Sequence[Candidate]) -> Experiment | None:
        """The motion that tells the first explanation from what it is confused with."""
        first = candidates[0]
        if not first.confused_with:
            return None
        other = next(h for h in ordered if h.name == first.confused_with[0])
        one = next(h for h in ordered if h.name == first.effect)
        if (one.name, other.name) in self.search.rivals and other.level > TIE * one.level:
            other = self.search.rivals[one.name, other.name]
        return next_experiment(self.model, self.bench, one, other)


def believed(candidates: Sequence[Candidate]) -> float:
    """Probability of the first cause and of what cannot be told from it."""
    first = candidates[0]
    return sum(row.probability for row in candidates if row is first or row.effect in first.confused_with)


def tones(bench: Workbench) -> float:
    """Effective number of tones, summed over the recordings."""
    return sum(tones_of(trial) for trial in bench.trials)


def tones_of(trial: Trial) -> float:
    """Effective number of tones in the motor speed: (sum p)^2 / sum p^2 over power in bins of about 0.2 Hz."""
    speed = np.gradient(trial.motion.theta_in_rad)[trial.rows[0] : trial.rows[-1]]
    power = np.abs(np.fft.rfft((speed - speed.mean()) * np.hanning(len(speed)))) ** 2
    width = max(1, round(TONE_WIDTH_HZ * len(speed) / trial.motion.rate_hz))
    bins = power[: len(power) // width * width].reshape(-1, width).sum(axis=1)
    return float(bins.sum() ** 2 / max(float((bins**2).sum()), 1e-300))


TONE_WIDTH_HZ = 0.2


def improves(base: Hypothesis, hypothesis: Hypothesis) -> bool:
    """Whether the fall of the held-out error is beyond chance (paired over blocks) and worth a name."""
    most = 1 - LEAST_GAIN
    if hypothesis.level > most * base.level or hypothesis.rmse > most * base.rmse:
        return False
    scaled = hypothesis.solution.held_out * (base.floor / hypothesis.floor) ** 2
    if hypothesis.level < 0.5 * base.level:
        return True
    return _surely(base.solution.held_out, scaled) > LEAST_T


def _surely(before: Array, after: Array) -> float:
    """t of the fall of squared errors (b,), paired over blocks."""
    return max(_t(before - after), _t(np.log(before / after)))


def _t(fall: Array) -> float:
    """Mean over its standard error: of squared errors, where busy blocks rule, or of logarithms, where all count."""
    return float(fall.mean()) / (float(fall.std(ddof=1)) / math.sqrt(len(fall)) + 1e-300)


def order(found: Sequence[Hypothesis], search: Search) -> list[Hypothesis]:
    """Best first, the simpler before what refines it or adds to it unless the data insist."""
    effects = search.candidates
    singles = sorted((h for h in found if len(h.added) == 1), key=rank)
    pairs = sorted((h for h in found if len(h.added) > 1), key=rank)
    singles = _usual_first(_simpler_first(singles, effects))
    if not singles or not pairs:
        return singles or pairs
    best = singles[0].level
    believed = [h for h in pairs if h.level < search.pair_gain(singles[0], h) * best and best > 1.0]
    return [*_usual_first(_simpler_first(believed, effects)), *singles]


def _simpler_first(ranked: Sequence[Hypothesis], effects: Sequence[Effect]) -> list[Hypothesis]:
    """A refinement steps behind its simpler form unless it is clearly better."""
    refines = {effect.name: effect.refines for effect in effects}
    out = list(ranked)
    for i, hypothesis in enumerate(ranked):
        for j, simple in enumerate(ranked):
            if j > i and _refined(hypothesis, simple, refines) and not insists(simple, hypothesis):
                out.remove(simple)
                out.insert(out.index(hypothesis), simple)
    return out


def _usual_first(ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    """What is rarer steps behind what is usual where the two cannot be told apart."""
    out = list(ranked)
    for hypothesis in ranked:
        for usual in ranked:
            behind = out.index(usual) > out.index(hypothesis)
            if behind and _refined(hypothesis, usual, USUAL) and _level_with(usual, hypothesis):
                out.remove(usual)
                out.insert(out.index(hypothesis), usual)
    return out


def _level_with(usual: Hypothesis, rarer: Hypothesis) -> bool:
    """Whether it does as well, or leaves nothing but noise."""
    return tied(usual, rarer) and (usual.level <= 1.0 or not improves(usual, rarer))


def takes_all(base: Hypothesis, hypothesis: Hypothesis) -> bool:
    """Whether nothing is left but noise of what clearly was more."""
    return _excess(hypothesis) < WORTH_EXCESS * _excess(base)


def outdone(best: Hypothesis, other: Hypothesis) -> bool:
    """Whether what is no candidate does better than the best of them, beyond chance."""
    held_out = other.solution.held_out * (best.floor / other.floor) ** 2
    return other.level < best.level and _surely(best.solution.held_out, held_out) > OUTDONE_T


def insists(simple: Hypothesis, finer: Hypothesis) -> bool:
    """Whether the data insist on a refinement: by its error, or by what it leaves above the noise, if that is beyond
    chance."""
    if simple.level > INSIST * finer.level:
        return True
    return improves(simple, finer) and _excess(simple) > INSIST_EXCESS * _excess(finer)


def _excess(hypothesis: Hypothesis) -> float:
    """Error beyond the noise, in noise floors; a third of the floor is no more than the floor is known."""
    return math.sqrt(max(hypothesis.level**2 - 1.0, FLOOR_DOUBT))


def beyond_noise(level: float) -> float:
    """Share of the held-out variance that is surely not noise, of an error in noise floors."""
    return 1.0 - (1.0 + FLOOR_DOUBT) / max(level**2, 1.0 + FLOOR_DOUBT)


FLOOR_DOUBT = 0.1
"""relative variance to which the noise floor is known"""
SUGGESTIVE = 0.95
"""error of a refinement over that of its simpler form below which it is at least a rival"""
IDLE = 0.05
"""weight of a refinement that gains nothing over its simpler form (guess)"""
SHY = 0.25
"""weight of one that gains, but not so much that the data insist on it (guess)"""
INSIST = 1.5
"""error of the simpler form over that of its refinement above which the refinement is believed"""
INSIST_EXCESS = 2.0
"""the same of the error beyond the noise"""


def _refined(one: Hypothesis, simple: Hypothesis, refines: dict[str, tuple[str, ...]]) -> bool:
    """Whether `one` is `simple` with one effect replaced by a refinement of it."""
    extra, less = set(one.added) - set(simple.added), set(simple.added) - set(one.added)
    return len(extra) == 1 and len(less) == 1 and next(iter(less)) in refines.get(next(iter(extra)), ())


def tied(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two explanations of one size cannot be told apart: below the noise nothing is better than anything else,
    and twins are one function of the motion, whatever floor each is held against."""
    if len(one.added) != len(other.added):
        return False
    low, high = sorted(max(h.level, 1.0) for h in (one, other))
    less, more = sorted(h.rmse for h in (one, other))
    return high < TIE * low or high - low < TIE_FLOORS or (twins(one, other) and more < TWIN_TIE * less)


def twins(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether they differ in two effects that no motion tells apart as a rule."""
    return frozenset(set(one.added) ^ set(other.added)) in NO_MOTION


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
