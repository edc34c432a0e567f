"""What the noise of sensors leaves of a drive's exact model, which is the same for every model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edge_daemon.balance.drive_columns import drive_columns, waves_beside
from edge_daemon.balance.motion_noise import TRANSFORM, MotionNoise
from edge_daemon.balance.one_encoder import Doubts
from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.balance.torque_noise import torque_noise
from edge_daemon.effects.algebra import derivative
from edge_daemon.motion.kinematics import FirSet
from edge_daemon.motion.left_over import LeftOver
from edge_daemon.records import Array

SEED = 5
"""Of the noise that is passed through the balance to see what it leaves."""
LOOK_DOUBT = 1.1
"""Noise over what a first look leaves at the most, whose many columns take up some of it (guess)."""


def with_floor(prepared: PreparedMotion, doubts: Doubts, noise: MotionNoise) -> PreparedMotion:
    """With the noise that torque and acceleration leave of a drive's exact model. That of a filtered current is more
    where the balance listens than near half the sampling rate."""
    unit = np.random.default_rng(SEED).normal(size=len(prepared.motion))
    drawn = np.stack((unit, noise.drawn_acceleration(doubts.turned, unit)), axis=1)
    torque, acceleration = (float(power) for power in np.mean(prepared.project(drawn) ** 2, axis=0))
    known = doubts.valid & np.isfinite(prepared.motion.torque_Nm)
    accelerated = doubts.inertia**2 * acceleration
    heard = torque_noise(prepared.motion, known, prepared.fir, accelerated)
    own = prepared.sensors.torque**2 * torque
    heard = min(heard, LOOK_DOUBT**2 * _left_by_look(prepared) - accelerated) if heard > own else own
    floor = math.sqrt(max(own, heard) + accelerated)
    frequency = np.asarray(np.fft.rfftfreq(TRANSFORM, 1 / prepared.motion.rate_hz), dtype=float)
    gains = [np.abs(np.fft.rfft(fir.value, TRANSFORM)) ** 2 for fir in (doubts.turned, prepared.fir)]
    by_frequency = noise.acceleration_power(frequency) * gains[0] * gains[1]
    shares = by_frequency / (float(by_frequency.sum()) or 1.0)
    return replace(prepared, acceleration_noise=acceleration, heard_hz=frequency, heard=shares, drive_floor=floor)


def _left_by_look(prepared: PreparedMotion) -> float:
    """Mean square that a first look leaves beside reversals: no noise is more. What happens at reversals may sound like
    noise where there is one in each window; and ripple where a controller's model torque is of the commanded motion."""
    x = np.hstack((prepared.project(np.nan_to_num(drive_columns(prepared.motion))), _swung(prepared)))
    if "torque_model_Nm" in prepared.motion.extra:
        beside, cutoff_hz = LeftOver.of(prepared.target, x), prepared.fir.cutoff_hz
        x = np.hstack((waves_beside(prepared.motion, prepared.rows, cutoff_hz, beside, prepared.project), x))
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-300
    found = np.linalg.lstsq(x / size, prepared.target, rcond=1e-8)[0]
    left = float(np.sum((prepared.target - x / size @ found) ** 2)) / max(prepared.known - len(found), 1)
    return left / _kept_of_noise(prepared.fir, *(found / size)[-2:])


def _swung(prepared: PreparedMotion) -> Array:
    """(m, 4) what a load that swings on the gear brings in: first and second derivative of acceleration and torque."""
    fir, rate_hz = prepared.fir, prepared.motion.rate_hz
    columns = list[Array]()
    for signal in (prepared.motion.acceleration_out_rad_s2, prepared.motion.torque_Nm):
        once = derivative(fir.apply(fir.value, np.nan_to_num(signal)), rate_hz)
        columns += [once, derivative(once, rate_hz)]
    return np.stack(columns, axis=1)[prepared.rows]


def _kept_of_noise(fir: FirSet, once: float, twice: float) -> float:
    """Mean square of what derivatives of a torque leave of its noise, over that noise's own behind the filter."""
    frequency = np.fft.rfftfreq(TRANSFORM, 1 / fir.rate_hz)
    power, omega = np.abs(np.fft.rfft(fir.value, TRANSFORM)) ** 2, 2 * np.pi * frequency
    return float(power @ np.abs(1 - 1j * once * omega + twice * omega**2) ** 2 / power.sum())
