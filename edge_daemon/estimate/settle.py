"""Friction simulated in the loop, and the solution that is consistent with it.

The loop needs the solution's amplitudes and the amplitudes need the loop's motion: both are repeated until the error
falls no more. Shapes are searched on a few seconds, since each trial is a simulation.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_daemon.estimate import inloop
from edge_daemon.estimate.workbench import (
    DAMPING,
    STIFFNESS,
    Shapes,
    Solution,
    Term,
    Workbench,
    from_search,
    inertia_of,
    to_search,
)
from edge_daemon.records import Array, Motion

LAWS = ("coulomb_friction", "stribeck_friction", "load_dependent_friction")
"""effects that the loop can simulate"""
SETTLE_STRETCH_S = 5.0
"""on which shapes are tried: some hundred reversals"""
SETTLE_LEAD_S = 0.3
"""left out at either end of it: the loop's transient and the filter's reach"""
SETTLE_SMOOTHING = (3e-5, 2e-4, 1e-3, 3e-3)
"""from dry to well lubricated [rad/s]"""
SETTLE_EVALUATIONS = 6
"""loop simulations of a stretch that each shape may cost beyond the grid"""
SETTLE_ROUNDS = 5
SETTLE_GAIN = 0.06
"""relative fall of the squared error below which the loop counts as settled"""


def settle(bench: Workbench, solution: Solution, rounds: int = SETTLE_ROUNDS) -> Solution:
    """The solution with its friction simulated in the loop; as given where no friction law is in it.

    The shapes are searched on a few seconds, the amplitudes fitted on all, until that gains no more.
    """
    term = _law_term(solution)
    if term is None or solution.amplitudes[term.effect.name].sum() <= 0:
        return solution
    term = settled_shapes(bench, solution, term)
    best, before = solution, math.inf
    for _ in range(rounds):
        following = with_columns(bench, solution, term, settled_columns(bench, solution, term, None))
        solution = replace(following, drift=np.abs(following.vector - solution.vector))
        bench.learn(solution)
        error = float(solution.fitted.sum())
        if error < best.fitted.sum():
            best = solution
        if error > (1 - SETTLE_GAIN) * before:
            break
        before = error
    return best


def with_columns(bench: Workbench, solution: Solution, term: Term, columns: Array) -> Solution:
    """The solution with other columns for one of its terms; tied terms follow what the bench knows now."""
    parts, i = [], 0
    for old in solution.terms:
        width = len(old.effect.amplitudes)
        own = old.effect.name == term.effect.name
        tied = bool(old.effect.tied)
        parts.append(
            columns if own else bench.columns(old.effect, old.shapes) if tied else solution.columns[:, i : i + width]
        )
        i += width
    terms = tuple(term if old.effect.name == term.effect.name else old for old in solution.terms)
    return bench.solution(terms, np.hstack(parts))


def settled_shapes(bench: Workbench, solution: Solution, term: Term) -> Term:
    """The friction term at the shapes that fit a stretch best: its grid of smoothings, then Nelder-Mead."""
    from scipy.optimize import minimize

    rows = term.effect.free_shapes
    tried = Stretch(bench, solution, term)
    for value in SETTLE_SMOOTHING:
        tried.loss({**term.shapes, "smoothing": value})
    start = np.array([to_search(row, tried.shapes[row.name]) for row in rows])
    simplex = np.vstack((start, start + 0.5 * np.eye(len(start))))
    options: Any = {"maxfev": SETTLE_EVALUATIONS * len(rows), "initial_simplex": simplex}

    def loss(point: Array) -> float:
        return tried.loss({row.name: from_search(row, float(v)) for row, v in zip(rows, point, strict=True)})

    minimize(loss, start, method="Nelder-Mead", options=options)
    return Term(term.effect, tried.shapes)


def middle_of(bench: Workbench) -> tuple[float, float]:
    """Seconds from the start of the first trial: the middle of it."""
    motion = bench.trials[0].motion
    length = len(motion) / motion.rate_hz
    middle = length / 2
    return max(0.0, middle - SETTLE_STRETCH_S / 2), min(length, middle + SETTLE_STRETCH_S / 2)


def rows_in(bench: Workbench, stretch: tuple[float, float]) -> NDArray[np.bool_]:
    """(m,) which rows lie in a stretch of the first trial."""
    trial = bench.trials[0]
    seconds = trial.rows / trial.motion.rate_hz
    inside = (seconds > stretch[0] + SETTLE_LEAD_S) & (seconds < stretch[1] - SETTLE_LEAD_S)
    return np.concatenate((inside, np.zeros(len(bench.target) - len(inside), dtype=bool)))


def settled_columns(bench: Workbench, solution: Solution, term: Term, stretch: tuple[float, float] | None) -> Array:
    """(m, k) columns of the friction term on the motion in the loop; only the first trial's stretch if given."""
    parts = []
    for trial, motion in zip(bench.trials, bench.motions, strict=True):
        extra = np.zeros(len(motion))
        for other in solution.terms:
            name = other.effect.name
            if other.effect.kind == "torque" and name not in (STIFFNESS[0], DAMPING[0], term.effect.name):
                columns, _ = other.effect.columns(motion, bench.shapes(other.effect, other.shapes), None)
                extra += columns @ solution.amplitudes[name]
        rows = trial.rows
        if stretch is not None:
            a, b = (round(edge * motion.rate_hz) for edge in stretch)
            motion, extra = sliced(motion, a, b), extra[a:b]
            rows = rows[rows_in(bench, stretch)[: len(rows)]] - a
        spring = inloop.Spring(
            inertia_of(trial), solution.amplitude(*STIFFNESS), max(solution.amplitude(*DAMPING, 0.0), 0.0)
        )
        law = _law(term, solution)
        fine = inloop.settled(motion, spring, law, extra)
        kernel = inloop.fine_filter(motion, trial.fir)
        columns, _ = term.effect.columns(fine, bench.shapes(term.effect, term.shapes), None)
        parts.append(kernel.apply(kernel.value, columns)[rows * inloop.refine(motion)])
        if stretch is not None:
            break
    return np.vstack(parts)


