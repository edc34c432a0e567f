"""A formula as an expression that `add --expression` takes, with no more digits than the data ask for, and in words."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.discover.factors import KINDS, ONE_WAY, Factor, Product
from edge_daemon.discover.leftover import Leftover, numbers_of
from edge_daemon.discover.past_axes import LATE_AXIS, SINCE_REVERSAL, SINCE_TWIST_REVERSAL, WAY_GONE, words_of
from edge_daemon.discover.refining import Formula, fitted, placed, settled
from edge_daemon.effects.expression import LETTERS, MISREAD, MOTOR
from edge_daemon.records import Array

ROUNDED = 1.002
"""Square over that of the exact numbers up to which a number is written shorter."""
SHORTER = 1.01
"""The same for each number that a formula saves by a factor less."""
NEARLY_WHOLE = 0.1
"""By how much a power that is not whole for being searched may miss it (guess)."""
HOPELESS = 1.5
"""Square over that from which a simpler formula, at rest on few rows, is given up on all after some steps (guess)."""
PROMISING = 2.0
"""Square over that of the longer formula, on few rows, up to which a simpler one is tried on all."""
MOST_DIGITS = 7
SLIGHT = 1e-3
"""Share of a product's torque below which a column of it is left out."""
AXIS_WORDS = {
    "theta_in_rad": ("the motor angle", "rad"),
    "theta_out_rad": ("the output angle", "rad"),
    "twist_rad": ("the twist", "rad"),
    "twist_rate_rad_s": ("the twist rate", "rad/s"),
    "velocity_out_rad_s": ("the output speed", "rad/s"),
    "acceleration_out_rad_s2": ("the output acceleration", "rad/s^2"),
    MOTOR: ("the motor's torque", ""),
    "temperature_degC": ("the temperature", "degC"),
    "time_s": ("the time", "s"),
    SINCE_REVERSAL: ("the time since the output turned round", "s"),
    SINCE_TWIST_REVERSAL: ("the time since the twist turned round", "s"),
    WAY_GONE: ("the way that the output has gone", "rad"),
}
"""Name and unit of each axis in a sentence."""


def axis_words(axis: str) -> tuple[str, str]:
    """Name and unit of any axis in a sentence; of a further channel its own name."""
    return words_of(axis) or AXIS_WORDS.get(axis, (axis, ""))


MEASURED_BY = (
    "saturation",
    *ONE_WAY,
    "full_size",
    "step",
    "window",
    "beyond",
    "short_of",
    "size_exponential",
    "bump",
    "spot",
    "above",
    "below",
    "dead_zone",
    "beyond_size",
    "reciprocal",
    "resonance",
)
"""Kinds whose numbers have the unit of their axis."""
NEARLY_STRAIGHT = ("saturation", "above", "below", "sine", "step", "dead_zone")
"""Kinds that may be a straight line through zero, where the data do not reach their bend."""
FRICTION = {(kind, axis) for kind in ("saturation", "direction") for axis in ("velocity_out_rad_s", "twist_rate_rad_s")}
DRAG = {("power_1", "velocity_out_rad_s"), ("power_1", "twist_rate_rad_s")}
STIFFNESS = {("power_1", "twist_rad")}
"""Factors by which a torque is called a friction, a drag or a stiffness."""


@dataclass(frozen=True, slots=True)
class Written:
    """A formula in both languages."""

    expression: str
    reads: str
    values: dict[str, float]
    """of the amplitudes"""


def plainer(leftover: Leftover, formula: Formula, floor: float) -> Formula:
    """The formula without factors that the data do not ask for, and at round numbers."""
    noise = floor**2 * len(formula.left)
    best = fitted(leftover, [joined(product) for product in formula.products]) or formula
    for _ in range(3):
        tries = [(products, _most(products, best, noise)) for products in _promising(leftover, best)]
        shorter = ((settled(leftover, products, 8, HOPELESS * most), most) for products, most in tries)
        fine = (f for f, most in shorter if f is not None and max(f.square, noise) < most)
        simpler = next(fine, None)
        if simpler is None:
            break
        best = simpler
    strained = any(product.strained(leftover.spans) for product in best.products)
    return rounded(leftover, formula if strained else best, floor)


