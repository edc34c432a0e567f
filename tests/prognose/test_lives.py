"""Lives of failed gears alone: against the law that the lives are drawn from here, which nobody else knows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import lognorm

from edge_daemon.prognose import learn
from edge_daemon.prognose.courses import LifeCourse, Scales
from edge_daemon.prognose.forecast import foresee
from edge_daemon.prognose.learn import FailedGear, learn_life
from edge_daemon.prognose.lives import Lives, learn_lives
from edge_daemon.usage.evidence import evidence_of
from edge_daemon.usage.gears import find_gear
from edge_daemon.usage.ledger import Ledger, rows_of

pytestmark = pytest.mark.slow

GEAR = find_gear("CSG-20-100")
SCALES = Scales(3.0, 1.0, np.full(5, 0.2), np.ones(3), np.ones(3))
LEVELS = (np.arange(40) + 0.5) / 40
SD, USE = 0.35, 4000.0


def life(rng: np.random.Generator, power: float) -> FailedGear:
    """It ends when torque to a power has added up to a use drawn at random; what is measured only scatters."""
    torque, use = rng.uniform(0.7, 1.3), USE * rng.lognormal(0.0, SD)
    t = np.arange(10.0, 10.0 * use / torque**power, 10.0)
    columns = {
        "speed_in_rpm": np.full(t.size, 1500.0),
        "torque_cubic_mean_Nm": np.full(t.size, torque * GEAR.rated_torque_Nm),
        "stiffness_Nm_per_rad": 1.6e4 * rng.lognormal(0.0, 0.03) * rng.normal(1.0, 0.01, t.size),
    }
    columns |= {f"noise_a{i}": 1e-3 * rng.lognormal(0.0, 0.2, t.size) for i in range(5)}
    return FailedGear(t, columns)


def ledger(life: FailedGear, share: float = 1.0) -> Ledger:
    rows = int(share * life.time_h.size)
    return rows_of(GEAR, life.time_h[:rows], np.full(rows, 10.0), {n: v[:rows] for n, v in life.columns.items()})


def known_left_h(seen: Ledger, power: float) -> np.ndarray:
    """Quantiles of what remains to a gear that has come so far, by the law that it was drawn from."""
    torque = float(np.cbrt(np.sum(seen.cubic_Nm3_h) / np.sum(seen.turns))) / GEAR.rated_torque_Nm
    age = float(np.sum(seen.hours))
    law = lognorm(SD, scale=10.0 * USE / torque**power)
    return np.asarray(law.isf(law.sf(age) * (1.0 - LEVELS)) - age)


def loss(samples: np.ndarray, truth: float) -> float:
    """CRPS of an ensemble (Gneiting and Raftery 2007, eq. 21)."""
    return float(np.mean(np.abs(samples - truth)) - 0.5 * np.mean(np.abs(samples[:, None] - samples[None])))


@pytest.mark.parametrize(("power", "clock"), [(0.0, (0, 1)), (3.0, (2,)), (9.0, (3,))])
def test_many_lives_tell_their_clock_and_what_remains(power: float, clock: tuple[int, ...]) -> None:
    rng = np.random.default_rng(4)
    lives = learn_lives([LifeCourse(ledger(life(rng, power)), SCALES) for _ in range(80)])
    assert lives.clock in clock
    assert lives.fits(80)
    for share in (0.3, 0.6, 0.9):
        seen = ledger(life(rng, power), share)
        course = LifeCourse(seen, SCALES)
        told = lives.left_h(course, len(course.clock) - 1, LEVELS)
        assert np.median(told) == pytest.approx(np.median(known_left_h(seen, power)), rel=0.3)


def test_a_gear_that_is_left_out_does_not_tell_of_itself() -> None:
    rng = np.random.default_rng(7)
    courses = [LifeCourse(ledger(life(rng, 0.0)), SCALES) for _ in range(6)]
    row = len(courses[2].clock) // 2
    ends = [end for i, end in enumerate(learn_lives(courses).ends) if i != 2]
    lives = learn_lives(courses)
    alone = Lives(lives.clock, ends).left_h(courses[2], row, LEVELS)
    assert lives.left_h(courses[2], row, LEVELS, 2) == pytest.approx(alone)
    assert lives.left_h(courses[2], row, LEVELS) != pytest.approx(alone)


def test_where_nothing_measured_tells_the_learned_forecast_is_as_good_as_the_age(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Against the very law of the lives: fifteen of them teach it within a quarter of its score."""
    monkeypatch.setattr(learn, "MOST_WEIGHED", 8)
    rng = np.random.default_rng(12)
    prior = learn_life(GEAR, [life(rng, 3.0) for _ in range(15)], rounds=2)
    learned = known = 0.0
    for one in [life(rng, 3.0) for _ in range(30)]:
        seen = ledger(one, rng.uniform(0.3, 0.9))
        left = one.time_h[-1] - float(np.sum(seen.hours))
        told = foresee(GEAR, seen, evidence_of(seen), prior).remaining_h
        learned += loss(told[::20], left) / one.time_h[-1]
        known += loss(known_left_h(seen, 3.0), left) / one.time_h[-1]
    assert learned < 1.25 * known, (learned, known)
