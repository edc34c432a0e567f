"""One encoder and the motor's torque: joints of another hand, whose friction is a budget that is clipped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from edge_daemon.balance.reversals import unknown_directions, without_unknown
from edge_daemon.discover.discover import discover
from edge_daemon.effects.catalogue import find
from edge_daemon.effects.effect import Wave
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect, helps
from edge_daemon.explain.diagnose import diagnose, missing_effects, searched
from edge_daemon.identify.fit import fit
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.identify.regression import RegressionProblem, Term
from edge_daemon.motion.kinematics import filters
from edge_daemon.records import Array, Recorded
from edge_daemon.search.free_orders import further, with_orders
from edge_daemon.search.grid_fit import refined
from tests.explain import simulated_drives
from tests.explain.simulated_drives import PLAIN_SENSING, RATIO, STEP_S, Arm, Joint, Sensing, record

pytestmark = pytest.mark.slow

KNOWN = ("inertia", "viscous_friction", "coulomb_friction", "gravity_load")
PLAIN = Arm(weight_Nm=12.0)
RIPPLE = replace(PLAIN, waves=(("in", 2.0, 0.3, 0.4),))
RIPPLE_NAME = "wave_generator_ripple"
MESH = replace(PLAIN, mesh=0.07)


def model(*more: str) -> Model:
    return Model("drive", RATIO, math.nan, tuple(ModelEffect(name) for name in (*KNOWN, *more)))


@pytest.mark.parametrize(
    ("arm", "more"), [(PLAIN, ()), (RIPPLE, ("wave_generator_ripple",)), (MESH, ("load_dependent_friction",))]
)
def test_the_exact_model_leaves_noise_alone(arm: Arm, more: tuple[str, ...]) -> None:
    fitted = fit([record(arm, 3)], model(*more))
    assert 0.8 < fitted.solution.rmse / fitted.floor < 1.5
    at_motor = {"inertia": ("inertia", arm.inertia_kg_m2), "viscous_friction": ("coefficient", arm.viscous_Nms)}
    for name, (parameter, value) in at_motor.items():
        assert fitted.model.value(name, parameter) == pytest.approx(value / RATIO, rel=0.01)


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


def low_passed(recording: Joint, share: float) -> Joint:
    """The same with a current whose noise ends at 25 Hz, below every band that is quiet."""
    rng, torque = np.random.default_rng(8), recording.columns["torque_in_Nm"]
    noise = sosfilt(butter(2, 25.0, fs=500.0, output="sos"), rng.normal(size=len(torque)))
    heard = torque + share * torque.std() * noise / noise.std()
    return Joint(recording.time_s, recording.columns | {"torque_in_Nm": heard})


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


@pytest.mark.parametrize("weight_Nm", [12.0, 60.0])
def test_friction_of_motor_and_load_is_told_from_that_of_the_load(weight_Nm: float) -> None:
    """As measured actuators have it: the motor's torque holds friction and inertia besides, and no gain stands in."""
    arm = replace(PLAIN, weight_Nm=weight_Nm, coulomb_Nm=3.47, viscous_Nms=1.21)
    recording = record(replace(arm, actuator={"motor": 0.063, "load": 0.063}), 1)
    found = diagnose([recording], model("load_dependent_friction"))
    first = found.candidates[0]
    assert found.verdict == "missing" and first.effect == "two_sided_load_friction" and first.probability > 0.9
    assert first.nrmse_after < 0.2 * first.nrmse_before
    assert first.parameters["two_sided_load_friction.coefficient"] == pytest.approx(0.063, rel=0.03)


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_friction_of_the_whole_motor_torque_is_exact_and_takes_the_place_of_load_friction(share: float) -> None:
    """The motor's torque holds drag and this friction itself; what stands against it outside may count or not."""
    arm = replace(PLAIN, weight_Nm=40.0, coulomb_Nm=4.83, viscous_Nms=7.4)
    recording = record(replace(arm, actuator={"motor": 0.148, "load": 0.148 * share}), 1)
    added = add_effect(model("load_dependent_friction"), "two_sided_load_friction", [recording])
    assert added.after.nrmse < 1.5 * added.after.noise_floor_nrmse
    row = added.model.effect("two_sided_load_friction")
    assert row is not None and row.value("coefficient") == pytest.approx(0.148, rel=0.02)
    assert row.value("external_share") == pytest.approx(share, abs=0.05)
    assert added.model.effect("load_dependent_friction") is None
    assert any(line.startswith("load_dependent_friction: left out") for line in added.warnings)
    assert diagnose([recording], added.model).verdict == "adequate"


