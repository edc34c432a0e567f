"""The times with which a law follows what was: those of the axes of a formula, made to fit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from edge_daemon.discover.factors import CLOCK, FADE, Factor, Product, fade
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.past_axes import Lagging, row_of
from edge_daemon.discover.refining import Formula, settled

FIRST_STEP, LAST_STEP = 0.5, 0.02
"""Steps of the logarithm of a time: between two that the search begins with, and such as data tell apart."""
NEAR_STEP, NEAR_LOOKS = 0.1, 4
"""Step of it at which all rows are asked first, where few have led near, and how often (guesses)."""
FARTHEST, LEAST_FALL = 3.0, 1e-4
"""Logarithm of a time over where the search began beyond which it ends, and of the square by a step (guesses)."""
LAG = "lag("
"""What brings along what was before."""
ROUNDS = 3
"""Steps of the other numbers at each time."""

UNKNOWN_SHARE = 0.01
"""Time that a law follows with, over that of the recording, beyond which what was before counts (guess): it shows in
three such times, and with a time of 0.36 s of 20 s a formula was bent to follow the beginning."""


def begun_before(leftover: Leftover, formula: Formula) -> bool:
    """Whether what the gear went through before the recording counts in much of it, and was not asked for: beside what
    is proportional to what follows, the data tell it (`with_beginning`)."""
    most = UNKNOWN_SHARE * leftover.spans[CLOCK].width
    axes = {f.axis for product in formula.products for f in product.factors if f.kind.name != "power_1"}
    rows = [(axis, row_of(axis)) for axis in axes]
    return any((row.time_of(axis) or 0.0) > most for axis, row in rows if row is not None and row.over == "time")


def roughly_timed(leftover: Leftover, formula: Formula) -> Formula | None:
    """The formula on few rows, at the times that leave least there."""
    products = formula.products
    for axis in _axes(products):
        products = _stepped(leftover, products, axis)
    return settled(leftover.thin, products, ROUNDS)


def timed(leftover: Leftover, products: tuple[Product, ...]) -> Formula | None:
    """A formula on all rows, at the times near its own that leave least: few rows are before the filter, and two
    filters after one another are a delay."""
    for axis in _axes(products):
        products = _near(leftover, products, axis)
    return settled(leftover, products)


def with_beginning(leftover: Leftover, products: tuple[Product, ...]) -> tuple[Product, ...]:
    """The formula with what the gear went through before the recording, of which each law that follows with a time has
    forgotten a part more at each instant; the same where none does."""
    return (*products, *(part for product in products for part in _brought_along(leftover, product)))


def _brought_along(leftover: Leftover, product: Product) -> Iterator[Product]:
    """What a product holds of before, for each of its factors that follows with a time."""
    for factor in product.factors:
        row = row_of(factor.axis)
        if row is not None and row.over == "time" and LAG in factor.axis and factor.kind.name == "power_1":
            rest = (other for other in product.factors if other is not factor)
            yield Product((*rest, _fading(leftover, row.time_of(factor.axis) or 0.0)))


def _fading(leftover: Leftover, after_s: float) -> Factor:
    return Factor(fade(after_s, leftover.spans[CLOCK].low), CLOCK)


def _axes(products: tuple[Product, ...]) -> tuple[str, ...]:
    """Axes of a formula that have a time."""
    return tuple(dict.fromkeys(f.axis for product in products for f in product.factors if row_of(f.axis)))


def _stepped(leftover: Leftover, products: tuple[Product, ...], axis: str) -> tuple[Product, ...]:
    """The products with an axis at the time that leaves least on few rows."""
    row, began_s = _time_of(axis)
    found, step = settled(leftover.thin, products, ROUNDS), FIRST_STEP
    while found is not None and step > LAST_STEP:
        time_s = row.time_of(axis) or began_s
        for other in (time_s * math.exp(step), time_s * math.exp(-step)):
            tried = _at(leftover, leftover.thin, found, axis, row.at(other))
            better = tried is not None and tried.square < (1 - LEAST_FALL) * found.square
            if tried is not None and better and abs(math.log(other / began_s)) < FARTHEST:
                found, axis = tried, row.at(other)
                break
        else:
            step /= 2
    return products if found is None else found.products


def _near(leftover: Leftover, products: tuple[Product, ...], axis: str) -> tuple[Product, ...]:
    """The products with an axis at the time that leaves least on all rows: where a parabola through it and one to
    either side has its lowest point, again from there where that lies beyond them, and once more of closer ones."""
    found, step = settled(leftover, products, ROUNDS), NEAR_STEP
    for _ in range(NEAR_LOOKS):
        row, time_s = _time_of(axis)
        if found is None or not time_s:
            break
        sides = [_at(leftover, leftover, found, axis, row.at(time_s * math.exp(by))) for by in (-step, step)]
        before, after = (found.square if side is None else side.square for side in sides)
        bend = before + after - 2 * found.square
        by = 0.5 * step * (before - after) / bend if bend > 0 else math.copysign(math.inf, before - after)
        lowest = row.at(time_s * math.exp(min(max(by, -2 * step), 2 * step)))
        tried = _at(leftover, leftover, found, axis, lowest)
        if tried is not None and tried.square < (1 - LEAST_FALL) * found.square:
            found, axis = tried, lowest
        elif step < NEAR_STEP:
            break
        if abs(by) < step:
            step = LAST_STEP
    return products if found is None else found.products


def _time_of(axis: str) -> tuple[Lagging, float]:
    """The row of an axis that has a time, and that time."""
    row = row_of(axis)
    assert row is not None
    return row, row.time_of(axis) or 0.0


def _at(leftover: Leftover, rows: Leftover, formula: Formula, axis: str, to: str) -> Formula | None:
    """The formula with one axis in place of another, on some rows of the leftover; None where that does not move."""
    leftover.make(to)
    if not leftover.spans[to].width > 0:
        return None
    row, after_s = _time_of(to)
    products = moved(formula.products, axis, to)
    if row.over == "time":
        fading = _fading(leftover, after_s)
        products = tuple(Product(tuple(fading if f.kind.name == FADE else f for f in p.factors)) for p in products)
    return settled(rows, products, ROUNDS)


def moved(products: tuple[Product, ...], axis: str, to: str) -> tuple[Product, ...]:
    """The products with one axis in place of another."""
    return tuple(
        Product(tuple(replace(f, axis=to) if f.axis == axis else f for f in product.factors)) for product in products
    )
