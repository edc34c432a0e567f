"""Motor offsets from a fitted model: theta_in = R (theta_out - e(theta_in) + phi(torque)).

The twist that a trajectory needs is the inverse of the model's own balance: loads and inertia give the torque that the
gear must pass, its springs the twist, and what depends on the twist's rate or remembers is taken off in a few rounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from edge_daemon.effects.algebra import derivative
from edge_daemon.effects.catalogue import shape_of
from edge_daemon.effects.effect import Effect
from edge_daemon.effects.model import Model, ModelEffect, ModelError
from edge_daemon.effects.resolve import resolve
from edge_daemon.effects.waves import waves
from edge_daemon.records import Array, Motion

PARTS = ("kinematic", "twist")
"""What can be compensated apart: the error of the transmission, and the twist under torque."""
MOST_RELATIVE_SD = 0.3
"""A parameter less certain than this is not acted on: its offset could err by as much as it mends at three sd."""
ROUNDS = 3
"""Of the twist's inverse: friction is some percent of the torque, so that the third moves it by 1e-4 of itself."""
GRID = 401
"""Twists at which the springs are tabled."""
WIDEST = 4.0
"""The table goes to so many times the twist of the linear spring alone."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Where the output is to be, (n,) each, evenly spaced in time; rates follow from the angle where not given."""

    rate_hz: float
    theta_out_rad: Array
    velocity_rad_s: Array
    acceleration_rad_s2: Array
    model_torque_Nm: Array | None = None
    """torque that the load needs at the output, where a controller tells it; instead of inertia and gravity"""


@dataclass(frozen=True, slots=True)
class Offsets:
    """What to add to the motor's target, (n,) each: angle [rad], speed [rad/s], torque [N m], all at the motor."""

    position_rad: Array
    velocity_rad_s: Array
    torque_Nm: Array
    parts: Mapping[str, Array]
    """position offset of each part"""


@dataclass(frozen=True, slots=True)
class Feedforward:
    """A model, ready to be inverted. `off` says of each part that is not used why."""

    model: Model
    effects: tuple[tuple[ModelEffect, Effect], ...]
    off: Mapping[str, str] = field(default_factory=dict)

    def without(self, part: str, why: str) -> Feedforward:
        """The same less one part."""
        return replace(self, off={**self.off, part: why})

    def offsets(self, path: Trajectory) -> Offsets:
        """For a trajectory of the output."""
        ratio, count = self.model.ratio, len(path.theta_out_rad)
        torque, phi = np.zeros(count), np.zeros(count)
        if "twist" not in self.off:
            torque, phi = self.twist(path)
        parts = {"twist": ratio * phi, "kinematic": np.zeros(count)}
        if "kinematic" not in self.off:
            at = ratio * path.theta_out_rad + parts["twist"]
            for _ in range(2):
                parts["kinematic"] = -ratio * self.error(at + parts["kinematic"], path.theta_out_rad)
        position = parts["twist"] + parts["kinematic"]
        speed = derivative(position, path.rate_hz) if count > 2 else np.zeros(count)
        return Offsets(position, speed, torque / ratio, parts)

    def error(self, theta_in_rad: Array, theta_out_rad: Array) -> Array:
        """The transmission's error e [rad], by which the output leads."""
        total = np.zeros(len(theta_in_rad))
        motion = _motion(self.model, 1.0, theta_out_rad, np.zeros_like(theta_in_rad), theta_in_rad=theta_in_rad)
        for row, effect in self.effects:
            if effect.name == "kinematic_error":
                total += waves(motion, effect.waves) @ _amplitudes(row, effect)
        return total

    def twist(self, path: Trajectory) -> tuple[Array, Array]:
        """Torque through the gear [N m] and the twist under it [rad]."""
        needed = self._load(path)
        phi, rate = self._sprung(needed), np.zeros(len(needed))
        for _ in range(ROUNDS if len(needed) > 2 else 0):
            rate = derivative(phi, path.rate_hz)
            phi = self._sprung(needed - self._rest(path, phi, rate))
        return needed, phi

    def _load(self, path: Trajectory) -> Array:
        """What the gear must pass: inertia and what acts on the output."""
        if path.model_torque_Nm is not None:
            return path.model_torque_Nm
        inertia = self.model.output_inertia_kg_m2
        total = (0.0 if math.isnan(inertia) else inertia) * path.acceleration_rad_s2
        motion = _motion(self.model, path.rate_hz, path.theta_out_rad, np.zeros_like(total), path)
        return np.asarray(total - self._sum(motion, lambda effect: not _of_twist(self.model, effect)))

    def _rest(self, path: Trajectory, phi: Array, rate: Array) -> Array:
        """What depends on the twist and is no spring: damping, friction, hysteresis."""
        motion = _motion(self.model, path.rate_hz, path.theta_out_rad, phi, path, rate)
        return self._sum(motion, lambda effect: _of_twist(self.model, effect) and not effect.is_spring)

    def _sum(self, motion: Motion, wanted: Callable[[Effect], bool]) -> Array:
        total = np.zeros(len(motion))
        for row, effect in self.effects:
            if effect.kind == "torque" and wanted(effect):
                columns, _ = effect.columns(motion, shape_of(self.model, effect), None)
                total += columns @ _amplitudes(row, effect)
        return total

    def _sprung(self, torque: Array) -> Array:
        """Twist of the springs under a torque, by their table turned about."""
        stiffness = self.model.value("linear_stiffness", "stiffness")
        widest = WIDEST * max(float(np.abs(torque).max(initial=0.0)), 1e-9) / stiffness
        grid = np.linspace(-widest, widest, GRID)
        motion = _motion(self.model, 1.0, np.zeros(GRID), grid)
        table = np.maximum.accumulate(self._sum(motion, lambda effect: effect.is_spring))
        return np.asarray(np.interp(torque, table, grid))


