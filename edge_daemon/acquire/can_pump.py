"""Moving frames from a bus to its inbox on the event loop, without waking for each of them."""

from __future__ import annotations

import asyncio
import math
import select
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
ONCE = select.EPOLLIN | select.EPOLLONESHOT
"""The loop hears of the first frame and then of nothing until it has looked."""
PATIENCE_S = 0.1
"""A thread waits this long in one receive, which bounds how long closing takes."""


class Pump:
    """Looks for frames when the descriptor becomes readable, at most every `pause_s`, so that they gather.

    An armed descriptor wakes the loop once (epoll(7), EPOLLONESHOT). To be armed again costs one call to the kernel;
    taking it out of the loop and putting it back cost a fifth of the loop's time, at a hundred bursts a second.
    """

    def __init__(self, reader: FrameReader, inbox: Inbox, limit: int, pause_s: float, deliver: Callable[[], None]):
        self._reader = reader
        self._inbox = inbox
        self._limit = limit
        self._pause_s = pause_s
        self._deliver = deliver
        self._delivery: asyncio.TimerHandle | None = None
        self._look: asyncio.TimerHandle | None = None
        self._looked_s = -math.inf

    async def run(self, descriptor: int) -> None:
        """Until cancelled. Raises `LinkDown`, and what `deliver` raises."""
        self._loop = asyncio.get_running_loop()
        self._descriptor = descriptor
        self._down: asyncio.Future[None] = self._loop.create_future()
        with select.epoll() as self._armed:
            self._armed.register(descriptor, ONCE)
            self._loop.add_reader(self._armed.fileno(), self._wake)
            try:
                await self._down
            finally:
                self._loop.remove_reader(self._armed.fileno())
                for timer in (self._delivery, self._look):
                    if timer is not None:
                        timer.cancel()

    def _wake(self) -> None:
        """Something has come: a look now, or as soon as the pause since the last look is over."""
        self._armed.poll(0)
        wait_s = self._looked_s + self._pause_s - self._loop.time()
        if wait_s > 0:
            self._look = self._loop.call_later(wait_s, self._drain)
        else:
            self._drain()

    def _drain(self) -> None:
        before = self._inbox.frames
        self._looked_s = self._loop.time()
        try:
            more = self._reader.drain(self._inbox, self._limit)
            if not more:
                self._armed.modify(self._descriptor, ONCE)
        except Exception as error:
            self._fail(error)
            return
        if more:
            self._look = self._loop.call_later(0.0, self._drain)
        if self._delivery is None and self._inbox.frames > before:
            self._delivery = self._loop.call_later(DELIVER_EVERY_S, self._hand_over)

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
