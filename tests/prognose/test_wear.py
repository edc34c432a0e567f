"""Curves of wear: their closed form against the equation they solve, and the integral over size against quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from edge_daemon.prognose.wear import FEEDBACKS, LOG_RISES, SHAPES, Belief, curves_of, weigh
from edge_daemon.usage.evidence import TrendEvidence

USED = np.linspace(0.0125, 0.9875, 40)
LEFT = np.array([0.2, 1.0, 5.0])


def trend(loss: float, sd: float, relative: bool) -> TrendEvidence:
    """A trend that ends at twice its age by D^2 without feedback, seen with white noise and its level as given."""
    rng = np.random.default_rng(4)
    y = loss * (USED / 2.0) ** 2 + sd * rng.normal(size=USED.size)
    return TrendEvidence(np.arange(USED.size), y, np.eye(USED.size) / sd, relative)


def test_the_curve_solves_its_equation() -> None:
    """dD/dz = c e^(f D) with D(1) = 1, integrated here by small steps, to the power p."""
    white = TrendEvidence(np.arange(USED.size), np.ones(USED.size), np.eye(USED.size), False)
    curves = curves_of(white, USED, np.zeros(1))
    for shape in (3, 47, 96, 120):
        feedback, power = SHAPES[shape][0], np.exp(SHAPES[shape][1])
        z = np.linspace(0.0, 1.0, 20001)
        # dz/dD ~ e^(-f D) by quadrature over D, then turned around
        damage = z
        clock = np.concatenate(([0.0], np.cumsum(np.exp(-feedback * (damage[1:] + damage[:-1]) / 2))))
        expected = np.interp(USED, clock / clock[-1], damage) ** power
        assert curves.dot[0, shape] == pytest.approx(np.sum(expected), rel=1e-4)
        assert curves.precision[0, shape] == pytest.approx(np.sum(expected**2), rel=1e-4)


@pytest.mark.parametrize(("loss", "sd"), [(0.2, 0.002), (0.2, 0.05), (0.0, 0.01)])
def test_the_size_is_integrated_out(loss: float, sd: float) -> None:
    """Evidence and mean log size of single curves against quadrature over the lognormal prior."""
    belief = Belief(np.array([0.0, 0.7, np.log(0.2)]), np.diag([1.0, 0.3**2, 0.5**2]))
    curves = curves_of(trend(loss, sd, False), USED, LEFT)
    weights = weigh(curves, belief)
    shapes = [i for i in range(len(SHAPES)) if abs(SHAPES[i][0]) < 0.1 and 0.3 < SHAPES[i][1] < 1.1]
    assert shapes
    for end in range(LEFT.size):
        for one in shapes:
            dot, precision = curves.dot[end, one], curves.precision[end, one]

            def density(u: float, dot: float = dot, precision: float = precision) -> float:
                fit = dot * np.exp(u) - 0.5 * precision * np.exp(2 * u)
                return float(np.exp(fit - dot**2 / (2 * precision) - 0.5 * ((u - np.log(0.2)) / 0.5) ** 2))

            peak = float(weights.log_size[end, one])
            exact = quad(density, peak - 4.0, peak + 4.0, points=[peak], limit=200)[0] / (np.sqrt(2 * np.pi) * 0.5)
            shape_weight = np.exp(-0.5 * (SHAPES[:, 0] ** 2 + ((SHAPES[:, 1] - 0.7) / 0.3) ** 2))
            log_shape = np.log(shape_weight[one] / shape_weight.sum())
            told = weights.log[end, one] - log_shape - curves.constant - dot**2 / (2 * precision)
            assert told == pytest.approx(np.log(exact), abs=0.1)


def test_a_trend_told_by_its_mean_gives_the_loss_since_new() -> None:
    """k = k0 (1 - a F): relative to its mean, the fitted size is a, not a over the mean."""
    course = 1.0 - 0.3 * (USED / 2.0) ** 2
    y = -(course / course.mean() - 1.0)
    level = np.eye(USED.size) - 1.0 / USED.size
    curves = curves_of(TrendEvidence(np.arange(USED.size), y, level / 1e-4, True), USED, np.ones(1))
    straight = int(np.argmin(np.abs(FEEDBACKS))) * len(LOG_RISES) + int(np.argmin(np.abs(LOG_RISES - np.log(2.0))))
    belief = Belief(np.array([0.0, np.log(2.0), np.log(0.2)]), np.diag([1.0, 1.0, 1.0]))
    found = float(np.exp(weigh(curves, belief).log_size[0, straight]))
    # the grid's nearest power is not 2: the size differs as far as the curve does
    power = np.exp(SHAPES[straight][1])
    expected = 0.3 * np.ptp((USED / 2.0) ** 2) / np.ptp((USED / 2.0) ** power)
    assert found == pytest.approx(expected, rel=0.05)


def test_what_explains_a_trend_otherwise_is_not_taken_for_wear() -> None:
    """A course that may add itself freely takes the evidence for its own shape away."""
    told = trend(0.2, 0.002, False)
    other = (USED / 2.0) ** 2
    apart, joined = curves_of(told, USED, LEFT), curves_of(told, USED, LEFT, other, 100.0)
    belief = Belief(np.array([0.0, 0.7, np.log(0.2)]), np.diag([1.0, 0.3**2, 0.5**2]))
    gained = [float(np.max(weigh(curves, belief).ends()) - curves.constant) for curves in (apart, joined)]
    assert gained[0] > 1000.0
    assert gained[1] < 5.0
