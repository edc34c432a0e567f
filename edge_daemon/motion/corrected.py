"""Errors of the angles taken out of the twist: what the gear has of what the encoders read.

A skew is put right first and without end, not to the first order of its delay; what else errs repeats with an angle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import fft

from edge_daemon.effects.effect import Effect
from edge_daemon.records import Array, Motion

SKEW = "encoder_skew"
"""The delay of this effect also shifts the motor angle that kinematic error follows."""


KnownAngleErrors = dict[tuple[object, ...], tuple[Array, Array, Array]]
"""Key of an effect -> motor angle (n,) that it was computed for, and its angle and rate per amplitude (n, k)."""
MOST_KNOWN = 8
"""So many effects are kept, the newest: a search for waves makes one for each order that it tries
(guess)."""


def angles_of(effect: Effect, motion: Motion, known: KnownAngleErrors, delay_s: float = 0.0) -> tuple[Array, Array]:
    """(n, k) angle and its rate that an error of the angles adds per amplitude; kept in `known`, but for what a skew of
    `delay_s` passes while it lasts: the input from the stamp on, the output, beside a measured torque, up to it."""
    kept = known.get(effect.key)
    if kept is None or kept[0] is not motion.theta_in_rad:
        angle = effect.columns(motion, {"stiffness": 1.0, "damping": 0.0}, None)[0]
        rate = effect.columns(motion, {"stiffness": 0.0, "damping": 1.0}, None)[0]
        if len(known) >= MOST_KNOWN:
            del known[next(iter(known))]
        kept = known[effect.key] = motion.theta_in_rad, angle, rate
    if effect.name == SKEW and delay_s:
        span_s = -delay_s if senses(motion) else delay_s
        return mean_ahead(kept[1], span_s, motion.rate_hz), mean_ahead(kept[2], span_s, motion.rate_hz)
    return kept[1], kept[2]


def mean_ahead(columns: Array, span_s: float, rate_hz: float) -> Array:
    """(n, k) mean of each column over the `span_s` that follow (negative: that went before), band-limited; a straight
    line through the ends is averaged apart.

    The first order of a Taylor series, the value itself, is a hundred noise floors off at a millisecond.
    """
    n = len(columns)
    slope = (columns[-1] - columns[0]) / (n - 1)
    line = columns[0] + slope * np.arange(n)[:, None]
    length = fft.next_fast_len(n, real=True)
    turn = 2j * math.pi * fft.rfftfreq(length, 1 / rate_hz)[1:] * span_s
    gain = np.concatenate(([1.0], np.expm1(turn) / turn))
    mean: Array = fft.irfft(fft.rfft(columns - line, length, axis=0) * gain[:, None], length, axis=0)[:n] + line
    mean += 0.5 * slope * rate_hz * span_s
    return mean


def corrected(
    motion: Motion, effects: Sequence[Effect], amplitudes: Mapping[str, Array], known: KnownAngleErrors | None = None
) -> Motion:
    """The motion with the twist that the gear has, errors of the angles added to the twist that was read."""
    known = {} if known is None else known
    acting = sorted((row for row in effects if row.is_angle_error), key=lambda effect: effect.name != SKEW)
    angle, rate, seen = np.zeros(len(motion)), np.zeros(len(motion)), motion
    for effect in acting:  # the skew first: what repeats with the motor angle does so at the instant of the torque
        a = amplitudes[effect.name]
        angles, rates = angles_of(effect, seen, known, float(a[0]) if effect.name == SKEW else 0.0)
        if effect.name == SKEW:
            seen = _moved(motion, angles @ a)
        angle += angles @ a
        rate += rates @ a
    if not angle.any():
        return motion
    twist, twist_rate = motion.twist_rad + angle, motion.twist_rate_rad_s + rate
    return replace(seen, twist_rad=twist, twist_rate_rad_s=twist_rate)


def _moved(motion: Motion, angle: Array) -> Motion:
    """The motion with the encoder's angle that a skew took at another instant than the torque's moved to that, by what
    it passes meanwhile (n,), seen from the output."""
    if senses(motion):
        return replace(motion, theta_out_rad=motion.theta_out_rad - angle)
    return replace(motion, theta_in_rad=motion.theta_in_rad + motion.ratio * angle)


def senses(motion: Motion) -> bool:
    """Whether the output torque was measured."""
    return "torque_out_Nm" in motion.extra
