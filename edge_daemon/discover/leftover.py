"""What a model leaves on recordings, made ready for formulas: the axes, and least squares beside the model.

Every formula is fitted jointly with the model's own numbers: what those would take up is projected out of the
leftover and of each column.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.balance.reversals import without_unknown
from edge_daemon.channels import CHANNELS
from edge_daemon.discover.factors import CLOCK, Evaluated, Product, Span
from edge_daemon.discover.past_axes import PAST_AXES, differences, load_axes, reads, turned_enough
from edge_daemon.effects.algebra import inertia_of
from edge_daemon.effects.expression import LOAD, MOTOR, evaluate, parse
from edge_daemon.effects.model import Model
from edge_daemon.explain.diagnose import missing_effects
from edge_daemon.explain.plausibility import correlation
from edge_daemon.identify.regression import RegressionProblem, independent_samples
from edge_daemon.identify.solution import DAMPING, STIFFNESS, Solution, Term
from edge_daemon.motion.corrected import senses
from edge_daemon.motion.left_over import LeftOver
from edge_daemon.records import Array, Motion

MOTION_AXES = {
    "torsion": (
        "theta_in_rad",
        "theta_out_rad",
        "twist_rad",
        "twist_rate_rad_s",
        "velocity_out_rad_s",
        "temperature_degC",
        "time_s",
    ),
    "drive": (
        "theta_in_rad",
        "theta_out_rad",
        "velocity_out_rad_s",
        "acceleration_out_rad_s2",
        LOAD,
        MOTOR,
        "temperature_degC",
        "time_s",
    ),
}
"""Axes of each balance: the torque is none, since it would explain itself. In a torsion balance acceleration would, but
where a sensor measures the torque and other drives load the joint."""
ACCELERATION, OUTSIDE = "acceleration_out_rad_s2", 0.1
"""Axis of a loaded joint, and share of its torque's square that its own motion must leave: inertia, weight, friction of
what it carries (guess)."""
NO_AXES = {
    "theta_in_rad",
    "theta_out_rad",
    "velocity_in_rad_s",
    "velocity_out_rad_s",
    "torque_out_Nm",
    "torque_in_Nm",
    "current_in_A",
    "profile_phase",
}
"""Further channels that are known already, or are what is to be explained."""
COPY = 0.995
"""Correlation with the torque from which a column is the same torque under another name: it would explain itself at a
probability of 1 (guess)."""
TURNING = ("theta_in_rad",)
"""Axes of which only the place within a turn can matter."""
LEAST_SPREAD = {"degC": 1.0}
"""Least change of an axis for a law of it to show, by its unit."""
PARTS_GOING_ON, ONE_WAY_SHARE = 16, 0.9
"""A channel goes on as the clock does where the means of so many parts differ by this share of all their steps (guess).
"""
FAR_CLOCK = 10.0
"""Start of a clock over its span above which a formula counts time from the start instead."""
THIN_ROWS = 2000
"""Rows on which formulas are sorted: some hundred per number."""


class Leftover:
    """One model on one problem, and what formulas may add to it."""

    kept: NDArray[np.bool_] | None = None
    """(m,) the rows that count; all where none is said"""
    misread = False
    """whether formulas are what the output's encoder reads too much, and no torques"""
    simulated = False
    """whether an axis is what a simulation says and not what was measured"""
    alone: Leftover | None = None
    """the same where a constant takes nothing; None where that is this one"""

    def __init__(self, problem: RegressionProblem, base: Solution, model: Model) -> None:
        self.problem, self.base, self.model = problem, base, model
        start_s, span_s = float(problem.motions[0].time_s[0]), float(np.ptp(problem.motions[0].time_s))
        self.shift = {CLOCK: round(start_s) if abs(start_s) > FAR_CLOCK * span_s else 0.0}
        self.varying = _varying([motion.extra for motion in problem.motions])
        """channels that change, be it only from one recording to the next"""
        self.axes: tuple[dict[str, Array], ...] = tuple(self._axes_of(motion) for motion in problem.motions)
        design = base.columns if base.design is None else base.design
        self.known: Array = _basis(design)
        self.left = self.without_known(problem.target - base.modelled)

    def beside_a_constant(self) -> Leftover:
        """The same where a constant takes what it can: the zero of a sensor hides laws, and a law may be less one."""
        part = copy(self)
        part.rows, part.spans = self.rows, self.spans  # an axis that is made for one is there for both
        part.alone, part.known = self, _basis(np.hstack((self.known, self.columns(Product(())))))
        part.left = part.without_known(self.left)
        return part

    def _axes_of(self, motion: Motion) -> dict[str, Array]:
        """Every channel that varies, time included."""
        names = [*MOTION_AXES[self.model.balance], *(name for name in motion.extra if name not in NO_AXES)]
        names += [ACCELERATION] if self.model.balance == "torsion" and _loaded_from_outside(motion) else []
        out = {}
        for name in names:
            column = getattr(motion, name) if hasattr(motion, name) else motion.extra[name]
            if name == LOAD and motion.external_Nm is None:  # of the inertia alone it is the acceleration
                continue
            if name in (LOAD, MOTOR):  # without what of the measured torque the model does not tell
                column = self.problem.made(self.base, motion, carried=name == LOAD)
            column = np.asarray(column, dtype=float) - self.shift.get(name, 0.0)
            further = name not in MOTION_AXES[self.model.balance] and name not in CHANNELS
            if further and abs(correlation(column, motion.torque_Nm)) > COPY:
                continue
            if np.isfinite(column).all() and (name in self.varying or _varies(name, column)):
                out[name] = column
        told = (name for name in out if name == "temperature_degC" or name not in MOTION_AXES[self.model.balance])
        apart = {axis: _past(axis, out) for axis in differences(told)}
        out |= {axis: column for axis, column in apart.items() if _varies(axis, column)}
        past = (axis for axis in PAST_AXES if reads(axis) <= out.keys() and turned_enough(axis, out))
        load = load_axes(motion.inertia_kg_m2) if LOAD in out and motion.inertia_kg_m2 > 0 else []
        return out | {axis: _past(axis, out) for axis in (*past, *load)}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Axes that every recording has; the load as what it is without a part of the motor's inertia."""
        return tuple(name for name in self.axes[0] if name != LOAD and all(name in axes for axes in self.axes))

    @cached_property
    def rows(self) -> dict[str, Array]:
        """(m,) the axes at the rows that are judged, as measured."""
        pairs = list(zip(self.problem.trials, self.axes, strict=True))
        return {name: np.concatenate([axes[name][trial.rows] for trial, axes in pairs]) for name in self.names}

    @cached_property
    def spans(self) -> dict[str, Span]:
        """How far each axis went."""
        return {name: Span.of(column) for name, column in self.rows.items()}

    def seen(self, axis: str) -> tuple[float, float]:
        """Least and largest of an axis, as recorded."""
        span, shift = self.spans[axis], self.shift.get(axis, 0.0)
        return span.low + shift, span.high + shift

    @cached_property
    def beside(self) -> frozenset[str]:
        """Axes that are told by sensors beside the joint, such as a temperature."""
        moves = {*MOTION_AXES[self.model.balance], *PAST_AXES} - {"temperature_degC"}
        return frozenset(name for name in self.names if name not in moves and name.isidentifier())

    @cached_property
    def clocks(self) -> frozenset[str]:
        """The clock, and of one recording what goes on one way as that does: a housing that warms up tells the time."""
        alone = [name for name in self.beside if name != CLOCK] if len(self.axes) == 1 else []
        return frozenset({CLOCK, *(name for name in alone if _goes_on(self.rows[name]))})

    def make(self, axis: str) -> None:
        """Makes an axis ready that is an expression, beside those that are there."""
        if axis in self.spans:
            return
        for axes in self.axes:
            axes[axis] = _past(axis, axes)
        pairs = zip(self.problem.trials, self.axes, strict=True)
        self.rows[axis] = np.concatenate([axes[axis][trial.rows] for trial, axes in pairs])
        self.spans[axis] = Span.of(self.rows[axis])
        self.thin.axes[0][axis] = self.rows[axis][_every(len(self.left))]

    def without_known(self, columns: Array) -> Array:
        """(m,) or (m, k) less what the model's own numbers would take up."""
        out: Array = columns - self.known @ (self.known.T @ columns)
        return out

    def columns(self, *products: Product, mixes: Sequence[Array] = ()) -> Array:
        """(m, k) of products through the balance filter; of each one column, its mixture by amplitudes, where `mixes`
        (k,) are given."""
        parts = [
            self._felt(trial, _mixed([product.courses(axes) for product in products], mixes))
            for trial, axes in zip(self.problem.trials, self.axes, strict=True)
        ]
        whole = np.vstack(parts)
        return whole if self.kept is None else whole[self.kept]

    def _felt(self, trial: PreparedMotion, columns: Array) -> Array:
        """(m, k) of columns (n, k) as the balance has them."""
        return trial.project(columns)

    def where(self, kept: NDArray[np.bool_]) -> Self:
        """The same on some of its rows (m,), fitted on them alone."""
        part = copy(self)
        part.kept, part.known = kept, _basis(self.known[kept])
        part.left = part.without_known(self.left[kept])
        return part

    @cached_property
    def thin(self) -> Thinned:
        """The same on few rows and without the filter: fifty times as fast, and good enough to sort by."""
        return Thinned(self)

    @cached_property
    def samples(self) -> float:
        """Independent samples of what is left."""
        return independent_samples(self.left, self.problem)

    @cached_property
    def catalogued(self) -> dict[str, Array]:
        """(m, k) orthonormal, by name: what each effect that the model lacks could take of the leftover, at the start
        of its shapes."""
        out = {}
        for effect in missing_effects(self.model, self.problem):
            columns = self.without_known(self.problem.columns(effect, effect.start))
            if np.isfinite(columns).all():
                out[effect.name] = np.linalg.qr(columns / np.maximum(np.abs(columns).max(axis=0), 1e-300))[0]
        return out

    def text(self, axis: str) -> str:
        """An axis as an expression names it."""
        shift = self.shift.get(axis, 0.0)
        return f"({axis} - {shift:.0f})" if shift else axis

    @property
    def square(self) -> float:
        """Sum of squares that is left."""
        return float(self.left @ self.left)


