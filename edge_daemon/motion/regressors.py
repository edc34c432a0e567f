"""From a model and a stretch of motion to columns of a regression, and how much sensor noise stands in them.

Beside the model's own columns stand those that no stiffness estimate can do without: a constant (the encoders' zeros
are unknown) and the kinematic error, sine and cosine of the motor angle's orders through the same filter as the
twist. Their amplitudes are torques [N m].
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge_daemon.effects.catalogue import shape_of
from edge_daemon.effects.effect import Balance, Effect, EffectState, Filters, Parameter
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.effects.resolve import resolve
from edge_daemon.effects.waves import of_input
from edge_daemon.motion.gear_load import GearLoad
from edge_daemon.motion.kinematics import FirSet
from edge_daemon.motion.noise_level import ColumnNoise
from edge_daemon.motion.streaming import ORDERS, Stretch
from edge_daemon.records import Array, Mask, Motion

KINEMATIC = "kinematic_error"
OFFSET = "offset"
PROBE_DEGC = 40.0
"""A usual temperature of a housing; what is linear in it is known at any other."""
PROBE_SAMPLES = 16
PROBE_SEED = 1
LINEAR_TOLERANCE = 1e-6
"""A column counts as linear in a signal when its response to a probe is this even over samples."""
TRANSFORM = 1024
"""Samples over which noise through a filter is laid out."""
SIGNALS = ("twist_rad", "twist_rate_rad_s", "velocity_out_rad_s", "acceleration_out_rad_s2")

RETIED = 1e-2
"""Columns of an angle's error may differ by this share within the reach of a filter (guess)."""
PP_ANGLES = np.linspace(0.0, 2 * np.pi, 361)
"""The kinematic error's peak-to-peak value is taken over these motor angles."""
PP_WAVES = np.column_stack([wave(m * PP_ANGLES) for m in ORDERS for wave in (np.sin, np.cos)])


@dataclass(frozen=True, slots=True)
class EncoderNoise:
    """White noise of the angles per sample, sd [rad] at each encoder itself."""

    theta_in_rad: float
    theta_out_rad: float


AmplitudeKey = tuple[str, str]
"""Effect and amplitude."""


STIFFNESS: AmplitudeKey = ("linear_stiffness", "stiffness")
DAMPING: AmplitudeKey = ("viscous_damping", "damping")


@dataclass(frozen=True, slots=True)
class Linearisation:
    """What is known of the gear where the product of stiffness and kinematic error is made linear."""

    stiffness: float = 0.0
    damping_s: float = 0.0
    """damping over stiffness"""
    error_rad: Array = field(default_factory=lambda: np.zeros(2 * len(ORDERS)))
    """sine and cosine of each order of the kinematic error"""
    zero_rad: float = 0.0
    """twist that the encoders' zeros hide"""

    def whole_error(self, stiffness: float, waves_Nm: Array) -> Array:
        """Sine and cosine [rad] of the kinematic error e from stiffness and wave amplitudes of a regression around
        here. The waves hold K (e - e0) + K0 e0: an error of K hardly moves e."""
        return self.error_rad + (waves_Nm - self.stiffness * self.error_rad) / stiffness

    def dump(self) -> list[float]:
        """Plain data; `load` takes it back."""
        return [self.stiffness, self.damping_s, self.zero_rad, *self.error_rad.tolist()]

    @classmethod
    def load(cls, state: list[float]) -> Linearisation:
        """What `dump` gave. Raises ValueError when it is too short."""
        stiffness, damping_s, zero_rad, *error_rad = map(float, state)
        return cls(stiffness, damping_s, np.array(error_rad).reshape(2 * len(ORDERS)), zero_rad)


@dataclass(slots=True)
class _Moved:
    """A shape that is held, as it may just as well be."""

    effect: int
    """place in the model"""
    shape: Parameter
    sd: float
    """of the logarithm"""
    state: EffectState = None

    def moved(self, held: Mapping[str, float]) -> dict[str, float]:
        """The effect's shapes with this one off by its sd, to the side that physics allows."""
        value = held[self.shape.name]
        step = self.sd if value * math.exp(self.sd) <= self.shape.upper else -self.sd
        return {**held, self.shape.name: value * math.exp(step)}


