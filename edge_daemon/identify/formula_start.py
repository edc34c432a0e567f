"""Where the search for a user's formula begins: at the best point of a coarse grid, where the model file says nothing.

A search that begins at 1 never finds a creep speed of 1e-3 rad/s: there tanh(rate / v) is a straight line, and every
other line is as good.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import Term

AXES: tuple[tuple[float, ...], ...] = (
    tuple(sorted({*(10.0 ** (k / 2) for k in range(-12, 13)), *map(float, range(2, 10))})),
    tuple(10.0**k for k in range(-6, 7)),
    tuple(10.0**k for k in range(-4, 5, 2)),
)
"""One, two or three unknown shapes are looked for here, each, in the parameter's own unit; small whole numbers are
orders of an angle. Of more than three a grid would take minutes."""
LARGEST_COLUMN = 1e100
"""Beyond it the squares of a fit overflow."""
ALIKE = 1e-4
"""Two points explain alike within this relative error: then the one nearer to 1 is taken (guess)."""


def begun(
    problem: RegressionProblem, terms: Sequence[Term], unstated: Mapping[str, Sequence[str]], rounds: int
) -> list[Term]:
    """The terms, each shape that its formula leaves open at the best point of a grid beside all that is known.

    `unstated` names the open shapes by effect; `rounds` of repetition settle what is known before.
    """
    known = [term for term in terms if term.effect.name not in unstated]
    before = problem.state
    found = {}
    if known:
        problem.fit(known, search=False, rounds=rounds)
    for term in terms:
        if term.effect.name in unstated:
            found[term.effect.name] = _best(problem, known, term, unstated[term.effect.name])
            known.append(found[term.effect.name])
    problem.restore(before)
    return [found.get(term.effect.name, term) for term in terms]


def _best(problem: RegressionProblem, known: Sequence[Term], term: Term, names: Sequence[str]) -> Term:
    """The term at its best point; as it is where no point gives numbers."""
    if len(names) > len(AXES):
        return term
    fixed = [problem.columns(row.effect, row.shapes) for row in known]
    rows: list[tuple[float, float, Term]] = []
    for point in itertools.product(AXES[len(names) - 1], repeat=len(names)):
        tried = replace(term, shapes={**term.shapes, **dict(zip(names, point, strict=True))})
        own = problem.columns(tried.effect, tried.shapes)
        if np.isfinite(own).all() and float(np.max(np.abs(own), initial=0.0)) < LARGEST_COLUMN:
            error = problem.solution([*known, tried], np.hstack((*fixed, own)), whole=True).rmse
            rows.append((error, math.hypot(*map(math.log, point)), tried))
    least = min((row[0] for row in rows), default=math.nan)
    alike = [row for row in rows if row[0] <= (1 + ALIKE) * least]
    return min(alike, key=lambda row: row[1])[2] if alike else term
