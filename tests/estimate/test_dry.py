"""The predicted twist of a dry gear against a joint integrated by other means, its derivatives against differences."""

from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.estimate.dry import DryTwist, Gear
from edge_daemon.estimate.kinematics import filters
from edge_daemon.estimate.streaming import Frame, MotionStream
from tests.estimate import simulated_joint as rig

JOINT = rig.Joint(coulomb=0.5, in_bits=40, out_bits=40)
PATH = rig.Path(seconds=3.0)
ENCODER_RAD = 2 * np.pi / 2**24 / np.sqrt(12)


def gear_of(joint):
    """The joint's own numbers; `rig.blocks` shifts the motor angle by 0.7 and the output by -0.3."""
    course = [(2, 0.3, 1.0), (1, 1.0, 0.3), (4, -0.5, 0.2)]
    x = np.linspace(0, 2 * np.pi, 2001)
    size = joint.kinematic_pp / np.ptp(sum(a * np.sin(m * x + p) for m, p, a in course))
    error = {m: size * a * np.exp(1j * (p - 0.7 * m)) for m, p, a in course}
    sine_cosine = [part for m in (1, 2, 4) for part in (error[m].real, error[m].imag)]
    return Gear(
        joint.inertia, joint.stiffness, joint.damping, joint.coulomb, joint.reversal, np.array(sine_cosine), 0.0
    )


def predicted(angles, gear, joint=JOINT):
    """Predictions of the second half, end to end, by field."""
    stream = MotionStream(Frame(joint.ratio, joint.inertia, False, arguments=True), filters(rig.RATE_HZ, 100.0))
    dry, found = DryTwist(joint.ratio), []
    for block in rig.blocks(joint, *angles):
        stretch = stream.push(block)
        if stretch is not None and stretch.arguments is not None:
            found.append(dry.predict(stretch.arguments, gear))
    kept = [row for row in found if row is not None and row.settled]
    return {name: np.concatenate([getattr(row, name) for row in kept]) for name in type(kept[0]).__slots__[:-1]}


@pytest.fixture(scope="module")
def angles():
    return rig.stepped(JOINT, PATH)


def test_prediction_is_the_simulated_twist(angles):
    rows = predicted(angles, gear_of(JOINT))
    off = rows["seen_rad"] - rows["twist_rad"]
    assert len(off) > 2500
    assert np.std(off) < 0.15 * ENCODER_RAD
    assert np.std(rows["seen_rad"]) > 500 * np.std(off)


@pytest.mark.parametrize(
    ("field", "name", "step"),
    [("by_stiffness", "stiffness", 1e3), ("by_damping", "damping", 2.0), ("by_friction", "friction", 0.02)],
)
def test_derivatives_are_those_of_the_prediction(angles, field, name, step):
    gear = gear_of(JOINT)
    up, down = (predicted(angles, replace(gear, **{name: getattr(gear, name) + sign * step})) for sign in (1, -1))
    slope = (up["twist_rad"] - down["twist_rad"]) / (2 * step)
    stated = predicted(angles, gear)[field]
    assert np.std(stated - slope) < 0.1 * np.std(slope)


def test_derivative_to_the_kinematic_error_too(angles):
    gear = gear_of(JOINT)
    for i in (0, 3, 5):
        shift = np.zeros(6)
        shift[i] = 1e-6
        up, down = (predicted(angles, replace(gear, error_rad=gear.error_rad + sign * shift)) for sign in (1, -1))
        slope = (up["twist_rad"] - down["twist_rad"]) / 2e-6
        assert np.std(predicted(angles, gear)["by_error"][:, i] - slope) < 0.1 * np.std(slope)
