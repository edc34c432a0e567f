"""A current that was not read when the angle was: joints of another hand, whose logger is late or early."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.balance import channel_delay
from edge_daemon.balance.channel_delay import delay_of, speed_delay_of
from edge_daemon.balance.preparation import prepare
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.identify.fit import fit
from tests.explain.simulated_drives import RATIO, Arm, Sensing, record

pytestmark = pytest.mark.slow

KNOWN = ("inertia", "viscous_friction", "coulomb_friction", "gravity_load")
PLAIN = Arm(weight_Nm=12.0)
ROBOT = Sensing(rate_hz=125.0, bits=19, noise=0.02, step=0.01, jitter=0.2, velocity_rad_s=2e-4)
MODEL = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, KNOWN)))
RIPPLE = replace(PLAIN, waves=(("in", 1.0, 0.6, 1.4),))
STRIBECK, PRESLIDING = replace(PLAIN, stribeck_Nm=2.5), replace(PLAIN, bristle_rad=(4e-3,))


def late(arm: Arm, seconds: float, sensing: Sensing, seed: int = 1) -> SimpleNamespace:
    """A recording whose current is that of so many seconds ago."""
    read = record(arm, seed, sensing=sensing)
    columns = dict(read.columns)
    name = next(name for name in ("torque_in_Nm", "current_in_A") if name in columns)
    columns[name] = np.interp(read.time_s - seconds, read.time_s, columns[name])
    return SimpleNamespace(time_s=read.time_s, columns=columns)


@pytest.mark.parametrize("sensing", [Sensing(), ROBOT], ids=["servo", "robot"])
@pytest.mark.parametrize("seconds", [3e-3, -4e-3, 10e-3])
def test_a_delay_is_found_with_its_sign(seconds: float, sensing: Sensing) -> None:
    read = late(PLAIN, seconds, sensing)
    assert delay_of(prepare(read.time_s, read.columns, MODEL)) == pytest.approx(seconds, abs=2e-4)


@pytest.mark.parametrize("arm", [PLAIN, RIPPLE, STRIBECK, PRESLIDING])
@pytest.mark.parametrize("sensing", [Sensing(), ROBOT], ids=["servo", "robot"])
def test_no_law_of_the_gear_is_taken_for_a_delay(arm: Arm, sensing: Sensing) -> None:
    read = record(arm, 1, sensing=sensing)
    assert delay_of(prepare(read.time_s, read.columns, MODEL)) == 0.0


@pytest.mark.parametrize("sensing", [Sensing(), ROBOT], ids=["servo", "robot"])
@pytest.mark.parametrize("after_s", [0.2, 0.4])
def test_a_drag_that_trails_the_speed_is_no_delay(after_s: float, sensing: Sensing) -> None:
    read = record(PLAIN, 1, sensing=sensing)
    columns = dict(read.columns)
    name = next(name for name in ("torque_in_Nm", "current_in_A") if name in columns)
    speed = np.gradient(columns["theta_out_rad"], read.time_s)
    trailing, step = np.zeros(len(speed)), np.diff(read.time_s)
    for i, dt in enumerate(step, start=1):
        trailing[i] = trailing[i - 1] + (speed[i] - trailing[i - 1]) * -math.expm1(-dt / after_s)
    columns[name] = columns[name] + 0.5 * columns[name].std() / trailing.std() * trailing
    assert delay_of(prepare(read.time_s, columns, MODEL)) == 0.0


def test_a_late_current_is_told_and_nothing_else_is_named_for_it() -> None:
    found = diagnose([late(PLAIN, 5e-3, Sensing())], MODEL)
    assert found.verdict == "adequate"
    assert any("follows theta_out_rad by 5.0 ms" in line for line in found.warnings)


def test_what_is_missing_beside_a_delay_is_still_named() -> None:
    found = diagnose([late(replace(PLAIN, mesh=0.07), -5e-3, Sensing())], MODEL)
    assert found.verdict == "missing" and found.candidates[0].effect == "load_dependent_friction"
    told = [line.split(" by ")[1].split(" ms")[0] for line in found.warnings if "leads theta_out_rad" in line]
    assert [float(ms) for ms in told] == pytest.approx([5.0], abs=0.2)


def filtered(arm: Arm, seconds: float, bits: int) -> SimpleNamespace:
    """A recording whose speed has passed a filter of first order."""
    read = record(arm, 8, sensing=Sensing(rate_hz=250.0, bits=bits, noise=0.01, velocity_rad_s=1e-3))
    columns = {name: column for name, column in read.columns.items() if name != "temperature_degC"}
    kept, speed = math.exp(-1 / (250.0 * seconds)), columns["velocity_out_rad_s"].copy()
    for i in range(1, len(speed)):
        speed[i] = kept * speed[i - 1] + (1 - kept) * speed[i]
    return SimpleNamespace(time_s=read.time_s, columns=columns | {"velocity_out_rad_s": speed})


@pytest.mark.parametrize(
    ("seconds", "bits"), [(0.002, 20), (0.003, 20), (0.005, 14), (0.005, 20), (0.01, 14), (0.01, 20)]
)
def test_a_filtered_speed_is_as_late_as_its_filter(seconds: float, bits: int) -> None:
    read = filtered(PLAIN, seconds, bits)
    kept = math.exp(-1 / (250.0 * seconds))
    assert speed_delay_of(prepare(read.time_s, read.columns, MODEL)) == pytest.approx(
        kept / (1 - kept) / 250.0, abs=3e-4
    )
    plain = record(PLAIN, 8, sensing=ROBOT)
    assert speed_delay_of(prepare(plain.time_s, plain.columns, MODEL)) == 0.0


def test_a_filtered_speed_names_nothing_and_moves_no_torque() -> None:
    """Friction that turns before the speed does was told as presliding at 0.92, and the torque moved by 8 ms."""
    found = diagnose([filtered(replace(PLAIN, offset_Nm=1.5), 0.01, 14)], MODEL)
    assert found.candidates[0].effect in ("constant_torque", "asymmetric_friction")
    assert not any("torque_in_Nm" in line for line in found.warnings)
    known = MODEL.with_effect(ModelEffect("constant_torque"))
    assert diagnose([filtered(replace(PLAIN, offset_Nm=1.5), 0.01, 14)], known).verdict == "adequate"


def test_a_current_is_late_beside_a_controllers_model_torque() -> None:
    """Coupling by other joints is nearly all of an arm's torque: without the model torque no delay would be seen."""
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, 30.0, 0.0025)
    phase = [2 * math.pi * hz * time_s + shift for hz, shift in ((0.11, 0.3), (0.31, 1.1), (0.9, 2.0))]
    angle, speed = sum(np.sin(p) for p in phase), np.gradient(sum(np.sin(p) for p in phase), time_s)
    model_Nm = 30.0 * np.sin(2 * math.pi * 0.23 * time_s) + 15.0 * np.sin(2 * math.pi * 0.61 * time_s + 1.0)
    torque = model_Nm + 0.8 * np.gradient(speed, time_s) + 6.0 * speed + 7.0 * np.tanh(speed / 1e-3)
    current = np.interp(time_s - 0.004, time_s, torque) / RATIO + rng.normal(0, 5e-4, len(time_s))
    columns = {"theta_out_rad": angle, "torque_in_Nm": current, "torque_model_Nm": model_Nm}
    assert delay_of(prepare(time_s, columns, MODEL)) == pytest.approx(0.004, abs=2e-4)


