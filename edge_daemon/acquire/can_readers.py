"""Taking frames off a bus that python-can opened, without its cost per frame.

python-can reads a serial adapter byte by byte and a socket with two system calls and an object per frame; at a few
thousand frames a second that alone fills a small computer. Where a descriptor is at hand the bytes are read here.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import time
from binascii import Error as HexError
from binascii import unhexlify
from typing import Any, Protocol

from edge_daemon.acquire.can_inbox import Inbox, Slot
from edge_daemon.acquire.canopen_objects import EXTENDED
from edge_daemon.acquire.source import Tally

SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40
SO_RCVBUFFORCE = 33
"""Number from asm-generic/socket.h, which Python does not name."""
FRAME = struct.Struct("=IBB2x")
"""A frame is its identifier with flags, its length and its FD flags (linux/can.h)."""
FRAME_BYTES = 72
"""An FD frame, the longest, has this many bytes."""
TIMESPEC = struct.Struct("@ll")
OVERFLOW = struct.Struct("@I")
ANCILLARY_BYTES = socket.CMSG_SPACE(TIMESPEC.size) + socket.CMSG_SPACE(OVERFLOW.size)
REMOTE_FLAG = 0x4000_0000
ERROR_FLAG = 0x2000_0000
ID_29 = 0x1FFF_FFFF
READ_BYTES = 65_536
LONGEST_LINE = 160
"""A line of the serial protocol is no longer: an FD frame of 64 bytes has 138 characters and perhaps a stamp."""


class LinkDown(Exception):
    """The descriptor is dead; the reason in a few words."""


class FrameReader(Protocol):
    """Takes what is there, and comes back."""

    stamps_itself: bool
    """times come from the kernel or the driver, not from the moment of reading"""

    def drain(self, inbox: Inbox, limit: int) -> bool:
        """Moves up to about `limit` frames; True if more may wait. Raises `LinkDown`."""
        ...


class SocketReader:
    """A raw CAN socket, one system call a frame, with kernel time stamps and the kernel's count of dropped frames."""

    stamps_itself = True

    def __init__(self, sock: socket.socket, receive_buffer_bytes: int, tally: Tally) -> None:
        self._socket = sock
        self._tally = tally
        self._dropped = 0
        sock.setblocking(False)
        try:
            sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, receive_buffer_bytes)
        except OSError:  # needs a capability; without it the kernel caps the size at net.core.rmem_max
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)

    def drain(self, inbox: Inbox, limit: int) -> bool:
        """See `FrameReader`."""
        receive = self._socket.recvmsg
        for _ in range(limit):
            try:
                frame, ancillary, _, _ = receive(FRAME_BYTES, ANCILLARY_BYTES)
            except (BlockingIOError, InterruptedError):
                return False
            except OSError as error:
                raise LinkDown(_named(error)) from error
            if len(frame) < FRAME.size:
                inbox.take_malformed()
                continue
            identifier, length, _ = FRAME.unpack_from(frame)
            payload = frame[FRAME.size : FRAME.size + length]
            time_s = self._ancillary(ancillary)
            if identifier & ERROR_FLAG:
                inbox.take_error(identifier & ID_29, payload)
            elif not identifier & REMOTE_FLAG:
                inbox.take(identifier, payload, time_s)
        return True

    def _ancillary(self, items: list[tuple[int, int, bytes]]) -> float:
        """The kernel's time stamp; counts what it dropped."""
        time_s = 0.0
        for _, kind, data in items:
            if kind == SO_TIMESTAMPNS:
                seconds, nanoseconds = TIMESPEC.unpack_from(data)
                time_s = seconds + nanoseconds * 1e-9
            elif kind == SO_RXQ_OVFL:
                dropped = OVERFLOW.unpack_from(data)[0]
                self._tally.count("kernel_drops", (dropped - self._dropped) & 0xFFFF_FFFF)
                self._dropped = dropped
        return time_s or time.time()


def _named(error: OSError) -> str:
    if error.errno == errno.ENETDOWN:
        return "the interface is down"
    if error.errno in (errno.ENODEV, errno.ENXIO):
        return "the interface is gone"
    return f"read failed: {error.strerror or error}"


