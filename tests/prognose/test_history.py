"""`edge-daemon life`: what a history says, and what it refuses."""

from __future__ import annotations

import json
import math
import warnings

import numpy as np
import pytest

from edge_daemon.prognose.history import LifeError, LifeReport, life_of_history
from edge_daemon.records import NE107, Array
from edge_daemon.usage.gears import find_gear
from edge_daemon.usage.ledger import rows_of

GEAR = find_gear("CSG-20-100")


def history(hours: int, life_h: float, loss: float = 0.2, seed: int = 5) -> tuple[Array, dict[str, Array]]:
    """A gear at moderate load whose stiffness falls by `loss` until `life_h`."""
    rng = np.random.default_rng(seed)
    t = np.arange(1.0, hours + 1.0)
    warm = 30 + 8 * np.sin(2 * np.pi * t / 24) + rng.normal(size=t.size)
    stiffness = 1.6e4 * (1 - loss * (t / life_h) ** 3) * (1 - 4e-4 * (warm - 25)) * (1 + 0.01 * rng.normal(size=t.size))
    return t, {
        "speed_in_rpm": 1500 + 100 * rng.normal(size=t.size),
        "torque_cubic_mean_Nm": 50 + 4 * rng.normal(size=t.size),
        "torque_peak_Nm": 90 + 4 * rng.normal(size=t.size),
        "temperature_degC": warm,
        "stiffness_Nm_per_rad": stiffness,
    }


def assert_sane(answer: LifeReport) -> None:
    document = answer.to_json()
    json.dumps(document, allow_nan=False)
    assert set(document) == {"time_h", "damage", "rul_h", "failure_probability", "state", "reasons"}
    assert 0 <= answer.p10_h <= answer.p50_h <= answer.p90_h
    chances = [row["probability"] for row in document["failure_probability"]]
    assert chances == sorted(chances)
    assert 0 <= answer.damage <= 1


def test_no_history_is_the_makers_prior_and_says_so() -> None:
    answer = life_of_history(np.empty(0), {}, GEAR)
    assert_sane(answer)
    assert answer.p10_h == pytest.approx(GEAR.l10_h, rel=0.15)
    assert answer.p50_h == pytest.approx(GEAR.l50_h, rel=0.12)
    assert any("maker" in reason for reason in answer.reasons)


def test_load_alone_follows_the_makers_cubic_law() -> None:
    t = np.arange(1.0, 101.0)
    load = {"speed_in_rpm": np.full(100, 1000.0), "torque_cubic_mean_Nm": np.full(100, 40.0)}
    answer = life_of_history(t, load, GEAR)
    assert_sane(answer)
    assert answer.p50_h == pytest.approx(GEAR.l50_h * (52 / 40) ** 3 * 2, rel=0.12)


def test_falling_stiffness_shortens_the_forecast() -> None:
    healthy = life_of_history(*history(10_000, 1e6), GEAR)
    worn = life_of_history(*history(10_000, 11_000), GEAR)
    assert_sane(worn)
    assert worn.p50_h < 0.2 * healthy.p50_h
    assert worn.damage > 0.6
    assert worn.state is NE107.MAINTENANCE_REQUIRED
    assert any("flexspline" in reason for reason in worn.reasons)


def test_stiffness_lost_counts_in_the_damage_of_a_history() -> None:
    """A gear that runs on at nine tenths of its stiffness is damaged (1 / 0.9)^m times as fast from then on."""
    hours = np.arange(1.0, 2001.0)
    exponent = np.log(1e7 / 1e4) / np.log(GEAR.momentary_peak_Nm / GEAR.repeated_peak_Nm)
    load = {"speed_in_rpm": 0 * hours + 1500.0, "torque_cubic_mean_Nm": 0 * hours + 60.0}
    noise = np.random.default_rng(8).normal(1.0, 0.004, hours.size)
    soft = rows_of(
        GEAR, hours, 0 * hours + 1.0, {**load, "stiffness_Nm_per_rad": 1.6e4 * noise * (1 - 0.1 * (hours > 500))}
    )
    fresh = rows_of(GEAR, hours, 0 * hours + 1.0, load)
    late = slice(700, None)
    ratio = soft.fatigue[late].sum() / fresh.fatigue[late].sum()
    sd = soft.fatigue_sd[late].sum() / fresh.fatigue[late].sum()
    assert abs(ratio - 0.9**-exponent) < 3.0 * sd
    assert 0.0 < sd < 0.1 * ratio


