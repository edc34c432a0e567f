"""Drift detection on simulated hours: quiet when healthy, quick and right when not, the same after a restart."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_daemon.health.control_chart import Chart, freeze, judge, regressors, threshold
from edge_daemon.health.trends import ConditionWatch
from edge_daemon.records import Estimate, Status
from edge_daemon.usage.gears import find_gear

GEAR = find_gear("CSG-20-100")
COMMISSION_H = 240.0


def live(watch: ConditionWatch, hours: range, softer_from: int = 10**9, loss: float = 0.0, seed: int = 4) -> None:
    """Hours with a warm afternoon every day; stiffness depends on temperature and load."""
    for hour in hours:
        rng = np.random.default_rng((seed, hour))
        warm = 25 + 8 * math.sin(2 * math.pi * hour / 24) + rng.normal()
        load = 30 + 10 * (hour % 24 > 8) + rng.normal()
        stiffness = 1.6e4 * (1 - 1e-3 * (warm - 25)) * (1 + 1e-3 * load) * (1 + 0.005 * rng.normal())
        if hour >= softer_from:
            stiffness *= 1 - loss
        values = {"stiffness": stiffness, "temperature": warm, "torque_rms": load, "speed_in": 100.0}
        watch.update(1.0, {name: Estimate(name, v, 0.01 * v, "", Status.VALID, 0.0) for name, v in values.items()})


def test_a_warm_afternoon_is_no_fault() -> None:
    watch = ConditionWatch("axis", GEAR, COMMISSION_H)
    live(watch, range(2400))
    assert not watch.findings()[0].high
    assert watch.drifts()["stiffness"][0] == pytest.approx(0.0, abs=0.003)


def test_two_percent_of_stiffness_are_found_within_days() -> None:
    watch = ConditionWatch("axis", GEAR, COMMISSION_H)
    live(watch, range(480), 480, 0.02)
    assert not watch.findings()[0].high
    live(watch, range(480, 480 + 120), 480, 0.02)
    (finding,) = watch.findings()
    assert finding.high
    assert "stiffness -2" in finding.text
    assert "fatigue" in finding.text
    drift, sd = watch.drifts()["stiffness"]
    assert drift == pytest.approx(math.log(0.98), abs=3 * sd + 1e-3)


def test_an_alarm_says_that_another_model_came_meanwhile() -> None:
    watch = ConditionWatch("axis", GEAR, COMMISSION_H)
    live(watch, range(600), 480, 0.02)
    before = watch.findings()[0]
    watch.model_changed()
    after = watch.findings()[0]
    assert before.high and after.high, "a stiffness comes referred to the first model, and goes on"
    assert "another model" not in before.text and "(another model since 600 h)" in after.text
    again = ConditionWatch("axis", GEAR, COMMISSION_H)
    assert again.restore(watch.state()) and again.findings() == watch.findings()


def test_nothing_is_said_during_commissioning() -> None:
    watch = ConditionWatch("axis", GEAR, COMMISSION_H)
    live(watch, range(200), 100, 0.2)
    assert not watch.findings()[0].high


@pytest.mark.parametrize("cut", [100, 239, 500, 511])
def test_a_restart_changes_nothing(cut: int) -> None:
    straight, first = ConditionWatch("axis", GEAR, COMMISSION_H), ConditionWatch("axis", GEAR, COMMISSION_H)
    live(straight, range(560), 480, 0.02)
    live(first, range(cut), 480, 0.02)
    second = ConditionWatch("axis", GEAR, COMMISSION_H)
    assert second.restore(first.state())
    live(second, range(cut, 560), 480, 0.02)
    assert second.drifts() == straight.drifts()
    assert not ConditionWatch("other", GEAR).restore(first.state())
    assert not ConditionWatch("axis", GEAR).restore(b"?")


def test_a_number_that_never_changes_is_watched_too() -> None:
    """Nothing scatters, and the baseline's normal equations had no inverse."""
    watch = ConditionWatch("axis", GEAR, COMMISSION_H)
    for hour in range(600):
        value = 1.6e4 if hour < 400 else 1.5e4
        watch.update(1.0, {"stiffness": Estimate("stiffness", value, 1.0, "", Status.VALID, 0.0)})
        assert watch.findings()[0].high is False or hour > 400
    assert watch.drifts()["stiffness"][0] == pytest.approx(math.log(1.5 / 1.6), abs=1e-6)


def test_a_number_that_hardly_changes_is_watched_too() -> None:
    """Rounding left a variance below zero where nothing but rounding scatters."""
    draw = np.random.default_rng(3)
    for length in draw.integers(30, 300, 50):
        rows = [(*map(float, row), 5.0 + 1e-9 * float(draw.normal())) for row in draw.random((length, 3))]
        chart = Chart(rows=rows)
        freeze(chart)
        for state in draw.random((50, 3)):
            judge(chart, 0.02, regressors(state[None])[0], 5.0, 10.0)
        assert not chart.drifted


def test_threshold_gives_the_stated_run_length() -> None:
    """Simulated average run length of one chart against Siegmund's formula."""
    limit = threshold(1.0, 400.0, 1)
    rng = np.random.default_rng(8)
    cusum, rung = np.zeros(400), 0
    for _ in range(3000):
        cusum = np.maximum(0.0, cusum + rng.normal(size=400) - 0.5)
        rung += int(np.sum(cusum > limit))
        cusum[cusum > limit] = 0.0
    assert 400 * 3000 / rung == pytest.approx(400, rel=0.1)


def test_a_drift_too_small_for_any_fault_is_held_but_rings_no_alarm() -> None:
    watch = ConditionWatch("axis", GEAR, COMMISSION_H)
    live(watch, range(480 + 600), 480, 0.0055)
    (finding,) = watch.findings()
    assert "stiffness -0." in finding.text
    assert not finding.high
