"""Noise of a current as amplifiers filter it, beside a motion with reversals and ripple: truth by construction."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from edge_daemon.balance.torque_noise import is_noise, stationary_noise
from edge_daemon.cli import main
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit
from edge_daemon.motion.kinematics import filters
from edge_daemon.records import Array, Motion

RATE_HZ = 250.0
FIR = filters(RATE_HZ, 100.0)


def noise(memory_s: float, averaged: int, rng: np.random.Generator) -> Array:
    """White noise behind a filter of first order and a running mean."""
    kept = math.exp(-1 / (memory_s * RATE_HZ)) if memory_s else 0.0
    out = rng.normal(size=8000)
    for i in range(1, len(out)):
        out[i] = kept * out[i - 1] + math.sqrt(1 - kept**2) * out[i]
    return np.convolve(out, np.ones(averaged) / averaged)[: len(out)]


def moving(ripple: float) -> Array:
    """Torque of a weight, of friction that turns about, and of ripple that runs through all frequencies."""
    t = np.arange(8000) / RATE_HZ
    speed = 0.5 * np.sin(0.9 * t) + 0.3 * np.sin(2.3 * t)
    angle = np.cumsum(speed) / RATE_HZ
    return 400 * np.sin(angle) + 60 * np.sign(speed) + ripple * np.sin(200 * angle)


@pytest.mark.parametrize("ripple", [0.0, 20.0])
@pytest.mark.parametrize(("memory_s", "averaged"), [(0.0, 1), (0.0, 3), (0.01, 1), (0.004, 2)])
def test_it_is_that_behind_the_filter_however_the_current_was_filtered(
    memory_s: float, averaged: int, ripple: float
) -> None:
    own = noise(memory_s, averaged, np.random.default_rng(3))
    heard = stationary_noise(RATE_HZ, moving(ripple) + own, np.ones(len(own), dtype=bool))
    assert heard is not None
    true = float(np.mean(FIR.apply(FIR.value, own)[200:-200] ** 2))
    assert 0.6 < math.sqrt(heard.through(FIR) / true) < 1.5


def test_a_short_recording_and_one_of_gaps_tell_nothing() -> None:
    own = noise(0.0, 1, np.random.default_rng(4))
    assert stationary_noise(RATE_HZ, own[:500], np.ones(500, dtype=bool)) is None
    assert stationary_noise(RATE_HZ, own, np.arange(len(own)) % 60 > 0) is None


def test_a_log_of_ten_rows_a_second_has_no_frequency_to_listen_to() -> None:
    """All of none were told, and what is not there was laid out along the filter."""
    torque = np.random.default_rng(1).normal(size=4000)
    assert stationary_noise(10.0, torque, np.ones(len(torque), dtype=bool)) is None


def test_a_motion_without_noise_is_not_taken_for_noise() -> None:
    """What is left by rounding, and by the reversals of a motion, is far below both."""
    torque = moving(20.0)
    heard = stationary_noise(RATE_HZ, torque, np.ones(len(torque), dtype=bool))
    assert heard is None or math.sqrt(heard.through(FIR)) < 0.02 * 20.0


def shaken(seed: int) -> tuple[Array, Array]:
    """Angle of a motor that goes slowly to and fro and is shaken up to 13 Hz, and the torque of its rotor and of a load
    that swings on the gear at 9 Hz: each tone's own answer, so nothing is integrated."""
    rng, time_s = np.random.default_rng(seed), np.arange(15000) / (2 * RATE_HZ)
    omega = 2 * math.pi * np.r_[0.17, rng.uniform(0.4, 13.0, 23)]
    own = (2 * math.pi * 9.0) ** 2
    swing = (own + 0.02j * math.sqrt(own) * omega) / (own + 0.02j * math.sqrt(own) * omega - omega**2)
    size = np.r_[0.6, 0.02 / omega[1:]]
    tones = size * np.exp(1j * (omega * time_s[:, None] + rng.uniform(0, 6.28, 24)))
    return tones.imag.sum(axis=1), (-(omega**2) * (4.0 + 30.0 * swing) * tones).imag.sum(axis=1)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_load_that_swings_is_not_heard_as_noise(seed: int) -> None:
    """It rings for longer than a window lasts: noise seemed 300 times itself, and 65 % of error near it."""
    angle, torque = shaken(seed)
    rng = np.random.default_rng(seed)
    step = 2 * math.pi / 2**20
    columns = {
        "theta_in_rad": np.round(100.0 * angle / step) * step,
        "torque_in_Nm": (torque + rng.normal(0, 1e-3 * torque.std(), len(torque))) / 100.0,
    }
    rows = tuple(map(ModelEffect, ("inertia", "viscous_friction", "coulomb_friction")))
    fitted = fit(
        [SimpleNamespace(time_s=np.arange(len(angle)) / (2 * RATE_HZ), columns=columns)],
        Model("drive", 100.0, math.nan, rows),
    )
    assert fitted.solution.rmse > 100 * fitted.floor


def test_what_goes_with_the_motion_is_not_heard_as_noise() -> None:
    """The torque of an inertia shaken up to 12 Hz, a thousand times the noise of the current."""
    rng = np.random.default_rng(3)
    shaking = np.asarray(sosfilt(butter(6, 12.0, fs=RATE_HZ, output="sos"), rng.normal(size=8000)))
    own = 1e-3 * rng.normal(size=8000)
    every = np.ones(len(own), dtype=bool)
    heard = stationary_noise(RATE_HZ, shaking + own, every, (shaking,))
    true = float(np.mean(FIR.apply(FIR.value, own)[200:-200] ** 2))
    assert heard is not None and 0.6 < math.sqrt(heard.through(FIR) / true) < 1.5


