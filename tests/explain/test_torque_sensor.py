"""A gear beside a torque sensor whose encoders are not read at one instant, or whose teeth err."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose

MODEL = Model("torsion", 100.0, math.nan, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
STIFFNESS, DAMPING, INERTIA, RATIO, RATE_HZ, SECONDS = 2e4, 3.0, 0.08, 100.0, 1000.0, 20.0


def joint(seed: int, bits: int, skew_s: float = 0.0, error_rad: float = 0.0) -> SimpleNamespace:
    """Six tones, each with the twist that spring and damper give it; torque with 0.1 % of noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    omega = 2 * math.pi * np.array([0.37, 1.1, 2.9, 6.7, 13.1, 19.0]) * rng.uniform(0.9, 1.1, 6)
    speed = np.array([1.2, 0.8, 0.4, 0.25, 0.15, 0.1]) * rng.uniform(0.8, 1.2, 6)
    phase = rng.uniform(0, 6.28, 6)

    def tones(size: np.ndarray, at: np.ndarray) -> np.ndarray:
        return np.asarray((np.exp(1j * (np.outer(at, omega) + phase)) * size).real.sum(axis=1))

    bent = INERTIA * speed * omega / (STIFFNESS + 1j * omega * DAMPING)
    angle, torque = tones(-speed / omega, time_s), INERTIA * tones(speed * omega, time_s)
    motor = RATIO * tones(bent - speed / omega, time_s + skew_s)
    motor -= RATIO * error_rad * (np.sin(2 * motor + 0.3) + 0.4 * np.sin(motor + 1.0) + 0.3 * np.sin(4 * motor + 2.0))
    columns = {"torque_out_Nm": torque + 1e-3 * torque.std() * rng.normal(size=len(torque))}
    for name, true, step in (("theta_in_rad", motor, 2**-17), ("theta_out_rad", angle, 2.0**-bits)):
        step *= 2 * math.pi
        columns[name] = np.rint(true / step + rng.normal(0, 0.25, len(true))) * step
    return SimpleNamespace(time_s=time_s, columns=columns)


def test_a_skew_at_20_bits_is_named_alone() -> None:
    """Only friction of the output does the same to first order: it may stand beside it."""
    found = diagnose([joint(2, 20, skew_s=2e-5)], MODEL)
    assert found.candidates[0].effect == "encoder_skew"
    assert {row.effect for row in found.candidates if row.probability > 0.05} <= {
        "encoder_skew",
        "output_viscous_friction",
    }
    assert found.candidates[0].nrmse_after < found.error.noise_floor_nrmse


def test_a_kinematic_error_at_24_bits_is_believed() -> None:
    first = diagnose([joint(2, 24, error_rad=5e-6)], MODEL).candidates[0]
    assert first.effect == "kinematic_error" and first.probability > 0.5
