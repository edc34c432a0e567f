"""Growth of indicators: gears whose law is integrated here in closed form, and a forecast by first passage."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.prognose.courses import LifeCourse
from edge_daemon.prognose.growth import POWERS, Growth, first_passage_h, learn_growth
from edge_daemon.usage.gears import find_gear
from edge_daemon.usage.ledger import Ledger, rows_of

GEAR = find_gear("CSG-20-100")
EVEN = np.full(5, 0.2)


def life(rng: np.random.Generator) -> tuple[Ledger, str]:
    """Da = C a^1.5 du seen in the stiffness against a race that wears at an even pace and is heard."""
    t = np.arange(1.0, 20_001.0)
    torque = rng.uniform(0.7, 1.2) * GEAR.rated_torque_Nm * rng.lognormal(0.0, 0.3, t.size)
    use = np.cumsum((torque / GEAR.rated_torque_Nm) ** 3)
    first = 0.1 * rng.lognormal(0.0, 0.2)
    crack = np.maximum(first**-0.5 - 0.5 * use * 8e-4 * rng.lognormal(0.0, 0.25), 1e-3) ** -2.0
    race = use / 5000.0 / rng.lognormal(0.0, 0.25)
    rows = int(np.argmax((crack >= 1.0) | (race >= 1.0))) + 1
    columns = {
        "speed_in_rpm": np.full(rows, 1500.0),
        "torque_cubic_mean_Nm": torque[:rows],
        "stiffness_Nm_per_rad": 1.6e4 * (1.0 - 0.25 * crack[:rows]) * rng.normal(1.0, 0.01, rows),
    }
    columns |= {f"noise_a{i}": 1e-3 * np.exp(race[:rows]) * rng.lognormal(0.0, 0.1, rows) for i in range(5)}
    return rows_of(GEAR, t[:rows], np.ones(rows), columns), "crack" if crack[rows - 1] >= 1.0 else "race"


@pytest.fixture(scope="module")
def taught() -> tuple[Growth, np.random.Generator]:
    rng = np.random.default_rng(11)
    growth = learn_growth([life(rng)[0] for _ in range(12)], EVEN, 0.03)
    assert growth is not None
    return growth, rng


def test_the_clock_and_the_crack_are_recognised(taught: tuple[Growth, np.random.Generator]) -> None:
    growth, _ = taught
    powers = {law.indicator: POWERS[int(np.argmax(law.log_weight))] for law in growth.laws}
    assert growth.exponent == 3.0
    assert set(powers) == {0, 1}
    assert 1.1 < powers[0] < 2.1
    assert powers[1] < 0.9
    assert growth.fits()


def test_most_gears_are_foreseen_at_seven_tenths(taught: tuple[Growth, np.random.Generator]) -> None:
    """Within a fifth, the interval holds, and what ends the gear is named."""
    growth, rng = taught
    near = inside = right = 0
    for _ in range(20):
        ledger, cause = life(rng)
        course = LifeCourse(ledger, growth.scales)
        row = int(0.7 * len(ledger)) - 1
        hours, first = first_passage_h(growth, course, row, 400)
        truth, (low, middle, high) = len(ledger) - 1.0 - row, np.quantile(hours, (0.1, 0.5, 0.9))
        near += abs(middle - truth) <= 0.2 * truth
        inside += low <= truth <= high
        right += (np.mean(first == 0) > 0.5) == (cause == "crack")
    assert near >= 16, near
    assert inside >= 12, inside
    assert right >= 15, right


def test_gears_that_show_nothing_teach_no_growth() -> None:
    rng = np.random.default_rng(3)
    rows = [int(n) for n in rng.uniform(1000, 3000, 6)]
    quiet = {
        "speed_in_rpm": np.full(3000, 1500.0),
        "torque_cubic_mean_Nm": np.full(3000, 30.0),
        "stiffness_Nm_per_rad": 1.6e4 * rng.normal(1.0, 0.01, 3000),
    }
    ledgers = [
        rows_of(GEAR, np.arange(1.0, n + 1), np.ones(n), {name: rng.permutation(v)[:n] for name, v in quiet.items()})
        for n in rows
    ]
    assert learn_growth(ledgers, EVEN, 0.03) is None
