"""One encoder and the motor's torque: joints of another hand, whose friction is a budget that is clipped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from edge_daemon.balance.reversals import unknown_directions, without_unknown
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import helps
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.results import ExplainError
from edge_daemon.identify.fit import fit
from edge_daemon.identify.problem import problem_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import Term
from edge_daemon.motion.kinematics import filters
from edge_daemon.records import Recorded
from tests.explain import simulated_drives
from tests.explain.one_encoder import KNOWN, MESH, PLAIN, RIPPLE, RIPPLE_NAME, first_named, low_passed, model
from tests.explain.simulated_drives import RATIO, Arm, Joint, Sensing, record

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("arm", "more"), [(PLAIN, ()), (RIPPLE, ("wave_generator_ripple",)), (MESH, ("load_dependent_friction",))]
)
def test_the_exact_model_leaves_noise_alone(arm: Arm, more: tuple[str, ...]) -> None:
    fitted = fit([record(arm, 3)], model(*more))
    assert 0.8 < fitted.solution.rmse / fitted.floor < 1.5
    at_motor = {"inertia": ("inertia", arm.inertia_kg_m2), "viscous_friction": ("coefficient", arm.viscous_Nms)}
    for name, (parameter, value) in at_motor.items():
        assert fitted.model.value(name, parameter) == pytest.approx(value / RATIO, rel=0.01)


@pytest.mark.parametrize("encoder", ["theta_in_rad", "theta_out_rad"])
def test_a_motor_that_turns_against_the_output_gives_the_same_numbers(encoder: str) -> None:
    """Its angle and its torque are its own, as its drive logs them; the ratio of a flexspline output is below 0."""
    joint = record(MESH, 3)
    angle, torque = joint.columns["theta_out_rad"], joint.columns["torque_in_Nm"]
    turned = {"theta_in_rad": -RATIO * angle, "theta_out_rad": angle}[encoder]
    known = model("load_dependent_friction")
    rows = [
        ({encoder: turned, "torque_in_Nm": -torque}, -RATIO),
        ({"theta_out_rad": angle, "torque_in_Nm": torque}, RATIO),
    ]
    one, other = (fit([Joint(joint.time_s, columns)], replace(known, ratio=ratio)) for columns, ratio in rows)
    for effect, name in (("inertia", "inertia"), ("coulomb_friction", "friction")):
        assert one.model.value(effect, name) == pytest.approx(other.model.value(effect, name), rel=1e-6)
    with pytest.raises(ExplainError, match="wrong sign: --map torque_in_Nm=-torque_in_Nm"):
        diagnose([Joint(joint.time_s, {encoder: turned, "torque_in_Nm": torque})], replace(known, ratio=-RATIO))


@pytest.mark.parametrize(
    ("arm", "name"), [(PLAIN, ""), (RIPPLE, "wave_generator_ripple"), (MESH, "load_dependent_friction")]
)
def test_small_ripple_and_load_friction_are_seen_and_nothing_where_nothing_is(arm: Arm, name: str) -> None:
    found = diagnose([record(arm, 4)], model())
    assert found.verdict == ("missing" if name else "adequate")
    if name:
        assert found.candidates[0].effect == name
        assert found.candidates[0].probability > 0.9
        assert found.candidates[0].nrmse_after < 1.5 * found.error.noise_floor_nrmse


@pytest.mark.parametrize(("arm", "name"), [(PLAIN, ""), (RIPPLE, "wave_generator_ripple")])
def test_low_passed_noise_of_a_current_is_no_error_of_the_model(arm: Arm, name: str) -> None:
    recording = low_passed(record(arm, 4), 0.004)
    fitted, found = fit([recording], model()), diagnose([recording], model())
    level = fitted.solution.rmse / fitted.floor
    assert level > 3.0 if name else level < 1.5
    assert found.verdict == ("missing" if name else "adequate")
    if name:
        assert found.candidates[0].effect == name
        assert found.candidates[0].nrmse_after < 1.5 * found.error.noise_floor_nrmse


def test_fits_of_other_samples_are_held_against_each_other_on_the_same() -> None:
    """A torque that is moved beside the larger model may lose a block: what the effect does ended in a traceback."""
    recording = record(RIPPLE, 4)
    less = Joint(recording.time_s[:-900], {name: column[:-900] for name, column in recording.columns.items()})
    before = fit([less], model())
    assert len(before.solution.held_out) < len(fit([recording], model()).solution.held_out)
    assert helps(before, fit([recording], model("wave_generator_ripple")))
    assert not helps(before, fit([recording], model("constant_torque")))


def test_an_encoder_at_the_motor_is_enough() -> None:
    recording = record(RIPPLE, 4)
    at_motor = Joint(recording.time_s, dict(recording.columns))
    at_motor.columns["theta_in_rad"] = RATIO * at_motor.columns.pop("theta_out_rad")
    found, same = diagnose([at_motor], model()), diagnose([recording], model())
    assert found.candidates[0].effect == "wave_generator_ripple"
    assert found.error.rmse == pytest.approx(same.error.rmse, rel=1e-3)
    assert any("the output's angle is theta_in_rad over the ratio" in line for line in found.warnings)


def test_a_single_sine_needs_no_known_weight_for_its_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Along one sine weight and inertia are nearly one function, and the noise of the acceleration is there all the
    same."""
    monkeypatch.setattr(simulated_drives, "TONES_HZ", (0.5,))
    monkeypatch.setattr(simulated_drives, "SPEEDS_RAD_S", (1.0,))
    fitted = fit([record(PLAIN, 2)], model())
    assert fitted.solution.rmse < 3 * fitted.floor
    assert fitted.model.value("inertia", "inertia") == pytest.approx(PLAIN.inertia_kg_m2 / RATIO, rel=0.01)


