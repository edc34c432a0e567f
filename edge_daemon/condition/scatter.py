"""What each encoder's own samples say of it: noise that no motion of a gear makes.

Above a third of the sampling rate nothing turns. Bits that stick or are lost, positions that are sent twice and
whatever else scatters a reading stand there alone; what a hard motion leaves there, it leaves in both angles alike.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from edge_daemon.records import Array, Block

ORDER = 12
"""The differences of this order hold what lies above 0.35 of the sampling rate."""
GAIN = math.comb(2 * ORDER, ORDER)
"""Variance of these differences over that of white noise."""
MIDDLE = 0.45494
"""Median of the square of a normal number: impacts and reversals of friction are among the larger half."""
ROUGH = 8.0
"""Times the usual noise that an encoder has failed at: a gear that knocks at a gap of an arc minute makes four
(guess)."""
GLITCH = 150.0
"""Times the usual noise that a single sample is wrong at: impacts in a gap of an arc minute make a third (guess)."""
GLITCHES, OF_BLOCKS = 3, 5
"""Blocks with wrong samples among the newest, from which on they are no single event: a slip is in one."""
SHARED = 4.0
"""Times what the other angle has in excess, below which it is the motion's."""
MEMORY_S, SURE_S = 30.0, 5.0
"""The usual noise is averaged over the first, and known after the second (guess)."""
FEWEST = 12
"""Differences of a block from which its noise can be told."""
GIVES_IN_S = 60.0
"""Noise that stays for so long is how the encoder is from now on, and goes into every sd (guess)."""


class ScatterWatch:
    """Of one drive with two encoders: `see` every block. `turns` says how many turns of it make one of the output, by
    channel, and `rounding_rad` by which sd it rounds."""

    def __init__(self, turns: Mapping[str, float], rounding_rad: Mapping[str, float]) -> None:
        self._encoders = [_Encoder(name, 1.0 / abs(turns[name]), rounding_rad.get(name, 0.0)) for name in turns]

    def see(self, block: Block) -> str:
        """Which encoder has failed and how, empty for neither; what is usual is learned as long as it has not."""
        if not all(encoder.name in block.values for encoder in self._encoders):
            return ""
        excess = [encoder.look(block) for encoder in self._encoders]
        for encoder, own, other in zip(self._encoders, excess, reversed(excess), strict=True):
            encoder.judge(own > SHARED * max(other, 0.0), block.size / block.rate_hz)
        return next((encoder.failure for encoder in self._encoders if encoder.failure), "")


class _Encoder:
    def __init__(self, name: str, per_out_rad: float, rounding_rad: float) -> None:
        self.name = name
        self.failure = ""
        self._per_out_rad, self._least_rad2 = per_out_rad, rounding_rad**2
        self._usual_rad2, self._usual_s = math.nan, 0.0
        self._newest_rad2, self._glitches = math.nan, deque[bool](maxlen=OF_BLOCKS)
        self._lasting_s = 0.0

    @property
    def _known_rad2(self) -> float:
        return max(self._usual_rad2, self._least_rad2)

    def look(self, block: Block) -> float:
        """Variance of the block's noise beyond what is usual, as the twist feels it [rad^2]; -inf where unknown."""
        squares = _squares(np.where(block.valid(self.name), block.values[self.name], math.nan))
        self._newest_rad2 = math.nan
        if len(squares) < FEWEST:
            return -math.inf
        self._newest_rad2 = float(np.median(squares)) / MIDDLE
        self._glitches.append(bool(squares.max() > GLITCH**2 * self._known_rad2))
        return (self._newest_rad2 - self._usual_rad2) * self._per_out_rad**2 if self._usual_s > 0 else -math.inf

    def judge(self, own: bool, duration_s: float) -> None:
        """Whether it fails; its noise is its `own` where the other angle has none like it."""
        if math.isnan(self._newest_rad2):
            return
        sure = self._usual_s >= SURE_S and self._known_rad2 > 0
        times = math.sqrt(self._newest_rad2 / self._known_rad2) if sure else 0.0
        rough = times > ROUGH and own
        if not rough and not (sure and sum(self._glitches) >= GLITCHES):
            self._learn(duration_s)
            return
        how = f"scatters {times:.2g} times as much as before" if rough else "has wrong samples among the good"
        self.failure = f"{self.name} {how}: check the encoder, its resolution, its cable and the shield"
        self._lasting_s += duration_s
        if self._lasting_s > GIVES_IN_S:
            self._usual_rad2 = self._newest_rad2
            self._glitches.clear()

    def _learn(self, duration_s: float) -> None:
        self.failure, self._lasting_s = "", 0.0
        self._usual_s += duration_s
        before = self._newest_rad2 if math.isnan(self._usual_rad2) else self._usual_rad2
        self._usual_rad2 = before + duration_s / min(self._usual_s, MEMORY_S) * (self._newest_rad2 - before)


def _squares(angle: Array) -> Array:
    """Squared differences, as far as all that they are made of was measured."""
    squares: Array = np.diff(angle, n=ORDER) ** 2 / GAIN
    return np.asarray(squares[np.isfinite(squares)])