def with_constant(leftover: Leftover, formula: Formula, floor: float) -> Formula:
    """A formula that was found beside a constant, with one where it is worth its number."""
    leftover = leftover.alone or leftover
    longer, noise = fitted(leftover, [*formula.products, Product(())]), floor**2 * len(formula.left)
    if longer is None:
        return formula
    most = _most(formula.products, longer, noise)
    shorter = settled(leftover, formula.products, hopeless=HOPELESS * most)
    return shorter if shorter is not None and max(shorter.square, noise) < most else longer


def _most(simpler: Sequence[Product], best: Formula, noise: float) -> float:
    """Square up to which the numbers that a formula saves are worth more than what it leaves more."""
    saved = best.price - sum(product.price for product in simpler)
    return float(SHORTER ** (saved + 1) * max(best.square, noise))


def _promising(leftover: Leftover, best: Formula) -> list[Sequence[Product]]:
    """The simpler formulas of which few rows say that they may do, the shortest first."""
    long = fitted(leftover.thin, best.products)
    tries = [settled(leftover.thin, products) for products in _simplified(best.products)]
    fine = [f for f in tries if f is not None and long is not None and f.square < PROMISING * long.square]
    return [f.products for f in sorted(fine, key=lambda f: (f.price, f.square))]


def _simplified(products: Sequence[Product]) -> list[list[Product]]:
    """The formula with a factor, or a product, less; or a factor by its simpler kin."""
    out = []
    for i, product in enumerate(products):
        before, after = products[:i], products[i + 1 :]
        if any(other.factors for other in (*before, *after)):
            out.append([*before, *after])
        for j, factor in enumerate(product.factors):
            others = product.factors[:j], product.factors[j + 1 :]
            if others[0] or others[1]:
                out.append([*before, Product((*others[0], *others[1])), *after])
            out += [[*before, joined(Product((*others[0], kin, *others[1]))), *after] for kin in related(factor)]
    return out


def joined(product: Product) -> Product:
    """The product with two whole powers of one axis as one."""
    for one, other in itertools.combinations(product.factors, 2):
        powers = [f.kind.name.removeprefix("power_") for f in (one, other)]
        if one.axis == other.axis and all(power.isdigit() for power in powers):
            kind = KINDS.get(f"power_{int(powers[0]) + int(powers[1])}")
            if kind is not None:
                rest = tuple(f for f in product.factors if f is not one and f is not other)
                return Product((*rest, Factor(kind, one.axis)))
    return product


def related(factor: Factor) -> list[Factor]:
    """Factors with fewer numbers, or of no past, that may be the same."""
    if (late := LATE_AXIS.fullmatch(factor.axis)) is not None:
        return [replace(factor, axis=late[2])]
    if factor.kind.name in NEARLY_STRAIGHT:
        return [Factor(KINDS["power_1"], factor.axis)]
    if factor.kind.name in ("size", "odd_power"):
        whole = round(factor.numbers[0])
        odd = whole % 2 == (factor.kind.name == "odd_power")
        if whole in (1, 2, 3) and odd:
            return [Factor(KINDS[f"power_{whole}"], factor.axis)]
    if factor.kind.name == "affine":
        return [Factor(KINDS["power_1"], factor.axis)]
    if factor.kind.name == "beyond_size":
        return [Factor(KINDS["size"], factor.axis, (1.0,))]
    return []


def whole(leftover: Leftover, formula: Formula) -> Formula | None:
    """The formula with every power that is nearly whole as that, if one is: what the motor makes is known to the model
    alone, and bends a power until the law itself is part of that."""
    products = [Product(tuple(map(_whole, product.factors))) for product in formula.products]
    return fitted(leftover, products) if products != list(formula.products) else None


def _whole(factor: Factor) -> Factor:
    power = factor.numbers[0] if factor.kind.name in ("size", "odd_power") else math.inf
    near = math.isfinite(power) and abs(power - round(power)) < NEARLY_WHOLE
    return next(iter(related(factor)), factor) if near else factor


def rounded(leftover: Leftover, formula: Formula, floor: float) -> Formula:
    """Each number with as few digits as the data let it have."""
    numbers = numbers_of(formula.products)
    most = ROUNDED * max(formula.square, floor**2 * len(formula.left))
    for i, number in enumerate(numbers):
        for digits in range(1, MOST_DIGITS + 1):
            tried = [*numbers[:i], float(f"{number:.{digits}g}"), *numbers[i + 1 :]]
            found = fitted(leftover, placed(formula.products, tried))
            if found is not None and found.square < most:
                numbers = tried
                break
    return fitted(leftover, placed(formula.products, numbers)) or formula


