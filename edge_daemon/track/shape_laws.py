"""What a window of motion says about the shape of a law: rows as predicted at every sigma point.

Friction that turns round is predicted in the loop: a measured rate is too coarse to tell when. The twist of a whole
gear is simulated from the motor angle, and stands against the measured one. What remembers the twist, or follows it
without a jump, is predicted on the measured twist, by the columns of the catalogue, in the balance of torques.

Points hold logarithms, of the shape in the first place; kinematic errors in units of `ERROR_RAD`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from edge_daemon.effects.catalogue import of_balance, shape_of
from edge_daemon.effects.effect import Effect, Parameter
from edge_daemon.effects.model import Model
from edge_daemon.integrator import twist
from edge_daemon.motion.law_simulation import AFTER, BEFORE, held, middles
from edge_daemon.motion.regressors import DAMPING, KINEMATIC, STIFFNESS, still
from edge_daemon.motion.window import LEAD, Window
from edge_daemon.records import Array, Motion
from edge_daemon.track.shape_filter import ShapeFilter
from edge_daemon.track.tracking import BalanceTracker

ERROR_RAD = 1e-4
"""Unit of the kinematic error's sine and cosine in a point."""
SHARES_OF_RATE = (0.4, 1.0, 2.0)
"""A search for a Stribeck speed starts at these shares of the rms twist rate where the model does not know one."""
SHARES_OF_TWIST = (0.25, 1.0)
"""Searches for widths and gaps start at these shares of the rms twist."""
SHAPE_SD, FITTED_SD = 0.5, 0.2
"""The logarithm of a shape is in this doubt at such a start, and in the second at one that the model file knows."""
AMPLITUDE_SD, DAMPING_SD, STIFFNESS_SD, ERROR_SHARE_SD = 0.5, 0.7, 0.02, 0.02
"""What goes with it is in this doubt, the kinematic error as a share of itself (guess: where the law is wrong yet, the
balance of torques errs by as much)."""
SHAPE_DRIFT, OTHER_DRIFT, STEADY_DRIFT = 1e-3, 1e-3, 1e-5
"""Random walk after one second, of logarithms: a shape may move by 6 % in an hour as temperature and wear do (guess),
with it friction and damping; stiffness and kinematic error hardly."""
LEAST_SHARE = 0.05
"""A search gives a law at least this share of the torque to begin with."""
REGION = 2.5
"""A shape may be at most so many times the rms rate or twist to be told: farther out the law is one straight line."""
LEAST_EXCESS, LEAST_TORQUE = 0.15, 0.03
"""An excess must be this share of the Coulomb level and of the torque's rms: less is feigned by a sign of another width
(measured: gears without any show up to 0.13 and 0.03)."""
STEPS = 3
"""Steps per sample of a simulated window, which are never split: a shape that is known to two per cent asks for less
than the amplitudes do. With two steps a Stribeck speed of gears with a narrow sign is wrong by three deviations."""
LIGHTEST = 0.01
"""Damping ratio that a simulated gear has at least."""
LARGEST, SMALLEST = 30.0, 1e-9
"""No gear has a larger logarithm, or a smaller shape to start from."""
RUN_IN_S = 0.5
"""A law that remembers forgets how it began in so much of a window: some widths of path in any lively motion."""
RIDE_ERRS, PATH_ERRS, BLUNT_ERRS = 0.02, 0.02, 0.2
"""Errors of a simulated gear, of a measured path, and of one that had to be smoothed, where its cut-off is the
resonance (measured on gears of 2e4 to 1e5 N m/rad)."""
HELD_ERRS = 0.1
"""Error of a hysteresis whose rounding is another than the model's, and is held: 0.5 for 0.6 moves the width by a
tenth."""
ROUGH = 0.2
"""The path must be smoothed where the light filter takes more than this out of the twist, over the twist's steps from
sample to sample: noise is path too, and would wear a hysteresis off."""
LIGHT = 0.1
"""A search begins at no less damping over sqrt(stiffness * inertia)."""


class Rows(NamedTuple):
    """What one window says; the unit is that of a torque."""

    seen: Array
    """(m,)"""
    predicted: Array
    """(m, s) at s points"""
    nuisance: Array
    """(m, q) columns nobody asks about"""
    bandwidth: float
    """share of the rows that are independent"""


@dataclass(frozen=True, slots=True)
class Tracked:
    """A shape that is tracked live."""

    effect: Effect
    shape: Parameter


