"""The order spectrum of a residual: what of it repeats with an angle, at any order, whole or not.

A least-squares periodogram over the input angle (Lomb 1976, Astrophys. Space Sci. 39; Scargle 1982, Astrophys. J. 263),
computed by Fourier transform of the residual sorted into bins of the angle (Press & Rybicki 1989, Astrophys. J. 338).
An order of the output or of the difference of both angles is one of the input too, as long as the gear hardly twists,
so that one spectrum finds all of them. What a line stands out from is the power of its neighbours, so that noise of any
smooth spectrum makes none.
"""

from __future__ import annotations

import itertools
import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import digamma, gammaincc, gammaincinv

from edge_daemon.motion.left_over import LeftOver
from edge_daemon.records import Array, Mask

HIGHEST_ORDER = 64.0
"""Largest order per turn of the input that is looked for (guess: twice the poles of the finest motor)."""
LEAST_TURNS = 2.0
"""Turns of the input, and periods of an order, below which no order is named: a part of a period is any curve."""
FINENESS = 4
"""Points of the spectrum per width of a line."""
BINS_PER_PERIOD = 4
"""Bins of the angle per period of the highest order. A sample is shared by the two that it lies between, and what that
takes of a wave is given back: one of three times the highest order leaves 1 % of its power there."""
BAND = 1.5
"""Highest over lowest order of a part of the spectrum, which is taken from the samples slow enough for it."""
LEAST_SAMPLES = 200
"""Samples that a part of the spectrum needs (guess)."""
SPEEDS = 32
"""Speeds by which it is seen which orders the filter passes."""
NEIGHBOURS = 60
"""Widths of a line to either side whose median power is what a line stands out from."""
RIDGE = 1e-7
"""Of the mean power of a column; keeps an order that was fitted already, or hardly turns, from being fitted again."""
PARABOLAS = (1 / FINENESS, 0.05)
"""Widths of a line to either side of the two parabolas that lead to its top: the spectrum's own spacing, and so near
that a line is one to a thousandth of its height."""
CHANCE = 1e-3
"""Probability of a line by chance, anywhere in a spectrum, below which it is one."""


WaveSums = NDArray[np.complex128]
"""(f,) sums of a wave over the samples"""


class OrderPowers(NamedTuple):
    """Power over order, (f,) each."""

    order: Array
    """per turn of the input, rising"""
    fall: Array
    """of the sum of squares by sine and cosine of that order"""
    stands_out: Array
    """`fall` over that of its neighbours"""
    trials: float
    """independent orders that were looked at"""

    def highest(self, count: int) -> list[float]:
        """The largest falls, no two within a width of a line."""
        widths = (
            np.append(self.fall, np.zeros(-len(self.fall) % FINENESS)).reshape(-1, FINENESS).max(axis=1, initial=0.0)
        )
        return sorted(map(float, widths), reverse=True)[:count]


class OrderLine(NamedTuple):
    """One line of a spectrum."""

    order: float
    """per turn of the input"""
    fall: float
    usual: float
    """fall by its neighbours"""
    chance: float
    """probability of such a line anywhere in the spectrum, were the residual noise"""

    @property
    def stands_out(self) -> float:
        """Its fall over that of its neighbours."""
        return self.fall / self.usual