class Misread(Leftover):
    """A leftover of a gear with two encoders, whose formulas are errors of the output's: stiffness times the angle and
    damping times its rate are missing in the twist, and a torque computed from it has the inertia's too much."""

    misread = True

    def __init__(self, whole: Leftover) -> None:
        self.problem, self.base, self.model, self.shift = whole.problem, whole.base, whole.model, whole.shift
        self.axes, self.known, self.left = whole.axes, whole.known, whole.left

    def _felt(self, trial: PreparedMotion, columns: Array) -> Array:
        stiffness, damping = (self.base.amplitude(*row, 0.0) for row in (STIFFNESS, DAMPING))
        kernel = stiffness * trial.fir.value + damping * trial.fir.first
        kernel = kernel + inertia_of(trial.motion) * trial.fir.second
        return without_unknown(trial.fir.apply(kernel, columns)[trial.rows], trial.unknown)


class Thinned(Leftover):
    """A leftover on every few rows, where a column is what it is before the filter."""

    axes: tuple[dict[str, Array]]

    def __init__(self, whole: Leftover) -> None:
        self.problem, self.base, self.model, self.shift = whole.problem, whole.base, whole.model, whole.shift
        step = _every(len(whole.left))
        self.axes = ({name: column[step] for name, column in whole.rows.items()},)
        self.known = _basis(np.hstack((whole.known[step], self._unfiltered()[step])))
        self.left = self.without_known(whole.left[step])
        self.spans = whole.spans
        self._evaluated: Evaluated = {}

    @property
    def rows(self) -> dict[str, Array]:
        """(m,) the axes at the rows."""
        return self.axes[0]

    def where(self, kept: NDArray[np.bool_]) -> Self:
        """The same on some of its rows (m,), fitted on them alone."""
        part = super().where(kept)
        part.axes = ({name: column[kept] for name, column in self.axes[0].items()},)
        part._evaluated = {}
        return part

    def _unfiltered(self) -> Array:
        """(m, k) what the model's torques are before the filter, at the rows that are judged: beside a product that is
        not filtered either, those as filtered would leave what the filter takes off."""
        terms = [row for row in self.base.terms if row.effect.in_loop is None and row.effect.kind != "measurement"]
        parts = [
            np.hstack([np.empty((len(motion), 0)), *(self._torque(term, motion) for term in terms)])[trial.rows]
            for trial, motion in zip(self.problem.trials, self.problem.motions, strict=True)
        ]
        return np.vstack(parts)

    def _torque(self, term: Term, motion: Motion) -> Array:
        return term.effect.columns(motion, self.problem.shapes(term.effect, term.shapes), None)[0]

    def columns(self, *products: Product, mixes: Sequence[Array] = ()) -> Array:
        """(m, k) of products at the rows."""
        return _mixed([product.courses(self.axes[0], self._evaluated) for product in products], mixes)


