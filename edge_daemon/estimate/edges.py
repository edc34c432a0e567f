"""Steps in an angle between two samples that no motion makes.

A polynomial through the samples before a place and one through those after it disagree there by such a step; motion
below a quarter of the sampling rate passes both alike. The most that they disagreed before, a step must exceed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edge_daemon.estimate.kinematics import Mask
from edge_daemon.records import Array

SAMPLES = 8
"""on either side"""
DEGREES = (2, 4)
"""of the polynomials: the first is steady in the noise of a coarse encoder, the second follows a quick motion better;
whichever disagrees less is believed"""
MEMORY_S = 60.0
"""of motion, over which the sharpest edges are remembered"""
SURE_S = 2.0
"""of motion before they are known"""
RAISED = 1.5
"""times the sharpest so far: an edge makes no more of itself than this"""


class Edge(NamedTuple):
    """The sharpest of a block."""

    place: int
    """index of the sample after it, negative for one of the block before"""
    size_rad: float
    share: float
    """size over that of the sharpest before; 0 before any is known"""
    usual_rad: float
    """size of the sharpest before"""


NONE = Edge(0, 0.0, 0.0, math.inf)


def _kernel(degree: int) -> Array:
    """(2 * SAMPLES,) what stands after a place less what stands before it, both carried on to the place."""
    powers = (0.5 + np.arange(SAMPLES))[:, None] ** np.arange(degree + 1)
    after = np.linalg.pinv(powers)[0]
    return np.concatenate((-after[::-1], after))


KERNELS = np.stack([_kernel(degree) for degree in DEGREES])


class EdgeFinder:
    """Of one angle; carries the samples that the next block's first edges need."""

    def __init__(self) -> None:
        self._seen_s = 0.0
        self._sharpest = np.zeros(len(DEGREES))
        self.forget()

    def forget(self) -> None:
        """The next samples do not follow the last ones."""
        self._tail = np.empty(0)

    def look(self, angle: Array, good: Mask | None, rate_hz: float, moves: bool) -> Edge:
        """The sharpest edge that (n,) samples make known; `good` None: all. What is usual is learned while it
        `moves`."""
        if good is not None:
            angle = np.where(good, angle, math.nan)
        known = np.concatenate((self._tail, angle))
        before, self._tail = len(self._tail), known[-(2 * SAMPLES - 1) :]
        if len(known) < 2 * SAMPLES:
            return NONE
        edges = np.stack([np.correlate(known, kernel, "valid") for kernel in KERNELS])
        if good is not None or not math.isfinite(float(edges.sum())):
            edges = np.nan_to_num(edges, nan=0.0)
        sizes = np.abs(edges)
        best = int(self._sharpest.argmin())
        at = int(sizes[best].argmax())
        usual_rad = float(self._sharpest[best])
        told = self._seen_s >= SURE_S and usual_rad > 0
        if moves:
            self._learn(sizes.max(axis=1), len(angle) / rate_hz)
        size_rad = float(edges[best, at])
        return Edge(at + SAMPLES - before, size_rad, abs(size_rad) / usual_rad if told else 0.0, usual_rad)

    def _learn(self, sharpest: Array, duration_s: float) -> None:
        keep = math.exp(-duration_s / MEMORY_S)
        most = RAISED * self._sharpest if self._seen_s >= SURE_S else math.inf
        self._sharpest = np.maximum(keep * self._sharpest, np.minimum(sharpest, most))
        self._seen_s += duration_s
