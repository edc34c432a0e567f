"""The core of `twist`, compiled: one scalar equation a step, solved by Newton's method between bounds, and the tangents
with it; about 5 ms for 30 s. Whoever imports this file asks for the compiler: only `machine_code` and the fit do.

The kinds of elements are those of `integrator.laws`. All that moves is one file, because the cache of what is compiled
sees changes of its own file only; kinds and places that come from elsewhere never change their meaning.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numba
import numpy as np
from numba import carray, types  # type: ignore[attr-defined]

from edge_daemon.integrator.laws import (
    BOUC_WEN,
    BRISTLE,
    BUMP,
    CLIP,
    END_MEAN,
    END_RATE,
    GAIN,
    LEAST_LIMIT,
    LOADED,
    OF_RATE,
    RUB,
    SPRING,
    STOP,
)
from edge_daemon.records import Array

NEWTON_STEPS = 40
"""Two or three steps are usual; bisection takes over where friction sticks."""
TOLERANCE = 1e-9
"""The last Newton step [rad/s] is a hundredth of a per cent of the driest friction's smoothing."""
LEAST_SLOPE = 0.1
"""Laws that soften the slope to less than this share of the linear part's are not followed downhill."""
SMOOTH, NEAR = 0.15, 2.5
"""A step is split where friction or a loop changes by more than a share SMOOTH of itself in NEAR steps."""
PATH_STEP, LONGEST_PATH = 0.5, 12.0
"""Bouc-Wen with an exponent takes steps of so many widths, in which Runge-Kutta errs by 1e-4; after the longest path z
is at its end."""
OVER_X, OVER_PATH, OVER_RATE, OVER_Z, OVER_SIZE, OVER_A, OVER_B, OVER_C, OF_Z, OF_RATE_TOO, OF_B, OF_C, OUT = range(13)
"""Places in the slopes of one element: over twist, its change and its rate, what is remembered, and its numbers. Of an
element with memory they are those of z; its torque over its size is `OUT`, with slopes of its own over z, v, b, c."""

UNCOUNTED: dict[str, Any] = {"_nrt": False}
"""A function that makes no arrays need not count who holds them: counting costs as much as a whole step does."""
F = TypeVar("F", bound=Callable[..., object])


def part(function: F) -> F:
    """What a compiled function calls, and is kept with."""
    made: F = numba.njit(nogil=True, error_model="numpy", **UNCOUNTED)(function)
    return made


class _Forcing(NamedTuple):
    """What drives the twist, as in `twist.Forcing`."""

    push: Array
    load: Array
    seen: Array
    pull: float
    step_s: float
    times: int


class _Numbers(NamedTuple):
    """What q numbers of the model change, as in `twist.Numbers`."""

    springs: Array
    elements: Array
    pushes: Array
    twists: Array


class _Step(NamedTuple):
    """One step, or a part of one, to be solved for its mean twist rate m: gain m + torque of the elements = known."""

    twist: float
    """at its start, as is the next"""
    rate: float
    last: float
    """twist in the middle of the step before"""
    half: float
    """half its length [s]"""
    gain: float
    known: float
    load: Array
    """(k,) what LOADED elements are multiplied by"""
    sample: int
    place: float
    """of its middle between this sample and the next, 0 to 1"""
    sag: float
    """a torque that stays for the step moves it as one that follows the curve does where it is that of a twist so much
    below the mean of the step's ends: a sixth of the step's square times the twist's acceleration"""


class _Tangents(NamedTuple):
    """What the motion so far changes by with each of q numbers."""

    twist: Array
    rate: Array
    middle: Array
    """(q,) of the rate in the middle of the last step"""
    last: Array
    """(q,) of the twist in the middle of the last step"""
    torque: Array
    """(q,) of the elements' torque in the last step"""
    z: Array
    """(q, e) of what the elements remember"""
    own: Array
    """(e,) room for one number: change of z at a motion that stays"""
    local: Array
    """(e, 13) room for the slopes of the elements"""