class OrderScale:
    """The angle over which waves are looked for, and what they are multiplied by: the same whatever is left."""

    def __init__(
        self,
        carriers: Array,
        angle_rad: Array,
        pace_hz: Array,
        cutoff_hz: float,
        rate_hz: float,
        ends: tuple[int, ...] = (),
    ) -> None:
        self.carriers = carriers
        """(c, m) what the wave is multiplied by, one after the other"""
        self.angle_rad = angle_rad
        """(m,) of the input"""
        self.pace_hz = pace_hz
        """(m,) size of its speed, turns per second"""
        self.cutoff_hz = cutoff_hz
        """of the filter that the residual passed"""
        self.rate_hz = rate_hz
        """at which sensors were sampled: faster waves fold, in the sensors and in the model alike"""
        self.ends = ends
        """where one recording ends and the next begins, if there are several"""
        self.turns = float(np.ptp(angle_rad)) / (2 * math.pi)

    def passed(self, order: float) -> Mask:
        """(m,) samples at whose speed the filter passes an order."""
        cycles = order * self.pace_hz / self.rate_hz
        inside: Mask = np.abs(cycles - np.round(cycles)) * self.rate_hz < self.cutoff_hz
        return inside

    def heard(self, orders: Array, inside: Mask) -> Mask:
        """(f,) orders of which some samples (m,) hear enough: at one speed an order may be folded into what the filter
        passes, and its neighbour not."""
        count, edges = np.histogram(self.pace_hz[inside], SPEEDS)
        cycles = orders[:, None] * (0.5 / self.rate_hz) * (edges[1:] + edges[:-1])
        passed = np.abs(cycles - np.round(cycles)) * self.rate_hz < self.cutoff_hz
        enough: Mask = passed @ count >= LEAST_SAMPLES
        return enough

    def part(self, rows: slice) -> OrderScale:
        """Some of the samples, as of one recording."""
        parts = self.carriers[:, rows], self.angle_rad[rows], self.pace_hz[rows]
        return OrderScale(*parts, self.cutoff_hz, self.rate_hz)

    @cached_property
    def recordings(self) -> list[tuple[slice, OrderScale]]:
        """Each of several, empty where there is one."""
        cuts = (0, *self.ends, len(self.angle_rad))
        rows = [slice(start, stop) for start, stop in itertools.pairwise(cuts)] if self.ends else []
        return [(row, self.part(row)) for row in rows]

    @cached_property
    def bands(self) -> list[OrderBand]:
        """Parts of the spectrum, each of the samples whose speed lets the filter pass its orders, those of the same
        samples in one; none where the input hardly turns."""
        parts = list[tuple[Mask, float, float]]()
        low = LEAST_TURNS / self.turns if self.turns >= LEAST_TURNS else HIGHEST_ORDER
        while low < HIGHEST_ORDER:
            high = min(BAND * low, HIGHEST_ORDER)
            inside = self.passed(high)
            if inside.sum() >= LEAST_SAMPLES and np.ptp(self.angle_rad[inside]) * high > 4 * math.pi * LEAST_TURNS:
                same = bool(parts) and parts[-1][2] == low and np.array_equal(parts[-1][0], inside)
                parts.append((inside, parts.pop()[1] if same else low, high))
            low = high
        return [OrderBand(self, *part) for part in parts]


