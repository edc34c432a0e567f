"""Which explanation comes first: what improves the model, what the data insist on, what cannot be told apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from edge_daemon.balance.evening import evening_of
from edge_daemon.identify.regression import RegressionProblem, independent_samples
from edge_daemon.identify.solution import Solution
from edge_daemon.identify.torque_lag import STEADY
from edge_daemon.motion.residual_statistics import surely
from edge_daemon.search.belief import left_where_it_is, offset_alone, surpasses, waves_alone
from edge_daemon.search.hypotheses import NEAR_FLOOR, DiagnosisProblem, Hypothesis, added, parted_by, rank
from edge_daemon.search.thresholds import (
    BELOW_SD,
    EXACT_FLOORS,
    EXPLAINED_FLOORS,
    FLOOR_DOUBT,
    INSIST,
    INSIST_EXCESS,
    LEAST_GAIN,
    LEAST_T,
    LIKELY_GAIN,
    LIKELY_SD,
    LIKELY_T,
    TIE,
    TIE_FLOORS,
    TWIN_TIE,
    WORTH_EXCESS,
)


def falls(before: Solution, after: Solution) -> bool:
    """Whether the held-out error of the same recording falls beyond chance (paired over blocks), and enough to be
    worth an effect's numbers."""
    if after.rmse > (1 - LEAST_GAIN) * before.rmse:
        return False
    return after.rmse < 0.5 * before.rmse or surely(before.held_out, after.held_out) > LEAST_T


def improves(base: Hypothesis, hypothesis: Hypothesis) -> bool:
    """Whether the fall of the held-out error is beyond chance (paired over blocks) and worth a name: beside the ripple
    of which it is another form, no less than a law that many samples tell."""
    had = base.solution.names
    most = LIKELY_GAIN if any(effect.waves_of in had for effect in added(hypothesis)) else 1 - LEAST_GAIN
    if hypothesis.error > most * base.error or hypothesis.rmse > most * base.rmse:
        return False
    if hypothesis.error < 0.5 * base.error:
        return True
    return surely(base.solution.held_out, hypothesis.solution.held_out) > LEAST_T


def likely(base: Hypothesis, hypothesis: Hypothesis, problem: RegressionProblem, least_sd: float = LIKELY_SD) -> bool:
    """Whether so many samples say so that few blocks, or few in which anything happens, need not be as sure: friction
    at creep shows at reversals alone, and a joint that is driven at a few constant speeds has a block for each. What
    one block alone says is an event and no law. A ripple that is plain where it is need not take much of slower errors.
    """
    if _plain_waves(base, hypothesis, problem):
        return True
    if hypothesis.error > most_left(base, hypothesis) * base.error or hypothesis.rmse >= base.rmse:
        return False
    before, after = base.solution.held_out, hypothesis.solution.held_out
    if hypothesis.level > NEAR_FLOOR and surely(before, after) < LIKELY_T:
        return False
    every, rest = apart_sd(base, hypothesis, problem)
    return every > least_sd and rest > LEAST_T


def _plain_waves(base: Hypothesis, hypothesis: Hypothesis, problem: RegressionProblem) -> bool:
    """Whether what is added is ripple of a usual form, and samples that count for what they tell insist on it."""
    rows = added(hypothesis)
    falls_at_all = hypothesis.error < base.error and hypothesis.rmse < base.rmse
    if not falls_at_all or not all(effect.is_ripple and effect.balance == "drive" for effect in rows):
        return False
    if left_where_it_is(hypothesis, base, problem) > 1 - LEAST_GAIN:
        return False
    every, rest = apart_sd(base, hypothesis, problem, evened=True)
    return every > BELOW_SD and rest > LEAST_T


def most_left(base: Hypothesis, hypothesis: Hypothesis) -> float:
    """Error over that of the model that an explanation may leave to be worth a name: one that leaves more than noise
    may mend another law that is a little off. Where the load makes friction, the form in which it does need not take
    as much, but for near the noise."""
    rows = added(hypothesis)
    formed = base.level > EXACT_FLOORS and any(term.effect.loaded for term in base.solution.terms)
    formed &= all(effect.loaded and not effect.waves for effect in rows)
    return 1 - LEAST_GAIN if formed or hypothesis.level <= NEAR_FLOOR else LIKELY_GAIN


def apart_sd(
    before: Hypothesis, after: Hypothesis, problem: RegressionProblem, evened: bool = False
) -> tuple[float, float]:
    """Standard deviations between two residuals, and without the block that says most. `evened`, and near the noise,
    samples count for what they tell: the noise of an acceleration is quick, and friction that is drowned in it is not.
    """
    left, was = (problem.held_out_residual(h.solution) for h in (after, before))
    evening = evening_of(left, problem.trials) if evened or after.level <= EXACT_FLOORS else None
    if evening is not None:
        left, was = evening.of(left), evening.of(was)
    count = independent_samples(left, problem)
    least, most = (np.bincount(problem.block, residual**2) for residual in (left, was))
    rest = np.arange(len(most)) != int(np.argmax(most - least))
    every = math.log(float(most.sum()) / float(least.sum()))
    others = math.log(float(most[rest].sum()) / float(least[rest].sum()))
    return math.sqrt(count * max(every, 0.0)), math.sqrt(count * max(others, 0.0))


def ordered(found: Sequence[Hypothesis], problem: DiagnosisProblem) -> list[Hypothesis]:
    """Best first, the simpler before what refines it or adds to it unless the data insist."""
    singles = sorted((h for h in found if len(h.added) == 1), key=rank)
    pairs = sorted((h for h in found if len(h.added) > 1), key=rank)
    singles = _usual_first(_simpler_first(singles, problem), problem)
    if not pairs:
        return singles
    believed = pairs
    if singles:
        best = singles[0]
        beside = [h for h in singles if h is best or h.error < best.error]  # what stands behind it for its form alone
        believed = [h for h in pairs if best.level > 1.0 and any(_more(h, one, problem) for one in beside)]
    believed = [h for h in believed if all(_more(h, fewer, problem) for fewer in believed if _part_of(fewer, h))]
    return [*_usual_first(_simpler_first(believed, problem), problem), *singles]


