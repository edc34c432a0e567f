"""The ring's blocks as a recording."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.records import Array, Block
from edge_daemon.store.reader import StoreReader

SAME_RUN_SAMPLES = 0.5
"""A block begins a new run where it starts further than this, in sampling steps, from the end of the one before: a
sample fell out or came twice."""
EVEN_OVER_S = 60.0
"""The sampling rate is taken as constant over this long (guess: a crystal drifts by 1e-7 of itself in that time, while
the map from a device's counter to the gateway's clock is steered within seconds)."""


def recording_of(
    reader: StoreReader, drive: str, since_s: float = -math.inf, until_s: float = math.inf
) -> tuple[Array, dict[str, Array]]:
    """`time_s` (n,) and (n,) per channel, SI, of the samples in [since_s, until_s); flawed samples are NaN.

    A channel that a block does not have is NaN there. Empty arrays where nothing is stored. Within a run of blocks the
    stamps are laid evenly: a device samples evenly, and where each block's start follows a clock that is still being
    steered, a step of 0.1 ms between two blocks would read as an acceleration.
    """
    times: list[Array] = []
    before: Block | None = None
    run: list[Array] = []
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
        if before is not None and not _follows(block, before):
            times.append(_evenly(np.concatenate(run)))
            run = []
        run.append(time_s[wanted])
        before = block
        size += length
    columns = {name: np.concatenate(column) for name, column in parts.items()}
    return np.concatenate([*times, _evenly(np.concatenate(run))]) if run else np.empty(0), columns


def _follows(block: Block, before: Block) -> bool:
    late_s = block.start_s - before.end_s
    return block.rate_hz == before.rate_hz and abs(late_s) * block.rate_hz < SAME_RUN_SAMPLES


def _evenly(time_s: Array) -> Array:
    """(n,) the stamps of one run on a line, which bends only from one `EVEN_OVER_S` to the next."""
    if len(time_s) < 3:
        return time_s
    count = np.arange(len(time_s), dtype=float)
    line = time_s[0] + np.polyval(np.polyfit(count, time_s - time_s[0], 1), count)
    parts = max(1, round((time_s[-1] - time_s[0]) / EVEN_OVER_S))
    centres, wander_s = ([float(part.mean()) for part in np.array_split(row, parts)] for row in (count, time_s - line))
    return np.asarray(line + np.interp(count, centres, wander_s))
