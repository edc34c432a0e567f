"""How formulas are weighed against each other."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.discover.extremes import HeldOutExtremes
from edge_daemon.discover.weighing import Priced, believed_of
from edge_daemon.explain.results import Proposal

TORQUE_NM = np.sin(np.arange(100.0))


def row(expression: str, nrmse: float, price: float, torque: float = 1.0, extremes: float = 1.0) -> Priced:
    """A formula of the speed that leaves so much, makes so many times the torque, and errs so on extremes."""
    proposal = Proposal(expression, "", nrmse, 0.0, {})
    held_out = HeldOutExtremes(extremes, 0.1)
    return Priced(proposal, price, False, held_out, False, frozenset({"v"}), expression, torque * TORQUE_NM)


def test_of_formulas_that_say_the_same_the_shortest_is_told_with_the_belief_of_all() -> None:
    capped, square = row("a*minimum(abs(v)/5, 1)**2", 0.01, 8.0), row("a*v**2", 0.01, 6.0, extremes=1.5)
    alone = believed_of([capped], 1.0, 0.01)[0]
    told = believed_of([capped, square], 1.0, 0.01)
    assert [found.expression for found in told] == ["a*v**2"]
    assert told[0].probability == pytest.approx(alone.probability)


def test_a_shorter_formula_that_leaves_more_is_not_told_instead() -> None:
    told = believed_of([row("a*minimum(abs(v)/5, 1)**2", 0.01, 8.0), row("a*v**2", 0.012, 6.0)], 1.0, 0.01)
    assert told[0].expression == "a*minimum(abs(v)/5, 1)**2"


def test_formulas_that_differ_are_told_apart() -> None:
    told = believed_of([row("a*v**2", 0.01, 6.0), row("a*v**3", 0.01, 6.0, torque=0.5)], 1.0, 0.01)
    assert [found.expression for found in told] == ["a*v**2", "a*v**3"]
    assert told[0].probability == pytest.approx(told[1].probability)
