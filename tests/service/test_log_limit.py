"""A log that repeats at full speed is cut, counted, and goes on."""

from __future__ import annotations

import logging
import time

from edge_daemon.service.log_limit import LogLimit


def line(number: int) -> logging.LogRecord:
    return logging.LogRecord("x", logging.ERROR, "a.py", number, "no descriptors", None, None)


def test_one_place_is_cut_and_others_go_on() -> None:
    limit = LogLimit(most=3, span_s=60.0)
    assert [limit.filter(line(1)) for _ in range(6)] == [True, True, True, False, False, False]
    assert limit.filter(line(2))


def test_what_was_left_out_is_told_when_the_place_writes_again() -> None:
    limit = LogLimit(most=1, span_s=0.02)
    while limit.filter(line(1)) or limit.filter(line(1)):  # within one span: the second is cut
        pass
    time.sleep(0.03)
    again = line(1)
    assert limit.filter(again) and "times before, left out" in again.getMessage()
