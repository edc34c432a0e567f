"""A recording too long to be worked on as a whole, as stretches spread evenly over it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from edge_daemon.acquire.recording import Recording

MOST_ROWS = 600_000
"""of all recordings together: ten minutes at 1 kHz; comparing them takes some 2 GB"""
STRETCHES = 10
"""from begin to end, so that a gear that warms up is seen cold and warm"""


def shortened(recordings: Sequence[Recording], most: int = MOST_ROWS) -> list[Recording]:
    """`recordings`, each with the same share of its rows, so that they have no more than `most` together."""
    rows = sum(len(row.time_s) for row in recordings)
    if rows <= most:
        return list(recordings)
    return [_excerpt(row, int(len(row.time_s) * most / rows)) for row in recordings]


def _excerpt(recording: Recording, rows: int) -> Recording:
    length = max(rows // STRETCHES, 1)
    first = np.linspace(0, len(recording.time_s) - length, STRETCHES).astype(np.intp)
    kept = np.unique(first[:, None] + np.arange(length))
    columns = {name: column[kept] for name, column in recording.columns.items()}
    return replace(recording, time_s=recording.time_s[kept], columns=columns)


def left_out(paths: Sequence[Path], whole: Sequence[Recording], used: Sequence[Recording]) -> Iterator[str]:
    """What a person has to know of recordings that were shortened, as a sentence each."""
    for path, long, short in zip(paths, whole, used, strict=True):
        if len(short.time_s) < len(long.time_s):
            yield (
                f"{path}: {len(long.time_s)} rows are more than is worked on at once: {len(short.time_s)} of them, "
                f"{STRETCHES} stretches from begin to end, stand for all"
            )
