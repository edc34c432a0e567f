"""The motor angle out of synthesised sound: a motor whose angle is known, in noise whose density is known."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from edge_daemon.config.settings import ChannelSettings, Drive, Estimation, SoundAngle
from edge_daemon.records import Block, Burst, Status
from edge_daemon.sound.sound_angle import MotorFromSound
from edge_daemon.track.live import DriveEstimator
from tests.motion import simulated_joint as rig

RATE_HZ, SOUND_HZ, START_S = 1000.0, 25_600.0, 1000.0
ORDER = 8
LEVELS = {1: 0.3, 2: 0.2, 8: 1.0}
"""amplitude of each order of the motor's turn"""


def colour(frequency):
    """Density of the noise over its own at 800 Hz: flat above, rising below, as gears sound."""
    return 0.6 + 0.4 * (800.0 / np.maximum(frequency, 10.0))


def noise(size, density, rng):
    frequency = np.fft.rfftfreq(size, 1 / SOUND_HZ)
    lines = rng.normal(size=len(frequency)) + 1j * rng.normal(size=len(frequency))
    return np.fft.irfft(lines * np.sqrt(density * colour(frequency) * SOUND_HZ * size / 4), size)


def motor_and_output(joint, seconds, seed):
    """(n,) true angles at RATE_HZ: 955 rpm of the motor and a shaking around it, in steady state."""
    path = rig.Path(((5.3, 0.1), (9.1, 0.1), (13.7, 0.1)), (0.2, 0.1), seed, seconds)
    t = np.arange(round(seconds * rig.FINE_HZ)) / rig.FINE_HZ
    shaking = path.angle(t)
    turns = round(joint.ratio * seconds / (2 * math.pi)) * 2 * math.pi / joint.ratio / seconds
    referred = shaking + turns * t  # whole turns of the motor: the kinematic error is periodic
    drive = shaking + rig.kinematic(joint, joint.ratio * referred)
    w = 2 * math.pi * np.fft.rfftfreq(len(t), 1 / rig.FINE_HZ)
    spring = joint.stiffness + 1j * w * joint.damping
    theta_out = np.fft.irfft(np.fft.rfft(drive) * spring / (spring - joint.inertia * w**2), len(t)) + turns * t
    every = round(rig.FINE_HZ / RATE_HZ)
    return joint.ratio * referred[::every], theta_out[::every]


def sound_of(theta_in, density, rng):
    """The motor heard: its orders, and noise around them."""
    t = np.arange(len(theta_in)) / RATE_HZ
    fine = np.arange(round(len(theta_in) / RATE_HZ * SOUND_HZ)) / SOUND_HZ
    base = theta_in[0] + (theta_in[-1] - theta_in[0]) * fine / t[-1]
    angle = base + CubicSpline(t, theta_in - np.interp(t, [0.0, t[-1]], [theta_in[0], theta_in[-1]]))(fine)
    tones = sum(level * np.cos(order * angle + 0.7 * order) for order, level in LEVELS.items())
    return tones + noise(len(fine), density, rng)


