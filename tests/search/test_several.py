"""More than two effects at once, with two encoders."""

from __future__ import annotations

import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.rig.recording import Simulated, simulate


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
