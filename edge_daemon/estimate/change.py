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
"""odds of twenty to one, however little a block tells (guess)"""
REST_BLOCKS = 20
"""after a change, until the other amplitudes have followed too"""
DECIDING_BLOCKS = 3.0
"""a shock lasts one block or two: that many at least decide"""
KNOWN_SHARE = 0.25
"""sd of the stiffness over the change waited for, above which the sums rest"""


class StiffnessChange:
    """Sums for a loss and for a gain."""

    def __init__(self) -> None:
        self._loss = self._gain = 0.0
        self._from_loss = self._from_gain = math.nan
        """the stiffness when a sum left zero: what the filter has followed of a change since then counts too"""
        self._rest = 0
        self._information = 0.0
        self._blocks = 0

    def follow(self, score: float, energy: float, stiffness: float, sd: float = 0.0) -> int:
        """-1 for a loss and +1 for a gain that is now certain, else 0; the sums then start over.

        Products of the stiffness column with a block's innovation and with itself, weighed by the innovation's inverse
        covariance (noise, and what is not yet known of the other amplitudes), sensor noise taken out of both. Nothing
        is counted against a `stiffness` whose `sd` is itself of the size of the change.
        """
        shift = SHIFT * stiffness
        self._rest -= 1
        if self._rest > 0 or sd > KNOWN_SHARE * abs(shift):
            self._loss = self._gain = 0.0
            return 0
        cost = 0.5 * shift**2 * energy
        self._from_loss = stiffness if self._loss == 0.0 else self._from_loss
        self._from_gain = stiffness if self._gain == 0.0 else self._from_gain
        self._blocks += 1
        self._information += (max(cost, 0.0) - self._information) / min(self._blocks, MEMORY_BLOCKS)
        enough = threshold(self._information)
        loss = -shift * (score + energy * (stiffness - self._from_loss)) - cost
        gain = shift * (score + energy * (stiffness - self._from_gain)) - cost
        self._loss = max(0.0, self._loss + min(loss, enough / DECIDING_BLOCKS))
        self._gain = max(0.0, self._gain + min(gain, enough / DECIDING_BLOCKS))
        if max(self._loss, self._gain) < enough:
            return 0
        which = -1 if self._loss > self._gain else 1
        self._rest = REST_BLOCKS
        self._loss = self._gain = 0.0
        return which


def threshold(information: float) -> float:
    """Of the sums, for one false alarm in FALSE_ALARM_BLOCKS when a block holds this much information."""
    target = 2 * FALSE_ALARM_BLOCKS * information
    h = math.log1p(target)
    for _ in range(3):
        h = math.log(target + h + 1.0)
    return max(h - OVERSHOOT * math.sqrt(2 * information), LEAST_THRESHOLD)
