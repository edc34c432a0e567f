"""A law of what only differs between recordings: each was made at one temperature."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.discover.discover import discover
from edge_daemon.effects.model import Model, ModelEffect

RATE_HZ, INERTIA, DRAG, FRICTION, HALVES_OVER_K, KNEE = 500.0, 0.8, 3.0, 4.0, 10.0, 0.25


def recorded(temperature_degC: float, seed: int) -> SimpleNamespace:
    """A joint whose grease rubs half as much for every ten kelvin, by its angle and its torque."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(16.0 * RATE_HZ)) / RATE_HZ
    rows = [(size, 2 * math.pi * hz, rng.uniform(0, 6)) for hz, size in ((0.19, 0.9), (0.61, 0.3), (1.7, 0.05))]
    angle, speed, acceleration = (
        sum(size * w**k * np.sin(w * time_s + phase + k * math.pi / 2) for size, w, phase in rows) for k in range(3)
    )
    grease = FRICTION * 2.0 ** (-(temperature_degC - 25.0) / HALVES_OVER_K) * speed / (np.abs(speed) + KNEE)
    torque = INERTIA * acceleration + DRAG * speed + grease + rng.normal(0, 0.02, len(time_s))
    columns = {"theta_out_rad": angle + rng.normal(0, 2e-6, len(time_s)), "torque_in_Nm": torque / 100.0}
    columns["temperature_degC"] = temperature_degC + rng.normal(0, 0.05, len(time_s))
    return SimpleNamespace(time_s=time_s, columns=columns)


@pytest.mark.slow
def test_friction_that_fades_with_warmth_is_told_of_recordings_at_one_temperature_each() -> None:
    """The temperature was no axis of any of them: another law of it was told at 0.99, and left nine noise floors."""
    model = Model("drive", 100.0, math.nan, (ModelEffect("inertia"), ModelEffect("viscous_friction")))
    found = discover([recorded(degC, i) for i, degC in enumerate((10.0, 23.0, 38.0))], model)
    best = found.proposals[0]
    assert "exp(-0.0" in best.expression and "temperature_degC" in best.expression
    assert best.nrmse_after < 1.5 * found.error.noise_floor_nrmse
    assert found.verdict == "unexplained"
