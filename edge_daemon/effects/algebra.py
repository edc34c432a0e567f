"""What several effects share: smooth signs, derivatives, and slip states that remember."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from edge_daemon.integrator.laws import LEAST_LIMIT
from edge_daemon.records import Array, Motion

SIGN_RAD_S, SIGN_SHARE = 2e-3, 0.01
"""Output speed at which a sign has reached tanh(1), at the most and over the rms speed: it is no number of the gear,
since where the sign is not seen nothing is fitted, and one that is free bends any friction into any other. On a slow
joint the former alone rounds off a tenth of the motion, and presliding was named for it."""


def stack(*columns: Array) -> Array:
    """(n, k) from k columns of (n,)."""
    return np.stack(columns, axis=1)


def smooth_sign(speed: Array, width: float) -> Array:
    """tanh(speed / width): a sign that a lubricated contact can have."""
    return np.asarray(np.tanh(speed / width))


def direction(motion: Motion) -> Array:
    """(n,) sign of the output's speed, rounded where no friction of a drive is fitted."""
    return smooth_sign(motion.velocity_out_rad_s, rounded_over(motion))


def rubbing(motion: Motion) -> Array:
    """(n,) the same of friction that presliding beside it lets build up: as far as that has come."""
    return direction(motion) if motion.built_up is None else motion.built_up


def rounded_over(motion: Motion) -> float:
    """The speed [rad/s] at which the sign of a motion has reached tanh(1)."""
    usual = math.sqrt(float(np.nanmean(motion.velocity_out_rad_s**2)))
    return min(SIGN_RAD_S, SIGN_SHARE * usual) or SIGN_RAD_S


def followed(signal: Array, keep: Array, start: float) -> Array:
    """(n,) what follows a signal from `start` on, each sample still behind by the share `keep` (n,)."""
    return _remembered(keep, (1.0 - keep) * signal, start)


def inertia_of(motion: Motion) -> float:
    """The output inertia [kg m^2] that a torque was computed with; 0 where it was measured."""
    if "torque_out_Nm" in motion.extra:
        return 0.0
    power = float(motion.acceleration_out_rad_s2 @ motion.acceleration_out_rad_s2)
    return float(motion.acceleration_out_rad_s2 @ motion.torque_Nm) / power if power else 0.0


def derivative(signal: Array, rate_hz: float) -> Array:
    """First derivative by central differences of sixth order; lower order in the last three samples of either end.

    The error is below 1 % up to 0.2 of the sampling rate.
    """
    out: Array = np.gradient(signal) if len(signal) > 1 else np.zeros_like(signal)
    if len(signal) > 6:
        s = signal
        out[3:-3] = (45 * (s[4:-2] - s[2:-4]) - 9 * (s[5:-1] - s[1:-5]) + (s[6:] - s[:-6])) / 60
    return out * rate_hz


Slip = tuple[float, float]
"""Displacement at the last sample of the block before, and the state reached there."""


def stop_operator(displacement: Array, width: float, state: Slip | None, taper: float = 0.0) -> tuple[Array, Slip]:
    """Elasto-plastic slip element: follows the displacement, limited to +-width; in units of width, (n,) in [-1, 1].
    With a `taper` [1 / unit of the displacement] the limit grows with the displacement, 1 + taper * displacement.

    Source: Iwan (1966); Brokate & Sprekels, Hysteresis and Phase Transitions (1996).
    """
    if taper:
        return _tapered_stop(displacement, width, state, taper)
    return stop_operators(displacement, (width,), (state,))[0]


def stop_operators(
    displacement: Array, widths: Sequence[float], states: Sequence[Slip | None]
) -> list[tuple[Array, Slip]]:
    """`stop_operator` of several elements side by side, whose displacement turns at the same samples."""
    last = float(displacement[0]) if states[0] is None else states[0][0]
    before = np.append(last, displacement)
    turns = _turns(np.diff(before))
    runs, lengths = np.diff(before[np.append(turns, -1)]), np.diff(np.append(turns, len(displacement)))
    rows = []
    for width, state in zip(widths, states, strict=True):
        begun, z = _begun(runs / width, 0.0 if state is None else state[1])
        unlimited = np.repeat(begun - before[turns] / width, lengths) + displacement / width
        rows.append((np.clip(unlimited, -1.0, 1.0), (float(displacement[-1]), z)))
    return rows


