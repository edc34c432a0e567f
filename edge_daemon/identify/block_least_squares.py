"""Least squares over blocks: normal equations per block, so that leaving blocks out costs a sum."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge_daemon.identify.bounded_least_squares import solve
from edge_daemon.records import Array, Mask

FOLDS = 6
LEAST_PHASES = 4
"""A motion that repeats itself within fewer blocks is not held out by its phase: too much would be unseen (guess)."""
MOST_POINTS, LONGEST_PERIOD, REPEATED = 1500, 0.6, 0.05
"""A period is looked for on so many points, up to this share of the recording, and found where the motion differs from
itself by no more than this share: the steps of the points leave half of that, a robot's repetition a hundredth."""
MUCH_NOISE, MOST_NOISE = 0.4, 0.5
"""Share of a column's power above which its noise is taken out in part, and not at all (guesses)."""
EVERY = slice(None)
"""Blocks where none are chosen."""


def taken_out(own: float, power: float) -> float:
    """How much of a noise in a column is taken out of its power: all of a small one, nothing of one that makes most of
    it, whose signal nobody knows, and no leap between."""
    share = own / max(power, 1e-300)
    return own * min(max((MOST_NOISE - share) / (MOST_NOISE - MUCH_NOISE), 0.0), 1.0)


@dataclass(frozen=True, slots=True)
class BlockSums:
    """Normal equations of `columns @ a = target`, block by block."""

    matrix: Array
    """(b, p, p)"""
    vector: Array
    """(b, p)"""
    square: Array
    """(b,) target squared"""
    count: Array
    """(b,) rows"""
    lower: Array
    """(p,) bounds of the amplitudes"""
    upper: Array
    noise_matrix: Array
    """(p, p) what sensor noise adds to the matrix per row, on average"""
    noise_vector: Array
    """(p,) what sensor noise adds to the vector per row, on average"""
    hushed: Array | None = None
    """(p, p) noise per row that columns take out of that of others, as a filter does: it explains nothing"""

    def fit(self, blocks: Mask | None = None) -> Array:
        """(p,) amplitudes of all or some blocks, free of the bias that noise in the columns would give."""
        used = np.ones(len(self.count), dtype=bool) if blocks is None else blocks
        rows, matrix, vector = self.count[used].sum(), self.matrix[used].sum(0), self.vector[used].sum(0)
        return solve(matrix - rows * self.noise_matrix, vector - rows * self.noise_vector, self.lower, self.upper)

    def hushing(self, hushed: Array | None) -> BlockSums:
        """The same with what columns take out of the noise of others; where noise is taken out of the sums at all, as
        much of that as of a column's own (`taken_out`)."""
        if hushed is None:
            return self
        power = np.diagonal(self.matrix.sum(axis=0)) / self.count.sum()
        own = [(-hushed[i, i], power[i]) for i in np.flatnonzero(np.diagonal(hushed))]
        part = min((taken_out(*row) / row[0] for row in own), default=0.0) if self.noise_matrix.any() else 0.0
        return replace(self, noise_matrix=self.noise_matrix - part * hushed, hushed=hushed)

    def pick(self, columns: Sequence[int]) -> BlockSums:
        """The same with only some of the columns."""
        i = np.asarray(columns, dtype=np.intp)
        square = i[:, None], i
        return BlockSums(
            self.matrix[:, i[:, None], i],
            self.vector[:, i],
            self.square,
            self.count,
            self.lower[i],
            self.upper[i],
            self.noise_matrix[square],
            self.noise_vector[i],
            None if self.hushed is None else self.hushed[square],
        )


def block_sums(
    columns: Array, target: Array, block: NDArray[np.intp], bounds: Array, noise: Array | None = None
) -> BlockSums:
    """Block-wise normal equations of columns (m, p) and target (m,).

    `bounds` (2, p); `noise` (p + 1, p): mean noise products per row, the last line those with the target.
    """
    starts = np.concatenate(([0], np.flatnonzero(np.diff(block)) + 1, [len(block)]))
    width = columns.shape[1]
    noise = np.zeros((width + 1, width)) if noise is None else noise
    every = np.column_stack((columns, target))
    sums = np.stack([every[a:b].T @ every[a:b] for a, b in itertools.pairwise(starts)])
    return BlockSums(
        matrix=sums[:, :-1, :-1],
        vector=sums[:, :-1, -1],
        square=sums[:, -1, -1],
        count=np.diff(starts).astype(float),
        lower=bounds[0],
        upper=bounds[1],
        noise_matrix=noise[:-1],
        noise_vector=noise[-1],
    )


