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
PARTS, SMOOTH, NEAR = 8, 0.15, 2.5
"""a step is split where friction or a loop changes by more than a share SMOOTH of itself in NEAR steps"""
PATH_STEP, LONGEST_PATH = 0.5, 12.0
"""of Bouc-Wen with an exponent, in widths: Runge-Kutta errs by 1e-4 in a step; after the longest z is at its end"""


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _growth(q: float, c: float, n: float) -> float:
    """dq/da of Bouc-Wen along its direction: 1 - q^n onward, 1 - c |q|^n on the way back."""
    if q >= 0.0:
        return 1.0 - math.pow(q, n)
    return 1.0 - c * math.pow(-q, n)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bouc_wen(z: float, x: float, rounding: float, n: float) -> float:
    """z after a straight path x; see `effects.algebra.bouc_wen_state`."""
    sign = -1.0 if x < 0 else 1.0
    a, q, c = abs(x), sign * z, 1.0 - 2.0 * rounding
    if n != 1.0:
        a = min(a, LONGEST_PATH)
        steps = 1 + int(a / PATH_STEP)
        h = a / steps
        for _ in range(steps):
            k1 = _growth(q, c, n)
            k2 = _growth(q + h / 2 * k1, c, n)
            k3 = _growth(q + h / 2 * k2, c, n)
            q += h / 6 * (k1 + 2 * k2 + 2 * k3 + _growth(q + h * k3, c, n))
        return sign * min(q, 1.0)
    if q < 0:
        straight = abs(c) < 1e-9
        grown = math.exp(c * a)
        after = q + a if straight else (q + 1 / c) * grown - 1 / c
        if after <= 0:
            return sign * after
        to_zero = -q if straight else -math.log1p(c * q) / c
        q, a = 0.0, max(a - to_zero, 0.0)
    return sign * (1.0 - (1.0 - q) * math.exp(-a))


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
        z = _bouc_wen(z, dx / a, e[3], e[4])
        return size * z, size * _growth(math.copysign(1.0, dx) * z, 1.0 - 2.0 * e[3], e[4]) / a, 0.0, z
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
def _bouc_wen_slopes(z: float, x: float, rounding: float, n: float, out: Array) -> None:
    """What z after a path x changes by: over x, z, rounding, n into `out` at 1, 3, 6, 7.

    Along a flow dq/da = g(q) a start is carried on by g(end) / g(start); laws that change, by the trapezoidal rule."""
    sign = -1.0 if x < 0 else 1.0
    a, c = abs(x), 1.0 - 2.0 * rounding
    q0 = sign * z
    q1 = sign * _bouc_wen(z, x, rounding, n)
    g0, g1 = _growth(q0, c, n), _growth(q1, c, n)
    carried = g1 / g0 if g0 > 1e-6 else math.exp(-n * a)
    out[1], out[3] = g1, carried
    for q, weight in ((q0, carried), (q1, 1.0)):
        size = abs(q)
        if size > 1e-9:
            power = size**n
            back = q < 0.0
            out[6] += sign * weight * 0.5 * a * (2.0 * power if back else 0.0)
            out[7] -= sign * weight * 0.5 * a * power * math.log(size) * (c if back else 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _slopes(e: Array, x: float, dx: float, v: float, load: float, z: float, out: Array) -> None:
    """What the torque of one element changes by: over x, dx, v, z, size, a, b, c into `out` (8,).

    Of elements with memory it is z that is differentiated, which the size then multiplies."""
    kind, size, a, b, c = e[0], e[1], e[2], e[3], e[4]
    out[:] = 0.0
    if kind <= LOADED:
        t = math.tanh(v / a)
        bump, fall = 1.0, 0.0
        if kind == BUMP:
            bump = math.exp(-((v / b) ** 2))
            fall = -2.0 * v / b**2
            out[6] = -fall * v / b * size * bump * t
        elif kind == LOADED:
            bump = load
        steep = size * bump * (1.0 - t * t) / a
        out[2] = steep + fall * size * bump * t
        out[4] = bump * t
        out[5] = -steep * v / a
    elif kind == CLIP:
        inside = abs(x) < a
        out[0] = size if inside else 0.0
        out[4] = min(max(x, -a), a)
        out[5] = 0.0 if inside else size * math.copysign(1.0, x)
    elif kind == SPRING:
        out[0] = size + (2.0 * a + 3.0 * b * x) * x
        out[4], out[5], out[6] = x, x * x, x * x * x
    elif kind == STOP:
        if abs(z + dx / a) < 1.0:
            out[1], out[3], out[5] = 1.0 / a, 1.0, -dx / a**2
    elif kind == BOUC_WEN:
        _bouc_wen_slopes(z, dx / a, b, c, out)
        out[5] = -out[1] * dx / a**2
        out[1] /= a
    else:
        bump = math.exp(-((v / c) ** 2))
        level = 1.0 + (b - 1.0) * bump
        path = abs(dx) / (a * level)
        kept = math.exp(-path)
        steady = math.copysign(level, dx)
        lag = (z - steady) * kept
        higher = math.copysign(1.0 - kept, dx) + lag * path / level
        out[1] = -math.copysign(1.0, dx) * lag / (a * level)
        out[2] = -2.0 * v / c**2 * (b - 1.0) * bump * higher
        out[3] = kept
        out[5] = lag * path / a
        out[6] = bump * higher
        out[7] = 2.0 * v * v / c**3 * (b - 1.0) * bump * higher


@numba.njit(cache=True, nogil=True, error_model="numpy")
def simulate(
    spring: Array,
    elements: Array,
    push: Array,
    load: Array,
    seen: Array,
    pull: float,
    start: Array,
    h: float,
    moves: Array,
    bends: Array,
    pushes: Array,
    shifts: Array,
    times: int,
) -> tuple[Array, Array, Array, Array]:
    """Mean twist, twist rate and elements' torque (n,) of each step h [s], and what the torque changes by.

    `spring`: inertia, stiffness, damping; `elements` (e, 5); `push` (n,) torque that drives the twist; `load` (n,)
    size of the transmitted torque; `seen` (n,) twist that an observer of gain `pull` holds on to; `start`: twist, rate.
    For each of q numbers: `moves` (q, 2) change of stiffness and damping, `bends` (q, e, 4) of the elements' size, a,
    b, c, `pushes` and `shifts` (q, n // times + 1) of push and seen. Last of the four: (q, n // times) change of the
    torque, averaged over `times` steps about each sample: tangents of the discrete motion, exact but for the average.
    """  # fmt: skip
    inertia, k, damping = spring[0], spring[1], spring[2]
    count, n, q = elements.shape[0], len(push), moves.shape[0]
    twists, rates, torques = np.zeros(n), np.zeros(n), np.zeros(n)
    changes = np.zeros((q, n // times))
    z, fresh = np.zeros(count), np.zeros(count)
    local, own = np.zeros((count, 8)), np.zeros((q, count))
    s_z, s_phi, s_v, s_m, s_last = np.zeros((q, count)), np.zeros(q), np.zeros(q), np.zeros(q), np.zeros(q)
    touched, driven = np.zeros((q, count), dtype=np.bool_), np.zeros(q, dtype=np.bool_)
    for p in range(q):
        driven[p] = np.any(pushes[p] != 0.0) or np.any(shifts[p] != 0.0)
        for j in range(count):
            touched[p, j] = np.any(bends[p, j] != 0.0)
    phi, v = start[0], start[1]
    m, before, last = v, v, phi
    for i in range(n):
        at, place = i // times, (i % times) / times
        pulled = pull * (seen[i] - phi - 0.5 * h * m)
        phi += pulled
        for p in range(q if pull > 0.0 else 0):
            towards = -s_phi[p] - 0.5 * h * s_m[p]
            if driven[p]:
                towards += (1.0 - place) * shifts[p, at] + place * shifts[p, at + 1]
            s_phi[p] += pull * towards
        parts = _parts(elements, m, before, z, h)
        ahead = 2 * m - before
        before = m
        length = h / parts
        half, mass = length / 2, 2 * inertia / length
        gain = mass + damping + half * k
        for s in range(parts):
            off = (s + 0.5) / parts - 0.5
            beside = min(max(i + (1 if off > 0 else -1), 0), n - 1)
            pushed = push[i] + abs(off) * (push[beside] - push[i])
            known = mass * v - k * phi + pushed
            m = ahead if parts == 1 else m
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
            x = phi + half * m
            steep, path, thick = 0.0, 0.0, 0.0
            for j in range(count if q else 0):
                _slopes(elements[j], x, x - last, m, load[i], z[j], local[j])
                scale = elements[j, 1] if elements[j, 0] >= STOP else 1.0
                steep += scale * local[j, 0]
                path += scale * local[j, 1]
                thick += scale * local[j, 2]
            slope = max(gain + half * (steep + path) + thick, 0.1 * gain)
            part = place + off / times
            for p in range(q):
                rest = 0.0
                for j in range(count):
                    if elements[j, 0] >= STOP:
                        own[p, j] = local[j, 3] * s_z[p, j]
                        if touched[p, j]:
                            own[p, j] += _bent(local[j], bends[p, j])
                            rest += fresh[j] * bends[p, j, 0]
                        rest += elements[j, 1] * own[p, j]
                    elif touched[p, j]:
                        rest += local[j, 4] * bends[p, j, 0] + _bent(local[j], bends[p, j])
                moved = mass * s_v[p] - moves[p, 1] * m - moves[p, 0] * x - rest
                if driven[p]:
                    moved += (1.0 - part) * pushes[p, at] + part * pushes[p, at + 1]
                rate = (moved - (k + steep + path) * s_phi[p] + path * s_last[p]) / slope
                spot = s_phi[p] + half * rate
                gone = spot - s_last[p]
                for j in range(count):
                    if elements[j, 0] >= STOP:
                        s_z[p, j] = own[p, j] + local[j, 0] * spot + local[j, 1] * gone + local[j, 2] * rate
                _spread(changes[p], (rest + steep * spot + path * gone + thick * rate) / parts, i, times)
                s_last[p], s_m[p] = spot, rate
                s_phi[p] += length * rate
                s_v[p] = 2 * rate - s_v[p]
            last = x
            for j in range(count):
                z[j] = fresh[j]
            twists[i] += x / parts
            rates[i] += m / parts
            torques[i] += total / parts
            phi += length * m
            v = 2 * m - v
    return twists, rates, torques, changes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _parts(elements: Array, m: float, before: float, z: Array, h: float) -> int:
    """Into how many a step is split: friction that turns round, or a loop that turns, does so within a step or two."""
    change = abs(m - before)
    for j in range(elements.shape[0]):
        e = elements[j]
        if e[0] <= LOADED:
            if change > SMOOTH * e[2] and abs(m) < NEAR * change + 2.0 * e[2]:
                return PARTS
        elif e[0] >= STOP and abs(math.copysign(1.0, m) - z[j]) * abs(m) * h > SMOOTH * e[2]:
            return PARTS
    return 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bent(slopes: Array, bend: Array) -> float:
    """What a change of an element's a, b, c changes."""
    change: float = slopes[5] * bend[1] + slopes[6] * bend[2] + slopes[7] * bend[3]
    return change


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _spread(samples: Array, value: float, i: int, times: int) -> None:
    """Add the value of substep i to the average about its nearest sample; half way it belongs to both."""
    at, part = i // times, i % times
    share = value / times
    if 2 * part == times:
        samples[at] += share / 2
        if at + 1 < len(samples):
            samples[at + 1] += share / 2
    elif 2 * part < times:
        samples[at] += share
    elif at + 1 < len(samples):
        samples[at + 1] += share


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
