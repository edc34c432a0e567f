"""The simulated output angle against the one that was read: as sharp as the Cramer-Rao bound, or not used at all."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.band_limit import REACH_S, band_limited
from edge_daemon.identify.fit import Fitted, fit
from edge_daemon.rig.recording import simulate
from tests.motion import simulated_joint as rig

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import cramer_rao

pytestmark = pytest.mark.slow

JOINT = rig.Joint(out_bits=20)
PATH = rig.Path(seconds=10.0)


def fitted(joint: rig.Joint, angles: tuple[np.ndarray, np.ndarray], seed: int, *more: str) -> Fitted:
    """The batch fit of white noise of the encoders' size, not of their rounding, which repeats with the motion; the
    encoders' zeros are apart."""
    rng = np.random.default_rng(seed)
    steps = 2 * math.pi / 2**joint.in_bits, 2 * math.pi / 2**joint.out_bits
    noisy = [
        angle + step / math.sqrt(12) * rng.normal(size=len(angle)) for angle, step in zip(angles, steps, strict=True)
    ]
    columns = {"theta_in_rad": noisy[0] + 7.0, "theta_out_rad": noisy[1] - 0.3}
    model = rig.model_of(joint, "linear_stiffness", "viscous_damping", *more)
    return fit([SimpleNamespace(time_s=np.arange(len(noisy[0])) / rig.RATE_HZ, columns=columns)], model)


@pytest.mark.parametrize("bits", [20, 24])
def test_errors_are_those_of_the_cramer_rao_bound_and_stated(bits: int) -> None:
    """At 24 bits most of the noise is the motor encoder's, and counts only where the motor moves: below 30 Hz."""
    joint = replace(JOINT, out_bits=bits)
    bound, angles = cramer_rao.bounds(joint, PATH, motor_hz=30.0), rig.linear(joint, PATH)
    errors, scores = [], []
    for seed in range(8):
        found = fitted(joint, angles, seed, "kinematic_error")
        assert found.sharp is not None
        value, sd = found.sharp.ratio
        rows = [(value - joint.ratio, sd, bound["ratio"])]
        for effect, name in (("linear_stiffness", "stiffness"), ("viscous_damping", "damping")):
            row = found.model.effect(effect).parameters[name]  # type: ignore[union-attr]
            rows.append((row.value - getattr(joint, name), row.sd, bound[name]))
        errors.append([error / least for error, _, least in rows])
        scores.append([error / sd for error, sd, _ in rows])
    assert np.sqrt(np.mean(np.square(errors))) < 1.28, "24 values: under two standard deviations above one"
    assert 0.72 < np.sqrt(np.mean(np.square(scores))) < 1.28


def test_a_model_that_lacks_something_is_left_to_the_balance() -> None:
    angles = rig.linear(JOINT, PATH)
    assert fitted(JOINT, angles, 1).sharp is None, "a kinematic error of one arc-minute is missing"
    assert fitted(replace(JOINT, kinematic_pp=0.0), rig.linear(replace(JOINT, kinematic_pp=0.0), PATH), 1).sharp


def test_friction_is_told_from_damping_and_its_width_is_found() -> None:
    joint = rig.Joint(out_bits=20, coulomb=0.5)
    found = fitted(joint, rig.stepped(joint, PATH), 3, "coulomb_friction", "kinematic_error")
    assert found.sharp is not None
    friction = found.model.effect("coulomb_friction")
    damping = found.model.effect("viscous_damping")
    assert friction is not None and damping is not None
    for row, truth in (
        (friction.parameters["friction"], joint.coulomb),
        (friction.parameters["smoothing"], joint.reversal),
        (damping.parameters["damping"], joint.damping),
    ):
        assert abs(row.value - truth) < 4 * row.sd
        assert row.sd < 0.1 * truth