class OrderBand:
    """One part of a spectrum: samples in bins of their angle, and the normal equations of sine and cosine of each order
    beside the carrier itself (Zechmeister & Kuerster 2009, Astron. Astrophys. 496, eq. 5)."""

    def __init__(self, scale: OrderScale, inside: Mask, low: float, high: float) -> None:
        self.inside, self.carriers = inside, scale.carriers[:, inside]
        angle = scale.angle_rad[inside]
        bin_rad = 2 * math.pi / (BINS_PER_PERIOD * high)
        self.bins = (angle - angle.min()) / bin_rad
        self.size = fft.next_fast_len(FINENESS * (int(self.bins.max()) + 2), real=True)
        self.place, self.share = _places(self.bins)
        step = 2 * math.pi / (self.size * bin_rad)
        rows = np.arange(math.ceil(low / step), math.floor(high / step) + 1)
        self.rows = rows[scale.heard(np.asarray(rows * step), inside)]
        self.order = np.asarray(self.rows * step)
        self.given_back = np.sinc(self.rows / self.size) ** -2
        self.whole = [float(carrier @ carrier) or 1.0 for carrier in self.carriers]
        self.normal = [self._normal(*row) for row in zip(self.carriers, self.whole, strict=True)]

    def _sums(self, signal: Array) -> WaveSums:
        """(f,) of the waves over a signal (m,)."""
        return _binned(self.place, self.share, signal, self.size)[self.rows] * self.given_back

    def _normal(self, carrier: Array, whole: float) -> tuple[Array, Array, Array]:
        """What the squares of cosine and sine and their product are multiplied by to make the fall."""
        weight = _binned(*_places(2 * self.bins), carrier**2, 2 * self.size)  # bins half as wide: twice the order
        twice = weight[2 * self.rows] * self.given_back
        alone = weight[self.rows] * np.sinc(0.5 * self.rows / self.size) ** -2
        cc = 0.5 * (whole + twice.real) - alone.real**2 / whole
        ss = 0.5 * (whole - twice.real) - alone.imag**2 / whole
        cs = -0.5 * twice.imag + alone.real * alone.imag / whole
        determinant = cc * ss - cs**2
        told = (determinant > 1e-6 * whole**2) / np.maximum(determinant, 1e-300)
        return ss * told, cc * told, -2 * cs * told

    def fall(self, residual: Array) -> Array:
        """(f,) of the sum of squares of a residual (m,), by each order."""
        left, fall = residual[self.inside], np.zeros(len(self.rows), dtype=float)
        for carrier, whole, (c2, s2, cs) in zip(self.carriers, self.whole, self.normal, strict=True):
            aside = left - float(carrier @ left) / whole * carrier
            once = self._sums(carrier * aside)
            c, s = once.real, -once.imag
            fall += c2 * c**2 + s2 * s**2 + cs * c * s
        return fall


def _places(bins: Array) -> tuple[NDArray[np.intp], Array]:
    """(2m,) the bins that samples at places between them (m,) lie in, and the share that each has."""
    below = bins.astype(np.intp)
    above = bins - below
    return np.concatenate((below, below + 1)), np.concatenate((1 - above, above))


def _binned(place: NDArray[np.intp], share: Array, signal: Array, size: int) -> WaveSums:
    """Transform of a signal (m,) in bins."""
    return np.fft.rfft(np.bincount(place, share * np.tile(signal, 2), size))


class OrderSamples(NamedTuple):
    """What a spectrum is taken of."""

    scale: OrderScale
    residual: LeftOver
    """beside columns that were fitted already, those of other lines among them"""


def spectrum(residual: Array, scale: OrderScale) -> OrderPowers:
    """The order spectrum of a residual (m,); empty where the input hardly turns."""
    if not scale.bands:
        return OrderPowers(*(np.empty(0),) * 3, 1.0)
    order = np.concatenate([band.order for band in scale.bands])
    fall = np.concatenate([band.fall(residual) for band in scale.bands])
    count = len(scale.carriers)
    usual = np.maximum(_medians(fall) / float(gammaincinv(count, 0.5)), _trend(order, fall) / math.exp(digamma(count)))
    return OrderPowers(order, fall, fall / np.maximum(usual, 1e-300), max(len(order) / FINENESS, 1.0))


def strongest(samples: OrderSamples) -> OrderLine | None:
    """The line that stands out most, None where chance would make it as well. Of several recordings, the one of each is
    asked where all together show none: one of few turns has broad lines, among which those of a longer one do not stand
    out."""
    scale, residual = samples.scale, samples.residual.signal
    every = seen = _look(residual, scale)
    looks = 1 + len(scale.recordings)
    if seen is None or seen.chance * looks > CHANCE:
        alone = [_look(residual[rows], part) for rows, part in scale.recordings]
        seen = min((look for look in (every, *alone) if look is not None), default=None, key=lambda look: look.chance)
    if seen is None or seen.chance * looks > CHANCE:
        return None
    near = seen.order if every is None or seen is every else _nearest(seen, every)
    if not scale.passed(near).any():
        return None
    fit = LineFit(samples, near)
    order = fit.sharpest()
    return OrderLine(order, fit.fall(order), seen.usual, seen.chance * looks)


class _Look(NamedTuple):
    """The line that stands out most of one spectrum."""

    powers: OrderPowers
    order: float
    width: float
    usual: float
    chance: float


