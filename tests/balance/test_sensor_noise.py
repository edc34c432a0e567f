"""The noise of a channel, from numbers drawn with a known sd at instants that are even, uneven or lost."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.balance.sensor_noise import (
    angle_noise,
    noise_of_sensors,
    sensor_noise,
    uneven,
    without_glitches,
    without_spikes,
)

SD_RAD = 1e-6


def angle(rate_hz: float, jitter: float, lost: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Instants, and a fast motion with white noise read at them; `jitter`: sd over the sampling interval."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(20 * rate_hz)) / rate_hz
    time_s = time_s + np.clip(rng.normal(0, jitter, len(time_s)), -0.4, 0.4) / rate_hz
    time_s = time_s[rng.uniform(size=len(time_s)) >= lost]
    moved = 0.3 * np.sin(2 * np.pi * 0.4 * time_s) + 0.02 * np.sin(2 * np.pi * 9 * time_s)
    return time_s, moved + rng.normal(0, SD_RAD, len(time_s))


@pytest.mark.parametrize("jitter", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("lost", [0.0, 0.01])
@pytest.mark.parametrize("rate_hz", [1000.0, 4000.0])
def test_it_is_that_of_the_sensor_however_the_samples_came(rate_hz: float, jitter: float, lost: float) -> None:
    time_s, read = angle(rate_hz, jitter, lost, 17)
    assert uneven(time_s) == (jitter > 0)
    assert angle_noise(time_s, read) == pytest.approx(SD_RAD, rel=0.1)
    for quantile in (0.5, 0.1):
        assert sensor_noise(time_s, read, quantile) == pytest.approx(SD_RAD, rel=0.1)


@pytest.mark.parametrize("lost", [0.0, 0.005])
@pytest.mark.parametrize("rate_hz", [250.0, 1000.0])
def test_stamps_that_err_are_heard_at_all_speeds(rate_hz: float, lost: float) -> None:
    """A joint that creeps for most of a log and moves fast at its ends: a fifth of its noise was heard, and what the
    right model left was made up for by three wrong effects."""
    rng = np.random.default_rng(5)
    even = np.arange(round(60 * rate_hz)) / rate_hz
    time_s = even + np.clip(rng.normal(0, 0.15, len(even)), -0.4, 0.4) / rate_hz
    time_s = time_s[rng.uniform(size=len(time_s)) >= lost]
    moved = (0.26 + 0.24 * np.tanh(np.abs(time_s - 30) - 18)) * np.sin(2 * time_s)
    speed = np.gradient(moved, time_s)
    read = moved + rng.normal(0, SD_RAD / 5, len(time_s))
    stamps = time_s + rng.normal(0, 2e-5, len(time_s))
    true = np.sqrt((SD_RAD / 5) ** 2 + (2e-5) ** 2 * np.mean(speed**2))
    assert angle_noise(stamps, read) == pytest.approx(true, rel=0.15)


@pytest.mark.parametrize("moving", [0.2, 0.6, 1.0])
@pytest.mark.parametrize("rate_hz", [100.0, 500.0])
def test_instants_that_err_unseen_are_heard_where_a_joint_moves(rate_hz: float, moving: float) -> None:
    """A log of even stamps that lost some frames, of a joint that rests between its strokes: the noise of its rests was
    told, and the right model seemed to leave four times the noise."""
    rng = np.random.default_rng(8)
    stamps = np.arange(round(120 * rate_hz)) / rate_hz
    stamps = stamps[rng.uniform(size=len(stamps)) >= 0.01]
    stroke, into = np.divmod((stamps + rng.normal(0, 3e-4, len(stamps))) / 4.0, 1.0)
    moved = (-1.0) ** stroke * np.cos(np.pi * np.minimum(into / moving, 1.0))
    speed = np.where(into < moving, np.pi / (4.0 * moving) * np.sin(np.pi * into / moving), 0.0)
    read = moved + rng.normal(0, 2e-5, len(stamps))
    true = np.sqrt(2e-5**2 + 3e-4**2 * np.mean(speed**2))
    assert angle_noise(stamps, read) == pytest.approx(true, rel=0.15)


def test_what_moves_both_angles_together_is_no_noise_of_a_twist() -> None:
    """A robot's log whose stamps err: each angle seemed twenty times as noisy as the twist was, and an encoder off its
    centre was lost in that."""
    rng = np.random.default_rng(4)
    time_s = np.arange(8000) / 500.0
    moved = 0.8 * np.sin(2 * np.pi * 0.3 * (time_s + rng.normal(0, 2e-4, len(time_s))))
    columns = {"theta_in_rad": 100.0 * moved, "theta_out_rad": moved + rng.normal(0, SD_RAD, len(time_s))}
    noise = noise_of_sensors(time_s, columns, 100.0, drive=False)
    assert np.hypot(noise.theta_in_rad / 100.0, noise.theta_out_rad) == pytest.approx(SD_RAD, rel=0.1)
    assert noise.shaken * noise.theta_out_rad > 50 * SD_RAD


def test_an_angle_that_is_held_is_none_as_long_as_it_is() -> None:
    angle = 40.0 * np.sin(np.arange(900) / 90.0)
    read = angle.copy()
    read[31:38] = read[30]
    assert np.flatnonzero(np.isnan(without_spikes(read))).tolist() == list(range(31, 38))


@pytest.mark.parametrize("late", [0, 1])
def test_a_sample_that_is_read_again_is_none(late: int) -> None:
    """What a logger writes twice, and the next one late after it: they left 16 noise floors of a healthy joint."""
    angle = np.rint(40.0 * np.sin(np.arange(4000) / 90.0) / 5e-5) * 5e-5
    read, again = angle.copy(), np.arange(120, 3900, 97)
    again = again[np.abs(np.gradient(angle)[again]) > 0.05]
    for i in range(late + 1):
        read[again + i] = angle[again + i - 1]
    kept = without_spikes(read)
    assert np.isnan(kept[again]).all() and np.isnan(kept[again + late]).all()
    assert np.isnan(kept).sum() == (late + 1) * len(again)


def test_steps_of_a_coarse_encoder_are_no_samples_that_are_read_again() -> None:
    angle = np.rint(2.0 * np.sin(np.arange(4000) / 90.0) / 5e-3) * 5e-3
    assert np.array_equal(without_spikes(angle), angle)


@pytest.mark.parametrize("noise", [1e-3, 3e-2])
def test_glitches_of_a_torque_are_left_out_and_steps_of_friction_are_not(noise: float) -> None:
    """Six samples of a hundred thousand left 27 noise floors."""
    rng, time_s = np.random.default_rng(3), np.arange(5000) / 500.0
    torque = 5.0 * np.sin(3.0 * time_s) + 2.0 * np.sign(np.cos(2.1 * time_s)) + noise * rng.normal(size=len(time_s))
    read, at = torque.copy(), rng.choice(np.arange(10, 4990, 20), 6, replace=False)
    read[at] += 15.0 * rng.choice([-1.0, 1.0], 6)
    kept = without_glitches(read)
    assert set(np.flatnonzero(np.isnan(kept))) == set(at)
    assert not np.isnan(without_glitches(torque)).any()
    assert not np.isnan(without_glitches(np.round(torque))).any(), "a coarse converter"


def test_friction_that_turns_round_is_no_noise_of_a_torque_sensor() -> None:
    """It sounds in every band: twice the noise was heard, below which the right law was taken for none."""
    rng = np.random.default_rng(6)
    time_s = np.arange(15_000) / 500.0
    rate = np.cos(2 * np.pi * 1.3 * time_s) + 0.7 * np.cos(2 * np.pi * 3.1 * time_s)
    torque = 20.0 * np.sin(2 * np.pi * 0.4 * time_s) + 4.0 * np.sign(rate)
    angle = 0.3 * np.sin(2 * np.pi * 0.4 * time_s)
    read = {
        "theta_in_rad": 100.0 * angle,
        "theta_out_rad": angle,
        "torque_out_Nm": torque + rng.normal(0, 0.03, 15_000),
    }
    assert noise_of_sensors(time_s, read, 100.0, drive=False).torque == pytest.approx(0.03, rel=0.1)