def test_thousands_of_unsure_samples_leave_next_to_nothing_either() -> None:
    """All their directions at once took half a minute. In each rest friction goes from one value to another."""
    fir = filters(rate_hz=1000.0, cutoff_hz=60.0)
    unsure = np.arange(6000) // 10 % 3 == 0
    rows = np.flatnonzero(~unsure)
    held = np.random.default_rng(5).normal(0, 100, 601)
    whatever = np.where(unsure, np.interp(np.arange(6000), 10.0 * np.arange(601), held), 0.0)
    spread = np.convolve(whatever, fir.value, mode="same")[rows]
    left = without_unknown(spread, unknown_directions(unsure, rows, fir.value))
    assert np.sqrt(np.mean(left**2)) < 0.02 * np.sqrt(np.mean(spread**2))


@pytest.mark.parametrize("seed", [1, 4])
def test_what_is_nearly_alike_is_told_apart_by_searches_that_have_ended(seed: int) -> None:
    """An asymmetry was sure where a constant does better once the width of the slipping elements has come to rest."""
    arm = Arm(viscous_Nms=3.0, coulomb_Nm=20.0, bristle_rad=(1e-4, 3e-4, 9e-4, 2.7e-3), offset_Nm=8.0)
    assert first_named(arm, seed, "inertia", "viscous_friction", "maxwell_slip_hysteresis") == "constant_torque"


@pytest.mark.parametrize("case", [2, 26])
def test_what_every_sample_says_is_named_below_a_floor_that_is_a_little_too_high(case: int) -> None:
    """An asymmetry takes a fourteenth of the error, the rest of which is noise, and was called noise."""
    sensing = Sensing(rate_hz=250.0, noise=0.02, step=0.01, memory_s=0.002, pace=1.4)
    arm = replace(PLAIN, weight_Nm=0.0, coulomb_Nm=5.0, asymmetry_Nm=1.7)
    found = diagnose([record(arm, case, sensing=sensing)], model())
    assert found.verdict == "missing"
    assert found.candidates[0].effect in ("constant_torque", "asymmetric_friction")


@pytest.mark.parametrize("memory_s", [0.0, 0.01])
def test_a_filtered_current_leaves_no_more_than_its_noise(memory_s: float) -> None:
    """Near half the sampling rate an averaged current is quiet: the exact model seemed to leave ten times the noise."""
    read = record(PLAIN, 5, sensing=Sensing(rate_hz=400.0, noise=0.01, memory_s=memory_s))
    torque = np.convolve(read.columns["torque_in_Nm"], np.ones(3) / 3, mode="same")
    found = diagnose([Joint(read.time_s, {**read.columns, "torque_in_Nm": torque})], model())
    assert found.verdict == "adequate" and found.error.nrmse < 2.5 * found.error.noise_floor_nrmse


