"""The chain of one drive, from frames on a bus to its newest state; a log of the same frames says the same."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import can
import msgspec
import numpy as np
import pytest

from edge_daemon.acquire.drivers import open_source
from edge_daemon.acquire.source import Source
from edge_daemon.clock import Clock
from edge_daemon.config.reading import load
from edge_daemon.config.settings import CanSource, CanStamp, Drive, FileSource, SourceSettings
from edge_daemon.records import Block, Estimate, Readings, Status
from edge_daemon.rig.can_face import DBC_FILE
from edge_daemon.rig.can_log import write_log
from edge_daemon.rig.live import live_drive
from edge_daemon.service.pipeline import Pipeline, open_pipeline

CONFIG = Path(__file__).parents[2] / "config"
SECONDS = 9.0
NEAR_S = 2e-6
"""of the instants of two receivers: their stamps are rounded to microseconds"""
"""the live side plays at its own pace: the device's clock must run beside the gateway's"""
QUIET_TURNS = 40
"""of 5 ms without a new reading: the source has said all it had"""
STAMPS = tuple(CanStamp(message=name, signal="Latch") for name in ("EncoderIn1", "EncoderOut1"))
NAMES = ("stiffness", "damping", "kinematic_error", "ratio", "torque_rms", "torque_peak", "model_nrmse")


def drive() -> Drive:
    """That of the demonstration, in a hurry: what is told within seconds of a cold start hangs on every sample."""
    row = load(CONFIG / "demo.toml").drive[0]
    return msgspec.structs.replace(row, estimation=msgspec.structs.replace(row.estimation, warm_up_s=1.0))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A candump log of the demonstration's drive."""
    file = tmp_path_factory.mktemp("log") / "drive.log"
    write_log(file, {1: live_drive(seed=3)}, SECONDS, start_s=time.time() - SECONDS, latch_start_us=5_000_000)
    return file


class Told(NamedTuple):
    blocks: list[Block]
    estimates: dict[str, Estimate]


def are_alike(one: Told, other: Told) -> bool:
    """Whether both saw the same samples at the same instants. While the device's clock is still being learned, a
    receiver that lags, as on a busy machine, begins with others."""
    pairs = list(zip(one.blocks, other.blocks, strict=False))
    times = all(abs(a.start_s - b.start_s) < NEAR_S for a, b in pairs)
    return times and all(np.array_equal(a.flaws[name], b.flaws[name]) for a, b in pairs for name in a.flaws)


async def estimates(source: Source, pipeline: Pipeline, feed: Callable[[], bool]) -> Told:
    """What the pipeline made and says at the end. `feed` gives the source more and tells whether there was any."""
    clock, blocks = Clock(), list[Block]()
    task = asyncio.create_task(source.run(pipeline.push, clock))
    async with asyncio.timeout(60):
        while source.health().counters.get("opened", 0) == 0:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
        read, quiet = 0, 0
        while feed() or quiet < QUIET_TURNS:
            before, read = read, source.health().counters.get("readings", 0)
            quiet = quiet + 1 if read == before else 0
            await asyncio.sleep(0.005)
            blocks += pipeline.step(clock.time_s(), ()).blocks
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task
    last = pipeline.step(clock.time_s() + 1.0, ())
    return Told([*blocks, *last.blocks], dict(last.snapshot.estimates))


async def of_source(settings: SourceSettings, feed: Callable[[], bool]) -> Told:
    return await estimates(open_source(settings, CONFIG), open_pipeline(drive(), CONFIG), feed)


@pytest.mark.slow
async def test_a_replayed_log_gives_the_estimates_that_the_live_bus_gave(log: Path) -> None:
    """The log is what a second receiver on the live bus wrote down."""
    sender = can.Bus(interface="virtual", channel="live-or-replay")
    listener = can.Bus(interface="virtual", channel="live-or-replay")
    heard = log.with_name("heard.log")
    frames = deque(can.LogReader(log))
    begin_s, first_s = time.monotonic(), frames[0].timestamp

    def feed() -> bool:
        while frames and frames[0].timestamp - first_s <= time.monotonic() - begin_s:
            message = frames.popleft()
            sender.send(can.Message(arbitration_id=message.arbitration_id, data=message.data, is_extended_id=False))
        return bool(frames)

    try:
        bus = CanSource(name="can0", interface="virtual", channel="live-or-replay", dbc=str(DBC_FILE), stamps=STAMPS)
        live = await of_source(bus, feed)
        with can.Logger(str(heard)) as logger:
            while message := listener.recv(0.0):
                logger(message)
    finally:
        sender.shutdown()
        listener.shutdown()
    played = FileSource(name="can0", file=str(heard), speed=0.0, dbc=str(DBC_FILE), stamps=STAMPS)
    replayed = await of_source(played, lambda: False)
    alike = are_alike(live, replayed)
    for name in NAMES:
        then, now = live.estimates[name], replayed.estimates[name]
        if alike:
            assert now.status is then.status
            near = max(1e-5 * abs(then.value), 1e-3 * then.sd)
            assert now.value == pytest.approx(then.value, rel=0, abs=near, nan_ok=True), name
            assert now.sd == pytest.approx(then.sd, rel=1e-3, nan_ok=True), name
        elif now.status is then.status is Status.VALID:
            assert abs(now.value - then.value) < 4 * then.sd, name


def test_a_stiffness_is_not_good_for_longer_than_its_encoders_are_heard() -> None:
    """A thermometer that goes on gives few blocks, and every one of them without motion."""
    pipeline, start_s = open_pipeline(drive(), CONFIG), 1000.0

    def tell(source: str, signal: str, at_s: float, values: list[float]) -> None:
        times_s = at_s + 1e-3 * np.arange(len(values))
        pipeline.push(Readings(source, signal, times_s, np.asarray(values)))

    def status_at(now_s: float) -> Status:
        return pipeline.step(now_s, ()).snapshot.estimates["stiffness"].status

    for i in range(20):
        time_s = start_s + 0.1 * i
        angle = np.sin(5.0 * (time_s + 1e-3 * np.arange(100))) / (2 * np.pi)
        tell("can0", "EncoderIn1.Position", time_s, list(np.round(131072 * 100 * angle)))
        tell("can0", "EncoderOut1.Position", time_s, list(np.round(16777216 * angle)))
        tell("housing1", "gear.temperature", time_s, [25.0])
        pipeline.step(time_s + 0.1, ())
    assert status_at(start_s + 2.0) is not Status.INVALID
    for i in range(40):
        if i % 10 == 0:
            tell("housing1", "gear.temperature", start_s + 2.0 + 0.1 * i, [25.0])
        pipeline.step(start_s + 2.1 + 0.1 * i, ())
    assert status_at(start_s + 6.5) is Status.INVALID