class Stretch:
    """A few seconds on which friction shapes are tried; the best so far also lends its amplitudes to the loop."""

    def __init__(self, bench: Workbench, solution: Solution, term: Term) -> None:
        self.bench, self.solution, self.term = bench, solution, term
        self.seconds = middle_of(bench)
        keep = rows_in(bench, self.seconds)
        self.place = _place(solution, term)
        self.columns = solution.columns[keep].copy()
        self.target = bench.target[keep]
        self.shapes, self.error = dict(term.shapes), math.inf

    def loss(self, shapes: Shapes) -> float:
        """Mean square error on the stretch."""
        own = settled_columns(self.bench, self.solution, Term(self.term.effect, shapes), self.seconds)
        self.columns[:, self.place] = own
        scale = np.sqrt(np.mean(self.columns**2, axis=0)) + 1e-300
        a = np.linalg.lstsq(self.columns / scale, self.target, rcond=1e-10)[0] / scale
        error = float(np.mean((self.target - self.columns @ a) ** 2))
        if error < self.error and a[self.place].sum() > 0:
            self.error, self.shapes = error, dict(shapes)
            cut = np.cumsum([len(term.effect.amplitudes) for term in self.solution.terms])[:-1]
            self.solution = replace(
                self.solution, amplitudes=dict(zip(self.solution.names, np.split(a, cut), strict=True))
            )
        return error


def sliced(motion: Motion, a: int, b: int) -> Motion:
    """Samples a to b of a motion."""
    arrays: dict[str, Any] = {
        name: getattr(motion, name)[a:b]
        for name in Motion.__dataclass_fields__
        if isinstance(getattr(motion, name), np.ndarray)
    }
    return replace(motion, extra={name: column[a:b] for name, column in motion.extra.items()}, **arrays)


def _law_term(solution: Solution) -> Term | None:
    """The one friction law of a solution; None if there is none or several."""
    found = [term for term in solution.terms if term.effect.name in LAWS and term.effect.balance == "torsion"]
    return found[0] if len(found) == 1 else None


def _law(term: Term, solution: Solution) -> inloop.Law:
    a = solution.amplitudes[term.effect.name]
    smoothing = term.shapes.get("smoothing", 1e-3)
    match term.effect.name:
        case "stribeck_friction":
            return inloop.Law(a[0], a[1], 0.0, smoothing, term.shapes["stribeck_speed"])
        case "load_dependent_friction":
            return inloop.Law(0.0, 0.0, a[0], smoothing)
    return inloop.Law(a[0], 0.0, 0.0, smoothing)


def _place(solution: Solution, term: Term) -> NDArray[np.intp]:
    i = 0
    for old in solution.terms:
        width = len(old.effect.amplitudes)
        if old.effect.name == term.effect.name:
            return np.arange(i, i + width)
        i += width
    return np.empty(0, dtype=np.intp)
