"""CAN over a serial adapter, end to end on a pseudo terminal; what goes wrong."""

from __future__ import annotations

import asyncio
import os
import pty
import struct
import tty
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from heard import Heard, eventually, opened, running, slcan

from edge_daemon.acquire.drivers import open_source
from edge_daemon.acquire.source import SourceLost
from edge_daemon.clock import Clock
from edge_daemon.config.settings import CanSource, CanStamp

HERE = Path(__file__).parent
STAMPS = tuple(CanStamp(message=name, signal="LatchTime") for name in ("EncoderIn", "EncoderOut"))


@pytest.fixture
def port() -> Iterator[tuple[int, str]]:
    """Master end and name of a pseudo terminal."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    try:
        yield master, os.ttyname(slave)
    finally:
        os.close(slave)
        with suppress(OSError):  # a test may have closed it
            os.close(master)


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def test_a_serial_adapter_gives_latched_encoders_identical_times(port: tuple[int, str]) -> None:
    master, name = port
    settings = CanSource(name="can", interface="slcan", channel=name, dbc="drive.dbc", stamps=STAMPS, bitrate=1_000_000)
    heard, source = Heard(), open_source(settings, HERE)
    async with running(source, heard):
        await opened(source)
        said = b""
        while b"S8\r" not in said:  # the adapter is told the bit rate, maybe not in the first piece of what it is told
            said += os.read(master, 1000)
        for i in range(300):
            latch = struct.pack("<I", (2**32 - 150_000 + 1000 * i) % 2**32)  # rolls over on the way
            os.write(master, slcan(0x100, struct.pack("<i", 100 * i) + latch))
            await asyncio.sleep(0.001)  # a device's pace; the two frames may be read apart
            os.write(master, slcan(0x101, struct.pack("<i", -i) + latch))
        await heard.until(
            lambda: heard.latest("EncoderIn.Count") == 29_900 and heard.latest("EncoderOut.Count") == -299
        )
    time_in_s, value_in = (part[-200:] for part in heard.of("EncoderIn.Count"))
    time_out_s, value_out = (part[-200:] for part in heard.of("EncoderOut.Count"))
    np.testing.assert_array_equal(time_in_s, time_out_s)
    np.testing.assert_array_equal(value_in, -100 * value_out)
    np.testing.assert_allclose(np.diff(time_in_s), 1e-3, atol=1e-6)
    counters = source.health().counters
    assert counters["clock_jumps"] == 0
    assert counters["settling"] < 150


async def test_noise_on_the_serial_line_is_counted(port: tuple[int, str]) -> None:
    master, name = port
    settings = CanSource(name="can", interface="slcan", channel=name, dbc="drive.dbc")
    heard, source = Heard(), open_source(settings, HERE)
    good = slcan(0x102, struct.pack("<hhBB", 100, 0, 0, 0))
    bad = (
        good[:9] + b"\r",  # cut short
        good[:-2] + b"X\r",  # not hexadecimal
        b"\xff\xfe\x00#\r",
        slcan(0x100, b"1234"),  # shorter than the database says
        slcan(0x7AB, b"1234"),
        b"t1028\r",
        b"\a",
        b"z\rZ\rr1000\r",
        b"Y" * 5000 + b"\r",
    )
    async with running(source, heard):
        await opened(source)
        for line in bad:
            os.write(master, line + good[:7])
            await asyncio.sleep(0)
            os.write(master, good[7:])
        await heard.until(lambda: heard.size("DriveState.Current") == len(bad))
        counters = source.health().counters
    assert (counters["truncated"], counters["unknown_ids"]) == (1, 1)
    assert counters["malformed"] >= 5


async def test_a_serial_port_that_is_pulled_is_lost(port: tuple[int, str]) -> None:
    master, name = port
    source = open_source(CanSource(name="can", interface="slcan", channel=name, dbc="drive.dbc"), HERE)
    async with running(source, Heard()) as task:
        await opened(source)
        os.close(master)
        with pytest.raises(SourceLost, match="the serial port is"):
            await asyncio.wait_for(task, 5)
    assert source.health().state == "down"


async def test_an_adapter_that_is_plugged_in_again_is_heard_again(tmp_path: Path) -> None:
    link = tmp_path / "can0"
    source = open_source(CanSource(name="can", interface="slcan", channel=str(link), dbc="drive.dbc"), HERE)
    before = open_files()
    for i in range(1, 4):
        master, slave = pty.openpty()
        tty.setraw(slave)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(slave))
        heard = Heard()
        async with running(source, heard) as task:
            await eventually(lambda opens=i: source.health().counters.get("opened", 0) == opens)
            os.write(master, slcan(0x102, struct.pack("<hhBB", 100 * i, 0, 0, 0)))
            await heard.until(lambda heard=heard: heard.size("DriveState.Current") == 1)
            assert source.health().state == "ok"
            os.close(slave)
            os.close(master)
            with pytest.raises(SourceLost):
                await asyncio.wait_for(task, 5)
        assert heard.of("DriveState.Current")[1] == i
    assert source.health().counters["losses"] == 3
    assert open_files() == before  # nothing was left open


async def test_an_adapter_that_another_process_has_open_is_not_shared(port: tuple[int, str]) -> None:
    """The one that closes it would stop the bus for both, without a word to the other."""
    _, name = port
    settings = CanSource(name="can", interface="slcan", channel=name, dbc="drive.dbc")
    first, second = open_source(settings, HERE), open_source(settings, HERE)
    async with running(first, Heard()):
        await opened(first)
        with pytest.raises(SourceLost, match="another process has this adapter open"):
            await second.run(lambda record: None, Clock())
        assert first.health().state == "ok"


async def test_an_adapter_that_somebody_closed_is_opened_anew(port: tuple[int, str]) -> None:
    """It answers nothing any more, and neither hangs up nor fails."""
    master, name = port
    source = open_source(
        CanSource(name="can", interface="slcan", channel=name, dbc="drive.dbc", silent_after_s=0.2), HERE
    )
    with pytest.raises(SourceLost, match=r"no known frame for .* the adapter is opened anew"):
        await asyncio.wait_for(source.run(lambda record: None, Clock()), 20.0)
    assert source.health().state == "down"
    heard = Heard()
    async with running(source, heard):
        await opened(source)
        while not heard.records:
            os.write(master, slcan(0x102, struct.pack("<hhBB", 100, 0, 0, 0)))
            await asyncio.sleep(0.01)