class Regressors:
    """Columns of one model; remembers the states of effects with memory."""

    def __init__(self, model: Model, channels: tuple[str, ...] = ()) -> None:
        """`channels` are the drive's, for a user's own effects. Raises `ModelError` for an effect nobody knows."""
        self.model = model
        rows = [row for given in model.effects for row in _beside_followed(given, model.balance)]
        self._effects: tuple[Effect, ...] = tuple(resolve(row, model.balance, channels) for row in rows)
        needs = {need for effect in self._effects for need in effect.needs}
        self.extra = tuple(sorted(needs - set(Motion.__dataclass_fields__)))
        self._shapes = [shape_of(model, effect) for effect in self._effects]
        self._states: list[EffectState] = [None] * len(self._effects)
        own = [(effect.name, row.name) for effect in self._effects for row in effect.amplitudes]
        self._own = len(own)
        self.free = [
            (effect.name, row) for effect in self._effects for row in effect.free_shapes if effect.in_loop is not None
        ]
        """shapes that a simulation learns with the amplitudes: effect and parameter each"""
        free = [(effect, row.name) for effect, row in self.free]
        self._constant = all(effect.steady != "exactly" for effect in self._effects)
        self._waves = model.balance == "torsion"
        waves = [(KINEMATIC, f"{word}_{m}") for m in ORDERS for word in ("sine", "cosine")]
        self.keys: tuple[AmplitudeKey, ...] = (*own, *free, *[(OFFSET, OFFSET)] * self._constant, *waves * self._waves)
        self._columns = {key: i for i, key in reversed(list(enumerate(self.keys)))}
        ends = np.cumsum([0, *(len(effect.amplitudes) for effect in self._effects)])
        self._places = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self._moved: list[_Moved] = []
        self._by_moved: Array = np.empty((0, 0))
        """(n, c) columns of the newest equation with each held shape moved, one after the other"""
        self._past = np.empty((0, self._own))
        self.gear_load = GearLoad(self.rows if model.balance == "drive" else (), len(self.keys))
        self._sensitivity, warm = self._probe(PROBE_DEGC), self._probe(PROBE_DEGC + 1.0)
        self._per_kelvin = warm - self._sensitivity
        self.loads = self._following_output()
        """(m,) columns that follow the output angle, as what another ratio makes does"""
        self._light = [
            model.balance == "torsion" and not self._sensitivity[place].any(axis=1).all() for place in self._places
        ]

    def shape(self, effect: str, name: str) -> float:
        """A shape parameter as the columns take it now. Raises StopIteration for an effect that the model lacks."""
        return next(s for e, s in zip(self._effects, self._shapes, strict=True) if e.name == effect)[name]

    def reshape(self, effect: str, name: str, value: float) -> None:
        """Let a shape parameter be `value` from now on: columns of before do not mix with those to come. Raises
        StopIteration for an effect that the model lacks."""
        next(s for e, s in zip(self._effects, self._shapes, strict=True) if e.name == effect)[name] = value
        self._past = np.empty((0, self._width))

    def hold(self, doubt: Mapping[AmplitudeKey, float]) -> None:
        """Nobody learns these shapes: what the sd of the logarithm of each makes of the torque is to be carried along
        (`torque_of_doubt`)."""
        self._moved = [
            _Moved(i, row, doubt[effect.name, row.name])
            for i, effect in enumerate(self._effects)
            for row in effect.free_shapes
            if (effect.name, row.name) in doubt
        ]
        self._past = np.empty((0, self._width))

    @property
    def held(self) -> dict[AmplitudeKey, float]:
        """The shapes that are held, each with the sd of its logarithm."""
        return {(self._effects[row.effect].name, row.shape.name): row.sd for row in self._moved}

    def torque_of_doubt(self, columns: Array, value: Array) -> Array:
        """(n, s) torque that one sd of each held shape adds to the newest equation, of these (n, k) columns, at
        amplitudes (k,)."""
        torques = [
            (self._by_moved[:, there] - columns[:, here]) @ value[here]
            for row, there in self._moved_places
            for here in [self._places[row.effect]]
        ]
        return np.stack(torques, axis=1)

    @property
    def _moved_places(self) -> Iterator[tuple[_Moved, slice]]:
        """Each moved shape, and where its columns are beyond the model's own."""
        begin = 0
        for row in self._moved:
            end = begin + len(self._effects[row.effect].amplitudes)
            yield row, slice(begin, end)
            begin = end

    @property
    def _width(self) -> int:
        """Columns of the effects, and of those whose shapes are moved."""
        return self._own + sum(len(self._effects[row.effect].amplitudes) for row in self._moved)

    @property
    def rows(self) -> list[tuple[Effect, dict[str, float], slice]]:
        """Each effect with its shape as it is now, and where its columns are."""
        return list(zip(self._effects, self._shapes, self._places, strict=True))

    def state(self, effect: str) -> EffectState:
        """What an effect with memory carries now; None at the start. Raises StopIteration as `shape` does."""
        return next(s for e, s in zip(self._effects, self._states, strict=True) if e.name == effect)

    def index(self, effect: str, amplitude: str) -> int | None:
        """Which column, None when the model has no such amplitude."""
        return self._columns.get((effect, amplitude))

    def following(self, signals: Collection[str]) -> list[int]:
        """Places of the columns that are one of these fields of `Motion` themselves, in their order."""
        rows = zip(self._effects, self._places, strict=True)
        places = {effect.follows: place.start for effect, place in rows}
        return [places[signal] for signal in signals if signal in places]

    @property
    def kinematic(self) -> slice:
        """The columns of the kinematic error; empty in a drive balance."""
        return slice(len(self.keys) - 2 * len(ORDERS) * self._waves, len(self.keys))

    @property
    def offset(self) -> int | None:
        """The column of the constant; None when an effect of the model spans it."""
        return self._own + len(self.free) if self._constant else None

    def springs(self, twist_rad: Array) -> tuple[Array, list[int]]:
        """(n, m) columns of what depends on the twist alone, at (n,) twists [rad] at rest, and their places."""
        n = len(twist_rad)
        rest = replace(still(n, self.model.ratio, self.extra), twist_rad=twist_rad)
        rows = zip(self._effects, self._shapes, self._places, strict=True)
        chosen = [(effect, shape, place) for effect, shape, place in rows if effect.is_spring]
        parts = [effect.columns(rest, shape, None)[0] for effect, shape, _ in chosen]
        places = [i for _, _, place in chosen for i in range(place.start, place.stop)]
        return np.concatenate([np.empty((n, 0)), *parts], axis=1), places

    @property
    def shaping(self) -> slice:
        """The columns of the shapes, of which each counts as the logarithm of it over what `shape` says."""
        return slice(self._own, self._own + len(self.free))

    def forget_states(self) -> None:
        """Start effects with memory anew, after a gap."""
        self._states = [None] * len(self._effects)
        for row in self._moved:
            row.state = None
        self._past = np.empty((0, self._width))

    @property
    def curved(self) -> NDArray[np.bool_]:
        """(k,) which columns are not linear in the motion: worth nothing before the kinematic error is known. Waves of
        an angle alone are not among them."""
        curved = np.zeros(len(self.keys), dtype=bool)
        for effect, place, light in zip(self._effects, self._places, self._light, strict=True):
            curved[place] = light and not _is_of_angle(effect)
        return curved

    @property
    def wants_arguments(self) -> bool:
        """Whether any effect is not linear in the motion and must see it before the balance filter does."""
        return any(self._light)

    def tie(self, known: Mapping[AmplitudeKey, float]) -> Array | None:
        """Let shapes that are tied to another effect's amplitude take its newest estimate. (k,) what each amplitude is
        to be multiplied by so that its torque stays; None where nothing changes."""
        factors = np.ones(len(self.keys))
        for effect, shape, place in self.rows:
            before = shape.get("stiffness", 1.0)
            for name, source in effect.tied.items():
                value = known.get(source, math.nan)
                if math.isfinite(value):
                    shape[name] = value
            if effect.is_angle_error:
                factors[place] = before / shape["stiffness"]
        far = np.abs(factors - 1.0).max()
        if far > RETIED:  # columns of before are of another size
            self._past = np.empty((0, self._width))
        return factors if far > 0 else None

    def equation(self, stretch: Stretch, point: Linearisation) -> tuple[Array, Array]:
        """(n, k) columns and (n,) torque of the regression, linear around `point`.

        The gear feels the twist plus the kinematic error e, K (phi + e) + B (dphi + de) and whatever friction makes
        of it. The error known so far is added to the twist, and the columns of its waves carry what is still wrong
        with it; the torque is shifted so that their amplitudes come near K times the whole error (`whole_error`).
        """
        motion, torque = stretch.motion, stretch.motion.torque_Nm
        waves = stretch.kinematic + point.damping_s * stretch.kinematic_rate if self._waves else None
        if waves is not None and point.error_rad.any():
            motion = _felt(motion, stretch.kinematic, stretch.kinematic_rate, point.error_rad)
            torque = torque + waves @ (point.error_rad * point.stiffness)
        columns, motion = np.ones((len(motion), len(self.keys))), self.gear_load.on(motion)
        found, motion = self._model_columns(stretch, motion, point)
        columns[:, : self._own], self._by_moved = found[:, : self._own], found[:, self._own :]
        columns, passed = self.gear_load.followed(columns, motion)
        columns[:, self.shaping] = 0.0  # a measured twist is too coarse to tell them
        if waves is not None:
            columns[:, self.kinematic] = waves
        return columns, torque + passed

    def load_columns(self, columns: Array) -> Array:
        """(n, m) those of `loads`, each of one size for good: an angle's own without the stiffness known today."""
        sizes = np.ones(self._own)
        for effect, shape, place in self.rows:
            sizes[place] = shape["stiffness"] if effect.is_angle_error else 1.0
        chosen: Array = columns[:, self.loads] / sizes[self.loads]
        return chosen

    def rebasing(self, before: Linearisation, after: Linearisation) -> tuple[Array, Array]:
        """(k, k) and (k,): mix @ amplitudes + offset are the amplitudes around `after` of those around `before`."""
        k, place = len(self.keys), self.kinematic
        mix, offset = np.eye(k), np.zeros(k)
        mix[place, self.index("linear_stiffness", "stiffness")] = before.error_rad - after.error_rad
        offset[place] = after.stiffness * after.error_rad - before.stiffness * before.error_rad
        return mix, offset

    def _model_columns(self, stretch: Stretch, motion: Motion, point: Linearisation) -> tuple[Array, Motion]:
        """Linear effects on the motion behind the balance filter; the others on what came before it, then filtered. And
        the motion with what they tell of it."""
        columns = np.empty((len(motion), self._width))
        motion = self._evaluate(columns, motion, stretch.motion, False)
        light = stretch.arguments
        if light is not None:
            felt = _felt(light.motion, light.kinematic, light.kinematic_rate, point.error_rad, point.zero_rad)
            new = np.zeros((len(felt), self._width))
            self._evaluate(new, felt, light.motion, True)
            rows = light.balance.samples
            lacking = np.full((max(rows - len(self._past) - len(new), 0), self._width), math.nan)
            joined = np.concatenate((lacking, self._past, new))[-rows:]
            self._past = joined[light.fresh :]
            moved = [slice(self._own + at.start, self._own + at.stop) for at in self._moved_of(True)]
            for place in (*self._argued, *moved):
                columns[:, place] = light.balance(joined[:, place])
        return columns, motion

    @property
    def _argued(self) -> list[slice]:
        return [place for place, light in zip(self._places, self._light, strict=True) if light]

    def _evaluate(self, columns: Array, felt: Motion, measured: Motion, light: bool) -> Motion:
        """Fill in the columns of the effects that see the light motion, or of those that do not: as the gear feels it,
        or as the angles were measured where an effect follows them alone. The motion with how far friction has built
        up, which what rubs is the last to see."""
        for rubs in (False, True):
            for i, effect in enumerate(self._effects):
                if self._light[i] is light and effect.rubs is rubs:
                    motion = measured if _is_of_angle(effect) else felt
                    shape, place = self._shapes[i], self._places[i]
                    columns[:, place], self._states[i] = effect.columns(motion, shape, self._states[i])
            felt = felt if rubs else self.gear_load.rubbing(columns, felt)
        for row, at in self._moved_places:
            if self._light[row.effect] is light:
                shape = row.moved(self._shapes[row.effect])
                moved, row.state = self._effects[row.effect].columns(felt, shape, row.state)
                columns[:, self._own + at.start : self._own + at.stop] = moved
        return felt

    def _moved_of(self, light: bool) -> list[slice]:
        return [at for row, at in self._moved_places if self._light[row.effect] is light]

    def _own_columns(self, motion: Motion) -> Array:
        parts = [np.empty((len(motion), 0))]
        parts += [e.columns(motion, shape, None)[0] for e, shape in zip(self._effects, self._shapes, strict=True)]
        return np.concatenate(parts, axis=1)

    def _probe(self, temperature_degC: float) -> Array:
        """(own columns, 4) response of each column to each signal where it is exactly linear, else 0.

        Noise reaches a linear column in a known amount; what it does to a sign or a hysteresis is not compensated.
        """
        rng = np.random.default_rng(PROBE_SEED)
        base = _probe_motion(rng, self.model.ratio, self.extra, temperature_degC)
        response = np.zeros((self._own, len(SIGNALS)))
        here = self._own_columns(base)
        for j, signal in enumerate(SIGNALS):
            steps = rng.normal(size=(2, PROBE_SAMPLES)) * np.array([[1e-5], [0.1]])
            slopes = []
            for step in steps:
                moved = replace(base, **{signal: getattr(base, signal) + step})
                slopes.append((self._own_columns(moved) - here) / step[:, None])
            joined = np.concatenate(slopes)
            middle = joined.mean(axis=0)
            even = np.ptp(joined, axis=0) <= LINEAR_TOLERANCE * np.maximum(np.abs(middle), 1e-12)
            response[:, j] = np.where(even, middle, 0.0)
        return response

    def _following_output(self) -> NDArray[np.intp]:
        base = _probe_motion(np.random.default_rng(PROBE_SEED), self.model.ratio, self.extra)
        moved = replace(base, theta_out_rad=base.theta_out_rad + 1.0)
        follows = (self._own_columns(moved) != self._own_columns(base)).any(axis=0)
        loaded = [place for place in self._places if self.model.balance == "torsion" and follows[place].any()]
        return np.array([i for place in loaded for i in range(place.start, place.stop)], dtype=np.intp)

    @property
    def warms(self) -> bool:
        """Whether what noise does to a column depends on the temperature."""
        return bool(self._per_kelvin.any())

    def noise(
        self, fir: FirSet, sensors: EncoderNoise, torque_measured: bool, temperature_degC: float = PROBE_DEGC
    ) -> TorqueNoise:
        """Second moments of what the encoders' noise puts into columns and torque. Two columns that differ by a factor,
        as damping and its change with a constant temperature do, take it up with that factor."""
        inertia = 0.0 if torque_measured else self.model.output_inertia_kg_m2
        moments = signal_noise(fir, sensors, self.model.ratio)
        acceleration = SIGNALS.index("acceleration_out_rad_s2")
        k = len(self.keys)
        columns, torque = np.zeros((k, k)), np.zeros(k)
        response = self._sensitivity + (temperature_degC - PROBE_DEGC) * self._per_kelvin
        columns[: self._own, : self._own] = response @ moments @ response.T
        torque[: self._own] = response @ moments[:, acceleration] * inertia
        for effect, shape, place in zip(self._effects, self._shapes, self._places, strict=True):
            if effect.filters is not None:
                both, own = filtered_noise(fir, sensors, effect.filters, shape)
                columns[place, : self._own] = response[:, acceleration] * both
                columns[: self._own, place] = columns[place, : self._own].T
                columns[place, place], torque[place] = own, both * inertia
        return TorqueNoise(ColumnNoise(columns, torque), float(moments[acceleration, acceleration] * inertia**2))


