"""Recursive least squares over effect amplitudes: a Kalman filter fed one compressed block at a time.

A block of n samples with k columns carries no more about k amplitudes than its triangular factor: `compress` takes
[columns | torque] to a (k, k) factor and a (k,) target by QR, and one filter update with these gives the posterior
of n scalar updates (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. IV).

Noise also stands in the columns (errors in variables). The expected shrinkage it causes is linear in the true
amplitudes, so it is carried beside the filter as a (k, k) matrix and undone on reading: the filter itself stays the
textbook one. Batch form: Soderstrom, Errors-in-variables methods in system identification, Automatica 43 (2007),
section 5 (bias-compensated least squares with known noise covariance).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.linalg import lapack

from edge_daemon.records import Array

SHRINKAGE_LIMIT = 0.7
"""a direction of which noise makes up more than this share of the information is not trusted (guess: the
compensated estimate is then three times as uncertain as the filter's)"""


WORK = 64
"""columns of workspace that LAPACK's QR likes; any multiple of one will do"""
GUESS_BELOW = 5.0
"""degrees of freedom below which a measured noise level is not yet one, and the guess counts"""
LEVEL_MEMORY_S = 20.0
"""over which a noise level is averaged"""
CLEARLY = 4.0
"""sd of a measured variance by which one must exceed another to be more"""
NOISE_SLACK = 1.15
"""a measured noise variance within this factor of the sensors' own is theirs: five sd of 200 blocks' estimate"""


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


class AmplitudeFilter:
    """Amplitudes with covariance. Never grows without excitation: drift enters only where data removed doubt.

    `mean` (k,), `prior_sd` (k,) and `drift_per_sqrt_s` (k,) are in the amplitudes' units; the drift is the standard
    deviation of a random walk after one second.
    """

    def __init__(self, mean: Array, prior_sd: Array, drift_per_sqrt_s: Array) -> None:
        k = len(mean)
        self.scale = np.asarray(prior_sd, dtype=float).copy()
        self._drift = (drift_per_sqrt_s / self.scale) ** 2
        self._kalman = KalmanFilter(dim_x=k, dim_z=k)
        self._mean = mean / self.scale
        self._doubt = np.eye(k)
        self._removed = np.zeros(k)
        self._samples = np.zeros(k)
        self._shrink = np.zeros((k, k))
        self._shift = np.zeros(k)
        self._identity = np.eye(k)
        self._units = np.outer(self.scale, self.scale)
        self._refresh()

    def update(self, block: Compressed, noise_sd: float, elapsed_s: float, noise: ColumnNoise | None = None) -> None:
        """Take in a block whose rows carry white noise of `noise_sd` [unit of the torque].

        `elapsed_s` is the time since the last block that was taken in; `noise` the sensor noise in the columns.
        """
        self._predict(elapsed_s)
        before = self._doubt.diagonal().copy()
        keep = self._condition(block.factor * (self.scale / noise_sd), block.target / noise_sd)
        self._removed = np.maximum(before - self._doubt.diagonal(), 0.0)
        self._samples += block.samples
        self._follow_shrinkage(keep, block, noise_sd, noise)
        self._refresh()

    def _predict(self, elapsed_s: float) -> None:
        doubt, added = self._doubt.diagonal(), self._added(elapsed_s)
        self._samples *= doubt / np.maximum(doubt + added, 1e-300)
        self._doubt.flat[:: len(added) + 1] += added

    def _added(self, elapsed_s: float) -> Array:
        """Drift, but per direction never more than the last block removed, and never beyond the prior (1)."""
        most = np.minimum(self._removed, np.maximum(1.0 - self._doubt.diagonal(), 0.0))
        added: Array = np.minimum(self._drift * elapsed_s, most)
        return added

    def drifted(self, elapsed_s: float) -> Array:
        """(k, k) covariance of `value` when the next block comes after this time."""
        covariance = self.covariance.copy()
        covariance.flat[:: len(covariance) + 1] += self._added(elapsed_s) * self.scale**2
        return covariance

    def _condition(self, factor: Array, target: Array) -> Array:
        """The posterior of rows factor @ x = target with unit noise: (k, k) how much of an error before is left."""
        kalman = self._kalman
        kalman.x, kalman.P = self._mean[:, None], self._doubt
        kalman.update(target[:, None], H=factor)
        self._mean, self._doubt = kalman.x[:, 0], 0.5 * (kalman.P + kalman.P.T)
        keep: Array = self._identity - kalman.K @ factor
        return keep

    def _follow_shrinkage(self, keep: Array, block: Compressed, noise_sd: float, noise: ColumnNoise | None) -> None:
        self._shrink = keep @ self._shrink
        self._shift = keep @ self._shift
        if noise is not None:
            weight = self._doubt * (block.samples / noise_sd**2)
            self._shrink += weight @ (noise.columns * self._units)
            self._shift += weight @ (noise.torque * self.scale)

    def _refresh(self) -> None:
        """Undo the shrinkage: x = (1 - shrink) a + shift in expectation."""
        undo = lapack.dgesv(self._identity - self._shrink, self._identity)[2]
        self.value: Array = self.scale * (undo @ (self._mean - self._shift))
        """(k,) amplitudes, shrinkage undone; a new array after each update, as are the others"""
        self.covariance: Array = (undo @ self._doubt @ undo.T) * self._units
        """(k, k) of `value`"""
        self.sd: Array = np.sqrt(np.maximum(self.covariance.diagonal(), 0.0))
        """(k,) standard deviations of `value`"""

    @property
    def raw(self) -> tuple[Array, Array]:
        """(k,) mean and (k, k) covariance of the Kalman filter alone, before the shrinkage is undone."""
        covariance: Array = self._doubt * self._units
        return self._mean * self.scale, covariance

    @property
    def samples(self) -> Array:
        """(k,) how many samples stand behind each amplitude; what drift has outdated no longer counts."""
        return self._samples.copy()

    @property
    def finite(self) -> bool:
        """False once a NaN or an overflow has got in: the filter is then worth nothing."""
        return math.isfinite(float(self.value.sum() + self.covariance.sum()))

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """(k,) False where noise is so much of what excites a column that its shrinkage cannot be undone."""
        trusted: NDArray[np.bool_] = np.abs(np.diag(self._shrink)) < SHRINKAGE_LIMIT
        return trusted

    def forget(self, share: Array) -> None:
        """Return doubt: (k,) shares of the prior variance that are added, 1 = start over in that direction."""
        before = self._doubt.diagonal().copy()
        self._doubt = self._doubt + np.diag(share)
        over = np.sqrt(np.maximum(self._doubt.diagonal(), 1.0))
        self._doubt = self._doubt / np.outer(over, over)
        self._samples *= np.minimum(before / np.maximum(self._doubt.diagonal(), 1e-300), 1.0)
        self._refresh()

    def rebase(self, mix: Array, offset: Array) -> None:
        """Mean the amplitudes mix @ amplitudes + offset from now on: (k, k) regular, (k,); doubt goes along."""
        mix, offset = mix * self.scale / self.scale[:, None], offset / self.scale
        self._mean = mix @ self._mean + offset
        self._doubt = mix @ self._doubt @ mix.T
        self._shrink = mix @ self._shrink @ np.linalg.inv(mix)
        self._shift = mix @ self._shift + self._shrink @ offset
        self._refresh()

    def dump(self) -> dict[str, list[float]]:
        """State as plain lists; `load` takes it back."""
        arrays = {
            "mean": self._mean,
            "covariance": self._doubt.ravel(),
            "removed": self._removed,
            "samples": self._samples,
            "shrink": self._shrink.ravel(),
            "shift": self._shift,
            "scale": self.scale,
            "drift": self._drift,
        }
        return {name: [float(v) for v in array] for name, array in arrays.items()}

    @classmethod
    def load(cls, state: dict[str, list[float]]) -> AmplitudeFilter:
        """The filter that `dump` described. Raises ValueError or KeyError if the lists do not fit together."""
        k = len(state["mean"])
        scale = np.array(state["scale"])
        made = cls(np.array(state["mean"]) * scale, scale, np.sqrt(np.array(state["drift"])) * scale)
        made._doubt = np.array(state["covariance"]).reshape(k, k)
        made._removed = np.array(state["removed"]).reshape(k)
        made._samples = np.array(state["samples"]).reshape(k)
        made._shrink = np.array(state["shrink"]).reshape(k, k)
        made._shift = np.array(state["shift"]).reshape(k)
        if not all(np.isfinite(values).all() for values in map(np.array, state.values())):
            raise ValueError("state is not finite")
        made._refresh()
        return made


PATTERN_S = 0.5
"""an effect that the model lacks repeats with the motion: it averages out no longer than this (guess, of the size of
a period of motion); more data do not make such an estimate more certain. Within it the pattern has as many degrees
of freedom as the motion, two per hertz of the motion's own bandwidth, not of the filter's: a friction turns round
when the motion does"""


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

    def __init__(self, floor: float, guess: float = 0.0, memory_s: float = LEVEL_MEMORY_S) -> None:
        """`floor` is what the sensors alone give; `guess` counts until something has been measured."""
        self.floor = floor
        self.guess = guess
        self._memory_s = memory_s
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

    def after(self, square: float, expected: float, directions: int) -> None:
        """Count the squares of an innovation's components, target minus factor @ amplitudes before the update, and what
        is expected of them from the doubt of the amplitudes."""
        if expected < directions * self.sd**2:
            self._along += square - expected
            self._counted += directions

    @property
    def structure(self) -> float:
        """Share of the variance that sensor noise does not explain."""
        return structure_share(self.floor**2, self.sd**2)

    @property
    def sd(self) -> float:
        """Noise sd per compressed row, unit of the torque; never below the floor."""
        variance = self.floor**2
        if self._freedom < GUESS_BELOW:
            variance = max(variance, self.guess**2)
        outside = self._outside / self._freedom if self._freedom > 0 else 0.0
        along = self._along / self._counted if self._counted > 0 else 0.0
        chance = CLEARLY * math.sqrt(2 / self._counted) if self._counted > 0 else 0.0
        return math.sqrt(max(variance, outside, along if along > (1 + chance) * outside else 0.0))

    def dump(self) -> list[float]:
        """State as a plain list; `load` takes it back."""
        return [self.floor, self.guess, self._outside, self._freedom, self._along, self._counted]

    @classmethod
    def load(cls, state: list[float]) -> NoiseLevel:
        """The level that `dump` described. Raises ValueError for another number of values."""
        made = cls(state[0], state[1])
        made._outside, made._freedom, made._along, made._counted = map(float, state[2:])
        return made
