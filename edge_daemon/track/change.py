"""A sudden change of stiffness: two-sided CUSUM of the log likelihood ratio over block innovations.

The sum of ln p(block | K (1 + d)) / p(block | K) that never falls below zero reaches its threshold with the least
delay for its false alarms (Page, Biometrika 41 (1954); Lorden, Ann. Math. Statist. 42 (1971)). The threshold follows
from what a block tells: the mean time between false alarms of one sum is (exp(h') - h' - 1) / I blocks, with I the
information of a block and h' = h + 1.166 sqrt(2 I) (Siegmund, Sequential Analysis, 1985, ch. X: the overshoot).
"""

from __future__ import annotations

import math
from typing import NamedTuple

SHIFT = 0.01
"""The sums wait for this relative change of stiffness."""
FALSE_ALARM_S = 3600.0
"""So much time passes between false alarms on average, both sums together."""
OVERSHOOT = 1.166
MEMORY_S = 10.0
"""The information of a block is averaged over this time."""
LEAST_THRESHOLD = 3.0
"""However little a block tells, the odds must be twenty to one (guess)."""
REST_S = 5.0
"""After a change the sums rest this long, until all that is linear around the stiffness of before has followed too."""
DECIDING_BLOCKS = 1.95
"""A block that one disturbance has spoiled does not decide alone: two at least do."""
EXPLAINED = 0.5
"""Another stiffness must mend this share of what does not fit: an effect that the model lacks and a new motion brings
out may lie along the stiffness too, but hardly with most of itself (guess)."""
BY_CHANCE = 3.0
"""So many sd of the squares of noise may be among what does not fit."""
KNOWN_SHARE = 0.125
"""The sums rest above this sd of the stiffness over the change waited for: an estimate that is off by half the change
lets a sum grow, and that should be four sd."""


class ChangeEvidence(NamedTuple):
    """What a block says of the stiffness, weighed by the inverse covariance of its innovation: noise, and what is not
    yet known of the amplitudes. Sensor noise within the column is taken out of score and energy."""

    score: float
    """stiffness column times innovation [1 / (N m/rad)]"""
    energy: float
    """stiffness column times itself [1 / (N m/rad)^2]: information"""
    square: float
    """innovation times itself: about as much as it has components"""
    components: int
    duration_s: float
    """of the block"""


class _Sum:
    """Of one direction, and what came in since it left zero."""

    def __init__(self, side: int) -> None:
        self._side = side
        self.start_over()

    def start_over(self) -> None:
        self.value = 0.0
        self._from = math.nan
        self._score = self._energy = self._excess = self._components = 0.0

    def add(self, seen: ChangeEvidence, stiffness: float, most: float) -> None:
        """Count a block, at `most` so much: against the stiffness when the sum left zero, for what the filter has
        followed of a change since then counts too."""
        if self.value == 0.0:
            self.start_over()
            self._from = stiffness
        shift, followed = SHIFT * stiffness, stiffness - self._from
        score = seen.score + seen.energy * followed
        likelier = self._side * shift * score - 0.5 * shift**2 * seen.energy
        self.value = max(0.0, self.value + min(likelier, most))
        self._score += score
        self._energy += seen.energy
        self._excess += seen.square - seen.components + followed * (seen.score + score)
        self._components += seen.components

    @property
    def explains(self) -> bool:
        """Whether another stiffness mends most of what has not fitted since the sum left zero."""
        if not self._energy > 0:
            return False
        chance = BY_CHANCE * math.sqrt(2 * self._components)
        return self._score**2 / self._energy > EXPLAINED * (self._excess - chance)


class StiffnessChange:
    """Sums for a loss and for a gain."""

    def __init__(self) -> None:
        self._sums = (_Sum(-1), _Sum(1))
        self._rest_s = 0.0
        self._information = 0.0
        self._blocks = 0

    @property
    def waits(self) -> bool:
        """Whether a sum is on its way: what comes in may be that of another stiffness already."""
        return any(row.value > 0 for row in self._sums)

    def follow(self, seen: ChangeEvidence, stiffness: float, sd: float) -> int:
        """-1 for a loss and +1 for a gain that is now certain, else 0; the sums then start over. Nothing is counted
        against a `stiffness` whose `sd` is itself of the size of the change."""
        self._rest_s -= seen.duration_s
        if self._rest_s > 0 or sd > KNOWN_SHARE * SHIFT * abs(stiffness):
            self._start_over()
            return 0
        cost = 0.5 * (SHIFT * stiffness) ** 2 * seen.energy
        self._blocks += 1
        memory = min(self._blocks, max(MEMORY_S / seen.duration_s, 1.0))
        self._information += (max(cost, 0.0) - self._information) / memory
        enough = threshold(self._information, FALSE_ALARM_S / seen.duration_s)
        for row in self._sums:
            row.add(seen, stiffness, enough / DECIDING_BLOCKS)
        loss, gain = self._sums
        which, larger = (-1, loss) if loss.value > gain.value else (1, gain)
        if larger.value < enough:
            return 0
        if not larger.explains:
            larger.value = enough
            return 0
        self.rest()
        return which

    def rest(self) -> None:
        """Much of what was learned is in doubt: wait until it is known again."""
        self._start_over()
        self._rest_s = REST_S

    def _start_over(self) -> None:
        for row in self._sums:
            row.start_over()


def threshold(information: float, blocks: float) -> float:
    """Of the sums, for one false alarm in so many blocks when each holds this much information."""
    target = 2 * blocks * information
    h = math.log1p(target)
    for _ in range(3):
        h = math.log(target + h + 1.0)
    return max(h - OVERSHOOT * math.sqrt(2 * information), LEAST_THRESHOLD)
