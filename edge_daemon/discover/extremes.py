"""What a formula says of the extremes of its axes when it is fitted without them: the fastest, the most loaded, the
hottest, the ends of the way. Another motion reaches other extremes, and a curve of a wrong shape goes astray there
first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.discover.leftover import TURNING, Leftover, orthogonal_squares
from edge_daemon.discover.refining import Formula, fitted, settled
from edge_daemon.discover.writing import ROUNDED, axes_of
from edge_daemon.records import Array

SHARE = 0.15
"""Share of the rows that count as an extreme of an axis (guess: less tells little, more is no extreme)."""
REACH = 0.75
"""Share of an axis's reach beyond which all is extreme, however many rows: a motion dwells where it turns (guess)."""
LEAST_INSIDE = 0.3
"""Share of a formula's square that is no extreme, below which it speaks of extremes alone, as an end stop does, and
nothing can be held out (guess)."""
ASTRAY = 2.0
"""Error on extremes that a formula was not fitted to, over that of the formula fitted to all, from which on it is a
curve through what was seen (guess)."""
ROUNDS = 4
"""Steps of a formula's numbers without the extremes."""
ExtremeRows = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class HeldOutExtremes:
    """How a formula does on extremes that it was not fitted to; the worst of its axes."""

    error: float
    """over that of the formula fitted to all, at least the noise"""
    without: float
    """over that without any formula"""

    @property
    def astray(self) -> bool:
        """Whether it goes wrong there."""
        return self.error > ASTRAY or self.without >= 1.0

    @property
    def level(self) -> float:
        """By which the error of all rows grows where the extremes are held out."""
        return math.sqrt(1.0 - SHARE + SHARE * max(self.error, 1.0) ** 2)


def stretch(leftover: Leftover, formula: Formula, floor: float) -> HeldOutExtremes:
    """Of a formula; floor: the rms that noise leaves. On few rows and without the filter, which is far from what is
    filtered where a motion is fast: what goes astray there is held against all rows."""
    found = _stretch(leftover.thin, formula, floor)
    return _stretch(leftover, formula, floor) if found.astray else found


def _stretch(rows: Leftover, formula: Formula, floor: float) -> HeldOutExtremes:
    worst = HeldOutExtremes(1.0, 0.0)
    columns = _columns(rows, formula)
    with_all = _left(rows, columns, np.ones(len(rows.left), dtype=bool))
    torque = (rows.left - with_all) ** 2
    for extreme in _extremes(rows, axes_of(formula)):
        if float(np.sum(torque[~extreme])) < LEAST_INSIDE * float(np.sum(torque)):
            continue
        inner = _inside(rows.where(~extreme), formula)
        if inner is None:
            continue
        predicted = _rms(_left(rows, _columns(rows, inner), ~extreme)[extreme])
        error = predicted / max(_rms(with_all[extreme]), floor)
        if error > worst.error:
            worst = HeldOutExtremes(error, predicted / max(_rms(rows.left[extreme]), floor))
    return worst


def _columns(rows: Leftover, formula: Formula) -> Array:
    """(m, k) of a formula."""
    return np.hstack([rows.columns(product) for product in formula.products])


def _inside(inside: Leftover, formula: Formula) -> Formula | None:
    """The formula fitted to rows that are no extremes; its numbers as they were where those rows do not tell them, as
    they do not tell the load from which on a law is full if that is an extreme."""
    as_it_was, inner = fitted(inside, formula.products), settled(inside, formula.products, ROUNDS)
    if as_it_was is None or inner is None:
        return None
    return as_it_was if as_it_was.square < ROUNDED * inner.square else inner


def helps(leftover: Leftover, columns: Array) -> bool:
    """Whether columns (m, k) of few rows, fitted without the extremes of any axis, leave less there than nothing."""
    thin = leftover.thin
    return all(
        _rms(_left(thin, columns, ~extreme)[extreme]) < _rms(thin.left[extreme])
        for extreme in _extremes(thin, leftover.names)
    )


def _left(rows: Leftover, columns: Array, kept: ExtremeRows) -> Array:
    """(m,) what is left everywhere by model and columns (m, k) fitted where `kept`."""
    design = np.hstack((rows.known, columns))
    return np.asarray(rows.left - design @ orthogonal_squares(design[kept], rows.left[kept])[1])


def _extremes(rows: Leftover, axes: Sequence[str]) -> Iterator[ExtremeRows]:
    """(m,) the rows at the end of each axis, to both sides where it has two."""
    for axis in (name for name in axes if name not in TURNING):
        span, column = rows.spans[axis], rows.rows[axis]
        size = np.abs(column - 0.5 * (span.low + span.high)) if span.two_sided else column
        low, high = float(size.min()), float(size.max())
        yield size > min(float(np.quantile(size, 1.0 - SHARE)), low + REACH * (high - low))


def _rms(column: Array) -> float:
    with np.errstate(over="ignore"):  # of what grows without end where it was not fitted: infinite
        return float(np.sqrt(np.mean(column**2))) if len(column) else 0.0
