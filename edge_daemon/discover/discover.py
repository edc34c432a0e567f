"""Laws outside the catalogue: formulas proposed for what a model leaves, where the data insist on one.

What is left is searched for products of simple factors (`screening`, `refining`, `search`), the best are written as
expressions (`writing`), fitted with the model as `add` would, and ranked by held-out error and length.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from edge_daemon.discover.curve import curve_of
from edge_daemon.discover.extremes import HeldOutExtremes, stretch
from edge_daemon.discover.leftover import Leftover, Misread
from edge_daemon.discover.memory import begun_before
from edge_daemon.discover.past_axes import channel_of, family
from edge_daemon.discover.refining import Formula, directed, leaps
from edge_daemon.discover.search import EXACT_FLOORS, MOST_PRODUCTS, FormulaSearch
from edge_daemon.discover.sticking import sticking
from edge_daemon.discover.table import best_table, in_words
from edge_daemon.discover.writing import axes_of, plainer, rounded, set_off, written
from edge_daemon.effects.expression import parse
from edge_daemon.effects.model import Model, ModelEffect, ModelError
from edge_daemon.effects.torque_source import MOTOR_SIDE
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.results import Candidate, Diagnosis, Proposal
from edge_daemon.explain.verdict import believed
from edge_daemon.identify.fit import ReadyOnce, fit_terms, floor_of, problem_of, terms_of, unit_of
from edge_daemon.identify.regression import STIFFNESS, RegressionProblem
from edge_daemon.records import Array, Recorded
from edge_daemon.search.hypotheses import LEAST_FLOOR, Progress
from edge_daemon.search.thresholds import EXPLAINED_FLOORS

NAME = "law"
"""Name under which a formula is tried; the user gives it another."""
REFITTED, NEAR_BEST = 4, 1.3
"""Formulas that are fitted with the model as `add` would, and their error over the best one's up to which one is: none
beyond would be believed to a twentieth."""
CHOICES = 500.0
"""Factors among which each of a formula's is chosen: kinds, axes and where their numbers are looked for first; 490 of
them with one encoder, 589 with two, and eight half turns."""
TWINS = 2
"""Formulas of which it is asked whether the data tell a friction from a load."""
LEAST_LEVEL = 1.6
"""Error over the noise floor below which a model leaves nothing that a formula is looked for in (guess: an exact model
leaves up to 1.3)."""
LEAST_GAIN = 0.75
"""Error after over before up to which a formula is worth telling (guess: curves of a fit to chance take a tenth)."""
NEAR_FLOORS, NEAR_SHARE = 3.0, 0.05
"""Error over the noise floor, or over that before, up to which a formula that leaps with the direction says all that
there is to say, a measured rate does not carry its reversals; any other does up to `EXACT_FLOORS`."""
ROUGH_BELIEF = 0.5
"""Most that is believed of a formula whose reversals leave more than three noise floors: what they leave hides other
shapes, and one in seven did not hold on another motion; and of one that goes astray on extremes, or that speaks of
places that were not seen."""
PART_BELIEF = 0.4
"""Most that is believed of a formula that leaves more than that (guess)."""
TABLE_BELIEF = 0.2
"""Most that is believed of a table: it is a curve, and the law behind it may depend on more (guess)."""
SHARPNESS, PRICE = 12.0, 0.1
"""Probability falls with the error to this power, and so much in its logarithm for each number."""
SAME = 0.02
"""Difference of two formulas of the same axes, over their torque, up to which they are one law (guess)."""
LITTLE_MORE = 1.01
"""Error of one that says the same in fewer numbers, over that of the better, up to which it is told instead (guess)."""
ODD_BELIEF = 4.0
"""How much more an unusual factor costs in probability than in error (guess)."""
RESEMBLES = 0.6
"""Share of a formula's torque that an effect of the catalogue must make to be named beside it."""
CERTAIN = 0.9
"""Probability of a cause from which on no formula is looked for (guess)."""
CATALOGUED_SHARE = 0.1
"""Error that the best of the catalogue leaves of a drive balance, over that before, below which nothing else is looked
for: a measured speed does not carry its reversals, while a spring near the right one leaves little and is wrong."""
NEARLY_EXACT = 1.2
"""The same over the noise floor, of a cause by which a torque is not what the recording calls it (guess: an exact model
leaves up to 1.3, most less)."""
MISREAD_GAIN = 0.7
"""Error of the best formula of what an encoder misreads over that of a torque up to which it is told (guess)."""
STEPS = 3
"""Causes of a drive balance that are added in turn before a formula is held against them (guess: friction, drag and one
more)."""
BOUND = 1.3
"""Error of a formula beside the model's bounds over that without them above which it is tried set off (guess)."""
AS_GOOD = 1.05
"""Error of a formula over that of two effects up to which it does as well (guess)."""
FAR_BETTER = 0.5
"""Error of a formula over that of the best of the catalogue up to which it is told beside it."""


