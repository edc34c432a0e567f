"""A drive's temperature while it is moved, where a limit depends on it."""

from __future__ import annotations

import asyncio
import contextlib
import math
import threading
import time
from collections.abc import Iterator

from edge_daemon.acquire.source import Source, SourceLost
from edge_daemon.clock import Clock
from edge_daemon.config.settings import Excite
from edge_daemon.excite.operator import Operator
from edge_daemon.service.motion_recording import MotionLog

LOOK_EVERY_S = 0.02
TEMPERATURE_WITHIN_S = 10.0
"""The first temperature is waited for this long where a limit depends on it."""


@contextlib.contextmanager
def running(source: Source | None, log: MotionLog, clock: Clock) -> Iterator[None]:
    """Runs the source of the temperature beside the motion, where it has one of its own."""
    if source is None:
        yield
        return
    beside = _Beside(source, log, clock)
    try:
        yield
    finally:
        beside.stop()


class _Beside:
    """A source in a thread with an event loop of its own."""

    def __init__(self, source: Source, log: MotionLog, clock: Clock) -> None:
        self._source, self._log, self._clock = source, log, clock
        self._loop = asyncio.new_event_loop()
        self._task: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._run, name="thermometer", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        self._task = self._loop.create_task(self._source.run(self._log.take, self._clock))
        with contextlib.suppress(asyncio.CancelledError, SourceLost):
            self._loop.run_until_complete(self._task)
        self._loop.close()

    def stop(self) -> None:
        """Ends it; a bus that hangs is left behind."""
        with contextlib.suppress(RuntimeError):  # the loop is closed already
            self._loop.call_soon_threadsafe(lambda: self._task and self._task.cancel())
        self._thread.join(TEMPERATURE_WITHIN_S)


def await_temperature(it: Excite, log: MotionLog, hand: Operator) -> None:
    if it.limits.temperature_degC is None:
        return
    end_s = time.monotonic() + TEMPERATURE_WITHIN_S
    tick = threading.Event()
    while (
        math.isnan(log.temperature_degC()) and time.monotonic() < end_s and not hand.reason and not hand.dead_man.gone
    ):
        tick.wait(LOOK_EVERY_S)
        log.flush()