@part
def _integrate(
    stiffness: float,
    split: int,
    elements: Array,
    steps: Array,
    on: _Forcing,
    numbers: _Numbers,
    by: _Tangents,
    place: Array,
    z: Array,
    fresh: Array,
    means: Array,
    changes: Array,
    ends: Array,
    end_changes: Array,
) -> None:
    """All steps, into `means` (3, n), `changes`, `ends` and `end_changes`; `fresh` (e,) is room."""
    h = on.step_s
    bend = h / 6.0 if steps[0, 0, OF_RATE] > 0.0 else 0.0  # without inertia the balance holds in the middle itself
    phi, v, m, before, last = place
    every = 1 if numbers.pushes.shape[1] > len(on.push) else on.times
    for i in range(len(on.push)):
        if on.pull > 0.0:
            _hold(by, on, numbers, i)
            phi += on.pull * (on.seen[i] - phi - 0.5 * h * m)
        parts = split if _turns(elements, m, before, z, h) else 1
        ahead = 2 * m - before if parts == 1 else m
        length = h / parts
        sag = bend * (m - before) / (parts * parts)
        before = m
        move = steps[0 if parts == 1 else 1]
        for s in range(parts):
            off = (s + 0.5) / parts - 0.5
            known = _beside(on.push, i, off) - stiffness * phi + move[0, OF_RATE] * v
            between = (i % every) / every + off / every
            step = _Step(phi, v, last, length / 2, move[0, GAIN], known, on.load[i], i // every, between, sag)
            m, total = _solved(elements, step, ahead if parts == 1 else m, z, fresh)
            if len(changes):
                _carry(by, stiffness, elements, move, numbers, step, m, z, fresh)
            for p in range(len(changes)):
                _spread(changes[p], by.torque[p] / parts, i, on.times)
            last = phi + step.half * m - sag
            means[0, i] += (last + sag / 2) / parts
            means[1, i] += m / parts
            means[2, i] += total / parts
            v = move[0, END_RATE] * v + move[0, END_MEAN] * m
            phi += length * m
            for j in range(len(z)):
                z[j] = fresh[j]
        if (i + 1) % on.times == 0:
            ends[i // on.times] = phi
            for p in range(len(changes)):
                end_changes[p, i // on.times] = by.twist[p]
    place[0], place[1], place[2], place[3], place[4] = phi, v, m, before, last


@part
def _beside(signal: Array, i: int, off: float) -> float:
    """A signal a share `off` of a step from its sample i, towards the next or the one before."""
    beside = min(max(i + (1 if off > 0 else -1), 0), len(signal) - 1)
    value: float = signal[i] + abs(off) * (signal[beside] - signal[i])
    return value


@part
def _turns(elements: Array, m: float, before: float, z: Array, h: float) -> bool:
    """Whether a step must be split: friction that turns round, or a loop that turns, does so within a step or two."""
    change = abs(m - before)
    for j in range(elements.shape[0]):
        e = elements[j]
        if e[0] <= LOADED:
            if change > SMOOTH * e[2] and abs(m) < NEAR * change + 2.0 * e[2]:
                return True
        elif e[0] >= STOP and abs(math.copysign(1.0, m) - z[j]) * abs(m) * h > SMOOTH * e[2]:
            return True
    return False


@part
def _solved(elements: Array, at: _Step, guess: float, z: Array, fresh: Array) -> tuple[float, float]:
    """(twist rate, elements' torque) in the middle of a step, by Newton's method; what they remember into `fresh`."""
    m, total, step = guess, 0.0, np.inf
    low, high = -np.inf, np.inf
    for _ in range(NEWTON_STEPS):
        total, slope = 0.0, at.gain
        x = at.twist + at.half * m - at.sag
        for j in range(elements.shape[0]):
            f, over_x, over_v, fresh[j] = _torque(elements[j], x, x - at.last, m, _factor(elements[j], at.load), z[j])
            total += f
            slope += at.half * over_x + over_v
        over = at.gain * m + total - at.known
        if over > 0:
            high = m
        else:
            low = m
        newton = -over / slope if slope > LEAST_SLOPE * at.gain else -over / at.gain
        if abs(newton) < TOLERANCE:
            break
        bounded = np.isfinite(low + high)
        if bounded and (not (low < m + newton < high) or abs(newton) > 0.5 * abs(step)):
            newton = 0.5 * (low + high) - m
        step = newton
        m += step
        if abs(step) < TOLERANCE:
            break
    return m, total


# tangents


@part
def _hold(by: _Tangents, on: _Forcing, numbers: _Numbers, i: int) -> None:
    """The observer's pull on the tangents, at the start of step i."""
    at, place = i // on.times, (i % on.times) / on.times
    for p in range(len(by.twist)):
        towards = -by.twist[p] - 0.5 * on.step_s * by.middle[p] + _between(numbers.twists[p], at, place)
        by.twist[p] += on.pull * towards


@part
def _carry(
    by: _Tangents,
    stiffness: float,
    elements: Array,
    move: Array,
    numbers: _Numbers,
    step: _Step,
    m: float,
    z: Array,
    fresh: Array,
) -> None:
    """The tangents over one step that was solved: each number moves the one equation, and so its rate."""
    local, half = by.local, step.half
    steep, path, thick = _steepness(elements, step, m, z, local)
    slope = max(step.gain + half * (steep + path) + thick, LEAST_SLOPE * step.gain)
    v = step.rate
    by_spring = move[1, OF_RATE] * v - move[1, GAIN] * m - step.twist
    by_damper = move[2, OF_RATE] * v - move[2, GAIN] * m
    end_spring = move[1, END_RATE] * v + move[1, END_MEAN] * m
    end_damper = move[2, END_RATE] * v + move[2, END_MEAN] * m
    for p in range(len(by.rate)):
        spring, damper = numbers.springs[p, 0], numbers.springs[p, 1]
        rest = _moved(by, elements, numbers.elements[p], fresh, p)
        moved = move[0, OF_RATE] * by.rate[p] + spring * by_spring + damper * by_damper - rest
        moved += _between(numbers.pushes[p], step.sample, step.place)
        rate = (moved - (stiffness + steep + path) * by.twist[p] + path * by.last[p]) / slope
        spot = by.twist[p] + half * rate
        gone = spot - by.last[p]
        for j in range(len(elements)):
            if elements[j, 0] >= STOP:
                slope_z = local[j]
                by.z[p, j] = by.own[j] + slope_z[OVER_X] * spot + slope_z[OVER_PATH] * gone + slope_z[OVER_RATE] * rate
        by.torque[p] = rest + steep * spot + path * gone + thick * rate
        end = move[0, END_RATE] * by.rate[p] + move[0, END_MEAN] * rate
        by.last[p], by.middle[p] = spot, rate
        by.rate[p] = end + spring * end_spring + damper * end_damper
        by.twist[p] += 2 * half * rate


@part
def _steepness(elements: Array, step: _Step, m: float, z: Array, local: Array) -> tuple[float, float, float]:
    """What all elements' torque changes by over twist, its change and its rate; each one's slopes into `local`."""
    x = step.twist + step.half * m - step.sag
    steep, path, thick = 0.0, 0.0, 0.0
    for j in range(len(elements)):
        _slopes(elements[j], x, x - step.last, m, _factor(elements[j], step.load), z[j], local[j])
        scale = elements[j, 1] if elements[j, 0] >= STOP else 1.0
        steep += scale * local[j, OF_Z] * local[j, OVER_X]
        path += scale * local[j, OF_Z] * local[j, OVER_PATH]
        thick += scale * (local[j, OF_Z] * local[j, OVER_RATE] + local[j, OF_RATE_TOO])
    return steep, path, thick


@part
def _moved(by: _Tangents, elements: Array, bends: Array, fresh: Array, p: int) -> float:
    """What number p changes the elements' torque by while the motion of this step stays; of their z into `own`."""
    rest = 0.0
    for j in range(len(elements)):
        bent = _bent(by.local[j], bends[j])
        if elements[j, 0] >= STOP:
            by.own[j] = by.local[j, OVER_Z] * by.z[p, j] + bent
            rest += (by.local[j, OUT] if elements[j, 0] == RUB else fresh[j]) * bends[j, 0]
            further = by.local[j, OF_B] * bends[j, 2] + by.local[j, OF_C] * bends[j, 3]
            rest += elements[j, 1] * (by.local[j, OF_Z] * by.own[j] + further)
        else:
            rest += by.local[j, OVER_SIZE] * bends[j, 0] + bent
    return rest


@part
def _bent(local: Array, bend: Array) -> float:
    """What a change of an element's a, b, c changes."""
    change: float = local[OVER_A] * bend[1] + local[OVER_B] * bend[2] + local[OVER_C] * bend[3]
    return change


@part
def _between(samples: Array, at: int, place: float) -> float:
    """A signal between two of its samples."""
    value: float = (1.0 - place) * samples[at] + place * samples[at + 1]
    return value


@part
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


# the laws


@part
def _follow(elements: Array, twist: Array, rate: Array, load: Array, out: Array) -> None:
    """Add the torque of the elements along a given motion to `out` (n,)."""
    for j in range(elements.shape[0]):
        z, last = 0.0, twist[0]
        for i in range(len(twist)):
            f, _, _, z = _torque(elements[j], twist[i], twist[i] - last, rate[i], _factor(elements[j], load[i]), z)
            out[i] += f
            last = twist[i]


@part
def _factor(e: Array, load: Array) -> float:
    """What an element is multiplied by, where it is LOADED: which of them its b says."""
    factor: float = load[int(e[3])] if e[0] == LOADED else 0.0
    return factor


@part
def _torque(e: Array, x: float, dx: float, v: float, load: float, z: float) -> tuple[float, float, float, float]:
    """(torque, its slope over x, its slope over v, z) of one element [kind, size, a, b, c]; dx since the last call."""
    kind, size, a = e[0], e[1], e[2]
    if kind <= LOADED:
        f, over_v = _friction(e, v, load)
        return f, 0.0, over_v, z
    if kind == CLIP:
        return size * min(max(x, -a), a), (size if abs(x) < a else 0.0), 0.0, z
    if kind == SPRING:
        return (size + (a + e[3] * x) * x) * x, size + (2 * a + 3 * e[3] * x) * x, 0.0, z
    if kind == STOP:
        z += dx / a
        limit = max(1.0 + e[3] * x, LEAST_LIMIT)
        if abs(z) >= limit:
            z = math.copysign(limit, z)
            return size * z, size * _taper(e[3], x, z), 0.0, z
        return size * z, size / a, 0.0, z
    if kind == BOUC_WEN:
        z = _bouc_wen(z, dx / a, e[3], e[4])
        return size * z, size * _growth(math.copysign(1.0, dx) * z, 1.0 - 2.0 * e[3], e[4]) / a, 0.0, z
    z, over_x = _bristle(e, dx, v, z)
    if kind == BRISTLE:
        return size * z, over_x, 0.0, z
    y, of_z, of_v, _, _ = _rub(e, v, z)
    return size * y, of_z * over_x, size * of_v, z


@part
def _taper(b: float, x: float, z: float) -> float:
    """What the limit that a stop is at changes by over x."""
    return math.copysign(1.0, z) * b if 1.0 + b * x > LEAST_LIMIT else 0.0


@part
def _slopes(e: Array, x: float, dx: float, v: float, load: float, z: float, out: Array) -> None:
    """What the torque of one element changes by into `out` (8,), at the places OVER_X to OVER_C.

    Of elements with memory it is z that is differentiated, which the size then multiplies."""
    kind, size, a, b = e[0], e[1], e[2], e[3]
    out[:] = 0.0
    out[OF_Z] = 1.0
    if kind <= LOADED:
        _friction_slopes(e, v, load, out)
    elif kind == CLIP:
        inside = abs(x) < a
        out[OVER_X] = size if inside else 0.0
        out[OVER_SIZE] = min(max(x, -a), a)
        out[OVER_A] = 0.0 if inside else size * math.copysign(1.0, x)
    elif kind == SPRING:
        out[OVER_X] = size + (2.0 * a + 3.0 * b * x) * x
        out[OVER_SIZE], out[OVER_A], out[OVER_B] = x, x * x, x * x * x
    elif kind == STOP:
        end = z + dx / a
        if abs(end) < max(1.0 + b * x, LEAST_LIMIT):
            out[OVER_PATH], out[OVER_Z], out[OVER_A] = 1.0 / a, 1.0, -dx / a**2
        elif 1.0 + b * x > LEAST_LIMIT:
            out[OVER_X], out[OVER_B] = _taper(b, x, end), math.copysign(1.0, end) * x
    elif kind == BOUC_WEN:
        _bouc_wen_slopes(e, dx, z, out)
    else:
        _bristle_slopes(e, dx, v, z, out)
        if kind == RUB:
            out[OUT], out[OF_Z], out[OF_RATE_TOO], out[OF_B], out[OF_C] = _rub(e, v, _bristle(e, dx, v, z)[0])


@part
def _friction(e: Array, v: float, load: float) -> tuple[float, float]:
    """(torque, its slope over v) of what follows the sign of the twist rate."""
    kind, a, b = e[0], e[2], e[3]
    t = math.tanh(v / a)
    level = e[1] * load if kind == LOADED else e[1]
    slope = 0.0
    if kind == BUMP:
        level *= math.exp(-((v / b) ** 2))
        slope = -2.0 * v / b**2 * level * t
    return level * t, slope + level * (1 - t * t) / a


@part
def _friction_slopes(e: Array, v: float, load: float, out: Array) -> None:
    kind, size, a, b = e[0], e[1], e[2], e[3]
    t = math.tanh(v / a)
    bump, fall = 1.0, 0.0
    if kind == BUMP:
        bump = math.exp(-((v / b) ** 2))
        fall = -2.0 * v / b**2
        out[OVER_B] = -fall * v / b * size * bump * t
    elif kind == LOADED:
        bump = load
    steep = size * bump * (1.0 - t * t) / a
    out[OVER_RATE] = steep + fall * size * bump * t
    out[OVER_SIZE] = bump * t
    out[OVER_A] = -steep * v / a


@part
def _growth(q: float, c: float, n: float) -> float:
    """dq/da of Bouc-Wen along its direction: 1 - q^n onward, 1 - c |q|^n on the way back."""
    if q >= 0.0:
        return 1.0 - math.pow(q, n)
    return 1.0 - c * math.pow(-q, n)


@part
def _bouc_wen(z: float, x: float, rounding: float, n: float) -> float:
    """z after a straight path x; see `effects.algebra.bouc_wen_state`."""
    sign = -1.0 if x < 0 else 1.0
    a, q, c = abs(x), sign * z, 1.0 - 2.0 * rounding
    if n != 1.0:
        return sign * _bouc_wen_by_steps(q, min(a, LONGEST_PATH), c, n)
    if q < 0:
        straight = abs(c) < 1e-9
        grown = math.exp(c * a)
        after = q + a if straight else (q + 1 / c) * grown - 1 / c
        if after <= 0:
            return sign * after
        to_zero = -q if straight else -math.log1p(c * q) / c
        q, a = 0.0, max(a - to_zero, 0.0)
    return sign * (1.0 - (1.0 - q) * math.exp(-a))


@part
def _bouc_wen_by_steps(q: float, a: float, c: float, n: float) -> float:
    """q after a path a in its own direction, by Runge-Kutta: with an exponent there is no closed form."""
    steps = 1 + int(a / PATH_STEP)
    h = a / steps
    for _ in range(steps):
        k1 = _growth(q, c, n)
        k2 = _growth(q + h / 2 * k1, c, n)
        k3 = _growth(q + h / 2 * k2, c, n)
        q += h / 6 * (k1 + 2 * k2 + 2 * k3 + _growth(q + h * k3, c, n))
    return min(q, 1.0)


@part
def _bouc_wen_slopes(e: Array, dx: float, z: float, out: Array) -> None:
    """Along a flow dq/da = g(q) a start is carried on by g(end) / g(start); changed laws, by the trapezoidal rule."""
    width, rounding, n = e[2], e[3], e[4]
    x = dx / width
    sign = -1.0 if x < 0 else 1.0
    a, c = abs(x), 1.0 - 2.0 * rounding
    q0 = sign * z
    q1 = sign * _bouc_wen(z, x, rounding, n)
    g0, g1 = _growth(q0, c, n), _growth(q1, c, n)
    carried = g1 / g0 if g0 > 1e-6 else math.exp(-n * a)
    for q, weight in ((q0, carried), (q1, 1.0)):
        size = abs(q)
        if size > 1e-9:
            power = size**n
            back = q < 0.0
            out[OVER_B] += sign * weight * 0.5 * a * (2.0 * power if back else 0.0)
            out[OVER_C] -= sign * weight * 0.5 * a * power * math.log(size) * (c if back else 1.0)
    out[OVER_PATH], out[OVER_Z], out[OVER_A] = g1 / width, carried, -g1 * dx / width**2


@part
def _bristle(e: Array, dx: float, v: float, z: float) -> tuple[float, float]:
    """(z, the slope of the torque over x) of what bends until it slips."""
    size, a = e[1], e[2]
    level = 1 + (e[3] - 1) * math.exp(-((v / e[4]) ** 2))
    kept = math.exp(-abs(dx) / (a * level))
    steady = math.copysign(level, dx)
    return steady + (z - steady) * kept, size * kept / a * abs(steady - z) / level


@part
def _bristle_slopes(e: Array, dx: float, v: float, z: float, out: Array) -> None:
    a, b, c = e[2], e[3], e[4]
    bump = math.exp(-((v / c) ** 2))
    level = 1.0 + (b - 1.0) * bump
    path = abs(dx) / (a * level)
    kept = math.exp(-path)
    steady = math.copysign(level, dx)
    lag = (z - steady) * kept
    higher = math.copysign(1.0 - kept, dx) + lag * path / level
    out[OVER_PATH] = -math.copysign(1.0, dx) * lag / (a * level)
    out[OVER_RATE] = -2.0 * v / c**2 * (b - 1.0) * bump * higher
    out[OVER_Z] = kept
    out[OVER_A] = lag * path / a
    out[OVER_B] = bump * higher
    out[OVER_C] = 2.0 * v * v / c**3 * (b - 1.0) * bump * higher


@part
def _rub(e: Array, v: float, z: float) -> tuple[float, float, float, float, float]:
    """(rate at which bristles bend, times a, and its slopes over z, v, b and c)."""
    b, c = e[3], e[4]
    bump = math.exp(-((v / c) ** 2))
    level = 1.0 + (b - 1.0) * bump
    by_level = abs(v) * z / level**2
    fall = -2.0 * v / c**2 * (b - 1.0) * bump
    turned = math.copysign(1.0, v) * z / level
    return (
        v * (1.0 - turned),
        -abs(v) / level,
        1.0 - turned + by_level * fall,
        by_level * bump,
        by_level * 2.0 * v * v / c**3 * (b - 1.0) * bump,
    )


# the way in

NUMBERS, TABLES = types.CPointer(types.int64), types.CPointer(types.CPointer(types.float64))  # type: ignore[no-untyped-call]
"""What the way in takes, as C would."""


def for_c(cache: bool) -> Callable[[Callable[..., None]], Any]:
    """Compiles a function that C can call; what comes from the cache cannot be put into a file of its own."""
    made: Callable[[Callable[..., None]], Any] = numba.cfunc(
        types.void(NUMBERS, TABLES), cache=cache, nogil=True, error_model="numpy"
    )
    return made


@for_c(cache=True)
def advance(sizes: Any, tables: Any) -> None:
    """The next steps of a motion: (8,) steps, steps per sample, elements, numbers, samples of their pushes and of their
    twists, parts of a step that is split, and loads; the tables are those of `twist.simulate`, in turn."""
    n, times, e, q, pushes, twists, split = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4], sizes[5], sizes[6]
    samples, scalars = n // times, carray(tables[0], (3,))
    on = _Forcing(
        carray(tables[1], (n,)),
        carray(tables[2], (n, sizes[7])),
        carray(tables[3], (n,)),
        scalars[1],
        scalars[2],
        times,
    )
    numbers = _Numbers(
        carray(tables[4], (q, 2)),
        carray(tables[5], (q, e, 4)),
        carray(tables[6], (q, pushes)),
        carray(tables[7], (q, twists)),
    )
    still, room = carray(tables[12], (5, q)), carray(tables[14], (2, e))
    local = carray(tables[15], (e, 13))
    by = _Tangents(still[0], still[1], still[2], still[3], still[4], carray(tables[13], (q, e)), room[0], local)
    _integrate(
        scalars[0],
        split,
        carray(tables[8], (e, 5)),
        carray(tables[9], (2, 3, 4)),
        on,
        numbers,
        by,
        carray(tables[10], (5,)),
        carray(tables[11], (e,)),
        room[1],
        carray(tables[16], (3, n)),
        carray(tables[17], (q, samples)),
        carray(tables[18], (samples,)),
        carray(tables[19], (q, samples)),
    )


@for_c(cache=True)
def follow(sizes: Any, tables: Any) -> None:
    """The torque along a given motion: (3,) samples, elements, loads; the tables are those of `twist.followed`."""
    n, e = sizes[0], sizes[1]
    of, out = (carray(tables[0], (e, 5)), carray(tables[4], (n,)))
    _follow(of, carray(tables[1], (n,)), carray(tables[2], (n,)), carray(tables[3], (n, sizes[2])), out)