def test_where_there_is_no_friction_neither_its_level_nor_its_width_is_identified() -> None:
    found = fitted(JOINT, rig.linear(JOINT, PATH), 2, "coulomb_friction", "kinematic_error")
    rows = found.model.effect("coulomb_friction").parameters  # type: ignore[union-attr]
    assert not rows["smoothing"].identified and not rows["friction"].identified


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_a_quiet_angle_keeps_the_motion_and_loses_the_noise(noise: float) -> None:
    t = np.arange(8000) / 1000.0
    slow, fast = 2 * np.pi * 0.7, 2 * np.pi * 17.3
    angle = 0.8 * np.sin(slow * t) + 0.01 * np.sin(fast * t) + 0.3 * t
    rate = 0.8 * slow * np.cos(slow * t) + 0.01 * fast * np.cos(fast * t) + 0.3
    found = band_limited(angle + noise * np.random.default_rng(3).normal(size=len(t)), noise, 1000.0)
    inside = slice(round(1000 * REACH_S), -round(1000 * REACH_S))
    left = np.sqrt(np.mean((found.angle - angle)[inside] ** 2))
    assert left < 0.4 * noise + 1e-8
    assert left == pytest.approx(noise * np.sqrt(np.mean(found.gain**2)), rel=0.15, abs=1e-8)
    assert np.sqrt(np.mean((found.rate - rate)[inside] ** 2)) < 2 * np.pi * 40 * 0.4 * noise + 2e-6


def test_a_shake_that_no_single_frequency_tells_is_motion_too() -> None:
    rng, noise, n = np.random.default_rng(4), 1e-6, 20_000
    frequency = np.fft.rfftfreq(n, 1e-3)
    shake = np.fft.irfft(np.fft.rfft(2 * noise * rng.normal(size=n)) * ((frequency > 60) & (frequency < 80)), n)
    found = band_limited(
        np.sin(2 * np.pi * 0.7 * np.arange(n) / 1000) + shake + noise * rng.normal(size=n), noise, 1000.0
    )
    kept = found.gain > 0.99
    assert kept[(frequency > 60) & (frequency < 80)].all() and kept[frequency < 5].all()
    assert not kept[(frequency > 25) & (frequency < 40)].any() and not kept[frequency > 120].any()


@pytest.mark.parametrize(
    ("effect", "seed", "own"),
    [
        ("stribeck_friction", 31705, {"friction": "level_Nm", "stribeck_speed": "stribeck_rad_s"}),
        ("lugre_friction", 7948, {"friction": "level_Nm", "bristle_damping": "bristle_Nms_per_rad"}),
        ("backlash", 7948, {}),
        ("encoder_eccentricity", 23786, {}),
    ],
)
def test_numbers_of_a_law_are_as_sure_as_steps_and_the_motors_noise_leave_them(
    effect: str, seed: int, own: dict[str, str]
) -> None:
    """A friction that falls with the rate makes so much of the motor encoder's rounding that its numbers were 38
    deviations off; bristles without their own damping made 11 of it; under fine encoders the steps of the simulation
    moved a damping by six, and the acceleration of what an eccentric encoder misreads a stiffness by a hundred."""
    made = simulate((effect,), 20.0, seed=seed)
    drawn = made.truth["parameters"]
    rows = tuple(map(ModelEffect, ("linear_stiffness", "viscous_damping", effect)))
    model = fit([made], Model("torsion", drawn["ratio"], drawn["inertia_kg_m2"], rows)).model
    truth = {("linear_stiffness", "stiffness"): drawn["stiffness_Nm_per_rad"]}
    truth |= {("viscous_damping", "damping"): drawn["damping_Nms_per_rad"]}
    truth |= {(effect, name): drawn[f"{effect}.{drew}"] for name, drew in own.items()}
    for (name, parameter), value in truth.items():
        found = model.effect(name).parameters[parameter]
        assert found.identified and abs(found.value - value) < 3.5 * found.sd, (name, parameter)
