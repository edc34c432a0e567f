"""A current or a speed that was read later or earlier than the angle, as loggers and filters make it: taken out.

A delay d of the torque leaves d dtau/dt: of a weight a drag that turns with the angle, of the inertia a jerk, of ripple
a turned phase. The likelihood of a delay is that of what a first look at the drive leaves of the shifted torque, with
friction of every form among its columns; its curvature over independent samples is the delay's standard deviation.
Reversals, where a joint that stands still is pushed before it moves, are left out as everywhere in this balance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.prepared import PreparedMotion, prepare
from edge_daemon.effects.algebra import smooth_sign, stop_operator
from edge_daemon.effects.model import Model
from edge_daemon.motion.residual_statistics import independent
from edge_daemon.records import Array, Motion

LONGEST_S, STEP_S = 0.02, 0.5e-3
DELAYS_S = np.arange(-LONGEST_S, LONGEST_S + STEP_S / 2, STEP_S)
"""Delays are looked for up to the former, in steps of the latter: beyond it no robot's log is of one instant."""
WIDTHS_RAD, CREEP_SHARES, ORDERS = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1), (0.15, 0.5), (1, 2, 3, 4, 6, 8)
"""Presliding, friction at creep and ripple would pass for a delay: angles after which elements slip, speeds over the
rms, and orders per turn of the motor."""
SIGN_RAD_S = 2e-3
"""Output speed at which a sign has reached tanh(1), as in the effects of a drive."""
LEAST_S, SURE_SD, LEAST_FALL, HALVES_S = 2e-3, 5.0, 0.05, 2e-3
"""A delay is believed from this length, so many standard deviations and such a share of the squared error that it
takes, where the halves of a recording, and all of it without the controller's model torque, differ by no more than the
last: a law that is missing has none of its own, and a model torque has a delay of its own, by which it may take the
inertia's place (guesses; on simulated joints it seemed 0.9 ms at the most, and on real ones halves agreed to 0.7 ms or
not at all)."""
LEAST_TURNS = 4
"""A motion that turns less often is one of constant speed, where ripple has any phase and torque no other."""
LEAST_OWN = 0.1
"""Share of what a delay changes that nothing else makes: 0.04 along one sine, where it is damping and inertia, 0.2
along two, 0.4 to 1 in robots' logs."""


def aligned(time_s: Array, columns: Mapping[str, Array], model: Model) -> PreparedMotion:
    """One recording ready, a drive's speed and torque at the instants of the angle. Raises `KinematicsError`."""
    trial, late_s = prepare(time_s, columns, model), dict[str, float]()
    delays = {"velocity_out_rad_s": speed_delay_of, "torque_in_Nm": delay_of, "current_in_A": delay_of}
    for name, delay in delays.items() if model.balance == "drive" else ():
        if name in columns and (found := delay(trial)):
            late_s[name] = found
            trial = prepare(time_s, columns, model, late_s=late_s, remarks=tuple(map(_told, late_s, late_s.values())))
    return trial


def _told(name: str, late_s: float) -> str:
    return f"{name} {'follows' if late_s > 0 else 'leads'} theta_out_rad by {1e3 * abs(late_s):.1f} ms: taken out"


def delay_of(trial: PreparedMotion) -> float:
    """Seconds by which the torque follows the angle, negative where it leads; 0 where that is not beyond doubt."""
    unaided = _columns(replace(trial.motion, extra={}))
    return _sure_delay(trial, trial.motion.torque_Nm, _columns(trial.motion), unaided)


def speed_delay_of(trial: PreparedMotion) -> float:
    """The same of the speed, which a filter makes late where it is recorded beside the angle."""
    moved = np.gradient(trial.motion.theta_out_rad) * trial.motion.rate_hz
    return _sure_delay(trial, trial.motion.velocity_out_rad_s, moved[:, None])


