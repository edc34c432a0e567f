"""Laws of a drive whose numbers measure the joint besides: each is named, and its numbers are those of the arm."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.effects.algebra import bristle_state
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.effects.waves import of_input
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.identify.fit import fit
from tests.explain.simulated_drives import RATIO, Arm, record

pytestmark = pytest.mark.slow

FREE = ("inertia", "viscous_friction", "gravity_load")
DRY = (*FREE, "coulomb_friction")
TUSTIN = Arm(weight_Nm=12.0, coulomb_Nm=4.0, stribeck_Nm=3.0, stribeck_rad_s=0.1, stribeck_exponent=1.0)
ROTOR = Arm(weight_Nm=30.0, mesh=0.1, rotor=0.35)
LUGRE = Arm(weight_Nm=12.0, coulomb_Nm=4.0, stribeck_Nm=3.0, stribeck_rad_s=0.08, bristles=(2500.0, 40.0))
DRAG = Arm(weight_Nm=12.0, drag=((2.0, 1.5, 0.4),))
ERROR = Arm(weight_Nm=12.0, rotor=0.4, error=(2.0, 2e-5, 0.7))


def model(*names: str) -> Model:
    return Model("drive", RATIO, math.nan, tuple(ModelEffect(name) for name in names))


@pytest.mark.parametrize(
    ("arm", "known", "name", "numbers"),
    [
        (ROTOR, DRY, "load_dependent_friction", {"coefficient": 0.1, "motor_share": 0.35}),
        (
            LUGRE,
            FREE,
            "lugre_friction",
            {
                "friction": 4.0 / RATIO,
                "bristle_damping": 40.0 / RATIO,
                "width": 4.0 / 2500.0,
                "static_ratio": 7.0 / 4.0,
                "stribeck_speed": 0.08,
            },
        ),
        (
            replace(LUGRE, stribeck_Nm=0.0, bristles=(2500.0, 0.0)),
            FREE,
            "dahl_friction",
            {"friction": 4.0 / RATIO, "width": 4.0 / 2500.0},
        ),
        (
            TUSTIN,
            FREE,
            "stribeck_friction",
            {"friction": 4.0 / RATIO, "excess": 3.0 / RATIO, "stribeck_speed": 0.1, "exponent": 1.0},
        ),
        (
            DRAG,
            DRY,
            "speed_ripple",
            {"sine_2": 1.5 * math.cos(0.4) / RATIO, "cosine_2": 1.5 * math.sin(0.4) / RATIO},
        ),
        (
            replace(DRAG, drag=((0.72, 1.5, 0.4),)),
            DRY,
            "speed_ripple",
            {"sine_0_72": 1.5 * math.cos(0.4) / RATIO, "cosine_0_72": 1.5 * math.sin(0.4) / RATIO},
        ),
        (
            ERROR,
            DRY,
            "kinematic_error",
            {"sine_2": 2e-5 * math.cos(0.7), "cosine_2": 2e-5 * math.sin(0.7), "share": 0.4},
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_law_is_named_and_its_numbers_are_the_arm_s(
    arm: Arm, known: tuple[str, ...], name: str, numbers: dict[str, float]
) -> None:
    recording = record(arm, 2, 30.0 if name == "dahl_friction" else 20.0)
    found = diagnose([recording], model(*known))
    first = found.candidates[0]
    assert found.verdict == "missing" and first.effect == name and first.probability > 0.9
    assert first.nrmse_after < 1.2 * found.error.noise_floor_nrmse
    added = add_effect(model(*known), name, [recording])
    assert added.after.nrmse < 1.02 * first.nrmse_after  # the promise is kept
    assert {p: added.model.value(name, p) for p in numbers} == pytest.approx(numbers, rel=0.04)


@pytest.mark.parametrize(("name", "damping"), [("dahl_friction", 0.0), ("lugre_friction", 40.0)])
def test_bristles_keep_their_stiffness_under_a_load(name: str, damping: float) -> None:
    """Friction of the load beside them leapt with the sign of the speed, and left 19 noise floors."""
    arm = Arm(weight_Nm=40.0, coulomb_Nm=5.0, mesh=0.08, bristles=(2500.0, damping))
    fitted = fit([record(arm, 2)], model(*FREE, name, "load_dependent_friction"))
    assert 0.8 < fitted.solution.rmse / fitted.floor < 1.5
    assert fitted.model.value(name, "width") == pytest.approx(5.0 / 2500.0, rel=0.02)
    assert fitted.model.value("load_dependent_friction", "coefficient") == pytest.approx(0.08, rel=0.02)


def test_an_error_that_raises_the_speed_by_a_twentieth_leaves_nothing_else_to_name() -> None:
    """To first order alone it left 1.6 noise floors here, and elsewhere ripple was named beside it at 1.00."""
    large = replace(ERROR, weight_Nm=60.0, rotor=0.8, error=(2.0, 2.5e-4, 0.7))
    exact = ModelEffect("kinematic_error", waves=of_input(2.0))
    fitted = fit([record(large, 2)], Model("drive", RATIO, math.nan, (*model(*DRY).effects, exact)))
    assert 0.8 < fitted.solution.rmse / fitted.floor < 1.2
    assert fitted.model.value("kinematic_error", "share") == pytest.approx(0.8, rel=0.01)


def test_an_inertia_alone_tells_no_share_of_the_motor() -> None:
    """There it is one number with the friction of the load: it is not searched for, and nothing is said of it."""
    arm = Arm(mesh=0.1, rotor=0.35)
    fitted = fit([record(arm, 2)], model("inertia", "viscous_friction", "coulomb_friction", "load_dependent_friction"))
    row = fitted.model.effect("load_dependent_friction")
    assert row is not None and row.value("motor_share") == 0.0 and not row.parameters["motor_share"].identified
    assert row.value("coefficient") == pytest.approx(0.1 * (1 - 0.35), rel=0.02)
    assert 0.8 < fitted.solution.rmse / fitted.floor < 1.2
    beside = fit([record(arm, 2)], model("inertia", "stribeck_friction", "load_dependent_friction"))
    assert beside.model.value("load_dependent_friction", "motor_share") == 0.0  # nor beside shapes that are searched


@pytest.mark.parametrize(
    "arm", [replace(LUGRE, bristles=(0.0, 0.0)), replace(LUGRE, stribeck_Nm=0.0, bristles=(0.0, 0.0))]
)
def test_dry_friction_without_bristles_is_not_called_lugre(arm: Arm) -> None:
    found = diagnose([record(arm, 2)], model(*FREE))
    assert found.candidates[0].effect == ("stribeck_friction" if arm.stribeck_Nm else "coulomb_friction")


def test_bristles_remember_from_block_to_block() -> None:
    """In one block or in three, each going on from the state of the one before, the same torque."""
    rng = np.random.default_rng(4)
    angle, level = np.cumsum(rng.normal(size=900)) * 1e-3, 1.0 + rng.uniform(size=900)
    reach = np.full(900, 2e-3)
    whole, _ = bristle_state(angle, reach, level, None)
    state, parts = None, []
    for rows in np.split(np.arange(900), 3):
        z, state = bristle_state(angle[rows], reach[rows], level[rows], state)
        parts.append(z)
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-12)
    force, step = 0.0, np.diff(angle, prepend=angle[0])
    for i in range(900):  # dz/dx = (sgn(dx) - z / g) / w along each straight step
        side = math.copysign(level[i], step[i])
        force = side + (force - side) * math.exp(-abs(step[i]) / (reach[i] * level[i]))
        assert whole[i] == pytest.approx(force, abs=1e-12)
