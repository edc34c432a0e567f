"""How noisy equations are: what sensors give, what is measured, and what of it is a pattern that the model lacks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import lapack

from edge_daemon.records import Array

GUESS_BELOW = 5.0
"""A measured noise level of fewer degrees of freedom is not yet one, and the guess counts."""
POOLED_GUESS_BELOW = 100.0
"""The same of a pooled level, which innovations alone tell: within a block the noise of a column hides in the column
(guess: two seconds)."""
LEVEL_MEMORY_S = 20.0
"""A noise level is averaged over this time."""
CLEARLY = 4.0
"""A measured variance must exceed another by so many of its sd to be more."""
NOISE_SLACK = 1.15
"""A measured noise variance within this factor of the sensors' own is theirs: five sd of 200 blocks' estimate."""
WORK = 64
"""LAPACK's QR likes so many columns of workspace; any multiple of one will do."""


@dataclass(frozen=True, slots=True)
class Compressed:
    """What a block says about the amplitudes: factor @ amplitudes = target, unit white noise per row."""

    factor: Array
    """(k, k) upper triangular, unit of the torque per unit of each amplitude"""
    target: Array
    """(k,) unit of the torque"""
    residual: float
    """sum of squares that no amplitudes can explain within this block"""
    samples: int


def compress(columns: Array, torque: Array) -> Compressed:
    """(n, k) columns and (n,) torque as their triangular factor; n may be smaller than k, or 0."""
    n, k = columns.shape
    joined = np.empty((max(n, k + 1), k + 1))
    joined[:n, :k] = columns
    joined[:n, k] = torque
    joined[n:] = 0.0
    upper = lapack.dgeqrf(joined, lwork=WORK * (k + 1))[0][: k + 1] * _above(k + 1)
    return Compressed(upper[:k, :k], upper[:k, k], float(upper[k, k] ** 2), n)


@cache
def _above(k: int) -> Array:
    """(k, k) ones on and above the diagonal."""
    return np.triu(np.ones((k, k)))


@dataclass(frozen=True, slots=True)
class ColumnNoise:
    """Second moments of the sensor noise per sample, as it stands in columns and torque after the filters."""

    columns: Array
    """(k, k) covariance between columns"""
    torque: Array
    """(k,) covariance of each column with the torque"""


def structure_share(sensors: float, seen: float) -> float:
    """Share of a `seen` variance that sensor noise does not explain: what the model lacks. 0 within NOISE_SLACK."""
    return max(0.0, 1.0 - NOISE_SLACK * sensors / seen) if seen > 0 else 0.0


def widening(structure: float, independent: Array | float, freedom: float) -> Array:
    """Factor on an sd that took all residuals for noise, spread over `independent` numbers: of the share `structure`
    there are but `freedom` of them, however long the motion goes on, for it repeats with the motion.

    A pattern m of d degrees of freedom meets a column x by E<x, m>^2 = |x|^2 |m|^2 / d: sd^2 grows by n / d.
    """
    return np.asarray(np.sqrt(1.0 + structure * np.maximum(np.asarray(independent) / freedom - 1.0, 0.0)))


class NoiseLevel:
    """White-noise sd of compressed rows, measured: what lies outside the columns, or along them where that is clearly
    more.

    Along the columns (the innovation) a missing effect shows even where it mimics them, which keeps a wrong model from
    looking certain. Both are pooled with exponential forgetting over `memory_s`.
    """

    def __init__(
        self, floor: float, guess: float = 0.0, memory_s: float = LEVEL_MEMORY_S, pooled: bool = False
    ) -> None:
        """`floor` is what the sensors alone give; `guess` counts until something has been measured. `pooled`: noise of
        a column lies along that column, and only the sum of both is what the sensors give."""
        self.floor = floor
        self.guess = guess
        self._memory_s, self._pooled = memory_s, pooled
        self._outside = self._freedom = 0.0
        self._along = self._counted = 0.0

    def before(self, block: Compressed, bandwidth: float, duration_s: float) -> None:
        """Count what no amplitudes can explain within a block; `bandwidth`: share of its samples that are
        independent."""
        keep = math.exp(-duration_s / self._memory_s)
        self._along, self._counted = keep * self._along, keep * self._counted
        freedom = block.samples * bandwidth - len(block.target)
        if freedom > 0.5:
            self._outside = keep * self._outside + block.residual
            self._freedom = keep * self._freedom + freedom

    def after(self, square: float, expected: float, directions: int, fades: bool = False) -> None:
        """Count the squares of an innovation's components, target minus factor @ amplitudes before the update, and what
        is expected of them from the doubt of the amplitudes. Where that hides them, what was seen before is no news,
        and `fades`; else it stays."""
        if expected < directions * self.sd**2:
            self._along += square - expected
            self._counted += directions
        elif fades:
            self._along, self._counted = 0.5 * self._along, 0.5 * self._counted

    @property
    def structure(self) -> float:
        """Share of the variance that sensor noise does not explain."""
        return structure_share(self.floor**2, self.sd**2)

    @property
    def sd(self) -> float:
        """Noise sd per compressed row, unit of the torque; never below the floor."""
        variance = self.floor**2
        told, enough = (self._counted, POOLED_GUESS_BELOW) if self._pooled else (self._freedom, GUESS_BELOW)
        if told < enough:
            variance = max(variance, self.guess**2)
        if self._pooled:
            counted = self._freedom + self._counted
            return math.sqrt(max(variance, (self._outside + self._along) / counted if counted > 0 else 0.0))
        outside = self._outside / self._freedom if self._freedom > 0 else 0.0
        along = self._along / self._counted if self._counted > 0 else 0.0
        chance = CLEARLY * math.sqrt(2 / self._counted) if self._counted > 0 else 0.0
        return math.sqrt(max(variance, outside, along if along > (1 + chance) * outside else 0.0))

    def dump(self) -> list[float]:
        """State as a plain list; `load` takes it back."""
        return [self.floor, self.guess, self._outside, self._freedom, self._along, self._counted]

    @classmethod
    def load(cls, state: list[float], pooled: bool = False) -> NoiseLevel:
        """The level that `dump` described. Raises ValueError for another number of values."""
        made = cls(state[0], state[1], pooled=pooled)
        made._outside, made._freedom, made._along, made._counted = map(float, state[2:])
        return made
