"""Which ranges of a spring the motion reaches: beyond a corner that it may not have come to, nothing is told.

A spring's columns are linear in its amplitudes for one place of its corners. Where a corner is in doubt and lies near
the end of the motion, the range behind it may hold a few samples or none: what an amplitude's deviation says of the
place assumed is then no deviation of the amplitude (profile likelihood instead of the linear one; Bates and Watts,
Nonlinear Regression Analysis and Its Applications, 1988, section 6.1).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from edge_daemon.effects.effect import Effect
from edge_daemon.motion.regressors import AmplitudeKey, Regressors, still
from edge_daemon.records import Array

MEMORY_S = 60.0
"""A twist counts as reached for about this long after it was (guess): a motion's largest come seldom."""
POINTS = 64
"""So many twists from none to the farthest stand for the motion."""
TELLING = 3.0
"""An amplitude of fewer deviations may be none: then nothing was learned of its corner either (guess)."""


class Reach:
    """Follows how far a gear is twisted."""

    def __init__(self, regressors: Regressors, doubt: Mapping[AmplitudeKey, float]) -> None:
        """`doubt`: of each shape's logarithm before the data."""
        self._regressors, self._doubt = regressors, doubt
        self._springs = [row for row in regressors.rows if row[0].is_spring and row[0].free_shapes]
        self.forget()

    def forget(self) -> None:
        """Nothing was seen yet."""
        self._farthest_rad = 0.0

    def follow(self, felt_rad: Array, duration_s: float) -> None:
        """(n,) twists that the gear felt in this time [rad]."""
        if self._springs and len(felt_rad):
            faded = self._farthest_rad * math.exp(-duration_s / MEMORY_S)
            self._farthest_rad = max(faded, float(np.abs(felt_rad).max()))

    def wider(self, value: Array, sd: Array) -> Array:
        """(k,) factors on the deviations `sd` (k,) of the amplitudes `value` (k,), infinite where the motion may not
        have come to a range at all."""
        factor = np.ones(len(value))
        if self._farthest_rad > 0:
            for effect, held, place in self._springs:
                factor[place] = self._wider_of(effect, held, place, value, sd)
        return factor

    def _wider_of(self, effect: Effect, held: Mapping[str, float], place: slice, value: Array, sd: Array) -> Array:
        """(m,) factors of one spring's amplitudes."""
        places = {row.name: self._regressors.index(effect.name, row.name) for row in effect.free_shapes}
        moved = {name: float(np.exp(value[i])) for name, i in places.items() if i is not None}
        shapes = {name: size * moved.get(name, 1.0) for name, size in held.items()}
        here, tells = self._columns(effect, shapes), np.abs(value[place]) > TELLING * sd[place]
        factor = np.ones(here.shape[1])
        for name, i in places.items():
            doubt = self._doubt[effect.name, name]
            there = self._columns(effect, _times(shapes, name, doubt))
            if i is not None and tells[np.any(there != here, axis=0)].any():
                doubt = min(doubt, float(sd[i]))
            for step in (doubt, -doubt):
                factor = np.maximum(factor, _fewer(here, self._columns(effect, _times(shapes, name, step))))
        return factor

    def _columns(self, effect: Effect, shapes: Mapping[str, float]) -> Array:
        """(POINTS, m) of the spring at rest, as far as it is twisted."""
        rest = still(POINTS, self._regressors.model.ratio, self._regressors.extra)
        twisted = replace(rest, twist_rad=np.linspace(0.0, self._farthest_rad, POINTS))
        columns: Array = effect.columns(twisted, shapes, None)[0]
        return columns


def _times(shapes: Mapping[str, float], name: str, step: float) -> dict[str, float]:
    """The shapes with the logarithm of one moved by `step`."""
    return {**shapes, name: shapes[name] * math.exp(step)}


def _fewer(here: Array, there: Array) -> Array:
    """(m,) how many times as large columns are at one place of a corner as at another; infinite where either is beyond
    the motion."""
    before, after = (np.sqrt(np.mean(columns**2, axis=0)) for columns in (here, there))
    times: Array = np.divide(before, after, out=np.full(len(before), math.inf), where=(before > 0) & (after > 0))
    return times
