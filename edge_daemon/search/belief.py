"""How far each explanation is believed: a likelihood of the held-out residuals, and what no candidate is.

Where two explanations leave residuals of scatter s and s', n independent samples make a log likelihood ratio of
n log(s' / s), and its signed root, sqrt(2 n log(s' / s)), is how many standard deviations lie between them (Wilks 1938,
Ann. Math. Stat. 9(1)). How many samples are independent follows from the autocorrelation of the residual itself
(Bartlett 1946, J. R. Stat. Soc. Suppl. 8(1)): noise behind a filter has some thousands in half a minute, what a wrong
law leaves a hundred. The tails are exponential, not Gaussian, since laws are never quite those of the gear and a search
may stop short: how long they are was learned from simulated recordings (`tools/calibrate_thresholds.py`), and
`tools/bench_belief.py` holds the beliefs against what is true.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edge_daemon.balance.evening import evening_of
from edge_daemon.identify.regression import RegressionProblem, independent_samples
from edge_daemon.motion.residual_statistics import surely
from edge_daemon.records import Array
from edge_daemon.search.hypotheses import NEAR_FLOOR, DiagnosisProblem, Hypothesis, added, rank
from edge_daemon.search.thresholds import (
    EXACT_FLOORS,
    EXPLAINED_FLOORS,
    FAR_ODDS,
    FAR_POWER,
    FAR_SHARE,
    FLOOR_DOUBT,
    LEAST_ODDS,
    NONE_ODDS,
    NUMBER_PRICE,
    POOR_ODDS,
    STEP_ODDS,
    STEP_POWER,
    STEP_TEMPER,
    TEMPER,
    TOLD_ODDS,
)

SHOWN = 8
"""Explanations that are listed, and weighed against each other, at the most."""


def samples(hypothesis: Hypothesis, problem: RegressionProblem) -> float:
    """Independent samples of what a hypothesis leaves."""
    return independent_samples(problem.held_out_residual(hypothesis.solution), problem)


def scatter(hypothesis: Hypothesis) -> float:
    """Logarithm of the scatter that a likelihood takes: the held-out error, but never less than the sensors' noise."""
    return math.log(max(hypothesis.error, hypothesis.floor))


def log_weights(worth: Sequence[Hypothesis], shy: Array, problem: RegressionProblem, temper: float = TEMPER) -> Array:
    """(k,) log likelihood, with what each number costs and `shy` (k,) of the order, that of the first taken off.

    What the order puts behind is never more believed: there a reason stands against it that errors do not know.
    """
    scatters = np.array([scatter(h) for h in worth])
    scatters = np.minimum.accumulate(scatters[::-1])[::-1]
    counts = np.array([samples(h, problem) for h in worth])
    numbers = [h.parameters for h in worth]
    apart_sd = np.sqrt(2.0 * counts * (scatters - scatters.min()))
    repeats = all(effect.waves for h in worth for effect in added(h))
    if repeats and min(h.level for h in worth) > EXPLAINED_FLOORS:  # forms of one ripple, none of them the gear's
        numbers = [sum(len(effect.waves) for effect in added(h)) for h in worth]
        apart_sd = np.minimum(apart_sd, [max(_surely_over(worth[0], h), 0.0) for h in worth])
    price = NUMBER_PRICE * np.array(numbers)
    weights = np.minimum.accumulate(-temper * apart_sd + shy - price)
    out: Array = weights - weights[0]
    return out


def _surely_over(best: Hypothesis, other: Hypothesis) -> float:
    """Standard deviations between two explanations that are both wrong: by how even one is ahead over the blocks
    (Vuong 1989, Econometrica 57(2)). What a wrong law leaves is the same again and again, not so many samples."""
    return surely(other.solution.held_out, best.solution.held_out)


def far_odds(best: Hypothesis) -> float:
    """Odds of a law outside the catalogue by the floors that the best explanation leaves."""
    return FAR_ODDS * (best.level / EXPLAINED_FLOORS) ** 4


def most_odds(best: Hypothesis, base: Hypothesis) -> float:
    """Odds of such a law by the share of the error that is left, which no floors make more: no law is the gear's own to
    a hundredth, however quiet its sensors are."""
    return float((best.error / base.error / FAR_SHARE) ** FAR_POWER)


def believable_level(base: Hypothesis) -> float:
    """Error over the noise floor beyond which no explanation is named: `far_odds`, and `most_odds`, outweigh it by
    itself and by all that cannot be told from it."""
    by_floors = EXPLAINED_FLOORS * (SHOWN / FAR_ODDS) ** 0.25
    return float(max(by_floors, FAR_SHARE * base.level * SHOWN ** (1 / FAR_POWER)))