class Law(Protocol):
    """How the windows of one drive are predicted."""

    errs: float
    """what the prediction itself errs by, as an sd of the shape's logarithm: it does not average out"""
    spread: float
    """rms that the doubt of the shape makes of the law's columns; NaN where a law has no state"""

    def excited(self, point: Array) -> bool:
        """Whether the newest window passed through where the law bends, and the law is there at all."""

    def starts(self, window: Window, tracker: BalanceTracker) -> list[ShapeFilter]:
        """Filters to begin with, of which the best will stay."""

    def rows(self, window: Window, points: Array, tracker: BalanceTracker) -> Rows:
        """The window at (s, n) points."""


class FrictionLaw:
    """A Stribeck speed, with the whole gear in the loop. A point: logarithms of Stribeck speed, Coulomb level, excess,
    stiffness, damping and the sign's width, then the kinematic error."""

    def __init__(self, model: Model, tracked: Tracked) -> None:
        self.errs, self.spread = RIDE_ERRS, math.nan
        self._inertia = model.output_inertia_kg_m2
        self._effect, self._shape = tracked.effect, shape_of(model, tracked.effect)
        self._bounds = tracked.shape.lower, tracked.shape.upper
        self._known = model.value(tracked.effect.name, tracked.shape.name)
        self._keys = [(tracked.effect.name, row.name) for row in tracked.effect.amplitudes]
        self._rate_rms = self._torque_rms = 0.0

    def starts(self, window: Window, tracker: BalanceTracker) -> list[ShapeFilter]:
        """One for each speed to start from; half of the friction found so far is excess."""
        stiffness, damping = _value(tracker, STIFFNESS), _value(tracker, DAMPING)
        together = sum(_value(tracker, key) for key in self._keys)
        torque = self._inertia * float(np.std(window.acceleration_out_rad_s2))
        half = max(together, LEAST_SHARE * torque) / 2
        damping = max(damping, LIGHT * math.sqrt(stiffness * self._inertia))
        error = tracker.error_rad / ERROR_RAD
        felt = window.twist_rate_rad_s + window.wave_rates @ tracker.error_rad
        speeds, speed_sd = _starts(self._known, SHARES_OF_RATE, _rms(felt))
        sd = [speed_sd, AMPLITUDE_SD, AMPLITUDE_SD, STIFFNESS_SD, DAMPING_SD, SHAPE_SD]
        of_error = np.full(len(error), max(ERROR_SHARE_SD * float(np.linalg.norm(error)), ERROR_SHARE_SD))
        drift = [
            SHAPE_DRIFT,
            OTHER_DRIFT,
            OTHER_DRIFT,
            STEADY_DRIFT,
            OTHER_DRIFT,
            OTHER_DRIFT,
            *[STEADY_DRIFT] * len(error),
        ]
        return [
            ShapeFilter(
                np.array([*np.log([speed, half, half, stiffness, damping, self._shape["smoothing"]]), *error]),
                np.array([*sd, *of_error]),
                np.array(drift),
            )
            for speed in speeds
        ]

    def excited(self, point: Array) -> bool:
        """Friction must fall within the speeds that there were, by more than the sign's own width could feign."""
        speed, friction, excess, smoothing = np.exp(point[[0, 1, 2, 5]])
        bends = smoothing < speed < REGION * self._rate_rms
        return bool(bends and excess > max(LEAST_EXCESS * friction, LEAST_TORQUE * self._torque_rms))

    def rows(self, window: Window, points: Array, tracker: BalanceTracker) -> Rows:
        """Measured and simulated twist, times the stiffness, at every sample of the pieces that can be simulated."""
        first, error = int(window.starts[0]), points[:, 6:] * ERROR_RAD
        driven = self._inertia * _driven(window, first)
        self._torque_rms = self._inertia * _rms(window.acceleration_out_rad_s2)
        self._rate_rms = _rms(window.twist_rate_rad_s + window.wave_rates @ error[0])
        at = slice(first + BEFORE, len(window.twist_rad) - AFTER + 1)
        shown = np.empty((at.stop - at.start - LEAD, len(points)))
        laws = _positive(points[:, :6], self._bounds)
        for i, law in enumerate(laws):
            push = driven[:, 0] + driven[:, 1:] @ error[i]
            felt = window.twist_rad + window.waves @ error[i]
            felt += self._inertia * window.acceleration_out_rad_s2.mean() / law[3] - felt.mean()
            rate = float(window.twist_rate_rad_s[at.start] + window.wave_rates[at.start] @ error[i])
            felt_rad = self._simulated(law, push, float(felt[at.start]), rate, window.rate_hz)
            shown[:, i] = felt_rad[LEAD - 1 :] - window.waves[at][LEAD:] @ error[i]
        seen = window.seen_rad[at][LEAD:] * laws[0, 3]
        return Rows(seen, shown * laws[0, 3], np.ones((len(seen), 1)), 1.0)

    def _simulated(self, law: Array, push: Array, twist_rad: float, rate: float, rate_hz: float) -> Array:
        """(n,) twist at the samples after the first, of a gear of these numbers, driven by (n * STEPS,) torques."""
        speed, friction, excess, stiffness, damping, smoothing = law.tolist()
        assert self._effect.in_loop is not None
        shape = self._shape | {"stribeck_speed": speed, "smoothing": smoothing}
        elements = np.array(self._effect.in_loop(shape, (friction, excess)))
        damping = max(damping, 2 * LIGHTEST * math.sqrt(stiffness * self._inertia))
        gear = twist.TorsionGear(self._inertia, stiffness, damping, elements)
        still = np.zeros(len(push))
        forcing = twist.Forcing(push, still, still, 0.0, 1 / (rate_hz * STEPS), STEPS, 1)
        start = twist.at_rest(twist_rad, rate, len(elements), 0)
        return twist.simulate(gear, forcing, twist.nothing(elements), start).ends


