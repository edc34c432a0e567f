"""How formulas are weighed against each other."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.discover.extremes import HeldOutExtremes
from edge_daemon.discover.factors import KINDS, Factor, Product
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.refining import settled
from edge_daemon.discover.weighing import Priced, believed_of, priced
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.results import Proposal
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.problem import problem_of, terms_of

TORQUE_NM = np.sin(np.arange(100.0))


def row(
    expression: str, nrmse: float, price: float, torque: float = 1.0, extremes: float = 1.0, bent: float = 0.0
) -> Priced:
    """A formula of the speed that leaves so much, makes so many times the torque, errs so on extremes, and of whose
    square another shape takes such a share."""
    proposal = Proposal(expression, "", nrmse, 0.0, {})
    held_out = HeldOutExtremes(extremes, 0.1)
    return Priced(proposal, price, False, held_out, False, frozenset({"v"}), expression, torque * TORQUE_NM, bent)


def test_of_formulas_that_say_the_same_the_shortest_is_told_with_the_belief_of_all() -> None:
    capped, square = row("a*minimum(abs(v)/5, 1)**2", 0.01, 8.0), row("a*v**2", 0.01, 6.0, extremes=1.5)
    alone = believed_of([capped], 1.0, 0.01)[0]
    told = believed_of([capped, square], 1.0, 0.01)
    assert [found.expression for found in told] == ["a*v**2"]
    assert told[0].probability == pytest.approx(alone.probability)


def test_a_shorter_formula_that_leaves_more_is_not_told_instead() -> None:
    told = believed_of([row("a*minimum(abs(v)/5, 1)**2", 0.01, 8.0), row("a*v**2", 0.012, 6.0)], 1.0, 0.01)
    assert told[0].expression == "a*minimum(abs(v)/5, 1)**2"


@pytest.mark.parametrize(("nrmse", "before", "bent", "least", "most"), [
    (0.05, 0.3, 0.02, 0.6, 0.7), (0.05, 0.15, 0.02, 0.3, 0.4), (0.05, 0.3, 0.2, 0.3, 0.4), (0.01, 0.1, 0.2, 0.9, 1.0),
])  # fmt: skip
def test_a_formula_that_no_other_shape_betters_is_believed_beside_dirt(
    nrmse: float, before: float, bent: float, least: float, most: float
) -> None:
    """A stack of springs left 2.0 noise floors of 78, a load by the square of the wind 4.5 of 29: told at 0.39."""
    told = believed_of([row("a*exp(v)", nrmse, 3.0, bent=bent)], before, 0.01)
    assert least < told[0].probability <= most


def test_formulas_that_differ_are_told_apart() -> None:
    told = believed_of([row("a*v**2", 0.01, 6.0), row("a*v**3", 0.01, 6.0, torque=0.5)], 1.0, 0.01)
    assert [found.expression for found in told] == ["a*v**2", "a*v**3"]
    assert told[0].probability == pytest.approx(told[1].probability)


def test_a_formula_that_leaves_less_than_any_noise_is_none() -> None:
    """Beside a torque sensor one took the place of the spring: it was told at 1.00, with an error of nothing."""
    time_s, rng = np.arange(6000) / 500.0, np.random.default_rng(3)
    angle = 0.8 * np.sin(2.0 * time_s) + 0.2 * np.sin(5.1 * time_s)
    speed = 1.6 * np.cos(2.0 * time_s) + 1.02 * np.cos(5.1 * time_s)
    torque = -3.2 * np.sin(2.0 * time_s) - 5.2 * np.sin(5.1 * time_s) + 2.0 * speed
    columns = {"theta_out_rad": angle, "torque_in_Nm": (torque + rng.normal(0, 0.02, 6000)) / 100.0}
    model = Model("drive", 100.0, math.nan, (ModelEffect("inertia"),))
    problem = problem_of([SimpleNamespace(time_s=time_s, columns=columns)], model)
    leftover = Leftover(problem, fit_terms(problem, terms_of(model, problem)), model)
    formula = settled(leftover, [Product((Factor(KINDS["power_1"], "velocity_out_rad_s", ()),))], 3)
    assert formula is not None
    left = priced(leftover, formula, 1e-6).proposal.nrmse_after
    assert 0.0 < left < 0.01
    assert priced(leftover, formula, 5.0 * left * problem.rms).proposal.nrmse_after == pytest.approx(left)
    assert priced(leftover, formula, 20.0 * left * problem.rms).proposal.nrmse_after == math.inf
