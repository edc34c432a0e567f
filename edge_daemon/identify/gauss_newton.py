"""A structure fitted with its nonlinear effects in the loop: Gauss-Newton on the output error.

Measured minus modelled torque is the error of the simulated output angle seen through J s^2 + B s + K (prediction error
method; Ljung 1999, System Identification, ch. 7 and 10.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edge_daemon.identify.block_least_squares import BlockSums, block_sums, held_out, square_error, taken_out
from edge_daemon.identify.bounded_least_squares import solve
from edge_daemon.identify.pilot_stretch import stretch_of
from edge_daemon.identify.regression import RegressionProblem, to_search
from edge_daemon.identify.solution import STIFFNESS, Solution
from edge_daemon.identify.structure import Place, Structure, lawful
from edge_daemon.records import Array

LOOP_ROUNDS = 30
"""Five steps are usual; a curved valley of shapes takes twenty."""
SETTLED = 2e-3
"""The loop counts as settled below this relative fall of the squared error."""
LONGEST_STEP = 1.2
"""A shape changes at most by this factor's exponential in one step."""
FIRST_DAMPING = 1e-2
LEAST_DAMPING = 1e-4
"""Damping of Levenberg and Marquardt over the diagonal: at the start, and where it starts to grow again."""
TRIES = 5
"""So many steps of growing damping are tried before the search counts as settled. What one needed the next begins with:
in a curved valley a step of less damping would fail again."""
PATIENCE = 3
"""A search may be given up as hopeless after so many rounds: the first steps say little of the next."""
STRETCH_ROUNDS = 15
LEAST_SHOWN = 0.02
"""Of what a number's column shows of all of a recording a stretch must show this share to tell it (guess)."""
ROUGHLY = 0.01
"""While searching the loop counts as settled below this relative fall of the squared error."""


class TrialStep(NamedTuple):
    """One step of the search that was taken."""

    point: Array
    base: Array
    """(m,) modelled there"""
    design: Array
    """(m, q) its derivative"""
    error: float
    """squared"""
    damping: float


class LoopProblem(Structure):
    """A structure whose numbers are searched for."""

    rms = math.inf
    """of measured minus modelled at `point`, once descended"""
    shown: Array = np.empty(0)
    """(q,) rms of what each number changes, once descended"""

    def normal(self, design: Array, residual: Array) -> BlockSums:
        """Normal equations about the present point, within bounds and the longest step of a shape."""
        lower = np.array([self._bound(place, j, -1) for j, place in enumerate(self.places)])
        upper = np.array([self._bound(place, j, +1) for j, place in enumerate(self.places)])
        noise = np.zeros((design.shape[1] + 1, design.shape[1]))
        for j, place in enumerate(self.places):
            own, cross = self.problem.noise.products.get(self.terms[place.term].effect.name, (0.0, 0.0))
            noise[j, j] = taken_out(own, float(np.mean(design[:, j] ** 2)))
            noise[-1, j] = cross * noise[j, j] / own if own else 0.0
        target = residual + design @ self.point
        return block_sums(design, target, self.problem.block, np.array([lower, upper]), noise)

    def _bound(self, place: Place, j: int, side: int) -> float:
        limit = place.row.lower if side < 0 else place.row.upper
        if place.index >= 0:
            return limit
        reach = self.point[j] + side * LONGEST_STEP
        limit = to_search(place.row, limit)
        return float(max(reach, limit) if side < 0 else min(reach, limit))

    @np.errstate(over="ignore", invalid="ignore")  # a start or a step too far is seen by its error
    def descend(
        self, rounds: int, settled: float = SETTLED, hopeless: float = math.inf, sparing: bool = False
    ) -> tuple[Array, Array]:
        """Levenberg-Marquardt until it settles, or until an rms of `hopeless` is out of reach: modelled torque (m,) and
        its derivative (m, q) at the last point. `sparing`: a step that promises less than settles it is not taken."""
        target = self.problem.target
        base, design = self.modelled(self.point)
        errors, damping, quiet = [float(np.sum((target - base) ** 2))], FIRST_DAMPING, False
        for i in range(rounds):
            normal = self.normal(design, target - base)
            if sparing and i and still(errors[-1], self._promised(normal, damping), settled):
                break
            step = self._step(normal, damping, errors[-1])
            if step is None:
                break
            self.point, base, design = step.point, step.base, step.design
            errors.append(step.error)
            before, quiet = quiet, still(errors[-2], errors[-1], settled)
            if quiet and (before or step.damping < FIRST_DAMPING):
                break
            if out_of_reach(errors, rounds - i - 1, hopeless**2 * len(target)):
                break
            damping = 0.1 * damping if step.damping == damping else step.damping
        self.rms, self.shown = math.sqrt(errors[-1] / len(target)), np.sqrt(np.mean(design**2, axis=0))
        return base, design

    def begin_where(self, stretch: LoopProblem, solution: Solution) -> None:
        """Take over where a stretch came to rest, but for amplitudes of which it shows next to nothing beside what the
        columns of a solution do: a corner of a spring that it never reaches can be anything there."""
        first = np.cumsum([0, *(len(term.effect.amplitudes) for term in self.terms)])
        size = np.sqrt(np.mean(solution.columns**2, axis=0))
        there = stretch.point.copy()
        for j, place in enumerate(self.places):
            if place.index >= 0 and stretch.shown[j] < LEAST_SHOWN * size[first[place.term] + place.index]:
                there[j] = self.point[j]
        self.point = there

    def _step(self, normal: BlockSums, damping: float, error: float) -> TrialStep | None:
        """The first of some steps of growing damping that is no worse; None where all are."""
        for _ in range(TRIES):
            point = self._stepped(normal, damping)
            left = float(np.sum((self.problem.target - self.modelled(point, derive=False)[0]) ** 2))
            if left < (1 + SETTLED) * error:  # half of all are refused, and derivatives take up to eight times as long
                return TrialStep(point, *self.modelled(point), left, damping)
            damping = max(damping, LEAST_DAMPING) * 10
        return None

    def _promised(self, normal: BlockSums, damping: float) -> float:
        """Squared error after a step, were the model linear."""
        return float(square_error(normal, self._stepped(normal, damping)).sum())

    def _stepped(self, normal: BlockSums, damping: float) -> Array:
        """(q,) the next point under some damping."""
        rows = normal.count.sum()
        matrix = normal.matrix.sum(0) - rows * normal.noise_matrix
        vector = normal.vector.sum(0) - rows * normal.noise_vector - matrix @ self.point
        matrix = matrix + damping * np.diag(np.diagonal(matrix))
        step = solve(matrix, vector, normal.lower - self.point, normal.upper - self.point)
        point: Array = self.point + step
        return point

    def solution(self, base: Array, design: Array) -> Solution:
        """The solution at the present point."""
        terms, amplitudes = self.split(self.point)
        g = self.normal(design, self.problem.target - base)
        columns = self.columns(terms, amplitudes)
        return Solution(
            tuple(terms), amplitudes, held_out(g, self.problem.fold), square_error(g, self.point), g.count, columns, g,
            design, self.point, base,
        )  # fmt: skip


