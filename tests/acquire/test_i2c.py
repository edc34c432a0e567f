"""I2C devices behind a bus that misbehaves on demand."""

from __future__ import annotations

import asyncio
import errno
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from heard import DEADLINE_S, Heard, eventually, opened, running

from edge_daemon.acquire.drivers import open_source
from edge_daemon.acquire.i2c_presets import bmp280_fine, bmp280_pressure_Pa
from edge_daemon.acquire.i2c_transfer import Registers, crc8_sensirion, smbus_pec
from edge_daemon.acquire.source import SourceLost
from edge_daemon.clock import Clock
from edge_daemon.config.settings import I2cBurst, I2cDevice, I2cRegister, I2cSource, SettingsError
from edge_daemon.records import Burst

EXAMPLE = (27504, 26435, -1000, 36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000)
"""calibration words of the worked example in the BMP280 datasheet, section 3.12"""
EXAMPLE_TEMPERATURE, EXAMPLE_PRESSURE = 519_888, 415_148
"""raw values there; the result is 25.08 degC and 100653.27 Pa"""
FAST_S = 0.002


@dataclass
class FakeBus:
    """256 registers per address; `trouble`, if set, may raise or spoil each read."""

    memory: dict[int, bytearray] = field(default_factory=dict)
    trouble: Callable[[int, int, list[int]], list[int]] | None = None
    written: list[tuple[int, int, int]] = field(default_factory=list)
    closed: int = 0

    def device(self, address: int) -> bytearray:
        return self.memory.setdefault(address, bytearray(256))

    def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
        if address not in self.memory:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        data = list(self.memory[address][register : register + length])
        return self.trouble(address, register, data) if self.trouble else data

    def write_byte_data(self, address: int, register: int, value: int, /) -> None:
        if address not in self.memory:
            raise OSError(errno.ENXIO, "No such device or address")
        self.written.append((address, register, value))
        self.memory[address][register] = value

    def write_i2c_block_data(self, address: int, register: int, data: list[int], /) -> None:
        for i, value in enumerate(data):
            self.write_byte_data(address, register + i, value)

    def close(self) -> None:
        self.closed += 1


def bmp280(memory: bytearray) -> None:
    memory[0xD0] = 0x58
    memory[0x88 : 0x88 + 24] = struct.pack("<HhhHhhhhhhhh", *EXAMPLE)
    memory[0xF7:0xFA] = (EXAMPLE_PRESSURE << 4).to_bytes(3, "big")
    memory[0xFA:0xFD] = (EXAMPLE_TEMPERATURE << 4).to_bytes(3, "big")


def source_of(bus: FakeBus, *devices: I2cDevice) -> object:
    return open_source(I2cSource(name="i2c", bus="sim:test", devices=devices), Path(), lambda name: bus)


def part(**more: object) -> I2cDevice:
    return I2cDevice(**{"name": "part", "address": 0x20, "period_s": FAST_S, **more})  # type: ignore[arg-type]


def test_the_worked_example_of_the_datasheet() -> None:
    fine = bmp280_fine(EXAMPLE_TEMPERATURE, EXAMPLE)
    assert fine / 5120 == pytest.approx(25.08, abs=0.005)
    assert bmp280_pressure_Pa(EXAMPLE_PRESSURE, fine, EXAMPLE) == pytest.approx(100_653.27, abs=0.2)


def test_checksums_of_the_datasheets() -> None:
    assert crc8_sensirion([0xBE, 0xEF]) == 0x92  # example in every Sensirion datasheet with this checksum
    assert smbus_pec(0x5A, 0x07, [0x2F, 0x3A]) == _crc_bitwise([0xB4, 0x07, 0xB5, 0x2F, 0x3A])


def _crc_bitwise(data: list[int]) -> int:
    """The same polynomial by long division of one big number, an independent way."""
    number = int.from_bytes(bytes(data), "big") << 8
    for bit in range(number.bit_length() - 1, 7, -1):
        if number >> bit & 1:
            number ^= 0x107 << (bit - 8)
    return number


async def test_both_presets_give_pressure_and_temperature() -> None:
    bus = FakeBus()
    bmp280(bus.device(0x76))
    st = bus.device(0x5C)
    st[0x0F] = 0xB1
    st[0x28:0x2D] = (1013 * 4096).to_bytes(3, "little") + struct.pack("<h", -512)
    source = source_of(
        bus,
        I2cDevice(name="bosch", address=0x76, preset="bmp280", period_s=FAST_S),
        I2cDevice(name="st", address=0x5C, preset="lps22hb", period_s=FAST_S),
    )
    heard = Heard()
    async with running(source, heard):
        await heard.until(lambda: heard.size("bosch.pressure") > 2 and heard.size("st.temperature") > 2)
    assert heard.of("bosch.pressure")[1][-1] == pytest.approx(100_653.27, abs=0.2)
    assert heard.of("bosch.temperature")[1][-1] == pytest.approx(25.08, abs=0.005)
    assert heard.of("st.pressure")[1][-1] == pytest.approx(101_300)
    assert heard.of("st.temperature")[1][-1] == -5.12
    assert np.all(np.diff(heard.of("st.pressure")[0]) > 0)
    assert (0x76, 0xF4, 0x57) in bus.written
    assert (0x5C, 0x10, 0x22) in bus.written
    assert bus.closed == 1


