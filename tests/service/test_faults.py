"""Faults of the readings on the demonstration's drive: told in time, nothing wrong valid, nothing learned lost."""

from __future__ import annotations

import pytest

from edge_daemon.records import NE107, Status
from edge_daemon.rig.live import DEMO_JOINT
from tests.service import faults

FROM_S, UNTIL_S, END_S = 40.0, 46.0, 51.0
TOLD_S = 3.0
WRONG_SD = 5.0
TRUTH = {
    "stiffness": DEMO_JOINT.stiffness_Nm_per_rad,
    "ratio": DEMO_JOINT.ratio,
}
GROSS = [
    ("skewed_out", 3e-4),
    ("skewed_in", 5e-5),
    ("skewed_in", 3e-3),
    ("scaled_in", 0.01),
    ("flipped_out", 0.0),
    ("exchanged", 0.0),
    ("stuck_bit_in", 10.0),
]


def wrong(told: faults.Told) -> list[str]:
    """Estimates that are called valid and contradict the truth."""
    rows = ((name, told.estimates[name], truth) for name, truth in TRUTH.items() if told.valid(name))
    return [name for name, row, truth in rows if abs(row.value - truth) > WRONG_SD * row.sd]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "size"), GROSS)
def test_wrong_readings_are_told_and_teach_nothing(name, size, tmp_path):
    """A shift of one encoder's latch by 0.3 ms was called a stiffness of 2 710 +- 340 and a gear worn out."""
    played = faults.spoiled(faults.healthy(END_S), name, size, FROM_S, UNTIL_S)
    rows = list(faults.told(faults.pipeline_in(tmp_path), played))
    before = next(row for row in reversed(rows) if row.time_s < FROM_S - 0.5)
    assert before.state is NE107.OK and before.valid("stiffness")
    spoiled = [row for row in rows if FROM_S + TOLD_S < row.time_s < UNTIL_S]
    for row in spoiled:
        assert row.state >= NE107.FUNCTION_CHECK
        assert all(channel in " ".join(row.reasons) for channel in faults.FAULTS[name].channels), row.reasons
        assert not row.valid("stiffness")
    assert not [fault for row in rows if row.time_s > FROM_S for fault in wrong(row)]
    last = rows[-1]
    assert last.state is NE107.OK, last.reasons
    then, now = before.estimates["stiffness"], last.estimates["stiffness"]
    assert now.status is Status.VALID
    assert abs(now.value - then.value) < then.sd
    assert last.estimates["model_nrmse"].value < 2 * before.estimates["model_nrmse"].value


@pytest.mark.slow
@pytest.mark.parametrize("loss", [0.1, 0.3])
def test_a_worn_gear_is_no_fault_of_its_readings(loss, tmp_path):
    played = faults.worn(46.0, FROM_S, loss)
    rows = list(faults.told(faults.pipeline_in(tmp_path), played))
    assert all(row.state is NE107.OK for row in rows), rows[-1].reasons
    found = [event for row in rows for event in row.events if "suddenly lower" in event.message]
    assert found and found[0].time_s - faults.START_S < FROM_S + 2.5
    stiffness = rows[-1].estimates["stiffness"]
    assert abs(stiffness.value / ((1 - loss) * TRUTH["stiffness"]) - 1) < 0.05


@pytest.mark.slow
def test_a_backlash_that_opens_is_no_fault_of_its_readings(tmp_path):
    played = faults.loose(44.0, FROM_S, 1e-4)
    rows = list(faults.told(faults.pipeline_in(tmp_path), played))
    assert not [row for row in rows if any("readings contradict" in reason for reason in row.reasons)]