def test_a_load_that_a_short_way_hardly_tells_is_fitted_with_its_friction() -> None:
    """A weight beside a constant: repeated fits went round, left 54 floors and a third of the friction."""
    arm = replace(PLAIN, weight_Nm=60.0, offset_Nm=3.0, mesh=0.2, coulomb_Nm=2.0)
    fitted = fit([record(arm, 5, 20.0, Sensing(pace=10.0))], model("constant_torque", "load_dependent_friction"))
    assert fitted.solution.rmse < 3 * fitted.floor
    assert fitted.model.value("load_dependent_friction", "coefficient") == pytest.approx(arm.mesh, rel=0.02)
    assert RATIO * fitted.model.value("constant_torque", "torque") == pytest.approx(arm.offset_Nm, rel=0.05)
    assert RATIO * fitted.model.value("gravity_load", "sine") == pytest.approx(arm.weight_Nm, rel=0.02)


def test_load_friction_that_is_that_of_the_load_gets_no_other_form() -> None:
    found = diagnose([record(replace(MESH, weight_Nm=60.0), 1)], model("load_dependent_friction"))
    assert found.verdict == "adequate"


def test_orders_that_overlap_are_named_by_what_turns_so_often() -> None:
    """Half a turn of the output does not resolve 198 from 200 in it."""
    arm = replace(PLAIN, waves=(("between", 2.0, 0.5, 2.1), ("in", 2.0, 0.4, 0.4)))
    fitted = fit([record(arm, 4)], model())
    found = with_orders(find("wave_generator_ripple", "drive"), fitted.solution, fitted.problem)
    assert found is not None and set(found.waves) == {Wave("input", 2.0), Wave("difference", 2.0)}


@pytest.mark.parametrize(
    ("arm", "name"),
    [
        (replace(PLAIN, coulomb_Nm=3.0, root_Nm=4.0), "sublinear_friction"),
        (replace(PLAIN, stribeck_Nm=3.0, stribeck_rad_s=0.15), "stribeck_friction"),
        (replace(PLAIN, root_Nm=4.0, root_exponent=2.0), "superlinear_friction"),
        (replace(PLAIN, root_Nm=3.0, root_exponent=3.0), "superlinear_friction"),
    ],
)
def test_a_robot_log_tells_churning_from_creep(arm: Arm, name: str) -> None:
    sensing = Sensing(rate_hz=125.0, bits=19, noise=0.02, step=0.01, jitter=0.2, velocity_rad_s=2e-4)
    found = diagnose([record(arm, 1, sensing=sensing)], model())
    assert found.candidates[0].effect == name


@pytest.mark.parametrize("excess", [0.0, 1.0])
def test_a_floor_that_was_taken_too_high_hides_no_friction(excess: float) -> None:
    """The exact model leaves 0.84 of it here, and what lacks a tenth of the error is below it as well."""
    arm = Arm(
        inertia_kg_m2=0.6, weight_Nm=40.0, viscous_Nms=1.7, coulomb_Nm=3.2, stribeck_Nm=excess, stribeck_rad_s=0.08
    )
    recording = record(arm, 153, sensing=Sensing(rate_hz=100.0, noise=0.02, step=0.01, jitter=0.1))
    fitted, found = fit([recording], model()), diagnose([recording], model())
    assert fitted.solution.rmse < fitted.floor
    assert [row.effect for row in found.candidates[:1]] == (["stribeck_friction"] if excess else [])


def test_a_load_below_the_noise_floor_is_named_where_every_block_has_it() -> None:
    arm = Arm(inertia_kg_m2=1.1, weight_Nm=40.0, viscous_Nms=9.1, coulomb_Nm=7.1, offset_Nm=1.7)
    sensing = Sensing(rate_hz=100.0, noise=0.01, jitter=0.3, velocity_rad_s=1e-3, pace=1.4)
    recording = record(arm, 521, sensing=sensing)
    fitted, found = fit([recording], model()), diagnose([recording], model())
    assert fitted.solution.rmse < fitted.floor
    assert found.verdict == "missing" and found.candidates[0].effect in ("constant_torque", "asymmetric_friction")


