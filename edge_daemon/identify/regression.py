"""Columns of any list of effects over one or several recordings, and the fit of their amplitudes and shapes.

Variable projection (Golub & Pereyra 1973): for given shapes the amplitudes follow by linear least squares, so that a
search runs over the few shapes only. Measurement effects correct the twist before the torque effects see it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.effects.column_memory import ColumnMemory
from edge_daemon.effects.drive_waves import DIRECTED, LOADS, carriers_of, drag, lead, leads, told_once
from edge_daemon.effects.effect import Effect, Parameter
from edge_daemon.effects.presliding import with_friction_built_up
from edge_daemon.effects.stiffness import bends, slope
from edge_daemon.effects.waves import wave_slopes
from edge_daemon.identify.block_least_squares import (
    BlockSums,
    MovingColumns,
    block_sums,
    folds,
    held_out,
    square_error,
)
from edge_daemon.identify.inloop import made_by, remembered, remembers
from edge_daemon.identify.noise_in_columns import noise_in_columns
from edge_daemon.identify.solution import (
    DAMPING,
    DELAY,
    INERTIA,
    SPRING_AND_DAMPER,
    STIFFNESS,
    Shapes,
    Solution,
    Term,
    delayed,
)
from edge_daemon.motion.corrected import KnownAngleErrors, angles_of, corrected
from edge_daemon.motion.order_spectrum import OrderScale
from edge_daemon.motion.residual_statistics import independent, lags_at
from edge_daemon.records import Array, Motion

START_STIFFNESS_NM_PER_RAD = 2e4
START_DAMPING_NMS_PER_RAD = 5.0
USUAL = {STIFFNESS: START_STIFFNESS_NM_PER_RAD, DAMPING: START_DAMPING_NMS_PER_RAD}
"""What tied shapes take where nothing is known."""
SEARCH_STEPS, SEARCH_STEP = 15, 1e-6
"""One shape search may take so many steps; by such a change of a shape, or of its logarithm, its slope is found."""
FAR_OFF = 1e3
"""Error over the rms of the torque where columns are no numbers."""
LONGEST_RATE = 0.9
"""A step over that before up to which shapes are heading somewhere (guess)."""
LONGEST_LEAP = 3.0
"""An extrapolated stiffness or damping may differ from the newest fitted one by this factor."""
ERROR_TOLERANCE = 2e-5
"""A search stops below this relative change of the squared error: a third of a standard deviation in 30 s."""
GEAR_ERROR = "kinematic_error"
CAME, IN_MOTION = (0.0, *(sign * way for way in (0.03, 0.12, 0.5, 2.0) for sign in (1.0, -1.0))), 0.02
"""Ways over the rms twist that it may have come before a recording began, and rate over its rms from which it begins in
motion (guesses)."""
ProblemState = tuple[dict[tuple[str, str], float], tuple[Motion, ...], tuple[float, ...]]


class RegressionProblem:
    """One or several trials of one joint, and the columns that effects give on them.

    `stiffness` and `damping` are what tied shapes take; `motions` hold the twist as corrected so far.
    """

    def __init__(self, trials: Sequence[PreparedMotion]) -> None:
        self.trials = tuple(trials)
        self.target = np.concatenate([trial.target for trial in trials])
        self.ends = tuple(int(end) for end in np.cumsum([len(trial.rows) for trial in trials])[:-1])
        """rows where one trial ends and the next begins"""
        self.block = np.concatenate([trial.block for trial in trials])
        self._whole = np.zeros(len(self.block), dtype=np.intp)
        blocks = len(np.unique(self.block))
        self.fold: NDArray[np.intp] = folds(blocks)
        if len(trials) > 1:
            owner = [np.full(len(np.unique(trial.block)), i) for i, trial in enumerate(trials)]
            self.fold = np.concatenate(owner).astype(np.intp)
        self.tied = dict(USUAL)
        self.motions: tuple[Motion, ...] = tuple(trial.motion for trial in trials)
        self.noise = noise_in_columns(trials)
        self.known: tuple[KnownAngleErrors, ...] = tuple({} for _ in self.trials)
        """of each trial, what errors of the angles are made of"""
        self.came = (0.0,) * len(self.trials)
        """how far the twist of each recording had come one way before that began [rad]"""
        self._linear: dict[str, Array] = {}
        self.levers: dict[tuple[int, object], object] = {}
        """by trial and effect, what the loop keeps from one structure to the next"""
        self.asked: dict[object, Any] = {}
        """what a search was told of a solution, by what it asked"""
        self._memory = ColumnMemory()
        self._quiet: dict[int, tuple[PreparedMotion, Motion, Motion]] = {}
        self._scales: dict[tuple[str, ...], tuple[tuple[object, ...], OrderScale]] = {}

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was left out of the recordings and why, a line each."""
        return tuple(line for trial in self.trials for line in trial.remarks)

    @property
    def late_s(self) -> list[Mapping[str, float]]:
        """By how much the channels of each recording were moved."""
        return [trial.late_s for trial in self.trials]

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
        if effect.name in SPRING_AND_DAMPER:
            return self._linear_columns(effect)
        raw = effect.kind == "measurement"
        shape = self.shapes(effect, free)
        if effect.is_angle_error:
            return np.vstack([self._angle_columns(i, effect, shape) for i in range(len(self.trials))])
        if remembers(effect):
            columns = [remembered(effect, self._as_felt(i), shape, came) for i, came in enumerate(self.came)]
            return told_once(np.vstack([t.project(rows) for t, rows in zip(self.trials, columns, strict=True)]), effect)
        parts = []
        for trial, motion in zip(self.trials, self.motions, strict=True):
            seen = replace(trial.motion, theta_in_rad=motion.theta_in_rad) if raw else motion
            torque = effect.columns(seen, shape, None)[0]
            if effect.name in motion.bending:  # what the error moves it by stands with that
                moved = motion.twist_rad - trial.motion.twist_rad
                torque = torque - motion.bending[effect.name] * moved[:, None]
            parts.append(trial.project(torque))
        return told_once(np.vstack(parts), effect)

    def torque(self, terms: Sequence[Term], amplitudes: Sequence[Array]) -> Array:
        """(m,) filtered, decimated: what terms of a drive balance make in all, at amplitudes of each."""
        parts = []
        for trial, motion in zip(self.trials, self.motions, strict=True):
            columns = (t.effect.columns(motion, self.shapes(t.effect, t.shapes), None)[0] for t in terms)
            made = np.sum([row @ a for row, a in zip(columns, amplitudes, strict=True)], axis=0)
            parts.append(trial.project(made[:, None])[:, 0])
        return np.concatenate(parts)

    def _as_felt(self, i: int) -> Motion:
        """A motion as friction feels it: the same as long as the motion is."""
        trial, motion, known = self.trials[i], self.motions[i], self._quiet.get(i)
        if known is None or known[0] is not trial or known[1] is not motion:
            known = self._quiet[i] = trial, motion, trial.felt(motion)
        return known[2]

    def kept_columns(self, effect: Effect, free: Shapes) -> Array:
        """The same, not to be written to, of an effect that no other has the key of: kept for the next time."""
        seen: list[object] = []
        for motion in self.motions:
            told = effect.loaded or effect.rubs or leads(effect)
            measured = motion.theta_in_rad, motion.theta_out_rad, motion.twist_rad, motion.twist_rate_rad_s
            seen += [motion] if told else measured
        name = effect.key, self.came if remembers(effect) else (), *self.shapes(effect, free).values()
        return self._memory.get(name, tuple(seen), lambda: self.columns(effect, free))

    def order_scale(self, carriers: tuple[str, ...]) -> OrderScale:
        """Over what waves are looked for that are carried so, on the rows of the balance."""
        motions, first = self.motions, self.trials[0]
        fields = ["transmitted_Nm" if name in LOADS else name for name in carriers if name not in DIRECTED]
        seen = tuple(getattr(motion, name) for motion in motions for name in ("theta_in_rad", *fields))
        known = self._scales.get(carriers)
        if known is not None and all(a is b for a, b in zip(known[0], seen, strict=True)):
            return known[1]
        rows = [(motion, trial.rows) for motion, trial in zip(motions, self.trials, strict=True)]
        speed = np.concatenate([motion.velocity_out_rad_s[at] for motion, at in rows]) * motions[0].ratio
        angle = np.concatenate([motion.theta_in_rad[at] for motion, at in rows])
        pace, carried = np.abs(speed) / (2 * math.pi), carriers_of(carriers, rows, speed)
        scale = OrderScale(carried, angle, pace, first.fir.cutoff_hz, first.motion.rate_hz, self.ends)
        self._scales[carriers] = seen, scale
        return scale

    def _linear_columns(self, effect: Effect) -> Array:
        """(m, 1) of the spring or the damper, on the twist as measured: always the same."""
        if effect.name not in self._linear:
            parts = [trial.project(effect.columns(trial.motion, {}, None)[0]) for trial in self.trials]
            self._linear[effect.name] = np.vstack(parts)
        return self._linear[effect.name]

    def _angle_columns(self, i: int, effect: Effect, shape: Shapes) -> Array:
        """(m, k) of an error of the angles on one trial: stiffness times angle and damping times rate, both kept as
        long as the motor angle and the delay of a skew stay as they are."""
        trial, motor, delay = self.trials[i], self.motions[i].theta_in_rad, self.tied.get(DELAY, 0.0)

        def projected() -> Array:
            seen = replace(trial.motion, theta_in_rad=motor)
            return np.hstack([trial.project(column) for column in angles_of(effect, seen, self.known[i], delay)])

        angle, rate = np.hsplit(self._memory.get(("angle", effect.key, i, delay), (motor,), projected), 2)
        own: Array = shape["stiffness"] * angle + shape["damping"] * rate
        if trial.by_motor and effect.name == GEAR_ERROR:
            own = own + shape["stiffness"] * self._as_ratio(i, effect)
        bend = self.motions[i].bend_Nm_per_rad
        if bend is None:
            return own

        def bent() -> Array:
            seen = replace(trial.motion, theta_in_rad=motor)
            return trial.project(bend[:, None] * angles_of(effect, seen, self.known[i], delay)[0])

        return own + self._memory.get(("bent", effect.key, i, delay), (motor, bend), bent)

    def _as_ratio(self, i: int, effect: Effect) -> Array:
        """(m, k) twist times what an error of the gear changes the ratio by, which a motor feels (virtual work)."""
        trial, motion = self.trials[i], self.motions[i]

        def projected() -> Array:
            return trial.project(motion.twist_rad[:, None] * wave_slopes(motion, effect.waves).slopes)

        return self._memory.get(("ratio", effect.key, i), (motion.twist_rad, motion.theta_in_rad), projected)

    def felt(self, effect: Effect) -> Array:
        """(m, k) filtered, decimated columns of an effect without shapes on the corrected twist, over all trials."""
        rows = zip(self.trials, self.motions, strict=True)
        return np.vstack([trial.project(effect.columns(motion, {}, None)[0]) for trial, motion in rows])

    def block_sums(
        self, effects: Sequence[Effect], columns: Array, whole: bool = False, target: Array | None = None
    ) -> BlockSums:
        """Block-wise normal equations, or those of all rows at once; columns of all `effects`, in order, against the
        torque or another `target` (m,)."""
        rows = [row for effect in effects for row in effect.amplitudes]
        bounds = np.array([[row.lower for row in rows], [row.upper for row in rows]]).reshape(2, -1)
        target = self.target if target is None else target
        sums = block_sums(columns, target, self._whole if whole else self.block, bounds)
        return self.noise.within(sums, effects)

    def solve(self, terms: Sequence[Term], whole: bool = False) -> Solution:
        """The amplitudes at the terms' shapes, with held-out errors; `whole`: without, all rows as one block."""
        columns = np.hstack([self.kept_columns(term.effect, term.shapes) for term in terms])
        return self.solution(terms, columns, whole)

    def solution(self, terms: Sequence[Term], columns: Array, whole: bool = False) -> Solution:
        """As `solve`, for columns already at hand."""
        effects = [term.effect for term in terms]
        g = self.block_sums(effects, columns, whole).hushing(self.noise.hushed(terms, self.shapes))
        a = g.fit()
        cut = np.cumsum([len(effect.amplitudes) for effect in effects])[:-1]
        amplitudes = dict(zip([effect.name for effect in effects], np.split(a, cut), strict=True))
        fitted = square_error(g, a)
        held = fitted if whole else held_out(g, self.fold)
        return Solution(tuple(terms), amplitudes, held, fitted, g.count, columns, g)

    def held_out_residual(self, solution: Solution) -> Array:
        """(m,) measured minus modelled, each fold by parameters fitted to the others."""
        residual = self.target - solution.modelled
        design = solution.columns if solution.design is None else solution.design
        point = solution.vector if solution.point is None else solution.point
        for f in np.unique(self.fold):
            rows = (self.fold == f)[self.block]
            residual[rows] -= design[rows] @ (solution.block_sums.fit(self.fold != f) - point)
        return residual

    def begin_at(self, stated: Mapping[tuple[str, str], float]) -> None:
        """Tied shapes take what a model states, where they take what is usual as yet."""
        if self.tied == USUAL:
            self.tied |= {key: value for key, value in stated.items() if value > 0.0}

    def learn(self, solution: Solution) -> None:
        """Tied shapes and the corrected twist follow a solution."""
        for key in (STIFFNESS, DAMPING):
            value = solution.amplitude(*key)
            if math.isfinite(value) and value > 0:
                self.tied[key] = value
        self.tied[DELAY] = solution.amplitude(*DELAY, 0.0)
        effects = [term.effect for term in solution.terms]
        seen = (
            corrected(trial.motion, effects, solution.amplitudes, known)
            for trial, known in zip(self.trials, self.known, strict=True)
        )
        self.motions = tuple(
            self._transmitting(trial, self._bending(motion, solution), solution)
            for trial, motion in zip(self.trials, seen, strict=True)
        )
        terms = [term for term in solution.terms if remembers(term.effect)]
        if terms and solution.simulated is None and len(solution.columns) == len(self.target):  # not of another motion
            left = np.split(self.target - solution.modelled, self.ends)
            self.came = tuple(self._came(i, terms, solution, part) for i, part in enumerate(left))

    def _came(self, i: int, terms: Sequence[Term], solution: Solution, left: Array) -> float:
        """How far the twist of a recording that begins in motion had come before, by what laws that remember it leave;
        what it did at rest nobody knows."""
        motion, trial = self._as_felt(i), self.trials[i]
        if not abs(motion.twist_rate_rad_s[0]) > IN_MOTION * np.std(motion.twist_rate_rad_s):
            return 0.0

        def torque(came: float) -> Array:
            rows = ((t.effect, self.shapes(t.effect, t.shapes), solution.amplitudes[t.effect.name]) for t in terms)
            made = [made_by(effect, motion, shape, a, came) for effect, shape, a in rows]
            return trial.project(np.sum(made, axis=0)[:, None])[:, 0]

        wanted, size = left + torque(self.came[i]), float(np.std(motion.twist_rad))
        return min((size * way for way in CAME), key=lambda came: float(np.sum((wanted - torque(came)) ** 2)))

    def _bending(self, motion: Motion, solution: Solution) -> Motion:
        """The motion with what bending springs rise by per twist, where an error of the angles moves that: it is
        felt by as much more, and a stiff end would not let the error be found by repetition."""
        rows = [term for term in solution.terms if bends(term.effect)]
        if not rows or not any(term.effect.is_angle_error for term in solution.terms):
            return motion
        bending = {t.effect.name: slope(t.effect, motion, self.shapes(t.effect, t.shapes)) for t in rows}
        whole = np.sum([columns @ solution.amplitudes[name] for name, columns in bending.items()], axis=0)
        return replace(motion, bending=bending, bend_Nm_per_rad=whole)

    def _transmitting(self, trial: PreparedMotion, motion: Motion, solution: Solution) -> Motion:
        """The motion with the torques of motor and load at the gear, where effects of the solution tell them.

        An acceleration is noisy and smoothed, so that a torque of it is neither level nor steep where it should be.
        What is faster comes from the measured torque less all that is modelled: of what the balance passes, its noise
        would explain itself. Unknown friction at reversals is bridged.
        """
        if not any(term.effect.carried for term in solution.terms):
            return motion
        parts = [self._raw(term, motion) @ solution.amplitudes[term.effect.name] for term in solution.terms]
        carried = np.sum(
            [part for part, term in zip(parts, solution.terms, strict=True) if term.effect.carried], axis=0
        )
        motor = np.sum(parts, axis=0)
        own = [part for part, term in zip(parts, solution.terms, strict=True) if term.effect.of_motor]
        outside = [part for part, term in zip(parts, solution.terms, strict=True) if term.effect.is_outside]
        external = -np.sum(outside, axis=0) if outside else None
        left = motion.torque_Nm - motor
        sure = np.flatnonzero(~trial.unsure & np.isfinite(left))
        if len(sure):
            left = np.interp(np.arange(len(left)), sure, left[sure])
            fast = trial.fir.apply(trial.fir.beyond, left)
            carried, motor = carried + fast, motor + fast
        told = {"transmitted_Nm": carried, "motor_Nm": motor - np.sum(own, axis=0), "external_Nm": external}
        rows = [(t.effect, self.shapes(t.effect, t.shapes), solution.amplitudes[t.effect.name]) for t in solution.terms]
        if any(leads(effect) for effect, _, _ in rows):
            told |= {"drag_Nm": drag(motion, rows), "lead": lead(motion, rows)}
        told["inertia_kg_m2"] = solution.amplitude(*INERTIA, 0.0)
        return with_friction_built_up(replace(motion, **told), rows)

    def made(self, solution: Solution, motion: Motion, carried: bool = False) -> Array:
        """(n,) torque that a solution makes of one motion, at its own rate, but for what is `of_motor`; or of it what
        passes the gear alone."""
        terms = [term for term in solution.terms if (term.effect.carried if carried else not term.effect.of_motor)]
        return sum((self._raw(t, motion) @ solution.amplitudes[t.effect.name] for t in terms), np.zeros(len(motion)))

    def _raw(self, term: Term, motion: Motion) -> Array:
        """(n, k) columns of a term on one motion, at its own rate."""
        shapes = self.shapes(term.effect, term.shapes)
        name = id(motion), term.effect.key, *shapes.values()
        return self._memory.get(name, (motion, term.effect), lambda: term.effect.columns(motion, shapes, None)[0])

    @property
    def state(self) -> ProblemState:
        """What `learn` changes; to be given back with `restore`."""
        return dict(self.tied), self.motions, self.came

    def restore(self, state: ProblemState) -> None:
        """Back to an earlier `state`."""
        self.tied, self.motions, self.came = dict(state[0]), *state[1:]

    def fit(self, terms: Sequence[Term], search: bool = True, rounds: int = 2) -> Solution:
        """Shapes by search, amplitudes by least squares, tied shapes and twist correction by repetition."""
        steps: list[tuple[Array, Array]] = []
        for i in range(rounds):
            if search and i < 2:
                terms, steps = self.search(terms, SEARCH_STEPS // (i + 1)), []
            before = self._ties
            self.learn(delayed(self.solve(terms, whole=True), float(before[0])))
            steps.append((before, self._ties))
            if i < rounds - 1:
                self._leap(steps)
        return self.solve(terms)

    @property
    def _ties(self) -> Array:
        """(2,) what tied shapes take: stiffness, damping."""
        return np.array([self.tied[STIFFNESS], self.tied[DAMPING]])

    def _leap(self, steps: Sequence[tuple[Array, Array]]) -> None:
        """Where the repetition is heading, from its last three steps (Anderson 1965, J. ACM 12(4)).

        Beside a large kinematic error a plain repetition takes back a fifteenth of the damping's error in each round.
        """
        if len(steps) < 3:
            return
        start, end = (np.array(rows) for rows in zip(*steps[-3:], strict=True))
        left = end - start
        size = np.abs(end[-1])
        mix = np.linalg.lstsq((np.diff(left, axis=0) / size).T, left[-1] / size, rcond=1e-8)[0]
        ahead = end[-1] - mix @ np.diff(end, axis=0)
        if np.all((ahead > end[-1] / LONGEST_LEAP) & (ahead < end[-1] * LONGEST_LEAP)):
            self.tied[STIFFNESS], self.tied[DAMPING] = map(float, ahead)

    def search(self, terms: Sequence[Term], steps: int = SEARCH_STEPS) -> tuple[Term, ...]:
        """The terms at the free shapes that fit best, from where they stand (dogleg steps within bounds, shapes that
        are positive by their logarithms; Voglis & Lagaris 2004, WSEAS Int. Conf. Appl. Math.)."""
        free = [(i, row) for i, term in enumerate(terms) for row in term.effect.searched_shapes]
        if not free:
            return tuple(terms)
        from scipy.optimize import least_squares

        effects, shaped = [term.effect for term in terms], sorted({i for i, _ in free})
        begun = np.hstack([self.kept_columns(term.effect, term.shapes) for term in terms])
        moving = np.repeat(np.isin(range(len(effects)), shaped), [len(e.amplitudes) for e in effects])
        sums = MovingColumns(self.block_sums(effects, begun, whole=True), begun, self.target, moving)
        filtered = self.noise.hushed(terms, self.shapes) is not None

        @lru_cache(maxsize=2 * len(shaped))
        def own(i: int, shapes: tuple[tuple[str, float], ...]) -> Array:
            return self.columns(effects[i], dict(shapes))

        def left(point: Array) -> Array:
            trial = _at(terms, free, point)
            columns = np.hstack([own(i, tuple(trial[i].shapes.items())) for i in shaped])
            if not np.isfinite(columns).all():
                return np.full(len(self.target) + filtered, FAR_OFF * self.rms)
            return sums.left_by(columns, self.noise.hushed(trial, self.shapes))

        def slopes(point: Array) -> Array:
            inward = np.where(point + SEARCH_STEP > upper, -SEARCH_STEP, SEARCH_STEP)
            here = left(point)
            return np.stack([(left(point + step) - here) / step.sum() for step in np.diag(inward)], axis=1)

        start = np.array([to_search(row, terms[i].shapes.get(row.name, row.start)) for i, row in free])
        lower, upper = np.array([(to_search(row, row.lower), to_search(row, row.upper)) for _, row in free]).T
        found = least_squares(
            left, np.clip(start, lower, upper), slopes, (lower, upper), "dogbox",
            ftol=ERROR_TOLERANCE, xtol=None, gtol=None, max_nfev=steps,
        )  # fmt: skip
        return _at(terms, free, found.x)


def independent_samples(residual: Array, problem: RegressionProblem) -> float:
    """How many independent samples tell the scatter of a residual (m,)."""
    trial = problem.trials[0]
    return independent(residual, problem.block, lags_at(trial.motion.rate_hz / trial.step))


def _at(terms: Sequence[Term], free: Sequence[tuple[int, Parameter]], point: Array) -> tuple[Term, ...]:
    shapes = [dict(term.shapes) for term in terms]
    for (i, row), value in zip(free, point, strict=True):
        shapes[i][row.name] = from_search(row, float(value))
    return tuple(replace(term, shapes=own) for term, own in zip(terms, shapes, strict=True))


def heading(first: Sequence[Term], second: Sequence[Term], third: Sequence[Term]) -> tuple[Term, ...]:
    """Where the shapes of the same terms are heading that move by ever smaller steps (Aitken 1926, Proc. R. Soc. Edinb.
    46); where they are, of those that do not."""
    free = [(i, row) for i, term in enumerate(third) for row in term.effect.searched_shapes]
    x = np.array([[to_search(row, terms[i].shapes[row.name]) for i, row in free] for terms in (first, second, third)])
    before, last = np.diff(x, axis=0)
    falls = (last * before > 0.0) & (np.abs(last) < LONGEST_RATE * np.abs(before))
    more = np.where(falls, last**2 / np.where(falls, before - last, 1.0), 0.0)
    return _at(third, free, x[-1] + more)


def to_search(row: Parameter, value: float) -> float:
    return math.log(value) if row.lower > 0 else value


def from_search(row: Parameter, value: float) -> float:
    bare = math.exp(min(value, 700.0)) if row.lower > 0 else value
    return min(max(bare, row.lower), row.upper)
