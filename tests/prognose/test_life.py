"""The live follower: prior, load accounting, restart, and agreement with the same life read from a file."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_daemon.prognose.history import life_of_history
from edge_daemon.prognose.life import LifeFollower
from edge_daemon.records import Array, Block, Estimate, Flags, Status
from edge_daemon.usage.gears import find_gear

GEAR = find_gear("CSG-20-100")
RATE_HZ = 1.0
"""slow blocks let a test live through weeks"""


def block(sequence: int, torque: Array | float, speed_rpm: float = 1500.0, size: int = 600) -> Block:
    values = {
        "torque_out_Nm": np.broadcast_to(np.asarray(torque, dtype=float), size).copy(),
        "velocity_in_rad_s": np.full(size, speed_rpm * math.pi / 30),
    }
    flaws: dict[str, Flags] = {name: np.zeros(size, dtype=np.uint8) for name in values}
    return Block("axis", sequence, sequence * size / RATE_HZ, RATE_HZ, values, flaws)


def estimate(name: str, value: float) -> Estimate:
    return Estimate(name, value, abs(value) * 0.01, "1", Status.VALID, 0.0)


def by_name(estimates: tuple[Estimate, ...]) -> dict[str, Estimate]:
    return {row.name: row for row in estimates}


def test_a_new_gear_has_the_makers_prior() -> None:
    answer = by_name(LifeFollower(GEAR, "axis").update(block(0, 30.0), {}))
    assert answer["rul_p50_h"].status is Status.WARMING_UP
    assert answer["rul_p50_h"].value == pytest.approx(GEAR.l50_h, rel=0.12)
    assert answer["rul_p10_h"].value == pytest.approx(GEAR.l10_h, rel=0.15)
    assert answer["damage"].value == 0.0


def test_an_unknown_gear_has_no_life_but_a_load() -> None:
    answer = by_name(LifeFollower(None, "axis").update(block(0, -30.0), {}))
    assert answer["rul_p50_h"].status is Status.INVALID
    assert math.isnan(answer["damage"].value)
    assert answer["torque_cubic_mean"].value == pytest.approx(30.0)


def test_cubic_mean_is_weighted_by_turns() -> None:
    follower = LifeFollower(GEAR, "axis")
    follower.update(block(0, 20.0, 500.0), {})
    answer = by_name(follower.update(block(1, 60.0, 2000.0), {}))
    expected = ((20**3 * 500 + 60**3 * 2000) / 2500) ** (1 / 3)
    assert answer["torque_cubic_mean"].value == pytest.approx(expected, rel=1e-9)


def test_torque_comes_from_the_best_source_there_is() -> None:
    follower = LifeFollower(None, "axis")
    bare = block(0, 30.0)
    spoilt = Block("axis", 0, 0.0, 1.0, bare.values, {**bare.flaws, "torque_out_Nm": np.full(600, 1, dtype=np.uint8)})
    answer = by_name(follower.update(spoilt, {"torque_rms": estimate("torque_rms", 10.0)}))
    assert answer["torque_cubic_mean"].value == pytest.approx(10.63, rel=1e-3)
    follower = LifeFollower(None, "axis")
    answer = by_name(follower.update(spoilt, {}, np.full(600, 25.0)))
    assert answer["torque_cubic_mean"].value == pytest.approx(25.0)
    answer = by_name(LifeFollower(None, "axis").update(spoilt, {}))
    assert answer["torque_cubic_mean"].status is Status.INVALID


def test_a_live_life_equals_the_same_life_from_a_file() -> None:
    rng = np.random.default_rng(11)
    follower = LifeFollower(GEAR, "axis")
    rows = {"speed_in_rpm": [], "torque_cubic_mean_Nm": [], "torque_peak_Nm": [], "stiffness_Nm_per_rad": []}
    for hour in range(300):
        load, speed = 60 + 5 * rng.normal(), 1500 + 100 * rng.normal()
        stiffness = 1.6e4 * (1 - 0.2 * (hour / 400) ** 2) * (1 + 0.005 * rng.normal())
        for part in range(6):
            change = Estimate("stiffness_change", -0.2 * (hour / 400) ** 2, 0.002, "1", Status.VALID, 0.0)
            told = {"stiffness": estimate("stiffness", stiffness), "stiffness_change": change}
            answer = by_name(follower.update(block(6 * hour + part, load, speed), told, background=hour < 299))
        for name, value in zip(rows, (speed, load, load, stiffness), strict=True):
            rows[name].append(value)
    report = life_of_history(np.arange(1.0, 301.0), {name: np.array(values) for name, values in rows.items()}, GEAR)
    assert follower.observed_h == pytest.approx(300.0)
    assert answer["rul_p50_h"].status is Status.VALID
    # the ensemble turns rounding of the summed hours into its own Monte-Carlo error
    for name, value in (("p10", report.p10_h), ("p50", report.p50_h), ("p90", report.p90_h)):
        assert answer[f"rul_{name}_h"].value == pytest.approx(value, rel=0.2)
    assert answer["damage"].value == pytest.approx(report.damage, rel=0.1)


def test_killed_and_restarted_it_goes_on_as_if_nothing_happened() -> None:
    straight, cut = LifeFollower(GEAR, "axis"), LifeFollower(GEAR, "axis")
    rng = np.random.default_rng(2)
    for i in range(40):
        piece = block(i, 40 * np.sin(np.arange(600) / 7) + rng.normal(size=600))
        straight.update(piece, {})
        cut.update(piece, {})
        reborn = LifeFollower(GEAR, "axis")
        assert reborn.restore(cut.state())
        cut = reborn
    assert cut.observed_h == straight.observed_h
    np.testing.assert_array_equal(cut.cycles.cycles(), straight.cycles.cycles())
    last = block(40, 10.0)
    assert cut.update(last, {}) == straight.update(last, {})


def test_state_of_another_gear_or_broken_is_refused() -> None:
    follower = LifeFollower(GEAR, "axis")
    follower.update(block(0, 30.0), {})
    blob = follower.state()
    assert not LifeFollower(find_gear("CSG-25-100"), "axis").restore(blob)
    assert not LifeFollower(GEAR, "other").restore(blob)
    assert not LifeFollower(GEAR, "axis").restore(blob[: len(blob) // 2])
    assert not LifeFollower(GEAR, "axis").restore(b"")


def lived(change: float, sd: float, hours: int = 30) -> tuple[LifeFollower, dict[str, Estimate]]:
    """A gear at constant load that has lost stiffness before it was watched, and keeps what is left."""
    follower = LifeFollower(GEAR, "axis")
    told = {
        "stiffness": estimate("stiffness", 1.6e4 * (1.0 + change)),
        "stiffness_change": Estimate("stiffness_change", change, sd, "1", Status.VALID, 0.0),
    }
    for hour in range(hours):
        answer = by_name(follower.update(block(hour, 60.0, size=3600), told, background=hour < hours - 1))
    return follower, answer


def test_a_softer_gear_is_damaged_faster_by_the_makers_promises() -> None:
    """Strength falls with the section that is left, and damage with its power through the maker's two promises."""
    exponent = math.log(1e7 / 1e4) / math.log(GEAR.momentary_peak_Nm / GEAR.repeated_peak_Nm)
    (fresh, new), (soft, worn) = lived(0.0, 0.002), lived(-0.1, 0.002)
    assert soft.ledger.fatigue.sum() / fresh.ledger.fatigue.sum() == pytest.approx(0.9**-exponent, rel=1e-9)
    assert worn["damage"].value > 1.2 * new["damage"].value
    assert worn["rul_p50_h"].value < new["rul_p50_h"].value
    assert f"{0.9**-exponent:.3g}" in soft.counted and "10.0%" in soft.counted