def test_a_single_sine_needs_no_known_weight_for_its_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Along one sine weight and inertia are nearly one function, and the noise of the acceleration is there all the
    same."""
    monkeypatch.setattr(simulated_drives, "TONES_HZ", (0.5,))
    monkeypatch.setattr(simulated_drives, "SPEEDS_RAD_S", (1.0,))
    fitted = fit([record(PLAIN, 2)], model())
    assert fitted.solution.rmse < 3 * fitted.floor
    assert fitted.model.value("inertia", "inertia") == pytest.approx(PLAIN.inertia_kg_m2 / RATIO, rel=0.01)


def test_what_friction_does_in_an_unsure_sample_leaves_no_trace() -> None:
    rng = np.random.default_rng(5)
    fir = filters(rate_hz=1000.0, cutoff_hz=60.0)
    unsure = np.zeros(1000, dtype=bool)
    unsure[[200, 201, 202, 260]] = unsure[600:640] = True
    rows = np.flatnonzero(~unsure)
    directions = unknown_directions(unsure, rows, fir.value)
    whatever = np.where(unsure, rng.normal(0, 100, 1000), 0.0)
    spread = np.convolve(whatever, fir.value, mode="same")[rows]
    assert np.abs(without_unknown(spread, directions)).max() < 0.02 * np.abs(spread).max()
    law = np.sin(np.arange(1000) / 40.0)[rows]
    assert np.mean(without_unknown(law, directions) ** 2) > 0.9 * np.mean(law**2)


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


def test_orders_of_a_pair_are_those_beside_its_other_part() -> None:
    """Below drag that the model lacks, a line was called by its neighbour, and the promised error was not reached."""
    arm = replace(PLAIN, viscous_Nms=15.0, waves=(("between", 2.0, 0.6, 1.0),))
    recording = record(arm, 6, sensing=Sensing(rate_hz=250.0, bits=19, noise=0.002))
    known = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", "coulomb_friction", "gravity_load"))))
    added = add_effect(known, "viscous_friction+wave_generator_ripple", [recording])
    row = added.model.effect("wave_generator_ripple")
    assert row is not None and row.waves == (Wave("difference", 2.0),)
    assert added.after.nrmse < 1.5 * added.after.noise_floor_nrmse


def test_further_orders_of_a_pair_are_those_beside_its_other_part() -> None:
    """What was named was refused: below the drag that came with it no further order stood out."""
    arm = replace(PLAIN, viscous_Nms=15.0, waves=(("in", 2.0, 0.6, 1.0), ("in", 5.0, 0.05, 0.4)))
    recording = record(arm, 6, sensing=Sensing(rate_hz=250.0, bits=19, noise=0.002))
    ripple = ModelEffect("wave_generator_ripple", waves=(Wave("input", 2.0),))
    rest = map(ModelEffect, ("inertia", "coulomb_friction", "gravity_load"))
    added = add_effect(
        Model("drive", RATIO, math.nan, (*rest, ripple)), "viscous_friction+wave_generator_ripple", [recording]
    )
    row = added.model.effect("wave_generator_ripple")
    assert row is not None and row.waves == (Wave("input", 2.0), Wave("input", 5.0))


@pytest.mark.parametrize("seed", [2, 3])
def test_shapes_that_pull_at_each_other_are_fitted_to_the_end(seed: int) -> None:
    """Exact models left 10 and 12 times what they leave now, so that whatever was added seemed to be missing."""
    arm = Arm(viscous_Nms=0.0, bristle_rad=(8e-4,), root_Nm=4.0, root_exponent=1.4)
    recording = record(arm, seed, 15.0, Sensing(rate_hz=100.0, bits=22))
    names = ("inertia", "hysteresis", "superlinear_friction")
    fitted = fit([recording], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, names)))).model
    assert fitted.value("superlinear_friction", "exponent") == pytest.approx(arm.root_exponent, rel=0.01)
    assert fitted.value("hysteresis", "width") == pytest.approx(arm.bristle_rad[0], rel=0.02)


def test_a_loop_of_several_elements_is_fitted_at_the_better_of_its_widths() -> None:
    """Where a search began beside the other one it ended there, at two noise floors."""
    arm = Arm(weight_Nm=0.0, viscous_Nms=3.0, coulomb_Nm=20.0, bristle_rad=(1e-4, 3e-4, 9e-4, 2.7e-3))
    recording = record(arm, 1, 15.0, Sensing(rate_hz=250.0, bits=20))
    names = ("inertia", "viscous_friction", "maxwell_slip_hysteresis")
    fitted = fit([recording], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, names))))
    assert fitted.solution.rmse < 1.3 * fitted.floor
    assert fitted.model.value("maxwell_slip_hysteresis", "width") == pytest.approx(1e-4, rel=0.5)


def first_named(arm: Arm, seed: int, *known: str) -> str:
    """What comes first of what a model of `known` effects lacks."""
    found = diagnose([record(arm, seed, 20.0)], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, known))))
    return found.candidates[0].effect if found.verdict == "missing" else found.verdict


def test_a_shape_that_went_astray_is_called_back_beside_what_was_missing() -> None:
    """Beside the right loop a drag of the model stayed where it had gone without it, at 42 noise floors, and several
    elements were named instead."""
    arm = Arm(viscous_Nms=3.0, coulomb_Nm=15.0, bristle_rad=(4e-3,), root_Nm=4.0, root_exponent=2.0)
    assert first_named(arm, 3, "inertia", "viscous_friction", "superlinear_friction") == "hysteresis"


@pytest.mark.parametrize("seed", [1, 4])
def test_what_is_nearly_alike_is_told_apart_by_searches_that_have_ended(seed: int) -> None:
    """An asymmetry was sure where a constant does better once the width of the slipping elements has come to rest."""
    arm = Arm(viscous_Nms=3.0, coulomb_Nm=20.0, bristle_rad=(1e-4, 3e-4, 9e-4, 2.7e-3), offset_Nm=8.0)
    assert first_named(arm, seed, "inertia", "viscous_friction", "maxwell_slip_hysteresis") == "constant_torque"


@pytest.mark.parametrize("seed", [2, 3])
def test_a_plainer_form_is_not_sure_of_itself_where_a_finer_one_does_better(seed: int) -> None:
    """Friction with a root of speed below the noise: viscous friction was named at 0.99 and 1.00, since the other
    waited for it."""
    arm = Arm(viscous_Nms=0.0, coulomb_Nm=8.0, root_Nm=2.0, root_exponent=0.6)
    recording = record(arm, seed, 15.0, Sensing(rate_hz=125.0, noise=0.08))
    known = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", "coulomb_friction"))))
    belief = {row.effect: row.probability for row in diagnose([recording], known).candidates}
    assert belief["sublinear_friction"] > 0.1 and belief["viscous_friction"] < 0.9


@pytest.mark.parametrize("seed", [1, 2])
def test_two_plain_laws_are_not_taken_for_the_finer_one_between_them(seed: int) -> None:
    """A power of the speed leaves little more than dry and viscous friction together, and much less than either."""
    recording = record(Arm(viscous_Nms=4.0), seed, 15.0, Sensing(rate_hz=125.0, noise=0.1))
    found = diagnose([recording], Model("drive", RATIO, math.nan, (ModelEffect("inertia"),)))
    assert found.candidates[0].effect == "coulomb_friction+viscous_friction"


def stairs(seconds: float, rng: np.random.Generator, pace: float = 1.0) -> tuple[Array, Array, Array]:
    """Constant speeds, one after the other, there and back."""
    levels = np.repeat((0.05, 0.1, 0.2, 0.35, 0.5, 0.8, 1.1), 2) * np.tile((1, -1), 7)
    t = np.arange(round(seconds / STEP_S)) * STEP_S
    smooth = np.ones(1000) / 1000
    speed = np.convolve(levels[(t / 1.6).astype(int) % 14] * np.minimum(1.0, t / 0.4), smooth, mode="same")
    return np.cumsum(speed) * STEP_S, speed, np.gradient(speed, STEP_S)


def named_in_steps(recording: Joint, *known: str) -> set[str]:
    """What diagnosis adds to a model, step by step."""
    now = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, known)))
    for _ in range(6):
        found = diagnose([recording], now)
        if found.verdict != "missing":
            break
        now = add_effect(now, found.candidates[0].effect, [recording]).model
    return {row.name for row in now.effects} - set(known)


@pytest.mark.parametrize(
    ("arm", "name"),
    [
        (Arm(inertia_kg_m2=1.2, weight_Nm=35.0, viscous_Nms=8.0, coulomb_Nm=7.0, stribeck_Nm=2.9, stribeck_rad_s=0.11),
         "stribeck_friction"),
        (Arm(inertia_kg_m2=1.2, weight_Nm=35.0, viscous_Nms=8.0, coulomb_Nm=7.0, root_Nm=4.0, root_exponent=2.0),
         "superlinear_friction"),
    ],
)  # fmt: skip
def test_forms_of_friction_over_speed_are_weighed_beside_drag(
    arm: Arm, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With drag in the same step friction at creep was named for drag that grows faster than speed."""
    monkeypatch.setattr(simulated_drives, "course", stairs)
    recording = record(arm, 1, 35.0, Sensing(bits=19, noise=0.002))
    assert named_in_steps(recording, "inertia", "coulomb_friction", "gravity_load") == {"viscous_friction", name}


