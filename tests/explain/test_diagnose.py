"""Diagnosis of recordings from the simulated drive, which shares no code with the catalogue."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.catalogue import find
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.compare import compare
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.results import Diagnosis
from edge_daemon.rig.recording import Simulated, simulate
from edge_daemon.search.order import tied

pytestmark = pytest.mark.slow

SECONDS = 12.0


@cache
def recording(effects: tuple[str, ...], bits_out: int = 24, motion: str = "rich", seed: int = 3) -> Simulated:
    return simulate(effects, SECONDS, seed=seed, bits_out=bits_out, motion=motion)


def base_model(made: Simulated) -> Model:
    inertia = made.truth["parameters"]["inertia_kg_m2"]  # type: ignore[index]
    return Model("torsion", 100.0, inertia, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))


@cache
def diagnosis(effects: tuple[str, ...], bits_out: int = 24, motion: str = "rich", seed: int = 3) -> Diagnosis:
    made = recording(effects, bits_out, motion, seed)
    return diagnose([made], base_model(made))


@pytest.mark.parametrize(
    ("hidden", "partner", "bits_out"),
    [
        ("coulomb_friction", "", 20),
        ("lugre_friction", "", 24),
        ("bouc_wen_hysteresis", "", 24),
        ("asymmetric_hysteresis", "", 24),
        ("backlash", "piecewise_stiffness", 24),
        ("polynomial_stiffness", "", 20),
        ("kinematic_error", "", 24),
        ("gravity_load", "encoder_eccentricity", 24),
        ("constant_load", "", 20),
        ("encoder_skew", "output_viscous_friction", 24),
        ("temperature_stiffness", "", 20),
    ],
)
def test_names_what_was_hidden(hidden: str, partner: str, bits_out: int) -> None:
    found = diagnosis((hidden,), bits_out)
    first = found.candidates[0]
    assert found.verdict == "missing"
    if first.effect == partner:
        assert hidden in first.confused_with
        first = next(row for row in found.candidates if row.effect == hidden)
    assert first.effect == hidden
    assert first.nrmse_after < 0.15 * first.nrmse_before
    assert first.nrmse_after < 5 * found.error.noise_floor_nrmse
    if first.nrmse_after > 2 * found.error.noise_floor_nrmse:  # something of the law is not as it is
        assert first.probability < 0.8


def test_names_a_pair() -> None:
    found = diagnosis(("kinematic_error", "coulomb_friction"))
    assert set(found.candidates[0].effect.split("+")) == {"kinematic_error", "coulomb_friction"}
    assert found.candidates[0].probability > 0.8


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("bits_out", [24, 20])
def test_a_healthy_drive_is_adequate(seed: int, bits_out: int) -> None:
    found = diagnosis((), bits_out, seed=seed)
    assert found.verdict == "adequate"
    assert found.candidates == () and found.next_experiment is None
    assert found.error.nrmse == pytest.approx(found.error.noise_floor_nrmse, rel=0.1)


@pytest.mark.parametrize("name", ["", "coulomb_friction", "backlash", "kinematic_error"])
def test_two_seconds_tell_what_they_can(name: str) -> None:
    recording = simulate((name,) if name else (), 2.0, seed=5)
    found = diagnose([recording], base_model(recording))
    assert [row.effect for row in found.candidates[:1]] == ([name] if name else [])
    assert found.verdict == ("missing" if name else "adequate")


def test_an_effect_outside_the_catalogue_stays_unexplained() -> None:
    found = diagnosis(("outside_twist_times_angle",))
    assert found.verdict == "unexplained"
    assert found.where[0].axis == "twist x output angle" and found.where[0].share > 0.5
    assert all(row.probability < 0.5 for row in found.candidates)


def test_one_sine_is_never_believed_for_certain() -> None:
    for effects in (("gravity_load",), ("encoder_skew",)):
        found = diagnosis(effects, motion="poor")
        assert all(row.probability < 0.9 for row in found.candidates)


def test_what_cannot_be_told_apart_gets_an_experiment() -> None:
    found = diagnosis(("gravity_load",))
    assert {"gravity_load", "encoder_eccentricity"} <= {found.candidates[0].effect, *found.candidates[0].confused_with}
    experiment = found.next_experiment
    assert experiment is not None and "payload" in experiment.motion
    reach = sum(v / (2 * np.pi * f) for f, v in zip(experiment.tones_hz, experiment.speeds_in_rad_s, strict=True)) / 100
    assert reach <= experiment.limits["travel_rad"] * 1.001
    assert sum(experiment.speeds_in_rad_s) <= experiment.limits["motor_speed_rad_s"] * 1.001


@pytest.mark.parametrize(
    ("other", "level", "rmse", "rivals"),
    [
        ("encoder_eccentricity", 1.05, 0.0105, True),
        ("encoder_eccentricity", 5.0, 0.0102, True),  # held against a floor of its own, it leaves as much
        ("encoder_eccentricity", 5.0, 0.02, False),
        ("backlash", 5.0, 0.0122, False),
        ("backlash", 0.6, 0.006, True),  # both are noise
    ],
)
def test_twins_are_rivals_by_what_they_leave(other: str, level: float, rmse: float, rivals: bool) -> None:
    terms = [SimpleNamespace(effect=find(name, "torsion")) for name in ("coulomb_friction", "gravity_load", other)]
    fitted = SimpleNamespace(terms=terms)
    one = SimpleNamespace(added=("coulomb_friction", "gravity_load"), error=0.01, rmse=0.01, floor=0.011)
    two = SimpleNamespace(added=("coulomb_friction", other), error=rmse, rmse=rmse, floor=rmse / level)
    one.solution = two.solution = fitted
    assert tied(one, two) == tied(two, one) == rivals  # type: ignore[arg-type]


def test_json_is_the_contract() -> None:
    said = json.loads(json.dumps(diagnosis(("gravity_load",)).to_json(), allow_nan=False))
    assert {"verdict", "error", "candidates", "next_experiment"} <= set(said)
    assert set(said["error"]) == {"nrmse", "noise_floor_nrmse", "rmse", "unit"}
    assert {"effect", "nrmse_before", "nrmse_after", "probability", "confused_with", "parameters"} <= set(
        said["candidates"][0]
    )


def test_adding_the_effect_takes_the_error_to_the_floor_and_writes_history() -> None:
    made = recording(("kinematic_error",))
    added = add_effect(base_model(made), "kinematic_error", [made], "shift.csv")
    assert added.after.nrmse < 2 * added.after.noise_floor_nrmse < 0.05 * added.before.nrmse
    assert [row.change for row in added.model.lineage] == ["fit", "add kinematic_error"]
    assert added.model.lineage[-1].nrmse == added.after.nrmse
    assert "stiffness" in [row.name for row in added.moved]
    truth = made.truth["parameters"]
    fitted = added.model.effect("kinematic_error")
    assert fitted is not None
    size = np.hypot(fitted.value("sine_2"), fitted.value("cosine_2"))
    assert size == pytest.approx(truth["kinematic_error.order2_rad"], rel=0.01)  # type: ignore[index]
    again = diagnose([made], added.model)
    assert again.verdict == "adequate"


def test_compare_says_where() -> None:
    made = recording(("kinematic_error",))
    said = compare([made], base_model(made))
    assert said.error.nrmse > 50 * said.error.noise_floor_nrmse
    assert said.where[0].axis == "input angle" and "2 (" in said.where[0].detail
    assert said.where[0].share > 0.5
    order = next(row for row in said.spectra if row.axis == "input order")
    assert order.at[np.argmax(order.amplitude)] == pytest.approx(2.0, abs=0.06)
    json.dumps(said.to_json(), allow_nan=False)


def test_compare_of_a_healthy_drive_finds_no_structure() -> None:
    made = recording(())
    said = compare([made], base_model(made))
    assert all(row.share < 0.05 for row in said.where)
    truth = made.truth["parameters"]
    line = next(row for row in said.parameters if row.name == "stiffness")
    assert line.identified and line.value == pytest.approx(truth["stiffness_Nm_per_rad"], rel=5e-4)  # type: ignore[index]
    assert min(row.probability for row in said.tests) > 0.005


def test_several_recordings_leave_one_out() -> None:
    one, two = (simulate(("constant_load",), 9.0, seed=s, parameters=SAME) for s in (1, 2))
    found = diagnose([one, two], base_model(one))
    assert found.verdict == "missing" and found.candidates[0].effect == "constant_load"


def test_recordings_given_in_another_order_than_they_were_made_say_the_same() -> None:
    """Of two days, the younger first: time runs backwards from one to the other, and is no time to fill."""
    made = recording(("kinematic_error",))
    later = replace(made, time_s=made.time_s + 86_400.0)
    there, back = (compare(order, base_model(made)).where for order in ([made, later], [later, made]))
    assert [(row.axis, row.share) for row in there] == [(row.axis, pytest.approx(row.share, abs=0.01)) for row in back]


SAME = {
    "inertia_kg_m2": 0.1,
    "stiffness_Nm_per_rad": 3e4,
    "damping_Nms_per_rad": 6.0,
    "constant_load.load_Nm": 1.5,
}
