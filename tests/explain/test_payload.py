"""A payload of which the controller's model torque knows nothing: what weight, inertia and model torque share."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.identify.fit import fit
from tests.explain.simulated_drives import RATIO, Arm, Joint, Sensing, record


def with_payload(seed: int, bits: int, mesh: float = 0.0) -> Joint:
    """A joint whose controller reckons a third of the weight, and five eighths of the inertia, without any noise."""
    arm = Arm(weight_Nm=12.0, coulomb_Nm=4.0, viscous_Nms=3.0, mesh=mesh)
    read, fine = (record(arm, seed, 20.0, Sensing(rate_hz=250.0, bits=row)) for row in (bits, 28))
    angle, window = fine.columns["theta_out_rad"], np.hanning(9) / np.hanning(9).sum()
    bent = np.gradient(np.gradient(angle, fine.time_s), fine.time_s)
    reckoned = 0.5 * np.convolve(bent, window, mode="same") + 4.0 * np.sin(angle)
    return replace(read, columns={**read.columns, "torque_model_Nm": reckoned})


@pytest.mark.slow
@pytest.mark.parametrize("mesh", [0.0, 0.07])
def test_a_payload_of_which_the_controller_knows_nothing_is_a_weight(mesh: float) -> None:
    """It was refused, since weight and inertia make all of the model torque, and slipping elements were sure."""
    names = ("inertia", "coulomb_friction", "viscous_friction", "model_torque")
    names += ("load_dependent_friction",) if mesh else ()
    found = diagnose([with_payload(2, 19, mesh)], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, names))))
    assert found.verdict == "missing" and found.candidates[0].effect == "gravity_load"
    assert found.candidates[0].nrmse_after < 1.3 * found.error.noise_floor_nrmse
    assert any(line.startswith("gravity_load beside model_torque: a payload") for line in found.warnings)


def test_no_more_noise_is_taken_out_of_an_inertia_than_others_leave_of_it() -> None:
    """Weight and model torque make all of it but noise: freed of that it left five times as much as it was."""
    names = ("inertia", "coulomb_friction", "viscous_friction", "model_torque", "gravity_load")
    fitted = fit([with_payload(2, 15)], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, names))))
    design, target = fitted.solution.columns, fitted.problem.target
    least = target - design @ np.linalg.lstsq(design, target, rcond=1e-12)[0]
    assert fitted.solution.rmse < 1.2 * math.sqrt(float(np.mean(least**2)))


@pytest.mark.parametrize(("seed", "bits"), [(2, 16), (1, 17), (2, 18)])
def test_what_happens_at_reversals_is_heard_as_no_noise(seed: int, bits: int) -> None:
    """With a reversal in each window it sounded like noise, and the floor was 10 to 20 times what the exact model
    leaves."""
    names = ("inertia", "coulomb_friction", "viscous_friction", "gravity_load")
    fitted = fit([with_payload(seed, bits)], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, names))))
    assert 0.8 < fitted.solution.rmse / fitted.floor < 1.3
