"""At which orders per turn of the wave generator a fault sings, and how loud a recording is there.

The wave generator carries the inner ring; the outer ring turns with the flexspline, the other way and ratio times
slower where the circular spline is held. A bearing's orders are those of Randall and Antoni (2011), eq. 1 to 4, times
the turn of one ring against the other. Sound or torque is laid on equal steps of the wave generator's angle, so that a
line stays sharp while the speed changes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from edge_daemon.records import Array

MOST_STEPS = 1024
"""Steps a turn, where the recording is fast enough: tooth pass of ratio 160 lies at 322 orders."""
TURNS = 32
"""Spectra over so many turns tell orders a thirty-second apart, and a slipping bearing's line stays within one."""
HARMONICS = 3
"""So many harmonics of an order are added up: a pit's blow is short."""
ASIDE = (3, 12)
"""What surrounds a line is looked at from so many to so many bins beside it."""
LEAST_PIECES = 3
"""Fewer spectra give no scatter."""
SHARP = 0.4
"""A line counts up to so many times the samples per turn: above, the recorder's filter shapes it."""


@dataclass(frozen=True, slots=True)
class Bearing:
    """Geometry of the wave generator's bearing."""

    balls: int
    ball_over_pitch: float
    """ball diameter times the cosine of the contact angle over pitch diameter"""


def orders_of(bearing: Bearing | None, ratio: float) -> dict[str, float]:
    """Line of `conditions.LINES` -> order per turn of the wave generator; without geometry only those of the gear."""
    against = 1.0 + 1.0 / ratio
    told = {"order_turn": 1.0, "order_lobes": 2.0, "order_teeth": 2.0 * (ratio + 1.0)}
    if bearing is None:
        return told
    size, balls = bearing.ball_over_pitch, bearing.balls
    return told | {
        "order_outer": 0.5 * balls * (1.0 - size) * against,
        "order_inner": 0.5 * balls * (1.0 + size) * against,
        "order_ball": (1.0 - size**2) / size * against,
        "order_cage": 0.5 * (1.0 - size) * against,
    }


def line_levels(theta_in_rad: Array, signal: Array, orders: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Name -> (logarithm of a line's power over its surroundings, sd); lines that cannot be told are absent.

    `theta_in_rad` and `signal` are (n,), in order of time; the angle may run back and forth: the longest way in one
    direction is used. An impact's ring is heard in the envelope: the higher of signal and envelope counts.
    """
    first, last = _longest_way(theta_in_rad)
    turn = np.abs(theta_in_rad[first:last] - theta_in_rad[first]) / (2.0 * math.pi)
    if turn.size < 2 or turn[-1] < TURNS * LEAST_PIECES:
        return {}
    steps = min(2 ** int(math.log2(max(turn.size / float(turn[-1]), 1.0))), MOST_STEPS)
    even = np.arange(math.floor(turn[-1] / TURNS) * TURNS * steps) / steps
    values = np.interp(even, turn, signal[first:last])
    spectra = [_spectra(part, TURNS * steps) for part in (values, _envelope(values))]
    found = {}
    for name, order in orders.items():
        harmonics = [k * order for k in range(1, HARMONICS + 1) if k * order < SHARP * steps]
        if harmonics and order * TURNS >= ASIDE[0]:
            found[name] = max(_line(spectrum, harmonics) for spectrum in spectra)
    return found


def _longest_way(theta: Array) -> tuple[int, int]:
    """The rows from and up to which the angle goes on in one direction."""
    forward = np.sign(np.diff(theta))
    ends = np.flatnonzero(np.concatenate(([True], forward[1:] != forward[:-1], [True])))
    longest = int(np.argmax(np.abs(theta[ends[1:]] - theta[ends[:-1]])))
    return int(ends[longest]), int(ends[longest + 1]) + 1


def _spectra(values: Array, length: int) -> Array:
    """(pieces, bins) power by order, a bin one over `TURNS`."""
    pieces = values.reshape(-1, length)
    window = np.hanning(length)
    return np.asarray(np.abs(np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2)


def _envelope(values: Array) -> Array:
    """Magnitude of the upper half of the orders: what blows excite."""
    spectrum = np.fft.fft(values)
    n = len(values)
    spectrum[: n // 8] = 0.0
    spectrum[n // 2 :] = 0.0
    return np.abs(np.fft.ifft(2.0 * spectrum))


def _line(spectra: Array, orders: list[float]) -> tuple[float, float]:
    """(level, sd) of the lines together."""
    mean = spectra.mean(axis=0)
    levels = []
    for order in orders:
        middle = round(order * TURNS)
        near, far = ASIDE
        around = np.concatenate(
            (mean[max(middle - far, 1) : middle - near + 1], mean[middle + near : middle + far + 1])
        )
        line = float(np.max(mean[middle - 1 : middle + 2]))
        levels.append(line / max(float(np.median(around)), 1e-300))
    level = float(np.mean(levels))
    return math.log(max(level, 1e-12)), 1.0 / math.sqrt(len(spectra) * len(orders))
