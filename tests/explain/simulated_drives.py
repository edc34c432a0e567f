"""Joints with one encoder for trials: a pendulum under a position controller, friction as a budget that is clipped.

Nothing here is shared with the product. The arm moves by steps of 0.1 ms: friction takes whatever would stop the arm,
up to its budget, so that a joint sticks and breaks loose by itself. The controller follows a course of tones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 1e-4
RATIO = 100.0
GRAVITY_M_S2 = 9.81


@dataclass(frozen=True, slots=True)
class Arm:
    """A pendulum behind a gear, all of it seen at the output; 0 takes an effect away."""

    inertia_kg_m2: float = 0.8
    weight_Nm: float = 0.0
    steady_Nm: float = 0.0
    """a load behind the gear that is the same at any angle: a weight on a belt, a spring"""
    viscous_Nms: float = 6.0
    coulomb_Nm: float = 5.0
    offset_Nm: float = 0.0
    asymmetry_Nm: float = 0.0
    """what friction has more in positive motion"""
    mesh: float = 0.0
    """friction per torque that passes the gear to inertia and weight"""
    root_Nm: float = 0.0
    """friction at 1 rad/s that grows with a power of speed"""
    root_exponent: float = 0.5
    stribeck_Nm: float = 0.0
    stribeck_rad_s: float = 0.1
    stribeck_exponent: float = 2.0
    rotor: float = 0.0
    """share of the inertia before the gear, which no friction of the load feels"""
    bristles: tuple[float, float] = (0.0, 0.0)
    """stiffness [N m/rad] and damping [N m s/rad] of bristles that carry all dry friction (LuGre); 0: it is clipped"""
    bristle_rad: tuple[float, ...] = ()
    """angles over which equal parts of the dry friction build up; none: at once"""
    warmth_Nms_per_K: float = 0.0
    waves: tuple[tuple[str, float, float, float], ...] = ()
    """ripple: the angle (`in`, `out`, `between`), its order, its size [N m] and phase"""
    drag: tuple[tuple[float, float, float], ...] = ()
    """ripple of the motor's turn that grows with speed: its order, its size [N m s/rad] and phase"""
    error: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """the motor leads the output, over its ratio, by an angle of this order of its turn, this size [rad] and phase; all
    friction is before it"""
    actuator: Mapping[str, float] = field(default_factory=dict)
    """`motor`, `load`, `creep`, `driving`, `backdriven`: friction per torque of motor and load, as BAM has it"""


@dataclass(frozen=True, slots=True)
class Sensing:
    """How a joint is read; shares of the current are of its rms."""

    rate_hz: float = 500.0
    bits: int = 20
    noise: float = 1e-3
    """white noise of the current"""
    memory_s: float = 0.0
    """time over which the noise of the current forgets itself; 0: at once"""
    step: float = 0.0
    """to which the current is rounded"""
    jitter: float = 0.0
    """scatter of the sampling interval over itself; the stamps tell the true instants"""
    stamp_s: float = 0.0
    """by how much the stamps err"""
    lost: float = 0.0
    """share of the samples that never arrive"""
    velocity_rad_s: float = 0.0
    """noise of the measured speed; 0: it is not measured"""
    pace: float = 1.0
    """of the course over its usual one"""


PLAIN_SENSING = Sensing()


@dataclass(frozen=True, slots=True)
class Joint:
    """What was recorded."""

    time_s: Array
    columns: dict[str, Array]


TONES_HZ = (0.13, 0.47, 1.3, 2.9)
SPEEDS_RAD_S = (0.7, 0.6, 0.4, 0.25)


def course(seconds: float, rng: np.random.Generator, pace: float = 1.0) -> tuple[Array, Array, Array]:
    """Angle, speed and acceleration to follow, each step."""
    t = np.arange(round(seconds / STEP_S)) * STEP_S
    out = np.zeros((3, len(t)))
    for hz, size in zip(TONES_HZ, SPEEDS_RAD_S, strict=True):
        w, p = 2 * math.pi * pace * hz * rng.uniform(0.9, 1.1), rng.uniform(0, 2 * math.pi)
        out += size * np.array([-np.cos(w * t + p) / w, np.sin(w * t + p), w * np.cos(w * t + p)])
    return out[0] - out[0][0], out[1], out[2]


def record(arm: Arm, seed: int, seconds: float = 20.0, sensing: Sensing = PLAIN_SENSING) -> Joint:
    """One recording; as a rule 500 Hz, 20 bits, current with 0.1 % of noise."""
    rng = np.random.default_rng(seed)
    wanted = np.stack(course(seconds, rng, sensing.pace))
    degC = 25.0 + 15.0 * -np.expm1(-np.arange(wanted.shape[1]) * STEP_S / 12.0)
    orders = {"in": RATIO, "out": 1.0, "between": RATIO - 1.0}
    waves = np.array([(orders[of] * n, size, phase) for of, n, size, phase in arm.waves]).reshape(-1, 3)
    numbers = np.array([
        arm.inertia_kg_m2, arm.weight_Nm, arm.viscous_Nms, arm.coulomb_Nm, arm.offset_Nm, arm.asymmetry_Nm, arm.mesh,
        arm.root_Nm, arm.stribeck_Nm, arm.stribeck_rad_s, arm.stribeck_exponent, arm.warmth_Nms_per_K,
        *(arm.actuator.get(name, 0.0) for name in ("motor", "load", "creep", "driving", "backdriven")),
        arm.root_exponent, arm.rotor, *arm.bristles, RATIO * arm.error[0], *arm.error[1:],
        arm.steady_Nm,
    ])  # fmt: skip
    drag = np.array([(RATIO * n, size, phase) for n, size, phase in arm.drag]).reshape(-1, 3)
    angle, speed, torque = _moved(numbers, np.array(arm.bristle_rad), waves, drag, wanted, degC)
    return as_read(sensing, rng, np.stack((angle, speed, torque / RATIO, degC)))


