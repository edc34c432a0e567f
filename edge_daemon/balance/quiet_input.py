"""What drives friction without the sensors' noise: what lies above the motion in its spectrum is cut off.

Friction remembers the way that the twist went, there and back: noise of a fiftieth of its presliding a sample lets it
forget all of that in some tens of samples.
"""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.motion.kinematics import FirSet, filters
from edge_daemon.records import Array, Motion

BAND_HZ, BAND_SIGMA = 0.5, 6.0
"""A band of this width holds motion where its mean power is so many standard deviations above the noise."""
QUIET_TRANSITION, QUIET_EDGES = 0.12, 4.0
"""The filter above the motion has this transition, and so many edges lie between the two: what is passed is whole to
6e-5."""
QUIET_SHARE = 0.2
"""Above this cut-off over the sampling rate nothing is gained."""
KNOWN_SHARE = 0.34
"""Above this share of the sampling rate the arguments' own filter has cut the motion off."""


LOUD = 9.0
"""A twist, or a torque that drives one, is motion where its power is so many times the noise: noise from there on would
move friction more than what is cut off (guess: 4 to 20 do alike)."""


def quiet_filter(signal: Array, noise: float, rate_hz: float) -> FirSet | None:
    """What cuts off all of a signal (n,) beyond where it is that much louder than white noise of sd `noise`; None where
    it is as loud up to where nothing is gained."""
    known = signal[np.isfinite(signal)]
    cutoff_hz = motion_ends_hz(known, math.sqrt(LOUD) * noise, rate_hz)
    if not noise > 0 or cutoff_hz > QUIET_SHARE * rate_hz:
        return None
    fir = filters(rate_hz, cutoff_hz)
    return fir if len(signal) > 4 * fir.delay else None


def quiet_input(motion: Motion, noise: float) -> Array:
    """(n,) speed of the input over the ratio without what lies above the motion: encoder noise would shake friction.

    `noise`: sd of the angle per sample. The motion ends where bands of the angle's spectrum sink to white noise; a
    smoothing filter (`kinematics.filters`) cuts above. Unchanged where the motion reaches high, and at the ends.
    """
    speed, rate_hz = motion.velocity_out_rad_s + motion.twist_rate_rad_s, motion.rate_hz
    top = motion_ends_hz(motion.theta_in_rad, noise, rate_hz)
    cutoff_hz = top / (1 - QUIET_EDGES * QUIET_TRANSITION)
    if cutoff_hz > QUIET_SHARE * rate_hz:
        return speed
    fir = filters(rate_hz, cutoff_hz, QUIET_TRANSITION)
    if len(speed) < 4 * fir.delay:
        return speed
    inside = slice(fir.delay, len(speed) - fir.delay)
    quiet = speed.copy()
    quiet[inside] = fir.apply(fir.value, speed)[inside]
    return quiet


def motion_ends_hz(angle: Array, noise: float, rate_hz: float) -> float:
    """Upper end of the highest band in which an angle holds more than white noise of sd `noise` per sample."""
    n = len(angle)
    window = np.blackman(n)
    level = angle - np.linspace(angle[0], angle[-1], n)
    power = np.abs(np.fft.rfft((level - level.mean()) * window)) ** 2 / (window @ window)
    width = max(1, round(BAND_HZ * n / rate_hz))
    bands = power[: len(power) // width * width].reshape(-1, width).mean(axis=1)
    louder = np.flatnonzero(bands > (1 + BAND_SIGMA / math.sqrt(width)) * noise**2)
    known = louder[louder < KNOWN_SHARE * n / width]
    return float((known[-1] + 1 if len(known) else 1) * width * rate_hz / n)
