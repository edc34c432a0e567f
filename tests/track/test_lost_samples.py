"""Samples that are lost teach nothing, and nothing stays behind once they come again."""

import sys
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.records import Block, Flaw, Status
from edge_daemon.track.live import DriveEstimator
from tests.motion import simulated_joint as rig

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import compiled_joint

BEGIN_S, END_S, UNTIL_S = 12.0, 20.0, 27.0
BLOCK = 300
"""Samples, as the daemon makes them: longer than the motor filter, which then looks at bridges alone."""
AGAIN_S = 3.0
"""A filter of two blocks and the settling of a prediction have passed by then."""


def thinned(block, channel, share, rng):
    """The block without this share of a channel's samples."""
    values, flaws, lost = dict(block.values), dict(block.flaws), rng.random(block.size) < share
    values[channel] = np.where(lost, np.nan, values[channel])
    flaws[channel] = np.where(lost, np.uint8(Flaw.MISSING), flaws[channel])
    return Block(block.drive, block.sequence, block.start_s, block.rate_hz, values, flaws)


@pytest.mark.parametrize("channel", ["theta_in_rad", "theta_out_rad"])
@pytest.mark.parametrize("friction_Nm", [0.0, 0.5])
def test_what_lost_samples_were_bridged_with_is_no_motion(friction_Nm, channel):
    """The kinks of the bridges were taken for a motor that shakes: its angle was smoothed no more for minutes, a model
    error of 4.5 thousandths became 6, and damping 12.6 +- 4 of 12 +- 0.1."""
    joint, rng = rig.Joint(coulomb=friction_Nm), np.random.default_rng(4)
    names = ("linear_stiffness", "viscous_damping", *(("coulomb_friction",) if friction_Nm else ()))
    estimator = DriveEstimator(rig.drive_settings(joint, warm_up_s=2.0), rig.model_of(joint, *names))
    simulate = compiled_joint.stepped if friction_Nm else rig.linear
    course = []
    for block in rig.blocks(joint, *simulate(joint, rig.Path(seconds=UNTIL_S)), size=BLOCK):
        now_s = block.end_s - 1000.0
        if BEGIN_S < now_s < END_S:
            block = thinned(block, channel, 0.3, rng)
        course.append((now_s, {row.name: row for row in estimator.update(block)}))
    truth = {"stiffness": joint.stiffness, "damping": joint.damping}
    for now_s, rows in course:
        usable = [name for name in truth if rows[name].status is Status.VALID and now_s > BEGIN_S]
        assert all(abs(rows[name].value - truth[name]) < 4 * rows[name].sd for name in usable), now_s
    before = next(rows for now_s, rows in course if now_s > BEGIN_S - 0.5)
    for rows in (rows for now_s, rows in course if now_s > END_S + AGAIN_S):
        assert rows["damping"].status is Status.VALID
        assert rows["damping"].sd < 1.5 * before["damping"].sd
        assert rows["model_nrmse"].value < 1.2 * before["model_nrmse"].value