@dataclass(frozen=True, slots=True)
class Priced:
    """A proposal that is not judged yet."""

    proposal: Proposal
    price: float
    """in numbers"""
    leaps: bool
    """with the direction"""
    stretch: HeldOutExtremes
    guessed: bool
    """of places that were not seen, or of what was before"""
    axes: frozenset[str]
    """channels, whether as they are or as they were"""
    form: object
    """kinds and axes of each product, whatever the numbers"""
    torque: Array
    """(m,) of the formula beside the model"""

    def says_what(self, other: Priced) -> bool:
        """Whether another is of the same form, or speaks of the same axes and comes to the same: one law, said in two
        ways."""
        if self.form == other.form:
            return True
        apart = float(np.sum((self.torque - other.torque) ** 2))
        return self.axes == other.axes and apart < SAME**2 * float(np.sum(self.torque**2))

    @property
    def astray(self) -> bool:
        """Whether it is likely to go wrong on another motion."""
        return self.guessed or self.stretch.astray


def discover(
    recordings: Sequence[Recorded],
    model: Model,
    on_progress: Progress | None = None,
    thorough: bool = False,
) -> Diagnosis:
    """The diagnosis, with formulas for what the catalogue does not explain. Raises `BadInput` in one line.

    `thorough`: also where it offers a cause that leaves more than noise.
    """
    progress = on_progress or (lambda what, share: None)
    recordings = [ReadyOnce(row) for row in recordings]
    found = diagnose(recordings, model, lambda what, share: progress(what, 0.6 * share))
    if not _worth(found, model, thorough):
        return found
    with np.errstate(all="ignore"):
        rows = proposals(recordings, model, lambda what, share: progress(what, 0.6 + 0.4 * share), _rival(found))
    reached, numbers, effects = _story(rows, recordings, model, found)
    good = [row for row in rows if row.nrmse_after < AS_GOOD * reached]
    shorter = [row for row in good if row.numbers < numbers and row.laws < effects]
    told = tuple(row for row in rows if row in shorter or row.nrmse_after < FAR_BETTER * reached)
    return _beside(_doubted(found, rows, shorter, reached), told)


def _doubted(found: Diagnosis, rows: Sequence[Proposal], shorter: Sequence[Proposal], reached: float) -> Diagnosis:
    """The diagnosis, its causes together believed no further than a part where a formula leaves much less than they
    come to, or than one that leaves as little with fewer numbers lets them: then they only imitate what is missing."""
    imitated = min((row.nrmse_after for row in rows), default=math.inf) < LEAST_GAIN * reached
    doubt = max([row.probability for row in shorter] + [(1.0 - PART_BELIEF) * imitated])
    share = min((1.0 - doubt) / max(sum(row.probability for row in found.candidates), 1e-300), 1.0)
    less = tuple(replace(row, probability=share * row.probability) for row in found.candidates)
    return replace(found, candidates=less)


def _beside(found: Diagnosis, told: tuple[Proposal, ...]) -> Diagnosis:
    """The diagnosis with formulas, the catalogue explaining nothing where one of them is believed rather than it."""
    if found.verdict != "missing":
        return replace(found, proposals=told)
    least = (LEAST_GAIN if _against_its_name(found) else FAR_BETTER) * found.candidates[0].nrmse_after
    outdone = any(row.probability > believed(found.candidates) and row.nrmse_after < least for row in told)
    return replace(found, proposals=told, verdict="unexplained" if outdone else "missing")


