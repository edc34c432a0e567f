"""Inner numbers of a formula by Gauss-Newton, amplitudes by least squares (variable projection, Kaufman 1975)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge_daemon.discover.factors import KINDS, SCALED, Factor, Product
from edge_daemon.discover.leftover import Leftover, numbers_of
from edge_daemon.records import Array

ROUNDS = 12
"""Steps at most; five are usual."""
PATIENCE = 2
"""Steps that every promise gets before it may be given up."""
SETTLED = 1e-4
"""Relative fall of the squared error below which a formula counts as settled."""
STEP = 1e-3
"""Finite difference, over the scale of a number."""
LONGEST = 0.7
"""Longest step of the logarithm of a number."""
DAMPINGS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Of Levenberg and Marquardt, in turn until a step is no worse."""

SPEED, MOVING = "velocity_out_rad_s", ("velocity_out_rad_s", "twist_rate_rad_s")
"""The axis along which a friction turns round, and those whose factors know the direction already."""
STEEP = {"saturation": 0.1, "forward": 0.1, "backward": 0.1, "odd_power": 0.8}
"""Kinds that leap where a motion turns round, below these numbers: a width over the rms of the axis, an exponent."""
REVERSAL_SHARE, TURNED_ROUNDS = 0.01, 5
"""Width of that turn over the rms speed where its search begins, and the steps of it."""
EQUAL = 1e-12
"""Share of a column's power up to which it says nothing that the model or the columns beside it do not: the rounding of
sums of squares is a hundredth of that."""
LEAST_POWER, LARGEST_POWER = 1e-200, 1e120
"""Of a column: below it there is none, beyond it the products of squares overflow."""
TOLD_APART = 1.3
"""Square over that of the better, both at least the noise, up to which data do not tell two formulas apart (guess)."""


@dataclass(frozen=True, slots=True)
class Formula:
    """A sum of products, fitted beside the model."""

    products: tuple[Product, ...]
    amplitudes: tuple[Array, ...]
    """(k,) of each product"""
    square: float
    """sum of squares that it leaves"""
    left: Array
    """(m,) what it leaves"""

    @property
    def price(self) -> int:
        """Free numbers."""
        return sum(product.price for product in self.products)

    @property
    def oddity(self) -> float:
        """How unlike what machines do it is, in numbers."""
        return sum(factor.oddity for product in self.products for factor in product.factors)


def settled(
    leftover: Leftover, products: Sequence[Product], rounds: int = ROUNDS, hopeless: float = math.inf
) -> Formula | None:
    """The formula at rest; None where its columns are no numbers. Given up above a square of `hopeless` after some
    rounds."""
    found = _fitted(leftover, products)
    if found is None:
        return None
    scale = _scales(leftover, products)
    damping = 0
    for i in range(rounds):
        square = found.formula.square
        if not scale.size or (i >= PATIENCE and square > hopeless):
            break
        squares = _squares(leftover, found, _slopes(leftover, found, scale))
        better = None
        for k in range(damping, len(DAMPINGS)):
            step = _step(*squares, DAMPINGS[k])
            better = _fitted(leftover, _moved(found.formula.products, step, scale))
            damping = max(k - 1, 0)
            if better is not None and better.formula.square < square:
                break
            better = None
        if better is None:
            break
        found = better
        if 1 - found.formula.square / square < SETTLED:
            break
    return found.formula


def fitted(leftover: Leftover, products: Sequence[Product]) -> Formula | None:
    """Amplitudes at the inner numbers as they are."""
    found = _fitted(leftover, products)
    return None if found is None else found.formula


@dataclass(frozen=True, slots=True)
class _Fitted:
    """A formula on its way, with what its next step needs."""

    formula: Formula
    columns: Array
    """(m, k) of all its products"""
    known: Array
    """(p, k) what of them the model takes up, along its own columns"""
    inverse: Array
    """(k, k) of their squares beside the model"""


def _fitted(leftover: Leftover, products: Sequence[Product]) -> _Fitted | None:
    columns = leftover.columns(*products)
    own = columns.T @ columns
    if not (np.diagonal(own) < LARGEST_POWER).all():  # nor is it of what is no number
        return None
    known = leftover.known.T @ columns
    inverse = _inverse(own - known.T @ known, np.diagonal(own))
    amplitudes = inverse @ (columns.T @ leftover.left)
    left = leftover.left - columns @ amplitudes + leftover.known @ (known @ amplitudes)
    apart = tuple(amplitudes[at] for at in _places([product.amplitudes for product in products]))
    formula = Formula(tuple(products), apart, float(left @ left), left)
    return _Fitted(formula, columns, known, inverse)


def _places(counts: Sequence[int]) -> list[slice]:
    """Where so many columns each lie beside each other."""
    ends = list(itertools.accumulate(counts))
    return [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]


