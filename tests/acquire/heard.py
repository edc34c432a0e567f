"""A sink that remembers, and waiting with a limit."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

import numpy as np

from edge_daemon.acquire.source import Source
from edge_daemon.clock import Clock
from edge_daemon.records import Array, Bands, Burst, Readings

DEADLINE_S = 10.0


class Heard:
    """Everything a source delivered; `until` waits for a condition on it."""

    def __init__(self) -> None:
        self.records: list[Readings | Burst | Bands] = []
        self._changed = asyncio.Event()

    def __call__(self, record: Readings | Burst | Bands) -> None:
        self.records.append(record)
        self._changed.set()

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(DEADLINE_S):
            while not condition():
                self._changed.clear()
                await self._changed.wait()

    def of(self, signal: str) -> tuple[Array, Array]:
        """All times and values of a signal."""
        found = [r for r in self.records if isinstance(r, Readings) and r.signal == signal]
        if not found:
            return np.empty(0), np.empty(0)
        return np.concatenate([r.time_s for r in found]), np.concatenate([r.value for r in found])

    def latest(self, signal: str) -> float:
        """The newest value of a signal; NaN before the first."""
        values = self.of(signal)[1]
        return float(values[-1]) if len(values) else float("nan")

    def size(self, signal: str) -> int:
        return len(self.of(signal)[0])


@asynccontextmanager
async def running(source: Source, heard: Heard) -> AsyncIterator[asyncio.Task[None]]:
    """The source runs inside; its failure surfaces on leaving unless the test looked at the task."""
    task = asyncio.create_task(source.run(heard, Clock()))
    try:
        yield task
    finally:
        if not task.done():
            task.cancel()
            with suppress(asyncio.CancelledError):
                await asyncio.wait_for(task, DEADLINE_S)


async def eventually(condition: Callable[[], bool]) -> None:
    """Returns when the condition holds, looked at again and again, for what tells nobody when it changes."""
    async with asyncio.timeout(DEADLINE_S):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.001)


async def opened(source: Source) -> None:
    """Returns when the source has opened its bus."""
    await eventually(lambda: source.health().counters.get("opened", 0) > 0)


def slcan(identifier: int, data: bytes) -> bytes:
    """A frame as a serial adapter writes it."""
    return b"t%03X%d%s\r" % (identifier, len(data), data.hex().upper().encode())
