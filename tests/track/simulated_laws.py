"""The joint of `simulated_joint` with torques whose shape is to be found, by Runge-Kutta; no code of the product.

J alpha = K (phi - clip(phi, -g, g)) + B dphi + (F + E exp(-(dphi/v)^2)) tanh(dphi/w) + L z, z' after Wen (1976).
"""

import math
from dataclasses import dataclass

import numpy as np

from tests.motion import simulated_joint as rig


@dataclass(frozen=True)
class Laws:
    level: float = 0.0
    excess: float = 0.0
    speed: float = 5e-3
    width: float = 1e-3
    loop: float = 0.0
    knee: float = 1e-5
    rounding: float = 0.6
    half_gap: float = 0.0


@dataclass(frozen=True)
class Run:
    theta_in: np.ndarray
    theta_out: np.ndarray
    state: np.ndarray
    """z"""


def run(joint, path, laws, fine_hz=10_000.0, speed_at=None):
    """At RATE_HZ, starting at rest on the path; `speed_at(t)` replaces the constant Stribeck speed."""
    h, every = 1 / fine_hz, round(fine_hz / rig.RATE_HZ)
    n = round(path.seconds * fine_hz)
    referred = path.angle(np.arange(2 * n + 2) * (h / 2))
    drive = referred + rig.kinematic(joint, joint.ratio * referred)
    u, du = drive.tolist(), np.gradient(drive, h / 2).tolist()
    force = _force(joint, laws)
    x, v, z, speed = u[0], du[0], 0.0, laws.speed
    out, states = np.empty(n // every), np.empty(n // every)
    for i in range(n):
        if i % every == 0:
            out[i // every], states[i // every] = x, z
            speed = laws.speed if speed_at is None else speed_at(i * h)
        p, d = u[2 * i], du[2 * i]
        q, e = u[2 * i + 1], du[2 * i + 1]
        r, f = u[2 * i + 2], du[2 * i + 2]
        a1, z1 = force(p - x, d - v, z, speed)
        a2, z2 = force(q - x - h / 2 * v, e - v - h / 2 * a1, z + h / 2 * z1, speed)
        a3, z3 = force(q - x - h / 2 * v - h * h / 4 * a1, e - v - h / 2 * a2, z + h / 2 * z2, speed)
        a4, z4 = force(r - x - h * v - h * h / 2 * a2, f - v - h * a3, z + h * z3, speed)
        x, v = x + h * v + h * h / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        z += h / 6 * (z1 + 2 * z2 + 2 * z3 + z4)
    return Run(joint.ratio * referred[:: 2 * every][: len(out)], out, states)


def _force(joint, laws):
    """Acceleration of the output and z' at twist p, its rate d and z."""
    k, b, j = joint.stiffness, joint.damping, joint.inertia
    level, excess, turn, gap = laws.level, laws.excess, 1 / laws.width, laws.half_gap
    loop, knee, rounding = laws.loop, laws.knee, laws.rounding
    tanh, exp = math.tanh, math.exp

    def friction(p, d, z, speed):
        bump = d / speed
        return (k * p + b * d + (level + excess * exp(-bump * bump)) * tanh(d * turn)) / j, 0.0

    def hysteresis(p, d, z, speed):
        grown = d - (rounding * abs(d) * (1 if z > 0 else -1) + (1 - rounding) * d) * abs(z)
        return (k * p + b * d + loop * z) / j, grown / knee

    def dead_zone(p, d, z, speed):
        return (k * (p - max(-gap, min(gap, p))) + b * d) / j, 0.0

    return hysteresis if loop else dead_zone if gap else friction