def test_an_inertia_that_the_controller_reckons_brings_no_noise_of_the_speed() -> None:
    """Taken as the joint's own it put the floor at eight times the noise, below which load friction was not seen."""
    rng = np.random.default_rng(2)
    time_s = np.arange(0.0, 40.0, 0.01)
    speed = sum(
        size * np.sin(2 * math.pi * hz * time_s + shift)
        for size, hz, shift in ((0.5, 0.11, 0.3), (0.4, 0.31, 1.1), (0.3, 0.7, 2.0))
    )
    angle, reckoned = np.cumsum(speed) * 0.01, 20.0 * np.gradient(speed, time_s)
    load = reckoned + 0.5 * np.gradient(speed, time_s)
    torque = load + 3.0 * speed + (2.0 + 0.08 * np.abs(load)) * np.tanh(speed / 2e-3)
    columns = {
        "theta_out_rad": angle,
        "velocity_out_rad_s": speed + rng.normal(0, 1.5e-3, len(speed)),
        "torque_in_Nm": torque + rng.normal(0, 0.03, len(speed)),
        "torque_model_Nm": reckoned,
    }
    fitted = fit([Joint(time_s, columns)], model("model_torque", "load_dependent_friction"))
    assert 0.7 < fitted.solution.rmse / fitted.floor < 1.5


def test_two_laws_are_named_at_once_though_one_waits_for_the_plain_form() -> None:
    """The plain law was named alone, at 1.00, and left 3 to 50 noise floors."""
    had = Model("drive", RATIO, math.nan, tuple(ModelEffect(row) for row in KNOWN if row != "viscous_friction"))
    found = diagnose([record(replace(PLAIN, mesh=0.15), 7)], had)
    assert found.verdict == "missing"
    assert found.candidates[0].effect == "load_dependent_friction+viscous_friction"
    assert found.candidates[0].probability > 0.9
    assert found.candidates[0].nrmse_after < 1.5 * found.error.noise_floor_nrmse


def test_a_logger_that_loses_two_frames_of_three_is_read_at_what_is_left() -> None:
    """Stamps 2 and 6 ms apart in turn: everything lay in gaps, and nothing was accepted."""
    whole = record(PLAIN, 4)
    kept = np.flatnonzero(np.arange(len(whole.time_s)) % 4 < 2)
    joint = Joint(whole.time_s[kept], {name: column[kept] for name, column in whole.columns.items()})
    fitted = fit([joint], model())
    assert any("frames were lost" in line for line in fitted.problem.remarks)
    assert fitted.model.value("inertia", "inertia") == pytest.approx(PLAIN.inertia_kg_m2 / RATIO, rel=0.03)
    assert fitted.solution.rmse < 2.0 * fitted.floor


def test_ten_seconds_are_held_out_in_many_blocks() -> None:
    """Each of six held a part of the motion that no other had, and drag was not told from dry friction."""
    whole = record(PLAIN, 4)
    early = whole.time_s < whole.time_s[0] + 9.0
    joint = Joint(whole.time_s[early], {name: column[early] for name, column in whole.columns.items()})
    assert len(fit([joint], model()).solution.held_out) >= 12


def test_what_takes_next_to_nothing_of_noise_is_no_missing_effect() -> None:
    """A ripple of a fifth of the noise, sure by its samples, was named at 1.00 although the model was at its noise."""
    arm = replace(PLAIN, waves=(("in", 2.0, 0.04, 0.4),))
    found = diagnose([record(arm, 3, 60.0, Sensing(noise=0.02))], model())
    assert found.verdict == "adequate"
    assert found.error.nrmse < 1.25 * found.error.noise_floor_nrmse


def test_a_floor_is_no_higher_than_what_an_explanation_leaves() -> None:
    """What load friction does at reversals sounds like noise: the exact pair left a twentieth of that."""
    arm = Arm(weight_Nm=20.0, viscous_Nms=8.0, coulomb_Nm=3.0, mesh=0.2, rotor=0.2)
    recording = record(arm, 3, 20.0, Sensing(rate_hz=125.0, bits=17, velocity_rad_s=2e-3))
    known = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", "viscous_friction", "gravity_load"))))
    found = diagnose([recording], known)
    assert found.candidates[0].effect == "coulomb_friction+load_dependent_friction"
    assert 0.9 < found.candidates[0].nrmse_after / found.error.noise_floor_nrmse < 1.5


def test_a_torque_is_not_moved_where_nothing_does_better_then(monkeypatch: pytest.MonkeyPatch) -> None:
    """Presliding that leads was taken for a torque that does: what compare left at one noise floor was unexplained at
    five."""
    recording = record(RIPPLE, 5, 15.0)
    columns = {**recording.columns, "torque_in_Nm": np.roll(recording.columns["torque_in_Nm"], 4)}
    late = Joint(recording.time_s, columns)

    def moved(
        recordings: Sequence[Recorded], now: Model, beside: Sequence[Sequence[Term]] = (), held_against: bool = False
    ) -> RegressionProblem:
        return problem_of([late], now, as_read=bool(beside))

    monkeypatch.setattr("edge_daemon.explain.diagnose.problem_of", moved)
    monkeypatch.setattr("edge_daemon.explain.diagnose.may_be_late", lambda search, found: True)
    found = diagnose([late], model())
    assert found.candidates[0].effect == RIPPLE_NAME
    assert found.candidates[0].nrmse_after < 1.2 * found.error.noise_floor_nrmse


