"""A log made without a clock, read back by python-can."""

from __future__ import annotations

from pathlib import Path

import can
import cantools
import pytest

from edge_daemon.rig.can_face import DBC_FILE
from edge_daemon.rig.can_log import write_log
from edge_daemon.rig.live import live_drive

START_S = 1_700_000_000.0


@pytest.mark.parametrize("suffix", ["log", "asc", "blf"])
def test_the_log_holds_every_sample_of_every_drive_in_order_of_arrival(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"drives.{suffix}"
    count = write_log(file, {1: live_drive(1), 2: live_drive(2)}, 1.0, START_S, 0)
    with can.LogReader(str(file)) as reader:
        messages = [message for message in reader if not message.is_error_frame]
    assert len(messages) == count == 2 * (2 * 1000 + 100)
    stamps = [message.timestamp for message in messages]
    assert stamps == sorted(stamps)
    database = cantools.database.load_file(DBC_FILE)
    reference = live_drive(2).advance(1.0)
    outer = [database.decode_message(m.arbitration_id, m.data) for m in messages if m.arbitration_id == 0x282]
    assert sorted(row["Latch"] for row in outer) == [1000 * (i + 1) for i in range(1000)]  # type: ignore[index,call-overload]
    by_latch = {row["Latch"]: row["Position"] for row in outer}  # type: ignore[index,call-overload]
    # the noise is drawn in other portions here, hence a step or two
    assert all(abs(by_latch[1000 * (i + 1)] - int(value)) <= 3 for i, value in enumerate(reference.counts_out))


def test_a_frame_arrives_after_it_was_latched(tmp_path: Path) -> None:
    file = tmp_path / "drives.log"
    write_log(file, {1: live_drive(1)}, 1.0, START_S, 0)
    database = cantools.database.load_file(DBC_FILE)
    with can.LogReader(str(file)) as reader:
        delays = [
            message.timestamp - START_S - database.decode_message(message.arbitration_id, message.data)["Latch"] * 1e-6  # type: ignore[index,call-overload,operator]
            for message in reader
            if message.arbitration_id == 0x181
        ]
    assert min(delays) > 1e-4
    assert sum(delays) / len(delays) == pytest.approx(5e-4, rel=0.2)
