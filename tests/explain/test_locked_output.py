"""A stand that holds the output and loads the gear by its motor: the loop of torque over twist."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from edge_daemon.discover.discover import discover
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.plausibility import examine

MODEL = Model("torsion", 100.0, math.nan, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
RATE_HZ, ZERO_RAD = 250.0, 1.2e-3
HYSTERESES = ("bouc_wen_hysteresis", "maxwell_slip_hysteresis")


def loop(held_rad: float, seed: int = 1) -> SimpleNamespace:
    """Slow triangles of torque; a spring that is stiffer beyond 1 mrad, and four elements that slip beside it."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 30.0, 1.0 / RATE_HZ)
    top = np.interp(time_s, (0.0, 15.0, 30.0), (2.5e-3, 1.6e-3, 0.8e-3))
    twist = top * (2.0 / math.pi) * np.arcsin(np.sin(2.0 * math.pi * 0.21 * time_s))
    torque = 2e4 * twist + 1.6e4 * np.sign(twist) * np.maximum(np.abs(twist) - 1e-3, 0.0)
    for width, level in ((2e-4, 1.2), (4e-4, 1.2), (8e-4, 1.2)):
        strain = 0.0
        for i, step in enumerate(np.diff(twist, prepend=0.0)):
            strain = min(max(strain + step / width, -1.0), 1.0)
            torque[i] += level * strain
    out = 0.7 + held_rad * torque / 60.0
    step = 2.0 * math.pi / 2**20
    motor = 100.0 * (twist + out + ZERO_RAD)
    columns = {
        "theta_in_rad": np.round(motor / step) * step,
        "theta_out_rad": np.round(out / step) * step if held_rad else out,
        "torque_out_Nm": torque + rng.normal(scale=0.05, size=len(torque)),
    }
    return SimpleNamespace(time_s=time_s, columns=columns)


@pytest.mark.slow
@pytest.mark.parametrize("held_rad", [0.0, 4e-5])
def test_stiffness_and_hysteresis_of_a_held_gear_are_named(held_rad: float) -> None:
    """It was refused: its motor moves a thousand times as far as its output, or the output not at all."""
    found = diagnose([loop(held_rad)], MODEL)
    first = found.candidates[0]
    assert found.verdict == "missing"
    assert set(first.effect.split("+")) in ({"piecewise_stiffness", name} for name in HYSTERESES)
    assert first.nrmse_after < 0.1 * found.error.nrmse
    of_motion = ("kinematic_error", "encoder", "gravity", "output", "inertia", "mesh")
    assert not any(name.startswith(of_motion) for row in found.candidates for name in row.effect.split("+"))


def pushed(seed: int) -> SimpleNamespace:
    """A held gear that is pushed slowly and shaken quickly: a spring that is stiffer beyond 0.45 mrad, two elements
    that slip beside it, and a sensor that drifts by three times its noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 25.0, 1.0 / RATE_HZ)
    twist = 1.5e-3 * np.sin(2 * math.pi * 0.11 * time_s + seed) * np.interp(time_s, (0, 12, 25), (1.0, 0.3, 0.8))
    for hz, size in ((0.43, 2.5e-4), (1.3, 1.2e-4)):
        twist += size * np.sin(2 * math.pi * hz * time_s + rng.uniform(0, 6.28))
    torque = 1.5e4 * twist + 1e4 * np.sign(twist) * np.maximum(np.abs(twist) - 4.5e-4, 0.0)
    for width, level in ((1.3e-4, 1.5), (6e-4, 1.0)):
        strain = 0.0
        for i, step in enumerate(np.diff(twist, prepend=0.0)):
            strain = min(max(strain + step / width, -1.0), 1.0)
            torque[i] += level * strain
    drift = gaussian_filter1d(rng.normal(size=len(time_s)), 0.4 * RATE_HZ)
    torque += 0.15 / drift.std() * drift + rng.normal(scale=0.05, size=len(time_s))
    step = 2.0 * math.pi / 2**20
    motor = np.round(100.0 * (twist + 0.3) / step) * step
    columns = {"theta_in_rad": motor, "theta_out_rad": np.zeros(len(time_s)), "torque_out_Nm": torque}
    return SimpleNamespace(time_s=time_s, columns=columns)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seed", [1, 2])
def test_floors_above_the_noise_do_not_hide_what_no_formula_says_as_well(seed: int) -> None:
    """Formulas that left three times as much were told instead, of a law that the catalogue holds."""
    found = discover([pushed(seed), pushed(seed + 10)], MODEL)
    assert found.verdict == "missing" and not found.proposals
    assert set(found.candidates[0].effect.split("+")) == {"piecewise_stiffness", "maxwell_slip_hysteresis"}
    assert found.candidates[0].nrmse_after < 0.15 * found.error.nrmse
    bent = [row for row in found.candidates if "piecewise_stiffness" in row.effect.split("+")]
    assert 0.5 < sum(row.probability for row in bent) < 0.95


def test_it_is_said_once_what_a_held_output_does_not_tell() -> None:
    said = examine([loop(4e-5), loop(4e-5, 2)], MODEL)
    assert sum("locked" in line for line in said) == 1


def test_the_zero_of_a_stand_is_where_the_torque_is_nought() -> None:
    """A straight line through a spring that bends had it off by a corner's tenth, and left twelve noise floors."""
    read = loop(0.0)
    twist = read.columns["theta_in_rad"] / 100.0 - 0.7 - ZERO_RAD
    bent = 2e4 * twist + 1.6e4 * np.sign(twist) * np.maximum(np.abs(twist) - 1e-3, 0.0)
    read.columns["torque_out_Nm"] = bent + np.random.default_rng(3).normal(scale=0.05, size=len(bent))
    found = diagnose([read], MODEL)
    first = found.candidates[0]
    assert first.effect == "piecewise_stiffness" and first.probability > 0.8
    assert first.nrmse_after < 1.5 * found.error.noise_floor_nrmse
