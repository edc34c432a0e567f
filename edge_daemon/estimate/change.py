"""A sudden change of stiffness: two-sided CUSUM of the log likelihood ratio over block innovations.

The sum of ln p(block | K (1 + d)) / p(block | K) that never falls below zero reaches its threshold with the least
delay for its false alarms (Page, Biometrika 41 (1954); Lorden, Ann. Math. Statist. 42 (1971)). The threshold follows
from what a block tells: the mean time between false alarms of one sum is (exp(h') - h' - 1) / I blocks, with I the
information of a block and h' = h + 1.166 sqrt(2 I) (Siegmund, Sequential Analysis, 1985, ch. X: the overshoot).
"""

from __future__ import annotations

import math

SHIFT = 0.01
"""relative change of stiffness that the sums wait for"""
FALSE_ALARM_BLOCKS = 36_000.0
"""mean time between false alarms: an hour of blocks of 0.1 s, both sums together"""
OVERSHOOT = 1.166
MEMORY_BLOCKS = 100.0
"""over which the information of a block is averaged"""
LEAST_THRESHOLD = 3.0


class StiffnessChange:
    """Sums for a loss and for a gain."""

    def __init__(self) -> None:
        self._loss = self._gain = 0.0
        self._information = 0.0
        self._blocks = 0

    def follow(self, score: float, energy: float, stiffness: float, variance: float, doubt: float = 0.0) -> int:
        """-1 for a loss and +1 for a gain that is now certain, else 0; the sums then start over.

        Products of the stiffness column with a block's innovation and with itself, sensor noise taken out of both;
        each row of the block has white noise of `variance`. `doubt`: variance of the stiffness known so far.
        """
        shift = SHIFT * stiffness
        spread = variance + max(energy, 0.0) * doubt
        gain, cost = shift * score / spread, 0.5 * shift**2 * energy / spread
        self._loss = max(0.0, self._loss - gain - cost)
        self._gain = max(0.0, self._gain + gain - cost)
        self._blocks += 1
        self._information += (max(cost, 0.0) - self._information) / min(self._blocks, MEMORY_BLOCKS)
        if max(self._loss, self._gain) < threshold(self._information):
            return 0
        which = -1 if self._loss > self._gain else 1
        self._loss = self._gain = 0.0
        return which


def threshold(information: float) -> float:
    """Of the sums, for one false alarm in FALSE_ALARM_BLOCKS when a block holds this much information."""
    target = 2 * FALSE_ALARM_BLOCKS * information
    h = math.log1p(target)
    for _ in range(3):
        h = math.log(target + h + 1.0)
    return max(h - OVERSHOOT * math.sqrt(2 * information), LEAST_THRESHOLD)
