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
        self.signal, self.basis = signal, basis
        """(m,) what is left of it beside the columns of (m, q) an orthonormal basis"""

    @classmethod
    def of(cls, signal: Array, columns: Array) -> LeftOver:
        """Beside columns (m, p)."""
        basis = _basis(columns / _sizes(columns))
        return cls(_apart(signal, basis), basis)

    @property
    def power(self) -> float:
        """Sum of squares of what is left."""
        return float(self.signal @ self.signal)

    def beside(self, more: Array) -> LeftOver:
        """Beside further columns (m, k) as well."""
        new = self._new(more)
        return LeftOver(_apart(self.signal, new), np.hstack((self.basis, new)))

    def left_by(self, more: Array) -> Array:
        """(m,) what further columns (m, k) leave of it."""
        return _apart(self.signal, self._new(more))

    def _new(self, more: Array) -> Array:
        """(m, q) orthonormal, what columns (m, k) are beside those that were fitted, taken apart twice: once leaves
        rounding (Giraud, Langou & Rozloznik 2005, Comput. Math. Appl. 50)."""
        return _basis(_apart(_apart(more / _sizes(more), self.basis), self.basis))

    def within(self, mask: Mask) -> LeftOver:
        """Some of the rows alone."""
        return self if mask.all() else LeftOver.of(self.signal[mask], self.basis[mask])


def _apart(rows: Array, basis: Array) -> Array:
    """(m,) or (m, k) what a basis (m, q) cannot make of others."""
    return np.asarray(rows - basis @ (basis.T @ rows))


def _sizes(columns: Array) -> Array:
    return np.asarray(np.linalg.norm(columns, axis=0) + 1e-300)


def _basis(columns: Array) -> Array:
    """(m, q) orthonormal, of what columns (m, k) of size 1 or less span."""
    if not columns.shape[1]:
        return columns
    basis, r, _ = qr(columns, mode="economic", pivoting=True, check_finite=False)
    return np.asarray(basis[:, np.abs(np.diagonal(r)) > NEGLIGIBLE])