def test_damage_is_as_uncertain_as_the_loss_of_stiffness() -> None:
    """Held against drawn losses: the sd is theirs, to first order."""
    exponent = math.log(1e7 / 1e4) / math.log(GEAR.momentary_peak_Nm / GEAR.repeated_peak_Nm)
    (sure, _), (unsure, _) = lived(-0.1, 0.0), lived(-0.1, 0.005)
    drawn = (1.0 - np.random.default_rng(3).normal(0.1, 0.005, 20_000)) ** -exponent
    told = unsure.ledger.fatigue_sd.sum() / unsure.ledger.fatigue.sum()
    assert told == pytest.approx(float(np.std(drawn) / np.mean(drawn)), rel=0.05)
    assert sure.ledger.fatigue_sd.sum() == 0.0


def test_warm_grease_costs_a_live_bearing_more() -> None:
    """Its life halves for each 15 K above 70 degC, hour by hour; below nothing changes."""
    used, left = {}, {}
    for warm in (25.0, 40.0, 95.0):
        follower = LifeFollower(GEAR, "axis")
        for hour in range(30):
            told = {"temperature": Estimate("temperature", warm, 0.2, "degC", Status.VALID, 0.0)}
            answer = by_name(follower.update(block(hour, 60.0, size=3600), told, background=hour < 29))
        used[warm], left[warm] = follower.ledger.rated_h.sum(), answer["rul_p50_h"].value
    assert used[25.0] == pytest.approx(used[40.0])
    assert used[95.0] / used[40.0] == pytest.approx(2.0 ** (25.0 / 15.0), rel=1e-6)
    assert left[95.0] < 0.8 * left[40.0]


