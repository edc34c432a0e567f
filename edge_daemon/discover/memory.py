"""The times with which a law follows what was: those of the axes of a formula, made to fit."""

from __future__ import annotations

import math
from dataclasses import replace

from edge_daemon.discover.factors import Product
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.past_axes import LAGGING
from edge_daemon.discover.refining import Formula, settled

FIRST_STEP, LAST_STEP = 0.5, 0.02
"""Steps of the logarithm of a time: between two that the search begins with, and such as data tell apart."""
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
    return any((row.time_of(axis) or 0.0) > most for axis in axes for row in LAGGING if not row.inertial)


def timed(leftover: Leftover, formula: Formula) -> Formula | None:
    """The formula at the times that leave least; None where it follows nothing, or those were its own."""
    products = formula.products
    for axis in dict.fromkeys(f.axis for product in products for f in product.factors):
        products = _best(leftover, products, axis)
    return settled(leftover, products) if products != formula.products else None


def _best(leftover: Leftover, products: tuple[Product, ...], axis: str) -> tuple[Product, ...]:
    row, time_s = next(((row, t) for row in LAGGING if (t := row.time_of(axis)) is not None), (None, 0.0))
    found = None if row is None else settled(leftover.thin, products, ROUNDS)
    if row is None or found is None:
        return products
    best, step = (found, axis, time_s), FIRST_STEP
    while step > LAST_STEP and abs(math.log(best[2] / time_s)) < FARTHEST:
        for by in (step, -step):
            other, near = best[2] * math.exp(by), row.at(best[2] * math.exp(by))
            leftover.make(near)
            tried = settled(leftover.thin, _moved(best[0].products, best[1], near), ROUNDS)
            if tried is not None and tried.square < (1 - LEAST_FALL) * best[0].square:
                best = tried, near, other
                break
        else:
            step /= 2
    return best[0].products


def _moved(products: tuple[Product, ...], axis: str, to: str) -> tuple[Product, ...]:
    """The products with one axis in place of another."""
    return tuple(
        Product(tuple(replace(f, axis=to) if f.axis == axis else f for f in product.factors)) for product in products
    )
