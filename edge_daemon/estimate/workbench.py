"""Columns of any list of effects over one or several recordings, and the fit of their amplitudes and shapes.

Variable projection (Golub & Pereyra 1973): for given shapes the amplitudes follow by linear least squares, so that a
search runs over the few shapes only. Measurement effects correct the twist before the torque effects see it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_daemon.effects.effect import Effect, Parameter
from edge_daemon.estimate import inloop
from edge_daemon.estimate.balance import Trial
from edge_daemon.estimate.gram import Grams, folds, grams, held_out, square_error
from edge_daemon.records import Array, Motion

STIFFNESS = ("linear_stiffness", "stiffness")
DAMPING = ("viscous_damping", "damping")
SKEW = "encoder_skew"
"""its delay also shifts the motor angle that kinematic error follows"""
START_STIFFNESS_NM_PER_RAD = 2e4
START_DAMPING_NMS_PER_RAD = 5.0
SEARCH_EVALUATIONS = 45
"""column evaluations that one shape search may cost"""
SEARCH_TOLERANCE = 2e-3
"""relative change of a shape below which a search stops"""

SETTLE_SMOOTHING = (3e-5, 2e-4, 1e-3, 3e-3)
"""from dry to well lubricated [rad/s]"""
SETTLE_EVALUATIONS = 6
"""loop simulations of a stretch that each shape may cost beyond the grid"""
SETTLE_ROUNDS = 5
SETTLE_GAIN = 0.06
"""relative fall of the squared error below which the loop counts as settled"""

Shapes = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Term:
    """One effect of a structure, with its shapes."""

    effect: Effect
    shapes: Shapes


@dataclass(frozen=True, slots=True)
class Solution:
    """A fitted structure."""

    terms: tuple[Term, ...]
    amplitudes: Mapping[str, Array]
    """effect name -> (k,)"""
    held_out: Array
    """(b,) squared error of each block under a fit to the others, summed over its rows"""
    fitted: Array
    """(b,) squared error of each block under the fit to all"""
    count: Array
    """(b,) rows"""
    columns: Array
    """(m, p) of all terms, in order"""
    grams: Grams

    @property
    def names(self) -> tuple[str, ...]:
        """The effects, in order."""
        return tuple(term.effect.name for term in self.terms)

    @property
    def vector(self) -> Array:
        """(p,) all amplitudes in the order of the columns."""
        return np.concatenate([self.amplitudes[name] for name in self.names]) if self.terms else np.empty(0)

    @property
    def rmse(self) -> float:
        """Held-out rms of measured minus modelled."""
        return math.sqrt(float(self.held_out.sum() / self.count.sum()))

    def amplitude(self, effect: str, parameter: str, otherwise: float = math.nan) -> float:
        """One fitted amplitude."""
        for term in self.terms:
            if term.effect.name == effect:
                names = [row.name for row in term.effect.amplitudes]
                return float(self.amplitudes[effect][names.index(parameter)])
        return otherwise


class Workbench:
    """One or several trials of one joint, and the columns that effects give on them.

    `stiffness` and `damping` are what tied shapes take; `motions` hold the twist as corrected so far.
    """

    def __init__(self, trials: Sequence[Trial]) -> None:
        self.trials = tuple(trials)
        self.target = np.concatenate([trial.target for trial in trials])
        self.block = np.concatenate([trial.block for trial in trials])
        blocks = len(np.unique(self.block))
        self.fold: NDArray[np.intp] = folds(blocks)
        if len(trials) > 1:
            owner = [np.full(len(np.unique(trial.block)), i) for i, trial in enumerate(trials)]
            self.fold = np.concatenate(owner).astype(np.intp)
        self.tied = {STIFFNESS: START_STIFFNESS_NM_PER_RAD, DAMPING: START_DAMPING_NMS_PER_RAD}
        self.motions: tuple[Motion, ...] = tuple(trial.motion for trial in trials)
        self._noise = self._noise_products()

    @property
    def rms(self) -> float:
        """rms of the filtered torque."""
        return math.sqrt(float(np.mean(self.target**2)))

    def shapes(self, effect: Effect, free: Shapes) -> dict[str, float]:
        """All shapes: free ones as given or at their start, tied ones as known now."""
        values = effect.start | dict(free)
        return values | {name: self.tied.get(source, values[name]) for name, source in effect.tied.items()}

    def columns(self, effect: Effect, free: Shapes) -> Array:
        """(m, k) filtered, decimated columns over all trials. Linear and measurement effects see the twist as
        measured, torque effects the corrected one."""
        raw = effect.kind == "measurement" or (effect.name in (STIFFNESS[0], DAMPING[0]))
        shape = self.shapes(effect, free)
        parts = []
        for trial, motion in zip(self.trials, self.motions, strict=True):
            seen = replace(trial.motion, theta_in_rad=motion.theta_in_rad) if raw else motion
            columns, _ = effect.columns(seen, shape, None)
            parts.append(trial.project(columns))
        return np.vstack(parts)

    def grams(self, effects: Sequence[Effect], columns: Array) -> Grams:
        """Block-wise normal equations; columns of all `effects`, in order."""
        rows = [row for effect in effects for row in effect.amplitudes]
        bounds = np.array([[row.lower for row in rows], [row.upper for row in rows]]).reshape(2, -1)
        noise = np.zeros((len(rows) + 1, len(rows)))
        place = {effect.name: i for i, effect in _starts(effects)}
        for name, (own, cross) in self._noise.items():
            if name in place:
                i = place[name]
                power = float(np.mean(columns[:, i] ** 2))
                if own < 0.5 * power:
                    noise[i, i], noise[-1, i] = own, cross
        return grams(columns, self.target, self.block, bounds, noise)

    def _noise_products(self) -> dict[str, tuple[float, float]]:
        """effect -> mean square of the encoder noise in its column, and its mean product with that in the torque."""
        twist = rate = cross = weight = 0.0
        for trial in self.trials:
            m0, m2, _ = trial.moments
            into = (trial.sensors.theta_in_rad / trial.motion.ratio) ** 2
            out = trial.sensors.theta_out_rad**2
            rows = len(trial.target)
            twist += rows * m0 * (into + out)
            rate += rows * m2 * (into + out)
            accelerated = "torque_out_Nm" not in trial.motion.extra
            cross += rows * m2 * out * _inertia(trial) * accelerated
            weight += rows
        return {STIFFNESS[0]: (twist / weight, cross / weight), DAMPING[0]: (rate / weight, 0.0)}

    def solve(self, terms: Sequence[Term]) -> Solution:
        """The amplitudes at the terms' shapes, with held-out errors."""
        columns = np.hstack([self.columns(term.effect, term.shapes) for term in terms])
        return self.solution(terms, columns)

    def solution(self, terms: Sequence[Term], columns: Array) -> Solution:
        """As `solve`, for columns already at hand."""
        effects = [term.effect for term in terms]
        g = self.grams(effects, columns)
        a = g.fit()
        cut = np.cumsum([len(effect.amplitudes) for effect in effects])[:-1]
        amplitudes = dict(zip([effect.name for effect in effects], np.split(a, cut), strict=True))
        return Solution(tuple(terms), amplitudes, held_out(g, self.fold), square_error(g, a), g.count, columns, g)

    def learn(self, solution: Solution) -> None:
        """Tied shapes and the corrected twist follow a solution."""
        for key in (STIFFNESS, DAMPING):
            value = solution.amplitude(*key)
            if math.isfinite(value) and value > 0:
                self.tied[key] = value
        motions = []
        for trial in self.trials:
            motions.append(_corrected(trial.motion, solution))
        self.motions = tuple(motions)

    @property
    def state(self) -> tuple[dict[tuple[str, str], float], tuple[Motion, ...]]:
        """What `learn` changes; to be given back with `restore`."""
        return dict(self.tied), self.motions

    def restore(self, state: tuple[dict[tuple[str, str], float], tuple[Motion, ...]]) -> None:
        """Back to an earlier `state`."""
        self.tied, self.motions = dict(state[0]), state[1]

    def uncorrected(self) -> None:
        """Back to the twist as measured."""
        self.motions = tuple(trial.motion for trial in self.trials)

    def fit(self, terms: Sequence[Term], search: bool = True, rounds: int = 2) -> Solution:
        """Shapes by search, amplitudes by least squares, tied shapes and twist correction by repetition."""
        for i in range(rounds):
            if search and i < 2:
                terms = self.search(terms, SEARCH_EVALUATIONS // (i + 1))
            solution = self.solve(terms)
            self.learn(solution)
        return self.solve(terms)

    def search(self, terms: Sequence[Term], evaluations: int = SEARCH_EVALUATIONS) -> tuple[Term, ...]:
        """The terms at the free shapes that fit best (Nelder-Mead over logarithms, from where they stand)."""
        free = [(i, row) for i, term in enumerate(terms) for row in term.effect.free_shapes]
        if not free:
            return tuple(terms)
        from scipy.optimize import minimize

        fixed = [not term.effect.free_shapes for term in terms]
        known = {i: self.columns(term.effect, term.shapes) for i, term in enumerate(terms) if fixed[i]}
        effects = [term.effect for term in terms]

        def loss(point: Array) -> float:
            trial = _at(terms, free, point)
            blocks = [known[i] if fixed[i] else self.columns(t.effect, t.shapes) for i, t in enumerate(trial)]
            g = self.grams(effects, np.hstack(blocks))
            return float(square_error(g, g.fit()).sum())

        start = np.array([_to_search(row, terms[i].shapes.get(row.name, row.start)) for i, row in free])
        simplex = np.vstack((start, start + 0.3 * np.eye(len(start))))
        options: Any = {"maxfev": evaluations, "xatol": SEARCH_TOLERANCE, "fatol": 0.0, "initial_simplex": simplex}
        found = minimize(loss, start, method="Nelder-Mead", options=options)
        return _at(terms, free, np.asarray(found.x, dtype=float))

    def settle(self, solution: Solution, rounds: int = SETTLE_ROUNDS) -> Solution:
        """The solution with its friction simulated in the loop; as given where no friction law is in it.

        The shapes are searched on a few seconds, the amplitudes fitted on all, until that gains no more.
        """
        term = _law_term(solution)
        if term is None or solution.amplitudes[term.effect.name].sum() <= 0:
            return solution
        term = self._settled_shapes(solution, term)
        best, before = solution, math.inf
        for _ in range(rounds):
            solution = self._with_columns(solution, term, self._settled_columns(solution, term, None))
            self.learn(solution)
            error = float(solution.fitted.sum())
            if error < best.fitted.sum():
                best = solution
            if error > (1 - SETTLE_GAIN) * before:
                break
            before = error
        return best

    def _with_columns(self, solution: Solution, term: Term, columns: Array) -> Solution:
        parts, i = [], 0
        for old in solution.terms:
            width = len(old.effect.amplitudes)
            own = old.effect.name == term.effect.name
            tied = bool(old.effect.tied)
            parts.append(
                columns if own else self.columns(old.effect, old.shapes) if tied else solution.columns[:, i : i + width]
            )
            i += width
        terms = tuple(term if old.effect.name == term.effect.name else old for old in solution.terms)
        return self.solution(terms, np.hstack(parts))

    def _settled_shapes(self, solution: Solution, term: Term) -> Term:
        """The friction term at the shapes that fit a stretch best: its grid of smoothings, then Nelder-Mead."""
        from scipy.optimize import minimize

        rows = term.effect.free_shapes
        tried = Stretch(self, solution, term)
        for value in SETTLE_SMOOTHING:
            tried.loss({**term.shapes, "smoothing": value})
        start = np.array([_to_search(row, tried.shapes[row.name]) for row in rows])
        simplex = np.vstack((start, start + 0.5 * np.eye(len(start))))
        options: Any = {"maxfev": SETTLE_EVALUATIONS * len(rows), "initial_simplex": simplex}

        def loss(point: Array) -> float:
            return tried.loss({row.name: _from_search(row, float(v)) for row, v in zip(rows, point, strict=True)})

        minimize(loss, start, method="Nelder-Mead", options=options)
        return Term(term.effect, tried.shapes)

    def _stretch(self) -> tuple[float, float]:
        """Seconds from the start of the first trial: the middle of it."""
        motion = self.trials[0].motion
        length = len(motion) / motion.rate_hz
        middle = length / 2
        return max(0.0, middle - SETTLE_STRETCH_S / 2), min(length, middle + SETTLE_STRETCH_S / 2)

    def _rows_in(self, stretch: tuple[float, float]) -> NDArray[np.bool_]:
        trial = self.trials[0]
        seconds = trial.rows / trial.motion.rate_hz
        inside = (seconds > stretch[0] + SETTLE_LEAD_S) & (seconds < stretch[1] - SETTLE_LEAD_S)
        return np.concatenate((inside, np.zeros(len(self.target) - len(inside), dtype=bool)))

    def _settled_columns(self, solution: Solution, term: Term, stretch: tuple[float, float] | None) -> Array:
        """(m, k) columns of the friction term on the motion in the loop; only the first trial's stretch if given."""
        parts = []
        for trial, motion in zip(self.trials, self.motions, strict=True):
            extra = np.zeros(len(motion))
            for other in solution.terms:
                name = other.effect.name
                if other.effect.kind == "torque" and name not in (STIFFNESS[0], DAMPING[0], term.effect.name):
                    columns, _ = other.effect.columns(motion, self.shapes(other.effect, other.shapes), None)
                    extra += columns @ solution.amplitudes[name]
            rows = trial.rows
            if stretch is not None:
                a, b = (round(edge * motion.rate_hz) for edge in stretch)
                motion, extra = sliced(motion, a, b), extra[a:b]
                rows = rows[self._rows_in(stretch)[: len(rows)]] - a
            spring = inloop.Spring(
                _inertia(trial), solution.amplitude(*STIFFNESS), max(solution.amplitude(*DAMPING, 0.0), 0.0)
            )
            law = _law(term, solution)
            fine = inloop.settled(motion, spring, law, extra)
            kernel = inloop.fine_filter(motion, trial.fir)
            columns, _ = term.effect.columns(fine, self.shapes(term.effect, term.shapes), None)
            parts.append(kernel.apply(kernel.value, columns)[rows * inloop.refine(motion)])
            if stretch is not None:
                break
        return np.vstack(parts)


class Stretch:
    """A few seconds on which friction shapes are tried; the best so far also lends its amplitudes to the loop."""

    def __init__(self, bench: Workbench, solution: Solution, term: Term) -> None:
        self.bench, self.solution, self.term = bench, solution, term
        self.seconds = bench._stretch()
        keep = bench._rows_in(self.seconds)
        self.place = _place(solution, term)
        self.columns = solution.columns[keep].copy()
        self.target = bench.target[keep]
        self.shapes, self.error = dict(term.shapes), math.inf

    def loss(self, shapes: Shapes) -> float:
        """Mean square error on the stretch."""
        own = self.bench._settled_columns(self.solution, Term(self.term.effect, shapes), self.seconds)
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


LAWS = ("coulomb_friction", "stribeck_friction", "load_dependent_friction")
"""effects that the loop can simulate"""
SETTLE_STRETCH_S = 5.0
SETTLE_LEAD_S = 0.3


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


def _starts(effects: Sequence[Effect]) -> list[tuple[int, Effect]]:
    out, i = [], 0
    for effect in effects:
        out.append((i, effect))
        i += len(effect.amplitudes)
    return out


def _at(terms: Sequence[Term], free: Sequence[tuple[int, Parameter]], point: Array) -> tuple[Term, ...]:
    shapes = [dict(term.shapes) for term in terms]
    for (i, row), value in zip(free, point, strict=True):
        shapes[i][row.name] = _from_search(row, float(value))
    return tuple(replace(term, shapes=own) for term, own in zip(terms, shapes, strict=True))


def _to_search(row: Parameter, value: float) -> float:
    return math.log(value) if row.lower > 0 else value


def _from_search(row: Parameter, value: float) -> float:
    bare = math.exp(min(value, 700.0)) if row.lower > 0 else value
    return min(max(bare, row.lower), row.upper)


def _inertia(trial: Trial) -> float:
    """Output inertia that the torque was computed with."""
    acceleration = trial.motion.acceleration_out_rad_s2
    power = float(acceleration @ acceleration)
    return float(acceleration @ trial.motion.torque_Nm) / power if power else 0.0


def _corrected(motion: Motion, solution: Solution) -> Motion:
    """The motion with the twist that the gear has, measurement errors added to the twist that was read."""
    angle, rate, motor = np.zeros(len(motion)), np.zeros(len(motion)), motion.theta_in_rad
    for term in solution.terms:
        effect = term.effect
        if effect.kind == "measurement" and set(effect.tied) == {"stiffness", "damping"}:
            a = solution.amplitudes[effect.name]
            if effect.name == SKEW:
                advance = float(a[0]) * (motion.velocity_out_rad_s + motion.twist_rate_rad_s)
                motor = motion.theta_in_rad + motion.ratio * advance
            angle += effect.columns(motion, {"stiffness": 1.0, "damping": 0.0}, None)[0] @ a
            rate += effect.columns(motion, {"stiffness": 0.0, "damping": 1.0}, None)[0] @ a
    if not angle.any():
        return motion
    twist, twist_rate = motion.twist_rad + angle, motion.twist_rate_rad_s + rate
    return replace(motion, theta_in_rad=motor, twist_rad=twist, twist_rate_rad_s=twist_rate)
