"""What nothing tells of friction at a reversal, taken out of both sides of a balance.

Where the measured speed is within its own noise of zero, dry friction may have any value up to its level, and when it
turns round is known to a sample at best. So its torque in those samples counts as unknown with a variance without
bound: the directions in which the balance filter spreads them over the rows are left out of every fit (generalised
least squares, the limit of a large prior variance; Rao 1973, section 4a). All that lies between reversals stays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array, Mask

MOST_SAMPLES = 400
"""Unsure samples whose directions are looked for at once: the time grows with their cube (of 3772 it was 36 s)."""
NEGLIGIBLE_SHARE = 1e-3
"""Size of a direction over the largest below which an unknown friction leaves less than noise in it."""


@dataclass(frozen=True, slots=True)
class UnknownDirections:
    """Orthonormal directions over a run of rows."""

    rows: slice
    basis: Array
    """(rows, k)"""


def unknown_directions(unsure: Mask, rows: NDArray[np.intp], kernel: Array) -> tuple[UnknownDirections, ...]:
    """Where a filter spreads what is unknown in the `unsure` samples (n,); `rows` are the samples that are kept."""
    heard = np.flatnonzero(np.abs(kernel) > NEGLIGIBLE_SHARE * kernel.max())
    reach = max(len(kernel) // 2 - int(heard[0]), 1)
    out = []
    for samples in _episodes(unsure, rows, reach):
        start, stop = np.searchsorted(rows, (samples[0] - reach, samples[-1] + reach + 1))
        basis = _basis(samples, rows[start:stop], kernel, reach)
        out.append(UnknownDirections(slice(int(start), int(stop)), basis))
    return tuple(out)


def _basis(samples: NDArray[np.intp], rows: NDArray[np.intp], kernel: Array, reach: int) -> Array:
    """(rows, k) where a filter spreads what is unknown in samples: of many, what their parts span together."""
    if len(samples) > MOST_SAMPLES:
        halves = [_basis(half, rows, kernel, reach) for half in np.array_split(samples, 2)]
        left, size, _ = np.linalg.svd(np.hstack(halves), full_matrices=False)
        return np.asarray(left[:, size > NEGLIGIBLE_SHARE])
    seen = (rows >= samples[0] - reach) & (rows <= samples[-1] + reach)
    apart = rows[seen, None] - samples
    spread = np.where(np.abs(apart) <= reach, kernel[len(kernel) // 2 + np.clip(apart, -reach, reach)], 0.0)
    left, size, _ = np.linalg.svd(spread, full_matrices=False)
    told = left[:, size > NEGLIGIBLE_SHARE * kernel.max()]
    out = np.zeros((len(rows), told.shape[1]))
    out[seen] = told
    return out


def _episodes(unsure: Mask, rows: NDArray[np.intp], reach: int) -> Iterator[NDArray[np.intp]]:
    """Groups of unsure samples that rows see, of which no row sees two."""
    at = np.flatnonzero(unsure)
    if not len(rows):
        return
    following = np.searchsorted(rows, at)
    near = np.full(len(at), False)
    for side in (following - 1, following):
        inside = (side >= 0) & (side < len(rows))
        near |= inside & (np.abs(rows[np.clip(side, 0, len(rows) - 1)] - at) <= reach)
    at = at[near]
    if len(at):
        yield from np.split(at, np.flatnonzero(np.diff(at) > 2 * reach) + 1)


def without_unknown(columns: Array, directions: tuple[UnknownDirections, ...]) -> Array:
    """(m, ...) rows without the unknown directions."""
    out = np.array(columns)
    for row in directions:
        out[row.rows] -= row.basis @ (row.basis.T @ out[row.rows])
    return out