def still(before: float, after: float, settled: float) -> bool:
    """Whether an error fell by less than a share of itself."""
    return after > (1 - settled) * before


def out_of_reach(errors: Sequence[float], rounds: int, wanted: float) -> bool:
    """Whether further rounds would not bring an error to what is wanted, were each to take as large a share of it as
    the better of the last two did; as long as the falls still grow, that is not known."""
    if len(errors) <= PATIENCE:
        return False
    before, last = errors[-2] / errors[-3], errors[-1] / errors[-2]
    return last > before and errors[-1] * before**rounds > wanted


def nan_last(error: float) -> float:
    """An error, infinite where there is none."""
    return math.inf if math.isnan(error) else error


def on_stretch(stretch: RegressionProblem, solution: Solution, hopeless: float = math.inf) -> LoopProblem:
    """The loop brought to rest on a stretch; given up where an rms of `hopeless` is out of reach."""
    loop = LoopProblem(stretch, solution, held=True)
    loop.descend(STRETCH_ROUNDS, ROUGHLY, hopeless, sparing=True)
    return loop


def gauss_newton(problem: RegressionProblem, solution: Solution, hopeless: float = math.inf) -> Solution:
    """The solution with its lawful effects in the loop; as given where it has none, or no spring to simulate. What has
    been in the loop before goes on from there, all else begins on a stretch: or where it was, if that leads nowhere,
    since a stretch need not show all numbers. Given up where an rms of `hopeless` is out of reach."""
    if not lawful(solution.terms) or STIFFNESS[0] not in solution.names or not solution.amplitude(*STIFFNESS) > 0:
        return solution
    loop = LoopProblem(problem, solution)
    start = loop.point
    if solution.design is None:
        loop.begin_where(on_stretch(stretch_of(problem), solution), solution)
    found = loop.solution(*loop.descend(LOOP_ROUNDS, hopeless=hopeless))
    if solution.design is None and not loop.rms <= solution.rmse:
        loop.point = start
        again = loop.solution(*loop.descend(LOOP_ROUNDS, hopeless=hopeless))
        found = min(found, again, key=lambda row: nan_last(row.rmse))
    problem.learn(found)
    return found
