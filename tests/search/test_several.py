"""More than two effects at once, with two encoders."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.rig.recording import Simulated, simulate

pytestmark = pytest.mark.slow


def joint(made: Simulated) -> Model:
    inertia = made.truth["parameters"]["inertia_kg_m2"]  # type: ignore[index]
    return Model("torsion", 100.0, inertia, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))


def test_three_large_effects_are_named_together() -> None:
    """Any two leave hundreds of noise floors: that was "unexplained"."""
    made = simulate(("constant_load", "mesh_stiffness", "output_viscous_friction"), 12.0, seed=7, bits_out=22)
    found = diagnose([made], joint(made))
    first = found.candidates[0]
    assert found.verdict == "missing" and first.probability > 0.8
    assert first.effect == "constant_load+mesh_stiffness+output_viscous_friction"
    added = add_effect(joint(made), first.effect, [made])
    assert added.after.nrmse == pytest.approx(first.nrmse_after, rel=0.1)
    assert added.after.nrmse < 2.0 * found.error.noise_floor_nrmse


def test_the_usual_of_two_that_nothing_tells_apart_comes_first_among_several() -> None:
    """Weight and an encoder off its centre are one wave of the output; all that was listed were several effects, and
    then the last fit decided their order by a thousandth."""
    made = simulate(("coulomb_friction", "kinematic_error", "gravity_load"), 12.0, seed=8, bits_out=22)
    first, second = diagnose([made], joint(made)).candidates[:2]
    assert set(first.effect.split("+")) == {"coulomb_friction", "kinematic_error", "gravity_load"}
    assert "encoder_eccentricity" in second.effect and second.effect in first.confused_with
    assert second.probability > 0.3


def bent(seed: int, middle_rad: float) -> SimpleNamespace:
    """A weight and other joints on a spring of three ranges; an encoder off its centre, and teeth that err."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(10_000) / 1000.0
    tones = [(f, size, phase) for (f, size), phase in zip(TONES, rng.uniform(0.0, 6.28, 3), strict=True)]
    out = middle_rad + sum(size * np.sin(2 * math.pi * f * time_s + phase) for f, size, phase in tones)
    other = out + 1.1 * np.sin(1.3 * time_s + rng.uniform(0.0, 6.28))
    torque = 34.0 * np.sin(out) + 14.0 * np.sin(other) + 6.0 * np.sin(4.4 * time_s)
    corners = np.array([0.0, 5e-4, 1.4e-3, 5e-3])
    levels = np.concatenate(([0.0], np.cumsum(np.diff(corners) * (1.2e4, 2.1e4, 2.6e4))))
    motor = 100.0 * (out + np.sign(torque) * np.interp(np.abs(torque), levels, corners))
    motor += 100.0 * 5e-5 * np.sin(2.0 * motor + 1.1)
    read = out + 1.9e-4 * np.sin(out + 0.7) + 8e-5 * np.sin(2.0 * out + 2.2)
    columns = {"torque_out_Nm": torque + 0.1 * rng.normal(size=len(torque))}
    for name, angle, bits in (("theta_in_rad", motor, 20), ("theta_out_rad", read, 23)):
        step = 2.0 * math.pi / 2**bits
        columns[name] = np.rint(angle / step + rng.normal(0.0, 0.25, len(angle))) * step
    return SimpleNamespace(time_s=time_s, columns=columns)


TONES = ((0.09, 1.2), (0.27, 0.3), (0.61, 0.08))
"""Frequency in Hz and amplitude in rad."""


def test_a_second_order_of_an_encoder_leads_on_to_a_third_effect() -> None:
    """It shows only beside a spring that bends, and without it no third effect was worth a look: "unexplained" at 28
    noise floors. The spring is twice as stiff at its end as in the middle: by plain repetition an error of the motor's
    angle never came to rest."""
    model = Model("torsion", 100.0, math.nan, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
    found = diagnose([bent(1, 0.2), bent(2, -0.3)], model)
    first = found.candidates[0]
    assert first.nrmse_after < 1.2 * found.error.noise_floor_nrmse
    assert first.effect == "encoder_eccentricity+kinematic_error+piecewise_stiffness" and first.probability > 0.5