def test_stamps_that_err_make_no_slow_motion_unsure() -> None:
    """They move a fast joint far and a slow one hardly: heard as noise of the encoder they made the direction unsure up
    to a speed at which a joint no longer sticks, and a model without that was adequate."""
    read = record(Arm(weight_Nm=20.0), 7, 25.0, Sensing(rate_hz=125.0, noise=3e-3))
    stamps = read.time_s + 4e-4 * np.random.default_rng(1).normal(size=len(read.time_s))
    exact, shaken = (problem_of([Joint(t, read.columns)], model()).trials[0] for t in (read.time_s, stamps))
    assert np.count_nonzero(shaken.unsure) < 1.3 * np.count_nonzero(exact.unsure)
    noisy = read.columns["theta_out_rad"] + 3e-4 * np.random.default_rng(2).normal(size=len(read.time_s))
    encoder = problem_of([Joint(read.time_s, {**read.columns, "theta_out_rad": noisy})], model()).trials[0]
    assert np.count_nonzero(encoder.unsure) > 1.5 * np.count_nonzero(exact.unsure)
    coarse = 2e-2 * np.round(read.columns["theta_out_rad"] / 2e-2)  # rests where it is slow: that is no small noise
    stepped = problem_of([Joint(read.time_s, {**read.columns, "theta_out_rad": coarse})], model()).trials[0]
    assert np.count_nonzero(stepped.unsure) > 1.5 * np.count_nonzero(exact.unsure)


@pytest.mark.parametrize(("off", "told"), [((3000, 5000), "6 to 9.998"), ((8000, 10000), "16 to 19.998")])
def test_a_stretch_without_power_is_judged_by_nobody(off: tuple[int, int], told: str) -> None:
    """A joint that was moved by hand, its current nought, was a model at twenty noise floors; one that fell at the end
    was held against the last torque that was known."""
    read = record(PLAIN, 8, 20.0)
    torque = read.columns["torque_in_Nm"].copy()
    torque[slice(*off)] = 0.0
    found = diagnose([Joint(read.time_s, {**read.columns, "torque_in_Nm": torque})], model())
    assert found.verdict == "adequate"
    line = f"torque_in_Nm is 0 from {told} s while the joint is moved: switched off"
    assert any(line in row for row in found.warnings)


@pytest.mark.parametrize("when_it_changes", [False, True])
def test_a_temperature_that_is_read_seldom_does_not_stop_a_recording(when_it_changes: bool) -> None:
    """Once a second between rows without it, or now and then: all of a log lay in gaps, and was refused."""
    read, model_of_it = record(PLAIN, 8, 20.0), model()
    rows = np.arange(len(read.time_s))
    written = np.isin(rows, [0, 60, 150, 2000, 2050, 6100, 6200, 9700, 9999]) if when_it_changes else rows % 500 == 0
    told = np.where(written, 25.0 + 10.0 * rows / len(rows), np.nan)
    problem = problem_of([Joint(read.time_s, {**read.columns, "temperature_degC": told})], model_of_it)
    assert len(problem.target) == len(problem_of([read], model_of_it).target)
    felt = problem.motions[0].temperature_degC
    assert felt is not None
    np.testing.assert_allclose(felt[:-500], 25.0 + 10.0 * rows[: len(felt) - 500] / len(rows), atol=0.05)


@pytest.mark.parametrize("channels", [2, 5])
def test_channels_that_come_in_turn_are_one_recording(channels: int) -> None:
    """A row for each frame of a bus: more than thirty in a hundred without an angle were refused."""
    read = record(Arm(weight_Nm=20.0), 7, 40.0)
    turn = np.arange(len(read.time_s)) % channels
    apart = {name: np.where(turn == i, column, np.nan) for i, (name, column) in enumerate(read.columns.items())}
    lacking = replace(model(), effects=tuple(row for row in model().effects if row.name != "gravity_load"))
    found = diagnose([Joint(read.time_s, apart)], lacking)
    assert found.verdict == "missing" and found.candidates[0].effect == "gravity_load"
    assert found.candidates[0].nrmse_after < 1.5 * found.error.noise_floor_nrmse
    line = f"comes every {channels / 500.0:.3g} s: all is read at that rate"
    assert any(line in row for row in found.warnings) and not any("bridged" in row for row in found.warnings)