def _part_of(fewer: Hypothesis, more: Hypothesis) -> bool:
    """Whether an explanation is another one without some of its effects."""
    return set(fewer.added) < set(more.added)


def _more(pair: Hypothesis, single: Hypothesis, problem: DiagnosisProblem) -> bool:
    """Whether a second effect is believed rather than taken for what mends the first, as waves and an offset do to no
    other law, and two laws do not to a finer form of one of them."""
    if pair.error < problem.pair_gain(single, pair) * single.error:
        return True
    drive = all(effect.balance == "drive" for effect in added(pair))
    much = drive and pair.error < LIKELY_GAIN * single.error
    apart = waves_alone(pair, single) or offset_alone(pair, single) or _in_place(pair, single, problem)
    return much and apart and surpasses(pair, single, problem)


def _in_place(pair: Hypothesis, single: Hypothesis, problem: DiagnosisProblem) -> bool:
    """Whether a plainer form of one effect, and another, are in the place of that."""
    name = single.added[0]
    return len(single.added) == 1 and name not in pair.added and not problem.plainer(name).isdisjoint(pair.added)


def _simpler_first(ranked: Sequence[Hypothesis], problem: DiagnosisProblem) -> list[Hypothesis]:
    """A refinement steps behind its simpler form unless it is clearly better."""
    refines = {effect.name: effect.refines for effect in problem.known.values()}
    out = list(ranked)
    for hypothesis in ranked:
        for simple in ranked:
            behind = out.index(simple) > out.index(hypothesis)
            if not behind or not refined(hypothesis, simple, refines):
                continue
            if not insists(simple, hypothesis, problem.regression):
                out.remove(simple)
                out.insert(out.index(hypothesis), simple)
    return out


def _usual_first(ranked: Sequence[Hypothesis], problem: DiagnosisProblem) -> list[Hypothesis]:
    """What is rarer steps behind what is usual where the two cannot be told apart."""
    yields_to = {name: problem.yields_to(name) for name in problem.known}
    out = list(ranked)
    for hypothesis in ranked:
        for usual in ranked:
            behind = out.index(usual) > out.index(hypothesis)
            if not behind or not refined(hypothesis, usual, yields_to):
                continue
            if _level_with(usual, hypothesis) and not _foretells(usual, hypothesis, problem.regression):
                out.remove(usual)
                out.insert(out.index(hypothesis), usual)
    return out


def _level_with(usual: Hypothesis, rarer: Hypothesis) -> bool:
    """Whether it does as well, or leaves nothing but noise."""
    return tied(usual, rarer) and (usual.level <= 1.0 or not improves(usual, rarer))


def takes_all(base: Hypothesis, hypothesis: Hypothesis) -> bool:
    """Whether nothing is left but noise of what clearly was more."""
    return _excess(hypothesis) < WORTH_EXCESS * _excess(base)


def insists(simple: Hypothesis, finer: Hypothesis, problem: RegressionProblem) -> bool:
    """Whether the data insist on a refinement: by its error, by what it leaves above the noise, if that is beyond
    chance, or by samples that count for what they tell."""
    if simple.error > INSIST * finer.error:
        return True
    if improves(simple, finer) and _excess(simple) > INSIST_EXCESS * _excess(finer):
        return True
    return _foretells(simple, finer, problem)


def _foretells(simple: Hypothesis, finer: Hypothesis, problem: RegressionProblem) -> bool:
    """Whether samples of one encoder tell a refinement, or a rarer form, near the noise, or where it takes a good part
    of what is left."""
    near = finer.level <= EXACT_FLOORS and finer.error < simple.error
    taken = finer.level <= EXPLAINED_FLOORS and finer.error < LIKELY_GAIN * simple.error
    if not (near or taken) or any(effect.balance != "drive" for effect in added(finer)):
        return False
    every, rest = apart_sd(simple, finer, problem)
    return every > LIKELY_SD and rest > LEAST_T


def _excess(hypothesis: Hypothesis) -> float:
    """Error beyond the noise, in noise floors; a third of the floor is no more than the floor is known."""
    return math.sqrt(max(hypothesis.level**2 - 1.0, FLOOR_DOUBT))


def refined(one: Hypothesis, simple: Hypothesis, refines: Mapping[str, tuple[str, ...]]) -> bool:
    """Whether `one` is `simple` with one effect replaced by a refinement of it, which may hold a sensor's zero too."""
    extra, less = set(one.added) - set(simple.added), set(simple.added) - set(one.added)
    less -= {STEADY} if len(less) > 1 else set()
    return len(extra) == 1 and len(less) == 1 and next(iter(less)) in refines.get(next(iter(extra)), ())


def tied(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two explanations of one size cannot be told apart: below the noise nothing is better than anything else,
    and twins are one function of the motion, whatever floor each is held against."""
    if len(one.added) != len(other.added):
        return False
    floor = min(h.floor for h in (one, other))
    low, high = sorted(max(h.error, floor) for h in (one, other))
    less, more = sorted(h.rmse for h in (one, other))
    return (
        high < TIE * low
        or high - low < TIE_FLOORS * floor
        or (indistinguishable(one, other) and more < TWIN_TIE * less)
    )


def indistinguishable(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether they differ in two effects that no motion tells apart as a rule."""
    return bool(parted_by(one, other))
