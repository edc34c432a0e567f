"""Where a residual has structure: how much of it any smooth function of one axis, or of a pair, would remove.

The share is judged on blocks that the function was not fitted to, so that noise alone explains nothing: a share is
one minus the ratio of held-out errors, cut at zero.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from edge_daemon.effects.effect import Wave
from edge_daemon.effects.hysteresis import relaxed
from edge_daemon.effects.model import Teeth
from edge_daemon.effects.order_names import name_of
from edge_daemon.effects.waves import waves
from edge_daemon.explain.results import Where
from edge_daemon.identify.block_least_squares import free_sums, held_out
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.records import Array
from edge_daemon.search.free_orders import lines

KNOTS = 14
"""A function of one axis has so many knots, at quantiles."""
PAIR_KNOTS = 5
INPUT_ORDERS = (1, 2, 3, 4, 5, 6, 8)
OUTPUT_ORDERS = tuple(range(1, 25))
LINES_SHOWN = 4
"""Orders that stand out and are looked for (guess: more are not read)."""
LAG_S = 0.025
"""This is beyond the memory of the balance filter at 100 Hz."""
ITS_OWN_PAST = f"the residual {1e3 * LAG_S:.0f} and {2e3 * LAG_S:.0f} ms ago"
HOLE_S = 1.0
"""A longer step of the time between rows that are judged is a hole, and no part of a tone."""
LEAST_SHARE = 0.01
CREEP_S = (0.3, 1.0, 3.0)
"""A twist that gives way does so over these times: within the blocks' and the recording's lengths."""

Axes = Mapping[str, Array]


def axes_of(problem: RegressionProblem) -> dict[str, Array]:
    """(m,) each axis at the rows that are judged; channels that were not measured, or stand still, are left out."""
    fields = {
        "input angle": "theta_in_rad",
        "output angle": "theta_out_rad",
        "twist": "twist_rad",
        "twist rate": "twist_rate_rad_s",
        "speed": "velocity_out_rad_s",
        "torque": "torque_Nm",
        "temperature": "temperature_degC",
        "time": "time_s",
    }
    out = {}
    for axis, name in fields.items():
        column = np.concatenate(
            [getattr(m, name)[t.rows] for t, m in zip(problem.trials, problem.motions, strict=True)]
        )
        if np.isfinite(column).all() and np.ptp(column) > 1e-9 * (1 + np.abs(column).max()):
            out[axis] = column
    return out


def where(residual: Array, problem: RegressionProblem, teeth: Teeth | None = None) -> tuple[Where, ...]:
    """The axes by the share of residual variance they explain, largest first; shares below 1 % are left out. What the
    residual was a moment ago comes last: it tells that the error is no noise, and nothing of what it depends on."""
    axes = axes_of(problem)
    found = Periodic(residual, problem, teeth)
    rows = [
        *_single(residual, problem, axes, found),
        *found.difference(),
        *_pairs(residual, problem, axes),
        *_memory(residual, problem),
    ]
    shown = (row for row in rows if row.share >= LEAST_SHARE)
    return tuple(sorted(shown, key=lambda row: (row.detail == ITS_OWN_PAST, -row.share)))


def share(residual: Array, columns: Array, problem: RegressionProblem) -> float:
    """Held-out share of the residual variance that a linear combination of columns (m, p) removes."""
    g = free_sums(columns, residual, problem.block)
    return max(0.0, 1.0 - float(held_out(g, problem.fold).sum() / max(float(g.square.sum()), 1e-300)))


def _single(residual: Array, problem: RegressionProblem, axes: Axes, found: Periodic) -> Iterable[Where]:
    for axis, column in axes.items():
        if axis == "input angle":
            yield found.on(axis, INPUT_ORDERS)
        elif axis == "output angle":
            smooth = Where(axis, share(residual, hats(column, KNOTS), problem), "a smooth function of the angle")
            yield max(smooth, found.on(axis, OUTPUT_ORDERS, few=True), key=lambda row: row.share)
        elif axis == "time":
            yield _time(residual, problem, column)
        else:
            knots = hats(column, KNOTS)
            yield Where(axis, share(residual, knots, problem), _shape(residual, column))
    for axis in ("twist rate", "speed"):
        if axis in axes:
            sign = np.sign(axes[axis])
            columns = np.stack((sign, np.ones_like(sign)), axis=1)
            yield Where("direction", share(residual, columns, problem), f"sign of the {axis}")


def _time(residual: Array, problem: RegressionProblem, time_s: Array) -> Where:
    """A drift, or a tone that follows the clock and no angle."""
    drift = share(residual, hats(time_s, KNOTS), problem)
    joined_s = _joined(time_s)
    rate = float(1 / np.median(np.diff(joined_s)))
    grid = np.arange(joined_s[0], joined_s[-1], 1 / rate)
    even = np.interp(grid, joined_s, residual)
    spectrum = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(len(even)), 4 * len(even)))
    first = max(1, round(4 * 20 * len(even) / (rate * (joined_s[-1] - joined_s[0]))))
    tone_hz = float((np.argmax(spectrum[first:]) + first) * rate / (4 * len(even)))
    wave = 2 * math.pi * tone_hz * time_s
    tone = share(residual, np.stack((np.sin(wave), np.cos(wave)), axis=1), problem)
    if tone > drift:
        return Where("time", tone, f"a tone at {tone_hz:.4g} Hz")
    return Where("time", drift, "a slow drift")


def _joined(time_s: Array) -> Array:
    """(m,) rising times: what comes after a hole, or from a recording with a clock of its own, follows at once."""
    steps = np.diff(time_s)
    apart = (steps <= 0) | (steps > HOLE_S)
    if not apart.any():
        return time_s
    joined: Array = time_s[0] + np.concatenate(([0.0], np.cumsum(np.where(apart, np.median(steps), steps))))
    return joined


class Periodic:
    """What of a residual repeats with an angle: at the orders that are usual there, and at those that stand out."""

    def __init__(self, residual: Array, problem: RegressionProblem, teeth: Teeth | None) -> None:
        self.residual, self.problem, self.teeth = residual, problem, teeth
        found = lines(residual, problem, np.empty((len(residual), 0)))
        self.lines = list(dict.fromkeys(row.wave for row in itertools.islice(found, LINES_SHOWN)))

    def on(self, axis: str, usual: Iterable[int], few: bool = False) -> Where:
        """One angle: the joint share of its orders, of `few` only the strongest of the usual ones, and their names."""
        angle = axis.partition(" ")[0]
        own = [wave for wave in self.lines if wave.angle == angle]
        rows = [*own, *(wave for wave in (Wave(angle, order) for order in usual) if wave not in own)]
        alone = {wave: share(self.residual, self._columns([wave]), self.problem) for wave in rows}
        ranked = sorted(rows, key=lambda wave: -alone[wave])
        joint = [*own, *ranked[:1]] if few else rows
        total = share(self.residual, self._columns(dict.fromkeys(joint)), self.problem)
        strongest = [self._said(wave, alone[wave]) for wave in ranked[:3] if alone[wave] > LEAST_SHARE]
        if few and not own:
            return Where(axis, total, f"order {ranked[0].order:g} per turn")
        return Where(axis, total, f"orders per turn: {', '.join(strongest) or 'none stands out'}")

    def difference(self) -> Iterable[Where]:
        """The input against the output, where a line follows it."""
        if any(wave.angle == "difference" for wave in self.lines):
            yield self.on("difference angle", ())

    def _said(self, wave: Wave, alone: float) -> str:
        cause = name_of(wave, self.problem.motions[0].ratio, self.teeth) if wave in self.lines else ""
        return f"{wave.order:.6g} ({alone:.0%}{'; ' * bool(cause)}{cause})"

    def _columns(self, rows: Iterable[Wave]) -> Array:
        """(m, 2 k) sine and cosine of waves at the rows that are judged."""
        pairs = zip(self.problem.trials, self.problem.motions, strict=True)
        return np.vstack([waves(motion, list(rows))[trial.rows] for trial, motion in pairs])


PAIRS = (
    ("twist", "temperature"),
    ("twist rate", "temperature"),
    ("speed", "temperature"),
    ("torque", "temperature"),
    ("twist", "time"),
    ("twist rate", "time"),
    ("speed", "time"),
    ("torque", "time"),
    ("twist", "output angle"),
    ("speed", "output angle"),
    ("twist", "twist rate"),
    ("speed", "torque"),
)


def _pairs(residual: Array, problem: RegressionProblem, axes: Axes) -> Iterable[Where]:
    """Functions of two axes, kept where they explain clearly more than either alone."""
    for one, other in PAIRS:
        if one in axes and other in axes:
            a, b = hats(axes[one], PAIR_KNOTS), hats(axes[other], PAIR_KNOTS)
            both = (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)
            alone = max(share(residual, a, problem), share(residual, b, problem))
            joint = share(residual, both, problem)
            if joint > alone + 0.1:
                yield Where(f"{one} x {other}", joint, f"the better of them alone {alone:.0%}")
    if {"twist", "input angle"} <= set(axes):
        angle, twist = axes["input angle"], axes["twist"]
        waves = np.stack((twist * np.sin(2 * angle), twist * np.cos(2 * angle)), axis=1)
        joint = share(residual, waves, problem)
        if joint > 0.1:
            yield Where("twist x input angle", joint, "twist times order 2")


def _memory(residual: Array, problem: RegressionProblem) -> Iterable[Where]:
    """The residual's own past, beyond what the filter remembers, and the twist's of the last seconds."""
    trial = problem.trials[0]
    steps = max(1, round(LAG_S * trial.motion.rate_hz / trial.step))
    columns = np.zeros((len(residual), 2))
    columns[steps:, 0] = residual[:-steps]
    columns[2 * steps :, 1] = residual[: -2 * steps]
    own = Where("lag", share(residual, columns, problem), ITS_OWN_PAST)
    yield max(own, _creep(residual, problem), key=lambda row: row.share)


def _creep(residual: Array, problem: RegressionProblem) -> Where:
    """The twist as something that gives way in seconds has followed it."""
    parts = []
    for trial, motion in zip(problem.trials, problem.motions, strict=True):
        slow = [relaxed(motion.twist_rad, motion.rate_hz, time_s) for time_s in CREEP_S]
        parts.append(trial.project(np.stack(slow, axis=1)))
    return Where("lag", share(residual, np.vstack(parts), problem), "the twist of the last seconds: creep")


def hats(column: Array, knots: int) -> Array:
    """(m, <= knots) piecewise linear basis with knots at quantiles of the column."""
    at = np.unique(np.quantile(column, np.linspace(0, 1, knots)))
    if len(at) < 2:
        return np.ones((len(column), 1))
    place = np.clip(np.searchsorted(at, column, side="right") - 1, 0, len(at) - 2)
    share_right = (column - at[place]) / (at[place + 1] - at[place])
    out = np.zeros((len(column), len(at)))
    rows = np.arange(len(column))
    out[rows, place] = 1 - share_right
    out[rows, place + 1] = share_right
    return out


def _shape(residual: Array, column: Array) -> str:
    """Odd or even about zero, in a word."""
    mirrored: NDArray[np.bool_] = column < 0
    if not 0.2 < mirrored.mean() < 0.8:
        return "a smooth function"
    odd = abs(float(residual[~mirrored].mean() - residual[mirrored].mean()))
    even = abs(float(residual.mean()))
    return "mostly odd: changes sign with the axis" if odd > 2 * even else "a smooth function"