class SlcanReader:
    """A serial adapter that speaks the LAWICEL text protocol (slcan): `t1238<16 hex digits>` and a carriage return."""

    stamps_itself = False

    def __init__(self, descriptor: int, inbox: Inbox) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._rest = b""
        self._heads: dict[bytes, tuple[Slot, int]] = {}
        for key, slot in inbox.slots.items():
            if slot.layout.length <= 8:
                head = (
                    b"T%08X%d" % (key & ID_29, slot.layout.length)
                    if key & EXTENDED
                    else b"t%03X%d"
                    % (
                        key,
                        slot.layout.length,
                    )
                )
                for spelling in (head, head[:1] + head[1:].lower()):
                    self._heads[spelling] = (slot, len(head) + 2 * slot.layout.length)

    def drain(self, inbox: Inbox, limit: int) -> bool:
        """See `FrameReader`; takes all that one read gives."""
        try:
            chunk = os.read(self._descriptor, READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError as error:
            raise LinkDown(f"the serial port is gone: {error.strerror or error}") from error
        if not chunk:
            self._check_alive()
            return False
        time_s = time.time()
        *lines, rest = (self._rest + chunk).split(b"\r")
        self._rest = rest if len(rest) <= LONGEST_LINE else b""
        if len(rest) > LONGEST_LINE:
            inbox.take_malformed()
        self._take(inbox, lines, time_s)
        return len(lines) >= limit

    def _check_alive(self) -> None:
        """A terminal set up without a minimum reads as empty both when nothing is there and when it is hung up."""
        poll = select.poll()
        poll.register(self._descriptor, select.POLLIN)
        if any(events & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, events in poll.poll(0)):
            raise LinkDown("the serial port is closed")

    def _take(self, inbox: Inbox, lines: list[bytes], time_s: float) -> None:
        heads = self._heads
        found: dict[Slot, list[bytes]] = {}
        for line in lines:
            # a standard frame's identifier and length are five characters, an extended one's ten
            size = 5 if line[:1] == b"t" else 10
            known = heads.get(line[:size])
            if known is None:
                self._take_other(inbox, line, time_s)
                continue
            slot, end = known
            if len(line) not in (end, end + 4):  # four more: the adapter's own millisecond stamp
                inbox.take_malformed()
                continue
            payloads = found.get(slot)
            if payloads is None:
                payloads = found[slot] = []
            payloads.append(line[size:end])
        for slot, payloads in found.items():
            self._take_payloads(inbox, slot, payloads, time_s)

    @staticmethod
    def _take_payloads(inbox: Inbox, slot: Slot, payloads: list[bytes], time_s: float) -> None:
        try:
            data = [unhexlify(b"".join(payloads))]
        except HexError:
            data = []
            for payload in payloads:
                try:
                    data.append(unhexlify(payload))
                except HexError:
                    inbox.take_malformed()
        good = sum(map(len, data)) // slot.layout.length
        slot.data += data
        slot.times += inbox.latched(good, time_s) if slot.synced else [time_s] * good
        inbox.frames += good

    @staticmethod
    def _take_other(inbox: Inbox, line: bytes, time_s: float) -> None:
        """Frames of unknown or odd length, answers, noise."""
        line = line.lstrip(b"\a\n")  # the bell answers a refused command and has no end of its own
        kind = line[:1]
        if kind in (b"t", b"T"):
            size = 4 if kind == b"t" else 9
            try:
                key = int(line[1:size], 16) | (0 if kind == b"t" else EXTENDED)
                length = int(line[size : size + 1], 16)
                payload = unhexlify(line[size + 1 : size + 1 + 2 * length])
            except ValueError:
                inbox.take_malformed()
                return
            if len(payload) != length or length > 8:
                inbox.take_malformed()
            else:
                inbox.take(key, payload, time_s)
        elif kind and kind not in b"rRzZFVvNO":  # remote frames and answers to commands are no data
            inbox.take_malformed()


class BusReader:
    """Any other python-can bus, through its own `recv`."""

    stamps_itself = True

    def __init__(self, bus: Any) -> None:
        self._bus = bus

    def drain(self, inbox: Inbox, limit: int) -> bool:
        """See `FrameReader`."""
        for _ in range(limit):
            message = self.receive(0.0)
            if message is None:
                return False
            take_message(inbox, message, message.timestamp or time.time())  # some drivers give no time
        return True

    def receive(self, timeout_s: float) -> Any:
        """The next python-can message, None if none came in time. Raises `LinkDown`."""
        from can import CanError

        try:
            return self._bus.recv(timeout_s)
        except (CanError, OSError, ValueError) as error:
            raise LinkDown(f"read failed: {error}") from error


def take_message(inbox: Inbox, message: Any, time_s: float) -> None:
    """A python-can message, from a bus or from a log, that arrived at `time_s`."""
    if message.is_error_frame:
        inbox.take_error(message.arbitration_id, bytes(message.data))
    elif not message.is_remote_frame:
        key = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
        if len(message.data) < message.dlc:
            inbox.take_malformed()
        else:
            inbox.take(key, bytes(message.data), time_s)
