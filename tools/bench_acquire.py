"""What a CAN frame costs from the bus to a decoded reading, beside what python-can and cantools take for it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import socket
import struct
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import cantools
import numpy as np
from bench_row import Row

from edge_daemon.acquire.can_bus import CanBus
from edge_daemon.acquire.can_decode import by_key, dbc_layouts
from edge_daemon.acquire.can_inbox import Inbox
from edge_daemon.acquire.can_readers import SlcanReader, SocketReader
from edge_daemon.acquire.source import Tally
from edge_daemon.clock import Clock
from edge_daemon.config.settings import CanSource, CanStamp
from edge_daemon.recordings.recording import read_recording, write_recording

US_LIMIT = 5.0
"""most that a frame may take here, a tenth of a core of a computer ten times slower at 2000 frames a second"""
LIVE_LIMIT = 10.0
"""most of a core, in per cent, at 3000 frames a second, all wake-ups counted"""
RECORDING_LIMIT_MS = 100.0
DBC = Path(__file__).parent.parent / "tests" / "acquire" / "drive.dbc"
TICK_S = 1e-8
"""the batches below come faster than a device's; a faster tick keeps its counter behind the clock"""
BATCH = 30
"""frames that gather in 10 ms at three frames a millisecond"""
BATCHES = 300
LIVE_S = 3.0
PACED_WRITER = """
import os, struct, sys, time
port, seconds = int(sys.argv[1]), float(sys.argv[2])
began = time.monotonic()
for i in range(int(seconds * 1000)):
    data = struct.pack("<iI", i, 1000 * i).hex().upper().encode()
    os.write(port, b"t1008%s\\rt1018%s\\rt1026%s\\r" % (data, data, data[:12]))
    wait = began + i / 1000 - time.monotonic()
    if wait > 0:
        time.sleep(wait)
"""


def rows() -> list[Row]:
    """Costs per frame, live share of a core, and reading a recording."""
    beside = f"python-can and cantools {python_can_us():.0f} us"
    return [
        Row(f"serial adapter, {BATCH} frames a batch", slcan_us(), "us/frame", US_LIMIT, peer=beside),
        Row(f"raw socket, {BATCH} frames a batch", socket_us(), "us/frame", 2 * US_LIMIT),
        Row("virtual bus, receiving thread and loop", virtual_us(), "us/frame", 4 * US_LIMIT),
        Row("serial adapter at 3000 frames/s", live_slcan_percent(), "% of a core", LIVE_LIMIT),
        Row("recording of 30 000 x 10, CSV", recording_ms(".csv"), "ms", RECORDING_LIMIT_MS),
        Row("recording of 30 000 x 10, Parquet", recording_ms(".parquet"), "ms", RECORDING_LIMIT_MS),
    ]


def stamps(tick_s: float = TICK_S) -> tuple[CanStamp, ...]:
    """Both encoders latched on one counter."""
    return tuple(
        CanStamp(message=name, signal="LatchTime", seconds_per_count=tick_s) for name in ("EncoderIn", "EncoderOut")
    )


def inbox() -> Inbox:
    return Inbox("can", by_key(dbc_layouts(DBC)), stamps(), Tally("can"))


def payloads(i: int) -> list[tuple[int, bytes]]:
    latched = struct.pack("<iI", i, 1000 * i)
    return [(0x100, latched), (0x101, latched), (0x102, latched[:6])]


def us_per_frame(feed: Callable[[int], None], work: Callable[[], object], frames: int) -> float:
    """Median over batches of the time in `work`, per frame."""
    costs = []
    for i in range(BATCHES):
        feed(i)
        began = time.perf_counter()
        work()
        costs.append((time.perf_counter() - began) / frames)
    return 1e6 * float(np.median(costs))