def test_friction_with_the_square_of_the_load_gets_no_other_form_first() -> None:
    """It was offered only beside another form of load friction, which was named at 0.9 for it."""
    arm = replace(PLAIN, weight_Nm=40.0)
    read = record(arm, 2)
    load = arm.inertia_kg_m2 * np.gradient(np.gradient(read.columns["theta_out_rad"], read.time_s), read.time_s)
    load = np.convolve(load, np.ones(25) / 25, mode="same") + arm.weight_Nm * np.sin(read.columns["theta_out_rad"])
    speed = np.convolve(np.gradient(read.columns["theta_out_rad"], read.time_s), np.ones(5) / 5, mode="same")
    more = 4e-3 * load**2 * np.sign(speed) / RATIO
    columns = {**read.columns, "torque_in_Nm": read.columns["torque_in_Nm"] + more}
    found = diagnose([Joint(read.time_s, columns)], model())
    assert found.verdict == "missing" and found.candidates[0].effect == "squared_load_friction"


@pytest.mark.parametrize(
    ("had", "offered"), [((), False), (("load_dependent_friction",), True), (("two_sided_load_friction",), True)]
)
def test_load_friction_at_creep_waits_for_a_form_of_load_friction(had: tuple[str, ...], offered: bool) -> None:
    """Weighed from the first it was named for the dry friction of five stretches of real joints."""
    had_too = model(*had)
    problem = problem_of([record(PLAIN, 3, 8.0)], had_too)
    assert ("creep_load_friction" in {effect.name for effect in missing_effects(had_too, problem)}) == offered


