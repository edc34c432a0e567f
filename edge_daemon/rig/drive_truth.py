"""The drive truth: a servo with one encoder, motor torque (current) against motion.

    kt * ratio * i = J*a + Fv*v + Fc*sgn(v) + ... + noise        (all on the output side)

The motion is prescribed, so the torque follows from it at once; only hysteresis has memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.records import Array
from edge_daemon.rig.motion import MOTIONS, MotorMotion
from edge_daemon.rig.simulated import (
    FREE_ORDER,
    RATIO,
    REFERENCE_DEGC,
    Given,
    Simulated,
    UnknownEffect,
    Wanted,
    free_order_of_input,
    quantised,
    temperature_at,
)

REVERSAL_WIDTH_RAD_S = 5e-3
"""Friction turns round over this output speed."""
CURRENT_NOISE = 0.02
"""The current's noise has this sd relative to the current's rms (guess)."""
TORQUE_CONSTANT_Nm_per_A = 0.12
"""A small servo motor has this constant at its shaft."""
RICH_HERE = {"rich": "wide"}
"""What is rich for a torsion recording hardly leaves the spot."""


@dataclass(frozen=True, slots=True)
class Moving:
    """What the drive effects see: (n,) each, output side."""

    theta_out_rad: Array
    speed: Array
    acceleration: Array
    theta_in_rad: Array
    temperature_degC: Array
    inertia_torque_Nm: Array
    time_s: Array
    weight_Nm: Array
    """torque that holds what hangs on the output"""
    ratio: float

    @property
    def load_torque_Nm(self) -> Array:
        """(n,) what passes the gear."""
        return self.inertia_torque_Nm + self.weight_Nm

    @property
    def sign(self) -> Array:
        """(n,) direction of motion, smooth within the reversal width."""
        return np.asarray(np.tanh(self.speed / REVERSAL_WIDTH_RAD_S))


Torque = Callable[[Moving, Mapping[str, float]], Array]
Sizes = Callable[[np.random.Generator, float], dict[str, float]]
"""(rng, rms of the inertia torque) -> parameters"""


@dataclass(frozen=True, slots=True)
class DriveTruth:
    """One effect of the single-encoder drive: torque [N m] on the output side that the motor must make."""

    name: str
    draw: Sizes
    torque: Torque
    weighs: bool = False
    """whether it hangs on the output, so that the gear transmits it"""
    warms: bool = False  # visible only where the temperature changes


def _hysteresis(m: Moving, p: Mapping[str, float]) -> Array:
    """Dahl 1968: presliding friction, z' = v/knee*(1 - z*sgn(v))."""
    travel = np.diff(m.theta_out_rad, prepend=m.theta_out_rad[0]) / p["knee_rad"]
    z, out = 0.0, []
    for step in travel.tolist():
        side = math.copysign(1.0, step)
        z = side + (z - side) * math.exp(-abs(step))
        out.append(z)
    return p["level_Nm"] * np.array(out)


def _asymmetric(m: Moving, p: Mapping[str, float]) -> Array:
    return np.asarray(np.where(m.speed > 0, p["forward_Nm"], p["backward_Nm"]) * m.sign)


def _stribeck(m: Moving, p: Mapping[str, float]) -> Array:
    bump = (p["static_Nm"] - p["level_Nm"]) * np.exp(-np.square(m.speed / p["stribeck_rad_s"]))
    return np.asarray((p["level_Nm"] + bump) * m.sign)


def _crank(m: Moving, p: Mapping[str, float]) -> Array:
    """Power that the kinetic energy of a load takes whose inertia goes round twice a turn, over the speed."""
    usual, angle = m.inertia_torque_Nm, 2 * m.theta_out_rad + p["phase_rad"]
    inertia = p["relative"] * float(usual @ m.acceleration / (m.acceleration @ m.acceleration))
    return np.asarray(inertia * (np.cos(angle) * m.acceleration - np.sin(angle) * m.speed**2))


