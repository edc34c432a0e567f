"""The drive on CAN: encoder and drive frames, on any python-can bus or as a serial-line CAN adapter on a pty.

Layout as in `drive.dbc` beside this file; drives are numbered from 1. Little endian.

    EncoderIn<n>   0x180+n   position i32 [counts], latch time u32 [us]
    EncoderOut<n>  0x280+n   position i32 [counts], latch time u32 [us]
    Drive<n>       0x380+n   torque i16 [0.001 N m], current i16 [0.01 A], velocity i32 [0.001 rad/s]
"""

from __future__ import annotations

import contextlib
import os
import struct
import tty
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from edge_daemon.rig.live import Samples

ID_ENCODER_IN, ID_ENCODER_OUT, ID_DRIVE = 0x180, 0x280, 0x380
"""CiA 301 gives the first three transmit PDOs these identifiers; the node number is added."""
MOST_DRIVES = 8
DRIVE_FRAME_EVERY = 10
"""A drive frame comes every so many samples: 100 Hz."""
LATCH_PER_S = 1_000_000
LATCH_WRAP = 1 << 32
DBC_FILE = Path(__file__).with_name("drive.dbc")
_POSITION = struct.Struct("<iI")
_DRIVE = struct.Struct("<hhi")

Frame = tuple[int, bytes]
"""Identifier and data."""


def latch_us(time_s: float, start_us: int) -> int:
    """The devices' common 32-bit microsecond counter at a rig time."""
    return (start_us + round(time_s * LATCH_PER_S)) % LATCH_WRAP


def frames(number: int, samples: Samples, start_us: int, first: int = 0) -> Iterator[Frame]:
    """The frames of drive `number` (1..8) for its samples, in order; `first`: index of the first sample ever."""
    return (frame for _, frame in timed_frames(number, samples, start_us, first))


def timed_frames(number: int, samples: Samples, start_us: int, first: int = 0) -> Iterator[tuple[float, Frame]]:
    """As `frames`, each with the rig time [s] at which its values were latched."""
    rows = zip(
        samples.time_s.tolist(),
        samples.counts_in.tolist(),
        samples.counts_out.tolist(),
        samples.kept_in.tolist(),
        samples.kept_out.tolist(),
        samples.kept_drive.tolist(),
        strict=True,
    )
    for i, (time_s, counts_in, counts_out, kept_in, kept_out, kept_drive) in enumerate(rows):
        latch = latch_us(time_s, start_us)
        if kept_in:
            yield time_s, (ID_ENCODER_IN + number, _POSITION.pack(counts_in, latch))
        if kept_out:
            yield time_s, (ID_ENCODER_OUT + number, _POSITION.pack(counts_out, latch))
        if kept_drive and (first + i) % DRIVE_FRAME_EVERY == 0:
            yield time_s, (ID_DRIVE + number, _drive_frame(samples, i))


def _drive_frame(samples: Samples, i: int) -> bytes:
    torque = max(-32_768, min(32_767, round(float(samples.motor_torque_Nm[i]) * 1000)))
    current = max(-32_768, min(32_767, round(float(samples.motor_current_A[i]) * 100)))
    return _DRIVE.pack(torque, current, round(float(samples.motor_speed_rad_s[i]) * 1000))


@dataclass(slots=True)
class BusPort:
    """Frames onto an open python-can bus (virtual, udp_multicast, socketcan)."""

    bus: Any
    down: bool = False
    sent: int = 0
    dropped: int = 0

    @property
    def listening(self) -> bool:
        """A bus takes frames whether or not anybody listens."""
        return not self.down

    @property
    def full(self) -> bool:
        """python-can's buses say so only by an error."""
        return False

    def poll(self) -> None:
        """Takes in what others sent, so that nothing piles up."""
        while self.bus.recv(0.0) is not None:
            pass

    def send(self, outgoing: Iterable[Frame]) -> None:
        """Sends; what the bus refuses is counted as dropped."""
        import can

        for identifier, data in outgoing:
            try:
                self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
                self.sent += 1
            except can.CanError:
                self.dropped += 1

    def take_down(self) -> None:
        """The wire is cut."""
        self.down = True

    def bring_up(self) -> None:
        """The wire is whole again."""
        self.down = False

    def close(self) -> None:
        """Ends the bus."""
        self.bus.shutdown()