def test_a_short_delay_is_found_beside_what_is_missing() -> None:
    """It left 20 noise floors beside the right law."""
    found = diagnose([late(STRIBECK, 1.2e-3, Sensing())], MODEL)
    assert found.candidates[0].effect == "stribeck_friction"
    assert found.candidates[0].nrmse_after < 1.2 * found.error.noise_floor_nrmse
    assert any("torque_in_Nm follows theta_out_rad by 1.2 ms" in line for line in found.warnings)


@pytest.mark.parametrize("seconds", [1.2e-3, 0.6e-3])
def test_a_short_delay_is_found_beside_a_model_that_lacks_nothing(seconds: float) -> None:
    """It leaves three noise floors, and was taken for a missing law."""
    fitted = fit([late(PLAIN, seconds, Sensing())], MODEL)
    assert fitted.problem.trials[0].late_s == pytest.approx({"torque_in_Nm": seconds}, abs=5e-5)
    assert fitted.solution.rmse < 1.3 * fitted.floor
    missing = fit([late(replace(PLAIN, mesh=0.07), seconds, Sensing())], MODEL)
    assert not missing.problem.trials[0].late_s


def test_ripple_that_no_column_holds_is_taken_for_no_delay() -> None:
    """At 2.0166 per motor turn a current seemed 9 ms early."""
    arm = replace(PLAIN, waves=(("between", 2.0 * 122 / 99, 1.3, 0.4),))
    for seed in (1, 2, 3):
        read = record(arm, seed, sensing=Sensing(rate_hz=250.0, bits=19, noise=0.002))
        assert delay_of(prepare(read.time_s, read.columns, MODEL)) == 0.0


