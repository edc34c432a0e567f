"""The drive's I2C devices behind smbus2's calls, in the same process or over a Unix socket.

`RegisterBus` holds the devices; `serve` lets another process reach it; `SocketBus("sim:/path")` is that process's end.
A device that does not answer raises OSError(EREMOTEIO), as the Linux driver does.

Acoustic burst sensor (address 0x40), registers: 0x00 control (write 1: capture), 0x01 status (bit 0: ready),
0x02 data: each read goes on where the last one ended, i16 little endian; a new capture starts again at the first.
"""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, cast

import numpy as np

from edge_daemon.records import Array

BURST_ADDRESS = 0x40
REGISTER_CONTROL, REGISTER_STATUS, REGISTER_DATA = 0x00, 0x01, 0x02
CAPTURE, READY = 1, 1
BURST_SAMPLES = 8192
BURST_RATE_HZ = 25_600.0
"""2.56 times the 10 kHz band, the usual choice of analysers"""
PASCAL_PER_COUNT = 1e-4
"""Full scale is 3.3 Pa, 104 dB."""


class Device(Protocol):
    """What answers at one address."""

    def read(self, register: int, length: int) -> bytes: ...

    def write(self, register: int, data: bytes) -> None: ...


@dataclass(slots=True)
class BurstSensor:
    """Captures sound on command; ready when the stretch has passed on `clock`."""

    sound: Callable[[int, float], Array]
    """(samples, rate_hz) -> (samples,) [Pa] from now on"""
    clock: Callable[[], float]
    samples: int = BURST_SAMPLES
    rate_hz: float = BURST_RATE_HZ
    _data: bytes = b""
    _at: int = 0
    _ready_s: float = field(default=float("inf"))

    def read(self, register: int, length: int) -> bytes:
        """Status or the next stretch of data (zeros past the end)."""
        if register == REGISTER_STATUS:
            return bytes([READY if self.clock() >= self._ready_s else 0]).ljust(length, b"\0")
        if register != REGISTER_DATA:
            return bytes(length)
        piece = self._data[self._at : self._at + length]
        self._at += length
        return piece.ljust(length, b"\0")

    def write(self, register: int, data: bytes) -> None:
        """Starts a capture."""
        if register == REGISTER_CONTROL and data and data[0] & CAPTURE:
            self._data = waveform_i16(self.sound(self.samples, self.rate_hz)).astype("<i2").tobytes()
            self._at = 0
            self._ready_s = self.clock() + self.samples / self.rate_hz


def waveform_i16(sound_Pa: Array) -> Array:
    """(n,) what a 16-bit converter makes of it: whole counts, clipped at full scale."""
    return np.asarray(np.clip(np.rint(sound_Pa / PASCAL_PER_COUNT), -32_768, 32_767))


I2C_FAULTS = ("none", "absent", "short", "garbage", "previous")


@dataclass(slots=True)
class RegisterBus:
    """Devices by address, behind the calls of `smbus2.SMBus`."""

    devices: dict[int, Device]
    fault: str = "none"
    """`absent`: nobody acknowledges; `short`: half the bytes; `garbage`: all ones; `previous`: the bytes of the read
    before, as a Raspberry Pi gives them when a part stretches the clock"""
    _last: bytes = b""

    def read_i2c_block_data(self, address: int, register: int, length: int) -> list[int]:
        """`length` bytes from `register` on. Raises OSError where nobody answers."""
        data = self._device(address).read(register, length)
        if self.fault == "previous":
            data, self._last = self._last[:length].ljust(length, b"\0"), data
            return list(data)
        self._last = data
        if self.fault == "short":
            data = data[: length // 2]
        return [0xFF] * len(data) if self.fault == "garbage" else list(data)

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int]) -> None:
        """Writes bytes from `register` on."""
        self._device(address).write(register, bytes(data))

    def read_byte_data(self, address: int, register: int) -> int:
        """One register. Raises OSError where nobody answers."""
        data = self.read_i2c_block_data(address, register, 1)
        if not data:
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        return data[0]

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        """One register."""
        self.write_i2c_block_data(address, register, [value])

    def close(self) -> None:
        """Nothing to give back."""

    def _device(self, address: int) -> Device:
        if self.fault == "absent" or address not in self.devices:
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        return self.devices[address]


