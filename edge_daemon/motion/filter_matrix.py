"""A filter as a matrix that signals pass piece by piece: for short pieces faster than any transform.

Its zeros are wasted, so that pieces are kept short.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from edge_daemon.records import Array

PIECE = 128
"""At most so many samples are filtered at a time."""


@dataclass(frozen=True, slots=True)
class FilterMatrix:
    """The balance filter, as a matrix that a signal passes piece by piece."""

    rows: Array
    """(r, piece + reach)"""
    piece: int
    samples: int
    """that make a stretch: what is new, and the filter's reach"""

    def __call__(self, columns: Array) -> Array:
        """(n,) or (n, k) of a stretch from (samples,) or (samples, k)."""
        out: Array = windows_of(columns.T, self.piece, self.rows.shape[1]) @ self.rows.T
        return out.reshape(*columns.shape[1:], -1).T

    @property
    def taps(self) -> Array:
        """(reach + 1,) oldest sample first."""
        taps: Array = self.rows[-1, -self.reach - 1 :]
        return taps

    @property
    def reach(self) -> int:
        """Samples that it needs beyond what comes out."""
        return int(self.rows.shape[1]) - self.piece


@cache
def piece_of(samples: int, step: int = 1) -> int:
    """The longest part of `samples` that all of it divides into, of a multiple of `step`, and not above PIECE; all of
    it where there is none."""
    fitting = (n for n in range(min(samples, PIECE), 0, -1) if samples % n == 0 and n % step == 0)
    return next(fitting, samples)


def windows_of(signals: Array, piece: int, length: int) -> Array:
    """(..., p, length) of (..., m) signals, one every `piece` samples."""
    starts = range(0, signals.shape[-1] - length + 1, piece)
    return np.stack([signals[..., start : start + length] for start in starts], axis=-2)


def banded(kernel: Array, n: int) -> Array:
    """(n - len(kernel) + 1, n) the kernel, newest sample first, one sample further in each row."""
    rows = n - len(kernel) + 1
    matrix = np.zeros((rows, n))
    for i in range(rows):
        matrix[i, i : i + len(kernel)] = kernel[::-1]
    return matrix