def _look(residual: Array, scale: OrderScale) -> _Look | None:
    """One spectrum; None where the input hardly turns."""
    seen = spectrum(residual, scale)
    if not len(seen.order):
        return None
    top = int(np.argmax(seen.stands_out))
    chance = seen.trials * float(gammaincc(len(scale.carriers), seen.stands_out[top]))
    return _Look(seen, float(seen.order[top]), 1 / scale.turns, float(seen.fall[top] / seen.stands_out[top]), chance)


def _nearest(line: _Look, every: _Look) -> float:
    """Where all recordings together put a line of one of them."""
    near = np.abs(every.powers.order - line.order) <= 0.5 * max(line.width, every.width)
    if not near.any():
        return line.order
    return float(every.powers.order[near][np.argmax(every.powers.fall[near])])


class LineFit:
    """One line beside all that was fitted already, at orders near one, on the samples that the filter passes there."""

    def __init__(self, samples: OrderSamples, order: float) -> None:
        inside = samples.scale.passed(order)
        self.order, self.angle_rad = order, samples.scale.angle_rad[inside]
        self.carriers = samples.scale.carriers[:, inside]
        residual = samples.residual.within(inside).beside(self.carriers.T)
        self.basis, self.residual = residual.basis, residual.signal
        self.width = 2 * math.pi / float(np.ptp(self.angle_rad))
        """of the line"""
        self.ridge = RIDGE * len(self.angle_rad) * float(np.mean(self.carriers**2)) * np.eye(2 * len(self.carriers))

    def fall(self, order: float) -> float:
        """By how much sine and cosine of an order lower the sum of squares."""
        wave = order * self.angle_rad
        columns = np.vstack((self.carriers * np.sin(wave), self.carriers * np.cos(wave)))
        known = columns @ self.basis
        normal, sums = columns @ columns.T - known @ known.T + self.ridge, columns @ self.residual
        return float(sums @ np.linalg.solve(normal, sums))

    def sharpest(self) -> float:
        """The order within half a line's width that explains most: by a parabola through its top, and a narrow one."""
        from scipy.optimize import minimize_scalar

        top = self.order
        for share in PARABOLAS:
            step = share * self.width
            low, middle, high = (self.fall(top + k * step) for k in (-1, 0, 1))
            bent = 2 * middle - low - high
            if bent <= 0 or middle < max(low, high):
                break
            top += 0.5 * step * (high - low) / bent
        else:
            return top

        def rise(at: float) -> float:
            return -self.fall(at)

        options: Any = {"xatol": 2e-3 * self.width}
        within = (self.order - 0.5 * self.width, self.order + 0.5 * self.width)
        return float(minimize_scalar(rise, bounds=within, method="bounded", options=options).x)


def _trend(order: Array, fall: Array) -> Array:
    """(f,) geometric mean of the fall as a power of the order, or a bent one: at the low end all neighbours are on one
    side, and noise with a memory is steep there."""
    at = np.log(order)
    powers = np.log(np.maximum(fall, 1e-12 * fall.max() + 1e-300))
    curve = np.polynomial.Polynomial.fit(at, powers, 2, w=1 / np.sqrt(order))
    return np.asarray(np.exp(curve(at)))


def _medians(fall: Array) -> Array:
    """(f,) median of the neighbours of each order."""
    reach = NEIGHBOURS * FINENESS
    every = max(1, reach // 8)
    centres = np.minimum(np.arange(0, len(fall) + every, every), len(fall) - 1)
    inner = (centres >= reach) & (centres + reach < len(fall))
    medians = np.empty(len(centres))
    window = np.arange(-reach, reach + 1, FINENESS // 2)
    medians[inner] = np.median(fall[centres[inner, None] + window], axis=1)
    medians[~inner] = [np.median(fall[max(0, i - reach) : i + reach + 1 : FINENESS // 2]) for i in centres[~inner]]
    return np.asarray(np.interp(np.arange(len(fall)), centres, medians))
