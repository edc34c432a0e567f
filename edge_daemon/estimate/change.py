"""A sudden change of stiffness: two-sided CUSUM of the log likelihood ratio over block innovations.

The sum of ln p(block | K (1 + d)) / p(block | K) that never falls below zero reaches its threshold with the least
delay for its false alarms (Page, Biometrika 41 (1954); Lorden, Ann. Math. Statist. 42 (1971)).
"""

from __future__ import annotations

import math

SHIFT = 0.01
"""relative change of stiffness that the sums wait for"""
THRESHOLD = math.log(36_000.0)
"""one false alarm in more than an hour of blocks of 0.1 s: the mean time to it is at least exp(threshold) blocks"""


class StiffnessChange:
    """Sums for a loss and for a gain."""

    def __init__(self) -> None:
        self._loss = self._gain = 0.0

    def follow(self, score: float, energy: float, stiffness: float, variance: float) -> bool:
        """Whether the change is now certain; the sums then start over.

        Products of the stiffness column with a block's innovation and with itself, sensor noise taken out of both;
        each row of the block has white noise of `variance`.
        """
        shift = SHIFT * stiffness
        gain, cost = shift * score / variance, 0.5 * shift**2 * energy / variance
        self._loss = max(0.0, self._loss - gain - cost)
        self._gain = max(0.0, self._gain + gain - cost)
        if max(self._loss, self._gain) < THRESHOLD:
            return False
        self._loss = self._gain = 0.0
        return True
