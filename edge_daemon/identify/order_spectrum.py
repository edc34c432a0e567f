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
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import digamma, gammaincc, gammaincinv

from edge_daemon.records import Array, Mask

HIGHEST_ORDER = 64.0
"""Largest order per turn of the input that is looked for (guess: twice the poles of the finest motor)."""
LEAST_TURNS = 2.0
"""Turns of the input, and periods of an order, below which no order is named: a part of a period is any curve."""
FINENESS = 4
"""Points of the spectrum per width of a line."""
BINS_PER_PERIOD = 8
"""Bins of the angle per period of the highest order: 3 % of its power is lost."""
BAND = 1.5
"""Highest over lowest order of a part of the spectrum, which is taken from the samples slow enough for it."""
LEAST_SAMPLES = 200
"""OrderSamples that a part of the spectrum needs (guess)."""
NEIGHBOURS = 60
"""Widths of a line to either side whose median power is what a line stands out from."""
RIDGE = 1e-7
"""Of the mean power of a column; keeps an order that was fitted already, or hardly turns, from being fitted again."""
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


class OrderSamples(NamedTuple):
    """What a spectrum is taken of."""

    residual: Array
    """(m,)"""
    carriers: Array
    """(c, m) what the wave is multiplied by, one after the other"""
    angle_rad: Array
    """(m,) of the input"""
    pace_hz: Array
    """(m,) size of its speed, turns per second"""
    cutoff_hz: float
    """of the filter that the residual passed"""
    rate_hz: float
    """at which sensors were sampled: faster waves fold, in the sensors and in the model alike"""
    fitted: Array
    """(m, q) columns that were fitted already, those of other lines among them"""
    ends: tuple[int, ...] = ()
    """where one recording ends and the next begins, if there are several"""


def passed(samples: OrderSamples, order: float) -> Mask:
    """(m,) samples at whose speed the filter passes an order."""
    cycles = order * samples.pace_hz / samples.rate_hz
    inside: Mask = np.abs(cycles - np.round(cycles)) * samples.rate_hz < samples.cutoff_hz
    return inside


def spectrum(samples: OrderSamples) -> OrderPowers:
    """The order spectrum; empty where the input hardly turns."""
    turns = np.ptp(samples.angle_rad) / (2 * math.pi)
    parts = list(_bands(samples, float(turns))) if turns >= LEAST_TURNS else []
    if not parts:
        return OrderPowers(*(np.empty(0),) * 3, 1.0)
    order, fall = np.concatenate([row[0] for row in parts]), np.concatenate([row[1] for row in parts])
    count = len(samples.carriers)
    usual = np.maximum(_medians(fall) / float(gammaincinv(count, 0.5)), _trend(order, fall) / math.exp(digamma(count)))
    return OrderPowers(order, fall, fall / np.maximum(usual, 1e-300), max(len(order) / FINENESS, 1.0))


def strongest(samples: OrderSamples) -> OrderLine | None:
    """The line that stands out most, of all recordings together or of one of them, None where chance would make it as
    well: one of few turns has broad lines, among which those of a longer one do not stand out."""
    own = [_alone(samples, *two) for two in itertools.pairwise((0, *samples.ends, len(samples.residual)))]
    looks = [_look(part) for part in (samples, *(own if samples.ends else ()))]
    seen = min((look for look in looks if look is not None), default=None, key=lambda look: look.chance)
    if seen is None or seen.chance * len(looks) > CHANCE:
        return None
    fit = LineFit(samples, seen.order if looks[0] is None or seen is looks[0] else _nearest(seen, looks[0]))
    order = fit.sharpest()
    return OrderLine(order, fit.fall(order), seen.usual, seen.chance * len(looks))


class _Look(NamedTuple):
    """The line that stands out most of one spectrum."""

    powers: OrderPowers
    order: float
    width: float
    usual: float
    chance: float


def _look(samples: OrderSamples) -> _Look | None:
    """One spectrum; None where the input hardly turns."""
    seen = spectrum(samples)
    if not len(seen.order):
        return None
    top = int(np.argmax(seen.stands_out))
    chance = seen.trials * float(gammaincc(len(samples.carriers), seen.stands_out[top]))
    width = 2 * math.pi / float(np.ptp(samples.angle_rad))
    return _Look(seen, float(seen.order[top]), width, float(seen.fall[top] / seen.stands_out[top]), chance)


def _alone(samples: OrderSamples, start: int, stop: int) -> OrderSamples:
    """One recording of several."""
    rows = slice(start, stop)
    return samples._replace(
        residual=samples.residual[rows],
        carriers=samples.carriers[:, rows],
        angle_rad=samples.angle_rad[rows],
        pace_hz=samples.pace_hz[rows],
        fitted=samples.fitted[rows],
        ends=(),
    )


