"""What is left of a signal beside columns that were fitted to it, and of whatever is to be fitted next."""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr

from edge_daemon.records import Array, Mask

NEGLIGIBLE = 1e-9
"""What is left of a column over its own size below which others make all of it: rounding, near enough."""


class LeftOver:
    """A signal (m,) beside columns: only the space that these span counts, so that a basis of it is kept."""

    def __init__(self, signal: Array, basis: Array) -> None:
        self.basis = basis
        """(m, q) orthonormal"""
        self.signal = self.apart(signal)
        """(m,) what is left of it"""

    @classmethod
    def of(cls, signal: Array, columns: Array) -> LeftOver:
        """Beside columns (m, p)."""
        return cls(signal, _basis(columns / _sizes(columns)))

    @property
    def power(self) -> float:
        """Sum of squares of what is left."""
        return float(self.signal @ self.signal)

    def apart(self, rows: Array) -> Array:
        """(m,) or (m, k) what the columns cannot make of others."""
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def beside(self, more: Array) -> LeftOver:
        """Beside further columns (m, k) as well, each taken apart twice: once leaves rounding (Giraud, Langou &
        Rozloznik 2005, Comput. Math. Appl. 50)."""
        return LeftOver(self.signal, np.hstack((self.basis, _basis(self.apart(self.apart(more / _sizes(more)))))))

    def within(self, mask: Mask) -> LeftOver:
        """Some of the rows alone."""
        return self if mask.all() else LeftOver.of(self.signal[mask], self.basis[mask])


def _sizes(columns: Array) -> Array:
    return np.asarray(np.linalg.norm(columns, axis=0) + 1e-300)


def _basis(columns: Array) -> Array:
    """(m, q) orthonormal, of what columns (m, k) of size 1 or less span."""
    if not columns.shape[1]:
        return columns
    basis, r, _ = qr(columns, mode="economic", pivoting=True, check_finite=False)
    return np.asarray(basis[:, np.abs(np.diagonal(r)) > NEGLIGIBLE])
