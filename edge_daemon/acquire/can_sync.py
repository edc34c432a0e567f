"""Producing CANopen SYNC, so that devices latch together."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from edge_daemon.acquire.can_readers import LinkDown
from edge_daemon.acquire.canopen_objects import SYNC_ID

JOIN_S = 1.0
"""A port that blocks in sending is closed by its owner soon after, and the thread ends then."""


@contextmanager
def producing_sync(bus: Any, period_s: float, sent: Callable[[float], None], *, by_kernel: bool) -> Iterator[None]:
    """Sends SYNC every `period_s` while it lasts. Raises `LinkDown` if it cannot begin.

    The kernel keeps the period best, and what it sends comes back with its time. Elsewhere a thread sends, and tells
    `sent` the wall-clock time of each.
    """
    import can

    message = can.Message(arbitration_id=SYNC_ID, is_extended_id=False, data=b"")
    if by_kernel:
        try:
            task = bus.send_periodic(message, period_s)
        except (can.CanError, OSError) as error:
            raise LinkDown(f"cannot send SYNC: {error}") from error
        try:
            yield
        finally:
            with suppress(can.CanError, OSError):
                task.stop()
        return
    stop = threading.Event()
    thread = threading.Thread(target=_send, args=(bus, message, period_s, sent, stop), name="SYNC", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(JOIN_S)


def _send(bus: Any, message: Any, period_s: float, sent: Callable[[float], None], stop: threading.Event) -> None:
    import can

    due_s = time.monotonic()
    while not stop.wait(max(0.0, due_s - time.monotonic())):
        due_s = max(due_s, time.monotonic() - period_s) + period_s  # after a stall go on, do not catch up
        sent(time.time())
        try:
            bus.send(message)
        except (can.CanError, OSError):
            return  # the reader meets the same dead link, and says so
