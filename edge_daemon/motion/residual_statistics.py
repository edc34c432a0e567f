"""What a residual tells beyond chance: its independent samples, and the fall of squared errors over blocks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array


def independent(residual: Array, block: NDArray[np.intp], lags: int) -> float:
    """How many independent samples tell the scatter of a residual (m,), whose blocks do not know each other."""
    power = float(residual @ residual)
    if not power > 0:
        return float(len(residual))
    square = 0.0
    for k in range(1, lags):
        together = block[k:] == block[:-k]
        if together.any():
            product = float((residual[k:] * residual[:-k])[together].sum())
            square += (product / power * len(residual) / int(together.sum())) ** 2
    return len(residual) / (1.0 + 2.0 * square)


def surely(before: Array, after: Array) -> float:
    """t of the fall of squared errors (b,), paired over blocks."""
    return max(_t(before - after), _t(np.log(before / after)))


def _t(fall: Array) -> float:
    """Mean over its standard error: of squared errors, where busy blocks rule, or of logarithms, where all count."""
    return float(fall.mean()) / (float(fall.std(ddof=1)) / math.sqrt(len(fall)) + 1e-300)
