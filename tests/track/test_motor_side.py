"""An arm whose only torque is the motor's, recorded as the output's, followed live."""

import math

import numpy as np
import pytest

from edge_daemon.config.settings import ChannelSettings, Drive
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.records import Block, Status
from edge_daemon.track.live import DriveEstimator
from tests.identify.test_motor_torque import (
    DRY_NM,
    RATIO,
    ROTOR_KG_M2,
    STIFFNESS,
    VISCOUS_NMS,
    as_recorded_by_a_robot,
)

RATE_HZ, BLOCK = 500.0, 50
TRUTH = {
    ("linear_stiffness", "stiffness"): STIFFNESS,
    ("motor_side", "friction"): DRY_NM,
    ("motor_side", "coefficient"): VISCOUS_NMS,
    ("motor_side", "inertia"): ROTOR_KG_M2,
}


def test_the_stiffness_is_told_beside_what_the_motor_side_takes() -> None:
    """Without that effect it was 2.7 times what it is."""
    joint = as_recorded_by_a_robot(0.0)
    channels = tuple(
        ChannelSettings(channel=name, source="can", signal=name, counts_per_turn=2**24 if "theta" in name else None)
        for name in joint.columns
    )
    drive = Drive(name="joint", modbus_device_id=1, model="m.toml", rate_hz=RATE_HZ, channels=channels)
    effects = tuple(map(ModelEffect, ("linear_stiffness", "viscous_damping", "motor_side")))
    estimator = DriveEstimator(drive, Model("torsion", RATIO, math.nan, effects))
    for i in range(len(joint.time_s) // BLOCK):
        values = {name: column[i * BLOCK : (i + 1) * BLOCK] for name, column in joint.columns.items()}
        flaws = {name: np.zeros(BLOCK, np.uint8) for name in values}
        estimator.update(Block("joint", i, i * BLOCK / RATE_HZ, RATE_HZ, values, flaws))
    for key, value in TRUTH.items():
        estimate = estimator.tracker.estimate(key[0], "", key)
        assert estimate.status is Status.VALID
        assert abs(estimate.value - value) < 3 * estimate.sd and estimate.value == pytest.approx(value, rel=0.05)
