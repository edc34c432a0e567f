"""Which sequence numbers of which stream are there: spans of whole numbers, with the time at both ends of each."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator

NumberSpan = tuple[int, int, float, float]
"""First and last number, both included, and the time of each [s]."""


class Spans:
    """Disjoint spans in order; a number that joins two of them makes them one."""

    __slots__ = ("_first", "_first_s", "_last", "_last_s")

    def __init__(self, spans: Iterable[NumberSpan] = ()) -> None:
        self._first: list[int] = []
        self._last: list[int] = []
        self._first_s: list[float] = []
        self._last_s: list[float] = []
        for span in spans:
            self.join(*span)

    def __iter__(self) -> Iterator[NumberSpan]:
        return zip(self._first, self._last, self._first_s, self._last_s, strict=True)

    def __contains__(self, number: int) -> bool:
        at = bisect_right(self._first, number) - 1
        return at >= 0 and number <= self._last[at]

    def __len__(self) -> int:
        return sum(last - first + 1 for first, last in zip(self._first, self._last, strict=True))

    def add(self, number: int, time_s: float) -> int:
        """Take a number in: 0 where it was there before, 1 where it joins others, 2 where it stands apart."""
        last = self._last
        if last and number == last[-1] + 1:
            last[-1], self._last_s[-1] = number, time_s
            return 1
        if number in self:
            return 0
        pieces = len(last)
        self.join(number, number, time_s, time_s)
        return 2 if len(last) > pieces else 1

    def join(self, first: int, last: int, first_s: float, last_s: float) -> None:
        """Take a span in, whatever it covers or touches."""
        low = bisect_right(self._last, first - 2) if self._last else 0
        high = low
        while high < len(self._first) and self._first[high] <= last + 1:
            if self._first[high] <= first:
                first, first_s = self._first[high], self._first_s[high]
            if self._last[high] >= last:
                last, last_s = self._last[high], self._last_s[high]
            high += 1
        self._first[low:high], self._last[low:high] = [first], [last]
        self._first_s[low:high], self._last_s[low:high] = [first_s], [last_s]

    def missing(self, first: int, last: int) -> list[tuple[int, int]]:
        """Stretches of [first, last] that are not there."""
        found = []
        for begin, end, _, _ in self:
            if end < first or begin > last:
                continue
            if begin > first:
                found.append((first, begin - 1))
            first = end + 1
        return [*found, (first, last)] if first <= last else found

    def holes(self) -> list[NumberSpan]:
        """What is missing between numbers that are there, from 0 on; each with the times of its neighbours, NaN before
        the first."""
        found, next_one, before_s = [], 0, float("nan")
        for first, last, first_s, last_s in self:
            if first > next_one:
                found.append((next_one, first - 1, before_s, first_s))
            next_one, before_s = last + 1, last_s
        return found


StreamNumbers = dict[str, dict[int, Spans]]
"""Key of a stream (site/gateway/drive/topic) -> run -> numbers."""


def joined(into: StreamNumbers, other: StreamNumbers) -> None:
    """Add all that is in `other`."""
    for key, runs in other.items():
        mine = into.setdefault(key, {})
        for run, spans in runs.items():
            known = mine.setdefault(run, Spans())
            for span in spans:
                known.join(*span)
