"""Learning from failed gears: truth drawn by the articles' law, integrated here step by step."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.prognose.forecast import BROAD, Prior
from edge_daemon.prognose.gears import find_gear
from edge_daemon.prognose.learn import (
    FailedGear,
    LearnError,
    learn_law,
    learn_prior,
    prior_from_bytes,
    prior_to_bytes,
)

GEAR = find_gear("CSG-20-100")


def fail(rng: np.random.Generator, log_C: float, m: float, gamma: float, scatter: float) -> FailedGear:
    """An hourly life at a load of its own; stiffness falls with D^1.5 by a fifth.

    dD/dt = r(t) / (1 - gamma 0.2 D^1.5)^m is separable: the clock sum(r) is a tabled function of D.
    """
    t = np.arange(1.0, 60_001.0)
    torque = rng.uniform(0.8, 1.5) * 52.0 * np.exp(0.15 * rng.normal(size=t.size))
    speed = rng.uniform(1000.0, 2000.0)
    clock = np.cumsum(120.0 * speed * np.exp(log_C + scatter * rng.normal()) * (torque / 800.0) ** m)
    steps = np.linspace(0.0, 1.0, 2001)
    slowness = (1 - gamma * 0.2 * steps**1.5) ** m
    table = np.concatenate(([0.0], np.cumsum(0.5 * (slowness[1:] + slowness[:-1]) * np.diff(steps))))
    damage = np.interp(clock, table, steps)
    rows = int(np.searchsorted(clock, table[-1])) + 1
    failed = rows <= t.size
    stiffness = 1.6e4 * (1 - 0.2 * damage[:rows] ** 1.5) * (1 + 0.01 * rng.normal(size=min(rows, t.size)))
    columns = {
        "torque_cubic_mean_Nm": torque[:rows],
        "speed_in_rpm": np.full(min(rows, t.size), speed),
        "stiffness_Nm_per_rad": stiffness,
    }
    return FailedGear(t[:rows], columns, failed)


def test_learned_law_holds_the_truth_in_its_intervals() -> None:
    """Ten fleets: a 90 % interval misses now and then, but not often (binomial: 7 or fewer of 10 in 7 % of tests)."""
    held = dict.fromkeys(("m", "gamma", "log_C", "scatter"), 0)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        truth = {"m": rng.uniform(5, 10), "gamma": rng.uniform(0.5, 2.0), "scatter": 0.3}
        truth["log_C"] = -np.log(5000 * 120 * 1500) - truth["m"] * np.log(60 / 800)
        lives = [fail(rng, truth["log_C"], truth["m"], truth["gamma"], 0.3) for _ in range(25)]
        law = learn_law(GEAR, lives)
        for name in held:
            low, high = law.interval(name)
            held[name] += low <= truth[name] <= high
    assert min(held.values()) >= 7, held


def test_learned_exponent_is_sharp() -> None:
    rng = np.random.default_rng(42)
    law = learn_law(
        GEAR, [fail(rng, -np.log(5000 * 120 * 1500) - 8 * np.log(60 / 800), 8.0, 1.0, 0.3) for _ in range(30)]
    )
    low, high = law.interval("m")
    assert high - low < 2.5
    assert law.quantile("m", 0.5) == pytest.approx(8.0, abs=1.2)


def test_learned_prior_finds_the_loss_at_failure() -> None:
    rng = np.random.default_rng(3)
    log_C = -np.log(5000 * 120 * 1500) - 8 * np.log(60 / 800)
    lives = [fail(rng, log_C, 8.0, 1.0, 0.3) for _ in range(6)]
    prior = learn_prior(GEAR, lives, rounds=4)
    learned, before = prior.kinds[0].stiffness, BROAD.kinds[0].stiffness
    assert np.exp(learned.mean[2]) == pytest.approx(0.2, rel=0.12)
    assert learned.cover[2, 2] < 0.25 * before.cover[2, 2]


def test_too_few_failures_are_refused() -> None:
    rng = np.random.default_rng(1)
    lives = [fail(rng, -50.0, 8.0, 1.0, 0.3) for _ in range(6)]
    assert not any(life.failed for life in lives)
    for learn in (learn_law, learn_prior):
        with pytest.raises(LearnError, match="0 failed gears: expected at least 5"):
            learn(GEAR, lives)


def test_a_prior_survives_a_file() -> None:
    prior = Prior(BROAD.kinds, 0.03)
    again = prior_from_bytes(prior_to_bytes(prior))
    for one, other in (
        (again.kinds[0].stiffness, prior.kinds[0].stiffness),
        (again.kinds[0].noise, prior.kinds[0].noise),
    ):
        np.testing.assert_array_equal(one.mean, other.mean)
        np.testing.assert_array_equal(one.cover, other.cover)
    assert (again.kinds[0].fatigue, again.kinds[0].alone, again.doubt) == (prior.kinds[0].fatigue, 0.5, 0.03)
    saved = prior_to_bytes(prior)
    for broken in (b"", b"{}", saved.replace(b"log_size", b"other"), saved.replace(b"[[4.0", b"[[-4.0")):
        with pytest.raises(LearnError, match="learned prior"):
            prior_from_bytes(broken)
