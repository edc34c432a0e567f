"""A speed from the angle and from a channel of its own together, held against the motion that both were read of."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.balance.motion_noise import MotionNoise, with_measured_speed
from edge_daemon.balance.preparation import prepare
from edge_daemon.balance.sensor_noise import rounding
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit
from edge_daemon.motion.kinematics import FirSet, filters, motion_of, uniform
from edge_daemon.records import Array, Motion
from tests.explain.simulated_drives import Arm, Sensing, record

RATE_HZ, CUTOFF_HZ = 500.0, 100.0
TIME_S = np.arange(20_000) / RATE_HZ
TONES = ((0.4, 2 * math.pi * 0.7), (0.02, 2 * math.pi * 5.0))
ANGLE_RAD = np.sum([a * np.sin(w * TIME_S) for a, w in TONES], axis=0)
SPEED_RAD_S = np.sum([a * w * np.cos(w * TIME_S) for a, w in TONES], axis=0)


def read(noise: MotionNoise, speed_too: bool = True) -> tuple[Motion, FirSet]:
    """The motion as sensors of this noise tell it."""
    rng = np.random.default_rng(11)
    columns = {
        "theta_out_rad": ANGLE_RAD + rng.normal(0, noise.angle_rad, len(TIME_S)),
        "torque_in_Nm": np.ones(len(TIME_S)),
    }
    if speed_too:
        columns["velocity_out_rad_s"] = SPEED_RAD_S + rng.normal(0, noise.speed_rad_s, len(TIME_S))
    even = uniform(TIME_S, columns)
    fir = filters(RATE_HZ, CUTOFF_HZ)
    return with_measured_speed(motion_of(even, 100.0, 0.0, CUTOFF_HZ, drive=True).motion, even, fir, noise), fir


def error(motion: Motion, fir: FirSet) -> float:
    """rms of the speed's error, ends left out."""
    inside = slice(fir.delay + 1000, -fir.delay - 1000)
    return float(np.std((motion.velocity_out_rad_s - fir.apply(fir.value, SPEED_RAD_S))[inside]))


@pytest.mark.parametrize(("angle_rad", "speed_rad_s"), [(2e-5, 2e-3), (1e-6, 5e-3), (2e-4, 1e-3)])
def test_both_together_are_better_than_either_and_as_good_as_promised(angle_rad: float, speed_rad_s: float) -> None:
    noise = MotionNoise(RATE_HZ, angle_rad, speed_rad_s)
    both, fir = read(noise)
    alone, _ = read(MotionNoise(RATE_HZ, angle_rad, math.inf), speed_too=False)
    by_speed = speed_rad_s * math.sqrt(fir.bandwidth)
    assert error(both, fir) < 1.02 * min(error(alone, fir), by_speed)
    assert error(both, fir) == pytest.approx(noise.speed_sd(fir), rel=0.05)


def test_the_cut_off_is_where_the_speed_is_as_sure_as_wanted() -> None:
    noise = MotionNoise(RATE_HZ, 2e-5, math.inf)
    cutoff_hz = noise.cutoff_hz(3e-3, 6.0, 160.0)
    assert 6.0 < cutoff_hz < 160.0
    assert noise.speed_sd(filters(RATE_HZ, cutoff_hz)) == pytest.approx(3e-3, rel=0.15)
    assert noise.cutoff_hz(1e-9, 6.0, 160.0) == 6.0
    assert noise.cutoff_hz(1.0, 6.0, 160.0) == pytest.approx(160.0)


@pytest.mark.slow
@pytest.mark.parametrize("bits", [16, 20, 23])
def test_a_noisy_speed_hides_no_more_than_none(bits: int) -> None:
    """Its noise stood in inertia times acceleration, and a floor ten times as high hid what the angle tells."""
    arm = Arm(weight_Nm=12.0)
    known = ("inertia", "viscous_friction", "coulomb_friction", "gravity_load")
    model = Model("drive", 100.0, math.nan, tuple(map(ModelEffect, known)))
    made = record(arm, 3, sensing=Sensing(bits=bits, velocity_rad_s=5e-3))
    bare = {name: column for name, column in made.columns.items() if name != "velocity_out_rad_s"}
    both, alone = (fit([SimpleNamespace(time_s=made.time_s, columns=c)], model) for c in (made.columns, bare))
    assert both.floor < 1.1 * alone.floor
    assert 0.8 < both.solution.rmse / both.floor < 1.5


def steps(column: Array, step: float) -> Array:
    return np.rint(column / step) * step


def test_only_a_channel_that_rests_is_coarse() -> None:
    """Of a fine encoder the smallest moves are many steps, and a floor was taken for thirteen times too high."""
    assert rounding(steps(ANGLE_RAD, 1e-6)) == 0.0
    assert rounding(steps(ANGLE_RAD, 0.02)) == pytest.approx(0.02 / math.sqrt(12))


def test_what_an_encoder_leaves_in_the_torque_is_not_heard_twice() -> None:
    """All that a first look leaves holds the noise of inertia times acceleration, which was taken for the motor's."""
    made = record(Arm(weight_Nm=12.0, inertia_kg_m2=2.0), 5, sensing=Sensing(bits=14))
    trial = prepare(made.time_s, made.columns, Model("drive", 100.0, math.nan, (ModelEffect("inertia"),)))
    accelerated = 2.0 / 100.0 * math.sqrt(trial.acceleration_noise)
    assert trial.drive_floor == pytest.approx(accelerated, rel=0.15)
