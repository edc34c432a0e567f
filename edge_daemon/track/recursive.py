"""Recursive least squares over effect amplitudes: a Kalman filter fed one compressed block at a time.

A block of n samples with k columns carries no more about k amplitudes than its triangular factor: `compress` takes
[columns | torque] to a (k, k) factor and a (k,) target by QR, and one filter update with these gives the posterior
of n scalar updates (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. IV).

Noise also stands in the columns (errors in variables). The expected shrinkage it causes is linear in the true
amplitudes, so it is carried beside the filter as a (k, k) matrix and undone on reading: the filter itself stays the
textbook one. Batch form: Soderstrom, Errors-in-variables methods in system identification, Automatica 43 (2007),
section 5 (bias-compensated least squares with known noise covariance). What the doubt of a shape that is held makes of
the amplitudes is carried in the same way (consider covariance; Schmidt, Advances in Control Systems 3, 1966; Bierman,
ch. VIII).
"""

from __future__ import annotations

import math

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.linalg import lapack

from edge_daemon.motion.noise_level import ColumnNoise, Compressed
from edge_daemon.records import Array

SHRINKAGE_LIMIT = 0.7
"""A direction of which noise makes up more than this share of the information is not trusted (guess: the compensated
estimate is then three times as uncertain as the filter's)."""
REGROWTH = 2.0
"""Doubt of an amplitude whose drift is stated comes back at most so many times as fast as the last block removed it
(guess): with one, a filter that was surer once than its drift allows would stay so."""