def _worth(found: Diagnosis, model: Model, thorough: bool) -> bool:
    """Whether the catalogue leaves something to look for."""
    floor = max(found.error.noise_floor_nrmse, LEAST_FLOOR)
    if found.verdict == "adequate" or found.error.nrmse < LEAST_LEVEL * floor:
        return False
    if found.verdict == "unexplained":
        return True
    best = found.candidates[0].nrmse_after
    against = _against_its_name(found)
    doubtful = thorough or against or found.candidates[0].probability < CERTAIN or model.balance == "drive"
    rough = CATALOGUED_SHARE * found.error.nrmse if model.balance == "drive" else 0.0
    left = best > max((NEARLY_EXACT if against else EXACT_FLOORS) * floor, rough)
    return doubtful and (left or "+" in found.candidates[0].effect)


def _against_its_name(found: Diagnosis) -> bool:
    """Whether what is told first says that a torque is another than the one that the recording calls it."""
    return found.verdict == "missing" and MOTOR_SIDE.name in found.candidates[0].effect.split("+")


def _story(
    rows: Sequence[Proposal], recordings: Sequence[Recorded], model: Model, found: Diagnosis
) -> tuple[float, int, int]:
    """Error that the catalogue comes to where it offers a cause, and with how many numbers and effects where that takes
    several: two at once, or in a drive balance, where friction is built up from simple to fine, some one by one. As
    many laws under other names are no shorter. Told only where a formula is believed that could lose by it, and where
    the diagnosis, which has looked for a whole story already, did not end far above the noise."""
    if found.verdict == "unexplained" or not found.candidates:
        return math.inf, 0, 0
    first, added = found.candidates[0], 0
    reached, numbers, before = first.nrmse_after, len(first.parameters), len(model.effects)
    if _against_its_name(found):
        return reached, numbers + len(MOTOR_SIDE.amplitudes) + 1, len(first.effect.split("+")) + 1
    noise = first.nrmse_after < EXACT_FLOORS * found.error.noise_floor_nrmse
    steps = STEPS if model.balance == "drive" and not noise else 0
    rivals = [row for row in rows if row.probability > PART_BELIEF]
    all_told = first.nrmse_after > EXPLAINED_FLOORS * found.error.noise_floor_nrmse
    if steps and rivals and (all_told or all(_says_all(row, first) for row in rivals)):
        return reached, numbers + 1, 2
    while added < steps and any(row.nrmse_after < AS_GOOD * reached for row in rivals):
        step = diagnose(recordings, model) if added else found
        if step.verdict != "missing":
            break
        told = step.candidates[0]
        numbers += len(told.parameters) if added else 0
        model = step.with_first or add_effect(model, told.effect, recordings).model
        reached, added = min(reached, told.nrmse_after), added + 1
    effects = len(model.effects) - before if added else len(first.effect.split("+"))
    return reached, numbers if effects > 1 else 0, effects


def _says_all(row: Proposal, first: Candidate) -> bool:
    """Whether a formula does far better than one cause and has fewer numbers than that with any other beside it."""
    shorter = row.laws < 2 and row.numbers < len(first.parameters) + 1
    return shorter and row.nrmse_after < FAR_BETTER * first.nrmse_after


class Rival(NamedTuple):
    """What the catalogue comes to."""

    nrmse: float = math.inf
    """error over the torque, infinite where it names nothing"""
    products: int = MOST_PRODUCTS
    """summands of a formula that would be told beside it"""


NOTHING_NAMED = Rival()


def _rival(found: Diagnosis) -> Rival:
    """Where the catalogue leaves so little that no formula can do far better, only a shorter one is worth telling."""
    if found.verdict != "missing":
        return NOTHING_NAMED
    first = found.candidates[0]
    effects = len(first.effect.split("+")) + _against_its_name(found)
    noise = LEAST_GAIN * first.nrmse_after < found.error.noise_floor_nrmse
    return Rival(first.nrmse_after, effects - 1 if noise else MOST_PRODUCTS)


