"""How well the model of a moment ago predicted each block: overall, and by operating condition."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array, Motion

MEMORY_S = 60.0
"""The error is that of about the last minute."""
SPEED_EDGES_RAD_S = (10.0, 100.0, 200.0)
"""Motor speeds are told apart as standing, up to a third, two thirds, all of 3000 rpm."""
TORQUE_EDGES = (0.5, 1.5)
"""Torques are told apart over the rms so far as light, usual, heavy."""
GROSS = 2.0
"""Error of a block over its torque or the usual one, above which it is counted as gross and no further: one spoiled
block must not stand for a minute (guess)."""
TEMPERATURE_STEP_DEGC = 10.0


@dataclass(frozen=True, slots=True)
class Regime:
    """One operating condition."""

    speed: str
    direction: str
    torque: str
    temperature: str


@dataclass(frozen=True, slots=True)
class RegimeError:
    nrmse: float
    rmse: float
    samples: int


class PredictionError:
    """Sums of squares with forgetting; `add` before the parameters see the block."""

    def __init__(self, memory_s: float = MEMORY_S) -> None:
        self._memory_s = memory_s
        self._sums = np.zeros(4)
        self._blocks = 0.0
        self.gross = 0
        """blocks so far whose error was beyond all that a model explains"""
        self._regimes: dict[Regime, Array] = {}

    def add(self, motion: Motion, torque: Array, error: Array, good: NDArray[np.bool_], floor: float) -> None:
        """(n,) torque and error [N m]; `floor` is the variance that sensor noise alone gives the error [N^2 m^2]."""
        n = int(np.count_nonzero(good))
        if n == 0:
            return
        velocity = motion.velocity_out_rad_s
        if n < len(good):
            torque, error, velocity = torque[good], error[good], velocity[good]
        square, whole = float(error @ error), float(torque @ torque)
        usual = n * self._sums[1] / self._sums[3] if self._sums[3] > 0 else 0.0
        most = GROSS**2 * max(whole, usual)
        self.gross += square > most
        square = min(square, most)
        keep = math.exp(-len(motion) / motion.rate_hz / self._memory_s)
        self._sums = keep * self._sums + np.array([square, whole, n * floor, n])
        self._blocks = keep * self._blocks + 1.0
        row = self._regimes.setdefault(self._regime(motion, velocity, math.sqrt(whole / n)), np.zeros(3))
        row += (square, whole, n)

    def _regime(self, motion: Motion, velocity_rad_s: Array, torque_rms: float) -> Regime:
        """Of a block with these (n,) usable output speeds and this torque [N m]."""
        n, ratio = len(velocity_rad_s), abs(motion.ratio)
        velocity = float(velocity_rad_s.sum()) / n
        speed = float(np.abs(velocity_rad_s).sum()) / n * ratio
        usual = math.sqrt(self._sums[1] / self._sums[3])
        level = torque_rms / usual if usual > 0 else 1.0
        degc = float(motion.temperature_degC[-1])
        warm = f"{math.floor(degc / TEMPERATURE_STEP_DEGC) * TEMPERATURE_STEP_DEGC:.0f}" if degc == degc else "unknown"
        still = abs(velocity) * ratio < SPEED_EDGES_RAD_S[0]
        return Regime(
            speed=_bin(speed, SPEED_EDGES_RAD_S),
            direction="still" if still else "forward" if velocity > 0 else "backward",
            torque=_bin(level, TORQUE_EDGES),
            temperature=warm,
        )

    @property
    def rmse(self) -> float:
        """[N m]; NaN before the first block, as are the others."""
        return _root(self._sums[0], self._sums[3])

    @property
    def nrmse(self) -> float:
        """Error over torque, rms each."""
        return _root(self._sums[0], self._sums[1])

    @property
    def noise_floor(self) -> float:
        """What encoder noise alone would give for `nrmse`."""
        return _root(self._sums[2], self._sums[1])

    @property
    def relative_sd(self) -> float:
        """Standard deviation of `rmse` and `nrmse` over themselves, one degree of freedom a block at the least."""
        return 1.0 / math.sqrt(2.0 * self._blocks) if self._blocks > 0 else math.nan

    def by_regime(self) -> dict[Regime, RegimeError]:
        """Error per operating condition, since the start."""
        return {
            regime: RegimeError(_root(row[0], row[1]), _root(row[0], row[2]), int(row[2]))
            for regime, row in self._regimes.items()
        }


def _root(square: float, of: float) -> float:
    return math.sqrt(square / of) if of > 0 else math.nan


def _bin(value: float, edges: tuple[float, ...]) -> str:
    """The interval that `value` falls into, as text."""
    i = bisect_left(edges, value)
    low = f"{edges[i - 1]:g}" if i else "0"
    return f"{low}-{edges[i]:g}" if i < len(edges) else f"{low}-"
