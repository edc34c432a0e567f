"""Which products of two factors come near what is left: all of a library at once, sines by their whole spectra.

Products of the library are two matrix products away: the leftover's correlation with every pair of factors, and the
power of every pair less what the model takes up. Sines of free order follow from a Fourier transform over the axis
instead of time, the leftover weighted with each other factor; two sines from one in two dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from edge_daemon.discover.factors import CLOCK, HALF_WAVES, KINDS, Factor, Product, Span, never
from edge_daemon.discover.leftover import TURNING, Leftover
from edge_daemon.records import Array, Mask

MOST_ROWS = 3000
"""Rows that a library is tried on: some hundred per number."""
DARK = 1e-3
"""Power of a product that the model leaves, over its own, below which it is the model's."""
TOP_ORDER = {"theta_in_rad": 13.0, "theta_out_rad": 30.0}
"""Highest order per turn that is looked for."""
TOP_WAVES = 10.0
"""Most waves over the span of an axis that is no angle."""
TOP_HZ = 60.0
"""Highest frequency in time."""
PLACE_ORDER = 30.0
"""Order per turn of the output below which a wave is of its place: of the motor's angle only beyond."""
LEAST_WAVES = 0.7
"""Fewest waves over the span of an axis: below, a sine is no more than a curve."""
SAMPLES_PER_WAVE = 6
"""Places of an axis for each of its shortest waves."""
FINER = 2
"""Orders that are looked at for each that the span tells apart."""
BREAK_S, BROKEN = 2.0, 0.5
"""A time without a row that parts two recordings, and the share of all time from which on a spectrum is taken of one
stretch alone (guesses: of files hours apart a transform held millions of places, and took 20 s)."""
MOST_PLACES = 1 << 21
"""Of a transform in two dimensions: more takes too long."""
PEAKS = 3
"""Orders that are kept of one spectrum."""
SINE_AXES = ("theta_in_rad", "theta_out_rad", "velocity_out_rad_s", "time_s", "twist_rad", "twist_rate_rad_s")
SINE_PAIRS = (
    ("theta_in_rad", "theta_out_rad"),
    ("theta_in_rad", "time_s"),
    ("theta_out_rad", "time_s"),
    ("theta_out_rad", "velocity_out_rad_s"),
    ("theta_in_rad", "velocity_out_rad_s"),
)
SMOOTH = (
    "power_1",
    "power_2",
    "power_3",
    "affine",
    "size",
    "odd_power",
    "saturation",
    "exponential",
    "resonance",
    "capped",
    "dead_zone",
    "beyond_size",
)
"""Kinds that a sine is multiplied with; `affine` as its line alone."""
PARTNERS_PER_KIND = 3
"""Points of a kind's grid that a sine is multiplied with."""
LEAST_SINGLE = 1e-12
"""Its third power is just above the numbers of single precision that a processor is slow with."""


Places = NDArray[np.intp]
"""(m,) bin of each row along an axis"""


class Along(NamedTuple):
    """Rows along an axis, for a spectrum over it."""

    inside: Mask
    """(m,) which of them"""
    place: Places
    """of these"""
    size: int
    """how many places there are"""
    unit: float
    """order of one step of the spectrum"""
    lowest: int
    highest: int
    """steps between which orders are looked for"""


@dataclass(frozen=True, slots=True)
class Promise:
    """A product, and how much of the leftover's square it would take by itself."""

    product: Product
    gain: float


