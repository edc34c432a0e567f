"""What a simple search for formulas finds, for `bench_discover --rival`: products of two simple factors, greedily.

A fixed library of factors of one axis each, all products of two of them at once, the best one's numbers polished by
Nelder and Mead, the next beside it while half of the recording that was not fitted gains by it. It knows nothing of the
model, of noise, of reversals, or of what machines do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from edge_daemon.discover.leftover import MOTION_AXES
from edge_daemon.effects.model import Model
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.records import Array, Recorded

ROWS, SUMMANDS, WORTH = 3000, 3, 0.9
ORDERS = {"theta_in_rad": np.arange(0.1, 6.0, 0.02), "theta_out_rad": np.arange(1.0, 30.0, 0.5)}


@dataclass(frozen=True)
class Simple:
    """One factor."""

    axis: str
    text: str
    """with {x} for the axis and {p} for its number"""
    value: Callable[[Array, float], Array]
    number: float = 0.0

    def at(self, axes: dict[str, Array]) -> Array:
        """(n,) its course."""
        return self.value(axes[self.axis], self.number)

    def __str__(self) -> str:
        return self.text.format(x=self.axis, p=f"({self.number:.6g})")


def _library(axes: dict[str, Array]) -> Iterator[Simple]:
    yield Simple("time_s", "1", lambda x, p: np.ones_like(x))
    for axis, x in axes.items():
        if axis in ORDERS:
            for order in ORDERS[axis]:
                yield Simple(axis, "sin({p}*{x})", lambda x, p: np.sin(p * x), order)
                yield Simple(axis, "cos({p}*{x})", lambda x, p: np.cos(p * x), order)
        if axis == "theta_in_rad":
            continue
        size = float(np.sqrt(np.mean(x**2)))
        yield Simple(axis, "{x}", lambda x, p: x)
        yield Simple(axis, "{x}**2", lambda x, p: x**2)
        yield Simple(axis, "{x}**3", lambda x, p: x**3)
        for power in (0.5, 1.0, 1.5):
            yield Simple(axis, "abs({x})**{p}", lambda x, p: np.abs(x) ** p, power)
        for share in (0.02, 0.1, 0.5):
            yield Simple(axis, "tanh({x}/{p})", lambda x, p: np.tanh(x / p), share * size)
            yield Simple(axis, "exp(-abs({x}/{p}))", lambda x, p: np.exp(-np.abs(x / p)), 4 * share * size)
        for rate in (-2.0, -0.5, 0.5, 2.0):
            yield Simple(axis, "exp({p}*{x})", lambda x, p: np.exp(np.clip(p * x, -50, 50)), rate / np.ptp(x))
        for end in np.quantile(x, np.arange(1, 10) / 10):
            yield Simple(axis, "maximum({x} - {p}, 0)", lambda x, p: np.maximum(x - p, 0), end)
            yield Simple(axis, "minimum({x} - {p}, 0)", lambda x, p: np.minimum(x - p, 0), end)
            yield Simple(axis, "(1 + tanh(200*({x} - {p})))", lambda x, p: 1 + np.tanh(200 * (x - p)), end)


Pair = tuple[Simple, Simple]


def greedy(recordings: Sequence[Recorded], model: Model) -> str:
    """The expression that is found; empty where none helps."""
    problem = problem_of(recordings, model)
    base = fit_terms(problem, terms_of(model, problem))
    left, motion = problem.target - base.modelled, problem.motions[0]
    step = max(1, len(left) // ROWS)
    rows = problem.trials[0].rows[::step]
    columns = {name: getattr(motion, name, None) for name in MOTION_AXES[model.balance]}
    axes = {name: np.asarray(x)[rows] for name, x in columns.items() if x is not None and np.ptp(x) > 1e-9}
    known, y, chosen = base.columns[::step], left[::step], []
    library = list(_library(axes))
    table = np.stack([row.at(axes) for row in library], axis=1)
    table /= np.sqrt(np.mean(table**2, axis=0)) + 1e-300
    error = _held_out(known, [], axes, y)
    while len(chosen) < SUMMANDS:
        design = np.hstack([known, *(_column(pair, axes) for pair in chosen)])
        rest = y - design @ np.linalg.lstsq(design, y, rcond=1e-9)[0]
        gain = (table.T @ (table * rest[:, None])) ** 2 / ((table**2).T @ table**2 + 1e-300)
        i, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
        longer = _polished(known, [*chosen, (library[i], library[j])], axes, y)
        less = _held_out(known, longer, axes, y)
        if less > WORTH * error:
            break
        chosen, error = longer, less
    return " + ".join(f"{name}*{a}*{b}" for name, (a, b) in zip("abc", chosen, strict=False))


def _column(pair: Pair, axes: dict[str, Array]) -> Array:
    return (pair[0].at(axes) * pair[1].at(axes))[:, None]


def _held_out(known: Array, pairs: Sequence[Pair], axes: dict[str, Array], y: Array) -> float:
    """Rms of every other fifth of the time, fitted to the rest."""
    design = np.hstack([known, *(_column(pair, axes) for pair in pairs)])
    fitted = np.arange(len(y)) * 10 // len(y) % 2 == 0
    amplitudes = np.linalg.lstsq(design[fitted], y[fitted], rcond=1e-9)[0]
    return float(np.sqrt(np.mean((y[~fitted] - design[~fitted] @ amplitudes) ** 2)))


def _polished(known: Array, pairs: Sequence[Pair], axes: dict[str, Array], y: Array) -> list[Pair]:
    """All summands, the numbers of the last one where they leave least."""

    def at(change: Array) -> list[Pair]:
        one, other = (
            Simple(f.axis, f.text, f.value, f.number * (1 + d)) for f, d in zip(pairs[-1], change, strict=True)
        )
        return [*pairs[:-1], (one, other)]

    def left(change: Array) -> float:
        design = np.hstack([known, *(_column(pair, axes) for pair in at(change))])
        if not np.isfinite(design).all():
            return float("inf")
        return float(np.sum((y - design @ np.linalg.lstsq(design, y, rcond=1e-9)[0]) ** 2))

    start = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01]])
    return at(minimize(left, start[0], method="Nelder-Mead", options={"maxfev": 150, "initial_simplex": start}).x)
