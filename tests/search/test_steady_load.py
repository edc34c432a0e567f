"""A steady load behind the gear, told from a torque that never passes it by friction of the load alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from tests.explain.simulated_drives import RATIO, Arm, Joint, record

BELT = Arm(steady_Nm=4.0, mesh=0.1, coulomb_Nm=3.0)
"""What it accelerates changes the sign of the load, else its friction would be that of any joint."""
PLAIN = ("inertia", "viscous_friction", "coulomb_friction")


def model(*names: str) -> Model:
    return Model("drive", RATIO, math.nan, tuple(map(ModelEffect, names)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_a_weight_on_a_belt_is_a_load(seed: int) -> None:
    recording = record(BELT, seed)
    known = model(*PLAIN, "constant_torque", "load_dependent_friction")
    found = diagnose([recording], known)
    assert found.verdict == "missing" and found.candidates[0].effect == "constant_load"
    fitted = add_effect(known, "constant_load", [recording]).model
    row = fitted.effect("constant_load")
    assert row is not None
    load = row.parameters["load"]
    assert 0.0 < RATIO * load.sd < 0.1 * BELT.steady_Nm
    assert RATIO * load.value == pytest.approx(BELT.steady_Nm, abs=max(4 * RATIO * load.sd, 0.03 * BELT.steady_Nm))
    friction = fitted.effect("load_dependent_friction")
    assert friction is not None
    mesh = friction.parameters["coefficient"]
    assert 0.0 < mesh.sd < 0.1 * BELT.mesh and mesh.value == pytest.approx(BELT.mesh, abs=3 * mesh.sd)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_a_torque_before_the_gear_is_no_load(seed: int) -> None:
    arm = replace(BELT, steady_Nm=0.0, offset_Nm=4.0)
    for known in (model(*PLAIN, "constant_torque", "load_dependent_friction"), model(*PLAIN)):
        found = diagnose([record(arm, seed)], known)
        assert not found.candidates or "constant_load" not in found.candidates[0].effect.split("+")


@pytest.mark.slow
def test_the_zero_of_a_model_torque_passes_for_a_steady_load() -> None:
    """Friction knows the true load, the controller another by its zero: a weight was named that made up for that."""
    zero_Nm, rng, time_s = 4.0, np.random.default_rng(11), np.arange(15_000) / 500.0
    waves = [(2 * math.pi * hz, rng.uniform(0, 6.28)) for hz in (0.21, 0.83, 1.9)]
    angle = sum(0.8 * np.sin(w * time_s + phase) / w for w, phase in waves)
    speed = sum(0.8 * np.cos(w * time_s + phase) for w, phase in waves)
    load = 20 * np.sin(2 * math.pi * 0.37 * time_s) + 15 * np.sin(2 * angle)
    current = 0.1 * (load + (3.0 + 0.1 * np.abs(load)) * np.sign(speed) + 2 * speed) + rng.normal(0, 0.01, len(time_s))
    columns = {"theta_out_rad": angle, "current_in_A": current, "torque_model_Nm": load - zero_Nm}
    known = model("model_torque", *PLAIN[1:], "constant_torque", "load_dependent_friction")
    found = diagnose([Joint(time_s, columns)], known)
    assert found.verdict == "missing" and found.candidates[0].effect == "constant_load"
    row = add_effect(known, "constant_load", [Joint(time_s, columns)]).model.effect("constant_load")
    assert row is not None
    assert row.parameters["load"].value == pytest.approx(0.1 * zero_Nm, abs=4 * row.parameters["load"].sd)
