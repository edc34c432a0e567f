"""Least squares over blocks: normal equations per block, so that leaving blocks out costs a sum."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array, Mask

RIDGE = 1e-11
"""This relative ridge keeps equal columns solvable and changes no digit that matters."""
FOLDS = 6


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

    def fit(self, blocks: Mask | None = None) -> Array:
        """(p,) amplitudes of all or some blocks, free of the bias that noise in the columns would give."""
        used = np.ones(len(self.count), dtype=bool) if blocks is None else blocks
        rows = self.count[used].sum()
        matrix = self.matrix[used].sum(0) - rows * self.noise_matrix
        vector = self.vector[used].sum(0) - rows * self.noise_vector
        return solve(matrix, vector, self.lower, self.upper)

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
        )


def block_sums(
    columns: Array, target: Array, block: NDArray[np.intp], bounds: Array, noise: Array | None = None
) -> BlockSums:
    """Block-wise normal equations of columns (m, p) and target (m,).

    `bounds` (2, p); `noise` (p + 1, p): mean noise products per row, the last line those with the target.
    """
    starts = np.concatenate(([0], np.flatnonzero(np.diff(block)) + 1, [len(block)]))
    pairs = list(itertools.pairwise(starts))
    width = columns.shape[1]
    noise = np.zeros((width + 1, width)) if noise is None else noise
    return BlockSums(
        matrix=np.stack([columns[a:b].T @ columns[a:b] for a, b in pairs]),
        vector=np.stack([columns[a:b].T @ target[a:b] for a, b in pairs]),
        square=np.array([target[a:b] @ target[a:b] for a, b in pairs]),
        count=np.diff(starts).astype(float),
        lower=bounds[0],
        upper=bounds[1],
        noise_matrix=noise[:-1],
        noise_vector=noise[-1],
    )


def free_sums(columns: Array, target: Array, block: NDArray[np.intp]) -> BlockSums:
    """`block_sums` without bounds."""
    wide = np.full((2, columns.shape[1]), np.inf)
    wide[0] *= -1
    return block_sums(columns, target, block, wide)


def solve(matrix: Array, vector: Array, lower: Array, upper: Array) -> Array:
    """Amplitudes (p,) within bounds: columns that leave them are held at the bound (active set, a few rounds)."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-200))
    scaled = matrix / np.outer(scale, scale) + RIDGE * np.eye(len(vector))
    right, low, high = vector / scale, lower * scale, upper * scale
    held = np.zeros(len(vector), dtype=bool)
    a = np.zeros(len(vector))
    for _ in range(len(vector) + 1):
        free = ~held
        if not held.any():
            a = np.linalg.solve(scaled, right)
        elif free.any():
            a[free] = np.linalg.solve(scaled[np.ix_(free, free)], right[free] - scaled[np.ix_(free, held)] @ a[held])
        out = free & ((a < low) | (a > high))
        if not out.any():
            break
        worst = int(np.argmax(np.where(out, np.maximum(low - a, a - high), -np.inf)))
        a[worst] = np.clip(a[worst], low[worst], high[worst])
        held[worst] = True
    result: Array = a / scale
    return result


def square_error(g: BlockSums, a: Array) -> Array:
    """(b,) sum of squared residuals of amplitudes a (p,) in each block."""
    error: Array = g.square - 2 * g.vector @ a + np.einsum("i,bij,j->b", a, g.matrix, a)
    return np.maximum(error, 0.0)


def held_out(g: BlockSums, fold: NDArray[np.intp]) -> Array:
    """(b,) squared error of each block under amplitudes fitted to the other folds; `fold` (b,) numbers them."""
    error = np.empty(len(fold))
    for f in np.unique(fold):
        error[fold == f] = square_error(g, g.fit(fold != f))[fold == f]
    return error


def folds(blocks: int) -> NDArray[np.intp]:
    """(b,) fold of each block: every sixth block together, so that each fold sees the whole recording."""
    return np.arange(blocks) % min(FOLDS, blocks)


def independent(residual: Array, block: NDArray[np.intp], lags: int) -> float:
    """How many independent samples tell the scatter of a residual (m,), whose blocks do not know each other."""
    power = float(residual @ residual)
    if not power > 0:
        return float(len(residual))
    square = 0.0
    for k in range(1, lags):
        together = block[k:] == block[:-k]
        if together.any():
            product = float((residual[k:] * residual[:-k])[together].sum())
            square += (product / power * len(residual) / int(together.sum())) ** 2
    return len(residual) / (1.0 + 2.0 * square)


def surely(before: Array, after: Array) -> float:
    """t of the fall of squared errors (b,), paired over blocks."""
    return max(_t(before - after), _t(np.log(before / after)))


def _t(fall: Array) -> float:
    """Mean over its standard error: of squared errors, where busy blocks rule, or of logarithms, where all count."""
    return float(fall.mean()) / (float(fall.std(ddof=1)) / math.sqrt(len(fall)) + 1e-300)