def _sure_delay(trial: PreparedMotion, late: Array, made_of: Array, *others: Array) -> float:
    """Delay of a channel (n,) that is made of columns (n, k), or of others as well."""
    motion, reach = trial.motion, math.ceil(LONGEST_S * trial.motion.rate_hz)
    speed = motion.velocity_out_rad_s[trial.rows]
    if np.count_nonzero(np.diff(np.sign(speed[np.abs(speed) > 0.1 * np.abs(speed).max(initial=0.0)]))) < LEAST_TURNS:
        return 0.0
    inside = (trial.rows >= reach) & (trial.rows < len(motion) - reach)
    y, block = trial.project(_shifted(late, motion.rate_hz))[inside], trial.block[inside]
    x, *more = (trial.project(columns)[inside] for columns in (made_of, *others))
    every = np.arange(len(x))
    looks = [(x, every), *((x, half) for half in np.array_split(every, 2)), *((columns, every) for columns in more)]
    likeliest = [_likeliest(columns[part], y[part], block[part]) for columns, part in looks]
    late_s, sd, fall = likeliest[0]
    apart = max(abs(late_s - other) for other, *_ in likeliest)
    believed = abs(late_s) > max(LEAST_S, SURE_SD * sd) and fall > LEAST_FALL and apart < HALVES_S
    return late_s if believed else 0.0


def _columns(motion: Motion) -> Array:
    """(n, k) of what torque is made of in any drive; load friction of the model torque, or of the weight's shape."""
    speed, angle = motion.velocity_out_rad_s, motion.theta_out_rad
    sign, usual = smooth_sign(speed, SIGN_RAD_S), math.sqrt(float(np.mean(speed**2)))
    loads = [motion.extra[name] for name in ("torque_model_Nm",) if name in motion.extra]
    loads += [np.sin(angle), np.cos(angle)]
    turns = [wave(m * motion.theta_in_rad) for m in ORDERS for wave in (np.sin, np.cos)]
    rows = [motion.acceleration_out_rad_s2, speed, sign, np.sqrt(np.abs(speed)) * sign, np.ones(len(motion))]
    rows += [*loads, *turns, *(np.abs(load) * sign for load in loads), *(turn * sign for turn in turns)]
    rows += [np.exp(-((speed / (share * usual)) ** 2)) * sign for share in CREEP_SHARES]
    return np.stack([*rows, *(stop_operator(angle, width, None)[0] for width in WIDTHS_RAD)], axis=1)


def _shifted(late: Array, rate_hz: float) -> Array:
    """(n, d) a channel as it was later by each of the delays, band-limited."""
    y = np.where(np.isfinite(late), late, 0.0)
    line, slope = np.linspace(y[0], y[-1], len(y)), (y[-1] - y[0]) / (len(y) - 1) * rate_hz
    spectrum, turn = np.fft.rfft(y - line), 2j * math.pi * np.fft.rfftfreq(len(y), 1 / rate_hz)
    delays = (np.fft.irfft(spectrum * np.exp(turn * d), len(y)) + line + slope * d for d in DELAYS_S)
    return np.stack(list(delays), axis=1)


def _likeliest(x: Array, y: Array, block: NDArray[np.intp]) -> tuple[float, float, float]:
    """The delay of least squared error of y (m, d) beside x (m, k), its sd, and the share of the error that it takes;
    of infinite sd where there are too few samples, it is at an end, or what it changes is made by others as well."""
    size = np.sqrt(np.mean(x**2, axis=0)) if len(x) > 2 * x.shape[1] else np.zeros(x.shape[1])
    u, s, _ = np.linalg.svd(x[:, size > 0] / size[size > 0], full_matrices=False)
    q = u[:, s > 1e-8 * s.max(initial=0.0)]
    left = y - q @ (q.T @ y)
    power = np.log(np.sum(left**2, axis=0) + 1e-300)
    best, zero = int(np.argmin(power)), len(power) // 2
    bend = np.diff(power[best - 1 : best + 2])
    if len(bend) < 2 or not bend[1] > bend[0]:
        return 0.0, math.inf, 0.0
    own, whole = (np.linalg.norm(part[:, best + 1] - part[:, best - 1]) for part in (left, y))
    if own < LEAST_OWN * whole:
        return 0.0, math.inf, 0.0
    off = -0.5 * (bend[1] + bend[0]) / (bend[1] - bend[0]) * STEP_S
    count = independent(left[:, best], block, max(2, len(x) // 20))
    sd = STEP_S * math.sqrt(2 / (count * (bend[1] - bend[0])))
    return float(DELAYS_S[best] + off), sd, -math.expm1(power[best] - power[zero])
