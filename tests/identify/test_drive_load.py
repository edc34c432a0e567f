"""Torques that pass the gear of a single-encoder drive, and friction that grows with them, on the simulated drive."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit
from edge_daemon.rig.recording import simulate

NAMES = ("inertia", "gravity_load", "constant_torque", "load_dependent_friction")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_load_friction_follows_weight_and_inertia_alike(seed: int) -> None:
    wanted = ("gravity_load", "constant_torque", "load_dependent_friction")
    recording = simulate(wanted, 30.0, seed=seed, balance="drive", bits_out=0)
    truth = recording.truth["parameters"]
    assert isinstance(truth, dict)
    fitted = fit([recording], Model("drive", 100.0, math.nan, tuple(ModelEffect(name) for name in NAMES)))
    at_motor = truth["ratio"]
    told = {
        ("load_dependent_friction", "coefficient"): truth["load_dependent_friction.mu"],
        ("constant_torque", "torque"): truth["constant_torque.size_Nm"] / at_motor,
        ("inertia", "inertia"): truth["inertia_kg_m2"] / at_motor,
    }
    for (effect, name), value in told.items():
        row = fitted.model.effect(effect)
        assert row is not None
        known = row.parameters[name]
        assert known.identified
        assert known.value == pytest.approx(value, abs=max(4 * known.sd, 0.01 * abs(value)))


@pytest.mark.parametrize("channel", ["torque_model_Nm", "torque_out_Nm"])
def test_a_model_torque_carries_what_other_joints_do(channel: str) -> None:
    """The controller's torque holds inertia and coupling: friction of a tenth of it, and the gain to the current; and
    so does that of a sensor behind the gear, which was passed over, or else taken for that of a twist, and late."""
    rng = np.random.default_rng(11)
    time_s = np.arange(15_000) / 500.0
    waves = [(hz, rng.uniform(0, 6.28)) for hz in (0.21, 0.83, 1.9)]
    angle = sum(np.sin(2 * math.pi * hz * time_s + phase) / hz for hz, phase in waves)
    speed = sum(2 * math.pi * np.cos(2 * math.pi * hz * time_s + phase) for hz, phase in waves)
    coupling = 20 * np.sin(2 * math.pi * 0.37 * time_s) + 15 * np.sin(angle)
    current = 0.1 * (coupling + 0.1 * np.abs(coupling) * np.sign(speed) + 2 * speed) + rng.normal(0, 0.01, len(time_s))
    columns = {"theta_out_rad": angle, "current_in_A": current, channel: coupling}
    names = ("model_torque", "viscous_friction", "load_dependent_friction")
    recording = type("Stand", (), {"time_s": time_s, "columns": columns})()
    fitted = fit([recording], Model("drive", 100.0, math.nan, tuple(ModelEffect(name) for name in names)))
    assert fitted.solution.names == names
    assert fitted.model.value("model_torque", "gain") == pytest.approx(0.1, rel=0.005)
    assert fitted.model.value("load_dependent_friction", "coefficient") == pytest.approx(0.1, rel=0.03)
    row = fitted.model.effect("model_torque")
    assert row is not None and row.parameters["gain"].unit == "A/Nm"
