"""Tones in a spectrum: the bins that stand above its noise, and what frequency and level they add up to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from edge_daemon.records import Array, Mask

FALSE_ALARM = 1e-3
"""A spectrum without tones shows one with this chance."""
HALF_WIDTH = 2
"""A Hann main lobe reaches so many bins to either side of its centre."""
LOBE_FLOOR = 0.01
"""A neighbour of a tone with this share of its power is a tone: side lobes of the window are a thousandth."""
DIP = 0.1
"""Two tones are told apart where the power between them falls to this share of the weaker."""
LEAST_LOBED = 100
"""A spectrum of fewer bins is one of bands, which no window has spread."""


@dataclass(frozen=True, slots=True)
class Tone:
    frequency_hz: float
    level: float
    """rms, sensor unit"""


def chance_limit(averages: Array) -> Array:
    """(n,) power over the noise's density that bins of so many averages stay below."""
    each, of_bin = np.unique(averages, return_inverse=True)
    return np.asarray((gammaincinv(each, 1 - FALSE_ALARM / len(averages)) / each)[of_bin])


def near(frequency: Array, tones_hz: tuple[float, ...]) -> Mask:
    """(n,) where the main lobes of known tones lie."""
    found = np.zeros(len(frequency), dtype=bool)
    for tone_hz in tones_hz:
        at = int(np.clip(np.searchsorted(frequency, tone_hz), 1, len(frequency) - 1))
        width = frequency[at] - frequency[at - 1]
        found |= np.abs(frequency - tone_hz) < (HALF_WIDTH + 0.5) * width
    return found


def widened(marks: Mask) -> Mask:
    """Marks with the window's main lobe around them; a spectrum of few bands has none."""
    if not marks.any() or len(marks) < LEAST_LOBED:
        return marks
    wide: Mask = np.convolve(marks, np.ones(2 * HALF_WIDTH + 1), mode="same") > 0.5
    return wide


def tones_in(frequency: Array, psd: Array, model: Array, marked: Mask, width: Array) -> tuple[Tone, ...]:
    """The tones in runs of marked bins, each where its power has its middle, with its rms above the noise; strongest
    first."""
    excess = psd - model
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(np.int8), [0]])))
    found = []
    for low, high in zip(edges[::2], edges[1::2], strict=True):
        for part in _lobes(excess, int(low), int(high)):
            square = float(excess[part] @ width[part])
            top = part.start + int(np.argmax(excess[part]))
            lobe = slice(max(part.start, top - HALF_WIDTH), min(part.stop, top + HALF_WIDTH + 1))
            power = np.maximum(excess[lobe], 0.0) * width[lobe]
            if square > 0 and power.any():
                found.append(Tone(float(power @ frequency[lobe] / power.sum()), math.sqrt(square)))
    return tuple(sorted(found, key=lambda tone: -tone.level))


def _lobes(excess: Array, low: int, high: int) -> list[slice]:
    """The run cut where it dips far below what stands to either side: two tones that touch."""
    top = low + int(np.argmax(excess[low:high]))
    for side in (range(top + HALF_WIDTH, high), range(top - HALF_WIDTH, low, -1)):
        far = [i for i in side if excess[i] > LOBE_FLOOR * excess[top]]
        if len(side) <= 1 or not far:
            continue
        peak = max(far, key=lambda i: float(excess[i]))
        first, last = sorted((top, peak))
        dip = first + int(np.argmin(excess[first : last + 1]))
        if low < dip < high and excess[dip] < DIP * excess[peak]:
            return [*_lobes(excess, low, dip), *_lobes(excess, dip, high)]
    return [slice(low, high)]