@pytest.mark.parametrize(("seconds", "bits"), [(0.02, 20), (0.01, 20), (0.01, 14)])
def test_a_speed_that_its_filter_bends_is_left_out_where_the_angle_tells_more(seconds: float, bits: int) -> None:
    """Moved by its delay it left 2.6 floors of a filter of 8 ms, and of 20 ms 18 floors."""
    fitted = fit([filtered(PLAIN, seconds, bits)], MODEL)
    assert "velocity_out_rad_s" in fitted.problem.trials[0].left_out
    assert fitted.solution.rmse < 1.3 * fitted.floor
    assert any("left out" in line for line in fitted.problem.remarks)


def test_files_of_which_one_is_late_keep_their_blocks_apart() -> None:
    """The blocks of the others were numbered twice, and a command ended in a traceback."""
    files = [late(PLAIN, seconds, Sensing()) for seconds in (0.0, 1.2e-3, 0.0)]
    problem = fit(files, MODEL).problem
    assert np.array_equal(np.unique(problem.block), np.arange(len(problem.fold)))
    assert [trial.late_s for trial in problem.trials].count({}) == 2
    assert diagnose(files, MODEL).verdict == "adequate"


def test_files_that_turn_too_seldom_to_tell_a_delay_tell_it_together() -> None:
    """Each of three held less than four moves there and back, and 6 ms stayed: ripple that grows with the speed, and a
    load that swings at 1.00."""
    files = [late(PLAIN, 6e-3, Sensing(pace=0.1), seed) for seed in (1, 2, 3)]
    assert not any(fit([read], MODEL).problem.late_s[0] for read in files)
    assert [row["torque_in_Nm"] for row in fit(files, MODEL).problem.late_s] == pytest.approx([6e-3] * 3, abs=3e-4)


def test_a_file_that_turns_too_seldom_follows_one_that_tells_the_delay() -> None:
    """The one was moved and the other stayed: what set them apart was told as a formula of three summands."""
    files = [late(PLAIN, 6e-3, Sensing(), 1), late(PLAIN, 6e-3, Sensing(pace=0.1), 2)]
    assert not fit(files[1:], MODEL).problem.late_s[0]
    assert [row["torque_in_Nm"] for row in fit(files, MODEL).problem.late_s] == pytest.approx([6e-3] * 2, abs=3e-4)


def test_a_torque_stays_where_no_model_does_better_with_it_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a millisecond of one of three files, told by its own first look, undid in `add` what `diagnose` promised."""
    files = [record(PLAIN, seed) for seed in (1, 2)]
    monkeypatch.setattr(channel_delay, "known_delays_of", lambda trials, modelled, torque, *_: {torque: 8e-4})
    assert not any(fit(files, MODEL).problem.late_s)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_model_torque_that_is_as_late_as_the_motors_is_moved_with_it(seed: int) -> None:
    """The two were in step with each other, so that the motor's alone seemed hardly late; what was left was told as a
    load that swings, at 0.99, and beside ripple as one that grows with speed."""
    read = record(PLAIN, seed, sensing=Sensing(noise=0.05))
    others = 30.0 * np.sin(2.1 * read.time_s) + 20.0 * np.sin(7.3 * read.time_s)
    true = {
        "torque_in_Nm": read.columns["torque_in_Nm"] + others / RATIO,
        "torque_model_Nm": PLAIN.weight_Nm * np.sin(read.columns["theta_out_rad"]) + others,
    }
    model = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, (*KNOWN[:3], "model_torque"))))
    for late_s in (4e-3, 0.0):
        columns = {name: np.interp(read.time_s - late_s, read.time_s, column) for name, column in true.items()}
        joint = SimpleNamespace(time_s=read.time_s, columns=read.columns | columns)
        (found,) = fit([joint], model).problem.late_s
        assert found == pytest.approx(dict.fromkeys(true, late_s) if late_s else {}, abs=3e-4)
        assert diagnose([joint], model).verdict == "adequate"