@dataclass(frozen=True, slots=True)
class Actuator:
    """Friction of one strain wave actuator, output side, N m and rad/s.

    Source: Duclusaud & Passault (2024), BAM, fits of models M1, M3 and M6 to a ZeroErr eRob80.
    """

    base: float
    viscous: float
    motor: float = 0.0
    """friction per torque of the motor"""
    load: float = 0.0
    """friction per torque of the load"""
    static: float = 0.0
    stribeck_rad_s: float = 1.0
    exponent: float = 1.0
    load_creep: float = 0.0
    """friction per torque of the load, at creep"""
    square_driving: float = 0.0
    """friction per square of the load's torque, at creep, where the motor drives"""
    square_backdriven: float = 0.0
    """friction per square of the motor's torque, at creep, where the load drives"""

    def budget(self, speed: Array, motor_Nm: Array, external_Nm: Array) -> Array:
        """(n,) most that friction can be [N m]."""
        creep = np.exp(-np.power(np.abs(speed) / self.stribeck_rad_s, self.exponent))
        drives = np.abs(motor_Nm) > np.abs(external_Nm)
        square = np.where(drives, self.square_driving * external_Nm**2, self.square_backdriven * motor_Nm**2)
        meshed = np.abs(self.motor * motor_Nm - self.load * external_Nm)
        return np.asarray(self.base + meshed + creep * (self.static + self.load_creep * np.abs(external_Nm) + square))


ACTUATORS = {
    "actuator_m1_100": Actuator(5.61, 8.39),
    "actuator_m3_100": Actuator(4.83, 7.40, 0.148, 0.148),
    "actuator_m6_100": Actuator(0.0005, 9.7, 0.049, 0.0, 5.23, 2.03, 3.0, 0.051, 0.0027, 0.0026),
    "actuator_m1_50": Actuator(4.10, 1.30),
    "actuator_m3_50": Actuator(3.47, 1.21, 0.063, 0.063),
    "actuator_m6_50": Actuator(3.26, 1.40, 0.036, 0.0, 0.32, 2.83, 1.79, 0.041, 0.0016, 0.0019),
}
"""Two measured actuators, ratio 100 and 50, each as three models of rising detail describe it."""
MESH_ROUNDS = 12
"""Repetitions of a friction that depends on the motor's torque, of which it is a part: a seventh is left of each."""


def _actuator(name: str) -> Torque:
    """Friction of a measured actuator along a prescribed motion, where nothing sticks."""
    gear = ACTUATORS[name]

    def torque(m: Moving, p: Mapping[str, float]) -> Array:
        friction = np.zeros_like(m.speed)
        for _ in range(MESH_ROUNDS):
            motor = m.load_torque_Nm + friction
            friction = p["times"] * (gear.viscous * m.speed + m.sign * gear.budget(m.speed, motor, -m.weight_Nm))
        return friction

    return torque


def _ripple(m: Moving, p: Mapping[str, float]) -> Array:
    second = p["sine_Nm"] * np.sin(2 * m.theta_in_rad) + p["cosine_Nm"] * np.cos(2 * m.theta_in_rad)
    size = p["free_Nm"] + p["free_per_load"] * np.abs(m.load_torque_Nm) + p["free_Nms_per_rad"] * np.abs(m.speed)
    order = free_order_of_input(p, m.ratio)
    return np.asarray(second + size * np.sin(order * m.theta_in_rad + p["free_phase_rad"]))


def _ripple_sizes(rng: np.random.Generator, rms: float) -> dict[str, float]:
    two = {"sine_Nm": rng.uniform(0.1, 0.3) * rms, "cosine_Nm": rng.uniform(0.1, 0.3) * rms}
    return two | FREE_ORDER | {"free_Nm": 0.0, "free_per_load": 0.0, "free_Nms_per_rad": 0.0}


def _sized(name: str, low: float, high: float) -> Sizes:
    return lambda rng, rms: {name: rng.uniform(low, high) * rms}