def test_a_log_that_a_simulation_wrote_is_read() -> None:
    """Nothing at all was left of its torque, and the root of a rounding error below nought was asked for."""
    time_s = np.arange(5000) / 500.0
    angle, speed = (
        sum(a * w**k * f(w * time_s) for a, w in ((0.8, 1.9), (0.2, 5.3))) for k, f in ((0, np.sin), (1, np.cos))
    )
    columns = {"theta_out_rad": angle, "velocity_out_rad_s": speed, "torque_in_Nm": 0.02 * speed + 0.1 * np.sin(angle)}
    model_of_it = Model("drive", 100.0, math.nan, tuple(map(ModelEffect, ("inertia", "viscous_friction"))))
    found = diagnose([Joint(time_s, columns)], model_of_it)
    assert found.candidates[0].effect == "gravity_load"


def test_a_motor_that_plays_a_spring_has_an_inertia_beside_a_sensor_of_the_load() -> None:
    """Its torque is all but a function of the angle, whatever accelerates the joint: a fiftieth of the inertia was seen
    at a first look, little noise of the acceleration weighed, and the exact model seemed to leave many noise floors."""
    rng, time_s = np.random.default_rng(5), np.arange(15000) / 500.0
    waves = [(size, 2 * math.pi * hz, rng.uniform(0, 6)) for size, hz in ((0.9, 0.31), (0.35, 0.83), (0.12, 2.3))]
    angle, speed, acceleration = (
        sum(size * w**k * np.sin(w * time_s + phase + k * math.pi / 2) for size, w, phase in waves) for k in range(3)
    )
    motor = -7.5 * angle + 3e-3 * acceleration
    load = motor - 0.16 * acceleration - 0.75 * speed - 1.15 * np.sign(speed)
    step = 2 * math.pi / 4096 / 50
    columns = {
        "theta_out_rad": step * np.rint(angle / step + 0.3 * rng.normal(size=len(angle))),
        "torque_model_Nm": load + 5e-3 * rng.normal(size=len(load)),
        "torque_in_Nm": (motor + 5e-3 * rng.normal(size=len(load))) / 50.0,
    }
    names = ("inertia", "model_torque", "viscous_friction", "coulomb_friction")
    fitted = fit([Joint(time_s, columns)], Model("drive", 50.0, math.nan, tuple(map(ModelEffect, names))))
    assert 50.0 * fitted.solution.amplitude("inertia", "inertia") == pytest.approx(0.16, rel=0.02)
    assert fitted.solution.rmse < 1.5 * fitted.floor


def test_an_offset_is_told_with_the_law_beside_it_as_far_as_it_is_believed() -> None:
    """An offset that takes a quarter of what a drag leaves waited until that was added."""
    rng, time_s = np.random.default_rng(5), np.arange(15000) / 500.0
    waves = [(size, 2 * math.pi * hz, rng.uniform(0, 6)) for size, hz in ((0.9, 0.31), (0.35, 0.83), (0.12, 2.3))]
    angle, speed, acceleration = (
        sum(size * w**k * np.sin(w * time_s + phase + k * math.pi / 2) for size, w, phase in waves) for k in range(3)
    )
    dirt = sosfiltfilt(butter(2, 3.0, fs=500.0, output="sos"), rng.normal(size=len(angle)))
    torque = 0.4 * acceleration + 2.0 * speed + 3.0 * np.sign(speed) + 0.25 * speed * np.abs(speed)
    torque += 0.08 + 0.12 * dirt / dirt.std()
    step, seen, felt = 2 * math.pi / 2**18, 0.3 * rng.normal(size=len(angle)), 0.04 * rng.normal(size=len(angle))
    read = {"theta_out_rad": step * np.rint(angle / step + seen), "torque_in_Nm": (torque + felt) / RATIO}
    names = ("inertia", "viscous_friction", "coulomb_friction")
    found = diagnose([Joint(time_s, read)], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, names))))
    told = {row.effect: row.probability for row in found.candidates}
    both = sum(told[f"{offset}+superlinear_friction"] for offset in ("constant_torque", "asymmetric_friction"))
    assert found.verdict == "missing" and 0.9 < both < 0.99 and told["superlinear_friction"] > 0.01