def _is_of_angle(effect: Effect) -> bool:
    """Whether its columns are waves of an angle of two and nothing else."""
    return bool(effect.waves) and effect.carriers == ("",) and effect.balance == "torsion"


def _beside_followed(row: ModelEffect, balance: Balance) -> Iterator[ModelEffect]:
    """A row of the model without the orders of the kinematic error that are followed anyway; nothing where that is
    all."""
    if row.name != KINEMATIC or balance != "torsion":
        yield row
    elif others := tuple(wave for wave in row.waves if wave not in of_input(*ORDERS)):
        yield replace(row, waves=others)


def _felt(motion: Motion, waves: Array, rates: Array, error_rad: Array, zero_rad: float = 0.0) -> Motion:
    """The motion with the twist that the gear feels: what is known of kinematic error and zero put right."""
    return replace(
        motion,
        twist_rad=motion.twist_rad + waves @ error_rad + zero_rad,
        twist_rate_rad_s=motion.twist_rate_rad_s + rates @ error_rad,
    )


@dataclass(frozen=True, slots=True)
class TorqueNoise:
    """What the encoders alone do to the balance."""

    inside: ColumnNoise
    torque: float
    """variance of the torque side [N^2 m^2]"""

    def variance(self, amplitudes: Array) -> float:
        """Variance of torque - columns @ amplitudes, per filtered sample."""
        inside = self.inside
        total = self.torque - 2 * inside.torque @ amplitudes + amplitudes @ inside.columns @ amplitudes
        return max(float(total), 0.0)


