"""A smooth function of one axis as an effect of its own: a table of amplitudes, straight lines between them.

It is an expression like any other, so that a model file holds it and every part of the product can use it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from edge_daemon.discover.extremes import helps
from edge_daemon.discover.leftover import TURNING, Leftover
from edge_daemon.discover.writing import axis_words
from edge_daemon.effects.expression import LETTERS, LOAD, evaluate, parse
from edge_daemon.effects.model import Model, ModelError
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.records import Array, Recorded

KNOTS = 9
"""Places of a table: as many as an expression may hold."""
ORDERS = (1, 2, 3, 4)
"""Waves per turn of a table over an angle that turns many times."""
LEAST_SHARE = 0.2
"""Share of the leftover's square that a table must take to be worth offering."""


def table_expression(leftover: Leftover, axis: str) -> str:
    """The table over an axis, its places where the recording has samples. Raises `ModelError`."""
    if axis not in leftover.names:
        raise ModelError(f"{axis}: no axis of these recordings: expected one of {', '.join(leftover.names)}")
    text = leftover.text(axis)
    if axis in TURNING:
        waves = [f"{wave}({order}*{text})" for order in ORDERS for wave in ("sin", "cos")]
        return " + ".join(f"{name}*{wave}" for name, wave in zip(LETTERS, waves, strict=False))
    at = np.unique([float(f"{q:.4g}") for q in np.quantile(leftover.rows[axis], np.linspace(0, 1, KNOTS))])
    ends = [at[0], *at, at[-1]]
    places = zip(LETTERS, ends, at, ends[2:], strict=False)
    return " + ".join(f"{name}*tent({text}, {low:.4g}, {peak:.4g}, {high:.4g})" for name, low, peak, high in places)


def table_over(recordings: Sequence[Recorded], model: Model, axis: str) -> str:
    """As `table_expression`, from recordings. Raises `BadInput`."""
    problem = problem_of(recordings, model)
    return table_expression(Leftover(problem, fit_terms(problem, terms_of(model, problem)), model), axis)


def best_table(leftover: Leftover) -> tuple[str, str, float] | None:
    """The axis whose table takes most of the leftover, its expression and the share; None where none takes much, or it
    leaves more on the extremes of a motion than nothing does."""
    thin = leftover.thin
    shares = {}
    for axis in (name for name in leftover.names if LOAD not in name):  # a load's share is no part of a curve
        with suppress(ModelError):  # the name of a file's own column may be longer than an expression holds nine times
            shares[axis] = _share(thin, table_expression(leftover, axis))
    axis = max(shares, key=lambda name: shares[name], default="")
    if shares.get(axis, 0.0) < LEAST_SHARE or not helps(leftover, _columns(thin, table_expression(leftover, axis))):
        return None
    return axis, table_expression(leftover, axis), shares[axis]


def in_words(axis: str) -> str:
    """What a table is called in a sentence."""
    said = f"a table over {axis_words(axis)[0]}: no short formula fits, the curve itself does"
    return said if axis in TURNING else f"{said}; beyond what was seen it holds its last value, which is a guess"


def _columns(thin: Leftover, expression: str) -> Array:
    """(m, k) of a table."""
    law = parse(expression, thin.names)
    courses = {name: column + thin.shift.get(name, 0.0) for name, column in thin.axes[0].items()}
    unit = [{other: float(other == name) for other in law.amplitudes} for name in law.amplitudes]
    return np.stack([evaluate(law.tree, {**courses, **one}) for one in unit], axis=1)


def _share(thin: Leftover, expression: str) -> float:
    """Of the leftover's square, what a table takes of each half of the time, fitted to the other."""
    columns = thin.without_known(_columns(thin, expression))
    first, square = np.arange(len(thin.left)) < len(thin.left) // 2, 0.0
    for fitted in (first, ~first):
        amplitudes = np.linalg.lstsq(columns[fitted], thin.left[fitted], rcond=1e-9)[0]
        square += float(np.sum((thin.left[~fitted] - columns[~fitted] @ amplitudes) ** 2))
    return 1.0 - square / max(float(thin.left @ thin.left), 1e-300)
