"""Modbus sensors: a real server in this process, raw sockets that answer badly, a serial line on a pseudo terminal."""

from __future__ import annotations

import asyncio
import os
import pty
import socket
import struct
import tty
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from heard import DEADLINE_S, Heard, eventually, opened, running
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from edge_daemon.acquire.drivers import open_source
from edge_daemon.acquire.source import Source, SourceLost
from edge_daemon.clock import Clock
from edge_daemon.config.settings import ModbusRead, ModbusSource, SettingsError
from edge_daemon.records import Bands, Burst

FAST_S = 0.005
SEED = 11


def words(fmt: str, *values: float) -> list[int]:
    """Registers, big-endian."""
    data = struct.pack(f">{fmt}", *values)
    return [int(word) for word in np.frombuffer(data, ">u2")]


def source_at(port: int, *reads: ModbusRead, timeout_s: float = 0.2) -> Source:
    settings = ModbusSource(name="sensor", port=port, device_id=3, timeout_s=timeout_s, reads=reads)
    return open_source(settings, Path())


def read(signal: str, address: int, kind: str = "u16", **more: object) -> ModbusRead:
    values = {"signal": signal, "address": address, "type": kind, "period_s": FAST_S, **more}
    return ModbusRead(**values)  # type: ignore[arg-type]