DRIVE_TRUTHS: dict[str, DriveTruth] = {
    row.name: row
    for row in (
        DriveTruth("viscous_friction", _sized("Nms_per_rad", 0.3, 0.6), lambda m, p: p["Nms_per_rad"] * m.speed),
        DriveTruth("coulomb_friction", _sized("level_Nm", 0.3, 0.6), lambda m, p: p["level_Nm"] * m.sign),
        DriveTruth(
            "asymmetric_friction",
            lambda rng, rms: {"forward_Nm": rng.uniform(0.4, 0.6) * rms, "backward_Nm": rng.uniform(0.2, 0.3) * rms},
            _asymmetric,
        ),
        DriveTruth(
            "stribeck_friction",
            lambda rng, rms: {
                "level_Nm": 0.3 * rms,
                "static_Nm": rng.uniform(0.6, 0.8) * rms,
                "stribeck_rad_s": rng.uniform(0.2, 0.4),
            },
            _stribeck,
        ),
        DriveTruth(
            "sublinear_friction",
            _sized("size_Nm", 0.3, 0.6),
            lambda m, p: p["size_Nm"] * m.sign * np.sqrt(np.abs(m.speed)),
        ),
        DriveTruth(
            "superlinear_friction",
            _sized("size_Nm", 0.3, 0.6),
            lambda m, p: p["size_Nm"] * m.sign * np.square(m.speed),
        ),
        DriveTruth(
            "load_dependent_friction",
            lambda rng, rms: {"mu": rng.uniform(0.2, 0.4)},
            lambda m, p: p["mu"] * np.abs(m.load_torque_Nm) * m.sign,
        ),
        DriveTruth(
            "gravity_load",
            lambda rng, rms: {"size_Nm": rng.uniform(0.5, 1.0) * rms, "phase_rad": rng.uniform(0, 2 * math.pi)},
            lambda m, p: p["size_Nm"] * np.sin(m.theta_out_rad + p["phase_rad"]),
            weighs=True,
        ),
        DriveTruth(
            "varying_inertia",
            lambda rng, rms: {"relative": rng.uniform(0.2, 0.4), "phase_rad": rng.uniform(0, 2 * math.pi)},
            _crank,
            weighs=True,
        ),
        DriveTruth("constant_torque", _sized("size_Nm", 0.1, 0.3), lambda m, p: np.full(len(m.speed), p["size_Nm"])),
        DriveTruth(
            "wave_generator_ripple",
            _ripple_sizes,
            _ripple,
        ),
        DriveTruth(
            "temperature_friction",
            lambda rng, rms: {"Nms_per_rad_K": -rng.uniform(0.02, 0.04) * rms},
            lambda m, p: p["Nms_per_rad_K"] * (m.temperature_degC - REFERENCE_DEGC) * m.speed,
            warms=True,
        ),
        DriveTruth(
            "hysteresis",
            lambda rng, rms: {"level_Nm": rng.uniform(0.3, 0.6) * rms, "knee_rad": rng.uniform(0.01, 0.03)},
            _hysteresis,
        ),
        *(DriveTruth(name, lambda rng, rms: {"times": 1.0}, _actuator(name)) for name in ACTUATORS),
    )
}


def simulate_drive(wanted: Wanted, laws: Sequence[DriveTruth] = ()) -> Simulated:
    """A single-encoder recording: output angle and speed, motor current and torque, temperature."""
    given, rng = Given(wanted.parameters), np.random.default_rng(wanted.seed)
    inertia = given.value("inertia_kg_m2", rng.uniform(0.5, 2.0))
    ratio = given.value("ratio", RATIO)
    motion = _motion(wanted, rng)
    time_s = np.arange(round(wanted.seconds * wanted.rate_hz) + 1) / wanted.rate_hz
    course = motion.course(time_s)
    truths = [*(_truth(name) for name in wanted.effects if name != "inertia"), *laws]
    degC = temperature_at(time_s, wanted.span(any(row.warms for row in truths)))
    torque = inertia * course.acceleration / ratio
    out, speed, acceleration = course.angle / ratio, course.speed / ratio, course.acceleration / ratio
    moving = Moving(out, speed, acceleration, course.angle, degC, torque, time_s, np.zeros_like(torque), ratio)
    drawn = {row.name: given.of(row.name, row.draw(rng, float(torque.std()))) for row in truths}
    weight = sum((row.torque(moving, drawn[row.name]) for row in truths if row.weighs), moving.weight_Nm)
    moving = replace(moving, weight_Nm=weight)
    total = moving.load_torque_Nm + sum(row.torque(moving, drawn[row.name]) for row in truths if not row.weighs)
    given.refuse_leftovers()
    current = total / (ratio * TORQUE_CONSTANT_Nm_per_A)
    current = current + rng.normal(0.0, CURRENT_NOISE * float(current.std()), len(current))
    columns = {
        "theta_out_rad": quantised(moving.theta_out_rad, wanted.bits_out, rng),
        "velocity_out_rad_s": moving.speed,
        "current_in_A": current,
        "torque_in_Nm": current * TORQUE_CONSTANT_Nm_per_A,
        "temperature_degC": np.round(degC, 2),
    }
    truth = wanted.truth("drive", drawn, motion) | {"torque_rms_Nm": float(total.std()), "parameters": given.chosen}
    return Simulated(time_s, columns, truth)


def _motion(wanted: Wanted, rng: np.random.Generator) -> MotorMotion:
    if isinstance(wanted.motion, str):
        return MOTIONS[RICH_HERE.get(wanted.motion, wanted.motion)](wanted.seconds, rng)
    return wanted.motion


def _truth(name: str) -> DriveTruth:
    if name in DRIVE_TRUTHS:
        return DRIVE_TRUTHS[name]
    raise UnknownEffect(name, ("inertia", *DRIVE_TRUTHS))
