"""A log that repeats at full speed is cut, counted, and goes on; the journal knows each line's priority."""

from __future__ import annotations

import logging
import subprocess
import sys
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


LOGGED = """
import logging, os, sys
from edge_daemon.service.log_limit import begin_log
file = os.fstat(2)
os.environ["JOURNAL_STREAM"] = {stream}
begin_log(False)
logging.warning("no %s", "space")
logging.info("ready")
try:
    1 / 0
except ZeroDivisionError:
    logging.exception("failed")
"""


def logged(stream: str) -> list[str]:
    code = LOGGED.format(stream=stream)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr.splitlines()


def test_the_journal_is_told_how_grave_each_line_is() -> None:
    lines = logged('f"{file.st_dev}:{file.st_ino}"')
    assert lines[:3] == ["<4>no space", "<6>ready", "<3>failed"]
    assert len(lines) > 5 and all(line.startswith("<3>") for line in lines[2:])


def test_a_terminal_reads_words_also_where_the_journal_is_inherited() -> None:
    assert logged('"1:1"')[:2] == ["WARNING no space", "INFO ready"]
