"""The dry joint of `tests.motion.simulated_joint.stepped`, compiled: the same equations by the same Runge-Kutta steps
a hundred times faster, so that a Monte-Carlo can have many motions and a Cramer-Rao bound many derivatives."""

from __future__ import annotations

import math

import numba
import numpy as np

from tests.motion import simulated_joint as rig


def stepped(joint: rig.Joint, path: rig.Path, fine_hz: float = rig.FINE_HZ) -> tuple[np.ndarray, np.ndarray]:
    """(n,) theta_in and theta_out at the sampling rate, true values, from rest on the path."""
    h, every = 1 / fine_hz, round(fine_hz / rig.RATE_HZ)
    n = round(path.seconds * fine_hz)
    half = np.arange(2 * n + 2) * (h / 2)
    referred = path.angle(half)
    drive = referred + rig.kinematic(joint, joint.ratio * referred)
    gear = np.array([joint.inertia, joint.stiffness, joint.damping, joint.coulomb, 1 / joint.reversal])
    out = _integrated(drive, np.gradient(drive, h / 2), gear, h, every)
    return joint.ratio * referred[:: 2 * every][: len(out)], out


@numba.njit(cache=True)
def _force(u: float, du: float, x: float, v: float, gear: np.ndarray) -> float:
    """Acceleration of the output."""
    d = du - v
    return (gear[1] * (u - x) + gear[2] * d + gear[3] * math.tanh(d * gear[4])) / gear[0]


@numba.njit(cache=True)
def _integrated(u: np.ndarray, du: np.ndarray, gear: np.ndarray, h: float, every: int) -> np.ndarray:
    """(n,) output angle every so many steps."""
    n = (len(u) - 2) // 2
    out = np.empty(n // every)
    x, v = u[0], du[0]
    for i in range(n):
        if i % every == 0 and i // every < len(out):
            out[i // every] = x
        a, b, c = 2 * i, 2 * i + 1, 2 * i + 2
        a1 = _force(u[a], du[a], x, v, gear)
        a2 = _force(u[b], du[b], x + h / 2 * v, v + h / 2 * a1, gear)
        a3 = _force(u[b], du[b], x + h / 2 * v + h * h / 4 * a1, v + h / 2 * a2, gear)
        a4 = _force(u[c], du[c], x + h * v + h * h / 2 * a2, v + h * a3, gear)
        x += h * v + h * h / 6 * (a1 + a2 + a3)
        v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return out
