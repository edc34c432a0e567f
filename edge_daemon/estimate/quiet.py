"""An angle without the noise beside its motion: only the frequencies at which it moves are kept."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from edge_daemon.estimate import inloop
from edge_daemon.records import Array

ABOVE_NOISE = 5.0
"""amplitude of a frequency of the input over its noise from which it counts as motion"""
NEAR_HZ = 10.0
"""around such a frequency that is kept in full, and the width of the edge beside it"""


def quiet(angle: Array, noise: float, rate_hz: float) -> tuple[Array, Array]:
    """(n,) the angle, and (n,) its rate, without the frequencies at which it does not stand above white noise of sd
    `noise` per sample.

    What drives the simulated twist must not hold the noise that the error holds too: their product would be a bias.
    Loud frequencies are found under a window that leaks nothing (Nuttall 1981, IEEE Trans. ASSP 29(1), table II), and
    taken from the angle carried on by its mirror image, with soft edges: whole but for the ends.
    """
    n = len(angle)
    turn = 2 * math.pi * np.arange(n) / n
    window = 0.355768 - 0.487396 * np.cos(turn) + 0.144232 * np.cos(2 * turn) - 0.012604 * np.cos(3 * turn)
    power = np.abs(fft.rfft((angle - np.linspace(angle[0], angle[-1], n)) * window)) ** 2
    loud = np.flatnonzero(power > ABOVE_NOISE**2 * noise**2 * float(window @ window)) * (rate_hz / n)
    if not len(loud):
        return angle, inloop.slope_of(angle, rate_hz)
    mirrored = np.concatenate((angle, 2 * angle[-1] - angle[-2:0:-1]))
    slope = (angle[-1] - angle[0]) / (n - 1)
    line = angle[0] + slope * np.arange(len(mirrored))
    frequency = fft.rfftfreq(len(mirrored), 1 / rate_hz)
    away = np.abs(frequency[:, None] - loud[_nearest(loud, frequency)]).min(axis=1)
    gain = 0.5 + 0.5 * np.cos(math.pi * np.clip(away / NEAR_HZ - 1, 0, 1))
    spectrum = fft.rfft(mirrored - line) * gain
    still = fft.irfft(spectrum, len(mirrored)) + line
    rate = fft.irfft(2j * math.pi * frequency * spectrum, len(mirrored)) + slope * rate_hz
    return still[:n], rate[:n]


def _nearest(sorted_values: NDArray[np.floating], wanted: Array) -> NDArray[np.intp]:
    """(m, 2) the neighbours below and above of each wanted value."""
    above = np.searchsorted(sorted_values, wanted)
    last = len(sorted_values) - 1
    return np.stack((np.clip(above - 1, 0, last), np.clip(above, 0, last)), axis=1)
