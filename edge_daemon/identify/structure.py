"""A structure simulated on a bench: the torque that it models, and what every number of it changes there.

The torque of effects that the catalogue gives a law for is taken on a simulated twist, so that what a parameter changes
includes how it changes the twist.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, takewhile

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.effects.algebra import inertia_of
from edge_daemon.effects.effect import Effect, Parameter
from edge_daemon.identify import inloop
from edge_daemon.identify.regression import RegressionProblem, from_search, to_search
from edge_daemon.identify.solution import DAMPING, STIFFNESS, Solution, Term
from edge_daemon.integrator.laws import Element
from edge_daemon.motion.corrected import SKEW, angles_of, corrected, senses
from edge_daemon.records import Array, Motion

SHAPE_STEP = 1e-3
"""A shape that acts outside the loop has a finite difference of this relative step."""
LAW_STEP = 1e-6
"""A number within a law has a finite difference of this relative step."""


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


@dataclass(frozen=True, slots=True)
class LoopBaseline:
    """What one trial drives the loop with, at one correction of its angles."""

    motion: Motion
    """corrected"""
    ahead_rad: Array
    """(n,) of the correction, what the gear errs by: it is driven by that, and not by what an encoder misreads"""
    on: inloop.SimulatedTwist
    linear: Array
    """(m, 2) filtered twist and twist rate"""
    fixed: tuple[inloop.AngleSensitivity | None, ...]
    """of the numbers that act on push and twist, None for those of the laws"""
    columns: tuple[Array | None, ...]
    """(m, 2) filtered angle and rate, or (m, 1) torque, that the same numbers add outside the loop"""
    parts: Array
    """(n, f) torque of each further number, at the samples"""


@dataclass(frozen=True, slots=True)
class AngleLever:
    """What each amplitude of an error of the angles moves."""

    motor: Array
    """(n,) angle that it was computed for"""
    delay_s: float
    """of a skew"""
    bends: tuple[inloop.AngleSensitivity, ...]
    columns: tuple[Array, ...]
    """(m, 2) filtered angle and rate"""


class Structure:
    """A structure on a bench as a function of all its parameters."""

    def __init__(self, problem: RegressionProblem, solution: Solution, held: bool = False) -> None:
        self.held = held
        """whether the observer holds on firmly: laws may be far off"""
        self.problem, self.terms = problem, solution.terms
        self.places = [place for i, term in enumerate(self.terms) for place in _places(i, term)]
        self.point = np.array([_value(solution, place) for place in self.places])
        self._baselines: dict[int, tuple[bytes, LoopBaseline]] = {}

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

    def modelled(self, point: Array, derive: bool = True) -> tuple[Array, Array]:
        """(m,) torque of the whole structure, filtered, and (m, q) its derivative by each coordinate (`derive`)."""
        parts = [self._modelled(i, trial, point, derive) for i, trial in enumerate(self.problem.trials)]
        return np.concatenate([base for base, _ in parts]), np.vstack([design for _, design in parts])

    def _modelled(self, i: int, trial: PreparedMotion, point: Array, derive: bool) -> tuple[Array, Array]:
        terms, amplitudes = self.split(point)
        baseline = self._baseline(i, trial, terms, amplitudes)
        spring = spring_of(trial, amplitudes)
        bends = self._bends(point, baseline) if derive else []
        extra = self._further(baseline, point)
        by, changes = inloop.tangent(baseline.on, spring, self.elements(terms, amplitudes), extra, bends)
        base = baseline.linear @ (spring.stiffness, amplitudes.get(DAMPING[0], _NONE)[0])
        base = base + inloop.filtered(trial, by.torque_Nm, baseline.on.times)
        if extra is not None:
            base += trial.project(extra[:, None])[:, 0]
        design = trial.project(changes.T) if derive else np.empty((len(base), 0))
        for j in range(design.shape[1]):
            design[:, j] += self._outside(j, baseline, spring)
        return base, design

    def _outside(self, j: int, baseline: LoopBaseline, spring: inloop.Spring) -> Array | float:
        """(m,) what a number adds to the torque outside the elements."""
        place, column = self.places[j], baseline.columns[j]
        name = self.terms[place.term].effect.name
        if name in (STIFFNESS[0], DAMPING[0]):
            return baseline.linear[:, int(name == DAMPING[0])]
        if column is None:
            return 0.0
        if column.shape[1] == 1:
            return column[:, 0]
        angle: Array = column @ (spring.stiffness, spring.damping)
        return angle

    def _further(self, baseline: LoopBaseline, point: Array) -> Array | None:
        """(n,) torque of the effects that neither correct the twist nor are simulated."""
        places = [j for j, place in enumerate(self.places) if place.index >= 0 and _further(self.terms[place.term])]
        return baseline.parts @ point[places] if places else None

    def _baseline(
        self, i: int, trial: PreparedMotion, terms: Sequence[Term], amplitudes: Mapping[str, Array]
    ) -> LoopBaseline:
        acting = [t for t in terms if t.effect.is_angle_error]
        bent = [t for t in terms if _further(t) and t.effect.shapes]
        key = (
            _key(amplitudes, acting)
            + np.array([v for t in bent for v in self.shapes(t, amplitudes).values()]).tobytes()
        )
        known = self._baselines.get(i)
        if known is None or known[0] != key:
            known = self._baselines[i] = key, self._new_baseline(i, trial, terms, amplitudes)
        return known[1]

    def _new_baseline(
        self, i: int, trial: PreparedMotion, terms: Sequence[Term], amplitudes: Mapping[str, Array]
    ) -> LoopBaseline:
        motion = corrected(trial.motion, [term.effect for term in terms], amplitudes, self.problem.known[i])
        gears = [term.effect for term in terms if not term.effect.misreads]
        whole = len(gears) == len(terms)
        gear = motion if whole else corrected(trial.motion, gears, amplitudes, self.problem.known[i])
        speed = trial.input_rad_s + gear.twist_rate_rad_s - trial.motion.twist_rate_rad_s
        fixed: list[inloop.AngleSensitivity | None] = []
        columns: list[Array | None] = []
        parts = []
        seen = replace(trial.motion, theta_in_rad=motion.theta_in_rad)
        for term in terms:
            if term.effect.is_angle_error:
                lever = self._lever(i, term.effect, seen, amplitudes[term.effect.name])
                unmoved = np.zeros(len(motion))
                fixed += [replace(row, push=unmoved) if term.effect.misreads else row for row in lever.bends]
                columns += lever.columns
            elif _further(term):
                for torque, linearly in self._torques(term, motion, amplitudes):
                    fixed.append(inloop.AngleSensitivity((0.0, 0.0), _NO_BEND, -torque))
                    columns.append(trial.project(torque[:, None]))
                    parts += [torque] * linearly
            else:
                rows = [*term.effect.amplitudes, *term.effect.free_shapes]
                fixed += [None] * len(rows)
                columns += [None] * len(rows)
        linear = trial.project(np.stack((motion.twist_rad, motion.twist_rate_rad_s), axis=1))
        factors = [term.effect.factors(motion) for term in terms if term.effect.factors is not None]
        shaken = senses(motion) and any(inloop.remembers(term.effect) for term in terms)  # dry friction forgets noise
        driven = trial.felt(motion) if shaken else motion
        on = inloop.course(driven, loop_inertia(trial), speed, self.held, factors)
        ahead_rad = gear.twist_rad - trial.motion.twist_rad
        return LoopBaseline(motion, ahead_rad, on, linear, tuple(fixed), tuple(columns), np.array(parts).T)

    def _lever(self, i: int, effect: Effect, seen: Motion, amplitudes: Array) -> AngleLever:
        """Of an error of the angles on one trial; kept on the bench as long as the motor angle and the delay stay."""
        delay = float(amplitudes[0]) if effect.name == SKEW else 0.0
        kept = self.problem.levers.get((i, effect.key))
        if not isinstance(kept, AngleLever) or kept.motor is not seen.theta_in_rad or kept.delay_s != delay:
            angle, rate = angles_of(effect, seen, self.problem.known[i], delay)
            kept = self.problem.levers[i, effect.key] = levered(
                self.problem.trials[i], seen.theta_in_rad, delay, angle, rate
            )
        return kept

    def _torques(self, term: Term, motion: Motion, amplitudes: Mapping[str, Array]) -> list[tuple[Array, bool]]:
        """(n,) torque per unit of each number of an effect, and whether that number is an amplitude."""
        shapes = self.shapes(term, amplitudes)
        base = term.effect.columns(motion, shapes, None)[0]
        out = [(column, True) for column in base.T]
        for row in term.effect.free_shapes:
            at = to_search(row, shapes[row.name]) + SHAPE_STEP
            moved = term.effect.columns(motion, {**shapes, row.name: from_search(row, at)}, None)[0]
            out.append(((moved - base) @ amplitudes[term.effect.name] / SHAPE_STEP, False))
        return out

    def elements(self, terms: Sequence[Term], amplitudes: Mapping[str, Array]) -> list[Element]:
        """The laws of all simulated effects."""
        simulated = [term for term in terms if term.effect.in_loop is not None]
        laws = (self._law(term, self.shapes(term, amplitudes), amplitudes[term.effect.name]) for term in simulated)
        return list(chain.from_iterable(laws))

    def _law(self, term: Term, shapes: Mapping[str, float], amplitudes: Array) -> list[Element]:
        """The elements of an effect, which count their own factors behind those of the effects before."""
        assert term.effect.in_loop is not None
        before = takewhile(lambda other: other.effect.key != term.effect.key, self.terms)
        ahead = sum(len(other.effect.amplitudes) for other in before if other.effect.factors and term.effect.factors)
        return [row._replace(b=row.b + ahead) for row in term.effect.in_loop(shapes, amplitudes.tolist())]

    def _bends(self, point: Array, baseline: LoopBaseline) -> list[inloop.AngleSensitivity]:
        """What each number changes in the loop; of the laws by differences."""
        base = inloop.packed(self.elements(*self.split(point)))[:, 1:]
        out = []
        for j, place in enumerate(self.places):
            fixed = baseline.fixed[j]
            if fixed is not None:
                out.append(replace(fixed, elements=np.zeros_like(base)))
                continue
            moved = point.copy()
            moved[j] += self._difference(place, point[j])
            law = inloop.packed(self.elements(*self.split(moved)))[:, 1:]
            name = self.terms[place.term].effect.name
            spring = float(name == STIFFNESS[0]), float(name == DAMPING[0])
            out.append(inloop.AngleSensitivity(spring, (law - base) / (moved[j] - point[j])))
        return out

    def _difference(self, place: Place, value: float) -> float:
        """Difference by which laws are derived, away from a shape's upper bound."""
        if place.index >= 0:
            return LAW_STEP * (abs(value) or 1.0)
        return -LAW_STEP if value + LAW_STEP > to_search(place.row, place.row.upper) else LAW_STEP

    def shapes(self, term: Term, amplitudes: Mapping[str, Array]) -> dict[str, float]:
        """All shapes of a term, tied ones from the amplitudes at hand."""
        values = self.problem.shapes(term.effect, term.shapes)
        for name, (effect, parameter) in term.effect.tied.items():
            if effect in amplitudes and (effect, parameter) in (STIFFNESS, DAMPING):
                values[name] = float(amplitudes[effect][0])
        return values

    def _named(self) -> list[tuple[Place, float]]:
        return list(zip(self.places, self.point.tolist(), strict=True))

    def columns(self, terms: Sequence[Term], amplitudes: Mapping[str, Array]) -> Array:
        """(m, p) of all amplitudes: laws on the simulated twist, all else as measured."""
        return np.vstack([self._columns_of(i, terms, amplitudes) for i in range(len(self.problem.trials))])

    def _columns_of(self, i: int, terms: Sequence[Term], amplitudes: Mapping[str, Array]) -> Array:
        trial = self.problem.trials[i]
        baseline, by, parts = self._baseline(i, trial, terms, amplitudes), self.simulated(i, terms, amplitudes), []
        for term in terms:
            shapes = self.shapes(term, amplitudes)
            if term.effect.in_loop is None:
                raw = term.effect.kind == "measurement" or _linear(term)
                seen = replace(trial.motion, theta_in_rad=baseline.motion.theta_in_rad) if raw else baseline.motion
                parts.append(trial.project(term.effect.columns(seen, shapes, None)[0]))
                continue
            for unit in np.eye(len(term.effect.amplitudes)):
                torque = inloop.along(baseline.on, by, self._law(term, shapes, unit))
                parts.append(inloop.filtered(trial, torque, baseline.on.times)[:, None])
        return np.hstack(parts)

    def simulated(self, i: int, terms: Sequence[Term], amplitudes: Mapping[str, Array]) -> inloop.LoopDrive:
        """The simulated twist of one trial."""
        trial = self.problem.trials[i]
        baseline = self._baseline(i, trial, terms, amplitudes)
        extra = self._further(baseline, self.point)
        return inloop.simulated_twist(
            baseline.on, spring_of(trial, amplitudes), self.elements(terms, amplitudes), extra
        )


