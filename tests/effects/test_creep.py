"""A gear that gives way in time: complex stiffness in closed form, by inverse dynamics of five tones."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.hysteresis import relaxed
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose

STIFFNESS, DAMPING, INERTIA = 3e4, 8.0, 0.1
BASE = Model("torsion", 100.0, INERTIA, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))


def recording(creep: float, time_s: float, delay_s: float = 0.0, bits: int = 21) -> SimpleNamespace:
    """Of a gear of which a part `creep` [N m/rad] relaxes with `time_s`, and an output encoder that reads late."""
    rng = np.random.default_rng(4)
    t = np.arange(24_000) / 1000.0
    read, motor = np.zeros(len(t)), np.zeros(len(t))
    for tone in (0.3, 1.3, 3.7, 7.9, 13.0):
        w = 2 * np.pi * tone
        spring = STIFFNESS + 1j * w * DAMPING + creep * 1j * w * time_s / (1 + 1j * w * time_s)
        wave = 0.45 / w * np.exp(1j * (w * t + rng.uniform(0, 6)))
        motor += 100 * (wave * (1 - INERTIA * w**2 / spring)).imag
        read += (wave * np.exp(1j * w * delay_s)).imag
    noise_rad = 2 * np.pi / 2**bits / np.sqrt(12)
    columns = {
        "theta_in_rad": motor + rng.normal(0, 1e-5, len(t)),
        "theta_out_rad": read + rng.normal(0, noise_rad, len(t)),
    }
    return SimpleNamespace(time_s=t, columns=columns)


@pytest.mark.slow
@pytest.mark.parametrize("bits", [20, 21])
def test_creep_near_the_noise_is_not_called_a_skew(bits: int) -> None:
    """Above its own frequency it is what a speed makes; what tells them apart is the slow tone alone."""
    found = diagnose([recording(0.5 * STIFFNESS, 1.0, bits=bits)], BASE)
    assert found.verdict == "unexplained"
    assert found.candidates[0].effect in ("encoder_skew", "output_viscous_friction")
    assert found.candidates[0].nrmse_after < 1.5 * found.error.noise_floor_nrmse
    assert sum(row.probability for row in found.candidates) < 0.5
    lag = next(row for row in found.where if row.axis == "lag")
    assert "creep" in lag.detail and lag.share > 0.1


def test_a_skew_of_the_same_size_is_one() -> None:
    found = diagnose([recording(0.0, 1.0, 5e-6)], BASE)
    assert found.verdict == "missing"
    assert "encoder_skew" in {found.candidates[0].effect, *found.candidates[0].confused_with}


def test_what_has_given_way_follows_the_twist() -> None:
    """Against the closed form of a sine, once the beginning is forgotten."""
    t, w, time_s = np.arange(20_000) / 1000.0, 2 * np.pi * 0.7, 0.8
    slow = relaxed(np.sin(w * t), 1000.0, time_s)
    exact = (np.exp(1j * w * t) / (1 + 1j * w * time_s)).imag
    assert slow[10_000:] == pytest.approx(exact[10_000:], abs=2e-3)
