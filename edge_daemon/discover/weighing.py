"""What a formula is worth: fitted with the model as `add` would, priced by its numbers, believed by what it leaves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.discover.curve import bent, curve_of
from edge_daemon.discover.extremes import HeldOutExtremes, stretch
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.memory import begun_before
from edge_daemon.discover.past_axes import channel_of, family
from edge_daemon.discover.refining import Formula, leaps
from edge_daemon.discover.search import EXACT_FLOORS
from edge_daemon.discover.writing import axes_of, set_off, written
from edge_daemon.effects.model import ModelEffect, ModelError
from edge_daemon.explain.results import Proposal
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.problem import terms_of, unit_of
from edge_daemon.records import Array

NAME = "law"
"""Name under which a formula is tried; the user gives it another."""
LEAST_GAIN = 0.75
"""Error after over before up to which a formula is worth telling (guess: curves of a fit to chance take a tenth)."""
NEAR_FLOORS, NEAR_SHARE = 3.0, 0.05
"""Error over the noise floor, or over that before, up to which a formula that leaps with the direction says all that
there is to say, a measured rate does not carry its reversals; any other does up to `EXACT_FLOORS`."""
ROUGH_BELIEF = 0.5
"""Most that is believed of a formula whose reversals leave more than three noise floors: what they leave hides other
shapes, and one in seven did not hold on another motion; and of one that goes astray on extremes, or that speaks of
places that were not seen."""
FORETOLD, FORETOLD_BELIEF = 1.15, 0.7
"""Error on extremes that a formula was not fitted to, over that of the formula fitted to all, up to which it foretold
them, and most that is then believed of a curve of places of which only these were seen (guesses)."""
CLEAR_SHARE, BENT, CLEAR_BELIEF = 0.3, 0.05, 0.7
"""Share of the error up to which a formula may leave dirt and not a part of its law, where a curve of any shape takes
no more of that than by chance and this share of its square; and most that is then believed (guesses: what was right
left up to 0.28 and 0.01, what imitated it 0.03 and 0.19)."""
PART_BELIEF = 0.4
"""Most that is believed of a formula that leaves more than that (guess)."""
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
LEAST_LEFT = 0.1
"""Error over the noise floor below which a formula took the place of the spring: noise is left by any law (guess)."""
BOUND = 1.3
"""Error of a formula beside the model's bounds over that without them above which it is tried set off (guess)."""


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
    bent: float
    """largest share of what it leaves that another shape of it takes"""

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


def priced(leftover: Leftover, formula: Formula, floor: float) -> Priced:
    """A formula fitted with the model as `add` would, and its price in numbers. Where that leaves more than the formula
    by itself, a number of the model is at its bound: then the formula set off from it is tried."""
    unit = unit_of(leftover.model, leftover.problem.trials[0].motion.extra)
    text = written(leftover, formula, unit)
    after = error_with(leftover, text.expression)
    alone = math.sqrt(formula.square / len(formula.left)) / leftover.problem.rms
    bound = not leftover.simulated and after > BOUND * max(alone, floor / leftover.problem.rms)
    for other in set_off(leftover, formula) if bound else ():
        further = written(leftover, other, unit)
        if (left := error_with(leftover, further.expression)) < after / BOUND:
            formula, text, after = other, further, left
    if after * leftover.problem.rms < LEAST_LEFT * floor:  # the simulated twist is what the torque is of
        after = math.inf
    proposal = Proposal(
        expression=text.expression,
        reads=text.reads,
        nrmse_after=after,
        probability=0.0,
        range={axis: leftover.seen(axis) for axis in axes_of(formula)},
        parameters=text.values,
        numbers=formula.price,
        laws=sum(bool(product.factors) for product in formula.products),
        resembles=_resembles(leftover, formula),
        curve=curve_of(leftover, formula),
    )
    price = formula.price + ODD_BELIEF * formula.oddity
    guessed = begun_before(leftover, formula) or any(row.guessed(leftover.spans) for row in formula.products)
    torque = leftover.left - formula.left
    told = frozenset(map(channel_of, axes_of(formula)))
    form = sorted(sorted((f.kind.name, family(f.axis)) for f in product.factors) for product in formula.products)
    held_out, other_shape = stretch(leftover, formula, floor), bent(leftover, formula)
    return Priced(proposal, price, leaps(leftover, formula), held_out, guessed, told, form, torque, other_shape)


def error_with(leftover: Leftover, expression: str) -> float:
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


def distinct(rows: Sequence[Priced], before: float) -> list[Priced]:
    """Each expression once, and only what takes a good part of the error, and no less than nothing on extremes."""
    best: dict[str, Priced] = {}
    for row in rows:
        if row.proposal.nrmse_after < LEAST_GAIN * before and row.stretch.without < 1.0:
            best.setdefault(row.proposal.expression, row)
    return list(best.values())


def believed_of(rows: Sequence[Priced], before: float, floor: float) -> tuple[Proposal, ...]:
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
    belief = (1 - share**2) / (1 + 0.02 * (best - 1)) * min(_most(row, best, share), _most_elsewhere(row))
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


def _most_elsewhere(row: Priced) -> float:
    """The same of one that may go wrong on another motion: more of a curve that foretold its extremes."""
    if not row.astray:
        return 1.0
    return FORETOLD_BELIEF if row.stretch.error < FORETOLD else ROUGH_BELIEF


def _most(row: Priced, level: float, share: float) -> float:
    """Most that is believed of a formula that leaves so many noise floors, and such a share of the error."""
    if level < (NEAR_FLOORS if row.leaps else EXACT_FLOORS):
        return 1.0
    if row.leaps:
        return ROUGH_BELIEF if share < NEAR_SHARE else PART_BELIEF
    return CLEAR_BELIEF if share < CLEAR_SHARE and row.bent < BENT else PART_BELIEF
