"""The predicted twist of a gear with friction against a joint integrated by other means, its derivatives too."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.motion.excitation import SensorNoise
from edge_daemon.motion.kinematics import filters
from edge_daemon.motion.law_simulation import LawGear, LawSimulation
from edge_daemon.motion.motor_angle import MotorAngle
from edge_daemon.motion.regressors import EncoderNoise, Linearisation, Regressors
from edge_daemon.motion.streaming import MOTOR, MotionFrame, MotionStream
from edge_daemon.track.law_prediction import LIGHTEST, LawPrediction, LawsBehind, laws_of
from edge_daemon.track.live import DriveEstimator
from edge_daemon.track.recursive import AmplitudeFilter
from edge_daemon.track.relinearisation import HELD, MOST_AGAIN, SIMULATED, Relinearisation
from edge_daemon.track.state import AmplitudeState
from tests.motion import simulated_joint as rig

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import compiled_joint

JOINT = rig.Joint(coulomb=0.5, in_bits=40, out_bits=40)
PATH = rig.Path(seconds=3.0)
NOISE_RAD2 = (2 * np.pi / 2**40) ** 2 / 12
ENCODER_RAD = 2 * np.pi / 2**24 / np.sqrt(12)


def gear_of(joint):
    """The joint's own numbers; `rig.blocks` shifts the motor angle by 0.7 and the output by -0.3."""
    course = [(2, 0.3, 1.0), (1, 1.0, 0.3), (4, -0.5, 0.2)]
    x = np.linspace(0, 2 * np.pi, 2001)
    size = joint.kinematic_pp / np.ptp(sum(a * np.sin(m * x + p) for m, p, a in course))
    error = {m: size * a * np.exp(1j * (p - 0.7 * m)) for m, p, a in course}
    sine_cosine = [part for m in (1, 2, 4) for part in (error[m].real, error[m].imag)]
    return LawGear(joint.inertia, joint.stiffness, joint.damping, *coulomb(joint), np.array(sine_cosine), 0.0)


def coulomb(joint):
    """The law of the joint's friction, and what its level changes."""
    regressors = Regressors(rig.model_of(joint, *NAMES))
    regressors.reshape("coulomb_friction", "smoothing", joint.reversal)
    value = np.zeros(len(regressors.keys))
    value[2] = joint.coulomb
    return laws_of(value, regressors)


def predicted(angles, gear, joint=JOINT):
    """Predictions of the second half, end to end, by field."""
    fir = filters(rig.RATE_HZ, 100.0)
    stream, motor = MotionStream(MotionFrame(joint.ratio, joint.inertia, False), fir), MotorAngle(fir)
    dry, found = LawSimulation(joint.ratio), []
    for block in rig.blocks(joint, *angles):
        stretch = stream.push(block)
        samples = motor.follow(stretch.unfiltered, NOISE_RAD2) if stretch is not None else None
        if samples is not None:
            found.append(dry.predict(samples[:, :4], rig.RATE_HZ, gear))
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
    ("field", "place", "name", "step"),
    [
        ("by_spring", 0, "stiffness", 1e3),
        ("by_spring", 1, "damping", 2.0),
        ("by_laws", 0, "coulomb", 0.02),
    ],
)
def test_derivatives_are_those_of_the_prediction(angles, field, place, name, step):
    sides = (replace(JOINT, **{name: getattr(JOINT, name) + sign * step}) for sign in (1, -1))
    up, down = (predicted(angles, gear_of(joint)) for joint in sides)
    slope = (up["twist_rad"] - down["twist_rad"]) / (2 * step)
    stated = predicted(angles, gear_of(JOINT))[field][:, place]
    assert np.std(stated - slope) < 0.01 * np.std(slope)


def test_derivative_to_the_kinematic_error_too(angles):
    gear = gear_of(JOINT)
    for i in (0, 3, 5):
        shift = np.zeros(6)
        shift[i] = 1e-6
        up, down = (predicted(angles, replace(gear, error_rad=gear.error_rad + sign * shift)) for sign in (1, -1))
        slope = (up["twist_rad"] - down["twist_rad"]) / 2e-6
        assert np.std(predicted(angles, gear)["by_error"][:, i] - slope) < 0.01 * np.std(slope)