def as_read(sensing: Sensing, rng: np.random.Generator, true: Array) -> Joint:
    """What the sensors say of angle, speed, motor torque and temperature (4, n)."""
    instants = np.arange(0.0, (true.shape[1] - 1) * STEP_S, 1 / sensing.rate_hz)
    if sensing.jitter:
        instants = instants + rng.uniform(-0.5, 0.5, len(instants)) * math.sqrt(6) * sensing.jitter / sensing.rate_hz
        instants = np.sort(instants[(instants >= 0) & (instants < (true.shape[1] - 1) * STEP_S)])
    if sensing.lost:
        instants = instants[rng.uniform(size=len(instants)) > sensing.lost]
    angle, speed, current, degC = (np.interp(instants, np.arange(true.shape[1]) * STEP_S, row) for row in true)
    rms, step = float(current.std()), 2 * math.pi / 2**sensing.bits
    noise = rng.normal(size=len(current))
    if sensing.memory_s:
        kept = math.exp(-1 / (sensing.memory_s * sensing.rate_hz))
        for i in range(1, len(noise)):
            noise[i] = kept * noise[i - 1] + math.sqrt(1 - kept**2) * noise[i]
    current = current + sensing.noise * rms * noise
    columns = {
        "theta_out_rad": np.rint(angle / step + rng.normal(0, 0.25, len(angle))) * step,
        "torque_in_Nm": np.rint(current / (sensing.step * rms)) * sensing.step * rms if sensing.step else current,
        "temperature_degC": np.round(degC, 2),
    }
    if sensing.velocity_rad_s:
        columns["velocity_out_rad_s"] = speed + rng.normal(0, sensing.velocity_rad_s, len(speed))
    if sensing.stamp_s:
        instants = instants + rng.normal(0, sensing.stamp_s, len(instants))
    return Joint(instants, columns)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _moved(
    p: Array, bristles: Array, waves: Array, drag: Array, wanted: Array, degC: Array
) -> tuple[Array, Array, Array]:
    n = wanted.shape[1]
    angle, speed, torque = np.zeros(n), np.zeros(n), np.zeros(n)
    q = v = 0.0
    v = wanted[1, 0]
    gained = 0.0
    bent = 0.0
    strain = np.zeros(len(bristles))
    for i in range(n):
        weight = p[1] * math.sin(q) + p[24]
        ripple = 0.0
        for k in range(waves.shape[0]):
            ripple += waves[k, 1] * math.sin(waves[k, 0] * q + waves[k, 2])
        for k in range(drag.shape[0]):
            ripple += drag[k, 1] * abs(v) * math.sin(drag[k, 0] * q + drag[k, 2])
        ahead = p[21] * p[22] * math.cos(p[21] * q + p[23])
        bend = -p[21] * p[21] * p[22] * math.sin(p[21] * q + p[23])
        inertia = p[0] * (1 - p[18] + p[18] * (1 + ahead) ** 2)
        pull = 2500.0 * p[0] * (wanted[0, i] - q) + 70.0 * p[0] * (wanted[1, i] - v)
        tau = p[0] * wanted[2, i] + weight + pull
        angle[i], speed[i], torque[i] = q, v, tau
        slip = abs(v) * (1 + ahead)
        creep = math.exp(-((slip / p[9]) ** p[10]))
        load = p[0] * (1 - p[18]) * gained + weight
        drives = abs(tau) > abs(weight)
        square = p[15] * weight**2 if drives else p[16] * tau**2
        budget = p[3] + p[5] * (0.5 if v > 0 else -0.5) + p[6] * abs(load) + p[7] * slip ** p[17] + p[8] * creep
        budget += abs(p[12] * tau + p[13] * weight) + creep * (p[14] * abs(weight) + square)
        viscous = (p[2] + p[11] * (degC[i] - 25.0)) * v * (1 + ahead)
        free = (tau - p[4] - ripple - viscous) * (1 + ahead) - weight
        free -= p[0] * p[18] * (1 + ahead) * bend * v * v
        budget *= 1 + ahead
        dry = 0.0
        if p[19] > 0.0:
            rate = v - p[19] * slip / budget * bent
            bent += 1e-4 * rate
            dry = p[19] * bent + p[20] * rate
        elif len(bristles):
            for k in range(len(bristles)):
                strain[k] = min(max(strain[k] + v * 1e-4 / bristles[k], -1.0), 1.0)
                dry += budget * strain[k] / len(bristles)
        else:
            dry = min(max(free + inertia * v / 1e-4, -budget), budget)
        gained = (free - dry) / inertia
        v += 1e-4 * gained
        q += 1e-4 * v
    return angle, speed, torque
