"""The noise floor moves with the stiffness that an effect leaves: explanations are compared by their errors."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.recordings.recording import read_recording
from edge_daemon.rig.recording import simulate

BASE = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
ARM = Path(__file__).parents[3] / "shared/data/real/lara8_joint_3.csv"


@pytest.mark.slow
def test_an_effect_that_hears_more_noise_does_not_win_by_it() -> None:
    """A skew leaves more error than the friction that is there, but a floor twice as high."""
    made = simulate(("temperature_friction",), 20.0, seed=1266089060, bits_out=22, motion="poor")
    inertia = made.truth["parameters"]["inertia_kg_m2"]  # type: ignore[index]
    found = diagnose([made], Model("torsion", 100.0, inertia, BASE))
    assert found.candidates[0].effect == "temperature_friction"


@pytest.mark.slow
@pytest.mark.skipif(not ARM.exists(), reason=f"{ARM} is absent")
def test_an_effect_that_halves_error_and_floor_is_not_idle() -> None:
    """A real arm, whose output encoder's error takes half of the stiffness with it, and so half of the noise."""
    model = Model("torsion", 101.0, math.nan, BASE)
    recording = read_recording(ARM)
    best = diagnose([recording], model).candidates[0]
    assert {"encoder_eccentricity", "gravity_load"} & set(best.effect.split("+"))
    assert best.nrmse_after < 0.5 * best.nrmse_before
    assert add_effect(model, best.effect, [recording]).helps
