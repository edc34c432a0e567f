"""A device's counter on the gateway's clock.

Encoders that latch together stamp their frames with a common counter. Frames arrive with jitter, sometimes late, never
early, so the smallest delay of each second of the counter shows how the two clocks lie to each other, and a line
through these minima how they drift. The map from counter to gateway time is piecewise linear, continuous and only ever
extended ahead of what was mapped: equal counts give equal times, to the last bit, whenever and in whichever message
they arrive, and the result does not depend on how frames were batched.
"""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.records import Array

SEGMENT_S = 1.0
"""The counter is followed over stretches of this length between corrections."""
WINDOW_SEGMENTS = 30
"""The drift is fitted to this much of the past (guess: long against jitter, short against warming crystals)."""
ENOUGH_SEGMENTS = 6
"""No drift is believed before this many stretches."""
HORIZON_S = 4.0
"""An error is steered away over this time; the rate error it causes is the error over it."""
MAX_RATE = 0.01
"""Rates of gateway and counter differ by no more, relatively: even an RC oscillator that CAN accepts is within 0.5
%."""
AHEAD_S = 0.25
"""A frame this much earlier than the map says means that the counter jumped; less is a map begun with a late frame,
while the daemon was still starting, and is steered back (guess: ten times a slow start)."""
LATE_S = 10.0
"""A frame later than this was not delayed, the counter jumped (guess: no buffer holds so much)."""
BACK_S = 0.1
"""A counter that steps back by this within one message was reset."""
STRAGGLERS_S = 2.0
"""Frames from before a jump may still arrive for this long after it."""
KEPT_SEGMENTS = 64
SETTLE_S = 0.05
"""Frames are listened to for this long before the first is believed: three times what the slowest usual adapter (FTDI:
16 ms) holds back, so that one of them came without delay."""


