"""The only place that restarts anything."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable

from edge_daemon.records import TaskHealth
from edge_daemon.text import said

log = logging.getLogger(__name__)

FIRST_WAIT_S = 0.5
LONGEST_WAIT_S = 30.0
"""A device that returns is seen within this time; a dead one costs two attempts a minute."""
HEALTHY_AFTER_S = 60.0
"""A task that ran this long starts its next back-off afresh."""


class Supervisor:
    """Runs tasks by name; one that fails is started again after a growing wait, for ever."""

    def __init__(self, sleep: Callable[[float], Awaitable[None]] = asyncio.sleep) -> None:
        self._sleep = sleep
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._health: dict[str, TaskHealth] = {}

    def start(self, name: str, run: Callable[[], Awaitable[None]]) -> None:
        """Begin to run and watch `run`. A name in use is an error of the caller."""
        if name in self._tasks:
            raise ValueError(f"task {name!r} already runs")
        self._health[name] = TaskHealth(name, "running", 0, "")
        self._tasks[name] = asyncio.create_task(self._watch(name, run), name=name)

    async def stop(self, name: str) -> None:
        """End one task and forget it; unknown names are fine."""
        task = self._tasks.pop(name, None)
        self._health.pop(name, None)
        if task:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def stop_all(self, within_s: float) -> tuple[str, ...]:
        """End every task together; the names of those that did not end in time."""
        tasks, self._tasks = self._tasks, {}
        for task in tasks.values():
            task.cancel()
        if not tasks:
            return ()
        _, late = await asyncio.wait(tasks.values(), timeout=within_s)
        return tuple(task.get_name() for task in late)

    def health(self) -> tuple[TaskHealth, ...]:
        """One row a task, in the order they were started."""
        return tuple(self._health.values())

    async def _watch(self, name: str, run: Callable[[], Awaitable[None]]) -> None:
        wait_s = FIRST_WAIT_S
        loop = asyncio.get_running_loop()
        while True:
            began_s = loop.time()
            try:
                await run()
            except Exception as error:
                if self._tasks.get(name) is not asyncio.current_task():  # it was told to end and failed at that
                    raise asyncio.CancelledError from error
                _take_back_cancelling()
                if loop.time() - began_s > HEALTHY_AFTER_S:
                    wait_s = FIRST_WAIT_S
                self._failed(name, error, wait_s)
            else:
                self._set(name, "finished")
                return
            await self._sleep(wait_s)
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)
            self._set(name, "running")

    def _failed(self, name: str, error: Exception, wait_s: float) -> None:
        before = self._health[name]
        reason = str(error) or type(error).__name__
        self._health[name] = TaskHealth(name, "waiting", before.restarts + 1, reason)
        if reason != before.reason:  # a dead device fails the same way all night: say it once
            log.warning("%s; next try in %.1f s", said(name, reason), wait_s)
        log.debug("%s failed", name, exc_info=error)

    def _set(self, name: str, state: str) -> None:
        before = self._health[name]
        self._health[name] = TaskHealth(name, state, before.restarts, before.reason)


def _take_back_cancelling() -> None:
    """A TaskGroup of Python 3.11 and 3.12 whose task failed leaves its parent marked as being cancelled for ever."""
    task = asyncio.current_task()
    while task and task.cancelling():
        task.uncancel()
