"""A recording too long to be worked on as a whole, as stretches spread evenly over it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from edge_daemon.recordings.recording import ANGLES, Recording

MOST_ROWS = 600_000
"""All recordings together have no more rows: ten minutes at 1 kHz; comparing them takes some 2 GB."""
STRETCHES = 10
"""So many stretches reach from begin to end, so that a gear that warms up is seen cold and warm."""
LEAST_S = 20.0
"""A stretch of less tells too little; of a faster sampling fewer are taken."""
MOVES_RAD = 1e-3
"""An angle that changes by less in a whole stretch stands, and one that stands says nothing."""
WHOLE = 0.7
"""A stretch must hold an angle in this share of its rows."""


def shortened(recordings: Sequence[Recording], most: int = MOST_ROWS) -> list[Recording]:
    """`recordings`, or where they have more rows than `most` together, stretches of each: the same share of all.

    A stretch is a recording of its own: what lies between two is not there, rather than a hole that would be bridged.
    """
    rows = sum(len(row.time_s) for row in recordings)
    if rows <= most:
        return list(recordings)
    return [part for row in recordings for part in _stretches(row, int(len(row.time_s) * most / rows))]


def _stretches(recording: Recording, rows: int) -> list[Recording]:
    """Those in which the drive moves; all, where it never does."""
    many = min(max(round(rows * recording.notes.interval_s / LEAST_S), 1), STRETCHES)
    length = max(rows // many, 1)
    parts = []
    for first in np.linspace(0, len(recording.time_s) - length, many).astype(int):
        part = slice(first, first + length)
        columns = {name: column[part] for name, column in recording.columns.items()}
        parts.append(replace(recording, time_s=recording.time_s[part], columns=columns))
    return [part for part in parts if _moves(part)] or parts


def _moves(recording: Recording) -> bool:
    angles = [column for name, column in recording.columns.items() if name in ANGLES]
    known = [column[np.isfinite(column)] for column in angles]
    return all(len(seen) > WHOLE * len(recording.time_s) and np.ptp(seen) > MOVES_RAD for seen in known)


def left_out(paths: Sequence[Path], whole: Sequence[Recording], used: Sequence[Recording]) -> Iterator[str]:
    """What a person has to know of recordings that were shortened, a sentence each."""
    share = sum(len(row.time_s) for row in used) / sum(len(row.time_s) for row in whole)
    if share == 1.0:
        return
    for path, row in zip(paths, whole, strict=True):
        yield (
            f"{path}: {len(row.time_s)} rows are more than is worked on at once: stretches from begin to end in "
            f"which it moves, {share:.0%} of it, stand for all"
        )
