"""Formulas for what a model leaves: found, fitted with the model as `add` would, and ranked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edge_daemon.discover.leftover import Leftover, Misread
from edge_daemon.discover.refining import Formula, directed
from edge_daemon.discover.search import EXACT_FLOORS, MOST_PRODUCTS, FormulaSearch
from edge_daemon.discover.sticking import sticking
from edge_daemon.discover.table import best_table, in_words
from edge_daemon.discover.weighing import (
    LEAST_GAIN,
    NAME,
    NEAR_FLOORS,
    NEAR_SHARE,
    PART_BELIEF,
    Priced,
    believed_of,
    distinct,
    error_with,
    priced,
)
from edge_daemon.discover.writing import plainer, rounded, whole, with_constant, written
from edge_daemon.effects.expression import parse
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.effects.torque_source import OUTPUT_FRICTION
from edge_daemon.explain.results import Proposal
from edge_daemon.identify.fit import fit_terms, floor_of
from edge_daemon.identify.problem import problem_of, terms_of, unit_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import STIFFNESS
from edge_daemon.records import Recorded
from edge_daemon.search.hypotheses import LEAST_FLOOR, Progress

REFITTED, NEAR_BEST = 4, 1.3
"""Formulas that are fitted with the model as `add` would, and their error over the best one's up to which one is: none
beyond would be believed to a twentieth."""
CHOICES = 500.0
"""Factors among which each of a formula's is chosen: kinds, axes and where their numbers are looked for first; 490 of
them with one encoder, 589 with two, and eight half turns."""
UNTOLD = 1.5
"""Held-out error of the best formulas over what one leaves from which on they also tell of what happened once, which no
other block foretells: then those of one product are told as well (guess: else it is 1.0 to 1.1)."""
TWINS = 2
"""Formulas of which it is asked whether the data tell a friction from a load."""
NOWHERE_NEAR, NO_BETTER = 2.0, 0.9
"""Error of a friction in the loop, over one that is near the noise and over that of the friction before, from which on
no other is tried (guesses: of what was no friction all left 3 to 4 times as much as that, and within a tenth the same).
"""
TABLE_BELIEF = 0.2
"""Most that is believed of a table: it is a curve, and the law behind it may depend on more (guess)."""
MISREAD_GAIN = 0.7
"""Error of the best formula of what an encoder misreads over that of a torque up to which it is told (guess)."""


LEAST_STICKING = 0.1
"""Share of the leftover's square that friction of the output takes, for it to be taken for one that sticks (guess)."""


class Rival(NamedTuple):
    """What the catalogue comes to."""

    nrmse: float = math.inf
    """error over the torque, infinite where it names nothing"""
    products: int = MOST_PRODUCTS
    """summands of a formula that would be told beside it"""
    far: float | None = None
    """error over the torque beyond which the best product is not gone on with; as a search has it where none is said"""


NOTHING_NAMED = Rival()


def proposals(
    recordings: Sequence[Recorded], model: Model, progress: Progress, rival: Rival = NOTHING_NAMED
) -> tuple[Proposal, ...]:
    """Formulas for what the model leaves, best first, whatever the catalogue says; none where all are far behind the
    `rival`."""
    leftovers = [_at_reversals(_leftover(problem_of(recordings, model), model), recordings)]
    if any(leftovers[0].problem.late_s):
        leftovers.append(_leftover(problem_of(recordings, model, as_read=True), model))
    leftover, search = _begun(leftovers, progress, rival)
    if (later := _later(search, recordings)) is not None:
        leftover, search = min((leftover, search), _begun([later], progress, rival), key=lambda row: row[1].first)
    found = _proposed(search)
    if (found and found[0].probability > PART_BELIEF) or (not found and rival.nrmse < math.inf):
        return found
    return (*found, *_table(leftover, min((row.nrmse_after for row in found), default=math.inf)))


def _begun(leftovers: list[Leftover], progress: Progress, rival: Rival) -> tuple[Leftover, FormulaSearch]:
    """What is searched of several readings of the same: what is missing may have looked late, and does better as it was
    read from its first product on."""
    leftovers.sort(key=lambda row: row.base.rmse)
    noise = min(_floor(row) / row.problem.rms for row in leftovers)
    tries = []
    for row in leftovers:
        rms, beside = row.problem.rms, row.beside_a_constant()
        far = None if rival.far is None else rival.far * rms
        tries.append((row, FormulaSearch(beside, _floor(row), progress, rival.nrmse * rms, rival.products, far)))
        if row.model.balance == "drive":
            tries[-1][1].begin()
        if tries[-1][1].first < EXACT_FLOORS * noise * row.problem.rms:
            break
    return min(tries, key=lambda row: row[1].first)


def _later(search: FormulaSearch, recordings: Sequence[Recorded]) -> Leftover | None:
    """What a drive's model leaves where its torque is late beside the best product: what was missing had hidden that.
    None where it is not, or where that product leaves but noise."""
    problem, model = search.leftover.problem, search.leftover.model
    if model.balance != "drive" or not search.found or search.first < EXACT_FLOORS * search.floor:
        return None
    best = with_constant(search.leftover, search.best(1)[0], search.floor)
    text = written(search.leftover, best, unit_of(model, problem.trials[0].motion.extra))
    terms = terms_of(model.with_effect(ModelEffect(NAME, {}, text.expression)), problem)
    again = problem_of(recordings, model, (terms,))
    return None if again.late_s == problem.late_s else _leftover(again, model)


