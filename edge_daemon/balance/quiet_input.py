"""What drives friction without the sensors' noise: what lies above the motion in its spectrum is cut off.

Friction remembers the way that the twist went, there and back: noise of a fiftieth of its presliding a sample lets it
forget all of that in some tens of samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.motion.kinematics import filters, reflected
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
HEARD_HZ = 4.0
"""Width of the bands of which a twist passes those that are loud: its filter is as long as one period of it."""
LOUD = 30.0
"""A band of a twist, or of a torque that drives one, passes whole where its power is far more than so many times the
noise, and not at all below: noise there would move friction more than what is lost (guess: 4 to 100 do alike)."""


@dataclass(frozen=True, slots=True)
class QuietFilter:
    """What lets the loud bands of a signal pass: a Wiener filter that takes noise for more than it is."""

    kernel: Array
    """(2 d + 1,) symmetric, so that it delays nothing"""

    def __call__(self, signal: Array) -> Array:
        """(n,) of (n,); beyond its ends the signal goes on as its reflection in the end point."""
        delay = len(self.kernel) // 2
        whole = reflected(signal, delay)
        return np.convolve(whole, self.kernel, "valid")


def quiet_filter(signal: Array, noise: float, rate_hz: float) -> QuietFilter | None:
    """The filter of a signal (n,) with white noise of sd `noise` a sample, which lets what rests pass; None where there
    is no noise, or too little of a signal to tell, or to hear."""
    reach = round(rate_hz / HEARD_HZ)
    known = signal[np.isfinite(signal)]
    if not noise > 0 or len(known) < 8 * reach or len(known) < len(signal):
        return None
    bands = _band_power(known, rate_hz, HEARD_HZ)
    gain = np.maximum(0.0, 1.0 - LOUD * noise**2 / np.maximum(bands, 1e-300))
    if not gain.any():
        return None
    gain[0] = 1.0
    gain = np.max(np.stack((gain, np.append(gain[1:], 0.0), np.append(gain[0], gain[:-1]))), axis=0)
    width_hz = rate_hz / (2 * len(bands))
    at_hz = np.arange(reach + 1) * (0.5 * rate_hz / reach)
    answer = np.interp(at_hz, (np.arange(len(bands)) + 0.5) * width_hz, gain)
    kernel = np.roll(np.fft.irfft(answer, 2 * reach), reach)[1:] * np.hanning(2 * reach + 1)[1:-1]
    return QuietFilter(kernel / kernel.sum())


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
    bands, n = _band_power(angle, rate_hz, BAND_HZ), len(angle)
    width = max(1, round(BAND_HZ * n / rate_hz))
    louder = np.flatnonzero(bands > (1 + BAND_SIGMA / math.sqrt(width)) * noise**2)
    known = louder[louder < KNOWN_SHARE * n / width]
    return float((known[-1] + 1 if len(known) else 1) * width * rate_hz / n)


def _band_power(signal: Array, rate_hz: float, band_hz: float) -> Array:
    """Mean power of each band of a signal (n,) less its trend, 1 for white noise of variance 1."""
    n = len(signal)
    window = np.blackman(n)
    level = signal - np.linspace(signal[0], signal[-1], n)
    power = np.abs(np.fft.rfft((level - level.mean()) * window)) ** 2 / (window @ window)
    width = max(1, round(band_hz * n / rate_hz))
    out: Array = power[: len(power) // width * width].reshape(-1, width).mean(axis=1)
    return out
