"""An unscented Kalman filter over logarithms: what is positive and enters a torque in no straight line.

A window of motion is predicted at every sigma point; what the predictions differ by spans a few directions, and only
along these can the window say anything. So it is first brought to as many numbers by QR, as in `recursive`; columns
that nobody asks about (a constant, the linear part of the balance) are taken out by the same stroke, at no doubt.

Source: Julier & Uhlmann, Proc. IEEE 92(3) (2004); van der Merwe (2004), scaled points; for the fading memory Fagin,
IEEE Int. Conv. Rec. 12 (1964).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from edge_daemon.motion.noise_level import compress
from edge_daemon.records import Array

REACH = 1.0
"""The sigma points reach so many standard deviations."""
SURPRISE = 5.0
"""Beyond so many standard deviations of the innovation's square above what was expected of it the window counts as
noisier than it is, until it is none: where the law bends within its doubt, a full step would lead astray."""
FADE = 4.0
"""The doubt then grows by as much, this at most, and never beyond that of the start."""
TRIES = 8
SHOCK = 3.0
"""A window of so many times the usual noise is a shock."""
MEMORY = 10.0
"""The noise is averaged over so many windows."""
SMALLEST = 1e-14


class ShapeFilter:
    """`mean` (n,) with sd (n,) at the start, and sd (n,) of a random walk after one second."""

    def __init__(self, mean: Array, sd: Array, drift_per_sqrt_s: Array) -> None:
        n = len(mean)
        points = MerweScaledSigmaPoints(n, alpha=REACH / math.sqrt(n), beta=2.0, kappa=0.0)
        self._ukf = UnscentedKalmanFilter(n, 2 * n, 1.0, None, lambda x, dt: x, points)
        self._ukf.x, self._ukf.P = np.array(mean, dtype=float), np.diag(np.asarray(sd, dtype=float) ** 2)
        self._most = np.asarray(sd, dtype=float) ** 2
        self._drift = np.asarray(drift_per_sqrt_s, dtype=float) ** 2
        self._power = self._freedom = 0.0
        self.newest_sd = math.nan
        """noise of the rows of the newest window that was learned from"""

    @property
    def value(self) -> Array:
        """(n,) mean."""
        mean: Array = self._ukf.x
        return mean

    @property
    def sd(self) -> Array:
        """(n,) standard deviations."""
        sd: Array = np.sqrt(self._ukf.P.diagonal())
        return sd

    @property
    def noise_sd(self) -> float:
        """Of a row, as measured; NaN before any."""
        return math.sqrt(self._power / self._freedom) if self._freedom > 0 else math.nan

    def sigmas(self, elapsed_s: float) -> Array:
        """(2n + 1, n) points at which the next window is to be predicted; `elapsed_s` since the last one."""
        room = np.maximum(self._most - self._ukf.P.diagonal(), 0.0)
        self._ukf.Q = np.diag(np.minimum(self._drift * elapsed_s, room))
        try:
            self._ukf.predict()
        except np.linalg.LinAlgError:  # rounding has eaten a doubt: it starts over around what was found
            self.reopen(1.0)
            self._ukf.predict()
        points: Array = self._ukf.sigmas_f
        return points

    def update(self, seen: Array, predicted: Array, nuisance: Array, bandwidth: float = 1.0) -> float:
        """Take in (m,) rows, as predicted (m, 2n + 1) at the sigma points, up to any multiple of the (m, q) columns.

        `bandwidth` is the share of the rows that are independent. Returns this window's noise over the usual one; a
        window beyond `SHOCK` is not learned from.
        """
        apart, q = predicted[:, 1:] - predicted[:, :1], nuisance.shape[1]
        block = compress(np.concatenate((nuisance, apart), axis=1), seen - predicted[:, 0])
        freedom = max(len(seen) * bandwidth - q - apart.shape[1], 1.0)
        usual, noise = self.noise_sd, math.sqrt(block.residual / freedom)
        if noise > SHOCK * usual:
            return noise / usual
        self._power = self._power * (1 - 1 / MEMORY) + block.residual
        self._freedom = self._freedom * (1 - 1 / MEMORY) + freedom
        rows = np.concatenate((np.zeros((1, apart.shape[1])), block.factor[q:, q:].T))
        self._learn(rows, block.target[q:], max(self.noise_sd, SMALLEST) ** 2)
        self.newest_sd = noise
        return noise / usual if usual > 0 else 1.0

    def _learn(self, rows: Array, target: Array, variance: float) -> None:
        """One update, with as much noise as makes it no surprise."""
        ukf = self._ukf
        before, doubt = ukf.x, ukf.P
        louder, most = 1.0, 1 + SURPRISE * math.sqrt(2 / len(target))
        for _ in range(TRIES):
            points = iter(rows)
            ukf.x, ukf.P = before, doubt
            ukf.update(target, R=louder * variance, hx=lambda _, points=points: next(points))
            surprise = float(ukf.y @ ukf.SI @ ukf.y) / len(target)
            if surprise <= most:
                break
            louder *= max(surprise, 1.5)
        ukf.P = (ukf.P + ukf.P.T) / 2 * min(louder, FADE)
        over = np.sqrt(np.maximum(ukf.P.diagonal() / self._most, 1.0))
        ukf.P = ukf.P / np.outer(over, over) + SMALLEST * np.eye(len(before))

    def reopen(self, share: float) -> None:
        """Doubt again, as much as `share` of the start's sd, around what was found."""
        self._ukf.P = np.diag(self._most * share**2)

    @property
    def sound(self) -> bool:
        """False once it is worth nothing: an overflow, or a doubt that is none."""
        doubt = self._ukf.P.diagonal()
        return bool(np.isfinite(self._ukf.x).all() and np.isfinite(doubt).all() and (doubt > 0).all())

    def dump(self) -> dict[str, Any]:
        """Plain data; `load` takes it back."""
        arrays = {"mean": self.value, "doubt": self._ukf.P.ravel(), "most": self._most, "drift": self._drift}
        return {name: array.tolist() for name, array in arrays.items()} | {"noise": [self._power, self._freedom]}

    @classmethod
    def load(cls, state: dict[str, Any]) -> ShapeFilter:
        """What `dump` gave. Raises KeyError, TypeError or ValueError where it does not fit together."""
        mean, most, drift = (np.array(state[name], dtype=float) for name in ("mean", "most", "drift"))
        made = cls(mean, np.sqrt(most), np.sqrt(drift))
        made._ukf.P = np.array(state["doubt"], dtype=float).reshape(len(mean), len(mean))
        made._power, made._freedom = map(float, state["noise"])
        if most.shape != mean.shape or drift.shape != mean.shape or not made.sound:
            raise ValueError("state is not sound")
        return made