def _mixed(parts: Sequence[Sequence[Array]], mixes: Sequence[Array]) -> Array:
    """(n, k) of the courses (n,) of products, or of each its mixture."""
    if mixes:
        return np.array(
            [sum(a * row for a, row in zip(mix, own, strict=True)) for mix, own in zip(mixes, parts, strict=True)]
        ).T
    return np.array([row for own in parts for row in own]).T


def _every(rows: int) -> slice:
    """The few of so many."""
    return slice(None, None, max(1, math.ceil(rows / THIN_ROWS)))


def _varies(axis: str, column: Array) -> bool:
    """Whether a law of an axis can show in its course (n,)."""
    unit = axis.rstrip(")").rsplit("_", 1)[-1]
    return float(np.ptp(column)) > LEAST_SPREAD.get(unit, 1e-9 * (1 + float(np.abs(column).max())))


def _loaded_from_outside(motion: Motion) -> bool:
    """Whether the torque behind the gear was measured, is more than what the joint's own motion makes of a load, and
    acceleration is more than the angle, as in a single sine it is not."""
    speed, angle, acceleration = motion.velocity_out_rad_s, motion.theta_out_rad, motion.acceleration_out_rad_s2
    if not senses(motion) or abs(correlation(acceleration, angle)) > COPY:
        return False
    own = [acceleration, speed, np.sign(speed), np.sin(angle), np.cos(angle), np.ones(len(motion))]
    known = np.isfinite(motion.torque_Nm)
    torque = motion.torque_Nm[known] - np.mean(motion.torque_Nm[known])
    return LeftOver.of(torque, np.stack(own, axis=1)[known]).power > OUTSIDE * float(torque @ torque)


