"""Time for data: seconds since the Unix epoch that never run backward.

A gateway without a battery clock starts in the past and is stepped forward when the network answers; an
operator may step it back. Data time follows a forward step (a gap, honestly marked) and rides out a backward step
on the monotonic clock, so that nothing stored is ever overtaken or written twice.
"""

from __future__ import annotations

import time
from collections.abc import Callable

STEP_S = 0.5
"""A smaller disagreement is slewing, not a step (guess: ntpd steps above 0.128 s, chrony above 1 s by default)."""


class Clock:
    """`wall` and `monotonic` are injectable so that a test can step them."""

    def __init__(self, wall: Callable[[], float] = time.time, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._wall = wall
        self._monotonic = monotonic
        self._anchor_s = wall() - monotonic()
        self.steps_forward = 0
        self.steps_back = 0
        self._behind = False

    def time_s(self) -> float:
        """Now. Never smaller than any earlier answer."""
        ahead_s = self._wall() - self._monotonic() - self._anchor_s
        if ahead_s > STEP_S:
            self._anchor_s += ahead_s
            self.steps_forward += 1
            self._behind = False
        elif ahead_s < -STEP_S and not self._behind:
            self._behind = True
            self.steps_back += 1
        elif ahead_s >= -STEP_S:
            self._behind = False
        return self._anchor_s + self._monotonic()

    def from_wall_s(self, stamp_s: float) -> float:
        """A driver's wall-clock stamp on this clock: its age is kept, a step between is not."""
        return self.time_s() - max(0.0, self._wall() - stamp_s)

    @property
    def wall_offset_s(self) -> float:
        """Wall clock minus data time; large and negative after the wall clock was set back."""
        return self._wall() - self._monotonic() - self._anchor_s
