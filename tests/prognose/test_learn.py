"""Learning from failed gears: truth drawn by the articles' law, integrated here step by step."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from edge_daemon.prognose import learn
from edge_daemon.prognose.courses import FEATURES, INDICATORS, Scales
from edge_daemon.prognose.experience import Experience, weighed
from edge_daemon.prognose.forecast import BROAD, MAKERS, Prior, foresee
from edge_daemon.prognose.history import LifeError, life_of_history
from edge_daemon.prognose.learn import (
    FailedGear,
    LearnError,
    learn_law,
    learn_life,
    prior_from_bytes,
    prior_to_bytes,
)
from edge_daemon.prognose.lives import Lives
from edge_daemon.usage.evidence import evidence_of
from edge_daemon.usage.gears import find_gear
from edge_daemon.usage.ledger import rows_of

pytestmark = pytest.mark.slow

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


def test_learned_prior_finds_the_loss_at_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learn, "MOST_WEIGHED", 2)
    rng = np.random.default_rng(3)
    log_C = -np.log(5000 * 120 * 1500) - 8 * np.log(60 / 800)
    lives = [fail(rng, log_C, 8.0, 1.0, 0.3) for _ in range(6)]
    prior = learn_life(GEAR, lives, rounds=4)
    learned, before = prior.kinds[0].stiffness, BROAD.kinds[0].stiffness
    assert np.exp(learned.mean[2]) == pytest.approx(0.2, rel=0.12)
    assert learned.cover[2, 2] < 0.25 * before.cover[2, 2]


def test_too_few_failures_are_refused() -> None:
    rng = np.random.default_rng(1)
    lives = [fail(rng, -50.0, 8.0, 1.0, 0.3) for _ in range(6)]
    assert not any(life.failed for life in lives)
    for teach in (learn_law, learn_life):
        with pytest.raises(LearnError, match="0 failed gears: expected at least 5"):
            teach(GEAR, lives)


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


def crack_or_bearing(rng: np.random.Generator) -> FailedGear:
    """A gear by no law of the product, every fifth hour until it fails by a crack or by its bearing.

    The crack grows by Paris' law (da/dt ~ a^1.5, closed form) and costs stiffness late; the bearing is quiet until a
    first pit, and then louder by its area.
    """
    load, speed = rng.lognormal(-0.1, 0.1), rng.uniform(1000.0, 1800.0)
    crack_h = 14_000.0 * load**-3 * rng.lognormal(0.0, 0.25)
    pit_h = 9_000.0 * load**-3 * rng.lognormal(0.0, 0.3)
    bearing_h = pit_h + 0.6 * pit_h * rng.lognormal(0.0, 0.1)
    t = np.arange(5.0, min(crack_h, bearing_h), 5.0)
    crack = (0.06**-0.5 - (0.06**-0.5 - 1.0) * t / crack_h) ** -2
    pit = np.clip((t - pit_h) / (bearing_h - pit_h), 0.0, 1.0)
    heat = 35.0 + 4.0 * np.sin(t / 24.0 * 2.0 * np.pi) + rng.normal(size=t.size)
    stiffness = 1.6e4 * rng.lognormal(0.0, 0.03) * (1.0 - 0.22 * crack) * (1.0 - 4e-4 * (heat - 25.0))
    columns = {
        "speed_in_rpm": speed * np.exp(0.05 * rng.normal(size=t.size)),
        "torque_cubic_mean_Nm": 52.0 * load * np.exp(0.1 * rng.normal(size=t.size)),
        "temperature_degC": heat,
        "stiffness_Nm_per_rad": stiffness * (1.0 + 0.01 * rng.normal(size=t.size)),
    }
    for beta in range(5):
        told = 0.2 * crack + 1.5 * pit**1.3 + 0.1 * rng.normal(size=t.size)
        columns[f"noise_a{beta}"] = 1e-3 * rng.lognormal(0.0, 0.3) * np.exp(told)
    return FailedGear(t, columns)


def until(life: FailedGear, share: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    rows = int(share * life.time_h.size)
    return life.time_h[:rows], {name: values[:rows] for name, values in life.columns.items()}


def test_gears_that_fail_by_another_law_teach(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fifteen failed gears: at 70 % of life most forecasts are within 20 %, and the interval holds its promise."""
    monkeypatch.setattr(learn, "MOST_WEIGHED", 3)
    rng = np.random.default_rng(15)
    prior = prior_from_bytes(prior_to_bytes(learn_life(GEAR, [crack_or_bearing(rng) for _ in range(15)], rounds=2)))
    assert prior.experience is not None and sum(prior.experience.weights[:2]) >= 0.5
    near = inside = months = 0
    gears = [crack_or_bearing(rng) for _ in range(20)]
    hardly = replace(prior, experience=replace(prior.experience, stages=((0.9996, *[1e-4] * 4),) * 4))
    ledger = rows_of(GEAR, gears[0].time_h, np.full(gears[0].time_h.size, 5.0), gears[0].columns)
    assert foresee(GEAR, ledger, evidence_of(ledger), hardly).remaining_h.size > 1900
    for life in gears:
        told = life_of_history(*until(life, 0.7), GEAR, prior=prior)
        truth = life.time_h[-1] - told.time_h
        near += abs(told.p50_h - truth) <= 0.2 * truth
        inside += told.p10_h <= truth <= told.p90_h
        (why,) = (reason for reason in told.reasons if "it is most like" in reason)
        assert "courses" in why or "growth" in why
        assert not re.search(r"\b0%", why)
        if "a month more" in why:
            now, later = (float(number) for number in re.findall(r"from (\d+) to (\d+) h", why)[0])
            assert later < now
            months += 1
    assert near >= 14, near
    assert months >= 5
    assert 13 <= inside <= 19, inside
    with pytest.raises(LifeError, match="learned from gears of CSG-20-100"):
        life_of_history(*until(gears[0], 0.5), find_gear("CSG-25-100"), prior=prior)


