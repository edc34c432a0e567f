"""What reads CAN frames from a socket or a serial line, and the inbox they go to: stamps, drops, garbage."""

from __future__ import annotations

import os
import socket
import struct
from pathlib import Path

import numpy as np
import pytest
from heard import slcan

from edge_daemon.acquire.can_decode import by_key, dbc_layouts
from edge_daemon.acquire.can_inbox import Inbox
from edge_daemon.acquire.can_readers import LinkDown, SlcanReader, SocketReader
from edge_daemon.acquire.source import Tally

HERE = Path(__file__).parent


def decoded() -> tuple[Tally, Inbox]:
    tally = Tally("can")
    return tally, Inbox("can", by_key(dbc_layouts(HERE / "drive.dbc")), (), tally)


def _udp() -> tuple[socket.socket, socket.socket]:
    """A datagram socket has the same kernel stamps and drop counter as a CAN socket."""
    receiver, sender = socket.socket(type=socket.SOCK_DGRAM), socket.socket(type=socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", 0))
    sender.connect(receiver.getsockname())
    return receiver, sender


def _raw(identifier: int, data: bytes) -> bytes:
    return struct.pack("=IBB2x8s", identifier, len(data), 0, data)


def test_the_socket_reader_uses_the_kernel_stamp_and_counts_what_the_kernel_dropped() -> None:
    tally, inbox = decoded()
    receiver, sender = _udp()
    with receiver, sender:
        reader = SocketReader(receiver, 4096, tally)
        sent = 5000
        for i in range(sent):
            sender.send(_raw(0x100, struct.pack("<iI", i, 0)))
        while reader.drain(inbox, 64):
            pass
        sender.send(_raw(0x100, struct.pack("<iI", -1, 0)))  # the next frame tells how many were lost before it
        sender.send(_raw(0x2000_0004, bytes(8)))
        sender.send(_raw(0x8000_0000 | 0x18FF0001, bytes(8)))
        sender.send(b"tiny")
        assert reader.drain(inbox, 64) is False
        [readings, *_] = [r for r in inbox.flush(0.0) if r.signal == "EncoderIn.Count"]
    kept = len(readings.value)
    assert 0 < kept < sent
    assert tally.counters["kernel_drops"] == sent - (kept - 1)
    assert np.all(np.diff(readings.time_s) >= 0)
    assert (tally.counters["error_frames"], tally.counters["malformed"]) == (1, 1)
    assert tally.counters["frames"] == kept + 3


def test_a_dead_socket_is_a_link_down() -> None:
    tally, inbox = decoded()
    receiver, sender = _udp()
    with receiver, sender:
        reader = SocketReader(receiver, 4096, tally)
    with pytest.raises(LinkDown, match="read failed: Bad file descriptor"):
        reader.drain(inbox, 1)


def test_extended_identifiers_on_the_serial_line() -> None:
    _, inbox = decoded()
    read, write = os.pipe()
    odd = next(key for key, slot in inbox.slots.items() if slot.layout.name == "Odd")
    os.write(write, b"T%08X8%s\r" % (odd & 0x1FFFFFFF, bytes(8).hex().encode()))
    SlcanReader(read, inbox).drain(inbox, 10)
    assert {r.signal: r.value[0] for r in inbox.flush(0.0)}["Odd.Little21s"] == 3.0
    os.close(read)
    os.close(write)


def test_no_bytes_whatsoever_upset_the_serial_reader() -> None:
    rng = np.random.default_rng(20_241)
    tally, inbox = decoded()
    read, write = os.pipe()
    reader = SlcanReader(read, inbox)
    alphabet = np.frombuffer(b"tTrRdDbB0123456789abcdefXYz\r\r\r\a\n\0\xff", np.uint8)
    good = slcan(0x101, struct.pack("<iI", 1, 2))
    for _ in range(300):
        noise = rng.choice(alphabet, int(rng.integers(1, 400))).tobytes()
        os.write(write, noise + b"\r" + good)
        reader.drain(inbox, 100)
        readings = {r.signal: r.value for r in inbox.flush(0.0)}
        assert readings["EncoderOut.Count"][-1] == 1
    assert tally.counters["malformed"] > 1000
    os.close(read)
    os.close(write)


def test_no_frame_seems_to_come_from_the_future_when_the_wall_clock_was_set_back() -> None:
    _, inbox = decoded()
    for stamp_s in (1000.0, 1000.1, 400.2):  # the wall clock is set back by ten minutes before the third
        inbox.take(0x101, bytes(8), stamp_s)
    [readings, *_] = inbox.flush(600.0, latest_s=1000.25)
    np.testing.assert_allclose(readings.time_s, [1000.25, 1000.25, 1000.2])