class AmplitudeFilter:
    """Amplitudes with covariance. Never grows without excitation: drift enters only where data removed doubt.

    Stiffness and damping from twist, its rate and the torque, ten blocks of a hundred samples with noise of 0.1 N m:

    >>> from edge_daemon.motion.noise_level import compress
    >>> rng, truth = np.random.default_rng(1), np.array([1e5, 12.0])
    >>> filt = AmplitudeFilter(mean=np.zeros(2), prior_sd=np.array([1e6, 1e3]), drift_per_sqrt_s=np.zeros(2))
    >>> for _ in range(10):
    ...     columns = rng.normal(size=(100, 2)) * [1e-4, 1e-2]
    ...     block = compress(columns, columns @ truth + 0.1 * rng.normal(size=100))
    ...     filt.update(block, noise_sd=0.1, elapsed_s=0.1)
    >>> bool(np.all(abs(filt.value - truth) < 3 * filt.sd)), [float(f"{sd:.2g}") for sd in filt.sd]
    (True, [32.0, 0.32])

    `mean` (k,), `prior_sd` (k,) and `drift_per_sqrt_s` (k,) are in the amplitudes' units; the drift is the standard
    deviation of a random walk after one second.
    """

    def __init__(self, mean: Array, prior_sd: Array, drift_per_sqrt_s: Array) -> None:
        k = len(mean)
        self.scale = np.asarray(prior_sd, dtype=float).copy()
        self._drift = (drift_per_sqrt_s / self.scale) ** 2
        self._kalman = KalmanFilter(dim_x=k, dim_z=k)
        self._kalman.inv = _inverse
        self._mean = mean / self.scale
        self._doubt = np.eye(k)
        self._removed, self._moved = np.zeros(k), np.zeros(k)
        self._samples, self._regrowth = np.zeros(k), np.ones(k)
        self._shrink = np.zeros((k, k))
        self._shift = np.zeros(k)
        self._leaning = np.zeros((k, 0))
        """(k, s) by how much the amplitudes are off for one sd of each held shape, over `scale`"""
        self._identity = np.eye(k)
        self._units = np.outer(self.scale, self.scale)
        self._refresh()

    def update(
        self,
        block: Compressed,
        noise_sd: float,
        elapsed_s: float,
        noise: ColumnNoise | None = None,
        held: Array | None = None,
    ) -> None:
        """Take in a block whose rows carry white noise of `noise_sd` [unit of the torque].

        `elapsed_s` is the time since the last block that was taken in; `noise` the sensor noise in the columns;
        `held` (k, s) products of the columns with the torque that one sd of each held shape makes.
        """
        self._predict(elapsed_s)
        before, mean = self._doubt.diagonal().copy(), self._mean
        keep = self._condition(block.factor * (self.scale / noise_sd), block.target / noise_sd)
        self._moved = self._mean - mean
        self._removed = np.maximum(before - self._doubt.diagonal(), 0.0)
        self._samples += block.samples
        self._follow_shrinkage(keep, block, noise_sd, noise)
        if held is not None:
            if held.shape != self._leaning.shape:
                self._leaning = np.zeros(held.shape)
            self._leaning = keep @ self._leaning + self._doubt @ (held * self.scale[:, None] / noise_sd**2)
        self._refresh()

    def _predict(self, elapsed_s: float) -> None:
        doubt, added = self._doubt.diagonal(), self._added(elapsed_s)
        self._samples *= doubt / np.maximum(doubt + added, 1e-300)
        self._doubt.flat[:: len(added) + 1] += added

    def _added(self, elapsed_s: float) -> Array:
        """Drift, but per direction never far more than the last block removed, and never beyond the prior (1)."""
        most = np.minimum(self._regrowth * self._removed, np.maximum(1.0 - self._doubt.diagonal(), 0.0))
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
        """(k,) standard deviations of `value`, as if the held shapes were right"""
        self.held_sd: Array = self.scale * np.sqrt(np.square(undo @ self._leaning).sum(axis=1))
        """(k,) what their doubt adds to that, in the mean square"""

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
    def step(self) -> tuple[Array, Array]:
        """(k,) what the last update moved the amplitudes by, over `scale`, and (k,) what it took off their variance."""
        return self._moved, self._removed

    @property
    def finite(self) -> bool:
        """False once a NaN or an overflow has got in: the filter is then worth nothing."""
        return math.isfinite(float(self.value.sum() + self.covariance.sum()))

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """(k,) False where noise is so much of what excites a column that its shrinkage cannot be undone, or undoing it
        takes doubt away, which it cannot where the noise is reckoned right."""
        surer = self.sd < SHRINKAGE_LIMIT * self.scale * np.sqrt(self._doubt.diagonal())
        trusted: NDArray[np.bool_] = (np.abs(np.diag(self._shrink)) < SHRINKAGE_LIMIT) & ~surer
        return trusted

    def drift_by(self, i: int, per_sqrt_s: float) -> None:
        """Expect a random walk of amplitude i of this sd after one second, in its own unit: one that is stated."""
        self._regrowth[i], self._drift[i] = REGROWTH, (per_sqrt_s / self.scale[i]) ** 2

    def wander(self, elapsed_s: float) -> None:
        """So long nothing was seen of what the amplitudes stand for: their doubt grows by all of their drift."""
        doubt = self._doubt.diagonal()
        self._doubt.flat[:: len(doubt) + 1] += np.minimum(self._drift * elapsed_s, np.maximum(1.0 - doubt, 0.0))
        self._refresh()

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
        self._leaning = mix @ self._leaning
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
            "leaning": self._leaning.ravel(),
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
        made._leaning = np.array(state["leaning"]).reshape(k, -1) if state["leaning"] else np.zeros((k, 0))
        if not all(np.isfinite(values).all() for values in map(np.array, state.values())):
            raise ValueError("state is not finite")
        made._refresh()
        return made


PATTERN_S = 0.5
"""An effect that the model lacks repeats with the motion, and averages out no longer than this (guess, of the size of a
period of motion); more data do not make such an estimate more certain. Within it the pattern has as many degrees of
freedom as the motion, two per hertz of the motion's own bandwidth, not of the filter's: a friction turns round when the
motion does."""


def _inverse(matrix: Array) -> Array:
    """Of a symmetric matrix; of one that rounding makes singular, without the directions that it hides."""
    try:
        return np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrix, hermitian=True))
