"""A structure fitted with its nonlinear effects in the loop: Gauss-Newton on the output error.

The torque of effects that the catalogue gives a law for is taken on a simulated twist, so that what a parameter changes
includes how it changes the twist. Measured minus modelled torque is then the error of the simulated output angle seen
through J s^2 + B s + K (prediction error method; Ljung 1999, System Identification, ch. 7 and 10.2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from edge_daemon.effects.effect import Parameter
from edge_daemon.effects.laws import Element
from edge_daemon.estimate import inloop
from edge_daemon.estimate.balance import Trial
from edge_daemon.estimate.gram import Grams, grams, held_out, solve, square_error
from edge_daemon.estimate.workbench import (
    DAMPING,
    STIFFNESS,
    Solution,
    Term,
    Workbench,
    corrected,
    corrects,
    from_search,
    inertia_of,
    sub_bench,
    to_search,
)
from edge_daemon.records import Array, Motion

LOOP_ROUNDS = 30
"""steps at most; five are usual, a curved valley of shapes takes twenty"""
SETTLED = 2e-3
"""relative fall of the squared error below which the loop counts as settled"""
SHAPE_STEP = 1e-3
"""finite difference of a shape, relative"""
AMPLITUDE_STEP = 1e-4
"""finite difference of an amplitude, over the amplitude that would carry the whole torque"""
LONGEST_STEP = 1.2
"""a shape changes at most by this factor's exponential in one step"""
FIRST_DAMPING = 1e-2
LEAST_DAMPING = 1e-4
"""of Levenberg and Marquardt, over the diagonal: at the start, and where it starts to grow again"""
TRIES = 5
"""steps of growing damping that are tried before the search counts as settled"""
WORKERS = 2
STRETCH_S = 6.0
"""on which the loop is first brought to rest: some hundred reversals"""
LEAD_S = 0.3
"""left out at either end of it: the loop's transient and the filter's reach"""
STRETCH_ROUNDS = 15
ROUGHLY = 0.01
"""relative fall of the squared error below which the loop counts as settled while searching"""


def lawful(terms: Sequence[Term]) -> bool:
    """Whether an effect among them is simulated in the loop."""
    return any(term.effect.in_loop is not None for term in terms)


@dataclass(frozen=True, slots=True)
class Place:
    """One coordinate of the search: an amplitude, or the logarithm of a shape."""

    term: int
    row: Parameter
    index: int
    """among the amplitudes; -1 for a shape"""