NAMES = ("linear_stiffness", "viscous_damping", "coulomb_friction")


def test_rows_around_a_damping_that_cannot_be_simulated_are_still_those_of_the_gear():
    """Around -5 N m s/rad; the gear has little more than the least that is simulated."""
    joint = replace(JOINT, damping=1.1 * 2 * LIGHTEST * np.sqrt(JOINT.stiffness * JOINT.inertia))
    regressors, fir = Regressors(rig.model_of(joint, *NAMES)), filters(rig.RATE_HZ, 100.0)
    gear = gear_of(joint)
    point = Linearisation(joint.stiffness, 0.0, gear.error_rad)
    prediction, value = LawPrediction(regressors, fir), np.zeros(len(regressors.keys))
    value[:3], value[regressors.kinematic] = (joint.stiffness, -5.0, joint.coulomb), joint.stiffness * gear.error_rad
    stream = MotionStream(MotionFrame(joint.ratio, joint.inertia, False, arguments=True), fir)
    noise, rows = SensorNoise(regressors, fir, EncoderNoise(NOISE_RAD2**0.5, NOISE_RAD2**0.5), False), []
    for block in rig.blocks(joint, *compiled_joint.stepped(joint, rig.Path(seconds=5.0))):
        stretch = stream.push(block)
        if stretch is not None:
            rows.append(prediction.equation(stretch, value, point, noise))
    columns, torque = (np.concatenate([getattr(row, name) for row in rows]) for name in ("columns", "torque"))
    found = np.linalg.lstsq(columns / (scale := np.linalg.norm(columns, axis=0)), torque, rcond=None)[0] / scale
    assert found[:3] == pytest.approx([joint.stiffness, joint.damping, joint.coulomb], rel=0.05)


def known_as(damping):
    """A gear of this damping, each amplitude sure to a thousandth."""
    known = AmplitudeState(Regressors(rig.model_of(JOINT, *NAMES)))
    value = np.zeros(len(known.regressors.keys))
    value[:3] = JOINT.stiffness, damping, JOINT.coulomb
    known.filter = AmplitudeFilter(value, 1e-3 * np.abs(value) + 1e-6, np.zeros(len(value)))
    known.wider, known.point = np.ones(len(value)), Linearisation(JOINT.stiffness)
    return known


@pytest.mark.parametrize(("found", "far"), [(8.0, False), (16.0, True)])
def test_what_was_predicted_around_another_gear_is_learned_anew(found, far):
    known = known_as(7.0)
    rounds, at_s = Relinearisation(known, 1.0, SIMULATED), SIMULATED.rounds[-1]
    rounds.count = len(SIMULATED.rounds) - 1
    assert rounds.move(at_s) and rounds.predicts
    for again in range(MOST_AGAIN + 1):
        known.filter = known_as(found * 2.0**again).filter
        assert not rounds.move(at_s + 0.9 * HELD), "it waits until what was found is worth something"
        at_s += 1.01 * HELD
        assert rounds.move(at_s) is (far and again < MOST_AGAIN)
        assert rounds.count == len(SIMULATED.rounds)
        if not far:
            return


def test_damping_is_honest_seconds_after_the_start():
    """The balance of torques cannot tell damping from friction: it hands a prediction anything from -30 to 200."""
    joint = rig.Joint(coulomb=0.5, out_bits=20)
    scores = []
    for seed in (3, 6, 15):
        angles = compiled_joint.stepped(joint, rig.Path(seed=seed, seconds=5.0))
        estimator = DriveEstimator(rig.drive_settings(joint, warm_up_s=1.0), rig.model_of(joint, *NAMES))
        for block in rig.blocks(joint, *angles):
            rows = estimator.update(block)
        row = next(row for row in rows if row.name == "damping")
        scores.append((row.value - joint.damping) / row.sd)
        assert row.sd < 0.2 * joint.damping
    assert np.abs(scores).max() < 3.5