def _leftover(problem: RegressionProblem, model: Model) -> Leftover:
    """What a model leaves of one problem."""
    return Leftover(problem, fit_terms(problem, terms_of(model, problem)), model)


def _at_reversals(leftover: Leftover, recordings: Sequence[Recorded]) -> Leftover:
    """A leftover without what nothing tells where the output turns round, if dry friction of that is a good part of it:
    whatever that is multiplied by, it sticks there."""
    model, taken = leftover.model, leftover.catalogued.get(OUTPUT_FRICTION)
    if model.balance != "torsion" or taken is None:
        return leftover
    if float(np.sum((taken.T @ leftover.left) ** 2)) < LEAST_STICKING * leftover.square:
        return leftover
    return _leftover(problem_of(recordings, model.with_effect(ModelEffect(OUTPUT_FRICTION))), model)


def _floor(leftover: Leftover) -> float:
    """rms that sensor noise leaves."""
    return max(floor_of(leftover.problem, leftover.model, leftover.base), LEAST_FLOOR)


def _proposed(search: FormulaSearch) -> tuple[Proposal, ...]:
    """Formulas for what a model leaves."""
    leftover, floor = search.leftover, search.floor
    rms = leftover.problem.rms
    before, least = leftover.base.rmse / rms, floor / rms
    near = max(NEAR_FLOORS * least, NEAR_SHARE * before)
    rows = _stuck(search, near)
    if not any(row.proposal.nrmse_after < near for row in rows):
        rows += _searched(search)
    least = min([least, *(row.proposal.nrmse_after for row in rows)])  # no noise is more than a formula leaves
    return believed_of(distinct(rows, before), before, least)


def _stuck(search: FormulaSearch, near: float) -> list[Priced]:
    """Of dry friction of the twist, which is simulated; none where there is no such friction, and no further one where
    one comes nowhere near the noise in the loop and no nearer than that before, whatever it left of the measured
    twist."""
    simulated, floor = sticking(search.leftover), search.floor
    if simulated is None:
        return []
    found = _near(FormulaSearch(simulated, floor, search.progress).around(simulated.product), simulated, floor)
    waves = [any(product.waves for product in formula.products) for formula in found]
    shorter = [(rounded if wave else plainer)(simulated, f, floor) for f, wave in zip(found, waves, strict=True)]
    rows: list[Priced] = []
    for formula in shorter:
        rows += _told(simulated, [formula], floor)
        left = [row.proposal.nrmse_after for row in rows[-2:]]
        if len(left) > 1 and left[1] > max(NOWHERE_NEAR * near, NO_BETTER * left[0]):
            break
    return rows


def _searched(search: FormulaSearch) -> list[Priced]:
    """Of everything else."""
    leftover, floor = search.leftover, search.floor
    every = search.run()
    if every and not search.reached and leftover.model.balance == "torsion" and STIFFNESS[0] in leftover.base.names:
        misread = FormulaSearch(Misread(leftover.alone or leftover).beside_a_constant(), floor, search.progress)
        errors = misread.taken_over(every)
        if errors and misread.level(errors[0]) < MISREAD_GAIN * search.level(every[0]):
            return _priced(misread.leftover, _near(errors, misread.leftover, floor), floor)
    rows = _priced(leftover, _near(every, leftover, floor), floor)
    left = min((math.sqrt(f.square / len(f.left)) for f in every), default=math.inf) / leftover.problem.rms
    if rows and min(row.proposal.nrmse_after for row in rows) > UNTOLD * left:
        rows += _priced(leftover, _near([f for f in every if len(f.products) == 1], leftover, floor), floor)
    return rows


def _priced(leftover: Leftover, found: Sequence[Formula], floor: float) -> list[Priced]:
    """Formulas, and the first of them as friction, fitted with the model; with a constant that the data ask for."""
    floor = min([floor, *(math.sqrt(row.square / len(row.left)) for row in found)])  # no noise is more than one leaves
    found = [with_constant(leftover, formula, floor) for formula in found] if leftover.alone else found
    leftover = leftover.alone or leftover
    formulas = [plainer(leftover, formula, floor) for formula in found]
    formulas += [other for formula in formulas if (other := whole(leftover, formula)) is not None]
    twins = [directed(leftover, formula, floor) for formula in formulas[:TWINS]]
    return _told(leftover, [*formulas, *(rounded(leftover, twin, floor) for twin in twins if twin is not None)], floor)


def _told(leftover: Leftover, formulas: Sequence[Formula], floor: float) -> list[Priced]:
    """Each formula once."""
    once = {_said(formula): formula for formula in reversed(formulas)}
    return [priced(leftover, once[key], floor) for key in reversed(once)]


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
    after, before = error_with(leftover, expression), leftover.base.rmse / leftover.problem.rms
    if after > min(reached, LEAST_GAIN * before):
        return []
    stations, seen = len(parse(expression, leftover.names).amplitudes), {axis: leftover.seen(axis)}
    return [Proposal(expression, in_words(axis), after, TABLE_BELIEF * share, seen, numbers=stations)]