class MovingColumns:
    """Normal equations of all rows at once, again and again, where only some of the columns change."""

    def __init__(self, sums: BlockSums, columns: Array, target: Array, moving: Mask) -> None:
        self.sums, self.target = sums, target
        self.still, self.moving = np.flatnonzero(~moving), np.flatnonzero(moving)
        self.kept = columns[:, self.still]

    def left_by(self, columns: Array, hushed: Array | None = None) -> Array:
        """(m,) what a fit with other columns (m, k) in the place of those that move leaves, and what that hushes."""
        matrix, vector = self.sums.matrix.copy(), self.sums.vector.copy()
        cross = self.kept.T @ columns
        matrix[0, self.moving[:, None], self.moving] = columns.T @ columns
        matrix[0, self.still[:, None], self.moving] = cross
        matrix[0, self.moving[:, None], self.still] = cross.T
        vector[0, self.moving] = self.target @ columns
        sums = replace(self.sums, matrix=matrix, vector=vector).hushing(hushed)
        a = sums.fit()
        left = self.target - self.kept @ a[self.still] - columns @ a[self.moving]
        if sums.hushed is None:
            return left
        return np.append(left, math.sqrt(max(float(a @ sums.hushed @ a), 0.0) * len(left)))


def free_sums(columns: Array, target: Array, block: NDArray[np.intp]) -> BlockSums:
    """`block_sums` without bounds."""
    wide = np.full((2, columns.shape[1]), np.inf)
    wide[0] *= -1
    return block_sums(columns, target, block, wide)


def square_error(g: BlockSums, a: Array, blocks: Mask | slice = EVERY) -> Array:
    """(b,) sum of squared residuals of amplitudes a (p,) in each block, or in some of them, with what they hush."""
    error: Array = g.square[blocks] - 2 * g.vector[blocks] @ a + (g.matrix[blocks] @ a) @ a
    if g.hushed is not None:
        error = error + g.count[blocks] * max(float(a @ g.hushed @ a), 0.0)
    return np.maximum(error, 0.0)


def held_out(g: BlockSums, fold: NDArray[np.intp]) -> Array:
    """(b,) squared error of each block under amplitudes fitted to the other folds; `fold` (b,) numbers them."""
    error = np.empty(len(fold))
    for f in np.unique(fold):
        own = fold == f
        error[own] = square_error(g, g.fit(~own), own)
    return error


def folds(blocks: int) -> NDArray[np.intp]:
    """(b,) fold of each block: every sixth block together, so that each fold sees the whole recording."""
    return np.arange(blocks) % min(FOLDS, blocks)


def folds_of_phase(start_s: Array, period_s: float, block_s: float) -> NDArray[np.intp]:
    """(b,) the same along a motion that repeats itself: blocks of one phase together, since what a law lacks repeats
    as well, and a block that is held out would be known by its twin of another turn."""
    phases = int(period_s / block_s)
    if phases < LEAST_PHASES:
        return folds(len(start_s))
    phase = ((start_s - start_s[0]) / period_s % 1.0 * phases).astype(np.intp)
    return np.asarray(phase % min(FOLDS, phases))


def repeats_after(rate_hz: float, angle: Array) -> float:
    """Seconds after which a motion (n,) repeats itself, 0 where it does not: the first lag of least difference."""
    step = max(1, len(angle) // MOST_POINTS)
    q = angle[::step] - angle[::step].mean()
    lags = np.arange(1, int(LONGEST_PERIOD * len(q)))
    if not len(lags):
        return 0.0
    apart = np.array([np.mean((q[k:] - q[:-k]) ** 2) for k in lags]) / max(float(np.mean(q**2)), 1e-300)
    alike = np.flatnonzero(apart < REPEATED**2)
    left = np.flatnonzero(apart > 1.0)
    again = alike[alike > left[0]] if len(left) else alike[:0]
    if not len(again):
        return 0.0
    run = again[: int(np.argmax(np.diff(again, append=np.iinfo(np.intp).max) > 1)) + 1]
    return float(lags[run[np.argmin(apart[run])]] * step / rate_hz)