def test_a_shape_of_the_model_that_went_astray_forbids_nothing_that_is_missing() -> None:
    """Without the weight, creep in the model lasted over all speeds, and everything was refused for it."""
    arm = replace(PLAIN, actuator={"creep": 0.15}, stribeck_rad_s=0.15)
    had = Model(
        "drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", "coulomb_friction", "creep_load_friction")))
    )
    search, _ = searched([record(arm, 1)], had)
    creep, weight = (find(name, "drive") for name in ("creep_load_friction", "gravity_load"))
    astray = Term(creep, {"creep_speed": 100.0 * search.speed_rad_s})
    rest = [term for term in search.base.solution.terms if term.effect.name != creep.name]
    solution = search.regression.solve([*rest, astray, Term(weight, {})])
    assert search.carried(search.hypothesis((weight.name,), solution))
    assert not search.carried(search.hypothesis((creep.name,), solution))


def test_presliding_is_weighed_at_once_where_a_joint_never_slips_and_nothing_else_is_found() -> None:
    """A fifth of a radian to and fro, elements that slip after a tenth: dry friction alone explains none of it."""
    arm = Arm(weight_Nm=12.0, viscous_Nms=2.0, coulomb_Nm=8.0, bristle_rad=(0.1,))
    known = Model("drive", RATIO, math.nan, tuple(ModelEffect(name) for name in (KNOWN[0], KNOWN[1], KNOWN[3])))
    found = diagnose([record(arm, 3, sensing=Sensing(pace=6.0))], known)
    assert found.verdict == "missing" and found.candidates[0].effect == "hysteresis"
    assert found.candidates[0].nrmse_after < 1.5 * found.error.noise_floor_nrmse < 0.1 * found.error.nrmse


@pytest.mark.parametrize(
    ("arm", "hidden", "name"),
    [
        (replace(PLAIN, bristle_rad=(2e-3, 8e-3)), "coulomb_friction", "maxwell_slip_hysteresis"),
        (replace(PLAIN, actuator={"creep": 0.15}, stribeck_rad_s=0.15), "", "creep_load_friction"),
    ],
)
def test_a_finer_form_that_leaves_noise_alone_waits_for_no_plainer_one(arm: Arm, hidden: str, name: str) -> None:
    """Dry friction was named at 1.00 for elements that slip, of which it left 3 to 13 noise floors, and friction at
    creep for that of the load there."""
    known = Model("drive", RATIO, math.nan, tuple(ModelEffect(row) for row in KNOWN if row != hidden))
    found = diagnose([record(arm, 9)], known)
    assert found.verdict == "missing" and found.candidates[0].effect == name
    assert found.candidates[0].nrmse_after < 0.3 * found.candidates[0].nrmse_before


