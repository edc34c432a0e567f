"""Rows of a regression made equally noisy: what is left of the motor encoder's noise behind its filter is slow, the
output encoder's is white.

Noise of a known spectrum is what drives an autoregression of it (Yule-Walker; Kay, Modern Spectral Estimation, 1988,
section 6.3); subtracted from each row what the rows before tell of its noise, least squares weighs alike what is
equally sure. A row is an equation, and so is a sum of rows: the amplitudes stay what they are.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_toeplitz

from edge_daemon.motion.filter_matrix import banded
from edge_daemon.records import Array

ORDER = 16
"""So many rows before tell of a row's noise: twice the length of the filter's middle part."""
TRANSFORM = 1024
"""Spectra are taken over so many samples."""
LITTLE = 0.02
"""Below this share of the white noise the rest is not worth the trouble."""
LEAST = 1e-3
"""This share of all noise counts as white however little there is: noise without any would be known beforehand."""


class Whitening:
    """Carries the rows that the next ones still need."""

    def __init__(self) -> None:
        self._weights = np.ones(1)
        """newest row first; they sum to one: what is slow keeps its size"""
        self.white_rad2 = math.nan
        """variance of a row's noise afterwards"""
        self._matrix = np.empty((0, 0))
        self.forget()

    def forget(self) -> None:
        """The next rows do not follow the last ones."""
        self._tail: Array | None = None

    def expect(self, white_rad2: float, rest_rad2: Array) -> None:
        """Noise of one variance at all frequencies and, on top, of a spectrum (TRANSFORM // 2 + 1,), per sample."""
        weights, variance = np.ones(1), white_rad2 + float(np.fft.irfft(rest_rad2)[0])
        white_rad2 = max(white_rad2, LEAST * variance)
        if variance > (1 + LITTLE) * white_rad2:
            alike = np.fft.irfft(white_rad2 + rest_rad2)[: ORDER + 1]
            before = solve_toeplitz(alike[:-1], alike[1:])
            weights = np.append(1.0, -before)
            variance = float(alike @ weights) / weights.sum() ** 2
            weights = weights / weights.sum()
        if len(weights) != len(self._weights):
            self.forget()
        self._weights, self.white_rad2 = weights, variance
        self._matrix = np.empty((0, 0))

    def rows(self, columns: Array, torque: Array) -> tuple[Array, Array]:
        """(n, k) columns and (n,) torque of rows that follow the last ones; NaN the torque of those that nothing was
        known before."""
        order = len(self._weights) - 1
        if order == 0:
            return columns, torque
        new = np.column_stack((columns, torque))
        begun = self._tail is not None
        joined = np.concatenate((self._tail if self._tail is not None else np.zeros((order, new.shape[1])), new))
        self._tail = joined[-order:]
        if self._matrix.shape[0] != len(new):
            self._matrix = banded(self._weights, len(joined))
        white = self._matrix @ joined
        if not begun:
            white[:order] = 0.0
            white[:order, -1] = math.nan
        return white[:, :-1], white[:, -1]
