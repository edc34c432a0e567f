"""Steps in an angle between two samples that no motion makes.

A polynomial through the samples before a place and one through those after it disagree there by such a step; motion
below a quarter of the sampling rate passes both alike. The most that they disagreed before, a step must exceed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edge_daemon.records import Array, Mask

SAMPLES = 8
"""A polynomial is laid through so many samples on either side."""
DEGREES = (2, 4)
"""The first of these polynomials is steady in the noise of a coarse encoder, the second follows a quick motion better;
whichever disagrees less is believed."""
MEMORY_S = 60.0
"""The sharpest edges are remembered over so much motion."""
SURE_S = 2.0
"""So much motion must be seen before they are known."""
RAISED = 1.5
"""An edge raises the sharpest so far by no more than this factor."""


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
        self._sharpest = [0.0] * len(DEGREES)
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
        edges = np.empty((len(KERNELS), len(known) - 2 * SAMPLES + 1))
        for row, kernel in zip(edges, KERNELS, strict=True):
            row[:] = np.correlate(known, kernel, "valid")
        sizes = np.abs(edges)
        most = sizes.max(axis=1).tolist()
        if not math.isfinite(sum(most)):
            edges = np.nan_to_num(edges, nan=0.0)
            sizes = np.abs(edges)
            most = sizes.max(axis=1).tolist()
        usual_rad = min(self._sharpest)
        best = self._sharpest.index(usual_rad)
        at = int(sizes[best].argmax())
        told = self._seen_s >= SURE_S and usual_rad > 0
        if moves:
            self._learn(most, len(angle) / rate_hz)
        size_rad = float(edges[best, at])
        return Edge(at + SAMPLES - before, size_rad, abs(size_rad) / usual_rad if told else 0.0, usual_rad)

    def _learn(self, sharpest: list[float], duration_s: float) -> None:
        keep = math.exp(-duration_s / MEMORY_S)
        sure = self._seen_s >= SURE_S
        for k, (before, now) in enumerate(zip(self._sharpest, sharpest, strict=True)):
            self._sharpest[k] = max(keep * before, min(now, RAISED * before) if sure else now)
        self._seen_s += duration_s
