"""A torque sensor behind a slow amplifier: taken out and told, and no reason to miss or misname what the gear lacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.compare import compare
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.results import Diagnosis

RATE_HZ, SECONDS, RATIO = 1000.0, 20.0, 100.0
STIFFNESS, DAMPING, HALF_GAP, LAG_S = 2e4, 4.0, 8e-5, 6e-4
NOISE_NM = 0.02
BASE = Model("torsion", RATIO, 0.2, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))


@dataclass(frozen=True)
class Made:
    """A recording."""

    time_s: np.ndarray
    columns: dict[str, np.ndarray] = field(default_factory=dict)


def filtered(torque: np.ndarray, lag_s: float = LAG_S) -> np.ndarray:
    """Through a filter of first order, solved exactly from step to step."""
    read, keep = np.empty_like(torque), np.exp(-1 / (8 * RATE_HZ * lag_s))
    level = torque[0]
    for i, value in enumerate((0.5 * (torque + np.roll(torque, 1))).tolist()):
        level = value + keep * (level - value)
        read[i] = level
    return read


def recording(half_gap: float, sensor: Callable[[np.ndarray], np.ndarray] = filtered, seed: int = 4) -> Made:
    """Twist and output angle of several tones each; the torque of a spring, a damper and a gap, at an eighth of the
    interval, as a sensor reads it."""
    rng = np.random.default_rng(seed)
    fine = np.arange(round(SECONDS * RATE_HZ * 8)) / (8 * RATE_HZ)
    twist, rate, out = np.zeros_like(fine), np.zeros_like(fine), np.zeros_like(fine)
    for hz in (0.37, 1.9, 4.3, 7.7, 12.1):
        w, a, p = 2 * np.pi * hz, 2.2e-4 * rng.uniform(0.6, 1.0) / hz**0.3, rng.uniform(0, 6.28)
        twist += a * np.sin(w * fine + p)
        rate += a * w * np.cos(w * fine + p)
        out += 0.3 / hz * np.sin(w * fine + rng.uniform(0, 6.28))
    torque = STIFFNESS * (twist - np.clip(twist, -half_gap, half_gap)) + DAMPING * rate
    read = sensor(torque)
    pick = slice(None, None, 8)
    count = len(fine[pick])
    columns = {
        "theta_in_rad": RATIO * (out + twist)[pick] + rng.normal(0, 3e-6, count),
        "theta_out_rad": out[pick] + rng.normal(0, 3e-7, count),
        "torque_out_Nm": read[pick] + rng.normal(0, NOISE_NM, count),
    }
    return Made(fine[pick], columns)


@pytest.fixture(scope="module")
def gap() -> Diagnosis:
    return diagnose([recording(HALF_GAP)], BASE)


def test_a_gap_behind_a_slow_amplifier_is_named_and_leaves_noise(gap: Diagnosis) -> None:
    first = gap.candidates[0]
    assert gap.verdict == "missing" and first.effect == "backlash"
    assert first.nrmse_after < 1.3 * gap.error.noise_floor_nrmse
    assert first.parameters["backlash.half_gap"] == pytest.approx(HALF_GAP, rel=0.03)


@pytest.mark.parametrize("delay_s", [1e-3, 2e-3])
def test_a_gap_behind_a_converter_is_named_and_leaves_noise(delay_s: float) -> None:
    found = diagnose([recording(HALF_GAP, lambda torque: np.roll(torque, round(8 * RATE_HZ * delay_s)))], BASE)
    first = found.candidates[0]
    assert first.effect == "backlash"
    assert first.nrmse_after < 1.3 * found.error.noise_floor_nrmse
    assert first.parameters["backlash.half_gap"] == pytest.approx(HALF_GAP, rel=0.03)


def test_a_gap_behind_two_filters_is_named_and_leaves_noise() -> None:
    found = diagnose([recording(HALF_GAP, lambda torque: filtered(filtered(torque, 1e-3), 1e-3))], BASE)
    first = found.candidates[0]
    assert first.effect == "backlash"
    assert first.nrmse_after < 1.3 * found.error.noise_floor_nrmse
    assert first.parameters["backlash.half_gap"] == pytest.approx(HALF_GAP, rel=0.03)


def test_a_healthy_gear_is_adequate_and_its_sensor_called_late() -> None:
    made = recording(0.0)
    found = diagnose([made], BASE)
    assert found.verdict == "adequate"
    for warnings in (found.warnings, compare([made], BASE).warnings):
        line = next(row for row in warnings if "torque_out_Nm" in row)
        told_ms = float(line.split("at least ")[1].split(" ms")[0])
        assert told_ms == pytest.approx(1e3 * (LAG_S - DAMPING / STIFFNESS), rel=0.1)


def test_the_lag_is_no_effect_of_the_model() -> None:
    fitted = compare([recording(0.0)], BASE).model
    assert [row.name for row in fitted.effects] == ["linear_stiffness", "viscous_damping"]