def test_what_a_forecast_is_of_is_told() -> None:
    """By construction a fifth is lost at 2000 h, and 17 % at 1900 h, the middle of the last tenth."""
    t, columns = history(2000, 2000.0)
    (told,) = (reason for reason in life_of_history(t, columns, GEAR).reasons if "what changed" in reason)
    change = float(told.rpartition("stiffness ")[2].rstrip("%"))
    assert -19.0 < change < -15.0
    (alone,) = life_of_history(t, {name: columns[name] for name in list(columns)[:4]}, GEAR).reasons
    assert "no stiffness or noise" in alone


def test_a_peak_below_the_mean_is_doubted() -> None:
    t, columns = history(500, 5000.0)
    assert life_of_history(t, columns, GEAR).state is NE107.OK
    mean, peak = columns["torque_cubic_mean_Nm"], columns["torque_peak_Nm"]
    wrong = life_of_history(t, {**columns, "torque_cubic_mean_Nm": peak, "torque_peak_Nm": mean}, GEAR)
    assert wrong.state >= NE107.FUNCTION_CHECK
    assert any("in 500 rows" in reason and "exchanged" in reason for reason in wrong.reasons)


def test_more_torque_to_come_shortens_life() -> None:
    t, columns = history(3_000, 1e6)
    assert life_of_history(t, columns, GEAR, 1.2).p50_h < 0.75 * life_of_history(t, columns, GEAR).p50_h


def test_same_history_same_answer() -> None:
    t, columns = history(500, 5_000)
    assert life_of_history(t, columns, GEAR) == life_of_history(t, columns, GEAR)


@pytest.mark.parametrize("column", ["speed_in_rpm", "torque_cubic_mean_Nm", "torque_peak_Nm", "temperature_degC"])
@pytest.mark.parametrize("how", ["absent", "nan"])
def test_a_missing_column_is_no_disaster(column: str, how: str) -> None:
    t, columns = history(2_000, 20_000)
    complete = life_of_history(t, columns, GEAR)
    if how == "absent":
        del columns[column]
    else:
        columns[column] = np.full(t.size, np.nan)
    answer = life_of_history(t, columns, GEAR)
    assert_sane(answer)
    assert 0.2 < answer.p50_h / complete.p50_h < 5
    if column == "speed_in_rpm":
        assert any("speed unknown" in reason for reason in answer.reasons)
        assert answer.state is NE107.FUNCTION_CHECK


def test_scattered_nan_hardly_move_the_answer() -> None:
    t, columns = history(6_000, 12_000)
    holes = np.random.default_rng(1).uniform(size=t.size) < 0.1
    torn = {name: np.where(holes, np.nan, values) for name, values in columns.items()}
    assert life_of_history(t, torn, GEAR).p50_h == pytest.approx(life_of_history(t, columns, GEAR).p50_h, rel=0.25)


def test_spikes_are_left_out_and_told() -> None:
    t, columns = history(6_000, 12_000)
    clean = life_of_history(t, columns, GEAR)
    columns["stiffness_Nm_per_rad"][::100] *= 3
    answer = life_of_history(t, columns, GEAR)
    assert answer.p50_h == pytest.approx(clean.p50_h, rel=0.25)
    assert any("spikes" in reason for reason in answer.reasons)


def test_an_overload_is_out_of_specification() -> None:
    t, columns = history(200, 1e6)
    columns["torque_peak_Nm"][100] = 250.0
    answer = life_of_history(t, columns, GEAR)
    assert answer.state is NE107.OUT_OF_SPECIFICATION
    assert "191" in answer.reasons[0]


def test_a_gap_and_a_late_start_are_told() -> None:
    t, columns = history(500, 1e6)
    t = t + np.where(np.arange(500) > 250, 400.0, 0.0) + 1000.0
    text = " ".join(life_of_history(t, columns, GEAR).reasons)
    assert "gap" in text
    assert "no rows before 1001 h" in text


def damaged(column: str, row: int, value: float) -> tuple[Array, dict[str, Array]]:
    t, columns = history(100, 1e6)
    (t if column == "time_h" else columns[column])[row] = value
    return t, columns