def _varying(rows: Sequence[Mapping[str, Array]]) -> frozenset[str]:
    """The channels of some recordings that change over all of them."""
    shared = (name for name in rows[0] if all(name in row for row in rows))
    return frozenset(name for name in shared if _varies(name, np.concatenate([row[name] for row in rows])))


def _past(axis: str, axes: dict[str, Array]) -> Array:
    """(n,) of an axis that is an expression."""
    return evaluate(parse(f"a*{axis}", axes).tree, {**axes, "a": 1.0})


def _basis(columns: Array) -> Array:
    """(m, k) orthonormal, of what columns (m, n) span."""
    q, r = np.linalg.qr(columns / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300))
    kept: Array = q[:, np.abs(np.diagonal(r)) > 1e-9 * math.sqrt(len(q))]
    return kept


def orthogonal_squares(columns: Array, target: Array) -> tuple[Array, Array]:
    """(m, k) orthonormal, of what columns (m, k) span, and their amplitudes (k,), equal columns shared."""
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    q, r = np.linalg.qr(columns / scale)
    amplitudes: Array = np.linalg.lstsq(r, q.T @ target, rcond=1e-9)[0] / scale
    return q, amplitudes


def numbers_of(products: Sequence[Product]) -> list[float]:
    """All inner numbers, product by product."""
    return [number for product in products for number in product.numbers]


def _goes_on(column: Array) -> bool:
    """Whether a column (m,) goes one way, but for its noise: by the means of its parts."""
    steps = np.diff([part.mean() for part in np.array_split(column, PARTS_GOING_ON)])
    return abs(float(steps.sum())) > ONE_WAY_SHARE * float(np.abs(steps).sum())