class Loop:
    """A structure on a bench as a function of all its parameters."""

    def __init__(self, bench: Workbench, solution: Solution) -> None:
        self.bench, self.terms = bench, solution.terms
        self.places = [place for i, term in enumerate(self.terms) for place in _places(i, term)]
        self.point = np.array([_value(solution, place) for place in self.places])
        self.step = self._steps(solution)
        self.rms = math.inf
        """of measured minus modelled at `point`, once descended"""
        self._courses: dict[tuple[int, bytes], tuple[Motion, inloop.Course, Array]] = {}
        self._extras: dict[tuple[int, bytes], tuple[Array | None, Array]] = {}

    def _steps(self, solution: Solution) -> Array:
        """(q,) finite differences."""
        size = np.sqrt(np.mean(solution.columns**2, axis=0)) + 1e-300
        whole = iter(AMPLITUDE_STEP * self.bench.rms / size)
        return np.array([SHAPE_STEP if place.index < 0 else next(whole) for place in self.places])

    def split(self, point: Array) -> tuple[list[Term], dict[str, Array]]:
        """Terms with shapes, and amplitudes by effect."""
        shapes = [dict(term.shapes) for term in self.terms]
        amplitudes: dict[str, list[float]] = {term.effect.name: [] for term in self.terms}
        for place, value in zip(self.places, point.tolist(), strict=True):
            if place.index < 0:
                shapes[place.term][place.row.name] = from_search(place.row, value)
            else:
                amplitudes[self.terms[place.term].effect.name].append(value)
        terms = [replace(term, shapes=own) for term, own in zip(self.terms, shapes, strict=True)]
        return terms, {name: np.array(values) for name, values in amplitudes.items()}

    def modelled(self, point: Array) -> Array:
        """(m,) torque of the whole structure, filtered."""
        terms, amplitudes = self.split(point)
        parts = [self._modelled(i, trial, terms, amplitudes) for i, trial in enumerate(self.bench.trials)]
        return np.concatenate(parts)

    def _modelled(self, i: int, trial: Trial, terms: Sequence[Term], amplitudes: Mapping[str, Array]) -> Array:
        motion, on, linear = self._course(i, trial, terms, amplitudes)
        extra, further = self._extra(i, trial, motion, on.times, terms, amplitudes)
        spring = spring_of(trial, amplitudes)
        by = inloop.ride(on, spring, self.elements(terms, amplitudes), extra)
        straight = linear @ (spring.stiffness, amplitudes.get(DAMPING[0], _NONE)[0])
        out: Array = straight + further + inloop.filtered(trial, by.torque_Nm, on.times)
        return out

    def _course(
        self, i: int, trial: Trial, terms: Sequence[Term], amplitudes: Mapping[str, Array]
    ) -> tuple[Motion, inloop.Course, Array]:
        """The corrected motion, what it drives, and its filtered twist and twist rate (m, 2)."""
        key = i, _key(amplitudes, [t for t in terms if corrects(t.effect)])
        known = self._courses.get(key)
        if known is None:
            motion = corrected(trial.motion, terms, amplitudes)
            linear = trial.project(np.stack((motion.twist_rad, motion.twist_rate_rad_s), axis=1))
            known = self._courses[key] = motion, inloop.course(motion, loop_inertia(trial)), linear
        return known

    def _extra(
        self, i: int, trial: Trial, motion: Motion, times: int, terms: Sequence[Term], amplitudes: Mapping[str, Array]
    ) -> tuple[Array | None, Array]:
        """Torque of the effects that neither correct the twist nor are simulated: at the substep rate, and (m,)."""
        further = [t for t in terms if t.effect.in_loop is None and not corrects(t.effect) and not _linear(t)]
        if not further:
            return None, np.zeros(len(trial.rows))
        key = i, _key(amplitudes, [t for t in terms if corrects(t.effect)] + further)
        known = self._extras.get(key)
        if known is None:
            parts = [t.effect.columns(motion, self.shapes(t, amplitudes), None)[0] @ amplitudes[t.effect.name]
                     for t in further]  # fmt: skip
            torque: Array = np.sum(parts, axis=0)
            known = self._extras[key] = inloop.upsampled(torque, times), trial.project(torque[:, None])[:, 0]
        return known

    def elements(self, terms: Sequence[Term], amplitudes: Mapping[str, Array]) -> list[Element]:
        """The laws of all simulated effects."""
        out: list[Element] = []
        for term in terms:
            if term.effect.in_loop is not None:
                out += term.effect.in_loop(self.shapes(term, amplitudes), amplitudes[term.effect.name].tolist())
        return out

    def shapes(self, term: Term, amplitudes: Mapping[str, Array]) -> dict[str, float]:
        """All shapes of a term, tied ones from the amplitudes at hand."""
        values = self.bench.shapes(term.effect, term.shapes)
        for name, (effect, parameter) in term.effect.tied.items():
            if effect in amplitudes and (effect, parameter) in (STIFFNESS, DAMPING):
                values[name] = float(amplitudes[effect][0])
        return values

    def jacobian(self, base: Array) -> Array:
        """(m, q) derivative of the modelled torque by each coordinate, at `point`; `base` is the torque there."""
        with ThreadPoolExecutor(WORKERS) as workers:
            columns = list(workers.map(partial(self._derivative, base), range(len(self.places))))
        trials = len(self.bench.trials)
        self._courses = dict(list(self._courses.items())[:trials])
        self._extras = dict(list(self._extras.items())[:trials])
        return np.stack(columns, axis=1)

    def _derivative(self, base: Array, j: int) -> Array:
        moved = self.point.copy()
        moved[j] += self.step[j]
        change: Array = (self.modelled(moved) - base) / self.step[j]
        return change

    def normal(self, design: Array, residual: Array) -> Grams:
        """Normal equations about the present point, within bounds and the longest step of a shape."""
        lower = np.array([self._bound(place, j, -1) for j, place in enumerate(self.places)])
        upper = np.array([self._bound(place, j, +1) for j, place in enumerate(self.places)])
        noise = np.zeros((design.shape[1] + 1, design.shape[1]))
        for j, place in enumerate(self.places):
            own, cross = self.bench.noise.get(self.terms[place.term].effect.name, (0.0, 0.0))
            if own < 0.5 * float(np.mean(design[:, j] ** 2)):
                noise[j, j], noise[-1, j] = own, cross
        target = residual + design @ self.point
        return grams(design, target, self.bench.block, np.array([lower, upper]), noise)

    def _bound(self, place: Place, j: int, side: int) -> float:
        limit = place.row.lower if side < 0 else place.row.upper
        if place.index >= 0:
            return limit
        reach = self.point[j] + side * LONGEST_STEP
        limit = to_search(place.row, limit)
        return float(max(reach, limit) if side < 0 else min(reach, limit))

    def descend(self, rounds: int, settled: float = SETTLED) -> tuple[Array, Array]:
        """Levenberg-Marquardt until it settles: modelled torque (m,) and its derivative (m, q) at the last point."""
        target = self.bench.target
        base = self.modelled(self.point)
        design = self.jacobian(base)
        damping = FIRST_DAMPING
        for _ in range(rounds):
            error = float(np.sum((target - base) ** 2))
            normal = self.normal(design, target - base)
            for _ in range(TRIES):
                point = self._stepped(normal, damping)
                modelled = self.modelled(point)
                left = float(np.sum((target - modelled) ** 2))
                if left < (1 + SETTLED) * error:
                    break
                damping = max(damping, LEAST_DAMPING) * 10
            else:
                break
            self.point, base = point, modelled
            self._courses, self._extras = {}, {}
            design = self.jacobian(self.modelled(point))
            if left > (1 - settled) * error and damping < FIRST_DAMPING:
                break
            damping *= 0.1
        self.rms = math.sqrt(float(np.mean((target - base) ** 2)))
        return base, design

    def _stepped(self, normal: Grams, damping: float) -> Array:
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
        g = self.normal(design, self.bench.target - base)
        raw = np.array([1.0 if p.index >= 0 or p.row.lower <= 0 else math.exp(-v) for p, v in self._named()])
        columns = self._columns(terms, amplitudes)
        return Solution(
            tuple(terms), amplitudes, held_out(g, self.bench.fold), square_error(g, self.point), g.count, columns, g,
            design * raw, self.point,
        )  # fmt: skip

    def _named(self) -> list[tuple[Place, float]]:
        return list(zip(self.places, self.point.tolist(), strict=True))

    def _columns(self, terms: Sequence[Term], amplitudes: Mapping[str, Array]) -> Array:
        """(m, p) of all amplitudes: laws on the simulated twist, all else as measured."""
        return np.vstack([self._columns_of(i, trial, terms, amplitudes) for i, trial in enumerate(self.bench.trials)])

    def _columns_of(self, i: int, trial: Trial, terms: Sequence[Term], amplitudes: Mapping[str, Array]) -> Array:
        motion, on, _ = self._course(i, trial, terms, amplitudes)
        extra, _ = self._extra(i, trial, motion, on.times, terms, amplitudes)
        by = inloop.ride(on, spring_of(trial, amplitudes), self.elements(terms, amplitudes), extra)
        parts = []
        for term in terms:
            shapes = self.shapes(term, amplitudes)
            if term.effect.in_loop is None:
                raw = term.effect.kind == "measurement" or _linear(term)
                seen = replace(trial.motion, theta_in_rad=motion.theta_in_rad) if raw else motion
                parts.append(trial.project(term.effect.columns(seen, shapes, None)[0]))
                continue
            for unit in np.eye(len(term.effect.amplitudes)):
                torque = inloop.along(on, by, term.effect.in_loop(shapes, unit.tolist()))
                parts.append(inloop.filtered(trial, torque, on.times)[:, None])
        return np.hstack(parts)


