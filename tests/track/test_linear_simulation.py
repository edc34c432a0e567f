"""The twist by impulse response against a joint solved in the frequency domain, and what it makes of the damping."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.motion.excitation import SensorNoise
from edge_daemon.motion.kinematics import filters
from edge_daemon.motion.linear_simulation import LinearPrediction
from edge_daemon.motion.regressors import EncoderNoise, Linearisation, Regressors
from edge_daemon.motion.streaming import MotionFrame, MotionStream
from edge_daemon.track.live import DriveEstimator
from edge_daemon.track.relinearisation import DOUBTED_S, LINEAR, Relinearisation
from edge_daemon.track.state import AmplitudeState
from tests.motion import simulated_joint as rig

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import cramer_rao

JOINT = rig.Joint(in_bits=40, out_bits=40)
PATH = rig.Path(seconds=4.0)
ENCODER_RAD = 2 * math.pi / 2**24 / math.sqrt(12)


def rows_of(joint, around=JOINT):
    """Columns and torque of the prediction around one joint's own numbers, of the motion of another."""
    course = [(1, 0.3, 1.0), (2, 1.0, 0.3), (4, 0.2, -0.5)]
    x = np.linspace(0, 2 * math.pi, 2001)
    size = joint.kinematic_pp / np.ptp(sum(a * np.sin(m * x + p) for m, a, p in course))
    waves = [size * a * np.exp(1j * (p - 0.7 * m)) for m, a, p in course]  # `rig.blocks` turns the motor by 0.7
    error_rad = np.array([part for wave in waves for part in (wave.real, wave.imag)])
    fir, regressors = filters(rig.RATE_HZ, 100.0), Regressors(rig.model_of(joint))
    noise = SensorNoise(regressors, fir, EncoderNoise(1e-12, 1e-12), False)
    stream, prediction = (
        MotionStream(MotionFrame(joint.ratio, joint.inertia, False), fir),
        LinearPrediction(regressors, fir),
    )
    columns, torque, point = [], [], None
    for block in rig.blocks(joint, *rig.linear(joint, PATH)):
        stretch = stream.push(block)
        if stretch is not None:
            zero_rad = stretch.zero_rad - (0.7 / joint.ratio + 0.3)
            point = point or Linearisation(around.stiffness, around.damping / around.stiffness, error_rad, zero_rad)
            equation = prediction.equation(stretch, np.empty(0), point, noise)
            columns.append(equation.columns)
            torque.append(equation.torque)
    k = point.stiffness
    amplitudes = np.concatenate(([k, around.damping, k * point.zero_rad], k * error_rad))
    return np.concatenate(columns), np.concatenate(torque), amplitudes


def test_prediction_is_the_simulated_twist():
    columns, torque, amplitudes = rows_of(JOINT)
    assert len(torque) > 3000
    left = torque - columns @ amplitudes
    assert np.sqrt(np.mean(left**2)) < 0.05 * JOINT.stiffness * ENCODER_RAD


@pytest.mark.parametrize(("name", "step"), [("stiffness", 1e-3), ("damping", 1e-2)])
def test_a_gear_that_differs_a_little_is_found_where_it_is(name, step):
    joint = replace(JOINT, **{name: getattr(JOINT, name) * (1 + step)})
    columns, torque, amplitudes = rows_of(joint, around=JOINT)
    scale = np.linalg.norm(columns, axis=0)
    found = np.linalg.lstsq(columns / scale, torque, rcond=None)[0] / scale
    assert found[0] == pytest.approx(joint.stiffness, rel=1e-5)
    assert found[1] == pytest.approx(joint.damping, rel=1e-3)
    assert found[3:] == pytest.approx(amplitudes[3:], abs=1e-3)  # N m: they hold K0 e0 as long as e is e0


@pytest.mark.parametrize("size", [100, 300])
def test_damping_is_known_as_well_as_the_encoders_allow(size):
    joint, path = rig.Joint(out_bits=20), rig.Path(seconds=12.0)
    bound = cramer_rao.bounds(joint, path)
    estimator = DriveEstimator(rig.drive_settings(joint, warm_up_s=1.0), rig.model_of(joint))
    for block in rig.blocks(joint, *rig.linear(joint, path), size):
        rows = estimator.update(block)
    found = {row.name: row for row in rows}
    for name in ("stiffness", "damping"):
        assert bound[name] < found[name].sd < 1.25 * bound[name]
        assert abs(found[name].value - getattr(joint, name)) < 3.5 * found[name].sd


def test_a_prediction_that_leaves_too_much_for_long_gives_way_to_the_balance():
    known = AmplitudeState(Regressors(rig.model_of(JOINT)))
    known.point = Linearisation(1e5, 2e-4)
    rounds = Relinearisation(known, 1.0, LINEAR)
    rounds.count = LINEAR.predicts_from
    assert rounds.predicts
    for _ in range(round(DOUBTED_S / 0.1) - 5):
        assert not rounds.gives_up(0.9, 0.1)
    assert not rounds.gives_up(0.0, 0.1)
    told = [rounds.gives_up(0.9, 0.1) for _ in range(round(DOUBTED_S / 0.1) + 5)]
    assert sum(told) == 1 and not rounds.predicts
    rounds.start_over()
    rounds.count = LINEAR.predicts_from
    assert rounds.predicts
