"""A residual whose rows count for what they tell: less of each row what those before it foretell.

What a model leaves of a drive is seldom white: laws that nobody has named yet are slow, and a small ripple beside them
takes a thousandth of the error although nothing else is left where it is. Errors of explanations are therefore compared
behind the autoregression that describes what the best of them leaves (feasible generalised least squares; Cochrane &
Orcutt 1949, J. Am. Stat. Assoc. 44).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.records import Array

ORDER = 8
"""Numbers of the autoregression: enough for what falls or rises with the frequency, too few for a line."""
ROWS_PER_NUMBER = 50
"""Rows for each of those below which nothing is evened out (guess)."""


@dataclass(frozen=True, slots=True)
class Evening:
    """What each row of a residual is foretold by."""

    weights: Array
    """(p,) of the row before, of the one before that, ..."""
    before: NDArray[np.intp]
    """(m,) rows that stand before each without a gap"""

    def of(self, residual: Array) -> Array:
        """(m,) each row less what those before it foretell, white noise as large as it was."""
        out = np.array(residual, dtype=float)
        for lag, weight in enumerate(self.weights, 1):
            out[lag:] -= weight * (self.before[lag:] >= lag) * residual[:-lag]
        return out / math.sqrt(1 + float(self.weights @ self.weights))


def evening_of(residual: Array, trials: Sequence[PreparedMotion]) -> Evening | None:
    """What evens a residual (m,) out; None where there is too little of it."""
    before = np.concatenate([_before(trial) for trial in trials])
    rows = np.flatnonzero(before >= ORDER)
    if len(rows) < ROWS_PER_NUMBER * ORDER:
        return None
    past = residual[rows[:, None] - np.arange(1, ORDER + 1)]
    return Evening(np.linalg.lstsq(past, residual[rows], rcond=None)[0], before)


def _before(trial: PreparedMotion) -> NDArray[np.intp]:
    """(m,) rows of a recording that stand before each in its block without a gap."""
    broken = (np.diff(trial.rows) != trial.step) | (np.diff(trial.block) != 0)
    starts = np.concatenate(([0], np.flatnonzero(broken) + 1))
    place = np.arange(len(trial.rows))
    return np.asarray(place - starts[np.searchsorted(starts, place, side="right") - 1], dtype=np.intp)
