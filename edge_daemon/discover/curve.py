"""What was seen beside a formula: the leftover along one axis, the formula's other factors taken as they are."""

from __future__ import annotations

import numpy as np

from edge_daemon.discover.factors import Product
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.refining import Formula
from edge_daemon.explain.results import SeenCurve
from edge_daemon.records import Array

PLACES = 40
"""Points of a curve."""
LEAST_ROWS = 5
"""Rows that make a point."""
STEPS, FLAT = 24, 1e-6
"""Of a curve that may have any shape, and size over the largest below which a step says what others do (guesses)."""
CHANCES = 20
"""Other times at which what is left is held against such a curve (guess: their middle one is known to a quarter)."""


def curve_of(leftover: Leftover, formula: Formula) -> SeenCurve:
    """Of the first product, along the axis of its last factor.

    At each place the seen torque is the slope of the leftover over the product's other factors, times their rms.
    """
    product, amplitudes = formula.products[0], formula.amplitudes[0]
    axis = product.factors[-1].axis
    at, weight = leftover.rows[axis], _others(leftover, product, amplitudes, axis)
    own = leftover.without_known(leftover.columns(product, mixes=[amplitudes])[:, 0])
    seen = formula.left + own
    edges = np.quantile(at, np.linspace(0, 1, PLACES + 1))
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, PLACES - 1)
    count = np.bincount(place, minlength=PLACES)
    kept = count >= LEAST_ROWS
    power = np.maximum(np.bincount(place, weight**2, PLACES), 1e-300)

    def slope(signal: Array) -> Array:
        values: Array = (np.bincount(place, signal * weight, PLACES) / power)[kept]
        return values

    middle = (np.bincount(place, at, PLACES) / np.maximum(count, 1))[kept]
    return SeenCurve(axis, middle + leftover.shift.get(axis, 0.0), slope(seen), slope(own))


def _others(leftover: Leftover, product: Product, amplitudes: Array, axis: str) -> Array:
    """(m,) a product's factors on other axes, of power one; of a sine the stronger of its waves."""
    weight = np.ones(len(leftover.left))
    for factor in product.factors:
        if factor.axis != axis:
            columns = factor.columns(leftover.rows)
            strongest = int(np.argmax(np.abs(amplitudes))) if len(columns) == len(amplitudes) else 0
            weight = weight * columns[strongest]
    out: Array = weight / max(float(np.sqrt(np.mean(weight**2))), 1e-300)
    return out


def bent(leftover: Leftover, formula: Formula) -> float:
    """Largest share of what a formula leaves that a curve of any shape takes along one of its axes, the other factors
    of the product as they are: near nothing where its shape is right, whatever else is left (lack of fit). Beyond what
    such a curve takes by chance, as it does of the same course at other times: slow dirt is much like any slow axis."""
    shares = [0.0]
    size = len(formula.left)
    turns = np.linspace(0, size, CHANCES + 2).astype(int)[:-1]
    courses = np.stack([np.roll(formula.left, turn) for turn in turns], axis=1)
    for product, amplitudes in zip(formula.products, formula.amplitudes, strict=True):
        for axis in {factor.axis for factor in product.factors}:
            at = leftover.rows[axis]
            place = np.searchsorted(np.quantile(at, np.linspace(0, 1, STEPS + 1)[1:-1]), at, side="right")
            steps = np.zeros((size, STEPS))
            steps[np.arange(size), place] = _others(leftover, product, amplitudes, axis)
            basis, sizes, _ = np.linalg.svd(leftover.without_known(steps), full_matrices=False)
            taken, *by_chance = np.sum((basis[:, sizes > FLAT * sizes[0]].T @ courses) ** 2, axis=0) / formula.square
            shares.append(float(taken - np.median(by_chance)))
    return max(shares)
