"""Explanations that only come out beside others: a skew that hides the spring, a gap that an error of angles moves."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose

RATIO, STIFFNESS, DAMPING, INERTIA, RATE_HZ = 100.0, 2.2e4, 45.0, 1.5, 1000.0
START = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))


def tones(*rows: tuple[float, float]) -> tuple[np.ndarray, ...]:
    """Time, angle, speed and acceleration of 16 s with tones of these frequencies [Hz] and speeds [rad/s]."""
    time_s = np.arange(round(16.0 * RATE_HZ)) / RATE_HZ
    phase = [(2 * math.pi * hz, size, 2 * math.pi * hz * time_s + hz) for hz, size in rows]
    angle = sum(-size / w * np.cos(at) for w, size, at in phase)
    speed = sum(size * np.sin(at) for _, size, at in phase)
    return time_s, np.asarray(angle), np.asarray(speed), np.asarray(sum(w * s * np.cos(at) for w, s, at in phase))


def read(angle: np.ndarray, bits: int, rng: np.random.Generator) -> np.ndarray:
    """An angle by an encoder of so many bits."""
    step = 2 * math.pi / 2**bits
    return np.rint(angle / step + rng.normal(0, 0.3, len(angle))) * step


@pytest.mark.slow
def test_a_skew_that_hides_the_spring_is_named_with_what_turns_the_joint() -> None:
    """A pointing joint with a weight and dry friction whose output encoder is read 0.4 ms late: no effect alone leaves
    the spring a part of the torque, and nothing was listed."""
    rng = np.random.default_rng(5)
    time_s, angle, speed, acceleration = tones((0.13, 0.5), (0.41, 0.35), (1.7, 0.2), (4.3, 0.08))
    torque = INERTIA * acceleration + 11.0 * np.sin(angle) + 3.0 * np.cos(angle) + 1.2 * np.tanh(speed / 1e-3)
    ahead = torque / STIFFNESS - DAMPING / STIFFNESS**2 * np.gradient(torque, time_s)
    late = np.interp(time_s - 4e-4, time_s, angle)
    columns = {"theta_in_rad": read(RATIO * (angle + ahead), 20, rng), "theta_out_rad": read(late, 24, rng)}
    model = Model("torsion", RATIO, INERTIA, START)
    found = diagnose([SimpleNamespace(time_s=time_s, columns=columns)], model)
    first = found.candidates[0]
    same = {first.effect, *first.confused_with}
    assert found.verdict == "missing" and "encoder_skew+gravity_load+output_coulomb_friction" in same
    assert first.nrmse_after < 0.02 * found.error.nrmse


@pytest.mark.slow
def test_a_gap_is_not_where_the_twist_was_before_an_error_of_it_was_known() -> None:
    """A worn ankle whose torque sensor ripples: a kinematic error in its place was believed at 0.78 with columns of a
    gap that was not moved by it; fitted, it left more than twice as much."""
    rng = np.random.default_rng(6)
    time_s, angle, _, acceleration = tones((0.3, 0.9), (0.8, 0.4), (2.1, 0.2))
    torque = 0.8 * acceleration + 22.0 * np.sin(angle)
    ahead = torque / 1.7e4 + 2.6e-4 * np.tanh(torque / 0.02)
    motor = RATIO * (angle + ahead)
    ripple = 0.6 * np.sin(2 * motor + 0.8)
    columns = {
        "theta_in_rad": read(motor, 21, rng),
        "theta_out_rad": read(angle, 22, rng),
        "torque_out_Nm": torque + ripple + 2e-3 * torque.std() * rng.normal(size=len(torque)),
    }
    model = Model("torsion", RATIO, math.nan, START)
    found = diagnose([SimpleNamespace(time_s=time_s, columns=columns)], model)
    assert found.candidates[0].effect == "backlash+torque_ripple" and found.candidates[0].probability > 0.85
    assert all(row.nrmse_after > 2 * found.candidates[0].nrmse_after for row in found.candidates[1:])
