"""Friction of the load and the load itself, fitted together: the numbers that tell the one are those of the other.

To repeat a fit with the load that the last one told comes to rest where the load is well known. Where it is not, as of
a weight beside a constant on a short way, it goes round for ever, or rests at a load that is not the gear's own. Here
the derivative by the load's numbers holds what friction changes with them (Gauss-Newton; each step within bounds), and
so does that by the motor's share of the inertia.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import Solution, Term
from edge_daemon.records import Array

STEPS, HALVINGS = 6, 3
"""Gauss-Newton steps at the most, and how often one that leads uphill is halved."""
SETTLED = 1e-3
"""A step that lowers the squared error by less than this share is the last."""
STEP_SHARE = 1e-3
"""A derivative is taken over this share of a number's own size, or of what makes the load as large."""


@dataclass(frozen=True, slots=True)
class LoadPoint:
    """Amplitudes and then shares, and what they make of the torque with the load that they tell."""

    a: Array
    columns: Array
    error: float
    """summed squared residual"""


class LoadFit:
    """A structure whose friction grows with a load that its other terms tell."""

    def __init__(self, problem: RegressionProblem, solution: Solution) -> None:
        self.problem, self.start = problem, solution
        self.names = [(term, i) for term in solution.terms for i in range(len(term.effect.amplitudes))]
        motors = any(term.effect.of_motor for term in solution.terms)
        self.telling = [j for j, (term, _) in enumerate(self.names)
                        if term.effect.carried or (motors and not term.effect.of_motor)]  # fmt: skip
        self.loaded = np.array([term.effect.loaded for term, _ in self.names])
        rows = [(i, row) for i, term in enumerate(solution.terms) for row in term.effect.free_shapes if row.asks]
        self.shares = [(i, row) for i, row in rows if solution.terms[i].effect.loaded]
        """shapes by the place of their term, which only the load tells"""

    @property
    def begin(self) -> LoadPoint:
        """Where the structure is."""
        terms = self.start.terms
        shares = [terms[i].shapes.get(row.name, row.start) for i, row in self.shares]
        return self._at(np.append(self.start.vector, shares))

    def run(self) -> Solution:
        """The structure fitted on from where it is; what it was where no step leads downhill."""
        point = self.begin
        for _ in range(STEPS):
            step = self._step(point)
            better = next((at for at in self._tries(point, step) if at.error < point.error), None)
            if better is None:
                break
            gained, point = 1.0 - better.error / point.error, better
            if gained < SETTLED:
                break
        return self._solution(point)

    def _tries(self, point: LoadPoint, step: Array) -> Iterator[LoadPoint]:
        return (self._at(point.a + step / 2**i) for i in range(HALVINGS + 1))

    def _with(self, a: Array) -> Solution:
        width, terms = len(self.names), list(self.start.terms)
        for (i, row), value in zip(self.shares, a[width:].tolist(), strict=True):
            terms[i] = replace(terms[i], shapes={**terms[i].shapes, row.name: value})
        cut = np.cumsum([len(term.effect.amplitudes) for term in terms])
        amplitudes = dict(zip(self.start.names, np.split(a, cut), strict=False))
        return replace(self.start, terms=tuple(terms), amplitudes=amplitudes)

    def _columns(self, a: Array) -> Array:
        """(m, p) with the load of amplitudes and shares (p + s,)."""
        columns = self.start.columns.copy()
        columns[:, self.loaded] = np.hstack([self.problem.columns(t.effect, t.shapes) for t in self._of_load(a)])
        return columns

    def _of_load(self, a: Array) -> list[Term]:
        """What the load of amplitudes and shares (p + s,) moves, the problem's motion having that."""
        there = self._with(a)
        self.problem.learn(there)
        return [term for term in there.terms if term.effect.loaded]

    def _at(self, a: Array) -> LoadPoint:
        columns = self._columns(a)
        left = self.problem.target - columns @ a[: len(self.names)]
        return LoadPoint(a, columns, float(left @ left))

    def design(self, point: LoadPoint) -> Array:
        """(m, p + s) derivative of the modelled torque by every amplitude and share."""
        width = len(self.names)
        made = point.a[:width][self.loaded]
        torque = point.columns[:, self.loaded] @ made
        design = np.hstack((point.columns, np.zeros((len(torque), len(self.shares)))))
        load = max(float(np.max(np.abs(point.columns[:, self.telling] @ point.a[self.telling]))), 1e-300)
        sizes = {j: load / max(float(np.max(np.abs(point.columns[:, j]))), 1e-300) for j in self.telling}
        sizes |= {width + j: 1.0 for j in range(len(self.shares))}
        for j, size in sizes.items():
            moved = point.a.copy()
            moved[j] += STEP_SHARE * size
            terms = self._of_load(moved)
            cut = np.cumsum([len(term.effect.amplitudes) for term in terms])[:-1]
            changed = self.problem.torque(terms, np.split(made, cut))
            design[:, j] += (changed - torque) / (STEP_SHARE * size)
        return design

    def _step(self, point: LoadPoint) -> Array:
        """(p + s,) to the least squares of the torque as it is near a point."""
        design, width = self.design(point), len(self.names)
        wanted = self.problem.target + design @ point.a - point.columns @ point.a[:width]
        effects = [term.effect for term in self.start.terms]
        effects += [replace(effects[i], amplitudes=(row,)) for i, row in self.shares]
        sums = self.problem.block_sums(effects, design, True, wanted)
        return np.asarray(sums.fit() - point.a)

    def _solution(self, point: LoadPoint) -> Solution:
        made = self._with(point.a)
        self.problem.learn(made)
        return replace(self.problem.solution(made.terms, point.columns), amplitudes=made.amplitudes)


def with_its_load(problem: RegressionProblem, solution: Solution) -> Solution:
    """A solution whose load is its own, where friction grows with one that more than the inertia tells, or a law of the
    motor with its torque."""
    return LoadFit(problem, solution).run() if _tells_its_load(solution) else solution


def with_friction_of_load(problem: RegressionProblem, solution: Solution) -> Array:
    """(m, p) derivative of the modelled torque by every amplitude, what friction changes with the load among it."""
    if not _tells_its_load(solution):
        return solution.columns
    state, load = problem.state, LoadFit(problem, solution)
    design = load.design(load.begin)
    problem.restore(state)
    return design[:, : solution.columns.shape[1]]


def _tells_its_load(solution: Solution) -> bool:
    """Whether friction grows with a load of which more than the inertia tells, or a law of the motor does."""
    effects = [term.effect for term in solution.terms]
    return any(effect.is_outside or effect.of_motor for effect in effects) and any(effect.loaded for effect in effects)
