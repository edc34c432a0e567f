"""A joint whose load swings on the gear's spring: two masses, a controller on the motor, ripple of the motor's turn.

Nothing here is shared with the product. Angle and speed are the motor's, over the ratio.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from tests.explain.simulated_drives import PLAIN_SENSING, RATIO, STEP_S, Joint, Sensing, as_read, course

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ElasticArm:
    """A pendulum on a spring, seen at the output."""

    motor_kg_m2: float = 0.32
    load_kg_m2: float = 0.48
    swing_hz: float = 30.0
    """at which the load swings where the motor is held"""
    damping: float = 0.1
    """of that, over the critical"""
    weight_Nm: float = 12.0
    viscous_Nms: float = 6.0
    coulomb_Nm: float = 5.0
    ripple_Nm: float = 0.6
    """at twice the motor's turn"""
    drag_Nms: float = 0.0
    """the same where it grows with speed"""
    tones_hz: tuple[float, ...] = ()
    """that the motion has beside its course"""


def record(arm: ElasticArm, seed: int, seconds: float = 20.0, sensing: Sensing = PLAIN_SENSING) -> Joint:
    """One recording."""
    rng = np.random.default_rng(seed)
    wanted = np.stack(course(seconds, rng, sensing.pace))
    for hz in arm.tones_hz:
        wanted += _tone(hz, wanted.shape[1])
    w = 2 * math.pi * arm.swing_hz
    stiffness, damping = arm.load_kg_m2 * w**2, 2 * arm.damping * arm.load_kg_m2 * w
    numbers = np.array([
        arm.motor_kg_m2, arm.load_kg_m2, stiffness, damping, arm.weight_Nm, arm.viscous_Nms, arm.coulomb_Nm,
        arm.ripple_Nm, arm.drag_Nms,
    ])  # fmt: skip
    angle, speed, torque = _moved(numbers, wanted)
    return as_read(sensing, rng, np.stack((angle, speed, torque / RATIO, np.full(len(angle), 25.0))))


def _tone(hz: float, count: int) -> Array:
    """(3, n) angle, speed and acceleration of 0.2 rad/s at a frequency."""
    w, phase = 2 * math.pi * hz, 2 * math.pi * hz * STEP_S * np.arange(count) + hz
    return np.stack((0.2 / w * np.sin(phase), 0.2 * np.cos(phase), -0.2 * w * np.sin(phase)))


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _moved(p: Array, wanted: Array) -> tuple[Array, Array, Array]:
    n = wanted.shape[1]
    angle, speed, torque = np.zeros(n), np.zeros(n), np.zeros(n)
    q = out = 0.0
    v = w = wanted[1, 0]
    whole = p[0] + p[1]
    for i in range(n):
        tau = whole * (wanted[2, i] + 2500.0 * (wanted[0, i] - q) + 70.0 * (wanted[1, i] - v)) + p[4] * math.sin(q)
        angle[i], speed[i], torque[i] = q, v, tau
        carried = p[2] * (q - out) + p[3] * (v - w)
        ripple = (p[7] + p[8] * abs(v)) * math.sin(2.0 * RATIO * q + 0.4)
        free = tau - ripple - p[5] * v - carried
        dry = min(max(free + p[0] * v / STEP_S, -p[6]), p[6])
        v += STEP_S * (free - dry) / p[0]
        w += STEP_S * (carried - p[4] * math.sin(out)) / p[1]
        q += STEP_S * v
        out += STEP_S * w
    return angle, speed, torque
