"""From the predicted twist of a gear with laws to rows of the regression that all other models use.

Measured minus predicted twist, times the stiffness, has the unit and, for slow motion, the columns of the balance of
torques: twist for the stiffness, its rate for the damping, a sign for the friction.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from edge_daemon.integrator.laws import LOADED
from edge_daemon.motion.excitation import SensorNoise
from edge_daemon.motion.kinematics import FirSet
from edge_daemon.motion.law_simulation import AFTER, LawGear, LawSimulation, Predicted
from edge_daemon.motion.motor_angle import MotorAngle
from edge_daemon.motion.noise_level import ColumnNoise
from edge_daemon.motion.regressors import (
    DAMPING,
    STIFFNESS,
    AmplitudeKey,
    Equation,
    Linearisation,
    Regressors,
    TorqueNoise,
)
from edge_daemon.motion.streaming import Stretch
from edge_daemon.motion.whitening import TRANSFORM, Whitening
from edge_daemon.records import Array
from edge_daemon.track.prior import laws_in

LIGHTEST = 0.01
"""Damping ratio that a prediction has at least: an estimate that strays must not make it ring for ever, and a gear of
2 % with a large load must not be predicted with more than it has, or its damping comes out many sd too low."""
SHAPE_STEP = 1e-4
"""Elements are differenced over this share of a shape: small beside what bends them, large beside rounding."""
FARTHEST = 5.0
"""Times the stiffness known before, or its reciprocal, beyond which an estimate has gone astray."""


class LawPrediction:
    """Measures each stretch against the predicted twist."""

    def __init__(self, regressors: Regressors, fir: FirSet) -> None:
        self._regressors, self._rate_hz = regressors, fir.rate_hz
        self._motor = MotorAngle(fir)
        self._twist, self._whitening = LawSimulation(regressors.model.ratio), Whitening()
        self._expected, self._around = (math.nan, math.nan, False), Linearisation()
        self._behind = LawsBehind(self._motor.delay + AFTER - self._motor.lag)
        self.balanced: tuple[Stretch, Array | None] | None = None
        """the newest stretch whose laws' torque behind the balance filter is known, and that torque (n,)"""

    def forget(self) -> None:
        """Start from the measured twist with the next samples."""
        self._motor.forget()
        self._twist.forget()
        self._behind.forget()
        self._whitening.forget()

    def remembered(self, stretch: Stretch) -> tuple[float, float]:
        """What the first law remembers, and when [s], as known with the newest stretch."""
        assert stretch.arguments is not None
        late = self._motor.delay + AFTER - 1 - self._motor.lag
        time_s = float(stretch.arguments.motion.time_s[-1]) - late / self._rate_hz
        return float(self._twist.remembered[0]), time_s

    def equation(self, stretch: Stretch, value: Array, point: Linearisation, noise: SensorNoise) -> Equation:
        """Rows linear around the amplitudes `value` (k,), or the nearest that can be simulated."""
        usable, model = stretch.valid, self._regressors.model
        if not usable.all():
            self.forget()
        value = within_reason(value, point, self._regressors)
        gear = gear_of(value, point, self._regressors)
        motor = self._motor.follow(stretch.unfiltered, noise.motor_rad2, bool(stretch.valid.all()))
        seen = None
        if motor is not None:
            if self._motor.is_calm:
                motor[:, 3] -= motor[:, 4] / model.ratio  # noise that the prediction does not hold either
            seen = self._twist.predict(motor[:, :4], self._rate_hz, gear)
        self._expect(noise, gear, point)
        self.balanced = self._behind.follow(stretch, seen.laws_Nm if seen is not None else np.empty(0))
        k = len(value)
        white = TorqueNoise(ColumnNoise(np.zeros((k, k)), np.zeros(k)), gear.stiffness**2 * self._whitening.white_rad2)
        if seen is None or not seen.settled:
            return Equation(stretch.motion, np.zeros((0, k)), np.zeros(0), np.zeros(0, dtype=bool), usable, white)
        columns, torque = self._whitening.rows(*rows_of(seen, gear, value, point, self._regressors))
        return Equation(stretch.motion, columns, torque, np.isfinite(torque), usable, white)

    def _expect(self, noise: SensorNoise, gear: LawGear, point: Linearisation) -> None:
        """The encoders' noise in the rows. What a calm motor's filter leaves of its encoder's passes
        spring and damper, the output encoder's stands as it is."""
        known = noise.motor_rad2, noise.out_rad2, self._motor.is_calm
        if known == self._expected and point is self._around:
            return
        self._expected, self._around = known, point
        motor_rad2, still = noise.motor_rad2 / self._regressors.model.ratio**2, np.zeros(TRANSFORM // 2 + 1)
        if not self._motor.is_calm:
            self._whitening.expect(noise.out_rad2 + motor_rad2, still)
            return
        s = 2j * math.pi * np.fft.rfftfreq(TRANSFORM, 1 / self._rate_hz)
        spring = gear.stiffness + s * gear.damping
        answer = np.abs(spring / (spring + gear.inertia * s**2)) ** 2
        self._whitening.expect(noise.out_rad2, motor_rad2 * answer * self._motor.left(TRANSFORM))


class LawsBehind:
    """Torque of the laws behind the balance filter, for stretches that wait until it is known."""

    def __init__(self, late: int) -> None:
        """`late`: samples by which that torque comes after the lightly filtered motion."""
        self._late = late
        self._waiting: deque[tuple[Stretch, int]] = deque()
        self._fresh = False
        self.forget()

    def forget(self) -> None:
        """The next samples do not follow the last ones."""
        self._fresh = self._fresh or any(stretch.fresh for stretch, _ in self._waiting)
        self._waiting.clear()
        self._torque = np.empty(0)
        self._came = 0

    def follow(self, stretch: Stretch, laws_Nm: Array) -> tuple[Stretch, Array] | None:
        """Take a stretch in, and the torque (m,) that was found next; a stretch whose torque is known now."""
        assert stretch.arguments is not None
        self._came += stretch.unfiltered.shape[1]
        self._torque = np.append(self._torque, laws_Nm)
        self._waiting.append((stretch, self._came))
        head, end = self._waiting[0]
        assert head.arguments is not None
        balance, beyond = head.arguments.balance, self._came - self._late - end
        reach = balance.samples
        if beyond < 0:
            return None
        self._waiting.popleft()
        inside = self._torque[: len(self._torque) - beyond][-reach:]
        if len(inside) < reach:
            self._fresh = self._fresh or head.fresh
            return None
        self._torque = self._torque[-(reach + beyond) :]
        head = replace(head, fresh=True) if self._fresh else head
        self._fresh = False
        return head, balance(inside)


def can_be_simulated(regressors: Regressors, torque_measured: bool) -> bool:
    """Whether the twist of this model can be simulated here: spring, damper and laws, driven by the motor."""
    laws, keys = laws_in(regressors), regressors.keys
    if regressors.model.balance != "torsion" or torque_measured or not laws or not {STIFFNESS, DAMPING} <= {*keys}:
        return False
    return all(effect.in_loop is not None for effect, _, _ in laws) and not _is_loaded(regressors)


def _is_loaded(regressors: Regressors) -> bool:
    """Whether a law asks for the transmitted torque, which no block knows in time."""
    return LOADED in _elements(np.ones(len(regressors.keys)), regressors)[:, 0].tolist()


def is_credible(value: Array, point: Linearisation, regressors: Regressors) -> bool:
    """Whether a gear of these amplitudes (k,) may be simulated."""
    share = float(value[_column(regressors, STIFFNESS)]) / point.stiffness
    return 1 / FARTHEST < share < FARTHEST


def within_reason(value: Array, point: Linearisation, regressors: Regressors) -> Array:
    """(k,) the nearest amplitudes that can be simulated. Rows must be linear around what was simulated: around a
    damping that the simulation did not have they would blame it on the gear."""
    stiffness, damping = (_column(regressors, key) for key in (STIFFNESS, DAMPING))
    bounded = value.copy()
    bounded[stiffness] = max(bounded[stiffness], point.stiffness / FARTHEST)
    inertia = regressors.model.output_inertia_kg_m2
    bounded[damping] = max(bounded[damping], 2 * LIGHTEST * math.sqrt(bounded[stiffness] * inertia))
    for effect, _, place in laws_in(regressors):
        bounds = [(row.lower, row.upper) for row in effect.amplitudes]
        bounded[place] = np.clip(bounded[place], *np.transpose(bounds))
    for i, (name, shape) in enumerate(regressors.free, regressors.shaping.start):
        held = regressors.shape(name, shape.name)
        bounded[i] = min(max(bounded[i], math.log(shape.lower / held)), math.log(shape.upper / held))
    return bounded


def gear_of(value: Array, point: Linearisation, regressors: Regressors) -> LawGear:
    """What the amplitudes (k,) say of the gear."""
    stiffness, offset = float(value[_column(regressors, STIFFNESS)]), regressors.offset
    elements, changes = laws_of(value, regressors)
    return LawGear(
        inertia=regressors.model.output_inertia_kg_m2,
        stiffness=stiffness,
        damping=float(value[_column(regressors, DAMPING)]),
        elements=elements,
        changes=changes,
        error_rad=point.whole_error(stiffness, value[regressors.kinematic]),
        zero_rad=float(value[offset]) / stiffness if offset is not None else 0.0,
    )


def laws_of(value: Array, regressors: Regressors) -> tuple[Array, Array]:
    """(e, 5) elements of all laws at the amplitudes (k,), and (a, e, 4) what each of the laws' amplitudes and shapes
    changes."""
    places = places_of_laws(regressors)
    elements = _elements(value, regressors)
    changes = np.empty((len(places), len(elements), 4))
    for row, i in enumerate(places):
        moved, step = value.copy(), SHAPE_STEP if i >= regressors.shaping.start else 1.0
        moved[i] += step
        changes[row] = (_elements(moved, regressors) - elements)[:, 1:] / step
    return elements, changes


def places_of_laws(regressors: Regressors) -> list[int]:
    """Columns of what makes up the laws: their amplitudes, and their shapes."""
    amplitudes = [i for _, _, place in laws_in(regressors) for i in range(place.start, place.stop)]
    return [*amplitudes, *range(regressors.shaping.start, regressors.shaping.stop)]


def _elements(value: Array, regressors: Regressors) -> Array:
    factors = zip(regressors.free, np.exp(value[regressors.shaping]).tolist(), strict=True)
    factor = {(effect, row.name): times for (effect, row), times in factors}
    laws = []
    for effect, held, place in laws_in(regressors):
        shape = {name: found * factor.get((effect.name, name), 1.0) for name, found in held.items()}
        if effect.in_loop:
            laws.append(effect.in_loop(shape, value[place].tolist()))
    return np.array([element for law in laws for element in law], dtype=float).reshape(-1, 5)


def rows_of(
    seen: Predicted, gear: LawGear, value: Array, point: Linearisation, regressors: Regressors
) -> tuple[Array, Array]:
    """(n, k) columns and (n,) torque: columns @ amplitudes = torque, linear around `value` (k,)."""
    by_waves = seen.by_error / gear.stiffness
    columns = np.zeros((len(by_waves), len(value)))
    place, zero, stiffness = regressors.kinematic, regressors.offset, _column(regressors, STIFFNESS)
    waves = value[place] - point.stiffness * point.error_rad
    columns[:, place] = by_waves
    columns[:, [stiffness, _column(regressors, DAMPING)]] = seen.by_spring
    columns[:, stiffness] -= by_waves @ waves / gear.stiffness
    columns[:, places_of_laws(regressors)] = seen.by_laws
    if zero is not None:
        columns[:, zero] = -1 / gear.stiffness
        columns[:, stiffness] += gear.zero_rad / gear.stiffness
    columns *= -gear.stiffness
    return columns, columns @ value - gear.stiffness * (seen.seen_rad - seen.twist_rad)


def _column(regressors: Regressors, key: AmplitudeKey) -> int:
    i = regressors.index(*key)
    assert i is not None
    return i
