"""Files played as if they came from a bus, compared with the bus they were recorded on."""

from __future__ import annotations

import asyncio
import struct
import uuid
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest
from heard import DEADLINE_S, Heard, eventually, opened, running

from edge_daemon.acquire.drivers import open_source, validate_source
from edge_daemon.acquire.source import SourceLost
from edge_daemon.clock import Clock
from edge_daemon.config.settings import CanSource, CanStamp, FileSource
from edge_daemon.errors import BadInput
from edge_daemon.recordings.recording import write_recording

HERE = Path(__file__).parent
SEED = 5
STAMPS = tuple(
    CanStamp(message=name, signal="LatchTime", seconds_per_count=1e-6) for name in ("EncoderIn", "EncoderOut")
)


def messages(n: int, begin_s: float, seed: int = SEED) -> Iterator[can.Message]:
    """Two latched encoders at 500 Hz, the drive's state now and then, a foreign frame, a short one."""
    rng = np.random.default_rng(seed)
    at_s = begin_s
    for i in range(n):
        latch = 2000 * i
        at_s = max(at_s, begin_s + latch * 1e-6 + rng.exponential(3e-4))
        payload = struct.pack("<iI", 50 * i, latch)
        for identifier, data in ((0x100, payload), (0x101, payload), (0x102, bytes(6) if i % 10 == 0 else b"")):
            if data:
                at_s += 1e-4
                yield can.Message(timestamp=round(at_s, 6), arbitration_id=identifier, data=data, is_extended_id=False)
    yield can.Message(timestamp=round(at_s, 6), arbitration_id=0x7FF, data=b"?", is_extended_id=False)
    yield can.Message(timestamp=round(at_s, 6), arbitration_id=0x102, data=b"?", is_extended_id=False)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
async def test_a_log_replayed_gives_the_readings_of_the_live_bus(tmp_path: Path, suffix: str) -> None:
    begin_s = 1.7e9
    sent = list(messages(1500, begin_s))
    with can.Logger(tmp_path / f"bus{suffix}") as log:
        for message in sent:
            log(message)
    channel = uuid.uuid4().hex
    live, source = (
        Heard(),
        open_source(CanSource(name="x", interface="virtual", channel=channel, dbc="drive.dbc", stamps=STAMPS), HERE),
    )
    with can.Bus(channel, interface="virtual", preserve_timestamps=True) as bus:
        async with running(source, live):
            await opened(source)
            for message in sent:
                bus.send(message)
            # every frame, not every torque: the encoders' last frames follow the last torque
            await eventually(lambda: source.health().counters.get("frames") == len(sent))
    settings = FileSource(name="x", file=str(tmp_path / f"bus{suffix}"), speed=0, dbc="drive.dbc", stamps=STAMPS)
    replayed, player = Heard(), open_source(settings, HERE)
    async with running(player, replayed):
        await eventually(lambda: player.health().reason == "finished")
    for signal in ("EncoderIn.Count", "EncoderOut.Count", "DriveState.Torque"):
        live_s, live_value = live.of(signal)
        replayed_s, replayed_value = replayed.of(signal)
        np.testing.assert_array_equal(replayed_value, live_value)
        np.testing.assert_allclose(
            replayed_s - replayed_s[0], live_s - live_s[0], atol=2e-5
        )  # a log's rounding may change which frame was the fastest of a second: 10.3 us were seen
    np.testing.assert_array_equal(replayed.of("EncoderIn.Count")[0], replayed.of("EncoderOut.Count")[0])
    counted = [
        {k: h.counters[k] for k in ("frames", "unknown_ids", "truncated")} for h in (source.health(), player.health())
    ]
    assert counted[0] == counted[1] == {"frames": len(sent), "unknown_ids": 1, "truncated": 1}