@pytest.mark.slow
def test_tones_that_never_cease_are_not_noise(tmp_path: Path) -> None:
    """Friction that grows with the load, of which a model knows nothing: its current holds 0.1 % of white noise."""
    rec, model, found = (str(tmp_path / name) for name in ("d.csv", "d.toml", "d.json"))
    words = ["simulate", "--balance", "drive", "--effect", "load_dependent_friction", "--seconds", "12"]
    assert main([*words, "--out", rec, "--model", model]) == 0
    assert main(["compare", rec, "--model", model, "--json", found]) == 0
    error = json.loads(Path(found).read_text())["error"]
    assert error["nrmse"] > 10 * error["noise_floor_nrmse"]


def swinging(seconds: float) -> Motion:
    """A joint that swings at two frequencies."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    speed = 0.5 * np.sin(0.9 * t) + 0.3 * np.sin(2.3 * t)
    angle = np.cumsum(speed) / RATE_HZ
    empty = np.zeros_like(t)
    return Motion(
        rate_hz=RATE_HZ,
        ratio=100.0,
        time_s=t,
        theta_in_rad=100.0 * angle,
        theta_out_rad=angle,
        twist_rad=empty,
        twist_rate_rad_s=empty,
        velocity_out_rad_s=speed,
        acceleration_out_rad_s2=np.gradient(speed, t),
        torque_Nm=empty,
        temperature_degC=empty,
    )


def coloured(count: int, hz: float) -> Array:
    """White noise behind a filter of second order."""
    rng = np.random.default_rng(5)
    return np.asarray(sosfilt(butter(2, hz, fs=RATE_HZ, output="sos"), rng.normal(size=count)))


def test_slow_noise_of_few_independent_samples_is_no_curve() -> None:
    """Few of them make the mean of a place, so that chance alone held a tenth of the power: none of four passed."""
    motion = swinging(20.0)
    every, slow = np.arange(len(motion)), butter(2, 6.0, fs=RATE_HZ, output="sos")
    noises = [sosfilt(slow, np.random.default_rng(seed).normal(size=len(motion))) for seed in range(4)]
    assert sum(is_noise(motion, every, np.asarray(noise)) for noise in noises) >= 3


@pytest.mark.parametrize("hz", [20.0, 80.0, 120.0])
def test_what_follows_nothing_of_the_motion_is_noise_of_any_colour(hz: float) -> None:
    motion = swinging(40.0)
    every = np.arange(len(motion))
    assert is_noise(motion, every, coloured(len(motion), hz))


@pytest.mark.parametrize("share", [0.5, 1.0, 3.0])
def test_a_law_that_is_missing_is_no_noise(share: float) -> None:
    """Viscous friction of the power of the noise and of a quarter and nine times as much."""
    motion = swinging(40.0)
    noise, speed = coloured(len(motion), 40.0), motion.velocity_out_rad_s
    assert not is_noise(motion, np.arange(len(motion)), noise + share * speed * noise.std() / speed.std())


def test_a_tone_by_the_clock_is_no_noise() -> None:
    """Of half the power of the noise: it never comes back at the same motion, as noise does not."""
    motion = swinging(40.0)
    noise, tone = coloured(len(motion), 40.0), np.sin(2 * math.pi * 17.3 * motion.time_s)
    assert not is_noise(motion, np.arange(len(motion)), noise + noise.std() * tone)


def test_a_ripple_that_the_load_makes_is_no_noise() -> None:
    """Waves so fine that like motion is never at the same of them, as large as the acceleration."""
    motion = swinging(40.0)
    ripple = motion.acceleration_out_rad_s2 * np.sin(900.0 * motion.theta_out_rad)
    assert not is_noise(motion, np.arange(len(motion)), ripple)


def test_what_fades_along_a_recording_is_no_noise() -> None:
    """To a third of its size, and as unlike at like motion as noise: so is what a law leaves of a sweep."""
    motion = swinging(40.0)
    fading = coloured(len(motion), 80.0) * np.exp(-motion.time_s / 40.0)
    assert not is_noise(motion, np.arange(len(motion)), fading)


def test_too_short_a_motion_to_come_back_tells_no_noise() -> None:
    motion = swinging(0.6)
    assert not is_noise(motion, np.arange(len(motion)), coloured(len(motion), 80.0))


@pytest.mark.parametrize("told", [True, False])
def test_friction_that_comes_and_goes_by_itself_is_no_noise(told: bool) -> None:
    """A brake that drags for some seconds at a time is as unlike at like motion as noise, whether its coil is read."""
    motion = swinging(40.0)
    coil = np.where(np.sin(1.1 * motion.time_s) + np.sin(0.43 * motion.time_s) > 0.0, 0.6, 0.3)
    motion = replace(motion, extra={"brake_current_A": coil} if told else {})
    drag = (coil - coil.mean()) * np.sign(motion.velocity_out_rad_s)
    assert not is_noise(motion, np.arange(len(motion)), drag + 0.3 * drag.std() * coloured(len(motion), 40.0))