_NONE = np.zeros(1)


def _places(i: int, term: Term) -> list[Place]:
    amplitudes = [Place(i, row, k) for k, row in enumerate(term.effect.amplitudes)]
    return amplitudes + [Place(i, row, -1) for row in term.effect.free_shapes]


def _value(solution: Solution, place: Place) -> float:
    term = solution.terms[place.term]
    if place.index >= 0:
        return float(solution.amplitudes[term.effect.name][place.index])
    return to_search(place.row, term.shapes.get(place.row.name, place.row.start))


def _linear(term: Term) -> bool:
    return term.effect.name in (STIFFNESS[0], DAMPING[0])


def _key(amplitudes: Mapping[str, Array], terms: Sequence[Term]) -> bytes:
    """What a cached part of the model depends on."""
    parts = [part for t in terms for part in (amplitudes[t.effect.name], list(t.shapes.values()))]
    return np.concatenate([[0.0], *parts]).tobytes()


def loop_inertia(trial: Trial) -> float:
    """Inertia that the twist is simulated with; 0 where the torque is measured."""
    return 0.0 if "torque_out_Nm" in trial.motion.extra else inertia_of(trial)


def spring_of(trial: Trial, amplitudes: Mapping[str, Array]) -> inloop.Spring:
    """The linear part of a structure."""
    damping = float(amplitudes.get(DAMPING[0], _NONE)[0])
    return inloop.Spring(loop_inertia(trial), float(amplitudes[STIFFNESS[0]][0]), max(damping, 0.0))


def on_stretch(bench: Workbench, solution: Solution) -> Loop:
    """The loop brought to rest on a few seconds in the middle of the first trial."""
    loop = Loop(sub_bench(bench, STRETCH_S, LEAD_S), solution)
    loop.descend(STRETCH_ROUNDS, ROUGHLY)
    return loop


def settle(bench: Workbench, solution: Solution, rounds: int = LOOP_ROUNDS) -> Solution:
    """The solution with its lawful effects in the loop; as given where it has none, or no spring to simulate."""
    if not lawful(solution.terms) or STIFFNESS[0] not in solution.names or not solution.amplitude(*STIFFNESS) > 0:
        return solution
    loop = Loop(bench, solution)
    loop.point = on_stretch(bench, solution).point
    found = loop.solution(*loop.descend(rounds))
    bench.learn(found)
    return found