@asynccontextmanager
async def device(registers: list[int], refuse: Callable[[], bool] = lambda: False) -> AsyncIterator[int]:
    """A Modbus TCP device with number 3; yields its port."""

    async def action(*_request: object) -> ExcCodes | None:
        return ExcCodes.DEVICE_BUSY if refuse() else None

    data = [SimData(0, values=registers, datatype=DataType.REGISTERS)]
    server = ModbusTcpServer([SimDevice(3, data, action=action)], address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    try:
        yield server.transport.sockets[0].getsockname()[1]
    finally:
        await server.shutdown()


@asynccontextmanager
async def raw(answer: Callable[[bytes], Awaitable[bytes | None]]) -> AsyncIterator[int]:
    """A TCP server that answers each request as told; None hangs up. Yields its port."""
    writers: list[asyncio.StreamWriter] = []

    async def attend(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        with suppress(ConnectionError, asyncio.CancelledError):
            while request := await reader.read(300):
                reply = await answer(request)
                if reply is None:
                    break
                writer.write(reply)
        writer.close()

    server = await asyncio.start_server(attend, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for writer in writers:
            writer.close()


async def test_every_type_of_value() -> None:
    registers = [0] * 40
    registers[0:2] = [65_535, 40_000]
    registers[2:4] = words("I", 4_000_000_000)
    registers[4:6] = words("i", -5)[::-1]
    registers[6:8] = words("f", 20.25)
    registers[8:10] = words("f", -1.5)[::-1]
    reads = (
        read("u16", 1),
        read("i16", 0),
        read("u32", 2, "u32"),
        read("i32", 4, "i32", word_order="little"),
        read("f32", 6, "f32", table="holding", scale=2.0, offset=1.0),
        read("f32_little", 8, "f32", word_order="little"),
    )
    heard = Heard()
    async with device(registers) as port, running(source_at(port, *reads), heard):
        await heard.until(lambda: all(heard.size(r.signal) > 1 for r in reads))
    last = {r.signal: heard.of(r.signal)[1][-1] for r in reads}
    assert last == {"u16": 40_000, "i16": 65_535, "u32": 4e9, "i32": -5, "f32": 41.5, "f32_little": -1.5}
    assert np.all(np.diff(heard.of("u16")[0]) > 0)


async def test_words_in_the_other_order_are_told_and_not_measured() -> None:
    """21.3 degC is 0x41AA6666; with its words exchanged it is 2.7e+23."""
    heard, swapped = Heard(), words("f", 21.3)[::-1]
    async with device(swapped) as port:
        source = source_at(port, read("warm", 0, "f32"))
        async with running(source, heard):
            await heard.until(lambda: heard.size("warm") > 1)
            assert "in the other word_order 21.3" in source.health().reason
    assert np.isnan(heard.of("warm")[1]).all()


async def test_two_devices_on_one_line() -> None:
    data = {number: [SimData(0, values=[100 * number], datatype=DataType.REGISTERS)] for number in (3, 4)}
    server = ModbusTcpServer([SimDevice(number, row) for number, row in data.items()], address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    try:
        port = server.transport.sockets[0].getsockname()[1]
        heard = Heard()
        async with running(source_at(port, read("here", 0), read("there", 0, device_id=4)), heard):
            await heard.until(lambda: heard.size("here") > 1 and heard.size("there") > 1)
        assert set(heard.of("here")[1]) == {300.0} and set(heard.of("there")[1]) == {400.0}
    finally:
        await server.shutdown()


async def test_a_waveform_longer_than_one_read_and_band_levels() -> None:
    rng = np.random.default_rng(SEED)
    waveform = rng.integers(-32_768, 32_768, 400)
    bands = np.column_stack((np.geomspace(10, 10_000, 40), rng.uniform(0, 1, 40)))
    registers = words("400h", *waveform) + words("80f", *bands.ravel()) + words("2f", 1.0, 2.0)
    reads = (
        read("sound", 0, "waveform_i16", count=400, rate_hz=8000.0, scale=0.5),
        read("bands", 400, "bands_f32", count=40, averages=64.0),
        read("floats", 560, "waveform_f32", count=2, rate_hz=10.0),
    )
    heard = Heard()
    async with device(registers) as port, running(source_at(port, *reads), heard):
        await heard.until(lambda: {r.signal for r in heard.records} == {"sound", "bands", "floats"})
    burst = next(r for r in heard.records if r.signal == "sound")
    assert isinstance(burst, Burst) and burst.rate_hz == 8000
    np.testing.assert_array_equal(burst.value, waveform * 0.5)
    levels = next(r for r in heard.records if r.signal == "bands")
    assert isinstance(levels, Bands) and levels.averages == 64
    np.testing.assert_allclose(levels.frequency_hz, bands[:, 0], rtol=1e-6)
    np.testing.assert_allclose(levels.psd, bands[:, 1], rtol=1e-6)
    floats = next(r for r in heard.records if r.signal == "floats")
    assert isinstance(floats, Burst) and list(floats.value) == [1.0, 2.0]


async def test_a_queue_is_emptied() -> None:
    queue = list(range(-40, 60))
    asked = 0

    async def answer(request: bytes) -> bytes:
        nonlocal asked
        asked += 1
        transaction, _, _, unit, function, address = struct.unpack(">HHHBBH", request)
        assert (unit, function, address) == (3, 0x18, 77)
        part = [queue.pop(0) for _ in range(min(31, len(queue)))]
        body = struct.pack(">BBHH", unit, function, 2 * len(part) + 2, len(part)) + struct.pack(f">{len(part)}h", *part)
        return struct.pack(">HHH", transaction, 0, len(body)) + body

    heard = Heard()
    fifo = read("sound", 77, "fifo_i16", count=1000, rate_hz=1000.0)
    async with raw(answer) as port, running(source_at(port, fifo), heard):
        await heard.until(lambda: len(heard.records) == 1)
        await eventually(lambda: asked >= 6)
    [burst] = heard.records
    assert isinstance(burst, Burst)
    np.testing.assert_array_equal(burst.value, np.arange(-40, 60))


async def test_an_exception_gives_nan_and_the_next_good_answer_a_value() -> None:
    refusing = True
    source_heard = Heard()
    async with device([7], refuse=lambda: refusing) as port:
        source = source_at(port, read("x", 0))
        async with running(source, source_heard):
            await source_heard.until(lambda: source_heard.size("x") > 2)
            assert source.health().state == "degraded"
            assert "x: exception code 6: it is busy" in source.health().reason
            refusing = False
            await source_heard.until(lambda: source_heard.of("x")[1][-1] == 7)
            assert source.health().state == "ok"
    assert np.isnan(source_heard.of("x")[1][0])
    assert source.health().counters["refused"] >= 3


async def _garbage(request: bytes) -> bytes:
    return b"\xff\x00garbage" * 4


async def _silence(request: bytes) -> bytes:
    return b""


async def _wrong_device(request: bytes) -> bytes:
    return request[:4] + struct.pack(">HBBBH", 5, 9, 4, 2, 1)


async def _too_short(request: bytes) -> bytes:
    return request[:4] + struct.pack(">HBBB", 3, 3, 4, 0)


async def _broken_length(request: bytes) -> bytes:
    return request[:4] + struct.pack(">HBBBH", 65_535, 3, 4, 2, 1)


@pytest.mark.parametrize("answer", [_garbage, _silence, _wrong_device, _too_short, _broken_length])
async def test_bad_answers_become_nan_and_the_line_is_opened_anew(
    answer: Callable[[bytes], Awaitable[bytes | None]],
) -> None:
    heard = Heard()
    async with raw(answer) as port:
        source = source_at(port, read("x", 0), timeout_s=0.2)
        async with running(source, heard) as task:
            await eventually(lambda: source.health().counters.get("reopened", 0) >= 1 or task.done())
            assert not task.done()
            await heard.until(lambda: heard.size("x") >= 3)
            assert source.health().state == "degraded"
    assert np.all(np.isnan(heard.of("x")[1]))
    assert source.health().counters["no_answer"] >= 3


async def test_a_sensor_that_hangs_up_is_lost_and_comes_back_when_run_again() -> None:
    alive = True

    async def answer(request: bytes) -> bytes | None:
        return request[:4] + struct.pack(">HBBBH", 5, 3, 4, 2, 42) if alive else None

    heard = Heard()
    async with raw(answer) as port:
        source = source_at(port, read("x", 0))
        async with running(source, heard) as task:
            await heard.until(lambda: heard.size("x") > 1)
            alive = False
            with pytest.raises(SourceLost, match=f"sensor: 127.0.0.1:{port}: the connection"):
                await asyncio.wait_for(task, DEADLINE_S)
        assert source.health().state == "down"
        alive = True
        before = heard.size("x")
        async with running(source, heard):
            await heard.until(lambda: heard.size("x") > before + 1)
    assert heard.of("x")[1][-1] == 42


async def test_a_source_ends_although_the_library_lost_the_cancellation(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = asyncio.Event()

    async def deaf(*_: object) -> None:
        asked.set()
        with suppress(asyncio.CancelledError):
            await asyncio.Event().wait()

    monkeypatch.setattr("edge_daemon.acquire.modbus.ModbusSensor.read", deaf)
    async with device([0]) as port:
        task = asyncio.create_task(source_at(port, read("a", 0)).run(Heard(), Clock()))
        async with asyncio.timeout(DEADLINE_S):
            await asked.wait()
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task


async def test_a_sensor_that_is_not_there_is_one_clear_line() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        source = source_at(port, read("x", 0))
        with pytest.raises(SourceLost, match=f"sensor: 127.0.0.1:{port}: ") as caught:
            await asyncio.wait_for(source.run(Heard(), Clock()), DEADLINE_S)
    assert "\n" not in str(caught.value)


async def test_a_queue_that_is_not_cleared_is_read_once_also_on_a_serial_line() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    reply = struct.pack(">BBHH31h", 3, 0x18, 64, 31, *range(31))

    def answer() -> None:
        if os.read(master, 100)[:2] == b"\x03\x18":
            os.write(master, reply + crc16(reply))

    loop = asyncio.get_running_loop()
    loop.add_reader(master, answer)
    fifo = read("sound", 77, "fifo_i16", count=1000, rate_hz=1000.0)
    settings = ModbusSource(
        name="line", transport="rtu", serial=os.ttyname(slave), parity="N", device_id=3, timeout_s=0.2, reads=(fifo,)
    )
    heard = Heard()
    try:
        async with running(open_source(settings, Path()), heard):
            await heard.until(lambda: len(heard.records) >= 2)
    finally:
        loop.remove_reader(master)
        os.close(slave)
        os.close(master)
    for burst in heard.records:
        assert isinstance(burst, Burst)
        np.testing.assert_array_equal(burst.value, np.arange(31))


def crc16(data: bytes) -> bytes:
    """Modbus over serial line V1.02, section 6.2.2."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return struct.pack("<H", crc)


async def test_a_serial_line_survives_silence_and_is_lost_when_pulled() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    asked = 0

    def answer() -> None:
        nonlocal asked
        with suppress(OSError):
            request = os.read(master, 100)
            if request != b"\x03\x04\x00\x05\x00\x01" + crc16(b"\x03\x04\x00\x05\x00\x01"):
                return
            asked += 1
            if asked == 2:
                return  # silence once
            reply = b"\x03\x04\x02" + struct.pack(">h", -asked)
            os.write(master, reply + crc16(reply))

    loop = asyncio.get_running_loop()
    loop.add_reader(master, answer)
    settings = ModbusSource(
        name="line",
        transport="rtu",
        serial=os.ttyname(slave),
        parity="N",
        device_id=3,
        timeout_s=0.1,
        reads=(read("x", 5, "i16"),),
    )
    heard, source = Heard(), open_source(settings, Path())
    try:
        async with running(source, heard) as task:
            await opened(source)
            await heard.until(lambda: heard.size("x") >= 4)
            loop.remove_reader(master)
            os.close(slave)
            os.close(master)
            with pytest.raises(SourceLost, match="line: /dev/pts/"):
                await asyncio.wait_for(task, DEADLINE_S)
    finally:
        loop.remove_reader(master)
    np.testing.assert_array_equal(heard.of("x")[1][:4], [-1, np.nan, -3, -4])
    assert source.health().counters["reopened"] >= 1


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"reads": ()}, "reads: empty"),
        ({"reads": (read("s", 0, "waveform_i16"),)}, "s: rate_hz: missing"),
        ({"transport": "rtu"}, "serial: missing"),
    ],
)
def test_settings_that_do_not_fit_are_refused(change: dict[str, object], expected: str) -> None:
    settings = {"name": "m", "reads": (read("x", 0),), **change}
    with pytest.raises(SettingsError, match=expected):
        open_source(ModbusSource(**settings), Path())  # type: ignore[arg-type]
