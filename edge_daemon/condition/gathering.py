"""Blocks joined to longer ones, for a stage whose cost is by the block and not by the sample."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from edge_daemon.records import GAP_SAMPLES, Block

GATHERED_S = 0.3
"""Blocks are joined to this length: estimates change over seconds, and three times the blocks would cost more than
twice the time."""


class Gathering:
    """Holds blocks back until they last `span_s` together, or the next one does not follow them."""

    def __init__(self, span_s: float = GATHERED_S) -> None:
        self._span_s = span_s
        self._held: list[Block] = []

    def push(self, block: Block) -> Iterator[Block]:
        """What is complete now: what was held, if `block` does not follow it, and what lasts long enough with it."""
        if self._held and not block.continues(self._held[-1]):
            yield self._joined()
        self._held.append(block)
        half_a_sample = GAP_SAMPLES / block.rate_hz
        if block.end_s - self._held[0].start_s > self._span_s - half_a_sample:
            yield self._joined()

    def _joined(self) -> Block:
        held, self._held = self._held, []
        first = held[0]
        if len(held) == 1:
            return first
        return Block(
            first.drive,
            held[-1].sequence,
            first.start_s,
            first.rate_hz,
            {name: np.concatenate([block.values[name] for block in held]) for name in first.values},
            {name: np.concatenate([block.flaws[name] for block in held]) for name in first.flaws},
        )
