"""How far amplitudes may be off because of what the model lacks: the part of it that looks like one of their columns.

What is left after a fit stands across all columns, so it shows nothing of that part directly. But friction, a dead
zone, a spring that stiffens or a hysteresis are odd in twist and rate, and leave a shape behind that goes with the part
taken up: a dry friction F sgn(v) on a sine of speed V adds 4 F / (pi V) to the damping and leaves a third harmonic of a
third of that (describing function; Gelb & Vander Velde, Multiple-input describing functions, 1968, ch. 2). So odd
shapes are fitted to what is left, and what each would add to every amplitude, left out of the model, is a doubt
(omitted-variable bias; Greene, Econometric analysis, 2003, section 8.2.1).

x |x| of twist and rate stands for what depends on either: on a sine its own part along x is 5 times its third
harmonic, that of a sign or a cube 3 times; on a motion of many tones those are 6, 6 and 3. The doubt is that of a dry
friction, or up to twice what another law adds. A law with memory lags behind: x |y|, where y is the other one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from edge_daemon.motion.noise_level import ColumnNoise
from edge_daemon.motion.regressors import STIFFNESS, Regressors
from edge_daemon.records import Array

ODD_OF = ("twist_rad", "twist_rate_rad_s", "velocity_out_rad_s")
"""Signals that an odd law depends on: a column that is one of them takes up a part of the law."""
SURE = 3.0
"""A shape's size of this many sd is no chance."""
MEMORY_BLOCKS = 2000.0
"""Ten minutes hold so many blocks of 0.3 s."""
FIND_BLOCKS = 7
"""The doubt is found anew after so many blocks."""
LEAST_ACROSS = 1e-3
"""This share of a shape must stand across the columns to be told from them."""
RIDGE = 1e-9
"""This share of a column's power keeps columns that nothing excites solvable."""


class ModelBias:
    """Products of columns and odd shapes with each other and with what is left, with forgetting."""

    def __init__(self, regressors: Regressors) -> None:
        at = regressors.following(ODD_OF)
        self._twist = regressors.index(*STIFFNESS)
        self._amplitudes = len(regressors.keys)
        self._x, self._y = (np.repeat(at, len(at)).astype(int), np.tile(at, len(at)).astype(int))
        self._slopes = np.where(self._x == self._y, 2.0, 1.0)
        """of x |y| by the noise of x, over |y|"""
        self.forget()

    def forget(self) -> None:
        """Nothing was seen yet."""
        self.doubt = np.zeros(self._amplitudes)
        """(k,) sd of each amplitude for this reason"""
        self.begin()

    def begin(self) -> None:
        """Columns are others from now on; the doubt stays until it is found anew."""
        size = self._amplitudes + len(self._x)
        self._products, self._left = np.zeros((size, size)), np.zeros(size)
        self._blocks = 0

    def follow(
        self, columns: Array, torque: Array, zero_rad: float, sd: float, noise: ColumnNoise, value: Array
    ) -> None:
        """(n, k) columns and (n,) torque with amplitudes of this `value` (k,); `zero_rad` of the twist; `sd` of a
        compressed row; `noise` in the columns."""
        self._blocks += 1
        if not len(self._x):
            return
        k, places = self._amplitudes, np.concatenate((np.arange(self._amplitudes), self._x))
        rows = columns[:, places]
        size = np.abs(columns[:, self._y])
        if self._twist is not None and zero_rad:
            rows[:, k:][:, self._x == self._twist] += zero_rad
            size = np.abs(columns[:, self._y] + zero_rad * (self._y == self._twist))
        rows[:, k:] *= size
        # the noise in a column goes with that in what is left: E[n f(x + n)] is its variance times the mean slope of f
        shared = noise.torque - noise.columns @ value
        slopes = np.concatenate((np.full(k, float(len(rows))), self._slopes * size.sum(axis=0)))
        self._products *= 1 - 1 / MEMORY_BLOCKS
        self._products += rows.T @ rows
        self._left *= 1 - 1 / MEMORY_BLOCKS
        self._left += (torque - columns @ value) @ rows - slopes * shared[places]
        if self._blocks % FIND_BLOCKS == 0:
            self._find(sd)

    def _find(self, sd: float) -> None:
        k = self._amplitudes
        power = self._products.diagonal()
        scale = np.sqrt(np.where(power > 0, power, 1.0))
        products, left = self._products / np.outer(scale, scale), self._left / scale
        along = np.linalg.solve(products[:k, :k] + RIDGE * np.eye(k), products[:k, k:])
        across = products.diagonal()[k:] - np.einsum("ij,ij->j", products[:k, k:], along)
        told = across > LEAST_ACROSS
        size = (left[k:] - left[:k] @ along)[told] / across[told]
        square = np.maximum(size**2 - (SURE * sd) ** 2 / across[told], 0.0)
        self.doubt = np.sqrt(along[:, told] ** 2 @ square) / scale[:k]

    def dump(self) -> dict[str, Any]:
        """Plain data."""
        arrays = {"products": self._products.ravel(), "left": self._left, "doubt": self.doubt}
        return {"blocks": self._blocks, **{name: array.tolist() for name, array in arrays.items()}}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave. Raises ValueError for another number of columns."""
        size = len(self._left)
        self._products = np.array(state["products"], dtype=float).reshape(size, size)
        self._left = np.array(state["left"], dtype=float).reshape(size)
        self.doubt = np.array(state["doubt"], dtype=float).reshape(self._amplitudes)
        self._blocks = int(state["blocks"])
