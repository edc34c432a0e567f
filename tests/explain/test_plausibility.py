"""Recordings that cannot be what they claim."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.errors import BadInput
from edge_daemon.explain.add import with_added
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.plausibility import examine
from edge_daemon.identify.fit import fit
from edge_daemon.rig.recording import simulate

MODEL = Model("torsion", 100.0, 0.1, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
TIME = np.arange(20_000) / 1000.0
OUT = 0.5 * np.sin(2 * np.pi * 0.7 * TIME) + 0.02 * np.sin(2 * np.pi * 6 * TIME)


def made(time_s: np.ndarray = TIME, **columns: np.ndarray) -> SimpleNamespace:
    rows = {"theta_in_rad": 100 * OUT, "theta_out_rad": OUT} | columns
    return SimpleNamespace(time_s=time_s, columns=rows)


NAN = np.where(2 * np.arange(len(OUT)) < len(OUT), np.nan, OUT)


@pytest.mark.parametrize(
    ("recording", "says"),
    [
        (made(np.empty(0), theta_in_rad=np.empty(0), theta_out_rad=np.empty(0)), "0 rows"),
        (made(np.zeros(1), theta_in_rad=np.zeros(1), theta_out_rad=np.zeros(1)), "1 rows"),
        (made(theta_out_rad=np.full(len(OUT), 0.3)), "theta_out_rad: constant"),
        (made(theta_out_rad=NAN), "theta_out_rad: 50% of the rows hold no number"),
        (made(theta_out_rad=np.degrees(OUT)), "theta_out_rad looks like degrees"),
        (made(theta_in_rad=np.degrees(100 * OUT)), "theta_in_rad looks like degrees"),
        (made(theta_out_rad=-OUT), "wrong sign"),
        (made(theta_in_rad=OUT, theta_out_rad=100 * OUT), "look exchanged"),
        (made(torque_out_Nm=np.zeros(len(OUT))), "torque_out_Nm: constant 0"),
        (made(theta_in_rad=OUT), "referred to the output"),
        (SimpleNamespace(time_s=TIME, columns={"theta_out_rad": OUT}), "theta_in_rad: missing"),
        (SimpleNamespace(time_s=1e3 * TIME, columns={"torque_out_Nm": OUT}), "looks like milliseconds"),
        (made(TIME[:900], theta_in_rad=100 * OUT[:900], theta_out_rad=OUT[:900]), "expected at least"),
    ],
)
def test_refused_in_one_line(recording: SimpleNamespace, says: str) -> None:
    with pytest.raises(BadInput, match=says) as caught:
        diagnose([recording], MODEL)
    assert "\n" not in str(caught.value)


def test_a_missing_angle_is_refused_in_one_line_by_a_fit_as_well() -> None:
    for name, angle in (("theta_in_rad", "theta_out_rad"), ("theta_out_rad", "theta_in_rad")):
        with pytest.raises(BadInput, match=f"{name}: missing"):
            fit([SimpleNamespace(time_s=TIME, columns={angle: OUT})], MODEL)


def slow(interval_s: float, motor_rad_s: float) -> SimpleNamespace:
    """A joint with one encoder that swings slowly, by the stamps as they are."""
    time_s = interval_s * np.arange(2000)
    out = motor_rad_s / 100.0 * 0.02 * np.sin(50.0 / (2000 * interval_s) * time_s) * (2000 * interval_s)
    torque = np.sign(np.gradient(out)) + 0.3 * np.sin(out)
    return SimpleNamespace(time_s=time_s, columns={"theta_out_rad": out, "torque_in_Nm": torque})


@pytest.mark.parametrize(("interval_s", "motor_rad_s"), [(0.1, 0.5), (0.5, 8.0), (2.0, 8.0)])
def test_a_telescopes_log_is_slow_and_no_other_unit(interval_s: float, motor_rad_s: float) -> None:
    """Ten rows a second were refused as milliseconds; as those the motor would turn faster than any, or the logger."""
    said = examine([slow(interval_s, motor_rad_s)], Model("drive", 100.0, math.nan, (ModelEffect("inertia"),)))
    assert not any("time_s" in line for line in said)


@pytest.mark.parametrize(("interval_s", "unit"), [(1.0, "milliseconds"), (8.0, "milliseconds"), (2e3, "microseconds")])
def test_a_fast_log_in_another_unit_is_told(interval_s: float, unit: str) -> None:
    with pytest.raises(BadInput, match=f"looks like {unit}"):
        examine([slow(interval_s, 1e-4)], Model("drive", 100.0, math.nan, (ModelEffect("inertia"),)))


def test_both_angles_in_degrees_are_doubted() -> None:
    fast = made(theta_in_rad=np.degrees(100 * OUT), theta_out_rad=np.degrees(OUT))
    assert any("degrees" in line for line in examine([fast], MODEL))


def test_a_few_missing_rows_are_said() -> None:
    holes = OUT.copy()
    holes[100:120] = np.nan
    assert any("theta_out_rad: 0.1%" in line for line in examine([made(theta_out_rad=holes)], MODEL))


def test_unknown_effect_names_the_closest() -> None:
    with pytest.raises(BadInput, match="did you mean 'backlash'"):
        with_added(MODEL, "backlsh")
    with pytest.raises(BadInput, match="has it already"):
        with_added(MODEL, "viscous_damping")


def test_encoders_with_different_zeros_give_the_same_stiffness_and_a_word() -> None:
    simulated = simulate(["kinematic_error"], seconds=10.0, seed=4)
    known: Mapping[str, float] = simulated.truth["parameters"]  # type: ignore[assignment]
    model = Model("torsion", known["ratio"], known["inertia_kg_m2"], (*MODEL.effects, ModelEffect("kinematic_error")))
    turned = dict(simulated.columns, theta_out_rad=simulated.columns["theta_out_rad"] + 1.9)
    moved = SimpleNamespace(time_s=simulated.time_s, columns=turned)
    assert not examine([simulated], model)
    assert ["zeros are -1.9 rad apart" in line for line in examine([moved], model)] == [True]
    found = fit([moved], model).solution.amplitude("linear_stiffness", "stiffness")
    assert found == pytest.approx(known["stiffness_Nm_per_rad"], rel=1e-3)


def test_a_law_of_the_clock_is_doubted_in_a_word() -> None:
    """A motion follows the same clock: what other joints asked of one was told by it, and nothing said so."""
    passed = ModelEffect("fades", {}, "a * velocity_out_rad_s * exp(-since(time_s, velocity_out_rad_s))")
    warms = ModelEffect("warms", {}, "a * velocity_out_rad_s * exp(-0.1*time_s)")
    told = examine([made()], Model("torsion", 100.0, 0.1, (*MODEL.effects, passed, warms)))
    assert [line.partition(": ")[0] for line in told] == ["warms"]


def test_a_motors_torque_that_is_not_used_is_said() -> None:
    """An arm's weight is no inertia: 99 % of its torque was left without a word."""
    model, current = Model("torsion", 100.0, 0.1, MODEL.effects), made(current_in_A=np.ones(len(OUT)))
    (line,) = examine([current], model)
    assert line.startswith("current_in_A is not used") and "--map torque_in_Nm=current_in_A*CONSTANT" in line
    assert not examine([made()], model)