def _driven(window: Window, first: int) -> Array:
    """(m, 1 + 2 * len(ORDERS)) acceleration of the motor, seen from the output, and of the waves: mean of each step
    from the sample `first` + BEFORE on."""
    return held(middles(np.column_stack((window.driven_rad_s2, window.wave_lifts))[first:], STEPS), STEPS)


class PathLaw:
    """A width or a gap, on the measured twist. A point: logarithm of the shape, then those of the law's amplitudes."""

    def __init__(self, model: Model, tracked: Tracked) -> None:
        self._errs = PATH_ERRS + HELD_ERRS * (len(tracked.effect.free_shapes) > 1)
        self.errs, self.spread = self._errs, math.nan
        self._inertia = model.output_inertia_kg_m2
        self._name, self._effect = tracked.shape.name, tracked.effect
        self._shape = shape_of(model, self._effect)
        self._known = model.value(self._effect.name, self._name)
        self._bounds = tracked.shape.lower, tracked.shape.upper
        self._twist_rms = 0.0
        self._keys = [(self._effect.name, row.name) for row in self._effect.amplitudes]

    def starts(self, window: Window, tracker: BalanceTracker) -> list[ShapeFilter]:
        """One for each value to start from; amplitudes as found so far."""
        torque = np.concatenate([row.motion.torque_Nm for row in window.stretches])
        felt = self._felt(window, tracker, torque)
        values, shape_sd = _starts(self._known, SHARES_OF_TWIST, float(felt.std()))
        least = [
            LEAST_SHARE * float(torque.std()) if row.unit == "N m" else row.lower for row in self._effect.amplitudes
        ]
        amplitudes = [max(_value(tracker, key), low) for key, low in zip(self._keys, least, strict=True)]
        k = len(amplitudes)
        sd, drift = np.array([shape_sd, *[AMPLITUDE_SD] * k]), np.array([SHAPE_DRIFT, *[OTHER_DRIFT] * k])
        return [ShapeFilter(np.log([value, *amplitudes]), sd, drift) for value in values]

    def excited(self, point: Array) -> bool:
        """The twist must go as far as the law does."""
        return bool(math.exp(point[0]) < REGION * self._twist_rms)

    def rows(self, window: Window, points: Array, tracker: BalanceTracker) -> Rows:
        """The balance of torques behind its filter, from where the law has forgotten how it began."""
        torque = np.concatenate([row.motion.torque_Nm for row in window.stretches])
        felt = self._felt(window, tracker, torque)
        motion = replace(still(len(felt), window.ratio), twist_rad=felt)
        points = _positive(points, self._bounds)
        columns = {value: self._columns(motion, value, tracker) for value in set(points[:, 0].tolist())}
        middle = columns[float(points[0, 0])]
        self.spread = math.sqrt(max(float(np.mean((other - middle) ** 2)) for other in columns.values()))
        seen, predicted, nuisance = [], [], []
        last = len(felt) - len(_taps(window)) // 2
        for end, row in zip(window.ends.tolist(), window.stretches, strict=True):
            assert row.arguments is not None
            balance = row.arguments.balance
            if end - balance.samples < RUN_IN_S * window.rate_hz or end > last:
                continue
            at = slice(end - balance.samples, end)
            laws = {value: balance(column[at]) for value, column in columns.items()}
            predicted.append(np.stack([laws[point[0]] @ point[1:] for point in points], axis=1))
            linear = (np.ones(len(row.motion)), row.motion.twist_rad, row.motion.twist_rate_rad_s)
            nuisance.append(np.column_stack((*linear, row.kinematic, row.kinematic_rate)))
            seen.append(row.motion.torque_Nm)
        bandwidth = float(balance.taps @ balance.taps) * window.rate_hz / row.motion.rate_hz
        return Rows(np.concatenate(seen), np.concatenate(predicted), np.concatenate(nuisance), min(bandwidth, 1.0))

    def _columns(self, motion: Motion, value: float, tracker: BalanceTracker) -> Array:
        shape = self._shape | {self._name: value}
        shape |= {name: _value(tracker, source) for name, source in self._effect.tied.items()}
        return self._effect.columns(motion, shape, None)[0]

    def _felt(self, window: Window, tracker: BalanceTracker, torque: Array) -> Array:
        """(n,) twist [rad], kinematic error put right; its mean is what the mean torque makes of the spring."""
        stiffness = _value(tracker, STIFFNESS)
        felt = window.twist_rad + window.waves @ tracker.error_rad
        self.errs, self._twist_rms = self._errs, float(felt.std())
        if float(np.std(window.seen_rad - window.twist_rad)) > ROUGH * float(np.std(np.diff(felt))):
            taps = _taps(window)
            felt = np.convolve(felt, taps, "same")
            resonance_rad2_s2 = stiffness / self._inertia if math.isfinite(self._inertia) else math.inf
            cutoff_rad_s = math.pi * window.rate_hz * float(taps @ taps)
            self.errs += BLUNT_ERRS * cutoff_rad_s**2 / resonance_rad2_s2
        return np.asarray(felt - felt.mean() + float(torque.mean()) / stiffness)


