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

from edge_daemon.motion.kinematics import FirSet
from edge_daemon.records import Array, Mask

MOST_SAMPLES = 1500
"""Unsure samples of one episode above which they are thinned: all directions of 3772 took 36 s (guess)."""
NEGLIGIBLE_SHARE = 1e-3
"""Size of a direction over the largest below which an unknown friction leaves less than noise in it."""


@dataclass(frozen=True, slots=True)
class UnknownDirections:
    """Orthonormal directions over a run of rows."""

    rows: slice
    basis: Array
    """(rows, k)"""


def unknown_directions(unsure: Mask, rows: NDArray[np.intp], fir: FirSet) -> tuple[UnknownDirections, ...]:
    """Where a filter spreads what is unknown in the `unsure` samples (n,); `rows` are the samples that are kept."""
    kernel = fir.value
    heard = np.flatnonzero(np.abs(kernel) > NEGLIGIBLE_SHARE * kernel.max())
    middle = len(kernel) // 2
    reach = max(middle - int(heard[0]), 1)
    out = []
    for every in _episodes(unsure, rows, reach):
        samples = every if len(every) <= MOST_SAMPLES else _thinned(every, fir.step)
        start, stop = np.searchsorted(rows, (samples[0] - reach, samples[-1] + reach + 1))
        apart = rows[start:stop, None] - samples
        spread = np.where(np.abs(apart) <= reach, kernel[middle + np.clip(apart, -reach, reach)], 0.0)
        left, size, _ = np.linalg.svd(spread, full_matrices=False)
        out.append(UnknownDirections(slice(int(start), int(stop)), left[:, size > NEGLIGIBLE_SHARE * kernel.max()]))
    return tuple(out)


def _thinned(samples: NDArray[np.intp], step: int) -> NDArray[np.intp]:
    """Unsure samples without most of those between which a filter cannot tell: the ends of each run, and every so many
    in it."""
    apart = np.diff(samples, prepend=-2, append=samples[-1] + 2) > 1
    return np.asarray(samples[apart[:-1] | apart[1:] | (samples % step == 0)])


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