def test_an_unknown_loss_of_stiffness_counts_as_none_and_is_told() -> None:
    follower = LifeFollower(GEAR, "axis")
    for hour in range(3):
        follower.update(block(hour, 60.0, size=3600), {}, background=True)
    assert "no loss of stiffness is known" in follower.counted
    assert follower.ledger.fatigue.sum() == pytest.approx(lived(0.0, 0.0, 3)[0].ledger.fatigue.sum())
    again, (soft, _) = LifeFollower(GEAR, "axis"), lived(-0.1, 0.002, 3)
    assert again.restore(soft.state()) and again.counted == soft.counted


def test_a_clock_jump_adds_no_life() -> None:
    follower = LifeFollower(GEAR, "axis")
    follower.update(block(0, 30.0), {})
    follower.update(block(10_000_000, 30.0), {})
    assert follower.observed_h == pytest.approx(1200 / 3600)


def test_samples_that_are_not_finite_do_not_spread() -> None:
    follower = LifeFollower(GEAR, "axis")
    torque = np.full(600, 30.0)
    torque[::2] = np.nan
    answer = by_name(follower.update(block(0, torque), {}))
    assert answer["torque_cubic_mean"].value == pytest.approx(30.0)


def test_the_forecast_can_run_elsewhere() -> None:
    follower = LifeFollower(GEAR, "axis")
    assert by_name(follower.update(block(0, 30.0), {}, background=True))["rul_p50_h"].status is Status.INVALID
    task = follower.forecast_task()
    assert task is not None
    assert follower.forecast_task() is None
    follower.accept(task())
    assert math.isfinite(by_name(follower.update(block(1, 30.0), {}, background=True))["rul_p50_h"].value)


def test_hours_turns_and_cycles_of_a_plain_motion() -> None:
    """Ten minutes at 1500 rpm with 30 load cycles of 40 N m a block, then standstill."""
    follower = LifeFollower(GEAR, "axis")
    for i in range(10):
        follower.update(block(i, 20.0 * np.sin(2 * np.pi * np.arange(600) / 20)), {})
    told = by_name(follower.update(block(10, 20.0, speed_rpm=0.0), {}))
    minutes = 10 * 600 / RATE_HZ / 60
    assert told["operating_hours"].value == pytest.approx(minutes / 60)
    assert told["turns_in"].value == pytest.approx(1500.0 * minutes, rel=0.002)
    assert told["turns_out"].value == pytest.approx(1500.0 * minutes / GEAR.ratio, rel=0.002)
    assert told["load_cycles"].value == pytest.approx(300, abs=1.0)
    assert all(
        told[name].status is Status.VALID for name in ("operating_hours", "turns_in", "turns_out", "load_cycles")
    )
    reborn = LifeFollower(GEAR, "axis")
    assert reborn.restore(follower.state())
    again = by_name(reborn.update(block(11, 20.0, speed_rpm=0.0), {}))
    assert again["turns_in"].value == told["turns_in"].value


def test_turns_that_nothing_tells_are_no_number() -> None:
    """An output speed alone, of a gear that nobody named: the motor's turns would be a guess."""
    follower = LifeFollower(None, "axis")
    only_out = Block(
        "axis",
        0,
        0.0,
        RATE_HZ,
        {"velocity_out_rad_s": np.full(600, 3.0)},
        {"velocity_out_rad_s": np.zeros(600, np.uint8)},
    )
    told = by_name(follower.update(only_out, {}))
    assert told["turns_out"].status is Status.VALID
    assert told["turns_in"].status is Status.INVALID