def unexplained(best: Hypothesis, count: float) -> float:
    """Odds of a law that leaves nothing but noise over one that leaves `best.level` times as much, by its power; but no
    more than so many independent samples tell: a slow drift of a sweep is few of them."""
    apart = math.log(max(best.level, 1.0))
    return math.exp(min(2.0 * apart, TEMPER * math.sqrt(2.0 * count * apart)))


def none_log_weight(best: Hypothesis, base: Hypothesis, poor: bool, count: float) -> float:
    """Log odds of a law outside the catalogue over the best explanation, with `count` independent samples: the more is
    left of the error, above noise and of what there was, the more; on a `poor` motion laws take each other's shape, and
    leave nothing but noise."""
    left = unexplained(best, count) * (best.error / base.error) ** 2
    odds = min(NONE_ODDS * left + far_odds(best), most_odds(best, base))
    return math.log(odds + (POOR_ODDS if poor else 0.0) + LEAST_ODDS)


def step_log_weight(best: Hypothesis, base: Hypothesis, problem: RegressionProblem, foretold: bool = True) -> float:
    """Log odds that a step of a story is none, where each leaves the next: that what it takes is a part of another law,
    by the error's power that is left over what is gone, near a noise that was `foretold` by what is left above it; or
    is nothing, by the likelihood of the model as it was, which is all that waves are asked: they are part of no slower
    law."""
    left = min(left_where_it_is(best, base, problem), 1.0 - 1e-9)
    nothing = math.exp(-STEP_TEMPER * math.sqrt(-2.0 * samples(best, problem) * math.log(left)))
    if waves_alone(best, base):
        return math.log(nothing)
    odds = left**2 / (1.0 - left**2)
    if foretold and best.level <= EXACT_FLOORS:
        odds = min(odds, max(best.level**2 - 1.0, FLOOR_DOUBT) / max(base.level**2 - best.level**2, 1e-9))
    return math.log((STEP_ODDS * odds) ** STEP_POWER + nothing)


def surpasses(one: Hypothesis, other: Hypothesis, problem: DiagnosisProblem) -> bool:
    """Whether it is out of the question that what one says more, or otherwise, only mends the laws of the other, or
    unlikely where that is an offset, which is no part of any."""
    most = TOLD_ODDS if offset_alone(one, other) else LEAST_ODDS
    return step_log_weight(one, other, problem.regression, foretold=not problem.noise) < math.log(most)


def offset_alone(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether all that an explanation says more than another is steady."""
    more = [effect for effect in added(one) if effect.name not in other.added]
    return bool(more) and all(effect.steady == "exactly" for effect in more)


def outbids(several: Hypothesis, found: Sequence[Hypothesis], problem: DiagnosisProblem) -> bool:
    """Whether the data insist on several effects rather than on the best of those found with fewer."""
    fewer = min((h for h in found if len(h.added) < len(several.added)), default=problem.base, key=rank)
    return surpasses(several, fewer, problem)


def says_all(pair: Hypothesis, found: Sequence[Hypothesis], problem: DiagnosisProblem) -> bool:
    """Whether a pair leaves nothing but noise, or far less than any one effect."""
    return pair.level <= NEAR_FLOOR or outbids(pair, found, problem)


def left_where_it_is(best: Hypothesis, base: Hypothesis, problem: RegressionProblem) -> float:
    """Error over that of the model; of waves, which are no part of a slower law, where they are: with both residuals
    evened out by what the better one leaves."""
    left = best.error / base.error
    if not waves_alone(best, base):
        return left
    after, before = (problem.held_out_residual(h.solution) for h in (best, base))
    evening = evening_of(after, problem.trials)
    if evening is None:
        return left
    after, before = evening.of(after), evening.of(before)
    return min(left, math.sqrt(float(after @ after) / float(before @ before)))


def waves_alone(best: Hypothesis, base: Hypothesis) -> bool:
    """Whether all that an explanation adds to another repeats."""
    return all(effect.is_ripple for effect in added(best) if effect.name not in base.added)


def outside_log_weight(best: Hypothesis, outside: Hypothesis, problem: RegressionProblem) -> float:
    """Log odds of a law that is no candidate but was tried, over the best explanation; where that leaves nothing but
    noise, none can do better, whatever noise it hears."""
    apart = scatter(outside) - scatter(best)
    if best.level <= 1:
        apart = max(apart, 0.0)
    count = samples(outside if apart > 0 else best, problem)
    apart_sd = math.copysign(math.sqrt(2.0 * count * abs(apart)), apart)
    return -TEMPER * apart_sd - NUMBER_PRICE * (outside.parameters - best.parameters)


def beliefs(log_weight: Array, log_none: Sequence[float]) -> Array:
    """(k,) probabilities of the candidates beside everything that none of them is."""
    every = np.concatenate((log_weight, np.asarray(log_none, dtype=float)))
    share = np.exp(every - every.max())
    out: Array = share[: len(log_weight)] / share.sum()
    return out
