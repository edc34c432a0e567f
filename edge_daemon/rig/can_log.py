"""A CAN log of simulated drives, made as fast as it goes: what a logger beside the gateway would have written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import can
import numpy as np

from edge_daemon.rig.can_face import Frame, timed_frames
from edge_daemon.rig.live import LiveDrive

STRETCH_S = 0.1
"""A turn of the loop covers this much rig time."""
LEAST_DELAY_S, JITTER_S = 2e-4, 3e-4
"""From latching to the logger it takes never less than the first, on average the sum of both (guess: a busy bus)."""


def write_log(file: Path, drives: Mapping[int, LiveDrive], seconds: float, start_s: float, latch_start_us: int) -> int:
    """Logs what the numbered drives send in `seconds` from now on; the number of frames.

    The suffix of `file` chooses the format (`.log` is candump's; `.asc`, `.blf`). `start_s`: Unix time of the drives'
    time zero. Times in the log are those of arrival, and in order.
    """
    rng = np.random.default_rng(0)
    begin_s = max(drive.time_s for drive in drives.values())
    waiting: list[tuple[float, Frame]] = []
    count = 0
    with can.Logger(str(file)) as logger:
        for turn in range(1, round(seconds / STRETCH_S) + 1):
            until_s = begin_s + turn * STRETCH_S
            for number, drive in drives.items():
                waiting += _arriving(number, drive, until_s, latch_start_us, rng)
            waiting.sort(key=lambda row: row[0])
            last = turn == round(seconds / STRETCH_S)
            ready = [row for row in waiting if last or row[0] <= until_s]
            waiting = waiting[len(ready) :]
            for arrival_s, (identifier, data) in ready:
                stamp_s = start_s + arrival_s
                logger(can.Message(timestamp=stamp_s, arbitration_id=identifier, data=data, is_extended_id=False))
            count += len(ready)
    return count


def _arriving(
    number: int, drive: LiveDrive, until_s: float, latch_start_us: int, rng: np.random.Generator
) -> list[tuple[float, Frame]]:
    first = round(drive.time_s * 1000)
    timed = timed_frames(number, drive.advance(until_s), latch_start_us, first)
    return [(time_s + LEAST_DELAY_S + rng.exponential(JITTER_S), frame) for time_s, frame in timed]