def followed(angle, bits=17):
    """Angle, rate and acceleration of a motor angle (n,) read at `bits`, and which samples they are."""
    motor, found = MotorAngle(filters(rig.RATE_HZ, 100.0)), []
    read = rig.quantised(angle, bits)
    for i in range(0, len(read), 100):
        unfiltered = np.zeros((MOTOR + 1, 100))
        unfiltered[MOTOR] = read[i : i + 100]
        rows = motor.follow(unfiltered, (2 * np.pi / 2**bits) ** 2 / 12)
        found += [] if rows is None else [rows]
    rows = np.concatenate(found)
    return motor.is_rough, rows, slice(motor.delay, motor.delay + len(rows))


def test_a_smooth_motor_is_smoothed_and_one_that_shakes_above_the_band_is_not():
    t = np.arange(4000) / rig.RATE_HZ
    step, w, shake = 2 * np.pi / 2**17, 2 * np.pi * 3.3, 2 * np.pi * 151.0
    calm, shaken = 40 * np.sin(w * t), 40 * np.sin(w * t) + 20 * step * np.sin(shake * t)
    rough, rows, at = followed(calm)
    assert not rough
    assert np.std(rows[:, 0] - calm[at]) < 0.5 * step / np.sqrt(12)
    assert np.std(rows[:, 2] + w**2 * calm[at]) < step * 1e5
    rough, rows, at = followed(shaken)
    settled = slice(2000, None)
    assert rough
    assert np.std((rows[:, 0] - shaken[at])[settled]) < step
    assert np.std(rows[settled, 2]) > 0.9 * 20 * step * shake**2 / np.sqrt(2)


@pytest.mark.parametrize(("share", "calm"), [(0.0, True), (0.15, False)])
def test_a_motor_that_shakes_by_less_than_its_noise_is_not_calm(share, calm):
    """`share`: of the variance of the rounding, of a shake between the filters."""
    t, step = np.arange(20_000) / rig.RATE_HZ, 2 * np.pi / 2**17
    shake = step / np.sqrt(12) * np.sqrt(2 * share) * np.sin(2 * np.pi * 151.0 * t)
    motor = MotorAngle(filters(rig.RATE_HZ, 100.0))
    read, rows = rig.quantised(40 * np.sin(2 * np.pi * 3.3 * t) + shake, 17), []
    for i in range(0, len(read), 100):
        unfiltered = np.zeros((MOTOR + 1, 100))
        unfiltered[MOTOR] = read[i : i + 100]
        rows.append(motor.follow(unfiltered, step**2 / 12))
        assert not (motor.is_calm and i < 1500), "a second says nothing of it"
    assert motor.is_calm is calm and not motor.is_rough
    taken = np.concatenate([row[:, 4] for row in rows[-100:]])
    if calm:
        assert np.std(taken) == pytest.approx(step / np.sqrt(12) * np.sqrt(0.8), rel=0.05), "all above a fifth of it"


def test_friction_behind_the_filter_belongs_to_the_stretch_it_is_given_with():
    fir, rng = filters(rig.RATE_HZ, 100.0), np.random.default_rng(2)
    stream = MotionStream(MotionFrame(100.0, 0.05, False, arguments=True), fir)
    late, lag, friction = 62, MotorAngle(fir).lag, np.cumsum(rng.normal(size=2000))
    behind, told = LawsBehind(late - lag), []
    angle = np.sin(np.arange(2000) / 200.0)
    for i, block in enumerate(rig.blocks(JOINT, 100 * angle, angle)):
        stretch = stream.push(block)
        if stretch is None:
            continue
        start = (i + 1) * 100 - late
        row = behind.follow(stretch, friction[start - 100 : start])
        told += [] if row is None else [row]
    assert [stretch.fresh for stretch, _ in told] == [True] + [False] * (len(told) - 1) and len(told) > 12
    smooth = np.convolve(friction, fir.value, "same")
    for stretch, known in told:
        at = np.round((stretch.motion.time_s - 1000.0) * rig.RATE_HZ).astype(int)
        assert known == pytest.approx(smooth[at], abs=1e-9)
