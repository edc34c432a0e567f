"""An angle without the noise beside its motion: only the frequencies at which it moves are kept."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import erfc

from edge_daemon.identify import inloop
from edge_daemon.records import Array

ABOVE_NOISE = 5.0
"""A frequency counts as motion from this amplitude over the noise's, and from so many standard deviations of the mean
power about it."""
NEAR_HZ = 5.0
"""The band of that mean reaches so far, and so much is kept in full around a frequency with motion."""
EDGE_HZ, EDGES = 1.5, 4.5
"""The edge beside it has this standard deviation and is so many of them wide: whole to 3e-6."""
REACH_S = 0.67
"""So near the ends of an angle its noise is not told from the end: the edge's answer is 3e-9 of it after."""
ALIKE = 2.0
"""The window makes so many neighbouring frequencies one."""


class BandLimit(NamedTuple):
    """An angle as it moves, (n,) samples."""

    angle: Array
    rate: Array
    gain: Array
    """(f,) share of each frequency, up to half the sampling rate, that was kept"""


def band_limited(angle: Array, noise: float, rate_hz: float) -> BandLimit:
    """An angle (n,) without the frequencies at which it does not stand above white noise of sd `noise` per sample.

    What drives the simulated twist must not hold the noise that the error holds too: their product would be a bias;
    and the noise that was taken out is none that the simulated angle answers to. Loud frequencies are found under a
    window that leaks nothing (Nuttall 1981, IEEE Trans. ASSP 29(1), table II), and taken from the angle carried on by
    its mirror image, with soft edges: whole but for `REACH_S` at the ends.
    """
    n = len(angle)
    loud = _loud(angle, noise, rate_hz)
    if not len(loud):
        return BandLimit(angle, inloop.slope_of(angle, rate_hz), np.ones(n // 2 + 1))
    mirrored = np.concatenate((angle, 2 * angle[-1] - angle[-2:0:-1]))
    slope = (angle[-1] - angle[0]) / (n - 1)
    line = angle[0] + slope * np.arange(len(mirrored))
    frequency = fft.rfftfreq(len(mirrored), 1 / rate_hz)
    spectrum = fft.rfft(mirrored - line) * _gain(loud, frequency)
    still = fft.irfft(spectrum, len(mirrored)) + line
    rate = fft.irfft(2j * math.pi * frequency * spectrum, len(mirrored)) + slope * rate_hz
    return BandLimit(still[:n], rate[:n], _gain(loud, fft.rfftfreq(n, 1 / rate_hz)))


def _loud(angle: Array, noise: float, rate_hz: float) -> Array:
    """(l,) frequencies with motion, each by itself or with those about it."""
    n = len(angle)
    turn = 2 * math.pi * np.arange(n) / n
    window = 0.355768 - 0.487396 * np.cos(turn) + 0.144232 * np.cos(2 * turn) - 0.012604 * np.cos(3 * turn)
    power = np.abs(fft.rfft((angle - np.linspace(angle[0], angle[-1], n)) * window)) ** 2
    expected = noise**2 * float(window @ window)
    alone = power > ABOVE_NOISE**2 * expected
    half = math.ceil(NEAR_HZ * n / rate_hz)
    calm = np.concatenate(([0.0], np.cumsum(np.where(alone, expected, power))))
    ends = np.clip(np.arange(len(power))[:, None] + np.array([-half, half + 1]), 0, len(power))
    count = ends[:, 1] - ends[:, 0]
    mean = (calm[ends[:, 1]] - calm[ends[:, 0]]) / count
    together = mean > expected * (1 + ABOVE_NOISE * np.sqrt(ALIKE / count))
    return np.asarray(np.flatnonzero(alone | together) * (rate_hz / n))


def _gain(loud: Array, frequency: Array) -> Array:
    """(f,) of each frequency, by its distance from those with motion on either side.

    Where two edges meet the gain must not bend: a notch with a sharp end rings far beyond `REACH_S`.
    """
    beside = _nearest(loud, frequency)
    away = np.abs(frequency[:, None] - loud[beside])
    kept = 0.5 * erfc((away - NEAR_HZ - EDGES * EDGE_HZ) / (math.sqrt(2) * EDGE_HZ))
    kept[beside[:, 0] == beside[:, 1], 1] = 0.0
    return np.asarray(1 - np.prod(1 - kept, axis=1))


def _nearest(sorted_values: NDArray[np.floating], wanted: Array) -> NDArray[np.intp]:
    """(m, 2) the neighbours below and above of each wanted value."""
    above = np.searchsorted(sorted_values, wanted)
    last = len(sorted_values) - 1
    return np.stack((np.clip(above - 1, 0, last), np.clip(above, 0, last)), axis=1)
