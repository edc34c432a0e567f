"""The torsion of one gear with its laws, simulated: recordings are fitted with it, and live drives are predicted with
it block by block. What is compiled stands in `compiled`; this is the way in, and it asks for no compiler.

Inertia, damper and spring move exactly from step to step under the mean torque of a step (Hochbruck & Ostermann, Acta
Numerica 19 (2010), exponential integrators); the laws act with what they are in the middle of it. Without inertia it is
the implicit midpoint rule (Hairer, Lubich & Wanner 2006, Geometric Numerical Integration, II.1). Beside the motion go
its tangents, what it changes by with each number of the model: exact for the discrete motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edge_daemon.integrator import machine_code
from edge_daemon.integrator.laws import GAIN, OF_RATE, SPRING
from edge_daemon.records import Array

PARTS = 8
"""A step in which friction or a loop turns round is split into so many."""
NEARLY_CRITICAL = 1e-4
"""Below this square of the root over the step, near critical damping, a difference of hyperbolic functions is taken
from its series: it loses eight digits, and the series is good to ten."""


class TorsionGear(NamedTuple):
    """What is integrated."""

    inertia: float
    stiffness: float
    damping: float
    elements: Array
    """(e, 5) of kind, size, a, b, c"""


class Forcing(NamedTuple):
    """What drives the twist, (n,) each at the substep rate."""

    push: Array
    """torque that drives the twist [N m]"""
    load: Array
    """(n,) size of the transmitted torque [N m], or (n, k) further factors of LOADED elements beside it"""
    seen: Array
    """twist that an observer holds on to [rad]"""
    pull: float
    """gain of the observer per step; 0: there is none"""
    step_s: float
    times: int
    """steps per sample"""
    parts: int = PARTS
    """of a step in which friction or a loop turns round"""


class Numbers(NamedTuple):
    """What q numbers of the model change."""

    springs: Array
    """(q, 2) stiffness and damping"""
    elements: Array
    """(q, e, 4) size, a, b, c of the elements"""
    pushes: Array
    """(q, n // times + 1) the push at the samples, or (q, n + 1) at the steps"""
    twists: Array
    """(q, n // times + 1) the twist seen at the samples"""


class TwistState(NamedTuple):
    """Where the motion is: carried from one call to the next."""

    place: Array
    """(5,) twist and twist rate at the end of the last step, mean twist rate of it and of the one before, and twist in
    its middle"""
    z: Array
    """(e,) what the elements remember"""
    tangents: Array
    """(5, q) as `_Tangents` says"""
    tangent_z: Array
    """(q, e)"""


class TwistResponse(NamedTuple):
    """What comes of n steps."""

    twist: Array
    """(n,) mean of each step, as are the next two"""
    rate: Array
    torque: Array
    """(n,) of the elements"""
    torque_changes: Array
    """(q, n // times) what the torque changes by with each number, averaged over `times` steps about each sample"""
    ends: Array
    """(n // times,) the twist at the end of each sample's last step"""
    end_changes: Array
    """(q, n // times) what it changes by with each number"""


def nothing(elements: Array) -> Numbers:
    """No number that is asked for."""
    return Numbers(np.zeros((0, 2)), np.zeros((0, len(elements), 4)), np.zeros((0, 1)), np.zeros((0, 1)))


def at_rest(twist: float, rate: float, elements: int, numbers: int) -> TwistState:
    """A motion that begins: nothing is remembered, and no number has moved it."""
    place = np.array([twist, rate, rate, rate, twist])
    return TwistState(place, np.zeros(elements), np.zeros((5, numbers)), np.zeros((numbers, elements)))


def simulate(gear: TorsionGear, on: Forcing, numbers: Numbers, motion: TwistState) -> TwistResponse:
    """The next steps of a motion, which is carried on in place."""
    n, e, q, samples = len(on.push), len(gear.elements), len(numbers.springs), len(on.push) // on.times
    steps = steps_of(gear.inertia, np.array([gear.stiffness]), np.array([gear.damping]), on.step_s, on.parts)
    means, changes, ends, end_changes = (
        np.zeros((3, n)),
        np.zeros((q, samples)),
        np.zeros(samples),
        np.zeros((q, samples)),
    )
    scalars = np.array([gear.stiffness, on.pull, on.step_s])
    sizes = np.array([n, on.times, e, q, numbers.pushes.shape[1], numbers.twists.shape[1], on.parts, on.load.size // n])
    given = (scalars, on.push, on.load, on.seen, *numbers, gear.elements, steps)
    _enter("advance", sizes, (*given, *motion, np.empty((2, e)), np.empty((e, 13)), means, changes, ends, end_changes))
    return TwistResponse(means[0], means[1], means[2], changes, ends, end_changes)


LEAD = 16
"""Samples of what went before a recording."""


def followed(elements: Array, twist: Array, rate: Array, load: Array, came: float = 0.0) -> Array:
    """(n,) torque of the elements along a given motion; `load` (n,) or (n, k) as in `Forcing`. The twist had `came` so
    far one way before, from where nothing slipped."""
    if came:
        before = np.linspace(-came, 0.0, LEAD, endpoint=False)
        whole = np.append(twist[0] + before, twist), np.append(np.full(LEAD, rate[0]), rate)
        return followed(elements, *whole, np.concatenate((np.repeat(load[:1], LEAD, axis=0), load)))[LEAD:]
    elements = elements[(elements[:, 1] != 0.0) | (elements[:, 0] == SPRING)]  # others of no size have no torque
    torque = np.zeros(len(twist))
    _enter(
        "follow", np.array([len(twist), len(elements), load.size // len(twist)]), (elements, twist, rate, load, torque)
    )
    return torque


def _enter(name: str, sizes: Array, tables: Sequence[Array]) -> None:
    """Call a compiled function; the tables that it writes into are whole as they are."""
    whole = [np.ascontiguousarray(table, dtype=float) for table in tables]
    places = np.array([table.ctypes.data for table in whole], dtype=np.uintp)
    machine_code.entry(name)(sizes.ctypes.data, places.ctypes.data)


def steps_of(inertia: float, stiffness: Array, damping: Array, step_s: float, parts: int = PARTS) -> Array:
    """(s, 2, 3, 4) what the steps of s gears are made of, see `GAIN`: of a whole step and of one of its parts; the
    numbers, and their derivatives to stiffness and damping."""
    h = np.array([step_s, step_s / parts])[:, None]
    made = np.zeros((len(stiffness), 2, 3, 4))
    made[:, :, 0] = np.array([0.0, 0.0, -1.0, 2.0])
    made[:, :, 0, GAIN] = damping[:, None] + h[:, 0] / 2 * stiffness[:, None]
    made[:, :, 1, GAIN], made[:, :, 2, GAIN] = h[:, 0] / 2, 1.0
    if inertia > 0:
        exact = _exact_steps(inertia, stiffness, damping, h)
        made[:, :, 0, : OF_RATE + 1] += 2 * inertia / h
        usable = np.isfinite(exact).all(axis=(1, 2, 3)) & (exact[:, :, 0, GAIN] > 0).all(axis=1)
        made[usable] = exact[usable]  # the midpoint rule stays for numbers that no gear has, and a fit may try
    return made


def _exact_steps(inertia: float, stiffness: Array, damping: Array, h: Array) -> Array:
    """(s, 2, 3, 4) from the transition of twist and rate over steps of (2, 1) lengths.

    With a = damping / 2 inertia, r^2 = a^2 - stiffness / inertia, a twist rate moves the twist by
    p = exp(-a h) sinh(r h) / r, and a twist keeps c + a p of itself, where c = exp(-a h) cosh(r h)."""
    k, half = stiffness[:, None], damping[:, None] / (2 * inertia)
    square, h = half**2 - k / inertia, h[:, 0]
    made = np.empty((len(stiffness), len(h), 3, 4))
    with np.errstate(all="ignore"):
        z, still = square * h**2, np.exp(-half * h)
        near, root = np.abs(z) < NEARLY_CRITICAL, np.sqrt(square + 0j)
        slow, fast = np.exp((root - half) * h), np.exp((-root - half) * h)
        c = ((slow + fast) / 2).real
        p = np.where(near, still * h * (1 + z / 6 * (1 + z / 20)), ((slow - fast) / (2 * root)).real)
        bend = np.where(near, still * h**3 / 6 * (1 + z / 10), (h * c - p) / (2 * square))
        lost = 1 - c - half * p
        gain = h * k / lost
        made[:, :, 0] = np.stack(
            (gain, p * gain / h, c - half * p - p**2 * gain / (h * inertia), p * gain / inertia), -1
        )
        zero = np.zeros_like(half)
        moved = ((1.0, zero, zero - 1 / inertia), (0.0, zero + 1 / (2 * inertia), half / inertia))
        for row, (by_k, by_half, by_square) in enumerate(moved, start=1):
            dc, dp = by_square * h * p / 2 - by_half * h * c, by_square * bend - by_half * h * p
            dgain = (h * by_k + gain * (dc + half * dp + by_half * p)) / lost
            moment = (dp * gain + p * dgain) / h
            end_rate = dc - half * dp - by_half * p - (dp * p * gain / h + p * moment) / inertia
            made[:, :, row] = np.stack((dgain, moment, end_rate, h * moment / inertia), axis=-1)
    return made
