"""Doubt of numbers whose model lacks an effect, against gears simulated with it by equations of their own."""

import math

import numpy as np
import pytest

from edge_daemon.motion.noise_level import ColumnNoise
from edge_daemon.motion.regressors import Regressors
from edge_daemon.records import Status
from edge_daemon.track.live import DriveEstimator
from edge_daemon.track.model_bias import FIND_BLOCKS, ModelBias
from tests.motion import simulated_joint as rig
from tests.track import simulated_laws as laws

SECONDS = 12.0
LEAST_DOUBT = 5.0
"""Sd [N m s/rad] that a missing friction leaves at the least in the damping."""


def run(joint, theta_in, theta_out):
    """The estimator and all its estimates, block by block, by name."""
    estimator = DriveEstimator(rig.drive_settings(joint, warm_up_s=2.0), rig.model_of(joint))
    stream = rig.blocks(joint, theta_in, theta_out)
    return estimator, [{row.name: row for row in estimator.update(block)} for block in stream]


@pytest.mark.parametrize(
    ("missing", "wrong", "least_sd"),
    [
        (laws.Laws(level=0.05), "damping", LEAST_DOUBT),
        (laws.Laws(half_gap=3e-6), "stiffness", 4e3),
    ],
)
def test_what_an_effect_adds_to_a_number_that_lacks_it_is_within_its_doubt(missing, wrong, least_sd):
    joint = rig.Joint()
    found = laws.run(joint, rig.Path(seconds=SECONDS), missing)
    _, course = run(joint, found.theta_in, found.theta_out)
    for name in ("stiffness", "damping"):
        row, truth = course[-1][name], getattr(joint, name)
        assert abs(row.value - truth) < 3 * row.sd
        if name == wrong:
            assert abs(row.value - truth) > 0.7 * least_sd
            assert row.sd > least_sd


def test_the_right_model_is_in_no_more_doubt_than_its_noise_leaves():
    joint = rig.Joint(out_bits=20)
    _, course = run(joint, *rig.linear(joint, rig.Path(seconds=SECONDS)))
    damping = course[-1]["damping"]
    assert damping.status is Status.VALID and damping.sd < 0.1 * LEAST_DOUBT


def test_noise_in_the_columns_makes_no_shape():
    """The noise of a twist stands in its shapes and in what is left: their product must not pass for an effect."""
    rng = np.random.default_rng(5)
    regressors = Regressors(rig.model_of(rig.Joint()))
    lacking, k, n, noise_sd = ModelBias(regressors), len(regressors.keys), 100, 0.1
    value = np.zeros(k)
    value[0] = 2.0
    inside = np.zeros((k, k))
    inside[0, 0] = noise_sd**2
    for _ in range(10 * FIND_BLOCKS):
        columns = rng.normal(size=(n, k))
        columns[:, 0] = math.sqrt(2) * np.sin(rng.uniform(0, 2 * math.pi, n))
        torque = columns @ value
        columns[:, 0] += noise_sd * rng.normal(size=n)
        lacking.follow(columns, torque, 0.0, 2.0 * noise_sd, ColumnNoise(inside, np.zeros(k)), value)
    assert not lacking.doubt.any()


def test_a_model_that_is_contradicted_again_and_again_tells_no_change_and_is_not_valid():
    """A weight on the output, unknown to the model, twists the gear by a tenth of what the motion does, but slowly."""
    joint = rig.Joint()
    theta_in, theta_out = rig.linear(joint, rig.Path(seconds=20.0))
    sagging = theta_out - 1.0 / joint.stiffness * np.sin(theta_out + 0.3)
    estimator, course = run(joint, theta_in, sagging)
    assert estimator.stiffness_changes == (0, 0)
    valid = [rows["stiffness"] for rows in course if rows["stiffness"].status is Status.VALID]
    wrong = sum(abs(row.value - joint.stiffness) > 4 * row.sd for row in valid)
    assert wrong <= 0.05 * len(valid)


def test_what_was_left_outlives_a_restart():
    joint = rig.Joint()
    found = laws.run(joint, rig.Path(seconds=SECONDS), laws.Laws(level=0.05))
    estimator, course = run(joint, found.theta_in, found.theta_out)
    again = DriveEstimator(estimator.drive, estimator.model)
    assert again.restore(estimator.state())
    damping = again.tracker.estimate("damping", "N m s/rad", ("viscous_damping", "damping"))
    assert damping.sd == pytest.approx(course[-1]["damping"].sd, rel=0.05)
