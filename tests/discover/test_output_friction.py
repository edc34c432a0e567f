"""Dry friction of the output that sticks, beside two encoders, multiplied by what no catalogue has."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.discover.proposals import proposals
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.compare import compare

STIFFNESS, DAMPING, INERTIA, RATIO = 1.8e4, 7.0, 0.4, 100.0
STEP_S, EVERY, SECONDS = 1e-4, 20, 24.0
MODEL = Model("torsion", RATIO, INERTIA, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))


def cold_seal(seed: int) -> SimpleNamespace:
    """A seal whose friction falls to a third over 10 K of warmth, at 500 Hz and 24 bits; where it can hold, it does."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(SECONDS / STEP_S)) * STEP_S
    degC = 18.0 + 22.0 * -np.expm1(-time_s / 9.0)
    tones = zip((0.23, 0.71, 1.9, 3.7), (1.6, 0.4, 0.06, 0.02), rng.uniform(0, 2 * math.pi, 4), strict=True)
    motor = sum(size * np.sin(2 * math.pi * hz * time_s + phase) for hz, size, phase in tones)
    level, angle, speed, out = (5.0 * np.exp(-(degC - 20.0) / 9.0)).tolist(), float(motor[0]), 0.0, []
    rate = np.gradient(motor, STEP_S).tolist()
    for i, ahead in enumerate(motor.tolist()):
        out.append(angle)
        free = speed + STEP_S / INERTIA * (STIFFNESS * (ahead - angle) + DAMPING * (rate[i] - speed))
        held = STEP_S / INERTIA * level[i]
        speed = math.copysign(max(abs(free) - held, 0.0), free)
        angle += STEP_S * speed
    read = {"theta_in_rad": RATIO * motor, "theta_out_rad": np.array(out)}
    unit = 2 * math.pi / 2**24
    columns = {
        name: np.rint(row[::EVERY] / unit + rng.uniform(-0.5, 0.5, len(row[::EVERY]))) * unit
        for name, row in read.items()
    }
    return SimpleNamespace(time_s=time_s[::EVERY], columns=columns | {"temperature_degC": np.round(degC[::EVERY], 2)})


@pytest.mark.slow
def test_a_seal_that_rubs_less_as_it_warms_is_told() -> None:
    """Where the output stood nothing told its friction: 14 floors were left by a formula that was half of reversals."""
    gear = cold_seal(1)
    best = proposals([gear], MODEL, lambda what, share: None)[0]
    assert best.probability > 0.9 and best.laws == 1
    assert "temperature_degC" in best.expression and "velocity_out_rad_s" in best.expression
    larger = add_effect(MODEL, "seal", [gear], expression=best.expression).model
    other = compare([cold_seal(2)], larger)
    assert other.error.nrmse < 2.0 * other.error.noise_floor_nrmse
