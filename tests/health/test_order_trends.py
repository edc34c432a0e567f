"""Waves that grow over simulated weeks: quiet when healthy, right when a tooth wears, the same after a restart."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_daemon.health.order_trends import OrderWatch
from edge_daemon.records import NE107, Estimate, Status

COMMISSION_H = 240.0
LOBES, TOOTH = "kinematic_error_2", "kinematic_error_202_output"
MEANT = {LOBES: "twice a turn of the motor", TOOTH: "202 per turn of the output: circular spline tooth pass"}
WHOLE_RAD, LOBES_RAD, NOISE_RAD = 3e-4, 1.4e-4, 2e-7
DAY_H = 24


def live(
    watch: OrderWatch, hours: range, grows: str = "", from_h: int = 0, per_day: float = 0.0, tooth_rad=5e-7
) -> None:
    """Hours with a warm afternoon every day, which changes the lobes a little; one wave may grow by so many radians a
    day. What an encoder's noise makes of a wave is as large as a wave, whatever its phase."""
    for hour in hours:
        rng = np.random.default_rng((7, hour))
        warm = 25 + 8 * math.sin(2 * math.pi * hour / DAY_H) + rng.normal()
        grown = per_day * max(hour - from_h, 0) / DAY_H
        sizes = {LOBES: LOBES_RAD * (1 + 2e-3 * (warm - 25)), TOOTH: tooth_rad}
        seen = {n: abs(r + grown * (n == grows) + NOISE_RAD * complex(*rng.normal(size=2))) for n, r in sizes.items()}
        values = {**seen, "kinematic_error": WHOLE_RAD, "temperature": warm, "torque_rms": 30.0, "speed_in": 100.0}
        found = {n: Estimate(n, v, NOISE_RAD, "rad", Status.VALID, 0.0) for n, v in values.items()}
        watch.update(1.0, found, MEANT)


def told_h(watch: OrderWatch, hours: range, **grows: object) -> float:
    """When it is first told [h]; infinite for never."""
    for hour in hours:
        live(watch, range(hour, hour + 1), **grows)  # type: ignore[arg-type]
        if watch.findings()[0].high:
            return hour
    return math.inf


@pytest.mark.slow
def test_a_year_of_a_sound_gear_says_nothing() -> None:
    watch = OrderWatch("axis", None, COMMISSION_H)
    assert told_h(watch, range(0, 8760, 1)) == math.inf


def test_a_tooth_that_wears_is_told_with_its_name_and_by_how_much() -> None:
    """It was hidden behind the lobes, 300 times as large: the kinematic error as a whole hardly grew."""
    watch = OrderWatch("axis", None, COMMISSION_H)
    at_h = told_h(watch, range(1500), grows=TOOTH, from_h=480, per_day=1e-6)
    assert 480 < at_h < 480 + 15 * DAY_H
    (finding,) = watch.findings()
    assert finding.severity is NE107.MAINTENANCE_REQUIRED and finding.latching
    assert MEANT[TOOTH] in finding.text and MEANT[LOBES] not in finding.text
    live(watch, range(int(at_h) + 1, 2000), TOOTH, 480, 1e-6)
    by, sd = watch.growth()[TOOTH]
    days, least = (2000 - 480) / DAY_H, 0.02 * WHOLE_RAD  # a wave of less does no harm
    assert by == pytest.approx(1e-6 * (days - 15.0) / least, rel=0.05), "the mean of the newest thirty days"
    assert 0.0 < sd < 0.05


def test_a_wave_that_is_nothing_beside_the_whole_may_grow_by_half() -> None:
    watch = OrderWatch("axis", None, COMMISSION_H)
    assert told_h(watch, range(1500), grows=TOOTH, from_h=480, per_day=2.3e-8, tooth_rad=2e-6) == math.inf


def test_nothing_is_said_during_commissioning_nor_by_another_model() -> None:
    watch = OrderWatch("axis", None, COMMISSION_H)
    assert told_h(watch, range(230), grows=LOBES, from_h=100, per_day=1e-4) == math.inf
    watch = OrderWatch("axis", None, COMMISSION_H)
    live(watch, range(500))
    watch.model_changed()
    live(watch, range(500, 800), tooth_rad=5e-5)
    assert not watch.findings()[0].high, "another model sees another tooth"
    assert told_h(watch, range(800, 1500), grows=TOOTH, from_h=800, per_day=5e-6, tooth_rad=5e-5) < math.inf
    assert "since the model changed at 500 h" in watch.findings()[0].text


@pytest.mark.parametrize("cut", [100, 239, 500, 605])
def test_a_restart_changes_nothing(cut: int) -> None:
    grows = {"grows": TOOTH, "from_h": 480, "per_day": 1e-6}
    straight, first = OrderWatch("axis", None, COMMISSION_H), OrderWatch("axis", None, COMMISSION_H)
    live(straight, range(900), **grows)
    live(first, range(cut), **grows)
    second = OrderWatch("axis", None, COMMISSION_H)
    assert second.restore(first.state())
    live(second, range(cut, 900), **grows)
    assert second.growth() == straight.growth() != {}
    assert not OrderWatch("other").restore(first.state()) and not OrderWatch("axis").restore(b"?")