@pytest.mark.parametrize("case", [2, 26])
def test_what_every_sample_says_is_named_below_a_floor_that_is_a_little_too_high(case: int) -> None:
    """An asymmetry takes a fourteenth of the error, the rest of which is noise, and was called noise."""
    sensing = Sensing(rate_hz=250.0, noise=0.02, step=0.01, memory_s=0.002, pace=1.4)
    arm = replace(PLAIN, weight_Nm=0.0, coulomb_Nm=5.0, asymmetry_Nm=1.7)
    found = diagnose([record(arm, case, sensing=sensing)], model())
    assert found.verdict == "missing"
    assert found.candidates[0].effect in ("constant_torque", "asymmetric_friction")


@pytest.mark.parametrize(
    ("arm", "name"), [(PLAIN, ""), (RIPPLE, "wave_generator_ripple"), (MESH, "load_dependent_friction")]
)
def test_two_seconds_tell_what_they_can(arm: Arm, name: str) -> None:
    found = diagnose([record(arm, 7, 2.0)], model())
    assert [row.effect for row in found.candidates[:1]] == ([name] if name else [])
    assert found.verdict == ("missing" if name else "adequate")


def test_a_promise_is_of_the_load_that_is_carried_with_it() -> None:
    """Columns of another model's load took what the effect's own do not: added, it left nine times as much."""
    search, found = searched([record(MESH, 4)], model())
    told = next(row for row in found if row.added == ("load_dependent_friction",))
    columns = told.solution.columns.copy()
    columns[:, -1] = search.regression.target - columns[:, :-1] @ np.concatenate(
        [told.solution.amplitudes[name] for name in KNOWN]
    )
    promised = search.hypothesis(told.added, search.regression.solution(told.solution.terms, columns))
    assert promised.error < 0.1 * told.error
    assert refined(search, promised).error == pytest.approx(told.error, rel=0.02)


def test_the_square_of_the_load_waits_for_a_load_beside_the_inertia() -> None:
    """Beside nothing but a rotor's inertia it was named at 0.92 for the ripple of a real joint."""
    bare = Model("drive", RATIO, math.nan, tuple(ModelEffect(name) for name in KNOWN[:3]))
    problem = problem_of([record(PLAIN, 3, 8.0)], bare)
    rarer = {"squared_load_friction", "two_sided_load_friction", "creep_load_friction"}
    assert not rarer & {effect.name for effect in missing_effects(bare, problem)}
    assert "squared_load_friction" in {effect.name for effect in missing_effects(model(), problem)}


def test_ripple_that_grows_with_the_load_is_told_from_ripple_that_does_not() -> None:
    read = record(replace(RIPPLE, weight_Nm=40.0), 2, 30.0)
    angle, rate_hz = read.columns["theta_out_rad"], PLAIN_SENSING.rate_hz
    even = np.convolve(angle, np.hanning(31) / np.hanning(31).sum(), mode="same")
    carried = 40.0 * np.sin(angle) + RIPPLE.inertia_kg_m2 * np.gradient(np.gradient(even)) * rate_hz**2
    carried[[*range(40), *range(-40, 0)]] = 0.0
    more = 0.06 * np.abs(carried) * np.sin(2 * RATIO * angle + 1.0) / RATIO
    columns = {**read.columns, "torque_in_Nm": read.columns["torque_in_Nm"] + more}
    assert named_in_steps(Joint(read.time_s, columns), *KNOWN) == {"wave_generator_ripple", "load_ripple"}


@pytest.mark.parametrize("seed", [1, 3])
def test_ripple_that_swells_over_the_output_is_no_ripple_of_the_load(seed: int) -> None:
    """Its side bands, an order of the output to either side, were offered as five orders that grow with the load."""
    own, beside = (3.0, 8.0), (-1 / RATIO, 0.0, 1 / RATIO)
    waves = tuple(("in", n + d, 0.4 if d else 1.0, 0.4 * n + 30 * d) for n in own for d in beside)
    problem = problem_of([record(replace(PLAIN, weight_Nm=25.0, waves=waves), seed)], model())
    ripple = find("wave_generator_ripple", "drive").over(tuple(Wave("input", n) for n in own))  # type: ignore[misc]
    solution = problem.fit([*terms_of(model(), problem), Term(ripple, {})])
    of_load, more = (with_orders(row, solution, problem) for row in (find("load_ripple", "drive"), further(ripple)))
    assert of_load is None or all(wave.angle == "input" and wave.order % 1 == 0 for wave in of_load.waves)
    assert more is not None and {wave.angle for wave in more.waves} == {"output"}


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


