"""The person beside a drive that moves: at the terminal, with a hand on the key."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

from edge_daemon.config.settings import Excite
from edge_daemon.excite.arming import DeadMan

SIGNS_PER_TIMEOUT = 4
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(slots=True)
class Operator:
    """The operator at the terminal."""

    dead_man: DeadMan
    reason: str = ""
    """why the operator wants it to end; empty while not"""


@contextlib.contextmanager
def operator(it: Excite, *, hold: bool, descriptor: int | None = None) -> Iterator[Operator]:
    """Watches the terminal and the signals while it lasts.

    The end of standard input ends the motion, and so does Enter; with `hold` Enter must be held down instead.
    """
    hand = Operator(DeadMan(it.dead_man_s, time.monotonic))
    over = threading.Event()
    given = sys.stdin.fileno() if descriptor is None else descriptor
    watch = threading.Thread(target=_watch, args=(hand, given, it.dead_man_s, hold, over), name="dead-man", daemon=True)

    def stop(number: int, _frame: object) -> None:
        hand.reason = f"stopped by {signal.Signals(number).name}"

    main = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, stop) for number in STOPPING} if main else {}
    watch.start()
    try:
        yield hand
    finally:
        over.set()
        watch.join(it.dead_man_s)
        for number, handler in before.items():
            signal.signal(number, handler)


def _watch(hand: Operator, descriptor: int, timeout_s: float, hold: bool, over: threading.Event) -> None:
    """A sign of life as long as somebody is there."""
    try:
        while not over.is_set():
            if not select.select([descriptor], [], [], timeout_s / SIGNS_PER_TIMEOUT)[0]:
                if not hold:
                    hand.dead_man.give()
                continue
            if not os.read(descriptor, 4096):
                return
            if hold:
                hand.dead_man.give()
            else:
                hand.reason = "stopped by Enter"
    except (OSError, ValueError):  # the terminal is gone
        return
    finally:
        hand.dead_man.release()