async def test_a_tmp117_reads_below_zero_and_not_before_it_measured() -> None:
    """-25 degC is 0xF380 in the data sheet's table of 16-bit temperatures; 0x8000 is no temperature yet."""
    bus = FakeBus()
    part = bus.device(0x48)
    part[0x0F:0x11], part[0x00:0x02] = b"\x01\x17", b"\x80\x00"
    heard = Heard()
    async with running(source_of(bus, I2cDevice(name="ti", address=0x48, preset="tmp117", period_s=FAST_S)), heard):
        await heard.until(lambda: heard.size("ti.temperature") > 0)
        part[0x00:0x02] = b"\xf3\x80"
        await heard.until(lambda: heard.of("ti.temperature")[1][-1] == -25.0)
    assert np.isnan(heard.of("ti.temperature")[1][0])


@pytest.mark.parametrize(("word", "truth"), [(0xC194, 25.25), (0x1FF0, -1.0), (0xDE67, -25.5625)])
async def test_an_mcp9808_reads_beside_its_flags_and_below_zero(word: int, truth: float) -> None:
    """Equation 5-1 of the data sheet: upper byte times 16 and lower over 16, less 256 below zero."""
    bus = FakeBus()
    part = bus.device(0x18)
    part[0x05:0x07], part[0x07:0x09] = word.to_bytes(2, "big"), b"\x04\x00"
    heard = Heard()
    source = source_of(bus, I2cDevice(name="housing", address=0x18, preset="mcp9808", period_s=FAST_S))
    async with running(source, heard):
        await heard.until(lambda: heard.size("housing.temperature") > 0)
    upper, lower = divmod(word & 0x1FFF, 256)
    said = (upper & 0x0F) * 16 + lower / 16 - (256 if upper & 0x10 else 0)
    assert heard.of("housing.temperature")[1][-1] == said == truth


@pytest.mark.parametrize(
    ("kind", "order", "raw", "expected"),
    [
        ("u8", "big", b"\xfe", 254),
        ("i8", "big", b"\xfe", -2),
        ("i16", "big", b"\xff\x38", -200),
        ("u16", "little", b"\x38\xff", 0xFF38),
        ("i24", "little", b"\x01\x00\x80", -(2**23) + 1),
        ("u32", "big", b"\x80\x00\x00\x01", 2**31 + 1),
        ("f32", "little", struct.pack("<f", -1.5), -1.5),
    ],
)
def test_registers_of_any_width_and_order(kind: str, order: str, raw: bytes, expected: float) -> None:
    from edge_daemon.acquire.i2c_device import RegisterDevice

    bus = FakeBus()
    bus.device(0x20)[7 : 7 + len(raw)] = raw
    row = I2cRegister(signal="x", register=7, type=kind, byte_order=order, scale=2.0, offset=1.0)  # type: ignore[arg-type]
    _, found = RegisterDevice(part(registers=(row,)), Registers(bus, 0x20, 0, lambda _: None)).read()
    assert found == {"x": 2 * expected + 1}


async def test_checksums_are_verified_and_wrong_ones_become_nan() -> None:
    bus = FakeBus()
    memory = bus.device(0x20)
    memory[0:6] = bytes([0xBE, 0xEF, 0x92, 0xBE, 0xEF, 0x92])
    memory[0x10:0x13] = bytes([1, 2, smbus_pec(0x20, 0x10, [1, 2])])
    memory[0x20:0x23] = bytes([1, 2, 0x77])
    device = part(
        registers=(
            I2cRegister(signal="words", register=0, type="u32", crc="crc8_sensirion"),
            I2cRegister(signal="pec", register=0x10, type="u16", crc="smbus_pec"),
            I2cRegister(signal="wrong", register=0x20, type="u16", crc="smbus_pec"),
        )
    )
    heard, source = Heard(), source_of(bus, device)
    async with running(source, heard):
        await heard.until(lambda: heard.size("part.wrong") > 0)
    assert heard.of("part.words")[1][0] == 0xBEEFBEEF
    assert heard.of("part.pec")[1][0] == 0x0102
    assert math.isnan(heard.of("part.wrong")[1][0])
    assert source.health().counters["crc_errors"] >= 3  # the read and its two retries