def test_two_laws_of_the_catalogue_are_not_outbid_by_the_same_two_in_other_words() -> None:
    """A ripple of twelve numbers and dry friction were believed at 0.00 beside `a*v/(1 + abs(v)/6e-06)` and a sine."""
    had = Model("drive", RATIO, math.nan, tuple(ModelEffect(row) for row in KNOWN if row != "coulomb_friction"))
    found = discover([record(replace(RIPPLE, coulomb_Nm=1.0), 5)], had)
    assert set(found.candidates[0].effect.split("+")) == {"coulomb_friction", RIPPLE_NAME}
    assert found.candidates[0].probability > 0.9 and not found.proposals


def test_a_logger_that_loses_two_frames_of_three_is_read_at_what_is_left() -> None:
    """Stamps 2 and 6 ms apart in turn: everything lay in gaps, and nothing was accepted."""
    whole = record(PLAIN, 4)
    kept = np.flatnonzero(np.arange(len(whole.time_s)) % 4 < 2)
    joint = Joint(whole.time_s[kept], {name: column[kept] for name, column in whole.columns.items()})
    fitted = fit([joint], model())
    assert any("frames were lost" in line for line in fitted.problem.remarks)
    assert fitted.model.value("inertia", "inertia") == pytest.approx(PLAIN.inertia_kg_m2 / RATIO, rel=0.03)
    assert fitted.solution.rmse < 2.0 * fitted.floor


def test_a_motion_that_goes_one_way_tells_no_ripple_of_either_direction() -> None:
    """Each wave and the same with the sign of the motion shared one amplitude, and none was identified."""
    whole = record(RIPPLE, 4, 30.0)
    speed = np.gradient(whole.columns["theta_out_rad"], whole.time_s)
    forward = speed > 0.3 * speed.std()
    columns = {name: np.where(forward, column, math.nan) for name, column in whole.columns.items()}
    fitted = fit([Joint(whole.time_s, columns)], model(RIPPLE_NAME))
    sizes = dict(zip([row.name for row in find(RIPPLE_NAME, "drive").amplitudes],
                     fitted.solution.amplitudes[RIPPLE_NAME], strict=True))  # fmt: skip
    assert math.hypot(sizes["sine_2"], sizes["cosine_2"]) == pytest.approx(0.3 / RATIO, rel=0.1)
    assert not any(size for name, size in sizes.items() if name.endswith("_directed"))


def test_ten_seconds_are_held_out_in_many_blocks() -> None:
    """Each of six held a part of the motion that no other had, and drag was not told from dry friction."""
    whole = record(PLAIN, 4)
    early = whole.time_s < whole.time_s[0] + 9.0
    joint = Joint(whole.time_s[early], {name: column[early] for name, column in whole.columns.items()})
    assert len(fit([joint], model()).solution.held_out) >= 12


def test_waves_that_cancel_each_other_are_no_ripple() -> None:
    """A motion that hardly ever goes back was explained by 84 A forward less 84 A with the sign of the motion."""
    search, _ = searched([record(RIPPLE, 4)], model())
    ripple = Term(find(RIPPLE_NAME, "drive"), {})
    solution = search.regression.solve([*search.base.solution.terms, ripple])
    assert search.carried(search.hypothesis((RIPPLE_NAME,), solution))
    large = solution.amplitudes[RIPPLE_NAME] + 100.0 * search.regression.rms
    astray = replace(solution, amplitudes={**solution.amplitudes, RIPPLE_NAME: large})
    assert not search.carried(search.hypothesis((RIPPLE_NAME,), astray))


def test_load_friction_at_creep_may_fall_by_a_plain_exponential() -> None:
    """By the square of the speed, as the law had it, 4.8 floors were left, and four effects were named for two."""
    arm = replace(PLAIN, weight_Nm=40.0, viscous_Nms=6.0)
    read = record(arm, 6)
    speed, load = carried(read, arm)
    more = 0.12 * np.abs(load) * np.exp(-np.abs(speed) / 0.25) * np.sign(speed) / RATIO
    columns = {**read.columns, "torque_in_Nm": read.columns["torque_in_Nm"] + more}
    known = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", "coulomb_friction", "gravity_load"))))
    found = diagnose([Joint(read.time_s, columns)], known)
    assert found.candidates[0].effect == "creep_load_friction+viscous_friction"
    assert found.candidates[0].parameters["creep_load_friction.exponent"] == 1.0
    assert found.candidates[0].parameters["creep_load_friction.creep_speed"] == pytest.approx(0.25, rel=0.1)


