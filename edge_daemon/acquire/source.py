"""What a source of readings is, and how it says how it is."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from edge_daemon.clock import Clock
from edge_daemon.records import Bands, Burst, Readings, SourceHealth

Sink = Callable[[Readings | Burst | Bands], None]
"""Takes a record at once; never waits."""


def not_there(port: str) -> str:
    """Why a serial port cannot be opened: it is not there, and which are; empty where it is."""
    if "://" in port or Path(port).exists():
        return ""
    there = sorted(str(path) for path in (*Path("/dev/serial/by-id").glob("*"), *Path("/dev").glob("ttyACM*")))
    return f"no such serial device: plugged in? There {'are ' + ', '.join(there) if there else 'is none at all'}"


class SourceLost(Exception):
    """The bus or device cannot be opened, or went away; one line that says which and why."""


class Source(Protocol):
    """One bus, device or file."""

    name: str

    async def run(self, sink: Sink, clock: Clock) -> None:
        """Opens, delivers to `sink` until cancelled, closes what it opened.

        May be called again after it ended. Raises `SourceLost`, and nothing else that the outer world causes.
        """
        ...

    def health(self) -> SourceHealth:
        """How it is now; cheap, callable at any time."""
        ...


class Tally:
    """What a source counts and how it is, kept over restarts."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.state = "starting"
        self.reason = ""
        self.last_s = math.nan
        self.counters: dict[str, int] = {"readings": 0}
        self.failing: dict[str, str] = {}
        """which of its devices or signals do not answer, and why"""

    def count(self, counter: str, more: int = 1) -> None:
        """Adds to a counter; the first time makes it."""
        self.counters[counter] = self.counters.get(counter, 0) + more

    def set(self, state: str, reason: str = "") -> None:
        """`starting`, `ok`, `degraded` or `down`, and why."""
        self.state, self.reason = state, reason

    def lost(self, reason: str) -> SourceLost:
        """Marks the source as down; returns the exception for the caller to raise."""
        self.set("down", reason)
        self.count("losses")
        return SourceLost(f"{self.source}: {reason}")

    def health(self) -> SourceHealth:
        """A frozen copy; degraded where some do not answer."""
        state, reason = self.state, self.reason
        if state == "ok" and self.failing:
            state, reason = "degraded", "; ".join(f"{name}: {why}" for name, why in self.failing.items())
        return SourceHealth(self.source, state, reason, self.last_s, dict(self.counters))
