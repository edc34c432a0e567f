"""Ratio and skew against motions computed here, without the product's filters or regressions."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.encoders.ratio import COLUMNS, LEVEL, SLOPE, RatioEstimator, Slope
from edge_daemon.motion.kinematics import filters
from edge_daemon.motion.streaming import MotionFrame, MotionStream
from edge_daemon.records import Flaw, Status
from edge_daemon.track.live import DriveEstimator
from tests.motion import simulated_joint as rig

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import compiled_joint

TONES = ((5.37, 0.4), (9.13, 0.4), (13.77, 0.4), (19.33, 0.4))
SWEEP = (0.23, 1.2)
"""comes back after 30 s only, as its rounding errors do"""


def estimated(joint, angles, nominal=None, marks=()):
    """The estimator after a recording; `marks`: (block, channel) of counter resets."""
    fir = filters(rig.RATE_HZ, 100.0)
    nominal = nominal or joint.ratio
    stream = MotionStream(MotionFrame(nominal, joint.inertia, False), fir)
    ratio = RatioEstimator(nominal, fir)
    for block in rig.blocks(joint, *angles):
        for at, channel in marks:
            if block.sequence == at:
                block.flaws[channel][0] = Flaw.RESET
        ratio.update(block, stream.push(block))
    return ratio


def rows_of(ratio):
    return {row.name: row for row in ratio.estimates()}


def test_sd_is_that_of_encoder_steps_over_all_travel_and_covers():
    joint = rig.Joint(out_bits=20, kinematic_pp=1e-9)  # nobody tells the rate of the kinematic error here
    path = rig.Path(TONES, SWEEP, 3, 12.0)
    theta_in, theta_out = rig.linear(joint, path)
    rng = np.random.default_rng(11)
    scores, sd = [], 0.0
    for _ in range(25):
        zeros = rng.uniform(0, 1, 2)
        row = rows_of(estimated(joint, (theta_in + zeros[0], theta_out + zeros[1])))["ratio"]
        scores.append((row.value - joint.ratio) / row.sd)
        sd = row.sd
    steps = (2 * math.pi / 2**17 / 100, 2 * math.pi / 2**20)
    travel = theta_out - theta_out.mean()
    least = 100 * math.hypot(*steps) / math.sqrt(12) / math.sqrt(travel @ travel)
    # that bound is a straight line's: ten more unknowns cost something, and rounding errors are not quite white
    assert 0.9 * least < sd < 1.5 * least
    assert abs(np.mean(scores)) < 0.2 + 2 / math.sqrt(25)
    assert 0.65 < np.std(scores) < 1.4


def test_a_wrong_nominal_ratio_is_found_and_said():
    joint = rig.Joint(ratio=101.0)
    row = rows_of(estimated(joint, rig.linear(joint, rig.Path(TONES, SWEEP, 1, 12.0)), nominal=100.0))["ratio"]
    assert row.status is Status.VALID
    assert row.value == pytest.approx(101.0, abs=2e-3)


def test_a_lost_zero_starts_a_new_level_and_keeps_the_slope():
    joint = rig.Joint(out_bits=20, kinematic_pp=1e-9)
    theta_in, theta_out = rig.linear(joint, rig.Path(TONES, SWEEP, 2, 20.0))
    half = len(theta_out) // 2
    whole = rows_of(estimated(joint, (theta_in, theta_out)))["ratio"]
    lost = theta_out.copy()
    lost[half:] -= 0.5
    ratio = estimated(joint, (theta_in, lost), marks=((half // 100, "theta_out_rad"),))
    row = rows_of(ratio)["ratio"]
    assert row.sd < 1.5 * whole.sd
    assert abs(row.value - 100.0) < 4 * row.sd
    only_half = rows_of(estimated(joint, (theta_in[half:], theta_out[half:])))["ratio"]
    assert row.sd < 0.9 * only_half.sd


def test_an_unmarked_jump_does_not_move_the_slope():
    joint = rig.Joint(out_bits=20, kinematic_pp=1e-9)
    theta_in, theta_out = rig.linear(joint, rig.Path(TONES, SWEEP, 2, 20.0))
    jumped = theta_out + np.where(np.arange(len(theta_out)) > 10_000, 2 * math.pi / 202, 0.0)
    ratio = estimated(joint, (theta_in, jumped))
    row = rows_of(ratio)["ratio"]
    assert abs(row.value - 100.0) < 4 * row.sd < 1e-4


@pytest.mark.parametrize("late_s", [0.0, 2e-4, -1e-3])
def test_skew_is_how_much_later_the_output_encoder_is_sampled(late_s):
    joint = rig.Joint(out_bits=20, kinematic_pp=1e-9)
    path = rig.Path(TONES, SWEEP, 4, 12.0)
    theta_in, theta_out = rig.linear(joint, path)
    spectrum = np.fft.rfft(theta_out)
    turn = np.exp(2j * math.pi * np.fft.rfftfreq(len(theta_out), 1 / rig.RATE_HZ) * late_s)
    late = np.fft.irfft(spectrum * turn, len(theta_out))
    row = rows_of(estimated(joint, (theta_in, late)))["encoder_skew"]
    assert row.status is Status.VALID
    assert abs(row.value - late_s) < 4 * row.sd + 0.02 * abs(late_s)


def test_standstill_says_nothing():
    joint = rig.Joint()
    still = np.zeros(3000)
    rows = rows_of(estimated(joint, (still, still)))
    assert math.isnan(rows["ratio"].value) and rows["ratio"].status is Status.WARMING_UP


def test_state_is_taken_back_and_rubbish_is_not():
    joint = rig.Joint(out_bits=20)
    ratio = estimated(joint, rig.linear(joint, rig.Path(TONES, SWEEP, 5, 8.0)))
    state = ratio.dump()
    again = RatioEstimator(100.0, filters(rig.RATE_HZ, 100.0))
    again.load(state)
    assert again.slope.dump()["samples"] == ratio.slope.dump()["samples"]
    state["slope"]["samples"] = math.nan
    with pytest.raises(ValueError, match="finite"):
        again.load(state)


def test_a_missing_friction_is_in_the_doubt_of_ratio_and_skew() -> None:
    joint = rig.Joint(out_bits=24, coulomb=0.5)
    theta_in, theta_out = rig.stepped(joint, rig.Path(seconds=30.0))
    estimator = DriveEstimator(rig.drive_settings(joint), rig.model_of(joint))
    for block in rig.blocks(joint, theta_in, theta_out):
        rows = {row.name: row for row in estimator.update(block)}
    assert abs(rows["encoder_skew"].value) < 2 * rows["encoder_skew"].sd
    assert abs(rows["ratio"].value - joint.ratio) < 2 * rows["ratio"].sd


def test_residuals_that_are_independent_scatter_as_such_from_the_first_second() -> None:
    """What is not yet known of the unknowns is in the residuals too: a scatter of one, however early."""
    rng, shares = np.random.default_rng(5), []
    for _ in range(60):
        slope, truth = Slope(), 1e-3 * rng.normal(size=COLUMNS)
        for _ in range(50):
            columns = rng.normal(size=(20, COLUMNS))
            columns[:, LEVEL] = 1.0
            twist = columns @ truth + 1e-6 * rng.normal(size=20)
            slope.take(np.column_stack((columns, twist)), 0.1)
            if slope.due:
                slope.wander(200.0)
                slope.solve(1.0, math.nan)
        shares.append(slope.scatter)
    assert np.mean(shares, axis=0) == pytest.approx([1.0, 1.0], abs=0.25), "three sd of the mean of 240 groups"


def test_the_ratio_of_a_dry_gear_is_as_sure_as_its_travel_allows() -> None:
    joint = rig.Joint(out_bits=24, coulomb=0.5)
    names = ("linear_stiffness", "viscous_damping", "coulomb_friction")
    theta_in, theta_out = compiled_joint.stepped(joint, rig.Path(TONES, SWEEP, 12, 12.0))
    estimator = DriveEstimator(rig.drive_settings(joint, warm_up_s=1.0), rig.model_of(joint, *names))
    for block in rig.blocks(joint, theta_in, theta_out):
        rows = {row.name: row for row in estimator.update(block)}
    steps, travel = (2 * math.pi / 2**17 / 100, 2 * math.pi / 2**24), theta_out - theta_out.mean()
    least = 100 * math.hypot(*steps) / math.sqrt(12) / math.sqrt(travel @ travel)
    assert least < rows["ratio"].sd < 2 * least
    assert abs(rows["ratio"].value - joint.ratio) < 3.5 * rows["ratio"].sd


def test_loads_of_unknown_size_are_found_beside_the_slope_or_leave_it_in_doubt() -> None:
    """A weight's sine over a short travel is nearly a line: what it may hide of the slope is in the slope's sd."""
    rng, off, sds = np.random.default_rng(6), [], {0.3: [], 3.0: []}
    for travel_rad in 30 * [*sds]:
        slope, truth = Slope(2), np.append(1e-3 * rng.normal(size=COLUMNS), 2e-4 * rng.normal(size=2))
        for _ in range(50):
            columns = rng.normal(size=(20, COLUMNS + 2))
            columns[:, LEVEL] = 1.0
            out = columns[:, SLOPE] = travel_rad * rng.uniform(-1.0, 1.0, size=20)
            columns[:, COLUMNS:] = np.column_stack((np.sin(out), np.cos(out)))
            twist = columns @ truth + 1e-6 * rng.normal(size=20)
            slope.take(np.column_stack((columns, twist)), 0.1)
            if slope.due:
                slope.wander(200.0)
                slope.solve(1.0, math.nan)
        value, sd = slope.known(SLOPE)
        off.append((value - truth[SLOPE]) / sd)
        sds[travel_rad].append(sd)
    assert np.std(off) == pytest.approx(1.0, abs=0.25), "two and a half sd of the sd of 60 numbers"
    assert np.median(sds[0.3]) > 100 * np.median(sds[3.0])
