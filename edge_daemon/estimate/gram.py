"""Least squares over blocks: normal equations per block, so that leaving blocks out costs a sum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array

RIDGE = 1e-11
"""relative; keeps equal columns solvable and changes no digit that matters"""
FOLDS = 6


@dataclass(frozen=True, slots=True)
class Grams:
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

    @property
    def total(self) -> tuple[Array, Array]:
        """Normal equations of all blocks."""
        return self.matrix.sum(0), self.vector.sum(0)

    def pick(self, columns: Sequence[int]) -> Grams:
        """The same with only some of the columns."""
        i = np.asarray(columns, dtype=np.intp)
        return Grams(
            self.matrix[:, i[:, None], i], self.vector[:, i], self.square, self.count, self.lower[i], self.upper[i]
        )


def grams(
    columns: Array, target: Array, block: NDArray[np.intp], lower: Array, upper: Array, weight: Array | None = None
) -> Grams:
    """Block-wise normal equations of columns (m, p) and target (m,); `weight` (m,) multiplies each row."""
    if weight is not None:
        columns, target = columns * weight[:, None], target * weight
    starts = np.concatenate(([0], np.flatnonzero(np.diff(block)) + 1, [len(block)]))
    pairs = list(zip(starts[:-1], starts[1:], strict=True))
    matrix = np.stack([columns[a:b].T @ columns[a:b] for a, b in pairs])
    vector = np.stack([columns[a:b].T @ target[a:b] for a, b in pairs])
    square = np.array([target[a:b] @ target[a:b] for a, b in pairs])
    return Grams(matrix, vector, square, np.diff(starts).astype(float), lower, upper)


def solve(matrix: Array, vector: Array, lower: Array, upper: Array) -> Array:
    """Amplitudes (p,) within bounds: columns that leave them are held at the bound (active set, a few rounds)."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    scaled = matrix / np.outer(scale, scale) + RIDGE * np.eye(len(vector))
    right, low, high = vector / scale, lower * scale, upper * scale
    held = np.zeros(len(vector), dtype=bool)
    a = np.zeros(len(vector))
    for _ in range(len(vector) + 1):
        free = ~held
        if free.any():
            a[free] = np.linalg.solve(scaled[np.ix_(free, free)], right[free] - scaled[np.ix_(free, held)] @ a[held])
        out = free & ((a < low) | (a > high))
        if not out.any():
            break
        worst = int(np.argmax(np.where(out, np.maximum(low - a, a - high), -np.inf)))
        a[worst] = np.clip(a[worst], low[worst], high[worst])
        held[worst] = True
    result: Array = a / scale
    return result


def square_error(g: Grams, a: Array) -> Array:
    """(b,) sum of squared residuals of amplitudes a (p,) in each block."""
    error: Array = g.square - 2 * g.vector @ a + np.einsum("i,bij,j->b", a, g.matrix, a)
    return np.maximum(error, 0.0)


def held_out(g: Grams, fold: NDArray[np.intp]) -> Array:
    """(b,) squared error of each block under amplitudes fitted to the other folds; `fold` (b,) numbers them."""
    matrix, vector = g.total
    error = np.empty(len(fold))
    for f in np.unique(fold):
        out = fold == f
        a = solve(matrix - g.matrix[out].sum(0), vector - g.vector[out].sum(0), g.lower, g.upper)
        part = Grams(g.matrix[out], g.vector[out], g.square[out], g.count[out], g.lower, g.upper)
        error[out] = square_error(part, a)
    return error


def folds(blocks: int) -> NDArray[np.intp]:
    """(b,) fold of each block: every sixth block together, so that each fold sees the whole recording."""
    return np.arange(blocks) % min(FOLDS, blocks)