def _nearest(line: _Look, every: _Look) -> float:
    """Where all recordings together put a line of one of them."""
    near = np.abs(every.powers.order - line.order) <= 0.5 * max(line.width, every.width)
    if not near.any():
        return line.order
    return float(every.powers.order[near][np.argmax(every.powers.fall[near])])


class LineFit:
    """One line beside all that was fitted already, at orders near one, on the samples that the filter passes there."""

    def __init__(self, samples: OrderSamples, order: float) -> None:
        inside = passed(samples, order)
        self.order, self.angle_rad = order, samples.angle_rad[inside]
        self.carriers = samples.carriers[:, inside]
        columns = np.hstack((samples.fitted[inside], self.carriers.T))
        self.basis = np.linalg.qr(columns / (np.linalg.norm(columns, axis=0) + 1e-300))[0]
        self.residual = self._apart(samples.residual[inside])
        self.width = 2 * math.pi / float(np.ptp(self.angle_rad))
        """of the line"""

    def _apart(self, columns: Array) -> Array:
        """What the columns that were fitted already cannot make."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))

    def fall(self, order: float) -> float:
        """By how much sine and cosine of an order lower the sum of squares."""
        wave = order * self.angle_rad
        columns = self._apart(np.vstack((self.carriers * np.sin(wave), self.carriers * np.cos(wave))).T)
        normal, sums = columns.T @ columns, columns.T @ self.residual
        normal += RIDGE * len(wave) * np.mean(self.carriers**2) * np.eye(len(normal))
        return float(sums @ np.linalg.solve(normal, sums))

    def sharpest(self) -> float:
        """The order within half a line's width that explains most."""
        from scipy.optimize import minimize_scalar

        def rise(at: float) -> float:
            return -self.fall(at)

        options: Any = {"xatol": 2e-3 * self.width}
        within = (self.order - 0.5 * self.width, self.order + 0.5 * self.width)
        return float(minimize_scalar(rise, bounds=within, method="bounded", options=options).x)


def _bands(samples: OrderSamples, turns: float) -> Iterator[tuple[Array, Array]]:
    """(orders, fall) of one part of the spectrum after another: each of the samples whose speed lets the filter pass
    its orders."""
    low = LEAST_TURNS / turns
    while low < HIGHEST_ORDER:
        high = min(BAND * low, HIGHEST_ORDER)
        inside = passed(samples, high)
        if inside.sum() >= LEAST_SAMPLES and np.ptp(samples.angle_rad[inside]) * high > 4 * math.pi * LEAST_TURNS:
            yield _periodogram(samples, inside, low, high)
        low = high


def _periodogram(samples: OrderSamples, inside: Mask, low: float, high: float) -> tuple[Array, Array]:
    angle, residual = samples.angle_rad[inside], samples.residual[inside]
    bin_rad = 2 * math.pi / (BINS_PER_PERIOD * high)
    place = ((angle - angle.min()) / bin_rad).astype(np.intp)
    size = fft.next_fast_len(FINENESS * (int(place.max()) + 1), real=True)
    step = 2 * math.pi / (size * bin_rad)
    rows = np.arange(math.ceil(low / step), math.floor(high / step) + 1)
    fall = np.zeros(len(rows))
    for carrier in samples.carriers[:, inside]:
        whole = float(carrier @ carrier) or 1.0
        left = residual - float(carrier @ residual) / whole * carrier
        once = fft.rfft(np.bincount(place, carrier * left, size))
        weight = fft.rfft(np.bincount(place, carrier**2, size))
        fall += _fall(once[rows], weight[2 * rows], weight[rows], whole)
    return np.asarray(rows * step), fall


def _fall(
    once: NDArray[np.complex128], twice: NDArray[np.complex128], alone: NDArray[np.complex128], whole: float
) -> Array:
    """Of the sum of squares, by the normal equations of sine and cosine beside the carrier itself (Zechmeister &
    Kuerster 2009, Astron. Astrophys. 496, eq. 5)."""
    c, s = once.real, -once.imag
    cc = 0.5 * (whole + twice.real) - alone.real**2 / whole
    ss = 0.5 * (whole - twice.real) - alone.imag**2 / whole
    cs = -0.5 * twice.imag + alone.real * alone.imag / whole
    determinant = cc * ss - cs**2
    fall = (ss * c**2 + cc * s**2 - 2 * cs * c * s) / np.maximum(determinant, 1e-300)
    return np.asarray(np.where(determinant > 1e-6 * whole**2, fall, 0.0))


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
