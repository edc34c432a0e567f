"""Growth of indicators: gears whose law is integrated here in closed form, and a forecast by first passage."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.prognose.courses import LifeCourse
from edge_daemon.prognose.growth import POWERS, Growth, first_passage_h, learn_growth
from edge_daemon.usage.gears import find_gear
from edge_daemon.usage.ledger import Ledger, rows_of

pytestmark = pytest.mark.slow

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


def spalled(rng: np.random.Generator) -> tuple[Ledger, float]:
    """Nothing is heard until a race spalls; then the noise grows at an even pace, whatever the age. And the onset."""
    torque = rng.uniform(0.8, 1.2) * rng.lognormal(0.0, 0.1, 30_000)
    use = np.cumsum(torque**3)
    begins = 8000.0 * rng.lognormal(0.0, 0.3)
    heard = np.maximum(use - begins, 0.0) / (4000.0 * rng.lognormal(0.0, 0.25))
    rows = int(np.argmax(heard >= 1.8 * rng.lognormal(0.0, 0.05))) + 1
    columns = {"speed_in_rpm": np.full(rows, 1500.0), "torque_cubic_mean_Nm": torque[:rows] * GEAR.rated_torque_Nm}
    columns |= {f"noise_a{i}": 1e-3 * np.exp(heard[:rows]) * rng.lognormal(0.0, 0.1, rows) for i in range(5)}
    return rows_of(GEAR, np.arange(1.0, rows + 1.0), np.ones(rows), columns), float(np.argmax(use > begins))


def test_damage_that_begins_late_is_foreseen_from_its_onset() -> None:
    """Soon after the onset most medians lie within a fifth; before it the interval holds what only luck decides."""
    rng = np.random.default_rng(8)
    growth = learn_growth([spalled(rng)[0] for _ in range(12)], EVEN, 0.03)
    assert growth is not None
    (law,) = growth.laws
    chance, middle, _ = law.onset[int(np.argmax(law.log_weight))]
    assert chance > 0.8
    assert 0.4 < np.exp(middle) < 0.75
    near = inside = 0
    for _ in range(16):
        ledger, onset = spalled(rng)
        course = LifeCourse(ledger, growth.scales)
        for share, row in ((0.4, int(onset + 0.4 * (len(ledger) - onset))), (-0.3, int(0.7 * onset))):
            low, middle, high = np.quantile(first_passage_h(growth, course, row, 400)[0], (0.1, 0.5, 0.9))
            truth = len(ledger) - 1.0 - row
            near += share > 0.0 and abs(middle - truth) <= 0.2 * truth
            inside += low <= truth <= high
    assert near >= 12, near
    assert 20 <= inside <= 31, inside