def proposals(
    recordings: Sequence[Recorded], model: Model, progress: Progress, rival: Rival = NOTHING_NAMED
) -> tuple[Proposal, ...]:
    """Formulas for what the model leaves, best first, whatever the catalogue says; none where all are far behind the
    `rival`."""
    leftovers = [_leftover(problem_of(recordings, model), model)]
    if any(leftovers[0].problem.late_s):  # what is missing may have looked late
        leftovers.append(_leftover(problem_of(recordings, model, as_read=True), model))
    leftovers.sort(key=lambda row: row.base.rmse)
    noise = min(_floor(row) / row.problem.rms for row in leftovers)
    tries: list[tuple[tuple[Proposal, ...], Leftover]] = []
    ahead = math.inf
    for row in leftovers:
        search = FormulaSearch(row, _floor(row), progress, rival.nrmse * row.problem.rms, ahead, rival.products)
        tries.append((_proposed(search), row))
        if _least(tries[-1][0]) < EXACT_FLOORS * noise:
            break
        ahead = search.first
    found, leftover = min(tries, key=lambda row: _least(row[0]))
    if (found and found[0].probability > PART_BELIEF) or (not found and rival.nrmse < math.inf):
        return found
    return (*found, *_table(leftover, _least(found)))


def _least(found: Sequence[Proposal]) -> float:
    """Error that the best of some formulas leaves."""
    return min((row.nrmse_after for row in found), default=math.inf)


def _leftover(problem: RegressionProblem, model: Model) -> Leftover:
    """What a model leaves of one problem."""
    return Leftover(problem, fit_terms(problem, terms_of(model, problem)), model)


def _floor(leftover: Leftover) -> float:
    """rms that sensor noise leaves."""
    return max(floor_of(leftover.problem, leftover.model, leftover.base), LEAST_FLOOR)


def _proposed(search: FormulaSearch) -> tuple[Proposal, ...]:
    """Formulas for what a model leaves."""
    leftover, floor = search.leftover, search.floor
    rms = leftover.problem.rms
    before, least = leftover.base.rmse / rms, floor / rms
    rows = _stuck(leftover, floor, search.progress)
    if not any(row.proposal.nrmse_after < max(NEAR_FLOORS * least, NEAR_SHARE * before) for row in rows):
        rows += _searched(search)
    least = min([least, *(row.proposal.nrmse_after for row in rows)])  # no noise is more than a formula leaves
    return _believed(_distinct(rows, before), before, least)


def _stuck(leftover: Leftover, floor: float, progress: Progress) -> list[Priced]:
    """Of dry friction of the twist, which is simulated; none where there is no such friction."""
    simulated = sticking(leftover)
    if simulated is None:
        return []
    found = _near(FormulaSearch(simulated, floor, progress).around(simulated.product), simulated, floor)
    waves = [any(product.waves for product in formula.products) for formula in found]
    shorter = [(rounded if wave else plainer)(simulated, f, floor) for f, wave in zip(found, waves, strict=True)]
    return _told(simulated, shorter, floor)


def _searched(search: FormulaSearch) -> list[Priced]:
    """Of everything else."""
    leftover, floor = search.leftover, search.floor
    every = search.run()
    if every and not search.reached and leftover.model.balance == "torsion" and STIFFNESS[0] in leftover.base.names:
        misread = FormulaSearch(Misread(leftover), floor, search.progress)
        errors = misread.taken_over(every)
        if errors and misread.level(errors[0]) < MISREAD_GAIN * search.level(every[0]):
            return _priced(misread.leftover, _near(errors, misread.leftover, floor), floor)
    rows = _priced(leftover, _near(every, leftover, floor), floor)
    if rows and not any(math.isfinite(row.proposal.nrmse_after) for row in rows):  # blocks do not tell what they hold
        rows = _priced(leftover, _near([f for f in every if len(f.products) == 1], leftover, floor), floor)
    return rows