def set_off(leftover: Leftover, formula: Formula) -> list[Formula]:
    """The formula with one factor less its middle value each: beside a model that holds the rest of its product the
    same, but for bounds. A drag that falls with warmth would need one below nought where the warmth is."""
    out = []
    for i, product in enumerate(formula.products):
        amplitudes = formula.amplitudes[i]
        for factor in product.factors if len(product.factors) > 1 and len(amplitudes) == 1 else ():
            rest = tuple(other for other in product.factors if other is not factor)
            middle = 0.5 * float(np.ptp(column := factor.columns(leftover.rows)[0])) + float(column.min())
            parts = [(Product(rest), -middle * amplitudes), (product, amplitudes)]
            if factor.kind.name == "power_1":
                straight = Product((*rest, Factor(KINDS["affine"], factor.axis)))
                parts = [(straight, np.array([-middle, 1.0]) * amplitudes)]
            rows = [*zip(formula.products, formula.amplitudes, strict=True)]
            products, numbers = zip(*rows[:i], *parts, *rows[i + 1 :], strict=True)
            out.append(Formula(products, numbers, formula.square, formula.left))
    return out


def written(leftover: Leftover, formula: Formula, unit: str) -> Written:
    """The formula in both languages."""
    names = iter(LETTERS)
    summands, words = [], []
    values: dict[str, float] = {}
    for product, amplitudes in zip(formula.products, formula.amplitudes, strict=True):
        text, own = _product_text(leftover, product, amplitudes, names)
        summands.append(text)
        words.append(_product_words(leftover, product, own, unit))
        values |= own
    text = " + ".join(summands).replace("- -", "+ ").replace("*1/(", "/(")
    return Written(f"{MISREAD}({text})" if leftover.misread else text, "; and ".join(words), values)


def _product_text(
    leftover: Leftover, product: Product, amplitudes: Array, names: Iterator[str]
) -> tuple[str, dict[str, float]]:
    columns = [
        factor.kind.texts(leftover.text(factor.axis), [f"{n:.{MOST_DIGITS}g}" for n in factor.numbers])
        for factor in product.factors
    ]
    single = [texts[0] for texts in columns if len(texts) == 1]
    several = ["*".join(texts) for texts in itertools.product(*(texts for texts in columns if len(texts) > 1))]
    torque = leftover.columns(product) * amplitudes
    whole = float(np.mean(torque.sum(axis=1) ** 2))
    kept = [i for i in range(len(amplitudes)) if float(np.mean(torque[:, i] ** 2)) > SLIGHT**2 * whole]
    own = {next(names): float(amplitudes[i]) for i in kept}
    if several == [""]:
        return "*".join([*own, *single]), own
    terms = [name if several[i] == "1" else f"{name}*{several[i]}" for name, i in zip(own, kept, strict=True)]
    inner = " + ".join(terms)
    inner = f"({inner})" if len(terms) > 1 and single else inner
    return "*".join([inner, *single]), own


def _product_words(leftover: Leftover, product: Product, own: dict[str, float], unit: str) -> str:
    if not product.factors:
        return f"a constant of {next(iter(own.values())):.3g} (SI, result in {'rad' if leftover.misread else unit})"
    parts = " times ".join(_factor_words(leftover, factor) for factor in product.factors)
    seen = {(f.kind.name, f.axis) for f in product.factors}
    entrances = (("a friction", FRICTION), ("a stiffness", STIFFNESS), ("a drag", DRAG))
    kind = next((name for name, those in entrances if seen & those), "a torque")
    kind, unit = ("an error of the output's encoder", "rad") if leftover.misread else (kind, unit)
    return f"{kind} of {math.hypot(*own.values()):.3g} (SI, result in {unit}) times {parts}"


def _factor_words(leftover: Leftover, factor: Factor) -> str:
    name, unit = axis_words(factor.axis)
    shift = leftover.shift.get(factor.axis, 0.0)
    name += f" after {shift:.0f} {unit}" if shift else ""
    numbers = [f"{number:.4g}" for number in factor.numbers]
    if factor.kind.name in MEASURED_BY:
        numbers = [f"{number} {unit}".strip() for number in numbers]
    return factor.kind.words.format(*numbers, x=name)


def axes_of(formula: Formula) -> tuple[str, ...]:
    """The axes that it holds, in order of appearance."""
    return tuple(dict.fromkeys(f.axis for product in formula.products for f in product.factors))