def _begun(runs: Array, z: float) -> tuple[list[float], float]:
    """Where an element stands at the beginning of each run (r,) of one direction, in units of its width, and after the
    last."""
    begun = []
    for moved in runs.tolist():
        begun.append(z)
        z += moved
        if z > 1.0:  # twice as fast as `min` and `max`
            z = 1.0
        elif z < -1.0:
            z = -1.0
    return begun, z


def _turns(steps: Array) -> NDArray[np.intp]:
    """The first of each run of steps (n,) of one direction: within a run an element slips once, at its end."""
    moving = np.flatnonzero(steps)
    other = np.diff(np.signbit(steps[moving])) if len(moving) else moving.astype(bool)
    return np.append(0, moving[1:][other])


def _tapered_stop(displacement: Array, width: float, state: Slip | None, taper: float) -> tuple[Array, Slip]:
    last, z = state if state is not None else (float(displacement[0]), 0.0)
    steps = (np.diff(displacement, prepend=last) / width).tolist()
    limits = np.maximum(1.0 + taper * displacement, LEAST_LIMIT).tolist()
    out = []
    for step, limit in zip(steps, limits, strict=True):
        z += step
        if z > limit:
            z = limit
        elif z < -limit:
            z = -limit
        out.append(z)
    return np.array(out), (float(displacement[-1]), z)


def bouc_wen_state(
    displacement: Array, width: float, rounding: float, state: Slip | None, exponent: float = 1.0
) -> tuple[Array, Slip]:
    """(n,) in [-1, 1]: width * dz = dx - (rounding |dx| sgn z + (1 - rounding) dx) |z|^exponent.

    Solved exactly for straight steps where the exponent is 1, else by Runge-Kutta steps of at most half a width.
    Source: Wen (1976), J. Eng. Mech. Div. 102(2), scaled to |z| <= 1:
    rounding = beta / (beta + gamma), width = 1 / (beta + gamma) at exponent 1.
    """
    last, z = state if state is not None else (float(displacement[0]), 0.0)
    change = np.diff(displacement, prepend=last) / width
    length = np.abs(change)
    c = 1.0 - 2.0 * rounding
    signs = np.where(change < 0, -1.0, 1.0).tolist()
    onward = np.exp(-length).tolist()
    back = np.exp(c * length).tolist()
    out = []
    for i, (sign, a) in enumerate(zip(signs, length.tolist(), strict=True)):
        q = sign * z
        if exponent != 1.0:
            q = _bent(q, min(a, LONGEST_PATH), c, exponent)
        else:
            q = 1.0 - (1.0 - q) * onward[i] if q >= 0 else _unload(q, a, c, back[i])
        z = sign * q
        out.append(z)
    return np.array(out), (float(displacement[-1]), z)


PATH_STEP, LONGEST_PATH = 0.5, 12.0
"""Bouc-Wen with an exponent takes steps of so many widths, in which Runge-Kutta errs by 1e-4; after the longest path z
is at its end."""


def _bent(q: float, a: float, c: float, n: float) -> float:
    """dq/da = 1 - q^n onward, 1 - c |q|^n from a negative q, over a path a."""

    def growth(q: float) -> float:
        power: float = abs(q) ** n
        return 1.0 - power if q >= 0 else 1.0 - c * power

    steps = 1 + int(a / PATH_STEP)
    h = a / steps
    for _ in range(steps):
        k1 = growth(q)
        k2 = growth(q + h / 2 * k1)
        k3 = growth(q + h / 2 * k2)
        q += h / 6 * (k1 + 2 * k2 + 2 * k3 + growth(q + h * k3))
    return min(q, 1.0)


def _unload(q: float, a: float, c: float, grown: float) -> float:
    """dq/da = 1 + c q from a negative q over a path a; past zero it goes on as dq/da = 1 - q."""
    straight = abs(c) < 1e-9
    after = q + a if straight else (q + 1 / c) * grown - 1 / c
    if after <= 0:
        return after
    to_zero = -q if straight else -math.log1p(c * q) / c
    return 1.0 - math.exp(-max(a - to_zero, 0.0))