def _priced(leftover: Leftover, found: Sequence[Formula], floor: float) -> list[Priced]:
    """Formulas, and the first of them as friction, fitted with the model."""
    formulas = [plainer(leftover, formula, floor) for formula in found]
    twins = [directed(leftover, formula, floor) for formula in formulas[:TWINS]]
    return _told(leftover, [*formulas, *(rounded(leftover, twin, floor) for twin in twins if twin is not None)], floor)


def _told(leftover: Leftover, formulas: Sequence[Formula], floor: float) -> list[Priced]:
    """Each formula once."""
    once = {_said(formula): formula for formula in reversed(formulas)}
    return [_proposal(leftover, once[key], floor) for key in reversed(once)]


def _said(formula: Formula) -> tuple[object, ...]:
    """What a formula says, in whatever order its factors stand."""
    return tuple(
        sorted(tuple(sorted((f.kind.name, f.axis, f.numbers) for f in product.factors)) for product in formula.products)
    )


def _near(found: Sequence[Formula], leftover: Leftover, floor: float) -> list[Formula]:
    """Those of which any may come to be believed."""
    found = [formula for formula in found if _told_by(leftover, formula, floor)]
    if not found:
        return []
    squares = [max(formula.square, floor**2 * len(formula.left)) for formula in found]
    return [f for f, square in zip(found, squares, strict=True) if square < NEAR_BEST**2 * min(squares)][:REFITTED]


def _told_by(leftover: Leftover, formula: Formula, floor: float) -> bool:
    """Whether what is left says more than its formula does: the logarithm of its likelihood ratio, over independent
    samples of what is to be explained, against the choice of its factors and its numbers (minimum description length;
    Rissanen 1978, Automatica 14)."""
    noise = floor**2 * len(formula.left)
    said = 0.5 * leftover.samples * math.log(leftover.square / max(formula.square, noise, 1e-300))
    factors = sum(len(product.factors) for product in formula.products)
    return said > factors * math.log(CHOICES) + 0.5 * formula.price * math.log(max(leftover.samples, 1.0))


def _table(leftover: Leftover, reached: float) -> list[Proposal]:
    """The curve itself where no formula says all, if it does better than they do."""
    best = best_table(leftover)
    if best is None:
        return []
    axis, expression, share = best
    after, span = _after(leftover, expression), leftover.spans[axis]
    before = leftover.base.rmse / leftover.problem.rms
    if after > min(reached, LEAST_GAIN * before):
        return []
    shift = leftover.shift.get(axis, 0.0)
    seen = {axis: (span.low + shift, span.high + shift)}
    stations = len(parse(expression, leftover.names).amplitudes)
    return [Proposal(expression, in_words(axis), after, TABLE_BELIEF * share, seen, numbers=stations)]


def _proposal(leftover: Leftover, formula: Formula, floor: float) -> Priced:
    """A formula fitted with the model as `add` would, and its price in numbers. Where that leaves more than the formula
    by itself, a number of the model is at its bound: then the formula set off from it is tried."""
    unit = unit_of(leftover.model, leftover.problem.trials[0].motion.extra)
    text = written(leftover, formula, unit)
    after = _after(leftover, text.expression)
    alone = math.sqrt(formula.square / len(formula.left)) / leftover.problem.rms
    for other in set_off(leftover, formula) if after > BOUND * max(alone, floor / leftover.problem.rms) else ():
        further = written(leftover, other, unit)
        if (left := _after(leftover, further.expression)) < after / BOUND:
            formula, text, after = other, further, left
    ranges = {}
    for axis in axes_of(formula):
        span, shift = leftover.spans[axis], leftover.shift.get(axis, 0.0)
        ranges[axis] = span.low + shift, span.high + shift
    proposal = Proposal(
        expression=text.expression,
        reads=text.reads,
        nrmse_after=after,
        probability=0.0,
        range=ranges,
        parameters=text.values,
        numbers=formula.price,
        laws=len(formula.products),
        resembles=_resembles(leftover, formula),
        curve=curve_of(leftover, formula),
    )
    price = formula.price + ODD_BELIEF * formula.oddity
    guessed = begun_before(leftover, formula) or any(row.guessed(leftover.spans) for row in formula.products)
    torque = leftover.left - formula.left
    held_out = stretch(leftover, formula, floor)
    told = frozenset(map(channel_of, axes_of(formula)))
    form = sorted(sorted((f.kind.name, family(f.axis)) for f in product.factors) for product in formula.products)
    return Priced(proposal, price, leaps(leftover, formula), held_out, guessed, told, form, torque)