def signal_noise(fir: FirSet, sensors: EncoderNoise, ratio: float) -> Array:
    """(4, 4) covariance of SIGNALS from white encoder noise through the filters; exact, at equal times."""
    v, f, s = fir.value, fir.first, fir.second
    out, both = sensors.theta_out_rad**2, (sensors.theta_in_rad / ratio) ** 2 + sensors.theta_out_rad**2
    return np.array(
        [
            [both * (v @ v), both * (v @ f), -out * (v @ f), -out * (v @ s)],
            [both * (v @ f), both * (f @ f), -out * (f @ f), -out * (f @ s)],
            [-out * (v @ f), -out * (f @ f), out * (f @ f), out * (f @ s)],
            [-out * (v @ s), -out * (f @ s), out * (f @ s), out * (s @ s)],
        ]
    )


def filtered_noise(
    fir: FirSet, sensors: EncoderNoise, filters: Filters, shape: Mapping[str, float]
) -> tuple[float, float]:
    """Mean product of the noise of the output's acceleration with what an effect that filters it makes of that, and
    mean square of the latter."""
    frequency = np.asarray(np.fft.rfftfreq(TRANSFORM, 1 / fir.rate_hz), dtype=float)
    power = (np.abs(np.fft.rfft(fir.second, TRANSFORM)) * sensors.theta_out_rad) ** 2
    passed = filters(frequency, shape)
    return float(np.mean(power * passed.real)), float(np.mean(power * np.abs(passed) ** 2))


