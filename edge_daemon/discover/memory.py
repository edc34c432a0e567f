"""The times with which a law follows what was: those of the axes of a formula, made to fit."""

from __future__ import annotations

import math
from dataclasses import replace

from edge_daemon.discover.factors import Product
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.past_axes import Lagging, row_of
from edge_daemon.discover.refining import Formula, settled

FIRST_STEP, NEXT_STEP, LAST_STEP = 0.5, 0.25, 0.02
"""Steps of the logarithm of a time: between two that the search begins with, where all rows go on from few, and such as
data tell apart."""
FARTHEST, LEAST_FALL = 3.0, 1e-4
"""Logarithm of a time over where the search began beyond which it ends, and of the square by a step (guesses)."""
ROUNDS = 3
"""Steps of the other numbers at each time."""

UNKNOWN_SHARE = 0.01
"""Time that a law follows with, over that of the recording, beyond which what was before counts (guess): it shows in
three such times, and with a time of 0.36 s of 20 s a formula was bent to follow the beginning."""


def begun_before(leftover: Leftover, formula: Formula) -> bool:
    """Whether what the gear went through before the recording counts in much of it."""
    most = UNKNOWN_SHARE * leftover.spans["time_s"].width
    axes = {f.axis for product in formula.products for f in product.factors}
    rows = [(axis, row_of(axis)) for axis in axes]
    return any((row.time_of(axis) or 0.0) > most for axis, row in rows if row is not None and not row.inertial)


def timed(leftover: Leftover, formula: Formula) -> Formula | None:
    """The formula at the times that leave least; None where it follows nothing, or those were its own."""
    products = formula.products
    for axis in dict.fromkeys(f.axis for product in products for f in product.factors):
        products = _best(leftover, products, axis)
    return settled(leftover, products) if products != formula.products else None


def _best(leftover: Leftover, products: tuple[Product, ...], axis: str) -> tuple[Product, ...]:
    """On few rows, and from there on all: few are before the filter, and two filters after one another are a delay."""
    row = row_of(axis)
    if row is None:
        return products
    began_s = row.time_of(axis) or 0.0
    for rows, step in ((leftover.thin, FIRST_STEP), (leftover, NEXT_STEP)):
        products, axis = _stepped(leftover, rows, products, (row, axis, began_s), step)
    return products


def _stepped(
    leftover: Leftover, rows: Leftover, products: tuple[Product, ...], start: tuple[Lagging, str, float], step: float
) -> tuple[tuple[Product, ...], str]:
    """The products, and their axis, at the time that leaves least on some rows; `start`: the row, the axis, and the
    time where the search began."""
    row, axis, began_s = start
    found = settled(rows, products, ROUNDS)
    while found is not None and step > LAST_STEP:
        time_s = row.time_of(axis) or began_s
        for other in (time_s * math.exp(step), time_s * math.exp(-step)):
            near = row.at(other)
            leftover.make(near)
            tried = settled(rows, moved(found.products, axis, near), ROUNDS)
            better = tried is not None and tried.square < (1 - LEAST_FALL) * found.square
            if tried is not None and better and abs(math.log(other / began_s)) < FARTHEST:
                found, axis = tried, near
                break
        else:
            step /= 2
    return (products, axis) if found is None else (found.products, axis)


def moved(products: tuple[Product, ...], axis: str, to: str) -> tuple[Product, ...]:
    """The products with one axis in place of another."""
    return tuple(
        Product(tuple(replace(f, axis=to) if f.axis == axis else f for f in product.factors)) for product in products
    )
