"""Extremely randomised trees (Geurts, Ernst and Wehenkel 2006), grown all at once level by level in numpy.

Each tree sees a part of the groups of rows only, so that the others tell how well it forecasts what it has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array

TREES = 300
SEEN = 0.9
"""Each tree grows on this share of the groups: the fewer left out, the more alike seen and unseen; with 300 trees each
of fifteen groups is still left out of forty."""
LEAST_ROWS = 2
"""A leaf holds at least this many rows."""
DEEPEST = 24
SEED = 1865

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Forest:
    """Nodes of all trees in one table, (nodes,) each; a leaf is its own child."""

    feature: Indices
    edge: Array
    """values up to it go to the first child"""
    child: Indices
    """the first; the second follows it"""
    value: Array
    """mean of the targets in a node"""
    unseen: NDArray[np.bool_]
    """(trees, groups)"""

    def told(self, x: Array) -> Array:
        """(trees, rows) what each tree says of rows (rows, features)."""
        return np.asarray(self.value[self.leaves(x)])

    def leaves(self, x: Array) -> Indices:
        """(trees, rows) in which leaf each row ends."""
        trees, rows = len(self.unseen), np.arange(len(x))
        at = np.repeat(np.arange(trees)[:, None], len(x), axis=1)
        for _ in range(DEEPEST):
            inner = self.child[at] > 0
            if not inner.any():
                break
            right = x[rows, self.feature[at]] > self.edge[at]
            at = np.where(inner, self.child[at] + right, at)
        return at


def grow(x: Array, y: Array, group: Indices, trees: int = TREES) -> Forest:
    """A forest for targets `y` (n,) of rows `x` (n, features) that belong to groups 0, 1, ..."""
    rng = np.random.default_rng(SEED)
    groups = int(group.max()) + 1
    unseen = _left_out(rng, trees, groups)
    tree, row = np.nonzero(~unseen[:, group])
    node = tree
    columns: list[list[Array]] = [[], [], [], []]
    first, count = 0, trees
    for level in range(DEEPEST):
        split = _best_splits(rng, x, y, row, node - first, count, level < DEEPEST - 1)
        feature, edge, value, gain = split
        inner = gain > 0.0
        child = np.where(inner, first + count + 2 * (np.cumsum(inner) - 1), 0)
        for column, values in zip(columns, (feature, edge, child, value), strict=True):
            column.append(values)
        if not inner.any():
            break
        at = node - first
        going = inner[at]
        row, at = row[going], at[going]
        node = child[at] + (x[row, feature[at]] > edge[at])
        order = np.argsort(node, kind="stable")
        row, node = row[order], node[order]
        first, count = first + count, 2 * int(inner.sum())
    feature, edge, child, value = (np.concatenate(column) for column in columns)
    return Forest(feature.astype(np.intp), edge, child.astype(np.intp), value, unseen)


def _left_out(rng: np.random.Generator, trees: int, groups: int) -> NDArray[np.bool_]:
    """(trees, groups) which groups a tree does not see: the same number for each, each group about equally often."""
    few = max(round((1.0 - SEEN) * groups), 1)
    turns = -(-trees * few // groups)
    order = np.concatenate([rng.permutation(groups) for _ in range(turns)])[: trees * few].reshape(trees, few)
    unseen = np.zeros((trees, groups), dtype=bool)
    unseen[np.arange(trees)[:, None], order] = True
    return unseen


def _best_splits(
    rng: np.random.Generator, x: Array, y: Array, row: Indices, node: Indices, count: int, deeper: bool
) -> tuple[Array, Array, Array, Array]:
    """(count,) each: for every node, with its rows sorted by node, the best of one random edge per feature."""
    starts = np.searchsorted(node, np.arange(count))
    size = np.diff(np.append(starts, len(node))).astype(float)
    total = np.add.reduceat(y[row], starts)
    best, feature, edge = np.zeros(count), np.zeros(count), np.zeros(count)
    if deeper:
        for j in range(x.shape[1]):
            values = x[row, j]
            low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
            cut = low + (high - low) * rng.uniform(size=count)
            left = values <= cut[node]
            few = np.add.reduceat(left.astype(float), starts)
            part = np.add.reduceat(np.where(left, y[row], 0.0), starts)
            many = size - few
            gain = part**2 / np.maximum(few, 1.0) + (total - part) ** 2 / np.maximum(many, 1.0) - total**2 / size
            better = (gain > best + 1e-12) & (np.minimum(few, many) >= LEAST_ROWS)
            best, feature, edge = (np.where(better, new, old) for new, old in ((gain, best), (j, feature), (cut, edge)))
    return feature.astype(np.intp), edge, total / size, best
