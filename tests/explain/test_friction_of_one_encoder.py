"""Forms of friction and of the load, told apart with one encoder."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.balance.reversals import unknown_directions, without_unknown
from edge_daemon.discover.discover import discover
from edge_daemon.effects.catalogue import find
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose, missing_effects, searched
from edge_daemon.identify.fit import fit
from edge_daemon.identify.problem import problem_of
from edge_daemon.identify.solution import Term
from edge_daemon.motion.kinematics import filters
from edge_daemon.search.grid_fit import refined
from tests.explain import simulated_drives
from tests.explain.one_encoder import (
    KNOWN,
    MESH,
    PLAIN,
    RIPPLE,
    RIPPLE_NAME,
    carried,
    first_named,
    model,
    named_in_steps,
    stairs,
)
from tests.explain.simulated_drives import RATIO, Arm, Joint, Sensing, record

pytestmark = pytest.mark.slow


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


@pytest.mark.parametrize(
    ("arm", "rubs", "parameter", "true"),
    [
        (Arm(coulomb_Nm=4.0, stribeck_Nm=3.0, stribeck_rad_s=0.1), "stribeck_friction", "stribeck_speed", 0.1),
        (Arm(coulomb_Nm=4.0, mesh=0.2), "load_dependent_friction", "coefficient", 0.2),
    ],
)
def test_all_dry_friction_builds_up_over_the_angle_that_presliding_takes(
    arm: Arm, rubs: str, parameter: str, true: float
) -> None:
    """With the sign of the speed in its place friction at creep left 12 noise floors, and was not named, and friction
    of the load 24."""
    arm = replace(arm, weight_Nm=12.0, bristle_rad=(5e-4, 1.5e-3, 4.5e-3, 1.35e-2))
    recording, names = record(arm, 3), ("maxwell_slip_hysteresis", rubs)
    fitted = fit([recording], model(*names))
    assert fitted.solution.rmse < 1.4 * fitted.floor
    assert fitted.model.value(rubs, parameter) == pytest.approx(true, rel=0.02)
    _, found = searched([recording], model())
    assert set(found[0].added) == set(names)


def test_a_shape_that_went_astray_is_called_back_beside_what_was_missing() -> None:
    """Beside the right loop a drag of the model stayed where it had gone without it, at 42 noise floors, and several
    elements were named instead."""
    arm = Arm(viscous_Nms=3.0, coulomb_Nm=15.0, bristle_rad=(4e-3,), root_Nm=4.0, root_exponent=2.0)
    assert first_named(arm, 3, "inertia", "viscous_friction", "superlinear_friction") == "hysteresis"


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


def test_two_plain_laws_near_the_noise_are_told_rather_than_a_form_of_the_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside one law that all but explains no second was looked for: friction of the load by who drives, at 0.55."""
    monkeypatch.setattr(simulated_drives, "course", stairs)
    arm = Arm(weight_Nm=115.0, viscous_Nms=10.0, mesh=0.08, stribeck_Nm=6.0, stribeck_rad_s=0.07)
    found = diagnose([record(arm, 1, 40.0, Sensing(rate_hz=250.0, noise=0.06))], model())
    assert found.candidates[0].effect == "load_dependent_friction+stribeck_friction"
    assert found.candidates[0].probability > 0.9


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
    swinging = bare.with_effect(ModelEffect("joint_elasticity"))  # a part of the inertia stands against nothing
    for had in (bare, swinging):
        assert not rarer & {effect.name for effect in missing_effects(had, problem)}
    assert "squared_load_friction" in {effect.name for effect in missing_effects(model(), problem)}


def test_two_laws_of_the_catalogue_are_not_outbid_by_the_same_two_in_other_words() -> None:
    """A ripple of twelve numbers and dry friction were believed at 0.00 beside `a*v/(1 + abs(v)/6e-06)` and a sine."""
    had = Model("drive", RATIO, math.nan, tuple(ModelEffect(row) for row in KNOWN if row != "coulomb_friction"))
    found = discover([record(replace(RIPPLE, coulomb_Nm=1.0), 5)], had)
    assert set(found.candidates[0].effect.split("+")) == {"coulomb_friction", RIPPLE_NAME}
    assert found.candidates[0].probability > 0.9 and not found.proposals


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


def test_oil_that_thins_over_many_kelvins_is_one_effect() -> None:
    """By a straight line of the temperature a sixth of the error was left, and a formula was told for it."""
    read = record(PLAIN, 8, 25.0)
    speed, _ = carried(read, PLAIN)
    degc = -36.0 + 34.0 * read.time_s / read.time_s[-1]
    drag = 1.5 / RATIO
    more = drag * np.exp(-0.04 * degc) * speed
    columns = {**read.columns, "torque_in_Nm": read.columns["torque_in_Nm"] + more, "temperature_degC": degc}
    found = discover([Joint(read.time_s, columns)], model())
    first = found.candidates[0]
    assert (found.verdict, first.effect, found.proposals) == ("missing", "temperature_friction", ())
    assert first.probability > 0.9 and first.nrmse_after < 1.3 * found.error.noise_floor_nrmse
    assert first.parameters["temperature_friction.fading"] == pytest.approx(0.04, rel=0.05)
    assert first.parameters["temperature_friction.slope"] == pytest.approx(
        -0.04 * drag * np.exp(-0.04 * 25.0), rel=0.15
    )


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
