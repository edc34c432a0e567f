"""The lines that torque and twist of a shaken gear share, and the complex stiffness at each of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.records import Array, Mask

SEGMENT_S = 2.0
"""A segment of the spectra is so long: lines half a hertz apart."""
LINE_POWER = 1e-3
"""A line counts as excited from this share of the strongest one's torque power."""
LINE_APART = 4
"""So many bins lie between lines: the main lobe of the window."""
OVERLAP_LOSS = 1.056
"""Segments that overlap by half under a Hann window are worth this much less than independent ones (Welch 1967)."""


class MethodError(BadInput):
    """One line: which method, what it lacks."""


@dataclass(frozen=True, slots=True)
class Lines:
    """(m,) per excited frequency."""

    frequency_hz: Array
    stiffness: np.ndarray[tuple[int], np.dtype[np.complex128]]
    """torque over twist: real part stiffness, imaginary part angular frequency times damping"""
    sd: Array
    coherence: Array


def longest(valid: Mask) -> slice:
    """The longest run of valid samples. Raises `MethodError` where there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], valid, [False])).astype(np.int8)))
    if not len(edges):
        raise MethodError("frequency-response: no valid stretch of motion")
    starts, ends = edges[::2], edges[1::2]
    best = int(np.argmax(ends - starts))
    return slice(int(starts[best]), int(ends[best]))


def lines_of(torque: Array, twist: Array, rate_hz: float) -> Lines:
    """Complex stiffness at the excited frequencies, and its sd from coherence (Bendat & Piersol 2010, ch. 9).

    Raises `MethodError` where the record is too short or the two share no line.
    """
    size = round(SEGMENT_S * rate_hz)
    segments = 2 * len(torque) // size - 1
    if segments < 4:
        raise MethodError(f"frequency-response: {len(torque) / rate_hz:.3g} s: expected at least {2.5 * SEGMENT_S:g} s")
    into, out = _spectra(torque, size), _spectra(twist, size)
    frequency: Array = np.fft.rfftfreq(size, 1 / rate_hz).astype(np.float64)
    input_power, output_power = (np.mean(np.abs(x) ** 2, axis=0) for x in (into, out))
    cross = np.mean(np.conj(into) * out, axis=0)
    coherence = np.abs(cross) ** 2 / np.maximum(input_power * output_power, 1e-300)
    rows = _excited(input_power, coherence)
    if not len(rows):
        raise MethodError("frequency-response: torque and twist share no line: expected a vibration")
    stiffness = input_power[rows] / cross[rows]
    seen = np.minimum(coherence[rows], 1 - 1e-12)
    averages = segments / OVERLAP_LOSS
    sd = np.abs(stiffness) * np.sqrt((1 - seen) / (2 * seen * averages))
    return Lines(frequency[rows], stiffness, sd, seen)


def _spectra(values: Array, size: int) -> np.ndarray[tuple[int, int], np.dtype[np.complex128]]:
    """(segments, bins) of half overlapping segments under a Hann window, each without its straight line."""
    pieces = np.lib.stride_tricks.sliding_window_view(values, size)[:: size // 2]
    line = np.linspace(-1.0, 1.0, size)
    level, slope = pieces.mean(axis=1), pieces @ line / (line @ line)
    window = 0.5 - 0.5 * np.cos(2 * math.pi * np.arange(size) / size)
    spectra: np.ndarray[tuple[int, int], np.dtype[np.complex128]] = np.fft.rfft(
        (pieces - level[:, None] - slope[:, None] * line) * window, axis=1
    )
    return spectra


def _excited(power: Array, coherence: Array) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Bins of the excited lines: strongest first, none within another's main lobe, returned in order."""
    left = np.where(coherence > 0.5, power, 0.0)
    left[:2] = 0.0  # the trend's own bins
    floor = LINE_POWER * left.max()
    rows: list[int] = []
    while left.max() > floor:
        top = int(np.argmax(left))
        rows.append(top)
        left[max(0, top - LINE_APART) : top + LINE_APART + 1] = 0.0
    return np.array(sorted(rows), dtype=np.intp)
