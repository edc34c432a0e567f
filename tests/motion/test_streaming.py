"""Block by block against the whole record at once, which takes another way through the filter: a transform."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.motion.kinematics import filters, motion_of, uniform
from edge_daemon.motion.streaming import ORDERS, MotionFrame, MotionStream, Stretch
from edge_daemon.records import Array, Block

RATE_HZ, CUTOFF_HZ, RATIO, INERTIA = 1000.0, 100.0, -80.0, 0.05
SAMPLES = 3000


def record() -> dict[str, Array]:
    time_s = np.arange(SAMPLES) / RATE_HZ
    out = 0.7 + 0.8 * np.sin(2 * np.pi * 1.3 * time_s)
    twist = 2e-4 * np.sin(2 * np.pi * 17 * time_s) + 1e-3
    noise = np.random.default_rng(3).normal(size=(2, SAMPLES)) * 1e-6
    return {
        "theta_in_rad": RATIO * (out + twist) + noise[0],
        "theta_out_rad": out + noise[1],
        "temperature_degC": 30 + time_s,
    }


def stretches(columns: dict[str, Array], size: int, bad: tuple[int, ...] = ()) -> list[Stretch]:
    stream = MotionStream(MotionFrame(RATIO, INERTIA, False), filters(RATE_HZ, CUTOFF_HZ))
    flaws = np.zeros(SAMPLES, dtype=np.uint8)
    flaws[list(bad)] = 1
    found = []
    for i in range(0, SAMPLES - size + 1, size):
        part = {name: column[i : i + size] for name, column in columns.items()}
        marks = {name: flaws[i : i + size] if name == "theta_in_rad" else flaws[:size] * 0 for name in part}
        found.append(stream.push(Block("joint", i, i / RATE_HZ, RATE_HZ, part, marks)))
    return [stretch for stretch in found if stretch is not None]


@pytest.mark.parametrize("size", [90, 97, 100, 250])
def test_blocks_of_any_size_give_the_motion_of_the_whole_record(size: int) -> None:
    columns = record()
    whole, valid = motion_of(uniform(np.arange(SAMPLES) / RATE_HZ, columns), RATIO, INERTIA, CUTOFF_HZ)
    found = stretches(columns, size)
    at = np.rint(np.concatenate([row.motion.time_s for row in found]) * RATE_HZ).astype(int)
    assert valid[at].all() and len(at) > 0.9 * SAMPLES / {90: 3, 97: 1, 100: 2, 250: 2}[size]
    for name in (
        "theta_in_rad",
        "theta_out_rad",
        "twist_rate_rad_s",
        "velocity_out_rad_s",
        "acceleration_out_rad_s2",
        "torque_Nm",
        "temperature_degC",
        "twist_rad",
    ):
        seen = np.concatenate([getattr(row.motion, name) for row in found])
        true = getattr(whole, name)[at]
        if name == "twist_rad":  # counted from the encoders' zero, which nobody knows
            seen, true = seen - seen[0], true - true[0]
        np.testing.assert_allclose(seen, true, rtol=0, atol=1e-9 * np.abs(true).max(), err_msg=name)


def test_waves_are_those_of_the_motor_angle_through_the_same_filter() -> None:
    columns, fir = record(), filters(RATE_HZ, CUTOFF_HZ)
    found = stretches(columns, 100)
    at = np.rint(np.concatenate([row.motion.time_s for row in found]) * RATE_HZ).astype(int) - fir.delay
    for i, (order, wave) in enumerate((order, wave) for order in ORDERS for wave in (np.sin, np.cos)):
        angle = wave(order * columns["theta_in_rad"])
        for kernel, name in ((fir.value, "kinematic"), (fir.first, "kinematic_rate")):
            true = np.convolve(angle, kernel, "valid")[at]
            seen = np.concatenate([getattr(row, name)[:, i] for row in found])
            np.testing.assert_allclose(seen, true, rtol=0, atol=1e-9 * np.abs(true).max(), err_msg=f"{name} {order}")


def test_a_flawed_sample_is_invalid_as_far_as_the_filter_reaches_and_no_further() -> None:
    found, reach = stretches(record(), 97, bad=(1000, 1003)), filters(RATE_HZ, CUTOFF_HZ).delay
    at = np.rint(np.concatenate([row.motion.time_s for row in found]) * RATE_HZ).astype(int)
    valid = np.concatenate([row.valid for row in found])
    assert np.array_equal(valid, (at < 1000 - reach) | (at > 1003 + reach))
