"""What the torque of any drive is made of, whichever laws a model names: what a first look takes out of it."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.effects.algebra import smooth_sign, stop_operators
from edge_daemon.records import Array, Motion

WIDTHS_RAD, CREEP_SHARES, ORDERS = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1), (0.15, 0.5), (1, 2, 3, 4, 6, 8)
"""Presliding, friction at creep and ripple would pass for a delay, or for noise: angles after which elements slip,
speeds over the rms, and orders per turn of the motor."""
SIGN_RAD_S = 2e-3
"""Output speed at which a sign has reached tanh(1), as in the effects of a drive."""


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