def feedforward(model: Model) -> Feedforward:
    """What of a model can be acted on. Raises `ModelError` for one without two encoders."""
    if model.balance != "torsion":
        raise ModelError('joint.balance: expected "torsion": a drive balance tells no angle of the output')
    rows = tuple((row, resolve(row, "torsion")) for row in model.effects if row.expression is None)
    found = Feedforward(model, tuple(pair for pair in rows if _fitted(*pair)))
    if not any(effect.name == "kinematic_error" for _, effect in found.effects):
        found = found.without("kinematic", "the model has no fitted kinematic_error")
    for part, why in _doubts(found):
        found = found.without(part, why)
    return found


def _fitted(row: ModelEffect, effect: Effect) -> bool:
    names = [parameter.name for parameter in (*effect.amplitudes, *effect.shapes) if parameter.name not in effect.tied]
    return all(math.isfinite(row.value(name)) for name in names)


def _doubts(found: Feedforward) -> list[tuple[str, str]]:
    """Parts whose numbers are not known well enough to act on."""
    doubts = []
    held = found.model.effect("linear_stiffness")
    parameter = held.parameters.get("stiffness") if held else None
    if parameter is None or not parameter.value > 0.0:
        doubts.append(("twist", "the model has no fitted linear_stiffness"))
    elif not parameter.identified or not parameter.sd < MOST_RELATIVE_SD * parameter.value:
        doubts.append(("twist", "the recording did not identify the stiffness"))
    row = found.model.effect("kinematic_error")
    if row is not None and "kinematic" not in found.off:
        size = math.sqrt(sum(p.value**2 for p in row.parameters.values()))
        sd = math.sqrt(sum(p.sd**2 for p in row.parameters.values()))
        if not sd < MOST_RELATIVE_SD * size:
            doubts.append(("kinematic", f"its amplitudes are known to {sd:.2g} rad only, and are {size:.2g}"))
    return doubts


def _of_twist(model: Model, effect: Effect) -> bool:
    """Whether its torque follows the twist or its rate, and so the gear; else it acts on the load's side."""
    if effect.is_spring:
        return True
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(5, 16))
    path = Trajectory(1e3, rows[0], rows[1], rows[2])
    angle, shape = rows[0] * model.ratio, shape_of(model, effect)
    still = _motion(model, 1e3, rows[0], 0 * rows[3], path, 0 * rows[4], angle)
    bent = _motion(model, 1e3, rows[0], 1e-3 * rows[3], path, rows[4], angle)
    return not np.allclose(effect.columns(still, shape, None)[0], effect.columns(bent, shape, None)[0])


def _amplitudes(row: ModelEffect, effect: Effect) -> Array:
    return np.array([row.value(parameter.name) for parameter in effect.amplitudes])


def _motion(
    model: Model,
    rate_hz: float,
    theta_out: Array,
    phi: Array,
    path: Trajectory | None = None,
    rate: Array | None = None,
    theta_in_rad: Array | None = None,
) -> Motion:
    nothing = np.zeros(len(theta_out))
    return Motion(
        rate_hz=rate_hz,
        ratio=model.ratio,
        time_s=np.arange(len(theta_out)) / rate_hz,
        theta_in_rad=model.ratio * (theta_out + phi) if theta_in_rad is None else theta_in_rad,
        theta_out_rad=theta_out,
        twist_rad=phi,
        twist_rate_rad_s=nothing if rate is None else rate,
        velocity_out_rad_s=nothing if path is None else path.velocity_rad_s,
        acceleration_out_rad_s2=nothing if path is None else path.acceleration_rad_s2,
        torque_Nm=nothing,
        temperature_degC=np.full(len(theta_out), 25.0),
    )