_REQUEST = struct.Struct("<BBBB")
"""A request is operation, address, register, and the length of data (write) or of what is wanted (read)."""
_ANSWER = struct.Struct("<BB")
"""0 or an errno, length of data"""
OP_READ, OP_WRITE = 0, 1
SOCKET_TIMEOUT_S = 2.0
SCHEME = "sim:"


class _Attendant(asyncio.Protocol):
    """One client of the socket; answers each request at once."""

    def __init__(self, bus: RegisterBus) -> None:
        self._bus = bus
        self._rest = b""
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keeps the way back."""
        self._transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        """Answers every complete request."""
        self._rest += data
        while len(self._rest) >= _REQUEST.size and self._transport:
            operation, address, register, length = _REQUEST.unpack_from(self._rest)
            end = _REQUEST.size + (length if operation == OP_WRITE else 0)
            if len(self._rest) < end:
                return
            written, self._rest = self._rest[_REQUEST.size : end], self._rest[end:]
            self._transport.write(_answered(self._bus, operation, address, register, length, written))


async def serve(bus: RegisterBus, path: Path) -> asyncio.Server:
    """Lets other processes use `bus` over a Unix socket at `path`."""
    return await asyncio.get_running_loop().create_unix_server(lambda: _Attendant(bus), path)


def _answered(bus: RegisterBus, operation: int, address: int, register: int, length: int, data: bytes) -> bytes:
    try:
        if operation == OP_WRITE:
            bus.write_i2c_block_data(address, register, data)
            return _ANSWER.pack(0, 0)
        found = bytes(bus.read_i2c_block_data(address, register, length))
    except OSError as error:
        return _ANSWER.pack(error.errno or errno.EIO, 0)
    return _ANSWER.pack(0, len(found)) + found


class SocketBus:
    """smbus2's calls, answered by a rig in another process. Not for several threads at once."""

    def __init__(self, name: str) -> None:
        """`name`: `sim:/path/of/socket`. Raises OSError where nobody listens."""
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(SOCKET_TIMEOUT_S)
        try:
            self._socket.connect(name.removeprefix(SCHEME))
        except OSError:
            self._socket.close()
            raise

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int) -> list[int]:
        """`length` bytes (at most 255) from `register` on."""
        return list(self._asked(_REQUEST.pack(OP_READ, i2c_addr, register, length)))

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int]) -> None:
        """Writes at most 255 bytes from `register` on."""
        self._asked(_REQUEST.pack(OP_WRITE, i2c_addr, register, len(data)) + bytes(data))

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """One register."""
        data = self.read_i2c_block_data(i2c_addr, register, 1)
        if not data:
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        return data[0]

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """One register."""
        self.write_i2c_block_data(i2c_addr, register, [value])

    def close(self) -> None:
        """Hangs up."""
        self._socket.close()

    def _asked(self, request: bytes) -> bytes:
        self._socket.sendall(request)
        code, length = _ANSWER.unpack(self._exactly(_ANSWER.size))
        data = self._exactly(length)
        if code:
            raise OSError(code, os.strerror(code))
        return data

    def _exactly(self, length: int) -> bytes:
        data = b""
        while len(data) < length:
            piece = self._socket.recv(length - len(data))
            if not piece:
                raise OSError(errno.EREMOTEIO, "the simulated bus hung up")
            data += piece
        return data


def open_bus(name: str) -> SocketBus:
    """The bus behind `sim:/path/of/socket`."""
    return SocketBus(name)
