"""A log that nobody can fill: what repeats at full speed is written a few times, then counted."""

from __future__ import annotations

import logging
import time

MOST = 200
"""One place in the code may write so many lines within `SPAN_S`: fifty drives may begin at once."""
SPAN_S = 10.0
"""After this a place may write again, and the first line says how many were left out."""


class LogLimit(logging.Filter):
    """For a handler: lets few records of one place in the code through."""

    def __init__(self, most: int = MOST, span_s: float = SPAN_S) -> None:
        super().__init__()
        self._most, self._span_s = most, span_s
        self._places: dict[tuple[str, int], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """See `logging.Filter`."""
        place, now_s = (record.pathname, record.lineno), time.monotonic()
        begun_s, count = self._places.get(place, (now_s, 0))
        if now_s - begun_s >= self._span_s:
            if count > self._most:
                record.msg = f"{record.msg} (and {count - self._most} times before, left out)"
            begun_s, count = now_s, 0
        self._places[place] = (begun_s, count + 1)
        return count < self._most