def levered(trial: PreparedMotion, motor: Array, delay_s: float, angle: Array, rate: Array) -> AngleLever:
    """The lever of an angle and its rate (n, k) on a trial."""
    inertia, hz = loop_inertia(trial), trial.motion.rate_hz
    pairs = list(zip(angle.T, rate.T, strict=True))
    bends = tuple(inloop.AngleSensitivity((0.0, 0.0), _NO_BEND, inertia * inloop.slope_of(r, hz), a) for a, r in pairs)
    return AngleLever(motor, delay_s, bends, tuple(trial.project(np.stack(pair, axis=1)) for pair in pairs))


_NO_BEND = np.zeros((0, 4))
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


def _further(term: Term) -> bool:
    """Whether an effect adds a torque that is known before the twist is."""
    return term.effect.in_loop is None and not term.effect.is_angle_error and not _linear(term)


def _key(amplitudes: Mapping[str, Array], terms: Sequence[Term]) -> bytes:
    """What a cached part of the model depends on."""
    parts = [part for t in terms for part in (amplitudes[t.effect.name], list(t.shapes.values()))]
    return np.concatenate([[0.0], *parts]).tobytes()


def loop_inertia(trial: PreparedMotion) -> float:
    """Inertia that the twist is simulated with; 0 where the torque is measured."""
    return inertia_of(trial.motion)


def spring_of(trial: PreparedMotion, amplitudes: Mapping[str, Array]) -> inloop.Spring:
    """The linear part of a structure."""
    damping = float(amplitudes.get(DAMPING[0], _NONE)[0])
    return inloop.Spring(loop_inertia(trial), float(amplitudes[STIFFNESS[0]][0]), max(damping, 0.0))
