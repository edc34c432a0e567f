"""Flaws as events: one when a flaw sets in, one when it is gone, not one per sample, and one for all channels that a
cable takes with it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from edge_daemon.channels import CHANNELS
from edge_daemon.records import NE107, Event, Flags, Flaw

SETS_IN_SHARE = 0.1
"""A flaw is told when this share of a block has it; a single lost frame is only counted (guess)."""
GONE_AFTER_S = 2.0
"""A flaw is told to be gone when no sample has had it for so long (guess)."""
LOSING_AFTER_S = 1.0
"""Readings are told to be missing once they have been so long, now and then: less is a hiccup, and a channel that gives
nothing at all is told to be silent before (guess)."""
AT_ONCE_S = 0.5
"""Channels that tell the same within this have one cause, a cable or a bus (guess)."""
MOST_EVENTS = 1000
"""So many events are kept while nobody takes them; the oldest goes first."""

MEANINGS: dict[Flaw, str] = {
    Flaw.MISSING: "readings are missing",
    Flaw.RANGE: "outside its range",
    Flaw.RATE: "changes faster than it can",
    Flaw.FROZEN: "does not change although the drive moves",
    Flaw.STALE: "silent",
    Flaw.RESET: "lost its reference",
    Flaw.DEVICE: "the device reports an error",
}
NO_LONGER = "no longer: "
LASTING = tuple(flaw for flaw in MEANINGS if flaw is not Flaw.RESET)


class FlawWatch:
    """Standing flaws per channel, counts of flawed samples, events."""

    def __init__(self, drive: str) -> None:
        self._drive = drive
        self._last_s: dict[tuple[str, Flaw], float] = {}
        self._heard: set[str] = set()
        self._losing_s: dict[str, tuple[float, float]] = {}
        """of channels that lose readings: since when, and when last"""
        self._jumped_s: dict[str, float] = {}
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self.counts: dict[str, int] = {}

    def see(self, channel: str, flaws: Flags, start_s: float, end_s: float) -> None:
        """Take one channel of one block."""
        if np.count_nonzero(flaws):
            present = int(np.bitwise_or.reduce(flaws))
            for flaw in LASTING:
                if present & flaw:
                    self._count(channel, flaw, flaws, start_s, end_s)
        if self._last_s:
            self._clear(channel, end_s)
        if channel not in self._heard and not np.all(flaws):
            self._heard.add(channel)

    def _count(self, channel: str, flaw: Flaw, flaws: Flags, start_s: float, end_s: float) -> None:
        size = int(np.count_nonzero(flaws & flaw))
        name = f"{channel}.{str(flaw.name).lower()}"
        self.counts[name] = self.counts.get(name, 0) + size
        if (channel, flaw) in self._last_s:
            self._last_s[channel, flaw] = end_s
        elif flaw is Flaw.MISSING and channel not in self._heard and size < len(flaws):
            return  # the block in which a channel begins is no loss
        elif size >= SETS_IN_SHARE * len(flaws):
            since_s = self._losing(channel, start_s, end_s) if flaw is Flaw.MISSING else start_s
            if since_s is not None:
                self.silent_or_flawed(channel, flaw, since_s, end_s)

    def _losing(self, channel: str, start_s: float, end_s: float) -> float | None:
        """Since when a channel has been losing readings; None while that is not to be told."""
        since_s, last_s = self._losing_s.get(channel, (start_s, start_s))
        if start_s - last_s > GONE_AFTER_S:
            since_s = start_s
        self._losing_s[channel] = since_s, end_s
        silent = (channel, Flaw.STALE) in self._last_s
        return None if silent or end_s - since_s < LOSING_AFTER_S else since_s

    def silent_or_flawed(self, channel: str, flaw: Flaw, since_s: float, until_s: float) -> None:
        """A flaw stands from `since_s`, last seen at `until_s`; told once."""
        if (channel, flaw) not in self._last_s:
            known = CHANNELS.get(channel)
            severity = NE107.FAILURE if known is not None and known.angle else NE107.OUT_OF_SPECIFICATION
            self._events.append(Event(self._drive, since_s, severity, channel, MEANINGS[flaw]))
        self._last_s[channel, flaw] = until_s

    def reset(self, channel: str, time_s: float, count: int) -> None:
        """The counter of a channel lost its reference, `count` times so far."""
        self.counts[f"{channel}.resets"] = count
        message = f"{MEANINGS[Flaw.RESET]}; the angle is carried on from where it was ({count} times so far)"
        self._events.append(Event(self._drive, time_s, NE107.MAINTENANCE_REQUIRED, channel, message))

    def jump(self, channel: str, time_s: float, count: int, size: float) -> None:
        """A channel jumped by `size` [SI] and stays there, `count` times so far; a volley of jumps is told once."""
        self.counts[f"{channel}.jumps"] = count
        before_s, self._jumped_s[channel] = self._jumped_s.get(channel, -math.inf), time_s
        if time_s - before_s > GONE_AFTER_S:
            unit = CHANNELS[channel].unit if channel in CHANNELS else ""
            message = f"jumped by {size:.3g} {unit} and stays there ({count} times so far): a slip, or the sensor"
            self._events.append(Event(self._drive, time_s, NE107.MAINTENANCE_REQUIRED, channel, message))

    def _clear(self, channel: str, now_s: float) -> None:
        for flaw in LASTING:
            last_s = self._last_s.get((channel, flaw), math.inf)
            if now_s - last_s > GONE_AFTER_S:
                del self._last_s[channel, flaw]
                self._events.append(Event(self._drive, now_s, NE107.OK, channel, NO_LONGER + MEANINGS[flaw]))

    def take(self) -> list[Event]:
        """Events since the last call, oldest first; of channels that tell the same at once, one."""
        taken: list[Event] = []
        for event in self._events:
            i = next((i for i, known in enumerate(taken) if _alike(known, event)), None)
            if i is None:
                taken.append(event)
            else:
                names, worst = f"{taken[i].source}, {event.source}", max(taken[i].severity, event.severity)
                taken[i] = replace(taken[i], source=names, severity=worst)
        self._events.clear()
        return taken


def _alike(one: Event, other: Event) -> bool:
    """Whether two channels tell the same, and so shortly after one another that it has one cause."""
    same = one.message == other.message and other.source not in one.source.split(", ")
    return same and abs(one.time_s - other.time_s) < AT_ONCE_S
