"""A few seconds of unbroken motion, gathered from stretches as they come: what shapes are learned from.

Sampled as the light filter leaves it, and cut into pieces that are simulated side by side, with a lead in which a
simulation that starts from the measured twist forgets how it began.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_daemon.motion.filter_matrix import piece_of
from edge_daemon.motion.motor_angle import waves_of
from edge_daemon.motion.streaming import ORDERS, Stretch
from edge_daemon.records import Array

LEAD = 40
"""Each piece has so many samples before it."""


@dataclass(frozen=True, slots=True)
class Window:
    """(n,) samples each, angles at the encoders' own zeros."""

    rate_hz: float
    ratio: float
    theta_in_rad: Array
    twist_rad: Array
    """lightly filtered"""
    twist_rate_rad_s: Array
    seen_rad: Array
    """twist, not filtered"""
    acceleration_out_rad_s2: Array
    driven_rad_s2: Array
    """acceleration of the motor, seen from the output"""
    waves: Array
    """(n, 2 * len(ORDERS)) sine and cosine of each order of the motor angle"""
    wave_rates: Array
    wave_lifts: Array
    """their first and second derivatives in time"""
    starts: NDArray[np.intp]
    """(p,) where the leads of the pieces begin"""
    piece: int
    """samples of a piece, behind its lead"""
    stretches: tuple[Stretch, ...]
    """that the pieces lie in, all of one length; the first one that was gathered is only their lead"""

    @property
    def ends(self) -> NDArray[np.intp]:
        """(s,) sample behind each stretch."""
        first = self.starts[0] + LEAD
        whole = len(self.starts) * self.piece
        return np.asarray(first + whole // len(self.stretches) * np.arange(1, len(self.stretches) + 1))

    @property
    def seconds(self) -> float:
        """That the pieces last."""
        return len(self.starts) * self.piece / self.rate_hz


def window_of(stretches: Sequence[Stretch]) -> Window:
    """The first stretch is only there to begin with; all must hold `arguments` and follow each other."""
    parts = [row.arguments for row in stretches if row.arguments is not None]
    motions = [part.motion for part in parts]
    ratio, stretch, first = motions[0].ratio, parts[-1].fresh, len(motions[0])
    piece = piece_of(stretch)
    angle = np.concatenate([row.theta_in_rad for row in motions])
    bent = np.concatenate([part.twist_acceleration_rad_s2 for part in parts])
    rate = np.concatenate([row.twist_rate_rad_s for row in motions])
    speed = np.concatenate([row.velocity_out_rad_s for row in motions]) + rate
    acceleration = np.concatenate([row.acceleration_out_rad_s2 for row in motions])
    return Window(
        motions[0].rate_hz,
        ratio,
        angle,
        np.concatenate([row.twist_rad for row in motions]),
        rate,
        np.concatenate([part.twist_unfiltered_rad for part in parts]),
        acceleration,
        acceleration + bent,
        *_waves(angle, ratio * speed, ratio * (acceleration + bent)),
        np.arange(first, first + stretch * (len(parts) - 1), piece) - LEAD,
        piece,
        tuple(stretches[1:]),
    )


def _waves(angle: Array, rate: Array, acceleration: Array) -> tuple[Array, Array, Array]:
    waves, lifts = waves_of(np.column_stack((angle, rate, acceleration)))
    rates = np.empty_like(waves)
    for i, order in enumerate(ORDERS):
        rates[:, 2 * i], rates[:, 2 * i + 1] = order * rate * waves[:, 2 * i + 1], -order * rate * waves[:, 2 * i]
    return waves, rates, lifts
