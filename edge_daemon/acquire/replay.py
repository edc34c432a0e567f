"""Recordings and CAN logs, played as if they came from a bus."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Generator, Iterable, Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

from edge_daemon.acquire.can_decode import layouts_of
from edge_daemon.acquire.can_inbox import Inbox
from edge_daemon.acquire.can_readers import take_message
from edge_daemon.acquire.source import Sink, Tally
from edge_daemon.clock import Clock
from edge_daemon.config.settings import FileSource, SettingsError
from edge_daemon.recordings.csv_file import RecordingError
from edge_daemon.recordings.recording import Recording, read_recording
from edge_daemon.records import Readings, SourceHealth

CHUNK_S = 0.05
"""So much of the file is given between two looks at the clock; no batch is longer, so that latch times map as they do
live."""
CHUNK_FRAMES = 2000
LONGEST_PAUSE_S = 60.0
"""A longer pause in a file is not waited for: a clock was set in it, or nobody wants to see it (guess)."""
LOGS = frozenset({".log", ".asc", ".blf"})


class Replay:
    """One file. After its end the source stays, idle."""

    def __init__(self, settings: FileSource, base: Path) -> None:
        """Raises `SettingsError` if the decoding does not fit together."""
        self.name = settings.name
        self._settings = settings
        self._path = base / settings.file
        self._tally = Tally(settings.name)
        self._is_log = self._path.suffix.lower() in LOGS
        try:
            self._layouts = layouts_of(settings, base)
            self._new_inbox()
        except SettingsError as error:
            raise SettingsError(f"file {settings.name!r}: {error}") from error

    def _new_inbox(self) -> Inbox:
        return Inbox(self.name, self._layouts, self._settings.stamps, self._tally)

    def health(self) -> SourceHealth:
        """See `Source.health`; after the end of the file the reason is `finished`."""
        return self._tally.health()

    async def run(self, sink: Sink, clock: Clock) -> None:
        """See `Source.run`."""
        self._tally.set("ok")
        self._tally.count("opened")
        if self._is_log:
            await self._play_log(sink, clock)
        else:
            await self._play_recording(sink, clock)
        self._tally.set("ok", "finished")
        await asyncio.Event().wait()

    async def _play_recording(self, sink: Sink, clock: Clock) -> None:
        try:
            recording = await asyncio.to_thread(read_recording, self._path)
        except RecordingError as error:
            raise self._tally.lost(str(error)) from error
        begin_s = float(recording.time_s[0])
        pace = _Pace(self._settings.speed, begin_s, clock)
        for rows in _chunks(recording):
            await pace.until(float(recording.time_s[rows.stop - 1]))
            time_s = recording.time_s[rows] + pace.shift_s
            for name, column in recording.columns.items():
                sink(Readings(self.name, name, time_s, column[rows]))
            self._tally.count("readings", rows.stop - rows.start)
            self._tally.last_s = clock.time_s()

    async def _play_log(self, sink: Sink, clock: Clock) -> None:
        inbox = self._new_inbox()
        pace: _Pace | None = None
        async for messages in self._messages():
            pace = pace or _Pace(self._settings.speed, messages[0].timestamp, clock)
            for message in messages:
                take_message(inbox, message, message.timestamp)
            await pace.until(messages[-1].timestamp)
            for readings in inbox.flush(pace.shift_s):
                sink(readings)
                self._tally.last_s = clock.time_s()
        if pace is None:
            raise self._tally.lost(f"{self._path}: no frames: expected a CAN log")

    async def _messages(self) -> AsyncIterator[list[Any]]:
        """Runs of messages that span at most `CHUNK_S`, read off the loop."""
        log = _log(self._path, self._tally)
        held: list[Any] = []
        with closing(log):
            while True:
                try:
                    more = await asyncio.to_thread(lambda: list(islice(log, CHUNK_FRAMES)))
                except OSError as error:
                    raise self._tally.lost(f"{self._path}: cannot read: {error.strerror or error}") from error
                for message in more:
                    if held and not held[0].timestamp <= message.timestamp < held[0].timestamp + CHUNK_S:
                        yield held
                        held = []
                    held.append(message)
                if not more:
                    break
        if held:
            yield held


class _Pace:
    """Holds a file back to its speed, and puts its times on the gateway's clock."""

    def __init__(self, speed: float, begin_s: float, clock: Clock) -> None:
        self._speed = speed
        self._begin_s = begin_s
        self._loop_s = asyncio.get_running_loop().time()
        self.shift_s = clock.time_s() - begin_s if speed else 0.0
        """recorded times plus this; as fast as it goes, they stay as recorded"""
        self._at_s = begin_s

    async def until(self, recorded_s: float) -> None:
        """Returns when it is time for what was recorded then; lets others run in any case."""
        leap_s, self._at_s = recorded_s - self._at_s, recorded_s
        if self._speed and abs(leap_s) > LONGEST_PAUSE_S:
            self._begin_s += leap_s
            self.shift_s -= leap_s
        wait_s = 0.0
        if self._speed:
            due_s = self._loop_s + (recorded_s - self._begin_s) / self._speed
            wait_s = max(0.0, due_s - asyncio.get_running_loop().time())
        await asyncio.sleep(wait_s)


def _chunks(recording: Recording) -> Iterator[slice]:
    """Consecutive rows that span at most `CHUNK_S`, at least one each."""
    time_s = recording.time_s
    start = 0
    while start < len(time_s):
        end = max(start + 1, int(time_s.searchsorted(time_s[start] + CHUNK_S)))
        yield slice(start, end)
        start = end


def _log(path: Path, tally: Tally) -> Generator[Any]:
    """python-can messages of a log; lines that are no frames are counted and skipped. Raises OSError."""
    import can

    kind = path.suffix.lower()
    if kind != ".log":
        # the times of an .asc file count from its start, unless the file says otherwise; wanted is the time of day
        options = {"relative_timestamp": False} if kind == ".asc" else {}
        yield from _until_broken(lambda: can.LogReader(path, **options), tally)
        return
    with path.open(encoding="utf-8", errors="replace") as file:
        broken = True
        while broken:  # a reader that met a broken line is at its end
            broken = yield from _until_broken(lambda: can.CanutilsLogReader(file), tally)


def _until_broken(open_: Callable[[], Iterable[Any]], tally: Tally) -> Generator[Any, None, bool]:
    """Messages until the parser gives up: it checks no syntax and fails in as many ways as a file can be wrong. True
    where it did."""
    try:
        for message in open_():
            if math.isfinite(message.timestamp):
                yield message
            else:
                tally.count("malformed")
    except OSError:
        raise
    except Exception:
        tally.count("malformed")
        return True
    return False