def slcan_lines(batch: int) -> bytes:
    rows = [row for i in range(BATCH // 3) for row in payloads(batch * BATCH + i)]
    return b"".join(b"t%03X%d%s\r" % (key, len(data), data.hex().upper().encode()) for key, data in rows)


def _ignore(_: object) -> None:
    pass


def slcan_us() -> float:
    box = inbox()
    read, write = os.pipe()
    reader = SlcanReader(read, box)

    def work() -> None:
        reader.drain(box, 256)
        list(box.flush(0.0))

    try:
        return us_per_frame(lambda i: _ignore(os.write(write, slcan_lines(i))), work, BATCH)
    finally:
        os.close(read)
        os.close(write)


def socket_us() -> float:
    box = inbox()
    with socket.socket(type=socket.SOCK_DGRAM) as receiver, socket.socket(type=socket.SOCK_DGRAM) as sender:
        receiver.bind(("127.0.0.1", 0))
        sender.connect(receiver.getsockname())
        reader = SocketReader(receiver, 1 << 20, Tally("can"))

        def feed(batch: int) -> None:
            for i in range(BATCH // 3):
                for key, data in payloads(batch * BATCH + i):
                    sender.send(struct.pack("=IBB2x8s", key, len(data), 0, data))

        def work() -> None:
            reader.drain(box, 256)
            list(box.flush(0.0))

        return us_per_frame(feed, work, BATCH)


def python_can_us() -> float:
    """The same lines through python-can's own reader and cantools."""
    database = cantools.database.load_file(DBC)
    master, slave = pty.openpty()
    tty.setraw(slave)
    with can.Bus(os.ttyname(slave), interface="slcan", sleep_after_open=0.0) as bus:

        def work() -> None:
            for _ in range(BATCH):
                message = bus.recv(1.0)
                assert message is not None
                database.decode_message(message.arbitration_id, message.data, decode_choices=False)

        found = us_per_frame(lambda i: _ignore(os.write(master, slcan_lines(i))), work, BATCH)
        os.set_blocking(master, False)
        with contextlib.suppress(OSError):
            os.read(master, 65_536)
    os.close(master)
    os.close(slave)
    return found


async def _opened(source: CanBus) -> None:
    while source.health().counters.get("opened", 0) == 0:  # noqa: ASYNC110
        await asyncio.sleep(0.01)


async def _live(settings: CanSource, during: Callable[[], contextlib.AbstractContextManager[object]]) -> float:
    """Share of a core that this process takes while frames come."""
    source = CanBus(settings, DBC.parent)
    task = asyncio.create_task(source.run(lambda _: None, Clock()))
    await _opened(source)
    with during():
        await asyncio.sleep(0.3)
        cpu_s, frames, began = time.process_time(), source.health().counters["frames"], time.perf_counter()
        await asyncio.sleep(LIVE_S - 1.0)
        cpu_s, took_s = time.process_time() - cpu_s, time.perf_counter() - began
        rate = (source.health().counters["frames"] - frames) / took_s
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
    assert rate > 2000, f"only {rate:.0f} frames a second came"
    return 100 * cpu_s / took_s * 3000 / rate


def live_slcan_percent() -> float:
    """Three frames a millisecond through a pseudo terminal, written by another process."""
    master, slave = pty.openpty()
    tty.setraw(slave)

    @contextlib.contextmanager
    def writer() -> Iterator[object]:
        command = [sys.executable, "-c", PACED_WRITER, str(master), str(LIVE_S)]
        with subprocess.Popen(command, pass_fds=[master]) as child:
            yield child
            child.kill()

    settings = CanSource(name="can", interface="slcan", channel=os.ttyname(slave), dbc=DBC.name, stamps=stamps(1e-6))
    try:
        return asyncio.run(_live(settings, writer))
    finally:
        os.close(master)
        os.close(slave)


def virtual_us() -> float:
    """From the sending end of python-can's virtual bus, sending not counted: a receiving thread and the loop."""
    settings = CanSource(name="can", interface="virtual", channel="bench", dbc=DBC.name, stamps=stamps())
    frames = 6000

    async def measure() -> float:
        source = CanBus(settings, DBC.parent)
        with can.Bus("bench", interface="virtual") as device:
            task = asyncio.create_task(source.run(lambda _: None, Clock()))
            await _opened(source)
            for i in range(frames // 3):
                for key, data in payloads(i):
                    device.send(can.Message(arbitration_id=key, data=data, is_extended_id=False))
            cpu_s = time.process_time()
            while source.health().counters.get("frames", 0) < frames:  # noqa: ASYNC110
                await asyncio.sleep(0.001)
            cpu_s = time.process_time() - cpu_s
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
        return 1e6 * cpu_s / frames

    return asyncio.run(measure())


def recording_ms(suffix: str) -> float:
    """30 000 rows of ten columns."""
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"r{suffix}"
        write_recording(file, np.arange(30_000) / 1000, {f"c{i}": rng.normal(size=30_000) for i in range(10)})
        read_recording(file)
        began = time.perf_counter()
        read_recording(file)
        return 1e3 * (time.perf_counter() - began)
