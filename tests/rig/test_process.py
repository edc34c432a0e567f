"""The rig as a child process: what it says it sent is what arrives."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import can
import cantools
import pytest

from edge_daemon.rig.__main__ import parsed
from edge_daemon.rig.child import RigFailed, RigProcess
from edge_daemon.rig.i2c_face import open_bus

WANTED_FRAMES = 1500
WITHIN_S = 20.0


def received(channel: str, count: int) -> list[can.Message]:
    """`count` frames after opening the adapter."""
    found: list[can.Message] = []
    with can.Bus(interface="slcan", channel=channel, bitrate=1_000_000, sleep_after_open=0.0) as bus:
        deadline = time.monotonic() + WITHIN_S
        while len(found) < count and time.monotonic() < deadline:
            message = bus.recv(0.1)
            if message:
                found.append(message)
    return found


def test_what_arrives_is_what_the_log_says(tmp_path: Path) -> None:
    log = tmp_path / "sent.csv"
    with RigProcess(["--drives", "2", "--log", str(log)]) as rig:
        database = cantools.database.load_file(rig.ready["dbc"])
        found = received(rig.ready["can"]["channel"], WANTED_FRAMES)
        assert len(rig.ready["drives"]) == 2
        status = rig.order(status=True)
        assert status["sent"] >= WANTED_FRAMES
        assert rig.stop() == 0
    with log.open() as lines:
        rows = {(row["drive"], int(row["latch_us"])): row for row in csv.DictReader(lines)}
    checked = 0
    for message in found:
        name = database.get_message_by_frame_id(message.arbitration_id).name
        if not name.startswith("Encoder"):
            continue
        values = database.decode_message(message.arbitration_id, message.data)
        row = rows[name[-1], values["Latch"]]  # type: ignore[index,call-overload]
        assert values["Position"] == int(row["counts_in" if "In" in name else "counts_out"])  # type: ignore[index,call-overload]
        checked += 1
    assert checked > 0.9 * WANTED_FRAMES


def test_orders_are_obeyed_and_nonsense_is_answered() -> None:
    with RigProcess(["--effect", "none", "--wear", "0.5"]) as rig:
        truth = rig.ready["drives"][0]["truth"]
        assert truth["effects"] == []
        assert truth["stiffness_Nm_per_rad"] == 1e5
        bus = open_bus(rig.ready["drives"][0]["i2c"])
        assert bus.read_byte_data(0x76, 0xD0) == 0x58
        assert rig.order(drive=1, i2c="absent")["ok"]
        with pytest.raises(OSError, match="Remote"):
            bus.read_byte_data(0x76, 0xD0)
        bus.close()
        assert rig.order(drive=1, wear=0.75)["ok"]
        assert rig.order(status=True)["wear"] == [0.75]
        assert rig.order(drive=1, fault="frozen_in")["ok"]
        assert rig.order(drive=1, repair="frozen_in")["ok"]
        unknown = (
            {"drive": 1, "fault": "melt"},
            {"drive": 1, "repair": "reset"},
            {"drive": 1, "fault": "wear", "size": 9},
        )
        for nonsense in ({"drive": 9}, *unknown, {"can": "sideways"}, {}):
            assert rig.order(**nonsense)["ok"] is False
        channel = Path(rig.ready["can"]["channel"])
        rig.order(can="down")
        assert not channel.exists()
        rig.order(can="up")
        assert channel.exists()


def test_it_ends_on_sigterm_and_leaves_nothing_behind() -> None:
    rig = RigProcess()
    folder = Path(rig.ready["can"]["channel"]).parent
    os.kill(rig.pid, signal.SIGTERM)
    assert rig.stop() == 0
    assert not folder.exists()
    with pytest.raises(RigFailed):
        rig.order(status=True)


def test_without_anyone_to_command_it_it_runs_until_it_is_told_to_end() -> None:
    command = [sys.executable, "-m", "edge_daemon.rig", "--effect", "none"]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as rig:
        assert rig.stdout is not None and b'"ready": true' in rig.stdout.readline()
        rig.terminate()
        assert rig.communicate(timeout=WITHIN_S) == (b"", b"")
    assert rig.returncode == 0


@pytest.mark.slow
def test_bad_arguments_are_one_line_and_exit_code_two() -> None:
    for arguments in (["--effect", "magic"], ["--drives", "9"], ["--set", "coulomb_friction.level_Nm=high"]):
        ended = subprocess.run(
            [sys.executable, "-m", "edge_daemon.rig", *arguments],
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        assert ended.returncode == 2, arguments
        assert len(ended.stderr.splitlines()) == 1


def test_the_command_line_becomes_options() -> None:
    options = parsed(["--effect", "backlash", "--set", "backlash.gap_rad=1e-4", "--bits-out", "20"])
    assert options.effects == ("backlash",)
    assert options.parameters == {"backlash.gap_rad": 1e-4}
    assert options.bits_out == 20
    assert parsed([]).effects is None


def test_drives_of_one_rig_may_have_gears_of_their_own() -> None:
    named = ["--effect", "1:none", "--effect", "2:kinematic_error", "--effect", "2:coulomb_friction"]
    with RigProcess(["--drives", "3", *named, "--effect", "kinematic_error"]) as rig:
        found = [drive["truth"]["effects"] for drive in rig.ready["drives"]]
    assert [set(names) for names in found] == [set(), {"kinematic_error", "coulomb_friction"}, {"kinematic_error"}]
