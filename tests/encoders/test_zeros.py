"""Zeros of encoders that move without a flag: told, carried on, and nothing that was learned is lost."""

import math

import numpy as np
import pytest

from edge_daemon.condition.conditioner import Conditioner
from edge_daemon.condition.gathering import Gathering
from edge_daemon.records import Readings, Status
from edge_daemon.track.live import DriveEstimator
from tests.motion import simulated_joint as rig

ARC_MIN = math.pi / 10_800
PITCH = 2 * math.pi / 202
MOVED_S, END_S = 10.0, 15.0
MOTOR, OUT = "theta_in_rad", "theta_out_rad"
TRUE = {bits: rig.linear(rig.Joint(stiffness=k), rig.Path(seconds=END_S)) for bits, k in ((16, 2e4), (20, 1e5))}


def followed(bits, channel=OUT, by_rad=0.0, gap_s=0.0, within_s=0.0, extra_rad=None, both=False):
    """Estimator, its newest rows, everything that it said with when, and each stiffness after the shift, of a drive
    whose readings pass the conditioning; counts of `channel` move by `by_rad` and are missing for `gap_s` before, or
    those of `both`."""
    joint = rig.Joint(stiffness=2e4 if bits == 16 else 1e5, out_bits=bits)
    drive = rig.drive_settings(joint, warm_up_s=2.0)
    time_s = np.arange(len(TRUE[bits][0])) / rig.RATE_HZ
    shift = by_rad * np.clip((time_s - MOVED_S) / within_s, 0, 1) if within_s else by_rad * (time_s >= MOVED_S)
    angles = dict(zip((MOTOR, OUT), TRUE[bits], strict=True))
    if extra_rad is not None:
        angles[OUT] = angles[OUT] + extra_rad(time_s)
    sizes = {MOTOR: joint.in_bits, OUT: joint.out_bits}
    counts = {
        name: np.round((angle + 0.7 + shift * (name == channel)) / (2 * math.pi) * 2 ** sizes[name])
        for name, angle in angles.items()
    }
    lost = (time_s >= MOVED_S - gap_s) & (time_s < MOVED_S)
    conditioner, gathering = Conditioner(drive), Gathering()
    estimator, said, after, rows = DriveEstimator(drive, rig.model_of(joint)), [], [], {}
    for start in range(0, len(time_s), 100):
        piece = np.arange(start, start + 100)
        for name, signal in ((MOTOR, "in"), (OUT, "out")):
            kept = piece[~lost[piece]] if both or name == channel else piece
            conditioner.push(Readings("can", signal, time_s[kept], counts[name][kept]))
        for block in conditioner.blocks(time_s[piece[-1]]):
            for gathered in gathering.push(block):
                rows = {row.name: row for row in estimator.update(gathered)}
                said += [(gathered.end_s, text) for text in estimator.take_notices()]
                if gathered.end_s > MOVED_S:
                    after.append(rows["stiffness"])
    return estimator, rows, said, after, joint


CASES = [
    # bits, channel, by [rad], missing [s], what is said
    (20, MOTOR, 3.0, 0.0, "theta_in_rad (motor encoder) was reset: it counts from elsewhere by +3 rad"),
    (20, MOTOR, 3.7, 0.4, "theta_in_rad (motor encoder) was reset: it counts from elsewhere by +3.7 rad"),
    (
        16,
        MOTOR,
        4 * math.pi,
        0.4,
        "theta_in_rad (motor encoder) was reset: it counts from elsewhere by 2 whole turns (+12.6 rad)",
    ),
    (16, MOTOR, -0.6, 0.0, "theta_in_rad (motor encoder) was reset: it counts from elsewhere by -0.6 rad"),
    (20, OUT, 0.02, 0.0, "theta_out_rad (output encoder) was reset: it counts from elsewhere by +0.02 rad"),
    (16, OUT, -2.0, 0.4, "theta_out_rad (output encoder) was reset: it counts from elsewhere by -2 rad"),
    (16, OUT, 3 * ARC_MIN, 0.0, "theta_out_rad (output encoder): its zero slipped by +0.00087"),
    (20, MOTOR, 1e-3, 0.0, "theta_in_rad (motor encoder): its zero slipped by +0.00"),
    (20, OUT, PITCH, 0.0, "the gear has ratcheted by 1 tooth pitch,"),
]


