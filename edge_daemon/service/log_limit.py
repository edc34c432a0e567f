"""The log: nobody can fill it, and the journal knows how grave each line is."""

from __future__ import annotations

import logging
import os
import sys
import time

MOST = 200
"""One place in the code may write so many lines within `SPAN_S`: fifty drives may begin at once."""
SPAN_S = 10.0
"""After this a place may write again, and the first line says how many were left out."""

JOURNAL_LEVELS = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (0, 7))
"""The journal numbers priorities as syslog does (sd-daemon(3)); each stands for these levels and those above."""


def begin_log(verbose: bool) -> None:
    """Everything goes to standard error, limited; where that is systemd's journal, with the priority of each line."""
    logging.basicConfig(level=logging.DEBUG if verbose else logging.INFO, stream=sys.stderr)
    for handler in logging.getLogger().handlers:
        handler.addFilter(LogLimit())
        handler.setFormatter(JournalFormat() if _is_journal() else logging.Formatter("%(levelname)s %(message)s"))


def _is_journal() -> bool:
    """Whether standard error is what systemd says it connected to the journal: a shell's own children inherit the
    variable, and may write elsewhere."""
    try:
        file = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{file.st_dev}:{file.st_ino}"


class JournalFormat(logging.Formatter):
    """`<4>message`: the journal takes the number off and keeps it as PRIORITY, for each line of a traceback as well."""

    def format(self, record: logging.LogRecord) -> str:
        """See `logging.Formatter`."""
        priority = next(number for level, number in JOURNAL_LEVELS if record.levelno >= level)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).splitlines())


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