async def test_broken_lines_of_a_log_are_counted_and_skipped(tmp_path: Path) -> None:
    good = "(1700000000.000100) can0 101#0500000006000000\n"
    broken = ("(1700000000.0001) can0\n", "#### rubbish\n", "(x) can0 101#05\n", "(1700000000.1) can0 101#XX\n")
    (tmp_path / "bus.log").write_text("".join(good + line for line in broken) + good + good[:-14])
    heard = Heard()
    source = open_source(FileSource(name="f", file="bus.log", speed=0, dbc=str(HERE / "drive.dbc")), tmp_path)
    async with running(source, heard):
        await eventually(lambda: source.health().reason == "finished")
    assert heard.size("EncoderOut.Count") == 5
    counters = source.health().counters
    assert counters["malformed"] + counters.get("truncated", 0) == 5


@pytest.mark.parametrize("speed", [0.0, 1.0])
async def test_stamps_that_are_no_times_and_a_clock_that_was_set_hold_nothing_up(tmp_path: Path, speed: float) -> None:
    lines = [
        f"({stamp}) can0 101#0500000006000000\n" for stamp in ("0.5", "1700000000.1", "inf", "nan", "1700000000.2")
    ]
    (tmp_path / "bus.log").write_text("".join(lines))
    heard = Heard()
    source = open_source(FileSource(name="f", file="bus.log", speed=speed, dbc=str(HERE / "drive.dbc")), tmp_path)
    before_s = Clock().time_s()
    async with running(source, heard):
        await eventually(lambda: source.health().reason == "finished")
    assert heard.size("EncoderOut.Count") == 3 and source.health().counters["malformed"] == 2
    if speed:
        assert np.all(np.abs(heard.of("EncoderOut.Count")[0] - before_s) < DEADLINE_S), "it is played now"


@pytest.mark.parametrize(("name", "speed"), [("r.csv", 50.0), ("r.parquet", 0.0)])
async def test_a_recording_is_played_with_its_own_intervals(tmp_path: Path, name: str, speed: float) -> None:
    time_s = 1e6 + np.arange(2000) / 1000
    columns = {"theta_in_rad": np.sin(time_s), "torque_out_Nm": np.cos(time_s)}
    write_recording(tmp_path / name, time_s, columns)
    heard, source = Heard(), open_source(FileSource(name="f", file=name, speed=speed), tmp_path)
    loop = asyncio.get_running_loop()
    before_s, began_s = Clock().time_s(), loop.time()
    async with running(source, heard):
        await eventually(lambda: source.health().reason == "finished")
    took_s = loop.time() - began_s
    for column, values in columns.items():
        played_s, played = heard.of(column)
        np.testing.assert_array_equal(played, values)
        if speed:
            np.testing.assert_allclose(played_s - played_s[0], time_s - time_s[0], atol=1e-6)
            assert before_s <= played_s[0] < before_s + DEADLINE_S
        else:
            np.testing.assert_array_equal(played_s, time_s)
    assert source.health().state == "ok"
    if speed:
        assert took_s > 1.9 / speed


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("none.csv", None, "cannot read"),
        ("none.log", None, "cannot read"),
        ("empty.csv", b"", "empty"),
        ("empty.log", b"", "no frames"),
        ("bad.blf", b"not a log", "no frames"),
        ("bad.asc", b"\xff\xfe\x00", "no frames"),
    ],
)
async def test_what_cannot_be_played_is_one_clear_line(
    tmp_path: Path, name: str, content: bytes | None, expected: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    source = open_source(FileSource(name="f", file=name, speed=0), tmp_path)
    with pytest.raises(SourceLost, match=expected) as caught:
        await asyncio.wait_for(source.run(Heard(), Clock()), DEADLINE_S)
    assert "\n" not in str(caught.value)
    assert source.health().state == "down"


def test_a_file_that_is_missing_is_seen_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"file 'f': file: .*none\.csv: cannot read"):
        validate_source(FileSource(name="f", file="none.csv"), tmp_path)
    (tmp_path / "some.csv").write_text("time_s,a\n")
    validate_source(FileSource(name="f", file="some.csv"), tmp_path)