QUEUE_BYTES = 65_536
"""An adapter's own memory holds about a second of one drive; what does not fit is lost and counted."""
VERSION_ANSWER = b"V1013\r"
SERIAL_ANSWER = b"NEDGE\r"
ERROR_ANSWER = b"\a"


@dataclass(slots=True)
class SlcanPort:
    """A serial-line CAN adapter (Lawicel CAN232 command set) on a pseudo-terminal, reached under `path`.

    `path` is a link to the terminal in use: after `take_down` it is gone, after `bring_up` it leads to a new one, as
    when an adapter is pulled and plugged.
    """

    path: Path
    open_for_frames: bool = False
    sent: int = 0
    dropped: int = 0
    _master: int = field(default=-1)
    _slave: int = field(default=-1)
    _queue: bytearray = field(default_factory=bytearray)
    _commands: bytearray = field(default_factory=bytearray)

    def __post_init__(self) -> None:
        self.bring_up()

    @property
    def listening(self) -> bool:
        """Plugged, and told to open its channel."""
        return self._master >= 0 and self.open_for_frames

    @property
    def full(self) -> bool:
        """Nobody has read for so long that the adapter's memory is used up."""
        return len(self._queue) > QUEUE_BYTES

    def bring_up(self) -> None:
        """Plugs the adapter in."""
        if self._master >= 0:
            return
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))

    def take_down(self) -> None:
        """Pulls the adapter: its terminal and the link to it vanish."""
        if self._master < 0:
            return
        self.path.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1
        self.open_for_frames = False
        self._queue.clear()
        self._commands.clear()

    def poll(self) -> None:
        """Obeys the commands that have arrived, and sends on what waits."""
        if self._master < 0:
            return
        with contextlib.suppress(BlockingIOError, OSError):
            self._commands += os.read(self._master, 4096)
        while b"\r" in self._commands:
            command, _, rest = bytes(self._commands).partition(b"\r")
            self._commands[:] = rest
            self._obey(command)
        self._flush()

    def _obey(self, command: bytes) -> None:
        letter = command[:1]
        if letter in (b"O", b"L"):
            self.open_for_frames = True
        elif letter == b"C":
            self.open_for_frames = False
            self._queue.clear()
        answers = {b"V": VERSION_ANSWER, b"N": SERIAL_ANSWER, b"t": b"z\r", b"T": b"Z\r", b"F": b"F00\r"}
        known = letter in b"OLCSsZMmrRXYWy" or not letter
        self._queue += answers.get(letter, b"\r" if known else ERROR_ANSWER)

    def send(self, outgoing: Iterable[Frame]) -> None:
        """Puts frames out as ASCII."""
        for identifier, data in outgoing:
            self._queue += f"t{identifier:03X}{len(data)}{data.hex().upper()}\r".encode()
            self.sent += 1
        self._flush()

    def send_raw(self, data: bytes) -> None:
        """Bytes as they are: to test what garbage does."""
        self._queue += data
        self._flush()

    def _flush(self) -> None:
        while self._queue and self._master >= 0:
            try:
                written = os.write(self._master, self._queue)
            except (BlockingIOError, OSError):
                return
            del self._queue[:written]

    def close(self) -> None:
        """Pulls the adapter for good."""
        self.take_down()


SendPort = BusPort | SlcanPort


def open_port(where: str, folder: Path) -> SendPort:
    """`slcan` (a pty under `folder`) or `INTERFACE:CHANNEL` of python-can."""
    if where == "slcan":
        return SlcanPort(folder / "can0")
    import can

    interface, _, channel = where.partition(":")
    return BusPort(can.Bus(interface=interface, channel=channel))