def still(n: int, ratio: float, extra: tuple[str, ...] = ()) -> Motion:
    """`n` samples of a drive at rest."""
    zero = np.zeros(n)
    nine = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
    return Motion(1000.0, ratio, *nine, extra=dict.fromkeys(extra, zero))


def _probe_motion(
    rng: np.random.Generator, ratio: float, extra: tuple[str, ...], temperature_degC: float = PROBE_DEGC
) -> Motion:
    """A motion with nothing special about it, of the size that gears see."""
    n = PROBE_SAMPLES
    time_s = np.arange(n) / 1000.0
    out = rng.normal(size=n)
    return Motion(
        rate_hz=1000.0,
        ratio=ratio,
        time_s=time_s,
        theta_in_rad=ratio * out,
        theta_out_rad=out,
        twist_rad=1e-4 * rng.normal(size=n),
        twist_rate_rad_s=1e-2 * rng.normal(size=n),
        velocity_out_rad_s=rng.normal(size=n),
        acceleration_out_rad_s2=10 * rng.normal(size=n),
        torque_Nm=rng.normal(size=n),
        temperature_degC=np.full(n, temperature_degC),
        extra={name: rng.normal(size=n) for name in extra},
    )


class Equation(NamedTuple):
    """Rows of a regression."""

    motion: Motion
    columns: Array
    """(n, k)"""
    torque: Array
    """(n,)"""
    good: Mask
    """(n,)"""
    usable: Mask
    """samples of the stretch"""
    noise: TorqueNoise
    held: Array | None = None
    """(n, s) torque that one sd of each held shape makes"""
