"""What the lives of failed gears alone tell: how long one lasts that has come as far, whatever its indicators say.

Where nothing measured tells of what remains, nothing forecasts better than this, so no forecast may be worse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from edge_daemon.prognose.courses import LEAST, TOLD_EXPONENTS, LifeCourse
from edge_daemon.records import Array

LEFT = np.geomspace(1e-3, 50.0, 400)
"""Remaining over used life is told between these; a gear has hardly less or more ahead of it."""
LEAST_WIDTH = 0.05
"""No few lives are held to be more alike than this, in logarithms (guess)."""
SURPRISE = 1e-3
"""The share of gears that outlive all others by far, of whom the age alone tells nothing (guess)."""


class Lives(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How much use failed gears had seen at their end."""

    clock: int
    """which of `LifeCourse.uses`"""
    ends: list[float]
    """logarithm of the use of each failed gear"""

    def fits(self, gears: int) -> bool:
        """Whether it is one that this program can use."""
        known = len(self.ends) == gears and all(math.isfinite(end) for end in self.ends)
        return known and 0 <= self.clock <= len(TOLD_EXPONENTS)

    @property
    def exponent(self) -> float:
        """Of torque in the use."""
        return TOLD_EXPONENTS[self.clock - 1] if self.clock else 0.0

    def left_h(self, course: LifeCourse, row: int, levels: Array, without: int = -1) -> Array:
        """Remaining hours at probability levels (n,), of a gear that has come as far as a row, by all lives but one."""
        use = course.uses()[self.clock]
        now, ends = math.log(max(use[row], LEAST)), np.array(self.ends)
        chance = _density(ends[np.arange(ends.size) != without], now + np.log1p(LEFT)) * LEFT / (1.0 + LEFT)
        below = np.cumsum(chance) - 0.5 * chance
        share = np.exp(np.interp(levels, below / np.sum(chance), np.log(LEFT)))
        return np.asarray(share * use[row] * course.hours_a_unit(row, use))


def learn_lives(courses: Sequence[LifeCourse]) -> Lives:
    """Of courses to failure, on the clock on which the life of each was most likely by those of the others."""
    ends = np.log(np.maximum([[use[-1] for use in course.uses()] for course in courses], LEAST))
    others = ~np.eye(len(ends), dtype=bool)
    likely = [sum(math.log(_density(clock[keep], clock[[i]])[0]) for i, keep in enumerate(others)) for clock in ends.T]
    best = int(np.argmax(likely))
    return Lives(best, ends[:, best].tolist())


def _density(ends: Array, at: Array) -> Array:
    """(n,) density of logarithmic lives by kernels (Silverman 1986, eq. 3.28)."""
    width = 1.06 * float(np.std(ends)) * len(ends) ** -0.2 + LEAST_WIDTH
    kernels = np.exp(-0.5 * ((at[:, None] - ends) / width) ** 2)
    return np.asarray(np.mean(kernels, axis=1) / (width * math.sqrt(2.0 * math.pi)) + SURPRISE)
