"""Ranges of a spring that a motion may not come to, against the integral of what lies behind a corner."""

import math

import numpy as np
import pytest

from edge_daemon.effects.model import FittedParameter, Model, ModelEffect
from edge_daemon.motion.reach import Reach
from edge_daemon.motion.regressors import Regressors

CORNERS = {"corner_1": 1e-4, "corner_gap": 2e-4}
RISE_1, RISE_2, GAP = (("piecewise_stiffness", name) for name in ("rise_1", "rise_2", "corner_gap"))


def factors(farthest_rad, gap_doubt, rise_2=0.0, gap_sd=0.7):
    """Factors on the deviations of both rises, with the second corner at 0.3 mrad."""
    spring = ModelEffect("piecewise_stiffness", {name: FittedParameter(value) for name, value in CORNERS.items()})
    regressors = Regressors(Model("torsion", 100.0, 0.05, (ModelEffect("linear_stiffness"), spring)))
    doubt = {("piecewise_stiffness", "corner_1"): 1e-3, GAP: gap_doubt}
    reach = Reach(regressors, doubt)
    reach.follow(np.linspace(-farthest_rad, 0.3 * farthest_rad, 50), 0.3)
    value, sd = np.zeros(len(regressors.keys)), np.full(len(regressors.keys), 1e3)
    value[regressors.index(*RISE_1)], value[regressors.index(*RISE_2)] = 5e4, rise_2
    sd[regressors.shaping] = 1e-3, gap_sd
    found = reach.wider(value, sd)
    return found[regressors.index(*RISE_1)], found[regressors.index(*RISE_2)]


def test_a_range_behind_a_corner_in_doubt_is_told_by_what_surely_lies_in_it():
    """The mean square of the twist beyond a corner c, on the way to f, goes with (f - c)^3."""
    first, second = factors(6e-4, 0.2)
    assert second == pytest.approx(((6e-4 - 3e-4) / (6e-4 - 1e-4 - 2e-4 * math.exp(0.2))) ** 1.5, rel=0.03)
    assert first == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("gap_doubt", "reached"), [(0.7, False), (0.01, True)])
def test_a_range_that_the_motion_may_not_come_to_is_not_told(gap_doubt, reached):
    first, second = factors(3.5e-4, gap_doubt)
    assert math.isfinite(second) is reached and first == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("rise_2", "told"), [(2e3, False), (2e4, True)])
def test_what_was_learned_of_a_corner_counts_where_the_range_behind_it_is_seen(rise_2, told):
    """A range that may be no other than the one before says nothing of the corner between them."""
    assert math.isfinite(factors(3.5e-4, 0.7, rise_2, gap_sd=0.01)[1]) is told


def test_a_range_that_lies_beyond_the_motion_is_not_told_however_sure_its_corner_is():
    """Its column is nothing at all, and the number of a fit that had gone astray, -9e11 +- 700, was called valid."""
    first, second = factors(2.5e-4, 0.01)
    assert not math.isfinite(second) and first == pytest.approx(1.0, abs=0.01)
