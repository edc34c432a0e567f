"""The posterior of a gear's end against the bearing's own law, gears with scatter, and its own bookkeeping."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.prognose.forecast import forecast
from edge_daemon.records import Array
from edge_daemon.usage.bearing import bearing_law
from edge_daemon.usage.evidence import Evidence, evidence_of
from edge_daemon.usage.gears import find_gear
from edge_daemon.usage.ledger import merge, rows_of

GEAR = find_gear("CSG-20-100")


def gear_worn(hours: int, life_h: float, loss: float, noise: float, rise: float, seed: int) -> Evidence:
    rng = np.random.default_rng(seed)
    t = np.arange(1.0, hours + 1.0)
    share = (t / life_h) ** rise
    columns = {
        "speed_in_rpm": np.full(t.size, 1500.0),
        "torque_cubic_mean_Nm": np.full(t.size, 55.0),
        "stiffness_Nm_per_rad": 1.6e4 * (1 - loss * share) * (1 + 0.01 * rng.normal(size=t.size)),
        "noise_a0": 1e-4 * np.exp(noise * share + 0.1 * rng.normal(size=t.size)),
    }
    return evidence_of(rows_of(GEAR, t, np.ones(t.size), columns))


def test_without_condition_it_is_the_bearings_weibull_law() -> None:
    t = np.arange(1.0, 5001.0)
    columns = {"speed_in_rpm": np.full(t.size, 2000.0), "torque_cubic_mean_Nm": np.full(t.size, 52.0)}
    future = forecast(GEAR, evidence_of(rows_of(GEAR, t, np.ones(t.size), columns)))
    for probability in (0.1, 0.5):
        expected = bearing_law(GEAR).remaining(5000.0, probability)
        assert future.quantile_h(probability) == pytest.approx(expected, rel=0.15)


def test_the_interval_covers_gears_with_scatter() -> None:
    """Twelve gears at half life, stiffness at failure and shape of their own: most lie inside 80 %."""
    rng = np.random.default_rng(6)
    inside = 0
    for i in range(12):
        loss, rise = 0.19 * rng.lognormal(0, 0.3), rng.uniform(1.4, 3.0)
        future = forecast(GEAR, gear_worn(6_000, 12_000, loss, 0.1, rise, i), particles=300)
        inside += future.quantile_h(0.1) <= 6_000 <= future.quantile_h(0.9)
    assert inside >= 8


def test_noise_that_grows_points_to_the_bearing() -> None:
    worn = forecast(GEAR, gear_worn(8_000, 9_000, 0.01, 1.3, 2.0, 1), particles=800)
    assert np.mean(worn.bearing_first) > 0.8
    assert worn.quantile_h(0.5) < 10_000
    soft = forecast(GEAR, gear_worn(8_000, 9_000, 0.2, 0.05, 2.0, 1), particles=800)
    assert np.mean(soft.bearing_first) < 0.2


def test_chance_of_failure_agrees_with_the_quantiles() -> None:
    future = forecast(GEAR, gear_worn(4_000, 8_000, 0.2, 0.1, 2.0, 3), particles=800)
    for probability in (0.1, 0.5, 0.9):
        assert future.failure_probability(future.quantile_h(probability)) == pytest.approx(probability, abs=0.01)


def test_another_seed_hardly_changes_the_answer() -> None:
    """The median of two ensembles differs by far less than the distribution is wide."""
    evidence = gear_worn(6_000, 12_000, 0.2, 0.1, 2.0, 3)
    medians = [forecast(GEAR, evidence, seed=seed, particles=600).quantile_h(0.5) for seed in range(3)]
    assert max(medians) / min(medians) < 1.1, medians


def test_seed_fixes_the_answer() -> None:
    evidence = gear_worn(2_000, 8_000, 0.2, 0.1, 2.0, 3)
    first, again = (forecast(GEAR, evidence, particles=300).remaining_h for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_no_load_is_told_as_a_long_life() -> None:
    t = np.arange(1.0, 101.0)
    still: dict[str, Array] = {"speed_in_rpm": np.zeros(100), "torque_cubic_mean_Nm": np.zeros(100)}
    left = forecast(GEAR, evidence_of(rows_of(GEAR, t, np.ones(100), still)), particles=300).remaining_h
    assert np.isfinite(left).all()
    assert left.min() > 1e5


def test_merging_rows_keeps_every_sum() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(1.0, 1001.0)
    columns = {
        "speed_in_rpm": rng.uniform(500, 2000, 1000),
        "torque_cubic_mean_Nm": rng.uniform(10, 80, 1000),
        "stiffness_Nm_per_rad": rng.uniform(1e4, 2e4, 1000),
    }
    rows = rows_of(GEAR, t, np.ones(1000), columns)
    few = merge(merge(rows, 300), 40)
    assert len(few) == 40
    for name in ("hours", "turns", "cubic_Nm3_h", "rated_h", "fatigue"):
        assert getattr(few, name).sum() == pytest.approx(getattr(rows, name).sum(), rel=1e-12)
    np.testing.assert_allclose(few.strain.sum(axis=1), rows.strain.sum(axis=1), rtol=1e-12)
    logs = np.log(columns["stiffness_Nm_per_rad"])
    total = np.sum(few.log_scatter[0] + few.count[0] * (few.log_mean[0] - logs.mean()) ** 2)
    assert total == pytest.approx(np.sum((logs - logs.mean()) ** 2), rel=1e-9)