def _inverse(squares: Array, power: Array) -> Array:
    """(k, k) of squares (k, k), equal columns sharing what they take, and those that are the model's taking nothing;
    `power` (k,) is what each column has by itself."""
    if len(power) == 1:
        told = squares > EQUAL * np.maximum(power, LEAST_POWER)
        return np.asarray(told / np.where(told, squares, 1.0))
    scale = 1.0 / np.sqrt(np.maximum(power, LEAST_POWER))
    values, vectors = np.linalg.eigh(scale[:, None] * squares * scale)
    kept = values > EQUAL
    scaled = scale[:, None] * vectors[:, kept]
    return np.asarray((scaled / values[kept]) @ scaled.T)


def leaps(leftover: Leftover, formula: Formula) -> bool:
    """Whether it leaps where the motion turns round, which a measured rate does not carry exactly."""
    for product in formula.products:
        for factor in product.factors:
            if factor.kind.name == "direction":
                return True
            if factor.axis in MOVING and factor.kind.name in STEEP:
                unit = 1.0 if factor.kind.name == "odd_power" else leftover.spans[factor.axis].rms
                if factor.numbers[0] < STEEP[factor.kind.name] * unit:
                    return True
    return False


def directed(leftover: Leftover, formula: Formula, floor: float) -> Formula | None:
    """The formula with its first torque of a place or a time as a friction there, where the data do not tell the two
    apart: each place was passed one way only."""
    span = leftover.spans.get(SPEED)
    if span is None or not span.two_sided:
        return None
    direction = Factor(KINDS["saturation"], SPEED, (REVERSAL_SHARE * span.rms,))
    for i, product in enumerate(formula.products):
        if not any(factor.axis in MOVING for factor in product.factors):
            turned = Product((*product.factors, direction))
            other = settled(leftover, [*formula.products[:i], turned, *formula.products[i + 1 :]], TURNED_ROUNDS)
            least = max(formula.square, floor**2 * len(formula.left))
            return other if other is not None and other.square < TOLD_APART * least else None
    return None


def _scales(leftover: Leftover, products: Sequence[Product]) -> Array:
    """(q,) unit of each inner number's search; NaN where it is searched by its logarithm."""
    out = []
    for product in products:
        for factor in product.factors:
            span = leftover.spans[factor.axis]
            for way in factor.kind.search:
                turning = factor.kind.name in ("sine", "exponential")
                out.append(math.nan if way == SCALED else 1.0 / span.width if turning else span.width)
    return np.array(out)


def _slopes(leftover: Leftover, found: _Fitted, scale: Array) -> Array:
    """(m, q) derivative of the formula by each inner number, its amplitudes as they are."""
    formula = found.formula
    before = [found.columns[:, at] for at in _places([len(row) for row in formula.amplitudes])]
    moved: list[Product] = []
    mixes: list[Array] = []
    at: list[int] = []
    for i, (product, amplitudes) in enumerate(zip(formula.products, formula.amplitudes, strict=True)):
        for j, number in enumerate(product.numbers):
            numbers = list(product.numbers)
            numbers[j] = _shifted(number, STEP, scale[len(moved)])
            moved.append(product.at(numbers))
            mixes.append(amplitudes)
            at.append(i)
    now = np.array([columns @ mix for columns, mix in zip(before, formula.amplitudes, strict=True)]).T
    return np.asarray((leftover.columns(*moved, mixes=mixes) - now[:, at]) / STEP)


def _squares(leftover: Leftover, found: _Fitted, slopes: Array) -> tuple[Array, Array]:
    """(q, q) of slopes (m, q) where the model and the amplitudes are free to follow, and (q,) what they have in common
    with what is left; zero of one that is no number somewhere, or says what the model and the amplitudes do."""
    slopes[:, ~np.isfinite(slopes.sum(axis=0))] = 0.0
    known, squares = leftover.known.T @ slopes, slopes.T @ slopes
    both = found.columns.T @ slopes - found.known.T @ known
    normal = squares - known.T @ known - both.T @ found.inverse @ both
    told = np.diagonal(normal) > EQUAL * np.diagonal(squares)
    return np.where(told & told[:, None], normal, 0.0), np.where(told, slopes.T @ found.formula.left, 0.0)


def _step(normal: Array, common: Array, damping: float) -> Array:
    """(q,) what numbers move by; those that change nothing stay."""
    own = np.diagonal(normal)
    size = np.maximum(own, EQUAL * max(float(own.max(initial=0.0)), LEAST_POWER))
    step = np.linalg.solve(normal + np.diag(damping * size + (own == 0.0)), common)
    return np.asarray(np.clip(step, -LONGEST, LONGEST))


def _moved(products: Sequence[Product], step: Array, scale: Array) -> list[Product]:
    numbers = [_shifted(n, float(d), s) for n, d, s in zip(numbers_of(products), step, scale, strict=True)]
    return placed(products, numbers)


def placed(products: Sequence[Product], numbers: Sequence[float]) -> list[Product]:
    """The products at given inner numbers, product by product."""
    out, left = [], list(numbers)
    for product in products:
        count = len(product.numbers)
        out.append(product.at(left[:count]))
        left = left[count:]
    return out


def _shifted(number: float, by: float, scale: float) -> float:
    return number * math.exp(by) if math.isnan(scale) else number + by * scale
