"""Reading and writing the registers of one I2C device as if the bus were good: retries, checks, one kind of error.

All of this blocks, and runs in the one thread of its bus.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

T = TypeVar("T")

BLOCK = 32
"""One SMBus block holds this many bytes (System Management Bus specification 2.0, section 5.5.7)."""
BUS_ERRNOS = frozenset({errno.ENOENT, errno.EBADF, errno.EPIPE, errno.ECONNRESET, errno.ENOTCONN, errno.EACCES})
"""With these the bus itself is gone; anything else (EREMOTEIO, ENXIO, EIO, ETIMEDOUT, EAGAIN) is one device that
fails."""
UNANSWERED = frozenset({errno.EREMOTEIO, errno.ENXIO, errno.ENODEV})
"""Drivers say one of these when nobody acknowledges the address."""


class I2cBus(Protocol):
    """What is used of an I2C bus: these few methods of smbus2's `SMBus`, with its meaning and its errors."""

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, /) -> list[int]:
        """`length` (1 to 32) bytes from `register` on."""
        ...

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: list[int], /) -> None:
        """Writes `data` (at most 32 bytes) to `register`."""
        ...

    def write_byte_data(self, i2c_addr: int, register: int, value: int, /) -> None:
        """One byte."""
        ...

    def close(self) -> None:
        """Frees the bus."""
        ...


class DeviceError(Exception):
    """This device did not do what was asked; the reason in a few words."""


class NoSuchDevice(DeviceError):
    """ENODEV: some drivers say it of a part that is not there (i2c-stub), others of a bus that was unplugged."""


class BusGone(Exception):
    """The bus is closed or was removed."""


def crc8(data: Sequence[int], polynomial: int, start: int) -> int:
    """Checksum of `data`, most significant bit first, not reflected."""
    crc = start
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ polynomial) & 0xFF if crc & 0x80 else crc << 1
    return crc


def crc8_sensirion(word: Sequence[int]) -> int:
    """Sensirion's checksum of a two-byte word (e.g. SHT3x-DIS datasheet, section 4.12): x^8+x^5+x^4+1, start 0xFF."""
    return crc8(word, 0x31, 0xFF)


def smbus_pec(address: int, register: int, data: Sequence[int]) -> int:
    """Packet error code of a register read (SMBus specification 2.0, section 5.4): x^8+x^2+x+1, start 0."""
    return crc8([address << 1, register, address << 1 | 1, *data], 0x07, 0)


class Registers:
    """The registers of the device at one address."""

    def __init__(self, bus: I2cBus, address: int, retries: int, count: Callable[[str], None]) -> None:
        """`count` is told of each `bus_errors`, `short_reads`, `crc_errors`, `echoes`, also where a retry helped."""
        self.address = address
        self._bus = bus
        self._retries = retries
        self._count = count
        self._last: tuple[int, bytes] | None = None

    def read(self, register: int, length: int) -> bytes:
        """`length` bytes from `register` on; the device counts the address up. Raises `DeviceError`, `BusGone`."""
        data = b""
        for start in range(0, length, BLOCK):
            data += self._checked(register + start, min(BLOCK, length - start))
        return data

    def read_once(self, register: int) -> bytes:
        """One byte that changes by itself, such as a status: tried again on failure, never suspected of an echo."""
        return self._retried(lambda: self._once(register, 1))

    def stream(self, register: int, length: int) -> bytes:
        """`length` (at most `BLOCK`) bytes from a register that goes on where the last read ended.

        Never tried twice, since what a failed read had taken out is gone. Raises `DeviceError`, `BusGone`.
        """
        return self._once(register, length)

    def read_sensirion(self, register: int, length: int) -> bytes:
        """As `read`, where each two-byte word is followed by its checksum, which is taken off."""

        def check(raw: bytes) -> bytes | None:
            words = [raw[i : i + 3] for i in range(0, len(raw), 3)]
            good = all(crc8_sensirion(word[:2]) == word[2] for word in words)
            return b"".join(word[:2] for word in words) if good else None

        return self._verified(register, length // 2 * 3, check)

    def read_pec(self, register: int, length: int) -> bytes:
        """As `read`, followed by a packet error code, which is taken off."""

        def check(raw: bytes) -> bytes | None:
            return raw[:-1] if smbus_pec(self.address, register, raw[:-1]) == raw[-1] else None

        return self._verified(register, length + 1, check)

    def write(self, register: int, value: int) -> None:
        """One byte. Raises `DeviceError`, `BusGone`."""
        self._retried(lambda: self._translated(lambda: self._bus.write_byte_data(self.address, register, value)))

    def _verified(self, register: int, length: int, check: Callable[[bytes], bytes | None]) -> bytes:
        def attempt() -> bytes:
            data = check(self._once(register, length))
            if data is None:
                self._count("crc_errors")
                raise DeviceError("wrong checksum")
            return data

        return self._retried(attempt)

    def _checked(self, register: int, length: int) -> bytes:
        """A read that is repeated if it may be the echo of another register's.

        After clock stretching some masters hand out the bytes of the transaction before. Equal bytes from different
        registers are read once more: an echo then echoes the same register, which is what was wanted.
        """
        before = self._last
        data = self._retried(lambda: self._once(register, length))
        if before and before[0] != register and any(data) and data == before[1][:length]:
            again = self._retried(lambda: self._once(register, length))
            if again != data:
                self._count("echoes")
            data = again
        self._last = (register, data)
        return data

    def _once(self, register: int, length: int) -> bytes:
        data = bytes(self._translated(lambda: self._bus.read_i2c_block_data(self.address, register, length)))
        if len(data) != length:
            self._count("short_reads")
            raise DeviceError(f"short read, {len(data)} of {length} bytes")
        return data

    def _retried(self, attempt: Callable[[], T]) -> T:
        for left in range(self._retries, -1, -1):
            try:
                return attempt()
            except DeviceError:
                if not left:
                    raise
        raise AssertionError("unreachable")

    def _translated(self, transfer: Callable[[], T]) -> T:
        try:
            return transfer()
        except OSError as error:
            if error.errno in BUS_ERRNOS or isinstance(error, ConnectionError):
                raise BusGone(error.strerror or str(error)) from error
            self._count("bus_errors")
            kind = NoSuchDevice if error.errno == errno.ENODEV else DeviceError
            where = f": nothing answers at 0x{self.address:02x}" if error.errno in UNANSWERED else ""
            raise kind(f"{error.strerror or str(error) or 'no answer'}{where}") from error
        except (ValueError, IndexError) as error:  # a bus that hands out less than a byte
            self._count("bus_errors")
            raise DeviceError("no usable answer") from error