LEVELS = (np.arange(24) + 0.5) / 24


def told(rng: np.random.Generator, gears: int, claimed_sd: float) -> Experience:
    """Courses that tell nothing, and a law that errs by half of a logarithm and claims to err by `claimed_sd`."""
    rows = np.arange(16 * gears)
    x = rng.normal(size=(rows.size, len(FEATURES)))
    scales = Scales(3.0, 1.0, np.full(5, 0.2), np.ones(len(INDICATORS)), np.ones(len(INDICATORS)))
    left_h, group = np.exp(rng.normal(7.0, 3.0, rows.size)), rows // 16
    known = np.ones((gears, len(INDICATORS)), dtype=bool)
    names = tuple(str(i) for i in range(gears))
    told = (x, np.log(left_h), np.zeros(rows.size), left_h, group, known, Lives(0, [0.0] * gears))
    past = Experience("any", names, scales, *told)
    looked_at = rows[5::8].tolist()
    errs = rng.normal(0.0, 0.5, len(looked_at))
    law = [left_h[row] * np.exp(off + claimed_sd * norm.ppf(LEVELS)) for row, off in zip(looked_at, errs, strict=True)]
    nothing = [np.exp(20.0 + norm.ppf(LEVELS))] * len(law)
    return weighed(past, (nothing, nothing, law, nothing), looked_at, LEVELS)


def test_intervals_are_as_wide_as_gears_left_out_ask() -> None:
    """A law that claims a third of its error is widened, the more gears show it the further; an honest one is not, and
    drawn together a little as long as few gears tell that it stands alone."""
    rng = np.random.default_rng(4)
    bold, honest = (np.mean([told(rng, 15, sd).spread for _ in range(5)]) for sd in (0.5 / 3.0, 0.5))
    assert 1.8 < bold < 3.0
    assert 0.8 < honest < 1.3
    few, many = (np.mean([told(rng, gears, 0.5 / 3.0).spread for _ in range(5)]) for gears in (5, 30))
    assert 1.2 < few < many < 3.5
    assert 0.65 < np.mean([told(rng, 5, 0.5).spread for _ in range(5)]) < 1.3
    assert told(rng, 15, 0.5).weights[3] > 0.6


def shares(rng: np.random.Generator, gears: int) -> tuple[float, ...]:
    """Weights of members where courses tell what remains to 0.4 of a logarithm, and the lives alone to 0.25."""
    rows = np.arange(16 * gears)
    left_h, group = np.exp(7.0 + np.linspace(2.0, -3.0, 16)[rows % 16]), rows // 16
    x = np.repeat((np.log(left_h) + rng.normal(0.0, 0.4, rows.size))[:, None], len(FEATURES), axis=1)
    scales = Scales(3.0, 1.0, np.full(5, 0.2), np.ones(len(INDICATORS)), np.ones(len(INDICATORS)))
    known, names = np.ones((gears, len(INDICATORS)), dtype=bool), tuple(str(i) for i in range(gears))
    units = np.full(rows.size, 7.0)
    past = Experience(
        "any", names, scales, x, np.log(left_h) - 7.0, units, left_h, group, known, Lives(0, [0.0] * gears)
    )
    looked_at = rows[3::4].tolist()
    lives = [left_h[row] * np.exp(rng.normal(0.0, 0.25) + 0.25 * norm.ppf(LEVELS)) for row in looked_at]
    nothing = [np.exp(20.0 + norm.ppf(LEVELS))] * len(looked_at)
    return weighed(past, (nothing, lives, nothing, nothing), looked_at, LEVELS).weights


def test_five_gears_do_not_overturn_what_members_usually_weigh() -> None:
    """Five gears may chance to fail at one age; that thirty do is no chance."""
    rng = np.random.default_rng(6)
    few, many = np.mean([shares(rng, 5) for _ in range(4)], axis=0), shares(rng, 25)
    assert few[0] > 0.4 > many[0]
    assert many[2] > 0.6


def loss(samples: np.ndarray, truth: float) -> float:
    """CRPS of an ensemble (Gneiting and Raftery 2007, eq. 21)."""
    return float(np.mean(np.abs(samples - truth)) - 0.5 * np.mean(np.abs(samples[:, None] - samples[None])))


def fails_at_random(rng: np.random.Generator) -> FailedGear:
    """A gear that shows nothing until something strikes it."""
    life = crack_or_bearing(rng)
    rows = min(int(rng.uniform(0.2, 1.0) * life.time_h.size) + 20, life.time_h.size)
    columns = {name: rng.permutation(values[:rows]) for name, values in life.columns.items()}
    return FailedGear(life.time_h[:rows], columns)


@pytest.mark.parametrize("fail_so", [crack_or_bearing, fails_at_random])
def test_learning_from_few_gears_is_never_worse_than_none(
    fail_so: Callable[[np.random.Generator], FailedGear], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learn, "MOST_WEIGHED", 5)
    rng = np.random.default_rng(5)
    prior = learn_life(GEAR, [fail_so(rng) for _ in range(5)], rounds=2)
    learned = without = 0.0
    for life in [fail_so(rng) for _ in range(10)]:
        time_h, columns = until(life, 0.6)
        ledger = rows_of(GEAR, time_h, np.full(time_h.size, 5.0), columns)
        left = life.time_h[-1] - time_h[-1]
        told_of = (foresee(GEAR, ledger, evidence_of(ledger), one).remaining_h[::10] for one in (prior, MAKERS))
        score, score_without = (loss(samples, left) / left for samples in told_of)
        learned, without = learned + score, without + score_without
    assert learned < without, (learned, without)
