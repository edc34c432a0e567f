"""A gear that is softer by day than by night and rubs inside, recorded twice: the plain law of each is told."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.identify.fit import fit
from edge_daemon.rig.recording import simulate

STIFFNESS, SOFTER_PER_K, DAMPING, FRICTION, CREEP, INERTIA = 4.2e4, 126.0, 45.0, 4.0, 3e-4, 9.0
PAIR = ("coulomb_friction", "temperature_stiffness")
MODEL = Model("torsion", 100.0, INERTIA, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
STEPS, DURATION_S = 40, 16.0
"""of the integration in each of 500 samples a second"""


def recorded(temperature_degC: float, seed: int) -> SimpleNamespace:
    """A motor that follows three tones, an output that wind pushes, encoders of 19 and 24 bits and a torque sensor."""
    rng = np.random.default_rng(seed)
    step_s, n = 1 / 500 / STEPS, round(500 * DURATION_S)
    time_s = np.arange(n * STEPS) * step_s
    tones = ((0.5, 0.3), (0.13, 0.8), (0.03, 1.9))
    motor = sum(size * np.sin(2 * math.pi * hz * time_s + seed + hz) for size, hz in tones)
    speed = sum(2 * math.pi * hz * size * np.cos(2 * math.pi * hz * time_s + seed + hz) for size, hz in tones)
    wind = 25.0 * np.sin(2 * math.pi * 0.13 * time_s) + 9.0 * np.sin(2 * math.pi * 1.1 * time_s)
    stiffness = STIFFNESS - SOFTER_PER_K * (temperature_degC - 20.0)
    angle, rate = float(motor[0]), float(speed[0])
    out, torque = np.empty(n), np.empty(n)
    for i in range(n * STEPS):
        made = stiffness * (motor[i] - angle) + DAMPING * (speed[i] - rate)
        made += FRICTION * math.tanh((speed[i] - rate) / CREEP)
        if i % STEPS == 0:
            out[i // STEPS], torque[i // STEPS] = angle, made
        rate += step_s * (made + wind[i]) / INERTIA
        angle += step_s * rate
    into = np.rint(100.0 * motor[::STEPS] * 2**19 / (2 * math.pi)) * 2 * math.pi / 2**19
    out = np.rint(out * 2**24 / (2 * math.pi)) * 2 * math.pi / 2**24
    columns = {"theta_in_rad": into, "theta_out_rad": out, "torque_out_Nm": torque + rng.normal(0, 0.08, n)}
    columns["temperature_degC"] = temperature_degC + rng.normal(0, 0.05, n)
    return SimpleNamespace(time_s=time_s[::STEPS], columns=columns)


@pytest.mark.slow
def test_plain_friction_beside_another_law_is_not_taken_for_a_finer_form() -> None:
    """Neither recording tells what the temperature does, and either alone shows a friction only: the finer form was
    told at 0.98, with none of what it adds."""
    found = diagnose([recorded(24.0, 1), recorded(-11.0, 2)], MODEL)
    assert found.candidates[0].effect == "coulomb_friction+temperature_stiffness"
    assert found.candidates[0].probability > 0.5


@pytest.mark.slow
def test_what_one_temperature_in_each_recording_does_is_found() -> None:
    """Whole recordings were held out, of each of which the other knew nothing: 1366 noise floors, and no cause."""
    made = [simulate(PAIR, 12.0, seed=1, temperature=degC) for degC in (5.0, 40.0)]
    inertia = made[0].truth["parameters"]["inertia_kg_m2"]  # type: ignore[index]
    first = diagnose(made, replace(MODEL, output_inertia_kg_m2=inertia)).candidates[0]
    assert first.effect == "coulomb_friction+temperature_stiffness" and first.probability > 0.5


def test_the_error_of_a_law_of_the_temperature_is_held_out_where_others_know_it() -> None:
    made = [simulate(PAIR[1:], 8.0, seed=2, temperature=degC) for degC in (5.0, 40.0)]
    inertia = made[0].truth["parameters"]["inertia_kg_m2"]  # type: ignore[index]
    fitted = fit(made, replace(MODEL, output_inertia_kg_m2=inertia).with_effect(ModelEffect(PAIR[1])))
    assert fitted.nrmse < 1.3 * fitted.floor / fitted.problem.rms