async def test_a_dead_device_gives_nan_and_harms_no_other() -> None:
    bus = FakeBus()
    bus.device(0x20)[0:2] = b"\x00\x07"
    row = I2cRegister(signal="x", register=0)
    dead = I2cDevice(name="dead", address=0x30, registers=(row,), period_s=FAST_S)
    heard, source = Heard(), source_of(bus, dead, part(registers=(row,)))
    async with running(source, heard):
        await heard.until(lambda: heard.size("dead.x") > 3 and heard.size("part.x") > 3)
        health = source.health()
        assert health.state == "degraded"
        assert health.reason == "dead: Remote I/O error: nothing answers at 0x30"
        bus.device(0x30)[0:2] = b"\x00\x09"
        await heard.until(lambda: heard.of("dead.x")[1][-1] == 9)
        assert source.health().state == "ok"
    assert np.all(np.isnan(heard.of("dead.x")[1][:3]))
    np.testing.assert_array_equal(heard.of("part.x")[1], 7)
    assert health.counters["bus_errors"] >= 9


async def test_short_reads_are_retried_then_nan() -> None:
    bus = FakeBus()
    bus.device(0x20)[0:2] = b"\x00\x07"
    calls = 0

    def short(_address: int, _register: int, data: list[int]) -> list[int]:
        nonlocal calls
        calls += 1
        return data if calls % 4 == 0 else data[:1]

    bus.trouble = short
    heard = Heard()
    source = source_of(bus, part(registers=(I2cRegister(signal="x", register=0),), retries=1))
    async with running(source, heard):
        await heard.until(lambda: heard.size("part.x") >= 4)
    value = heard.of("part.x")[1]
    assert math.isnan(value[0]) and value[1] == 7  # the fourth transfer is the second reading's retry
    assert source.health().counters["short_reads"] >= 3


def test_the_echo_of_another_register_is_read_again() -> None:
    bus, counted = FakeBus(), []
    memory = bus.device(0x20)
    memory[0:2], memory[2:4] = b"\x11\x22", b"\x33\x44"
    previous: list[int] = []

    def echo(_address: int, register: int, data: list[int]) -> list[int]:
        """After clock stretching the first read of register 2 gives what the transfer before gave."""
        nonlocal previous
        answer = previous if register == 2 and previous == [0x11, 0x22] else data
        previous = data
        return answer

    bus.trouble = echo
    registers = Registers(bus, 0x20, 0, counted.append)
    assert registers.read(0, 2) == b"\x11\x22"
    assert registers.read(2, 2) == b"\x33\x44"
    assert counted == ["echoes"]
    memory[2:4] = b"\x11\x22"  # truly equal: no harm, no count
    assert registers.read(0, 2) == registers.read(2, 2)
    assert counted == ["echoes"]


async def test_a_part_that_loses_power_is_set_up_again() -> None:
    bus = FakeBus()
    bmp280(bus.device(0x76))
    heard = Heard()
    source = source_of(bus, I2cDevice(name="p", address=0x76, preset="bmp280", period_s=FAST_S, retries=0))
    async with running(source, heard):
        await heard.until(lambda: heard.size("p.pressure") > 2)
        memory = bus.memory.pop(0x76)
        await heard.until(lambda: bool(np.isnan(heard.of("p.pressure")[1][-1])))
        bus.written.clear()
        bus.memory[0x76] = memory
        await heard.until(lambda: bool(np.isfinite(heard.of("p.pressure")[1][-1])))
    assert (0x76, 0xF4, 0x57) in bus.written


async def test_a_wrong_part_is_named() -> None:
    bus = FakeBus()
    bus.device(0x76)[0xD0] = 0x60
    heard = Heard()
    source = source_of(bus, I2cDevice(name="p", address=0x76, preset="bmp280", period_s=FAST_S))
    async with running(source, heard):
        await heard.until(lambda: heard.size("p.pressure") > 0)
        assert "p: is no BMP280: its identity is 0x60, expected 0x58" in source.health().reason


class BurstBus(FakeBus):
    """An acoustic sensor: control 0, status 1, data 2; ready at the third look."""

    def __init__(self, samples: np.ndarray, looks: int = 3) -> None:
        super().__init__()
        self.device(0x40)
        self._samples = samples.astype("<i2").tobytes()
        self._looks = looks
        self._left = looks
        self._data = b""

    def write_byte_data(self, address: int, register: int, value: int, /) -> None:
        super().write_byte_data(address, register, value)
        if (address, register, value) == (0x40, 0, 1):
            self._left, self._data = self._looks, self._samples

    def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
        if address != 0x40:
            return super().read_i2c_block_data(address, register, length)
        if register == 1:
            self._left -= 1
            return [1 if self._left <= 0 else 0]
        data, self._data = self._data[:length], self._data[length:]
        return list(data)


