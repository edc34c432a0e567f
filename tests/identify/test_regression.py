"""Errors of the angles put right before torque is explained: recordings by inverse dynamics, in closed form."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.identify.block_least_squares import taken_out
from edge_daemon.identify.fit import fit
from edge_daemon.identify.problem import problem_of
from edge_daemon.identify.regression import STIFFNESS as STIFFNESS_OF

STIFFNESS, DAMPING, INERTIA = 2e4, 3.0, 0.05
BASE = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))


def skewed(delay_s: float, sensor: bool, seconds: float = 12.0) -> SimpleNamespace:
    """Five tones at the output; its encoder reads `delay_s` later than stamped, motor and torque are as stamped."""
    rng = np.random.default_rng(11)
    t = np.arange(round(seconds * 1000)) / 1000.0
    out, read, twist, torque = (np.zeros(len(t)) for _ in range(4))
    for tone in (0.7, 3.1, 7.3, 13.7, 19.1):
        w, p = 2 * np.pi * tone, rng.uniform(0, 6)
        wave = 0.4 / w * np.exp(1j * (w * t + p))
        push = -INERTIA * w**2 * wave
        out += wave.imag
        read += (wave * np.exp(1j * w * delay_s)).imag
        twist += (push / (STIFFNESS + 1j * w * DAMPING)).imag
        torque += push.imag
    columns = {
        "theta_in_rad": 100 * (out + twist) + rng.normal(0, 1e-5, len(t)),
        "theta_out_rad": read + rng.normal(0, 1e-7, len(t)),
    }
    if sensor:
        columns["torque_out_Nm"] = torque + rng.normal(0, 0.002, len(t))
    return SimpleNamespace(time_s=t, columns=columns)


@pytest.mark.parametrize("sensor", [False, True])
@pytest.mark.parametrize("delay_s", [4e-4, -4e-4])
def test_a_skew_is_taken_out_at_the_instant_of_the_torque(delay_s: float, sensor: bool) -> None:
    """That of the inertia goes with the output's angle, a measured one with the stamps: at the other's instant the
    damping is 8 N m s/rad off."""
    recording = skewed(delay_s, sensor)
    model = Model("torsion", 100.0, INERTIA, (*BASE, ModelEffect("encoder_skew")))
    fitted = fit([recording], model)
    assert fitted.model.value("encoder_skew", "delay") == pytest.approx(delay_s, rel=2e-3)
    assert fitted.model.value("linear_stiffness", "stiffness") == pytest.approx(STIFFNESS, rel=5e-3)
    assert fitted.model.value("viscous_damping", "damping") == pytest.approx(DAMPING, abs=0.3)
    assert fitted.solution.rmse < 1.1 * fitted.floor


@pytest.mark.parametrize("delay_s", [4e-4, -4e-4])
def test_a_skew_beside_a_torque_sensor_is_named_alone(delay_s: float) -> None:
    found = diagnose([skewed(delay_s, True)], Model("torsion", 100.0, INERTIA, BASE))
    assert found.verdict == "missing"
    first = found.candidates[0]
    assert "encoder_skew" in {first.effect, *first.confused_with} and "+" not in first.effect


def test_a_problem_learns_from_a_solution_on_another_motion() -> None:
    """A planned motion is foretold with what was fitted on the recorded one, whose rows are others."""
    model = Model("torsion", 100.0, INERTIA, (*BASE, ModelEffect("maxwell_slip_hysteresis")))
    solution, other = fit([skewed(0.0, True)], model).solution, problem_of([skewed(0.0, True, 8.0)], model)
    other.learn(solution)
    assert other.tied[STIFFNESS_OF] == solution.amplitude(*STIFFNESS_OF) and other.came == (0.0,)


def test_noise_is_taken_out_without_a_leap() -> None:
    """A column of which half is noise: an error of six parts in a hundred of that noise doubled the inertia."""
    shares = np.linspace(0.0, 0.8, 801)
    taken = np.array([taken_out(share, 1.0) for share in shares])
    assert np.array_equal(taken[shares <= 0.4], shares[shares <= 0.4]) and not taken[shares >= 0.5].any()
    assert np.abs(np.diff(taken)).max() < 0.01
