"""The time base of one block, and how a channel comes onto it."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from edge_daemon.condition.alignment import MISSING, STALE, Aligned, ascending, fit, hold, interpolate, largest, place
from edge_daemon.condition.track import Track
from edge_daemon.records import Array

SHARED_S = 5e-7
"""Stamps closer than this are one instant: two steps of a double that counts seconds since 1970."""
SMALL_SHIFT = 0.05
"""A larger shift, in periods, can move samples into the block or out of it."""


class Grid:
    """`size` instants from `start_s`. It follows the first of `order` that has samples and keeps the nominal rate."""

    def __init__(self, start_s: float, rate_hz: float, size: int, order: Iterable[Track]) -> None:
        self.start_s = start_s
        self._rate_hz = rate_hz
        self._size = size
        self._own: Array | None = None
        self._slots: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        for track in order:
            if not track.slow and (inside := self._inside(track)) is not None:
                self._follow(track, inside)
                break

    @property
    def end_s(self) -> float:
        """Start of the next block."""
        return self.start_s + self._size / self._rate_hz

    @cached_property
    def time_s(self) -> Array:
        """(size,) instants."""
        return self.start_s + _offsets_s(self._size, self._rate_hz)

    def _follow(self, track: Track, inside: slice) -> None:
        found = fit(track.time_s[inside], self.start_s, self._rate_hz, self._size)
        if not found.same_rate:
            return
        self.start_s += found.shift_s
        if abs(found.shift_s) * self._rate_hz > SMALL_SHIFT:
            shifted = self._inside(track)
            if shifted is None:
                return
            inside = shifted
            found = fit(track.time_s[inside], self.start_s, self._rate_hz, self._size)
        if found.fits:
            self._own, self._slots = track.time_s[inside], found.slots

    def _inside(self, track: Track) -> slice | None:
        """The samples of a channel that belong to this block; None where there are none."""
        half_s = 0.5 / self._rate_hz
        first, last = track.time_s.searchsorted((self.start_s - half_s, self.end_s - half_s)).tolist()
        return slice(first, last) if last > first else None

    def align(self, track: Track) -> Aligned:
        """(size,) values and flaws: as they are where the stamps are the grid's own, else interpolated or held."""
        if track.slow:
            lost_s = track.lost_after_s, track.missed_after_s
            return hold(track.time_s, track.values, track.flaws, track.row.patience_s, self.time_s, lost_s)
        inside = self._inside(track)
        slots = None if inside is None else self._shared(track.time_s[inside])
        if inside is not None and slots is not None:
            aligned = place(track.values[inside], track.flaws[inside], slots, self._size)
        else:
            aligned = interpolate(track.time_s, track.values, track.flaws, track.period_s, self.time_s, track.step)
        self._mark_stale(track, aligned)
        return aligned

    def _shared(self, time_s: Array) -> NDArray[np.intp] | None:
        """Slots of samples that were taken at the instants of the reference; None where they were not."""
        if self._own is None:
            return None
        if len(time_s) == len(self._own):
            if largest(time_s - self._own) <= SHARED_S:
                return self._slots
            if len(time_s) == self._size:  # both have a sample in every slot
                return None
        slots = np.rint((time_s - self.start_s) * self._rate_hz).astype(np.intp)
        if slots[0] < 0 or slots[-1] >= self._size or not ascending(slots):
            return None
        theirs = np.full(self._size, np.nan)
        theirs[self._slots] = self._own
        apart_s = np.abs(time_s - theirs[slots])
        common = ~np.isnan(apart_s)
        return slots if common.any() and (apart_s[common] <= SHARED_S).all() else None

    def _mark_stale(self, track: Track, aligned: Aligned) -> None:
        """A fast channel is stale once it has been silent too long; until then its samples are only missing."""
        flaws = aligned[1]
        if not flaws[-1] & MISSING:
            return
        last_s = track.last_before(self.end_s)
        flaws[(self.time_s - last_s > track.row.patience_s) & (flaws & MISSING != 0)] |= STALE


@cache
def _offsets_s(size: int, rate_hz: float) -> Array:
    """(size,) instants of a block after its start."""
    return np.arange(size) / rate_hz
