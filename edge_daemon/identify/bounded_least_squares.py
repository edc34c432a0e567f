"""Least squares from normal equations, within bounds."""

from __future__ import annotations

import numpy as np

from edge_daemon.records import Array, Mask

RIDGE = 1e-11
"""This relative ridge keeps equal columns solvable and changes no digit that matters."""
LET_GO = 1e-9
"""Slope of the squared error over the largest product with the target from which a bound is left: above rounding."""


def solve(matrix: Array, vector: Array, lower: Array, upper: Array) -> Array:
    """Amplitudes (p,) within bounds (Stark & Parker 1995, Comput. Stat. 10): what leaves them is held at the bound, and
    let go again where the error would fall: of columns that are nearly one, the first to leave need not be the one."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-200))
    scaled = matrix / np.outer(scale, scale) + RIDGE * np.eye(len(vector))
    right, low, high = vector / scale, lower * scale, upper * scale
    held, a = np.zeros(len(vector), dtype=bool), np.zeros(len(vector))
    for _ in range(len(vector) + 1):
        a = _free(scaled, right, a, ~held)
        out = ~held & ((a < low) | (a > high))
        if not out.any():
            break
        worst = int(np.argmax(np.where(out, np.maximum(low - a, a - high), -np.inf)))
        a[worst], held[worst] = np.clip(a[worst], low[worst], high[worst]), True
    for _ in range(len(vector) if held.any() else 0):
        downhill = right - scaled @ a
        inward = np.where(held & (low < high), np.where(a <= low, downhill, -downhill), 0.0)
        best = int(np.argmax(inward))
        if not inward[best] > LET_GO * np.max(np.abs(right)):
            break
        a, held = _let_go(scaled, right, a, held, best, (low, high))
    return np.asarray(a / scale)


def _free(matrix: Array, right: Array, a: Array, free: Mask) -> Array:
    """The amplitudes with the free ones solved for beside the others."""
    if free.all():
        return np.asarray(np.linalg.solve(matrix, right))
    a = a.copy()
    if free.any():
        a[free] = np.linalg.solve(matrix[np.ix_(free, free)], right[free] - matrix[np.ix_(free, ~free)] @ a[~free])
    return a


def _let_go(
    matrix: Array, right: Array, a: Array, held: Mask, which: int, bounds: tuple[Array, Array]
) -> tuple[Array, Mask]:
    """One amplitude let go, and those held that meet a bound on the way to the new solution."""
    held = held.copy()
    held[which] = False
    for _ in range(len(a)):
        step = _free(matrix, right, a, ~held) - a
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(step < 0, (bounds[0] - a) / step, np.where(step > 0, (bounds[1] - a) / step, np.inf))
        first = int(np.argmin(np.where(held, np.inf, room)))
        if held.all() or room[first] >= 1:
            return a + step, held
        a = np.clip(a + max(room[first], 0.0) * step, *bounds)
        held[first] = True
    return a, held
