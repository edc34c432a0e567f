"""What the torque of any drive is made of, whichever laws a model names: what a first look takes out of it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from edge_daemon.effects.algebra import smooth_sign, stop_operators
from edge_daemon.motion.left_over import LeftOver
from edge_daemon.motion.order_spectrum import OrderSamples, OrderScale, strongest
from edge_daemon.records import Array, Motion

WIDTHS_RAD, CREEP_SHARES, ORDERS = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1), (0.15, 0.5), (1, 2, 3, 4, 6, 8)
"""Presliding, friction at creep and ripple would pass for a delay, or for noise: angles after which elements slip,
speeds over the rms, and orders per turn of the motor."""
SIGN_RAD_S = 2e-3
"""Output speed at which a sign has reached tanh(1), as in the effects of a drive."""

MOST_WAVES = 3
"""Waves of other orders that are taken out besides: what shakes an inertia that no column holds would seem late, and
what never ceases would seem noise."""


def drive_columns(motion: Motion) -> Array:
    """(n, k) of what torque is made of in any drive; load friction of model torque, weight and inertia."""
    speed, angle = motion.velocity_out_rad_s, motion.theta_out_rad
    sign, usual = smooth_sign(speed, SIGN_RAD_S), math.sqrt(float(np.mean(speed**2)))
    loads = [motion.extra[name] for name in ("torque_model_Nm",) if name in motion.extra]
    loads += [np.sin(angle), np.cos(angle)]
    turns = [wave(m * motion.theta_in_rad) for m in ORDERS for wave in (np.sin, np.cos)]
    rows = [motion.acceleration_out_rad_s2, speed, sign, np.sqrt(np.abs(speed)) * sign, np.ones(len(motion))]
    inertia = motion.acceleration_out_rad_s2
    rows += [*loads, *turns, *(np.abs(load) * sign for load in (*loads, inertia)), *(turn * sign for turn in turns)]
    rows += [np.exp(-((speed / (share * usual)) ** 2)) * sign for share in CREEP_SHARES]
    return np.stack([*rows, *(z for z, _ in stop_operators(angle, WIDTHS_RAD, (None,) * len(WIDTHS_RAD)))], axis=1)


def waves_beside(
    motion: Motion, rows: NDArray[np.intp], cutoff_hz: float, left: LeftOver, project: Callable[[Array], Array]
) -> Array:
    """(m, w) waves over the motor's angle, of any order, that stand out of what such columns leave (m,) of the torque
    at some rows (m,) behind a filter; `project` puts columns (n, k) there. Their phase may be another one each way.
    """
    speed, waves = motion.velocity_out_rad_s, np.empty((len(rows), 0))
    pace_hz = np.abs(speed[rows]) * abs(motion.ratio) / (2 * math.pi)
    scale = OrderScale(np.ones((1, len(rows))), motion.theta_in_rad[rows], pace_hz, cutoff_hz, motion.rate_hz)
    for _ in range(MOST_WAVES):
        line = strongest(OrderSamples(scale, left))
        if line is None:
            break
        wave = np.stack([turn(line.order * motion.theta_in_rad) for turn in (np.sin, np.cos)], axis=1)
        more = project(np.nan_to_num(np.hstack((wave, wave * smooth_sign(speed, SIGN_RAD_S)[:, None]))))
        waves, left = np.hstack((waves, more)), left.beside(more)
    return waves
