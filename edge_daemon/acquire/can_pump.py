"""Moving frames from a bus to its inbox on the event loop, without waking for each of them."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Any

from edge_daemon.acquire.can_inbox import Inbox
from edge_daemon.acquire.can_readers import BusReader, FrameReader, LinkDown, take_message

LOOK_EVERY_S = 0.01
"""A look this long after the last loses nothing where frames bring their own time: what gathers meanwhile fits the
buffers of any driver."""
DELIVER_EVERY_S = 0.05
"""Decoding a batch costs the same for five frames as for fifty, and a block of the daemon is 0.1 s long."""
PATIENCE_S = 0.1
"""A thread waits this long in one receive, which bounds how long closing takes."""


class Pump:
    """Waits until a descriptor is readable, then looks every `pause_s` for what has gathered, while something has."""

    def __init__(self, reader: FrameReader, inbox: Inbox, limit: int, pause_s: float, deliver: Callable[[], None]):
        self._reader = reader
        self._inbox = inbox
        self._limit = limit
        self._pause_s = pause_s
        self._deliver = deliver
        self._delivery: asyncio.TimerHandle | None = None
        self._look: asyncio.TimerHandle | None = None

    async def run(self, descriptor: int) -> None:
        """Until cancelled. Raises `LinkDown`, and what `deliver` raises."""
        self._loop = asyncio.get_running_loop()
        self._descriptor = descriptor
        self._down: asyncio.Future[None] = self._loop.create_future()
        self._loop.add_reader(descriptor, self._begin)
        try:
            await self._down
        finally:
            self._loop.remove_reader(descriptor)
            for timer in (self._delivery, self._look):
                if timer is not None:
                    timer.cancel()

    def _begin(self) -> None:
        self._loop.remove_reader(self._descriptor)
        self._drain()

    def _drain(self) -> None:
        """One look. An empty one ends the looking: from then on the descriptor wakes us."""
        before = self._inbox.frames
        try:
            more = self._reader.drain(self._inbox, self._limit)
        except Exception as error:
            self._fail(error)
            return
        if self._inbox.frames == before and not more:
            self._loop.add_reader(self._descriptor, self._begin)
            return
        if self._delivery is None:
            self._delivery = self._loop.call_later(DELIVER_EVERY_S, self._hand_over)
        self._look = self._loop.call_later(0.0 if more else self._pause_s, self._drain)

    def _hand_over(self) -> None:
        self._delivery = None
        try:
            self._deliver()
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        if not self._down.done():
            self._down.set_exception(error)


async def pump_in_thread(reader: BusReader, inbox: Inbox, limit: int, deliver: Callable[[], None]) -> None:
    """For a bus without a descriptor: a thread receives, the loop decodes. Raises as `Pump.run`."""
    loop = asyncio.get_running_loop()
    down: asyncio.Future[None] = loop.create_future()
    stop = False

    def fail(error: Exception) -> None:
        if not down.done():
            down.set_exception(error)

    def take(messages: list[Any]) -> None:
        try:
            for message in messages:
                take_message(inbox, message, message.timestamp or time.time())
            deliver()
        except Exception as error:
            fail(error)

    def receive() -> None:
        try:
            while not stop:
                messages = _gather(reader, limit)
                if messages:
                    loop.call_soon_threadsafe(take, messages)
                if 0 < len(messages) < limit:
                    time.sleep(LOOK_EVERY_S)
        except LinkDown as error:
            if not stop:
                loop.call_soon_threadsafe(fail, error)

    # its own thread: the pool that `to_thread` uses is small and this one would keep a place for ever
    thread = threading.Thread(target=receive, name=f"can {inbox.source}", daemon=True)
    thread.start()
    try:
        await down
    finally:
        stop = True
        await asyncio.to_thread(thread.join)


def _gather(reader: BusReader, limit: int) -> list[Any]:
    """Waits for one message, then takes those that are there."""
    messages: list[Any] = []
    message = reader.receive(PATIENCE_S)
    while message is not None:
        messages.append(message)
        message = reader.receive(0.0) if len(messages) < limit else None
    return messages