def _after(leftover: Leftover, expression: str) -> float:
    """Held-out error with a formula, over the rms of the torque; infinite where it cannot be fitted."""
    problem = leftover.problem
    state = problem.state
    try:
        larger = leftover.model.with_effect(ModelEffect(NAME, {}, expression))
        return fit_terms(problem, terms_of(larger, problem)).rmse / problem.rms
    except (ModelError, np.linalg.LinAlgError):
        return math.inf
    finally:
        problem.restore(state)


def _resembles(leftover: Leftover, formula: Formula) -> str:
    """The effect of the catalogue that makes most of the formula's torque; empty where none makes much."""
    torque = leftover.left - formula.left
    power = max(float(torque @ torque), 1e-300)
    shares = {name: float(np.sum((basis.T @ torque) ** 2)) / power for name, basis in leftover.catalogued.items()}
    best = max(shares, key=lambda name: shares[name], default="")
    return best if shares.get(best, 0.0) > RESEMBLES else ""


def _distinct(rows: Sequence[Priced], before: float) -> list[Priced]:
    """Each expression once, and only what takes a good part of the error, and no less than nothing on extremes."""
    best: dict[str, Priced] = {}
    for row in rows:
        if row.proposal.nrmse_after < LEAST_GAIN * before and row.stretch.without < 1.0:
            best.setdefault(row.proposal.expression, row)
    return list(best.values())


def _believed(rows: Sequence[Priced], before: float, floor: float) -> tuple[Proposal, ...]:
    """With their probabilities, best first: by what they leave where the extremes are held out."""
    if not rows:
        return ()
    levels = np.array([max(row.proposal.nrmse_after / floor, 1.0) for row in rows])
    held_out = levels * np.array([row.stretch.level for row in rows])
    prices = np.array([row.price for row in rows])
    weights = (held_out.min() / held_out) ** SHARPNESS * np.exp(-PRICE * (prices - prices.min()))
    weights /= weights.sum()
    told = _told_once(rows, np.argsort(-weights, kind="stable").tolist(), weights)
    first = next(iter(told))
    best, row = float(levels[first]), rows[first]
    share = best * floor / before
    near = best < EXACT_FLOORS or (row.leaps and (best < NEAR_FLOORS or share < NEAR_SHARE))
    belief = (1 - share**2) / (1 + 0.02 * (best - 1)) * min(_most(best, near), ROUGH_BELIEF if row.astray else 1.0)
    return tuple(replace(rows[i].proposal, probability=belief * weight) for i, weight in told.items())


def _told_once(rows: Sequence[Priced], order: Sequence[int], weights: Array) -> dict[int, float]:
    """The rows that say something new, in their order, each with the weight of all that say the same: of these that of
    the fewest numbers among those that leave as little as the first."""
    told: dict[int, list[int]] = {}
    for i in order:
        told.setdefault(next((j for j in told if rows[j].says_what(rows[i])), i), []).append(i)
    said = {_plainest(rows, same): float(weights[same].sum()) for same in told.values()}
    return dict(sorted(said.items(), key=lambda row: -row[1]))


def _plainest(rows: Sequence[Priced], same: Sequence[int]) -> int:
    """Of rows that say the same, best first, that of the fewest numbers that does as well as the first."""
    most = LITTLE_MORE * rows[same[0]].proposal.nrmse_after
    alike = (i for i in same if rows[i].proposal.nrmse_after < most and rows[i].astray <= rows[same[0]].astray)
    return min(alike, key=lambda i: rows[i].price)


def _most(level: float, near: bool) -> float:
    """Most that is believed of a formula that leaves so many noise floors."""
    if near:
        return 1.0 if level < NEAR_FLOORS else ROUGH_BELIEF
    return PART_BELIEF
