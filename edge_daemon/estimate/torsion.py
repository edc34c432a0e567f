"""The torsion of one gear integrated with its nonlinear laws, compiled: about 10 ms for 30 s. Imported by the workbench
when it first simulates, never by the daemon.

Implicit midpoint rule (Hairer, Lubich & Wanner 2006, Geometric Numerical Integration, II.1): one scalar equation a
step, solved by Newton's method between bounds. The kinds of elements are those of `effects.laws`.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from edge_daemon.effects.laws import BOUC_WEN, BUMP, CLIP, LOADED, SPRING, STOP
from edge_daemon.records import Array

NEWTON_STEPS = 40
"""most; two or three are usual, bisection takes over where friction sticks"""
TOLERANCE = 1e-9
"""last Newton step [rad/s]: a hundredth of a per cent of the driest friction's smoothing"""


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bouc_wen(z: float, x: float, rounding: float) -> tuple[float, float]:
    """z after a straight path x, and dz/dx there; see `effects.algebra.bouc_wen_state`."""
    sign = -1.0 if x < 0 else 1.0
    a, q, c = abs(x), sign * z, 1.0 - 2.0 * rounding
    if q < 0:
        straight = abs(c) < 1e-9
        grown = math.exp(c * a)
        after = q + a if straight else (q + 1 / c) * grown - 1 / c
        if after <= 0:
            return sign * after, 1.0 + c * after
        to_zero = -q if straight else -math.log1p(c * q) / c
        q, a = 0.0, max(a - to_zero, 0.0)
    q = 1.0 - (1.0 - q) * math.exp(-a)
    return sign * q, 1.0 - q


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _torque(e: Array, x: float, dx: float, v: float, load: float, z: float) -> tuple[float, float, float, float]:
    """(torque, its slope over x, its slope over v, z) of one element [kind, size, a, b, c]; dx since the last call."""
    kind, size, a = e[0], e[1], e[2]
    if kind <= LOADED:
        t = math.tanh(v / a)
        level = size * load if kind == LOADED else size
        slope = 0.0
        if kind == BUMP:
            level *= math.exp(-((v / e[3]) ** 2))
            slope = -2.0 * v / e[3] ** 2 * level * t
        return level * t, 0.0, slope + level * (1 - t * t) / a, z
    if kind == CLIP:
        inside = abs(x) < a
        return size * min(max(x, -a), a), (size if inside else 0.0), 0.0, z
    if kind == SPRING:
        return (size + (a + e[3] * x) * x) * x, size + (2 * a + 3 * e[3] * x) * x, 0.0, z
    if kind == STOP:
        z += dx / a
        if abs(z) >= 1.0:
            return size * math.copysign(1.0, z), 0.0, 0.0, math.copysign(1.0, z)
        return size * z, size / a, 0.0, z
    if kind == BOUC_WEN:
        z, slope = _bouc_wen(z, dx / a, e[3])
        return size * z, size * slope / a, 0.0, z
    level = 1 + (e[3] - 1) * math.exp(-((v / e[4]) ** 2))
    kept = math.exp(-abs(dx) / (a * level))
    steady = math.copysign(level, dx)
    return (
        size * (steady + (z - steady) * kept),
        size * kept / a * abs(steady - z) / level,
        0.0,
        (steady + (z - steady) * kept),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def simulate(
    spring: Array, elements: Array, push: Array, load: Array, seen: Array, pull: float, start: Array, h: float
) -> tuple[Array, Array, Array]:
    """Twist, twist rate and the elements' torque (n,) in the middle of each step h [s].

    `spring`: inertia, stiffness, damping; `elements` (e, 5); `push` (n,) torque that drives the twist; `load` (n,)
    size of the transmitted torque; `seen` (n,) twist that an observer of gain `pull` holds on to; `start`: twist, rate.
    """
    inertia, k, damping = spring[0], spring[1], spring[2]
    half, count, n = h / 2, elements.shape[0], len(push)
    mass = 2 * inertia / h
    gain = mass + damping + half * k
    twists, rates, torques = np.empty(n), np.empty(n), np.empty(n)
    z, fresh = np.zeros(count), np.zeros(count)
    phi, v = start[0], start[1]
    m = v
    last = phi
    before = v
    for i in range(n):
        if pull > 0.0:
            phi += pull * (seen[i] - phi - half * m)
        known = mass * v - k * phi + push[i]
        guess = 2 * m - before
        before = m
        m = guess
        low, high = -np.inf, np.inf
        total, step = 0.0, np.inf
        for _ in range(NEWTON_STEPS):
            total, slope = 0.0, gain
            x = phi + half * m
            for j in range(count):
                f, over_x, over_v, fresh[j] = _torque(elements[j], x, x - last, m, load[i], z[j])
                total += f
                slope += half * over_x + over_v
            over = gain * m + total - known
            if over > 0:
                high = m
            else:
                low = m
            newton = -over / slope if slope > 0.1 * gain else -over / gain
            if abs(newton) < TOLERANCE:
                break
            bounded = np.isfinite(low + high)
            if bounded and (not (low < m + newton < high) or abs(newton) > 0.5 * abs(step)):
                newton = 0.5 * (low + high) - m
            step = newton
            m += step
            if abs(step) < TOLERANCE:
                break
        last = phi + half * m
        for j in range(count):
            z[j] = fresh[j]
        twists[i], rates[i], torques[i] = last, m, total
        phi += h * m
        v = 2 * m - v
    return twists, rates, torques


@numba.njit(cache=True, nogil=True, error_model="numpy")
def followed(elements: Array, twist: Array, rate: Array, load: Array) -> Array:
    """(n,) torque of the elements along a given motion."""
    out = np.zeros(len(twist))
    for j in range(elements.shape[0]):
        z, last = 0.0, twist[0]
        for i in range(len(twist)):
            f, _, _, z = _torque(elements[j], twist[i], twist[i] - last, rate[i], load[i], z)
            out[i] += f
            last = twist[i]
    return out