def _taps(window: Window) -> Array:
    """The balance filter's, oldest sample first."""
    assert window.stretches[0].arguments is not None
    return window.stretches[0].arguments.balance.taps


def _positive(points: Array, bounds: tuple[float, float]) -> Array:
    """What points of logarithms mean, the first one within its bounds."""
    values = np.exp(np.clip(points, -LARGEST, LARGEST))
    values[:, 0] = np.clip(values[:, 0], *bounds)
    return np.asarray(values)


def _rms(values: Array) -> float:
    return math.sqrt(float(values @ values) / len(values))


def _value(tracker: BalanceTracker, key: tuple[str, str]) -> float:
    found = tracker.amplitude(key)
    return found[0] if found is not None else 0.0


def _starts(known: float, shares: Sequence[float], size: float) -> tuple[list[float], float]:
    """Values of a shape to start from, and the sd of their logarithm."""
    if math.isfinite(known) and known > 0:
        return [known], FITTED_SD
    return [max(share * size, SMALLEST) for share in shares], SHAPE_SD


def law_of(model: Model, torque_measured: bool) -> tuple[Tracked, Law] | None:
    """The shape to track in a model and how it is predicted; None where there is none, or other effects are beside it
    that a simulation here does not carry."""
    names = {effect.name for effect in model.effects}
    if model.balance != "torsion" or not {STIFFNESS[0], DAMPING[0]} <= names:
        return None
    beside = {row.name for row in of_balance("torsion") if _stands_beside(row)}
    others = [row for row in of_balance("torsion") if row.name in names - beside]
    shapes = [shape for row in others for shape in row.shapes if shape.quantity]
    if len(names - beside) != 1 or not shapes:
        return None
    tracked = Tracked(others[0], shapes[0])
    if shapes[0].scale != "twist_rate_rad_s":
        return tracked, PathLaw(model, tracked)
    return (tracked, FrictionLaw(model, tracked)) if not torque_measured else None


def _stands_beside(effect: Effect) -> bool:
    """Whether the simulations here carry it beside a law: twist, twist rate, a constant and the kinematic error."""
    linear = effect.follows in ("twist_rad", "twist_rate_rad_s")
    return linear or effect.steady == "exactly" or effect.name == KINEMATIC
