"""The ring's blocks as a recording."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.records import Array
from edge_daemon.store.reader import StoreReader


def recording_of(
    reader: StoreReader, drive: str, since_s: float = -math.inf, until_s: float = math.inf
) -> tuple[Array, dict[str, Array]]:
    """`time_s` (n,) and (n,) per channel, SI, of the samples in [since_s, until_s); flawed samples are NaN.

    A channel that a block does not have is NaN there. Empty arrays where nothing is stored.
    """
    times: list[Array] = []
    parts: dict[str, list[Array]] = {}
    size = 0
    for block in reader.blocks(drive, since_s, until_s):
        time_s = block.time_s
        wanted = (time_s >= since_s) & (time_s < until_s)
        length = int(np.count_nonzero(wanted))
        for name, values in block.values.items():
            column = parts.setdefault(name, [np.full(size, math.nan)] if size else [])
            column.append(np.where(block.flaws[name] == 0, values, math.nan)[wanted])
        for name, column in parts.items():
            if name not in block.values:
                column.append(np.full(length, math.nan))
        times.append(time_s[wanted])
        size += length
    columns = {name: np.concatenate(column) for name, column in parts.items()}
    return np.concatenate(times) if times else np.empty(0), columns