@pytest.mark.parametrize(
    ("column", "row", "value", "expected"),
    [
        ("torque_cubic_mean_Nm", 3, -5.0, "torque_cubic_mean_Nm: row 4 is -5"),
        ("torque_peak_Nm", 99, 1e9, "torque_peak_Nm: row 100"),
        ("torque_peak_Nm", 9, math.inf, "torque_peak_Nm: row 10"),
        ("speed_in_rpm", 0, 1e6, "speed_in_rpm: row 1"),
        ("time_h", 50, 3.0, "time_h: row 51 runs backward"),
        ("time_h", 50, math.nan, "time_h: row 51 is not a number"),
        ("time_h", 99, 1e9, "time_h: row 100 jumps"),
        ("time_h", 0, -1.0, "time_h: starts at -1"),
    ],
)
def test_absurd_input_is_refused(column: str, row: int, value: float, expected: str) -> None:
    with pytest.raises(LifeError, match=expected) as caught:
        life_of_history(*damaged(column, row, value), GEAR)
    assert "\n" not in str(caught.value)


def test_columns_of_different_length_are_refused() -> None:
    with pytest.raises(LifeError, match="speed_in_rpm: 3 values for 2 rows"):
        life_of_history(np.array([1.0, 2.0]), {"speed_in_rpm": np.ones(3)}, GEAR)


def test_sensors_without_any_noise_are_no_trap() -> None:
    """A logger that rounds, or a model that writes the file: constant noise coefficients, a smooth stiffness."""
    t = np.arange(1.0, 3001.0)
    columns = {
        "speed_in_rpm": np.full(t.size, 1500.0),
        "torque_cubic_mean_Nm": np.full(t.size, 50.0),
        "stiffness_Nm_per_rad": 1.6e4 * (1.0 - 0.2 * (t / 6000.0) ** 2),
    } | {f"noise_a{beta}": np.full(t.size, 1e-4) for beta in range(5)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        said = life_of_history(t, columns, find_gear("CSG-20-100"))
    assert 0.0 < said.p10_h < said.p50_h < said.p90_h < 1e5


@pytest.mark.parametrize("seed", range(3))
def test_any_mixture_of_flaws_gives_finite_ordered_numbers(seed: int) -> None:
    """Few rows, idle or overloaded, wear that settles or runs away, columns absent or half empty."""
    rng = np.random.default_rng(seed)
    for rows in (1, 2, 5, 60, 400):
        t = 500.0 * rng.integers(0, 2) + np.cumsum(rng.exponential(10.0, rows) + 1e-6)
        share = t / t[-1]
        courses = (np.ones(rows), 1 - 0.2 * share**2, 1 + 0.2 * share, 1 - 0.9 * share, 1 - 0.3 * (share > 0.9))
        columns = {
            "speed_in_rpm": np.full(rows, rng.choice([0.0, 10.0, 1500.0])),
            "torque_cubic_mean_Nm": np.full(rows, rng.choice([0.0, 20.0, 150.0])),
            "stiffness_Nm_per_rad": 1.6e4 * courses[rng.integers(len(courses))],
            "noise_a0": 1e-4 * np.exp(rng.choice([-2.0, 0.0, 10.0]) * share**6),
        }
        columns = {
            name: np.where(rng.uniform(size=rows) < 0.3, np.nan, values)
            for name, values in columns.items()
            if rng.uniform() < 0.8
        }
        said = life_of_history(t, columns, find_gear("CSG-20-100"))
        numbers = np.array([0.0, said.p10_h, said.p50_h, said.p90_h])
        assert np.isfinite(numbers).all() and np.isfinite(said.damage), (seed, rows)
        assert (np.diff(numbers) >= 0.0).all(), (seed, rows)


def test_a_hot_gear_lives_shorter_and_is_told_so() -> None:
    """Load alone, as above: the bearing's life halves for each 15 K above 70 degC."""
    t = np.arange(1.0, 101.0)
    load = {"speed_in_rpm": np.full(100, 1000.0), "torque_cubic_mean_Nm": np.full(100, 40.0)}
    cool, hot = (life_of_history(t, {**load, "temperature_degC": np.full(100, warm)}, GEAR) for warm in (40.0, 100.0))
    assert hot.p50_h == pytest.approx(cool.p50_h / 4.0, rel=0.12)
    assert any("80 degC" in reason for reason in hot.reasons)
    assert hot.state is NE107.OUT_OF_SPECIFICATION
    assert not any("degC" in reason for reason in cool.reasons)
