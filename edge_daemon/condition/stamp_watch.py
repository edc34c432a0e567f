"""Whether the time stamps of a channel jump: an encoder that is read evenly is stamped evenly.

Readings that were lost leave whole periods out, and a clock that runs fast or slow is off by millionths; a trigger that
comes now and then late, a gateway that stamps on arrival, or a clock that is set leaves distances that are no whole
number of periods, or none at all. An angle that is stamped wrongly by a millisecond is a wrong angle.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median

import numpy as np

from edge_daemon.records import Array

LEAST = 0.05
"""A stamp that is off by less than this share of a period does no harm (guess: 50 us at 1 kHz, which the estimate of
the encoders' skew takes up)."""
FAR = 8.0
"""Times the usual distance from the even course, beyond which a stamp has jumped: what a bus does by itself stays below
(guess)."""
SURE_S, MEMORY_S = 5.0, 60.0
"""What is usual is known after the first, and averaged over the second (guess)."""
BEYOND = 1.5
"""Times the largest jump that was usual, beyond which one is not (guess)."""
JUMPS, WITHIN_S = 2, 4.0
"""So many jumps within this time are no single event, as a clock that is set once is (guess)."""
GIVES_IN_S, FORGETS_S = 60.0, 3600.0
"""Stamps that jump for the first of these are how the channel is stamped, until the second has passed (guess)."""


class StampWatch:
    """Of one channel: `see` the stamps as they arrived."""

    def __init__(self) -> None:
        self._last_s = math.nan
        self._readings = 0
        self._usual = math.nan
        """distance from the even course [periods]"""
        self._largest = 0.0
        """of the jumps that are usual [periods]"""
        self._lasting_s = 0.0
        self._jumps: deque[tuple[int, float]] = deque(maxlen=JUMPS)
        """place among the readings, and size [s], of the newest"""
        self._period_s = math.nan

    def see(self, time_s: Array, period_s: float) -> None:
        """Take (n,) stamps of a channel that is read every `period_s`."""
        steps = np.diff(np.append(self._last_s, time_s)) / period_s
        first, self._last_s, self._period_s = self._readings, float(time_s[-1]), period_s
        self._readings += len(time_s)
        off = np.abs(steps - np.maximum(np.rint(steps), 1.0))
        if not math.isfinite(off[0]):
            off[0] = 0.0
        if first * period_s < SURE_S:
            self._largest = max(self._largest, float(off.max()))
        else:
            self._note(off, first)
        self._learn(off)

    def _note(self, off: Array, first: int) -> None:
        """The jumps among (n,) distances from the even course, of which this is the `first` reading."""
        least = max(FAR * self._usual, LEAST, BEYOND * self._largest)
        for i in np.flatnonzero(off > least)[-JUMPS:].tolist():
            self._jumps.append((first + i, float(off[i]) * self._period_s))
        duration_s = len(off) * self._period_s
        self._lasting_s = max(self._lasting_s + (duration_s if self.jump_s else -duration_s), 0.0)
        if self._lasting_s > GIVES_IN_S:
            self._largest, self._lasting_s = max(self._largest, self.jump_s / self._period_s), 0.0
            self._jumps.clear()

    def _learn(self, off: Array) -> None:
        duration_s, middle = len(off) * self._period_s, median(off.tolist())
        self._largest *= math.exp(-duration_s / FORGETS_S)
        share = min(duration_s / min(self._readings * self._period_s, MEMORY_S), 1.0)
        self._usual = middle if math.isnan(self._usual) else self._usual + share * (middle - self._usual)

    @property
    def jump_s(self) -> float:
        """By how much its stamps jump now [s]; 0 while they do not."""
        if len(self._jumps) < JUMPS or (self._readings - self._jumps[0][0]) * self._period_s > WITHIN_S:
            return 0.0
        return max(size_s for _, size_s in self._jumps)
