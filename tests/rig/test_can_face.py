"""CAN frames, decoded by cantools from the DBC and received by python-can."""

from __future__ import annotations

import contextlib
import time
from itertools import pairwise
from pathlib import Path

import can
import cantools
import numpy as np
import pytest

from edge_daemon.rig.can_face import DBC_FILE, BusPort, SlcanPort, frames, latch_us
from edge_daemon.rig.live import Samples, live_drive

DATABASE = cantools.database.load_file(DBC_FILE)
START_US = (1 << 32) - 5_000


def abandon(bus: can.BusABC) -> None:
    """Closes a bus whose adapter is gone: it cannot say goodbye."""
    bus.serialPortOrig.close()  # type: ignore[attr-defined]
    with contextlib.suppress(Exception):
        bus.shutdown()


def some_samples() -> Samples:
    return live_drive(seed=2).advance(0.02)


def decoded(outgoing: list[tuple[int, bytes]], name: str) -> list[dict[str, float]]:
    identifier = DATABASE.get_message_by_name(name).frame_id
    return [DATABASE.decode_message(i, data) for i, data in outgoing if i == identifier]  # type: ignore[misc]


def test_the_dbc_names_three_messages_for_each_of_eight_drives() -> None:
    expected = {f"{kind}{n}" for kind in ("EncoderIn", "EncoderOut", "Drive") for n in range(1, 9)}
    assert {message.name for message in DATABASE.messages} == expected
    assert len({message.frame_id for message in DATABASE.messages}) == 24


@pytest.mark.parametrize("number", [1, 8])
def test_frames_say_what_was_latched(number: int) -> None:
    samples = some_samples()
    outgoing = list(frames(number, samples, START_US))
    inner, outer = (decoded(outgoing, f"{kind}{number}") for kind in ("EncoderIn", "EncoderOut"))
    assert [row["Position"] for row in inner] == samples.counts_in.tolist()
    assert [row["Position"] for row in outer] == samples.counts_out.tolist()
    assert [row["Latch"] for row in inner] == [row["Latch"] for row in outer]
    drive = decoded(outgoing, f"Drive{number}")
    assert len(drive) == 2
    assert drive[0]["Velocity"] == pytest.approx(samples.motor_speed_rad_s[0], abs=6e-4)
    assert drive[0]["Torque"] == pytest.approx(samples.motor_torque_Nm[0], abs=6e-4)


def test_a_lost_frame_is_not_sent_and_the_others_are() -> None:
    drive = live_drive(seed=2)
    drive.encoder_out.loss = 1.0
    drive.encoder_in.loss = 0.5
    outgoing = list(frames(1, drive.advance(1.0), START_US))
    assert decoded(outgoing, "EncoderOut1") == []
    assert 400 < len(decoded(outgoing, "EncoderIn1")) < 600


def test_the_latch_counter_rolls_over_in_even_steps() -> None:
    stamps = [latch_us(t, START_US) for t in np.arange(0, 20) / 1000]
    assert min(stamps) < max(stamps) - (1 << 31)
    assert {(b - a) % (1 << 32) for a, b in pairwise(stamps)} == {1000}


def received(bus: can.BusABC, port: SlcanPort, want: int) -> list[can.Message]:
    """At least `want` frames, or what came within five seconds."""
    found: list[can.Message] = []
    deadline = time.monotonic() + 5.0
    while len(found) < want and time.monotonic() < deadline:
        port.poll()
        message = bus.recv(0.01)
        if message:
            found.append(message)
    return found


def plugged(port: SlcanPort) -> can.BusABC:
    return can.Bus(interface="slcan", channel=str(port.path), bitrate=1_000_000, sleep_after_open=0.0)


def opened(port: SlcanPort) -> can.BusABC:
    bus = plugged(port)
    end_s = time.monotonic() + 5.0
    while not port.listening and time.monotonic() < end_s:  # what was written may take a moment through the pty
        port.poll()
    assert port.listening
    return bus


def test_an_slcan_adapter_delivers_every_frame_in_order(tmp_path: Path) -> None:
    port = SlcanPort(tmp_path / "can0")
    bus = opened(port)
    outgoing = list(frames(1, some_samples(), START_US))
    port.send(outgoing)
    found = received(bus, port, len(outgoing))
    assert [(message.arbitration_id, bytes(message.data)) for message in found] == outgoing
    bus.shutdown()
    port.poll()
    assert not port.listening
    port.close()


def test_a_version_question_is_answered(tmp_path: Path) -> None:
    port = SlcanPort(tmp_path / "can0")
    bus = opened(port)
    terminal = bus.serialPortOrig  # type: ignore[attr-defined]
    terminal.timeout = 2.0
    terminal.reset_input_buffer()
    terminal.write(b"V\rN\rQ\r")
    port.poll()
    assert terminal.read(len(b"V1013\rNEDGE\r\a")) == b"V1013\rNEDGE\r\a"
    bus.shutdown()
    port.close()


def test_a_pulled_adapter_is_an_error_and_comes_back_under_the_same_name(tmp_path: Path) -> None:
    port = SlcanPort(tmp_path / "can0")
    bus = opened(port)
    port.take_down()
    assert not port.path.exists()
    with pytest.raises(can.CanError):
        for _ in range(100):
            bus.recv(0.01)
    abandon(bus)
    port.bring_up()
    again = opened(port)
    port.send([(0x181, bytes(8))])
    assert received(again, port, 1)[0].arbitration_id == 0x181
    again.shutdown()
    port.close()


def test_an_adapter_nobody_reads_fills_up_and_says_so(tmp_path: Path) -> None:
    port = SlcanPort(tmp_path / "can0")
    bus = opened(port)
    for _ in range(10_000):
        if port.full:
            break
        port.send([(0x181, bytes(8))] * 100)
    assert port.full
    port.close()
    abandon(bus)


def test_a_virtual_bus_takes_the_same_frames() -> None:
    ours = BusPort(can.Bus(interface="virtual", channel="rig-test"))
    theirs = can.Bus(interface="virtual", channel="rig-test")
    outgoing = list(frames(3, some_samples(), START_US))
    ours.send(outgoing)
    found = [theirs.recv(1.0) for _ in outgoing]
    assert [(m.arbitration_id, bytes(m.data)) for m in found if m] == outgoing
    theirs.shutdown()
    ours.close()