def blocks(joint, theta_out):
    values = rig.quantised(theta_out, joint.out_bits)
    for i in range(len(values) // 100):
        part = values[i * 100 : (i + 1) * 100]
        flaws = {"theta_out_rad": np.zeros(100, dtype=np.uint8)}
        yield Block("joint", i, START_S + i * 0.1, RATE_HZ, {"theta_out_rad": part}, flaws)


def heard(motor, joint, theta_out, sound, burst=8192, every=8192):
    """Blocks as they become complete; bursts of `burst` samples out of each `every`."""
    starts = iter(range(0, len(sound), every))
    start = next(starts)
    for block in blocks(joint, theta_out):
        while start is not None and START_S + (start + burst) / SOUND_HZ <= block.end_s + 0.5:
            motor.hear(Burst("mic", "s", START_S + start / SOUND_HZ, SOUND_HZ, sound[start : start + burst]))
            start = next(starts, None)
        yield from motor.blocks((block,))


def listener(density, ratio=100.0, **more):
    settings = SoundAngle(order=ORDER, other_orders=(1, 2), **more)
    return MotorFromSound(settings, ratio, 50.0, lambda: lambda f: density * colour(f))


@pytest.mark.parametrize("density", [1e-8, 1e-5, 3e-4])
def test_the_angle_is_as_wrong_as_its_sd_says(density):
    """From a whisper of noise to a sample of 0.56 rad: error over the band of the balance against the stated sd."""
    joint = rig.Joint(stiffness=2e4, kinematic_pp=1e-12, out_bits=24)
    theta_in, theta_out = motor_and_output(joint, 20.0, 1)
    motor = listener(density)
    found = list(heard(motor, joint, theta_out, sound_of(theta_in, density, np.random.default_rng(2))))
    angle = np.concatenate([block.values["theta_in_rad"] for block in found])
    error = (angle - theta_in[: len(angle)])[4000:]
    assert np.isfinite(error).all() and motor.slips == 0
    band = np.fft.rfft(error - error.mean())[20 : 20 + int(40 * len(error) / RATE_HZ)]
    density_seen = float(np.mean(np.abs(band) ** 2)) / len(error)  # variance of a white sample
    exact = density / LEVELS[ORDER] ** 2 * RATE_HZ / ORDER**2 * float(np.mean(colour(np.linspace(77, 177, 50))))
    assert motor.sd_rad == pytest.approx(math.sqrt(exact), rel=0.15)
    own = 2e-5  # of the interpolation between samples of the output encoder
    assert math.sqrt(density_seen) == pytest.approx(math.hypot(motor.sd_rad, own), rel=0.15)


def test_a_line_that_drowns_is_not_heard_and_cycles_are_counted():
    joint = rig.Joint(stiffness=2e4, kinematic_pp=1e-12)
    theta_in, theta_out = motor_and_output(joint, 12.0, 3)
    loud = listener(1.0)
    found = list(heard(loud, joint, theta_out, sound_of(theta_in, 1.0, np.random.default_rng(4))))
    assert all(np.isnan(block.values["theta_in_rad"]).all() for block in found)
    assert loud.estimates()[0].status is Status.INVALID
    # the reference runs 0.05 % fast, as with a wrong ratio: eight orders of 100 rad/s lose 0.064 cycles a second
    wrong = listener(1e-6, ratio=100.05)
    list(heard(wrong, joint, theta_out, sound_of(theta_in, 1e-6, np.random.default_rng(5))))
    lost = 8 * 0.05 * (theta_out[-1] - theta_out[2500]) / (2 * math.pi)
    assert abs(wrong.slips - lost) <= 1
    assert wrong.estimates()[1].value == wrong.slips


def test_below_the_lowest_frequency_and_between_bursts_nothing_is_said():
    joint = rig.Joint(stiffness=2e4, kinematic_pp=1e-12)
    theta_in, theta_out = motor_and_output(joint, 12.0, 6)
    sound = sound_of(theta_in, 1e-7, np.random.default_rng(7))
    parts = list(heard(listener(1e-7), joint, theta_out, sound, burst=8192, every=25_600))
    known = np.isfinite(np.concatenate([block.values["theta_in_rad"] for block in parts]))
    assert 0.25 < known[8000:11000].mean() < 0.33  # 0.32 s of each second
    slow = listener(1e-7, lowest_hz=140.0)  # the line is at 127 Hz
    assert all(block.flaws["theta_in_rad"].all() for block in heard(slow, joint, theta_out, sound))


def stiffness_by_ear(density, seed, seconds=40.0):
    joint = rig.Joint(stiffness=2e4, inertia=0.3, damping=15.0, kinematic_pp=1e-4, out_bits=24)
    theta_in, theta_out = motor_and_output(joint, seconds, seed)
    motor = listener(density)
    drive = Drive(
        name="joint",
        modbus_device_id=1,
        model="m",
        channels=(ChannelSettings(channel="theta_out_rad", source="c", signal="o", counts_per_turn=2**24),),
        estimation=Estimation(warm_up_s=5.0, cutoff_hz=50.0, stiffness_drift_per_h=1e-6),
    )
    estimator = DriveEstimator(drive, rig.model_of(joint))
    rows = ()
    for block in heard(motor, joint, theta_out, sound_of(theta_in, density, np.random.default_rng(seed))):
        estimator.heard_motor(motor.sd_rad)
        rows = estimator.update(block)
    return next(row for row in rows if row.name == "stiffness")


@pytest.mark.slow
def test_stiffness_by_ear_where_the_line_is_loud_and_no_answer_where_it_is_not():
    found = [stiffness_by_ear(3e-7, seed) for seed in (1, 2)]
    for row in found:
        assert row.status is Status.VALID and row.sd < 0.03 * 2e4
        assert abs(row.value - 2e4) < 4 * row.sd
    drowned = stiffness_by_ear(1e-3, 1)
    assert drowned.status is not Status.VALID
