"""What a balance with one encoder needs beside the other: a filter under which its noise is white, and reversals.

Angles are differentiated twice: their noise stands in inertia times acceleration and grows with the square of the
frequency, while that of the torque is white. Both sides pass a filter of gain 1 / sqrt(1 + (f / f_c)^4), under which
the sum of the two is white (generalised least squares; Aitken 1936), so that each row counts for what it is worth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from edge_daemon.motion.kinematics import FirSet, filters
from edge_daemon.records import Array, Mask, Motion

ROUGH_HZ = 15.0
"""Cut-off of the first look at the inertia: low enough that an encoder's noise does not matter, above most motion."""
ROUGH_SHARE = 0.1
"""The same over the sampling rate, where that is low."""
LEAST_WHITE_HZ = 4.0
"""Lowest frequency from which encoder noise may count for more than the torque's: slower motion is no noise."""
TAIL = 6.0
"""Length of a whitening kernel in its time constants: what is left is 2.5e-3."""
TRANSFORM = 1 << 15
"""Samples over which the gain of a whitening filter is laid out."""
UNSURE_SD = 4.0
"""Standard deviations of the measured speed within which its sign is not known."""
TRUSTED_SD = 10.0
"""Standard deviations from zero from which the rough inertia is used."""
SEED = 5
"""Of the noise that is passed through the balance to see what it leaves."""


def rough_inertia(motion: Motion, valid: Mask) -> float:
    """Torque per acceleration of a first fit with friction, weight and a constant; 0 where none is seen."""
    fir = filters(motion.rate_hz, min(ROUGH_HZ, ROUGH_SHARE * motion.rate_hz))
    speed, angle = motion.velocity_out_rad_s, motion.theta_out_rad
    rows = [motion.acceleration_out_rad_s2, speed, np.sign(speed), np.sin(angle), np.cos(angle), np.ones(len(motion))]
    rows += [motion.extra[name] for name in ("torque_model_Nm",) if name in motion.extra]
    x = fir.apply(fir.value, np.stack([*rows, motion.torque_Nm], axis=1))[valid][:: fir.step]
    x = x[np.isfinite(x).all(axis=1)]
    if len(x) <= len(rows) + 1:
        return 0.0
    found, left, rank, _ = np.linalg.lstsq(x[:, :-1], x[:, -1], rcond=1e-10)
    if rank < len(rows) or not len(left):
        return 0.0
    inverse = np.linalg.inv(x[:, :-1].T @ x[:, :-1])
    sd = math.sqrt(float(left[0]) / (len(x) - len(rows)) * float(inverse[0, 0]))
    return float(found[0]) if found[0] > TRUSTED_SD * sd else 0.0


def whitening(fir: FirSet, corner_hz: float, power: int) -> FirSet:
    """The filter with a gain that falls as 1 / sqrt(1 + (f / corner)^(2 power)) besides, `power` times differentiated
    noise being what the corner parts from the torque's; as it is where that changes little."""
    if not corner_hz < fir.cutoff_hz:
        return fir
    corner_hz = max(corner_hz, LEAST_WHITE_HZ)
    frequency = np.fft.rfftfreq(TRANSFORM, 1 / fir.rate_hz)
    response = np.fft.irfft(1 / np.sqrt(1 + (frequency / corner_hz) ** (2 * power)))
    half = math.ceil(TAIL * math.sqrt(2) * fir.rate_hz / (2 * math.pi * corner_hz))
    bent = np.concatenate((response[-half:], response[: half + 1]))
    value = np.convolve(fir.value, bent)
    return replace(fir, value=value / value.sum())


def measured_velocity(motion: Motion) -> bool:
    """Whether the speed comes from a channel of its own."""
    column = motion.extra.get("velocity_out_rad_s")
    return column is not None and bool(np.isfinite(column).all())


def unit_noise(fir: FirSet, motion: Motion, project: Callable[[Array], Array]) -> tuple[float, float]:
    """Mean squares that white noise of one unit per sample leaves behind the balance: in a torque, and in the
    acceleration by way of the angle or the velocity."""
    unit = np.random.default_rng(SEED).normal(size=len(motion))
    bent = fir.apply(fir.first if measured_velocity(motion) else fir.second, unit)
    torque, acceleration = np.mean(project(np.stack((unit, bent), axis=1)) ** 2, axis=0)
    return float(torque), float(acceleration)
