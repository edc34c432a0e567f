"""Waves of other orders than a kinematic error usually has, followed live against true amplitudes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.effects.effect import Wave
from edge_daemon.effects.model import ModelEffect, Teeth
from edge_daemon.effects.waves import of_input
from edge_daemon.quantities import is_known
from edge_daemon.records import Status
from edge_daemon.track.live import DriveEstimator, fingerprint
from tests.motion import simulated_joint as rig

TOOTH = Wave("output", 202.0)
SIZES = {3.0: 5e-5, 2.02: 3e-5, 0.47: 4e-5}
"""Sizes [rad] by the order of the motor angle, which is a hundred times the output's."""


def model_of(joint: rig.Joint, *waves: Wave):
    plain = rig.model_of(joint)
    rows = [row for row in plain.effects if row.name != "kinematic_error"]
    own = (*of_input(1, 2, 4), *waves)
    return replace(plain, effects=(*rows, ModelEffect("kinematic_error", waves=own)), teeth=Teeth(200, 202))


@pytest.fixture(scope="module")
def run():
    joint = rig.Joint(waves=tuple((order, 0.6 * size, 0.8 * size) for order, size in SIZES.items()))
    model = model_of(joint, *of_input(3, 0.47), TOOTH)
    estimator = DriveEstimator(rig.drive_settings(joint), model)
    plain = DriveEstimator(rig.drive_settings(joint), model_of(joint))
    for block in rig.blocks(joint, *rig.linear(joint, rig.Path(seconds=30.0))):
        estimator.update(block)
        plain.update(block)
    return joint, estimator, {row.name: row for row in estimator.estimates}, {row.name: row for row in plain.estimates}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "order"), [("3", 3.0), ("0_47", 0.47), ("202_output", 2.02)])
def test_a_wave_of_any_order_and_angle_is_followed(run, name, order):
    found = run[2][f"kinematic_error_{name}"]
    assert found.status is Status.VALID and found.unit == "rad" and is_known(found.name)
    assert abs(found.value - SIZES[order]) < 4 * found.sd < 0.1 * SIZES[order]


def test_the_gear_beside_them_is_the_same_and_the_usual_orders_are_told_too(run):
    joint, _, rows, plain = run
    for name, truth in (("stiffness", joint.stiffness), ("damping", joint.damping)):
        assert rows[name].status is Status.VALID and abs(rows[name].value - truth) < 4 * rows[name].sd
    assert rows["model_nrmse"].value < 0.1 * plain["model_nrmse"].value
    main = {m: rows[f"kinematic_error_{m}"] for m in (1, 2, 4)}
    x = np.linspace(0, 2 * math.pi, 2001)
    course = rig.kinematic(replace(joint, waves=()), x)
    for m, row in main.items():
        size = 2 * abs(np.mean(course[:-1] * np.exp(-1j * m * x[:-1])))
        assert row.status is Status.VALID and abs(row.value - size) < 4 * row.sd < 0.1 * size


def test_teeth_name_the_order_and_another_set_of_orders_is_another_model(run):
    joint, estimator, _, _ = run
    meanings = {row.estimate.name: row.meaning for row in estimator.orders()}
    assert "circular spline tooth pass" in meanings["kinematic_error_202_output"]
    assert "wave generator, twice per turn" in meanings["kinematic_error_2"]
    assert meanings["kinematic_error_0_47"].endswith("0.47 per turn of the motor angle")
    assert fingerprint(estimator.model) != fingerprint(model_of(joint))
    assert not is_known("kinematic_error_") and not is_known("nonsense_3")
