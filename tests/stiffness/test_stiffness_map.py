"""K(phi) against the simulated drive's own spring, which is integrated by other code."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.commands.stiffness_map import command, maker_ranges, verdict
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.errors import BadInput
from edge_daemon.explain.add import extended
from edge_daemon.identify.fit import fit
from edge_daemon.rig.recording import Simulated, simulate
from edge_daemon.stiffness.stiffness_map import StiffnessMap, form_of, stiffness_map, straight
from edge_daemon.usage.gears import find_gear

pytestmark = pytest.mark.slow


def bare(simulated: Simulated) -> Model:
    known = simulated.truth["parameters"]
    effects = tuple(ModelEffect(name) for name in ("linear_stiffness", "viscous_damping"))
    return Model("torsion", known["ratio"], known["inertia_kg_m2"], effects)


@pytest.fixture(scope="module")
def cubic() -> tuple[Simulated, StiffnessMap]:
    simulated = simulate(["polynomial_stiffness"], seconds=12.0, seed=3)
    return simulated, stiffness_map([simulated], bare(simulated), extended)


def true_curve(simulated: Simulated, twist: np.ndarray) -> np.ndarray:
    known = simulated.truth["parameters"]
    k1, k2 = (known[f"polynomial_stiffness.{name}"] for name in ("k1_Nm_per_rad2", "k2_Nm_per_rad3"))
    return known["stiffness_Nm_per_rad"] + 2 * k1 * twist + 3 * k2 * twist**2


def test_the_form_that_is_true_is_named_and_is_right_within_its_band(cubic: tuple[Simulated, StiffnessMap]) -> None:
    simulated, found = cubic
    truth = true_curve(simulated, found.twist_rad)
    assert truth.max() > 1.3 * truth.min()
    assert found.best.name == "polynomial"
    apart = (found.best.stiffness_Nm_per_rad - truth) / found.best.sd_Nm_per_rad
    assert np.abs(apart).max() < 5
    assert np.abs(found.best.stiffness_Nm_per_rad / truth - 1).max() < 0.003
    assert "stiffens" in verdict(found) and "add polynomial_stiffness" in verdict(found)


@pytest.mark.parametrize("simulated", ["coulomb_friction", "stribeck_friction"])
def test_a_simulated_law_is_as_sure_in_the_map_as_in_the_fit(simulated: str) -> None:
    """Whether the numbers come from simulated angles or, where the law is another, from the torque, in which it errs
    alike in every block."""
    made = simulate([simulated], seconds=12.0, seed=11)
    base = bare(made)
    model = replace(base, effects=(*base.effects, ModelEffect("coulomb_friction")))
    found = fit([made], model)
    assert (found.sharp is not None) == (simulated == "coulomb_friction")
    linear = form_of("linear", found, found.solution, straight, np.array([-1e-4, 1e-4]))
    _, sd, _ = linear.numbers["linear_stiffness.stiffness"]
    told = found.model.effect("linear_stiffness")
    assert told is not None and sd == pytest.approx(told.parameters["stiffness"].sd, rel=1e-3)
    assert linear.sd_Nm_per_rad == pytest.approx(sd, rel=1e-3)


def test_a_table_follows_a_law_it_does_not_know(cubic: tuple[Simulated, StiffnessMap]) -> None:
    simulated, found = cubic
    by_name = {form.name: form for form in found.forms}
    truth = true_curve(simulated, found.twist_rad)
    apart = (by_name["table"].stiffness_Nm_per_rad - truth) / by_name["table"].sd_Nm_per_rad
    assert np.sqrt(np.mean(apart**2)) < 2
    assert np.sqrt(np.mean((by_name["table"].stiffness_Nm_per_rad / truth - 1) ** 2)) < 0.02
    assert np.sqrt(np.mean((by_name["linear"].stiffness_Nm_per_rad / truth - 1) ** 2)) > 0.1


def test_the_makers_ranges_stand_beside_it_where_the_torque_reached_them(
    cubic: tuple[Simulated, StiffnessMap],
) -> None:
    _, found = cubic
    ranges = maker_ranges(found, find_gear("CSG-20-100"))
    assert [row.name for row in ranges] == ["K1", "K2", "K3"]
    assert ranges[0].maker_Nm_per_rad == pytest.approx(1.6e4)
    assert ranges[0].found is not None and ranges[2].found is None


def test_the_command_writes_what_it_shows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulated = simulate([], seconds=9.0, seed=5)
    recording, model = tmp_path / "rec.csv", tmp_path / "m.toml"
    names = ["time_s", *simulated.columns]
    table = np.column_stack([simulated.time_s, *simulated.columns.values()])
    np.savetxt(recording, table, delimiter=",", header=",".join(names), comments="", fmt="%.12g")
    known = simulated.truth["parameters"]
    model.write_text(
        f'[joint]\nbalance = "torsion"\nratio = {known["ratio"]}\noutput_inertia_kg_m2 = {known["inertia_kg_m2"]}\n'
        '[[effect]]\nname = "linear_stiffness"\n[[effect]]\nname = "viscous_damping"\n'
    )
    found = tmp_path / "map.json"
    command(argparse.Namespace(recording=[recording], model=model, gear="CSG-20-100", json=str(found)))
    told = json.loads(found.read_text())
    assert told["best"] == "linear"
    assert told["forms"][0]["stiffness"][0] == pytest.approx(known["stiffness_Nm_per_rad"], rel=2e-3)
    assert "nothing is gained by a curve" in capsys.readouterr().out


@pytest.mark.parametrize("sd", [1e4, math.nan])
def test_a_bend_within_its_uncertainty_is_no_curve(cubic: tuple[Simulated, StiffnessMap], sd: float) -> None:
    _, found = cubic
    unsure = replace(found.best, sd_Nm_per_rad=np.full(len(found.twist_rad), sd))
    assert "no curve can be told" in verdict(replace(found, best=unsure))


def test_a_drive_with_one_encoder_is_refused() -> None:
    simulated = simulate([], seconds=9.0, seed=5)
    with pytest.raises(BadInput, match="balance"):
        stiffness_map([simulated], Model("drive", 100.0, 0.05, ()), extended)


@pytest.mark.parametrize("seed", [2])
def test_the_makers_ranges_are_found_as_add_finds_them(seed: int) -> None:
    """A fit from where the catalogue starts settles at other corners here: K1 three per cent off."""
    simulated = simulate(["piecewise_stiffness"], seconds=12.0, seed=seed)
    found = stiffness_map([simulated], bare(simulated), extended)
    known = {name.partition(".")[2]: value for name, value in simulated.truth["parameters"].items()}
    k1 = simulated.truth["parameters"]["stiffness_Nm_per_rad"]
    truth = {
        "linear_stiffness.stiffness": k1,
        "piecewise_stiffness.rise_1": k1 * (known["k2_over_k1"] - 1.0),
        "piecewise_stiffness.rise_2": k1 * (known["k3_over_k1"] - known["k2_over_k1"]),
        "piecewise_stiffness.corner_1": known["corner1_rad"],
    }
    assert found.best.name == "piecewise"
    assert {name: found.best.numbers[name][0] for name in truth} == pytest.approx(truth, rel=0.01)


def test_a_measured_torque_is_mapped_as_well() -> None:
    """Beside a torque sensor a fit holds the sensor's lag, which is no effect of the model."""
    simulated = simulate([], seconds=9.0, seed=5)
    known = simulated.truth["parameters"]
    exact = simulate([], seconds=9.0, seed=5, bits_in=0, bits_out=0).columns["theta_out_rad"]
    torque = known["inertia_kg_m2"] * np.gradient(np.gradient(exact)) * 1e6
    torque += np.random.default_rng(1).normal(0.0, 0.05, len(torque))
    measured = replace(simulated, columns={**simulated.columns, "torque_out_Nm": torque})
    found = stiffness_map([measured], bare(simulated), extended)
    assert found.best.name == "linear"
    assert found.best.stiffness_Nm_per_rad[0] == pytest.approx(known["stiffness_Nm_per_rad"], rel=0.02)