def bristle_state(displacement: Array, reach: Array, level: Array, state: Slip | None) -> tuple[Array, Slip]:
    """(n,) bristle force over the Coulomb level: reach * dz = dx - |dx| z / level, `level` (n,) the steady value.

    Source: Canudas de Wit et al. (1995), IEEE TAC 40(3), eq. 1-3, written over displacement instead of time.
    """
    last, before = state if state is not None else (float(displacement[0]), 0.0)
    change = np.diff(displacement, prepend=last)
    kept = np.exp(-np.abs(change) / (reach * level))
    z = _remembered(kept, (1.0 - kept) * np.where(change < 0, -level, level), before)
    return z, (float(displacement[-1]), float(z[-1]))


def _remembered(kept: Array, given: Array, start: float) -> Array:
    """(n,) z_i = kept_i z_(i-1) + given_i, with z before the first of them."""
    given = given.copy()
    given[0] += kept[0] * start
    rows = np.stack((np.ones(len(kept)), -np.append(kept[1:], 0.0)))
    return np.asarray(dtbtrs(rows, given[:, None], uplo="L")[0][:, 0])


Swing = tuple[float, float, float, float]
"""The last two samples of what drives a mass behind a spring, the newest first, and of what came of it."""
MOST_SWING = 0.45
"""Frequency over the sampling rate up to which a swing is followed: beyond, the mass moves with what drives it."""


def swung(
    signal: Array, rate_hz: float, frequency_hz: float, damping: float, state: Swing | None
) -> tuple[Array, Swing]:
    """(n,) by how much the acceleration of a mass behind a spring and a damper differs from that of the near end.

    -s^2 / (s^2 + 2 d w s + w^2), by the bilinear transform, exact at w (Oppenheim & Schafer 2010, section 7.2).
    """
    if frequency_hz > MOST_SWING * rate_hz:
        return np.zeros_like(signal), state or (0.0, 0.0, 0.0, 0.0)
    known = np.nan_to_num(signal)
    x1, x2, y1, y2 = state or (float(known[0]), float(known[0]), 0.0, 0.0)
    c = math.tan(math.pi * frequency_hz / rate_hz)
    lead, trail, whole = 1 + 2 * damping * c + c * c, 1 - 2 * damping * c + c * c, 2 * (c * c - 1)
    before = np.concatenate(((x2, x1), known))
    given = -np.diff(before, 2) / lead
    given[0] -= (whole * y1 + trail * y2) / lead
    if len(given) > 1:
        given[1] -= trail * y1 / lead
    rows = np.stack([np.full(len(given), number) for number in (1.0, whole / lead, trail / lead)])
    swing = np.asarray(dtbtrs(rows, given[:, None], uplo="L")[0][:, 0])
    last, past = np.append((x2, x1), known)[-2:], np.append((y2, y1), swing)[-2:]
    return swing, (float(last[1]), float(last[0]), float(past[1]), float(past[0]))


def swing_gain(frequency_hz: Array, own_hz: float, damping: float) -> NDArray[np.complex128]:
    """(n,) what `swung` makes of a signal by its frequency."""
    s = 1j * frequency_hz / own_hz
    return np.asarray(-(s**2) / (s**2 + 2 * damping * s + 1))


def dearer_by(columns: Array, own: int, others: slice) -> float:
    """Deviation of one amplitude over that which it would have, were those of some other columns (n, k) known."""
    size = np.linalg.norm(columns, axis=0)
    x = columns / (size + (size == 0.0))  # nothing of an effect that the motion does not reach
    known = np.delete(x, others, axis=1)
    at = own - len(range(*others.indices(x.shape[1]))) * (own > others.start)
    most, least = np.linalg.pinv(x.T @ x)[own, own], np.linalg.pinv(known.T @ known)[at, at]
    return float(np.sqrt(most / least))


def own_power(products: Array, i: int) -> float:
    """What the other columns do not make of one of them, by their products (k, k), as that column squared is: a
    controller's model torque and a weight make all of an inertia's but its noise, which then tells nothing."""
    others = np.arange(len(products)) != i
    vector = products[others, i]
    made = vector @ np.linalg.lstsq(products[np.ix_(others, others)], vector, rcond=1e-12)[0]
    return max(float(products[i, i] - made), 0.0)