@pytest.mark.parametrize(("bits", "channel", "by_rad", "gap_s", "what"), CASES)
def test_a_zero_that_moved_is_told_once_and_carried_on(bits, channel, by_rad, gap_s, what):
    estimator, rows, said, after, joint = followed(bits, channel, by_rad, gap_s)
    (time_s, text), *more = said
    assert text.startswith(what) and not more
    assert MOVED_S < time_s < MOVED_S + 3.0
    before_s = float(text.split(" s ago")[0].split()[-1])
    assert time_s - before_s == pytest.approx(MOVED_S - gap_s, abs=0.35)
    stiffness = rows["stiffness"]
    assert all(row.status is Status.VALID for row in after)
    assert all(abs(row.value - joint.stiffness) < 4 * row.sd for row in after)
    assert stiffness.sd < 0.01 * joint.stiffness
    assert abs(rows["damping"].value - joint.damping) < 4 * rows["damping"].sd
    assert rows["kinematic_error"].value == pytest.approx(joint.kinematic_pp, rel=0.2)
    assert rows["ratcheting_events"].value == (1 if "ratcheted" in what else 0)
    assert estimator.stiffness_changes[0] == 0


@pytest.mark.parametrize(
    ("channel", "by_rad", "what"),
    [
        (MOTOR, 3.7, "theta_in_rad (motor encoder) was reset: it counts from elsewhere by +3.7 rad"),
        (MOTOR, -2 * math.pi, "theta_in_rad (motor encoder) was reset: it counts from elsewhere by 1 whole turn"),
        (OUT, 0.3, "theta_out_rad (output encoder) was reset: it counts from elsewhere by +0.3 rad"),
    ],
)
def test_where_both_were_away_the_kinematic_error_tells_which_came_back_elsewhere(channel, by_rad, what):
    _, rows, said, after, joint = followed(16, channel, by_rad, gap_s=0.4, both=True)
    ((_, text),) = said
    assert text.startswith(what)
    assert rows["ratcheting_events"].value == 0 and rows["stiffness"].status is Status.VALID
    assert all(abs(row.value - joint.stiffness) < 4 * row.sd for row in after)


def test_a_coupling_that_slips_slowly_is_told_too():
    _, rows, said, after, joint = followed(20, OUT, 3 * ARC_MIN, within_s=0.2)
    ((_, text),) = said
    assert text.startswith("theta_out_rad (output encoder): its zero slipped by +0.00087")
    assert rows["stiffness"].status is Status.VALID
    assert all(abs(row.value - joint.stiffness) < 4 * row.sd for row in after if row.status is Status.VALID)


@pytest.mark.parametrize("bits", [16, 20])
def test_a_twist_that_comes_back_is_no_zero(bits):
    """A blow winds the gear up by several times what the motion does, for 50 ms; a level no higher than that stays."""

    def blow(time_s):
        return 2e-3 * np.exp(-(((time_s - MOVED_S) / 0.025) ** 2)) * np.sin(200 * time_s)

    estimator, rows, said, _, joint = followed(bits, extra_rad=blow)
    assert not said and estimator.zeros.shifts == 0
    assert abs(rows["stiffness"].value - joint.stiffness) < 4 * rows["stiffness"].sd


def test_a_carried_angle_is_carried_on_after_a_restart():
    estimator, _, _, _, joint = followed(20, MOTOR, 3.7)
    again = DriveEstimator(estimator.drive, estimator.model)
    assert again.restore(estimator.state())
    motor, out = (part[:8000] for part in TRUE[20])
    rows = {}
    for block in rig.blocks(joint, motor + 3.7, out, start_s=1100.0, size=300):
        rows = {row.name: row for row in again.update(block)}
        assert abs(rows["stiffness"].value - joint.stiffness) < 4 * rows["stiffness"].sd
    assert rows["kinematic_error"].value == pytest.approx(joint.kinematic_pp, rel=0.1)
    assert not again.take_notices()