class Library:
    """Factors that are tried, and what the model takes of their products, on the rows of one leftover that matter: the
    same whatever formulas leave of it."""

    def __init__(self, leftover: Leftover) -> None:
        self.leftover, self.rows = leftover, leftover.rows
        self.thin = slice(None, None, max(1, math.ceil(len(leftover.left) / MOST_ROWS)))
        self.axes = {name: column[self.thin] for name, column in self.rows.items()}
        self.known = np.linalg.qr(leftover.known[self.thin])[0]
        self.factors = tuple(_library({name: leftover.spans[name] for name in leftover.names}))
        self._placed: dict[str, Along] = {}

    @cached_property
    def by_width(self) -> tuple[tuple[Places, Array], ...]:
        """Of the factors that have as many columns: which they are, and (m, n, k) their columns."""
        columns = [np.stack(factor.columns(self.axes), axis=1) for factor in self.factors]
        widths = np.array([row.shape[1] for row in columns])
        alike = [np.flatnonzero(widths == width) for width in sorted(set(widths.tolist()))]
        return tuple((at, np.stack([columns[i] for i in at], axis=1)) for at in alike)

    @cached_property
    def table(self) -> Array:
        """(m, k) each factor, its power one, after a column of ones."""
        table = np.ones((len(self.known), len(self.factors) + 1))
        for at, columns in self.by_width:
            table[:, at + 1] = _of_power_one(columns[:, :, -1])
        return table

    @cached_property
    def beside_known(self) -> Array:
        """(k, k) power of every product of two columns less what the model takes up; infinite where that is all. Single
        precision errs by a thousandth of what `DARK` is, in two fifths of the time."""
        power, table = (self.table**2).T @ self.table**2, _single(self.table)
        rest = power - sum((table.T @ (table * q[:, None])) ** 2 for q in _single(self.known).T)
        return np.where(rest > DARK * power, np.maximum(rest, 1e-300), np.inf)

    def placed(self, axis: str) -> Along:
        """Where each row lies along an axis; along the clock, those of the longest stretch where several are far apart:
        no tone is told in step over hours in which nothing was seen."""
        if axis not in self._placed:
            self._placed[axis] = self._places(self.rows[axis], axis)
        return self._placed[axis]

    def _places(self, column: Array, axis: str) -> Along:
        inside = _without_breaks(column) if axis == CLOCK else np.ones(len(column), dtype=bool)
        column = column[inside]
        low, width = float(column.min()), float(np.ptp(column))
        turns = width / (2 * math.pi)
        top_hz = min(TOP_HZ, self.leftover.problem.motions[0].rate_hz / 2)  # above half the rate a tone is another one
        top = {"time_s": top_hz * 2 * math.pi}.get(axis, TOP_ORDER.get(axis, TOP_WAVES / turns))
        top = max(top, TOP_WAVES / turns) if axis in TOP_ORDER else top
        waves = top * turns
        inner = max(16, math.ceil(SAMPLES_PER_WAVE * waves))
        size = fft.next_fast_len(FINER * inner, real=True)
        step = width / inner
        place = np.minimum(((column - low) / step).astype(int), inner)
        unit = 2 * math.pi / (size * step)
        ratio = abs(self.leftover.problem.motions[0].ratio)
        least = PLACE_ORDER / ratio if axis in TURNING else 0.0
        least = max(LEAST_WAVES / turns, least)
        return Along(inside, place, size, unit, math.floor(least / unit), min(math.ceil(top / unit), size // 2))

    def partners(self) -> list[Factor]:
        """What a sine is multiplied with."""
        count: dict[tuple[str, str], int] = {}
        out = []
        for factor in self.factors:
            key = factor.kind.name, factor.axis
            count[key] = count.get(key, 0) + 1
            if factor.kind.name in SMOOTH and count[key] <= PARTNERS_PER_KIND:
                out.append(factor)
        return out


class Screening:
    """Of what is left of one leftover."""

    def __init__(self, library: Library, left: Array) -> None:
        self.library, self.axes, self.known = library, library.axes, library.known
        self.left = left[library.thin]
        self.square = float(self.left @ self.left)
        self.whole = left, library.rows

    def promises(self) -> list[Promise]:
        """Everything worth a closer look, best first; each signature once for each axis's best numbers."""
        return distinct([_phased(row) for row in (*self.pairs(), *self.sines(), *self.sine_pairs())])

    def pairs(self) -> Iterator[Promise]:
        """Every product of two of the library's factors, and each alone."""
        table = self.library.table
        gain = (table.T @ (table * self.left[:, None])) ** 2 / self.library.beside_known / self.square
        rows, columns = np.triu_indices(len(gain), 1)
        best: dict[object, tuple[float, int, int]] = {}
        own = [("", ""), *((f.kind.name, f.axis) for f in self.library.factors)]
        values = gain[rows, columns]
        for k in np.argsort(-values)[:3000]:
            i, j = int(rows[k]), int(columns[k])
            if i and own[i][1] == own[j][1] and own[i][0] == own[j][0]:
                continue
            best.setdefault((own[i], own[j]), (float(values[k]), i, j))
        for value, i, j in best.values():
            factors = [self.library.factors[at - 1] for at in (i, j) if at]
            yield Promise(Product(tuple(factors)), value)

    def sines(self) -> Iterator[Promise]:
        """A sine of one axis alone, or times a smooth factor of another."""
        left, rows = self.whole
        for partner in (None, *self.library.partners()):
            weight = np.ones(len(left)) if partner is None else partner.columns(rows)[-1]
            for axis in (name for name in SINE_AXES if name in rows):
                for order, gain in self._orders(axis, weight):
                    sine = Factor(KINDS["sine"], axis, (order,))
                    yield Promise(Product((sine,) if partner is None else (partner, sine)), gain)

    def multiplied(self, product: Product) -> list[Promise]:
        """A product times one more factor, its amplitudes free, as `promises`; `left` is then what the model leaves
        without it."""
        return distinct([_phased(row) for row in self._multiplied(product)])

    def _multiplied(self, product: Product) -> Iterator[Promise]:
        _, rows = self.whole
        for column in product.columns(rows).T[:2]:
            weight = _of_power_one(column)
            for axis in (name for name in SINE_AXES if name in rows):
                for order, gain in self._orders(axis, weight):
                    yield Promise(Product((*product.factors, Factor(KINDS["sine"], axis, (order,)))), gain)
            for at, columns in self.library.by_width:
                for i, gain in zip(at, self._gains(columns, weight[self.library.thin]), strict=True):
                    if gain > 0:
                        yield Promise(Product((*product.factors, self.library.factors[i])), float(gain))

    def _gains(self, columns: Array, weight: Array) -> Array:
        """(n,) share of the leftover's square that each factor's columns (m, n, k) times a weight (m,) take beside the
        model; zero of one that says what the model does."""
        felt = columns * weight[:, None, None]
        felt /= np.sqrt(np.maximum(np.einsum("mnk,mnk->nk", felt, felt), 1e-300))
        known, sums = np.tensordot(self.known.T, felt, 1), np.tensordot(self.left, felt, 1)
        rest = np.einsum("mni,mnj->nij", felt, felt) - np.einsum("pni,pnj->nij", known, known)
        dark = (np.einsum("nii->ni", rest) <= DARK).any(axis=1)
        rest[dark] = np.eye(rest.shape[1])
        found = np.einsum("ni,nij,nj->n", sums, np.linalg.pinv(rest, rcond=DARK, hermitian=True), sums)
        return np.where(dark, 0.0, found / self.square)

    def _orders(self, axis: str, weight: Array) -> Iterator[tuple[float, float]]:
        """The strongest orders of an axis in the leftover times a weight (m,), each with its gain."""
        along = self.library.placed(axis)
        if along.highest <= along.lowest:
            return
        left, weight = self.whole[0][along.inside], weight[along.inside]
        wave = fft.rfft(np.bincount(along.place, left * weight, along.size))
        gain = 2 * np.abs(wave) ** 2 / max(float(weight @ weight), 1e-300) / max(float(left @ left), 1e-300)
        gain[: along.lowest + 1], gain[along.highest :] = 0.0, 0.0
        for peak in _peaks(gain, FINER):
            yield _vertex(gain, peak) * along.unit, float(gain[peak])

    def sine_pairs(self) -> Iterator[Promise]:
        """A sine of one axis times a sine of another."""
        left, rows = self.whole
        for one, other in SINE_PAIRS:
            if one not in rows or other not in rows:
                continue
            (place, size, unit, *_), (place2, size2, unit2, *_) = self._coarse(one), self._coarse(other)
            if size * size2 > MOST_PLACES:
                continue
            table = np.bincount(place * size2 + place2, left, size * size2).reshape(size, size2)
            wave = np.abs(fft.rfft2(table)) ** 2 * 2 / len(left) / float(left @ left)
            mirrored = np.roll(wave[::-1], 1, axis=0)
            both = (wave + mirrored)[: size // 2]
            both[: int(LEAST_WAVES * FINER) + 1] = 0.0
            both[:, : int(LEAST_WAVES * FINER) + 1] = 0.0
            for _ in range(2):
                i, j = np.unravel_index(int(np.argmax(both)), both.shape)
                factors = (Factor(KINDS["sine"], one, (i * unit,)), Factor(KINDS["sine"], other, (j * unit2,)))
                yield Promise(Product(factors), float(both[i, j]))
                both[max(0, i - 2) : i + 3, max(0, j - 2) : j + 3] = 0.0

    def _coarse(self, axis: str) -> tuple[Places, int, float]:
        """As `_places`, the spectrum as fine as the span tells apart and up to half the highest order."""
        column = self.whole[1][axis]
        low, width = float(column.min()), float(np.ptp(column))
        turns = width / (2 * math.pi)
        top = {"time_s": 0.2 * TOP_HZ * 2 * math.pi}.get(axis, TOP_ORDER.get(axis, TOP_WAVES / turns))
        inner = max(16, math.ceil(3 * top * turns))
        size = 2 * fft.next_fast_len(math.ceil(FINER * inner / 2), real=True)
        step = width / inner
        place = np.minimum(((column - low) / step).astype(int), inner)
        return place, size, 2 * math.pi / (size * step)


def _without_breaks(time_s: Array) -> Mask:
    """(m,) rows of the stretch with the most of them, between breaks, where these make most of the time; else all."""
    order = np.argsort(time_s, kind="stable")
    steps = np.diff(time_s[order])
    breaks = steps > BREAK_S
    if steps[breaks].sum() <= BROKEN * steps.sum():
        return np.ones(len(time_s), dtype=bool)
    stretch = np.concatenate(([0], np.cumsum(breaks)))
    longest = np.zeros(len(time_s), dtype=bool)
    longest[order] = stretch == np.argmax(np.bincount(stretch))
    return longest


def distinct(found: Sequence[Promise]) -> list[Promise]:
    """Best first, each signature once; of a sine, whose order is all, the best few orders."""
    count: dict[object, int] = {}
    out = []
    for row in sorted(found, key=lambda row: -row.gain):
        key = row.product.signature
        count[key] = count.get(key, 0) + 1
        if count[key] <= (PEAKS if row.product.waves else 1):
            out.append(row)
    return out


def _single(columns: Array) -> NDArray[np.float32]:
    """Columns in single precision, nought where a product of three would be too small a number to be quick with."""
    return np.where(np.abs(columns) > LEAST_SINGLE, columns, 0.0).astype(np.float32)


def _of_power_one(column: Array) -> Array:
    """(m,) or (m, k) a column, or each, scaled."""
    return np.asarray(column / np.maximum(np.sqrt(np.mean(column**2, axis=0)), 1e-300))


def _phased(promise: Promise) -> Promise:
    """Half waves as sines of free phase."""
    factors = promise.product.factors
    if not any(factor.kind.name in HALF_WAVES for factor in factors):
        return promise
    sine = KINDS["sine"]
    return Promise(
        Product(tuple(replace(f, kind=sine) if f.kind.name in HALF_WAVES else f for f in factors)), promise.gain
    )


def _library(spans: dict[str, Span]) -> Iterator[Factor]:
    """Every factor but sines, over its grid, of every axis that does not turn."""
    for axis, span in spans.items():
        if axis not in TURNING:
            for kind in (row for row in KINDS.values() if row.name not in never(axis)):
                for numbers in kind.grid(span):
                    yield Factor(kind, axis, numbers)


def _peaks(gain: Array, reach: int) -> Sequence[int]:
    """Places of the highest few maxima."""
    inner = (gain[1:-1] >= gain[:-2]) & (gain[1:-1] > gain[2:])
    at = np.flatnonzero(inner) + 1
    best: list[int] = []
    for k in at[np.argsort(-gain[at])][: 4 * PEAKS].tolist():
        if all(abs(k - other) > 2 * reach for other in best):
            best.append(k)
    return best[:PEAKS]


def _vertex(gain: Array, peak: int) -> float:
    """Where a parabola through a maximum and its neighbours is highest."""
    a, b, c = np.sqrt(gain[peak - 1 : peak + 2])
    bend = a - 2 * b + c
    return peak + float(0.5 * (a - c) / bend if bend < 0 else 0.0)