def carried(read: Joint, arm: Arm) -> tuple[Array, Array]:
    """Speed, and what passes the gear, by the smoothed motion; nought at the ends, where that is unknown."""
    angle, rate_hz = read.columns["theta_out_rad"], PLAIN_SENSING.rate_hz
    even = np.convolve(angle, np.hanning(31) / np.hanning(31).sum(), mode="same")
    speed = np.gradient(even) * rate_hz
    load = arm.weight_Nm * np.sin(angle) + (1 - arm.rotor) * arm.inertia_kg_m2 * np.gradient(speed) * rate_hz
    load[[*range(40), *range(-40, 0)]] = 0.0
    return speed, load


def test_a_wave_of_few_periods_of_the_output_is_ripple_of_that() -> None:
    """Its broad line hides among its neighbours: the joint was called unexplained at 41 floors."""
    arm = replace(PLAIN, waves=(("out", 7.0, 0.6, 0.4),))
    recording = record(arm, 5)
    assert 2.0 < 7 * np.ptp(recording.columns["theta_out_rad"]) / (2 * math.pi) < 6.0
    found = diagnose([recording], model())
    assert found.candidates[0].effect == RIPPLE_NAME
    added = add_effect(model(), RIPPLE_NAME, [recording]).model.effect(RIPPLE_NAME)
    assert added is not None and [(wave.angle, wave.order) for wave in added.waves] == [("output", 7.0)]


@pytest.mark.parametrize("order", [1.417, 2.824])
def test_an_order_is_told_as_sharply_as_the_balance_hears_it(order: float) -> None:
    """A spectrum of waves that did not pass the balance's filter put 2.824 at 2.83, with five orders of the output to
    mend it, and 55 noise floors were left."""
    recording = record(replace(PLAIN, waves=(("in", order, 3.0, 0.4),)), 8, 12.0, Sensing(bits=24, noise=1e-4))
    done = add_effect(model(), RIPPLE_NAME, [recording])
    added = done.model.effect(RIPPLE_NAME)
    assert added is not None and [(wave.angle, wave.order) for wave in added.waves] == [("input", order)]
    assert done.after.nrmse < 1.5 * done.after.noise_floor_nrmse


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


def test_friction_of_the_load_that_grows_with_warmth_is_told_as_a_formula() -> None:
    """It was called load friction at 0.92, which left four fifths of it: no formula knew what passes the gear."""
    arm = replace(PLAIN, weight_Nm=40.0, rotor=0.3)
    read = record(arm, 4, 25.0)
    speed, load = carried(read, arm)
    warmth = 45.0 - 25.0 * np.exp(-read.time_s / 12.0)
    more = 5e-3 * (warmth - 25.0) * np.abs(load) * np.sign(speed) / RATIO
    columns = {**read.columns, "torque_in_Nm": read.columns["torque_in_Nm"] + more, "temperature_degC": warmth}
    joint = Joint(read.time_s, columns)
    found = discover([joint], model())
    best = found.proposals[0]
    assert best.probability > 0.9 and best.nrmse_after < 0.15 * found.error.nrmse
    assert "temperature_degC" in best.expression and "abs((transmitted_Nm - " in best.expression
    kept = add_effect(model(), "warm", [joint], expression=best.expression)
    assert kept.after.nrmse == pytest.approx(best.nrmse_after, rel=0.2)


def test_a_torque_is_not_moved_where_nothing_does_better_then(monkeypatch: pytest.MonkeyPatch) -> None:
    """Presliding that leads was taken for a torque that does: what compare left at one noise floor was unexplained at
    five."""
    recording = record(RIPPLE, 5, 15.0)
    columns = {**recording.columns, "torque_in_Nm": np.roll(recording.columns["torque_in_Nm"], 4)}
    late = Joint(recording.time_s, columns)

    def moved(recordings: Sequence[Recorded], now: Model, beside: Sequence[Sequence[Term]] = ()) -> RegressionProblem:
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


def test_a_stretch_without_power_is_judged_by_nobody() -> None:
    """A joint that was moved by hand, its current nought, was a model at twenty noise floors."""
    read = record(PLAIN, 8, 20.0)
    torque = read.columns["torque_in_Nm"].copy()
    torque[3000:5000] = 0.0
    found = diagnose([Joint(read.time_s, {**read.columns, "torque_in_Nm": torque})], model())
    assert found.verdict == "adequate"
    assert any(
        "torque_in_Nm is 0 from 6 to 9.998 s while the joint is moved: switched off" in line for line in found.warnings
    )
