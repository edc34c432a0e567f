"""One channel from counts to SI: signs, units, roll-over, glitches, resets, slips, frozen encoders."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from edge_daemon.condition.calibration import Calibration
from edge_daemon.config.settings import ChannelSettings
from edge_daemon.records import Array, Flaw

RATE_HZ = 1000.0
TURN = 2**12
STEP_RAD = 2 * math.pi / TURN


def calibration(channel: str = "theta_in_rad", **fields: Any) -> Calibration:
    return Calibration(ChannelSettings(channel=channel, source="s", signal="x", **fields), RATE_HZ)


def times(size: int) -> Array:
    return 1e9 + np.arange(size) / RATE_HZ


def in_parts(unit: Calibration, time_s: Array, raw: Array, cuts: list[int]) -> tuple[Array, Array]:
    """Handed over in parts, the rest of the record visible ahead."""
    found = []
    edges = [0, *cuts, len(raw)]
    for first, last in itertools.pairwise(edges):
        if last > first:
            found.append(unit.apply(time_s[first:last], raw[first:last], (time_s[last:], raw[last:])))
    return np.concatenate([row[0] for row in found]), np.concatenate([row[1] for row in found])


@pytest.mark.parametrize(
    ("channel", "fields", "raw", "expected"),
    [
        ("temperature_degC", {"unit": "K", "scale": 0.1}, 2981.5, 25.0),
        ("temperature_degC", {"unit": "degF"}, 212.0, 100.0),
        ("pressure_Pa", {"unit": "mbar", "offset": -13.25}, 1026.5, 101_325.0),
        ("velocity_in_rad_s", {"unit": "rpm", "reverse": True}, 3000.0, -100 * math.pi),
        ("torque_in_Nm", {"unit": "mN m", "scale": 0.64}, 1000.0, 0.64),
        ("theta_out_rad", {"counts_per_turn": 1024.0, "offset": 0.5}, 256.0, math.pi / 2 + 0.5),
        ("theta_out_rad", {"counts_per_turn": 1024.0, "reverse": True}, 256.0, -math.pi / 2),
        ("theta_out_rad", {"unit": "deg"}, 180.0, math.pi),
        ("my_own", {"unit": "bar"}, 2.0, 2e5),
    ],
)
def test_raw_values_become_si(channel: str, fields: dict[str, Any], raw: float, expected: float) -> None:
    values, flaws = calibration(channel, **fields).apply(times(1), np.array([raw]))
    assert values[0] == pytest.approx(expected, rel=1e-12)
    assert flaws[0] == 0


def test_a_unit_of_another_quantity_is_refused_with_what_would_fit() -> None:
    with pytest.raises(ValueError, match=r"'rpm' is no unit of pressure_Pa: expected one of Pa, hPa"):
        calibration("pressure_Pa", unit="rpm")
    with pytest.raises(ValueError, match="'furlong' is unknown"):
        calibration("pressure_Pa", unit="furlong")


@pytest.mark.parametrize("seed", range(5))
def test_roll_over_gives_the_multi_turn_angle_however_the_readings_are_cut(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = np.cumsum(np.cumsum(rng.normal(0, 8, 3000)).clip(-600, 600)).round()
    cuts = sorted(rng.integers(0, 3000, 40).tolist())
    unit = calibration(counts_per_turn=TURN, wrap_counts=TURN)
    values, flaws = in_parts(unit, times(3000), true % TURN, cuts)
    start = true[0] - true[0] % TURN
    assert np.array_equal(values, (true - start) * STEP_RAD)
    assert not flaws.any()


def test_turns_taken_inside_a_gap_follow_from_the_speed_before_it() -> None:
    true = np.round(0.3 * TURN * np.arange(1000))  # 0.3 turns per sample: 1885 rad/s
    kept = (np.arange(1000) < 500) | (np.arange(1000) >= 505)
    unit = calibration(counts_per_turn=TURN, wrap_counts=TURN, max_rate=2500.0)
    values, flaws = unit.apply(times(1000)[kept], (true % TURN)[kept])
    assert np.array_equal(values, true[kept] * STEP_RAD)
    assert not flaws.any()
    assert unit.resets == 0


def test_a_gap_too_long_to_know_the_turns_loses_the_reference_and_says_so() -> None:
    true = np.round(0.05 * TURN * np.arange(1000))
    kept = (np.arange(1000) < 400) | (np.arange(1000) >= 600)
    unit = calibration(counts_per_turn=TURN, wrap_counts=TURN)
    _, flaws = unit.apply(times(1000)[kept], (true % TURN)[kept])
    assert np.flatnonzero(flaws).tolist() == [400]
    assert flaws[400] == Flaw.RESET
    assert unit.resets == 1


@pytest.mark.parametrize("wrap", [None, TURN])
@pytest.mark.parametrize("cut", [500, 501, 502, 503])
@pytest.mark.parametrize("length", [1, 2])
def test_a_glitch_is_marked_and_changes_nothing_after_it(wrap: int | None, cut: int, length: int) -> None:
    true = np.round(0.01 * TURN * np.arange(1000))
    raw = true % wrap if wrap else true.copy()
    raw[501 : 501 + length] = (raw[501 : 501 + length] + 0.45 * TURN) % TURN
    unit = calibration(counts_per_turn=TURN, wrap_counts=wrap, max_rate=100.0)
    values, flaws = in_parts(unit, times(1000), raw, [cut])
    assert np.flatnonzero(flaws).tolist() == list(range(501, 501 + length))
    assert (flaws[flaws != 0] == Flaw.RATE).all()
    good = flaws == 0
    assert np.array_equal(values[good], true[good] * STEP_RAD)
    assert unit.resets == 0


@pytest.mark.parametrize("wrap", [None, TURN])
@pytest.mark.parametrize("cut", [300, 499, 500, 501, 502])
def test_a_reset_to_zero_is_bridged_exactly_at_constant_speed(wrap: int | None, cut: int) -> None:
    true = 10.0 * np.arange(1000)  # whole counts at a constant speed
    raw = true.copy()
    raw[500:] -= true[500] - (2.0 if wrap is None else 2.0 + 0.4 * TURN)
    raw = raw % wrap if wrap else raw
    unit = calibration(counts_per_turn=TURN, wrap_counts=wrap, max_rate=100.0)
    values, flaws = in_parts(unit, times(1000), raw, [cut])
    assert np.array_equal(values, true * STEP_RAD)
    assert (flaws[500:503] == Flaw.RESET).all()
    assert not flaws[:498].any()
    assert not flaws[503:].any()
    assert unit.resets == 1


def test_a_reset_with_nothing_ahead_to_confirm_it_is_settled_by_what_comes() -> None:
    true = 10.0 * np.arange(1000)
    raw = true.copy()
    raw[500:] -= 4321.0
    unit = calibration(counts_per_turn=TURN, max_rate=100.0)
    values = np.concatenate([unit.apply(times(1000)[i : i + 1], raw[i : i + 1])[0] for i in range(1000)])
    assert unit.resets == 1
    assert np.array_equal(values[:500], true[:500] * STEP_RAD)
    assert np.array_equal(values[510:], true[510:] * STEP_RAD)


@pytest.mark.parametrize("teeth", [120, 200, 320])
def test_a_slip_by_one_tooth_is_marked_but_never_corrected(teeth: int) -> None:
    per_turn = 2**20
    pitch = 2 * math.pi / teeth
    raw = np.round(np.linspace(0, 1000, 1000))
    raw[500:] += round(per_turn / teeth)
    unit = calibration("theta_out_rad", counts_per_turn=per_turn, max_rate=4.0)
    values, flaws = unit.apply(times(1000), raw)
    assert values[999] - values[0] == pytest.approx(pitch + 1000 / per_turn * 2 * math.pi, abs=1e-5)
    assert flaws[500] == Flaw.RATE
    assert unit.resets == 0


def test_the_rate_of_a_plain_channel_is_checked_sample_by_sample() -> None:
    raw = np.zeros(100)
    raw[40:] = 5.0
    _, flaws = calibration("torque_in_Nm", max_rate=1000.0).apply(times(100), raw)
    assert np.flatnonzero(flaws).tolist() == [40]
    assert flaws[40] == Flaw.RATE


def test_an_unchanging_encoder_is_frozen_only_while_the_drive_moves() -> None:
    unit = calibration("theta_out_rad", counts_per_turn=TURN, frozen_after_s=0.2005)
    time_s = times(1000)
    raw = np.full(1000, 7.0)
    raw[:100] = 106.0 - np.arange(100)
    _, still = unit.apply(time_s, raw)
    assert not still.any()
    again = calibration("theta_out_rad", counts_per_turn=TURN, frozen_after_s=0.2005)
    _, flaws = again.apply(time_s, raw, None, moved_s=float(time_s[600]))
    assert np.flatnonzero(flaws).tolist() == list(range(300, 1000))
    assert (flaws[flaws != 0] == Flaw.FROZEN).all()


def test_an_angle_says_when_it_moved() -> None:
    unit = calibration(counts_per_turn=TURN)
    unit.apply(times(100), np.random.default_rng(1).integers(0, 3, 100).astype(float))
    assert unit.moved_s == -math.inf, "noise is no motion"
    later_s = times(100) + 0.1
    unit.apply(later_s, np.linspace(0, TURN, 100).round())
    assert unit.moved_s == later_s[-1]
