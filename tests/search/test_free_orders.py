"""Orders that no catalogue lists, found in recordings of a gear that has them by its own physics."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from edge_daemon.effects.effect import Wave
from edge_daemon.effects.model import Model, ModelEffect, Teeth
from edge_daemon.errors import BadInput
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.compare import compare
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.results import Diagnosis
from edge_daemon.rig.recording import Simulated, simulate

SECONDS = 16.0
INPUT, OUTPUT, DIFFERENCE = 0.0, 1.0, 2.0
NOT_USUAL = {f"kinematic_error.order{m}_rad": 0.0 for m in (1, 2, 4)}


@cache
def recording(order: float, angle: float, size_rad: float = 5e-5, usual: bool = False, seed: int = 3) -> Simulated:
    sizes = {"free_order": order, "free_angle": angle, "free_rad": size_rad, "free_phase_rad": 0.7}
    given = {f"kinematic_error.{name}": value for name, value in sizes.items()}
    return simulate(
        ("kinematic_error",), SECONDS, seed=seed, bits_out=22, parameters=given | ({} if usual else NOT_USUAL)
    )


def model_of(made: Simulated, *further: ModelEffect, teeth: Teeth | None = None) -> Model:
    inertia = made.truth["parameters"]["inertia_kg_m2"]  # type: ignore[index]
    base = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
    return Model("torsion", 100.0, inertia, (*base, *further), teeth=teeth)


def orders(found: Diagnosis) -> set[str]:
    return {name.partition(".sine_")[2] for name in found.candidates[0].parameters if ".sine_" in name}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "angle", "name", "wave"),
    [
        (3.0, INPUT, "3", Wave("input", 3)),
        (7.0, INPUT, "7", Wave("input", 7)),
        (0.47, INPUT, "0_47", Wave("input", 0.47)),  # the cage of a bearing
        (202.0, OUTPUT, "202_output", Wave("output", 202)),  # a tooth
        (3.0, DIFFERENCE, "3_difference", Wave("difference", 3)),
    ],
)
def test_an_order_is_found_on_its_angle_and_its_size_is_right(
    order: float, angle: float, name: str, wave: Wave
) -> None:
    made = recording(order, angle)
    found = diagnose([made], model_of(made))
    assert found.verdict == "missing" and found.candidates[0].effect == "kinematic_error"
    assert orders(found) == {name} and found.candidates[0].probability > 0.8
    assert found.candidates[0].nrmse_after < 1.5 * found.error.noise_floor_nrmse
    added = add_effect(model_of(made), "kinematic_error", [made])
    row = added.model.effect("kinematic_error")
    assert row is not None and row.waves == (wave,)
    sine, cosine = (row.parameters[f"{word}_{name}"] for word in ("sine", "cosine"))
    assert sine.value == pytest.approx(5e-5 * np.cos(0.7), abs=max(4 * sine.sd, 2e-7))
    assert cosine.value == pytest.approx(5e-5 * np.sin(0.7), abs=max(4 * cosine.sd, 2e-7))
    assert added.after.nrmse < 1.5 * added.after.noise_floor_nrmse
    assert added.after.nrmse < 1.05 * found.candidates[0].nrmse_after


@pytest.mark.slow
def test_a_tooth_beside_the_usual_orders_is_told_from_the_second_of_the_motor() -> None:
    made = recording(202.0, OUTPUT, 2e-5, usual=True)
    found = diagnose([made], model_of(made))
    assert found.candidates[0].effect == "kinematic_error" and orders(found) >= {"2", "4", "202_output"}
    assert not any("_" in name for name in orders(found) - {"202_output"})


def test_a_model_that_has_the_usual_orders_is_given_further_ones_once() -> None:
    made = recording(202.0, OUTPUT, 2e-5, usual=True)
    model = model_of(made, ModelEffect("kinematic_error"))
    found = diagnose([made], model)
    assert found.candidates[0].effect == "kinematic_error" and orders(found) == {"202_output"}
    added = add_effect(model, "kinematic_error", [made])
    row = added.model.effect("kinematic_error")
    assert row is not None and row.waves == (*(Wave("input", m) for m in (1, 2, 4)), Wave("output", 202))
    assert np.hypot(row.value("sine_202_output"), row.value("cosine_202_output")) == pytest.approx(2e-5, rel=0.02)
    assert diagnose([made], added.model).verdict == "adequate"
    with pytest.raises(BadInput, match="has it already, and no further order stands out"):
        add_effect(added.model, "kinematic_error", [made])


@pytest.mark.slow
@pytest.mark.parametrize("effects", [(), ("coulomb_friction",), ("mesh_stiffness",), ("kinematic_error",)])
@pytest.mark.parametrize("seed", [11, 12])
def test_what_has_no_further_order_is_given_none(effects: tuple[str, ...], seed: int) -> None:
    made = simulate(effects, SECONDS, seed=seed, bits_out=22)
    found = diagnose([made], model_of(made))
    names = [name for row in found.candidates if row.probability > 0.05 for name in row.parameters]
    usual = {"1", "2", "4"} if effects == ("kinematic_error",) else {"2"} if effects == ("mesh_stiffness",) else set()
    assert {name.partition("sine_")[2] for name in names if "sine_" in name} <= usual
    if not effects:
        assert found.verdict == "adequate"


@pytest.mark.parametrize(
    ("order", "angle", "axis", "says"),
    [
        (3.0, INPUT, "input angle", "3 ("),
        (202.0, OUTPUT, "output angle", "circular spline tooth pass)"),
        (3.0, DIFFERENCE, "difference angle", "3 ("),
    ],
)
def test_compare_locates_an_order_on_its_angle(order: float, angle: float, axis: str, says: str) -> None:
    made = recording(order, angle)
    result = compare([made], model_of(made, teeth=Teeth(200, 202)))
    assert result.where[0].axis == axis and result.where[0].share > 0.4
    assert says in result.where[0].detail