class _Era:
    """The map between two jumps of the counter. `d_s` is the counter in seconds, wraps added."""

    def __init__(self, d_s: float, arrival_s: float, before_s: float = -math.inf) -> None:
        """`before_s`: the newest time that the era before gave out."""
        self.began_s = arrival_s
        self.newest_time_s = before_s
        """given out so far, by this era or the one before"""
        self._before_s = before_s
        self._first_s = d_s
        self._knot_d_s = [d_s]
        self._knot_t_s = [arrival_s]
        self._slope = [0.0]
        self._fastest: dict[int, tuple[float, float]] = {}  # segment -> (delay - constant, where), its smallest
        self.newest_s: dict[str, float] = {}  # message -> counter

    def begins_with(self, d_s: Array) -> bool:
        """Whether none of the counts, as this era unwraps them, is from before it began."""
        return float(np.minimum.reduce(d_s)) >= self._first_s

    def unwrap(self, d_s: Array, wrap_s: float, arrival_s: Array) -> Array:
        """The counter with as many wraps added as fit the arrival best."""
        lies_s = self._knot_t_s[-1] - self._knot_d_s[-1]
        first, last = (round((float(arrival_s[i] - d_s[i]) - lies_s) / wrap_s) for i in (0, -1))
        if first == last and d_s[0] <= d_s[-1]:
            return d_s + wrap_s * first
        wraps: Array = np.round((arrival_s - d_s - lies_s) / wrap_s)
        return d_s + wrap_s * wraps

    def accept(self, message: str, d_s: Array, arrival_s: Array) -> Array | None:
        """(n,) gateway times; None if the frames came early, far too late, or stepped back: they are of another era.

        NaN where the era before gave out that time for earlier counts: two instants are not mixed into one.
        """
        before_s = self.newest_s.get(message, d_s[0])
        if d_s[0] - before_s <= -BACK_S or (len(d_s) > 1 and np.minimum.reduce(d_s[1:] - d_s[:-1]) <= -BACK_S):
            return None
        delay_s = arrival_s - d_s
        lies_s = self._knot_t_s[-1] - self._knot_d_s[-1]
        unsure_s = MAX_RATE * max(0.0, float(d_s[-1]) - self._knot_d_s[-1])
        if not self._fits(delay_s - lies_s, unsure_s):  # before `_map` extends the knots to where the counter never was
            return None
        mapped_s = self._map(d_s)
        if not self._fits(arrival_s - mapped_s, 0.0):
            return None
        self._learn(d_s, delay_s)
        self.newest_s[message] = float(d_s[-1])
        self.newest_time_s = max(self.newest_time_s, float(np.maximum.reduce(mapped_s)))
        if mapped_s[0] < self._before_s:
            mapped_s[(mapped_s <= self._before_s) & (mapped_s > self._before_s - STRAGGLERS_S)] = np.nan
        return mapped_s

    @staticmethod
    def _fits(delay_s: Array, unsure_s: float) -> bool:
        earliest, latest = np.minimum.reduce(delay_s), np.maximum.reduce(delay_s)
        return bool(earliest >= -AHEAD_S - unsure_s and latest <= LATE_S + unsure_s)

    def _map(self, d_s: Array) -> Array:
        newest_s = float(np.maximum.reduce(d_s))
        if newest_s >= self._knot_d_s[-1] + SEGMENT_S:
            self._extend(newest_s)
        if np.minimum.reduce(d_s) >= self._knot_d_s[-1]:  # the usual case, the same arithmetic
            ahead_s = d_s - self._knot_d_s[-1]
            return self._knot_t_s[-1] + ahead_s + ahead_s * self._slope[-1]
        knots: Array = np.asarray(self._knot_d_s)
        k = np.maximum(np.searchsorted(knots, d_s, side="right") - 1, 0)
        ahead_s = d_s - knots[k]
        at_knot_s, slope = np.asarray(self._knot_t_s)[k], np.asarray(self._slope)[k]
        mapped_s: Array = at_knot_s + ahead_s + ahead_s * slope
        return mapped_s

    def _learn(self, d_s: Array, delay_s: Array) -> None:
        """Remembers the smallest delay of each segment."""
        first, last = (math.floor((float(d_s[i]) - self._first_s) / SEGMENT_S) for i in (0, -1))
        if first == last:
            self._learn_one(first, d_s, delay_s)
            return
        segment = np.floor((d_s - self._first_s) / SEGMENT_S).astype(np.int64)
        for i in np.unique(segment).tolist():
            self._learn_one(i, d_s[segment == i], delay_s[segment == i])

    def _learn_one(self, i: int, d_s: Array, delay_s: Array) -> None:
        best = int(delay_s.argmin())
        found = (float(delay_s[best]), float(d_s[best]))
        if found < self._fastest.get(i, (math.inf, 0.0)):
            self._fastest[i] = found

    def _extend(self, until_s: float) -> None:
        for _ in range(KEPT_SEGMENTS):
            if until_s < self._knot_d_s[-1] + SEGMENT_S:
                break
            self._append(SEGMENT_S)
        else:  # a long silence: the correction has died away, the drift alone carries on in one long segment
            self._append(int((until_s - self._knot_d_s[-1]) / SEGMENT_S) * SEGMENT_S)
        for kept in (self._knot_d_s, self._knot_t_s, self._slope):
            del kept[:-KEPT_SEGMENTS]

    def _append(self, length_s: float) -> None:
        d_s = self._knot_d_s[-1] + length_s
        t_s = self._knot_t_s[-1] + length_s + length_s * self._slope[-1]
        k = round((d_s - self._first_s) / SEGMENT_S)
        # the segment just ended may still gain frames of other messages: leave it out, or batching would matter
        known = sorted(self._fastest)
        seen = [self._fastest[i] for i in known if i <= k - 2][-WINDOW_SEGMENTS:]
        for i in known[: -2 * WINDOW_SEGMENTS]:  # by number, not by age: after a silence the old drift is all there is
            del self._fastest[i]
        self._knot_d_s.append(d_s)
        self._knot_t_s.append(t_s)
        self._slope.append(_steer(seen, d_s, t_s - d_s))