def burst(samples: int, chunk_bytes: int = 32) -> I2cDevice:
    settings = I2cBurst(
        control_register=0,
        status_register=1,
        data_register=2,
        samples=samples,
        rate_hz=1e6,
        scale=0.5,
        every_s=FAST_S,
        chunk_bytes=chunk_bytes,
    )
    return I2cDevice(name="mic", address=0x40, burst=settings)


async def test_a_burst_is_captured_and_read_out_in_chunks() -> None:
    samples = np.random.default_rng(3).integers(-32_768, 32_767, 1000)
    heard, source = Heard(), source_of(BurstBus(samples), burst(1000, chunk_bytes=28))
    before_s = Clock().time_s()
    async with running(source, heard):
        await heard.until(lambda: len(heard.records) >= 2)
    for record in heard.records:
        assert isinstance(record, Burst)
        assert (record.source, record.signal, record.rate_hz) == ("i2c", "mic.sound", 1e6)
        np.testing.assert_array_equal(record.value, samples * 0.5)
        assert before_s < record.time_s < Clock().time_s()


async def test_a_capture_that_never_ends_is_given_up() -> None:
    heard, source = Heard(), source_of(BurstBus(np.zeros(16), looks=10**9), burst(16))
    async with running(source, heard):
        await eventually(lambda: "does not end" in source.health().reason)
    assert not heard.records


async def test_a_bus_that_vanishes_is_lost_and_closed() -> None:
    bus = FakeBus()
    bus.device(0x20)
    source = source_of(bus, part(registers=(I2cRegister(signal="x", register=0),)))
    async with running(source, Heard()) as task:
        await opened(source)

        def gone(_address: int, _register: int, _data: list[int]) -> list[int]:
            raise OSError(errno.ENODEV, "No such device")

        bus.trouble = gone
        with pytest.raises(SourceLost, match="i2c: bus sim:test: No such device"):
            await asyncio.wait_for(task, DEADLINE_S)
    assert bus.closed == 1
    assert source.health().state == "down"


async def test_a_part_that_is_not_there_takes_no_other_with_it() -> None:
    """As the kernel's i2c-stub answers for an address without a part, on a real bus device."""
    bus, heard = FakeBus(), Heard()
    for address in (0x20, 0x50):
        bus.device(address)

    def absent(address: int, _register: int, data: list[int]) -> list[int]:
        if address == 0x50:
            raise OSError(errno.ENODEV, "No such device")
        return data

    bus.trouble = absent
    rows = (I2cRegister(signal="x", register=0),)
    parts = (part(registers=rows), part(registers=rows, name="absent", address=0x50))
    source = source_of(bus, *parts)
    async with running(source, heard) as task:
        await heard.until(lambda: heard.size("part.x") > 5)
        await eventually(lambda: source.health().reason == "absent: No such device: nothing answers at 0x50")
        assert source.health().state == "degraded" and not task.done()


async def test_a_bus_that_does_not_exist_is_one_clear_line() -> None:
    settings = I2cSource(name="i2c", bus=97, devices=(part(registers=(I2cRegister(signal="x", register=0),)),))
    with pytest.raises(SourceLost, match="i2c: cannot open bus 97: No such file or directory"):
        await asyncio.wait_for(open_source(settings, Path()).run(Heard(), Clock()), DEADLINE_S)


@pytest.mark.parametrize(
    ("device", "expected"),
    [
        ({"preset": "bmp999"}, "part: preset: 'bmp999' is unknown: expected one of"),
        ({}, "part: nothing to read"),
        ({"preset": "bmp280", "registers": (I2cRegister(signal="x", register=0),)}, "expected one or the other"),
        ({"registers": (I2cRegister(signal="x", register=0, type="u8", crc="crc8_sensirion"),)}, "two bytes"),
        ({"registers": (I2cRegister(signal="x", register=0), I2cRegister(signal="x", register=2))}, "appears twice"),
    ],
)
def test_settings_that_do_not_fit_are_refused(device: dict[str, object], expected: str) -> None:
    with pytest.raises(SettingsError, match=expected):
        source_of(FakeBus(), part(**device))


def test_a_simulated_bus_needs_its_opener() -> None:
    settings = I2cSource(name="i2c", bus="sim:x", devices=(part(preset="bmp280"),))
    with pytest.raises(SettingsError, match="'sim:x' is simulated"):
        open_source(settings, Path())