def test_a_torque_reckoned_from_the_motors_stands_for_no_sensor_behind_the_gear() -> None:
    """It would explain all that the motor does, and tell nothing of the gear."""
    motor = np.sin(2 * np.pi * 0.7 * TIME) + 0.3 * np.sign(np.cos(2 * np.pi * 0.7 * TIME))
    sensor = 100 * np.sin(2 * np.pi * 0.7 * TIME)
    drive = Model("drive", 100.0, np.nan, (ModelEffect("inertia"),))
    told = [
        [line for line in examine([made(torque_in_Nm=motor, torque_out_Nm=behind)], drive) if "torque_out_Nm" in line]
        for behind in (sensor, 80 * motor + 0.3, np.full(len(TIME), 2.0))
    ]
    assert [len(lines) for lines in told] == [1, 0, 0] and "stands for torque_model_Nm" in told[0][0]


def test_a_sensor_whose_torque_falls_as_the_twist_grows_has_the_wrong_sign() -> None:
    """It was explained by nothing at 114 % of error, or by a formula of the torque itself."""
    torque = 40.0 * np.sin(OUT + 0.4)
    there = made(theta_in_rad=100 * (OUT + torque / 2e4), torque_out_Nm=torque)
    assert not any("sign" in line for line in examine([there], MODEL))
    with pytest.raises(BadInput, match="wrong sign: --map torque_out_Nm=-torque_out_Nm"):
        examine([made(theta_in_rad=100 * (OUT + torque / 2e4), torque_out_Nm=-torque)], MODEL)


@pytest.mark.filterwarnings("error")
def test_a_sensor_that_tells_nothing_has_no_sign() -> None:
    """A mean of no sample was a warning of a library's."""
    assert examine([made(torque_out_Nm=np.full(len(OUT), np.nan))], MODEL)