def _steer(seen: list[tuple[float, float]], d_s: float, lies_s: float) -> float:
    """Rate correction that brings the map, `lies_s` above the counter at `d_s`, onto the line of smallest delays."""
    if not seen:
        return 0.0
    delay_s, where_s = np.asarray(seen).T
    rate = 0.0
    if len(seen) >= ENOUGH_SEGMENTS:
        # median of the slopes between all pairs (Theil 1950, Sen 1968): a second without a fast frame does not pull
        i, j = np.triu_indices(len(seen), 1)
        rate = float(np.clip(np.median((delay_s[j] - delay_s[i]) / (where_s[j] - where_s[i])), -MAX_RATE, MAX_RATE))
    floor_s = float(np.min(delay_s - rate * where_s))
    return float(np.clip((floor_s + rate * (d_s + HORIZON_S) - lies_s) / HORIZON_S, -MAX_RATE, MAX_RATE))


class DeviceClock:
    """One counter, shared by the messages that carry it."""

    def __init__(self, seconds_per_count: float, wrap_counts: float) -> None:
        self._seconds_per_count = seconds_per_count
        self._wrap_s = wrap_counts * seconds_per_count
        self._era: _Era | None = None
        self._before: _Era | None = None
        self.jumps = 0
        """how often the counter jumped: device restarted, or a clock was stepped"""
        self._settled_s = math.inf
        self._first: tuple[str, float] | None = None
        self._best = (math.inf, 0.0, 0.0)  # delay, counter, arrival

    def times(self, message: str, counts: Array, arrival_s: Array) -> Array:
        """(n,) gateway times of (n,) counter values that arrived in this order in one message.

        NaN for what arrives in the first `SETTLE_S`.
        """
        d_s = counts * self._seconds_per_count
        if self._era is None:
            self._settle(message, d_s, arrival_s)
        if arrival_s[0] >= self._settled_s:
            return self._mapped(message, d_s, arrival_s)
        late = arrival_s >= self._settled_s
        time_s = np.full(len(d_s), np.nan)
        if self._era is not None and late.any():
            time_s[late] = self._mapped(message, d_s[late], arrival_s[late])
        return time_s

    def _settle(self, message: str, d_s: Array, arrival_s: Array) -> None:
        """Anchors the map to the fastest of the first message's early frames; to one message's, for the same result
        however frames are batched."""
        if self._first is None:
            self._first = (message, float(d_s[0]))
            self._settled_s = float(arrival_s[0]) + SETTLE_S
        speaker, begin_s = self._first
        for d, at_s in zip(d_s.tolist(), arrival_s.tolist(), strict=True):
            if at_s >= self._settled_s + (0.0 if message == speaker else SETTLE_S):
                self._era = _Era(*self._best[1:])
                return
            onward_s = begin_s + (d - begin_s) % self._wrap_s
            if message == speaker:
                self._best = min(self._best, (at_s - onward_s, onward_s, at_s))

    def _mapped(self, message: str, d_s: Array, arrival_s: Array) -> Array:
        if self._era is None:
            return np.full(len(d_s), np.nan)
        unwrapped_s = self._era.unwrap(d_s, self._wrap_s, arrival_s)
        if self._before is None or self._era.begins_with(unwrapped_s):
            mapped_s = self._era.accept(message, unwrapped_s, arrival_s)
            if mapped_s is not None:
                return mapped_s
        return np.concatenate([self._one(message, d_s[i : i + 1], arrival_s[i : i + 1]) for i in range(len(d_s))])

    def _one(self, message: str, d_s: Array, arrival_s: Array) -> Array:
        """One frame at a time, where something jumped: counts from before a jump belong to the era before in every
        message, or two encoders that latched together would differ by the jump."""
        assert self._era is not None
        recent = self._before if arrival_s[0] < self._era.began_s + STRAGGLERS_S else None
        eras = [self._era] if recent is None else [self._era, recent]
        if not self._era.begins_with(self._era.unwrap(d_s, self._wrap_s, arrival_s)):
            eras.reverse()
        for era in eras:
            mapped_s = era.accept(message, era.unwrap(d_s, self._wrap_s, arrival_s), arrival_s)
            if mapped_s is not None:
                return mapped_s
        self.jumps += 1
        before_s = max(era.newest_time_s for era in eras)
        self._before, self._era = self._era, _Era(float(d_s[0]), float(arrival_s[0]), before_s)
        mapped_s = self._era.accept(message, d_s, arrival_s)
        assert mapped_s is not None, "a map fits the frame it was anchored to"
        return mapped_s
