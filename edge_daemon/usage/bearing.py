"""Life of the wave generator bearing: the maker's cubic law and the Weibull law behind its L10 and L50.

L_h = L_n (T_r/T_av)^3 (N_r/N_av) (maker's catalogue CSF/CSG p. 14, equation 8). Two quantiles fix a Weibull law:
L50/L10 = 5 gives shape 1.17 and scale 1.368 L50.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.records import Array
from edge_daemon.usage.gears import Gear

LOAD_EXPONENT = 3.0
"""The bearing's life falls with this power of the torque (maker's catalogue p. 14)."""

COOL_DEGC, HALVES_K = 70.0, 15.0
"""Above this temperature the life of a mineral grease halves with each step (SKF, Rolling bearings, 2018, relubrication
intervals; Lugt 2013, ch. 5), and the bearing that it feeds is taken to age with it."""

HOT_DEGC, HOT_CLEAR_DEGC = 80.0, 75.0
"""Makers limit the housing of standard grease to about 80 degC."""


@dataclass(frozen=True, slots=True)
class Weibull:
    """Life in hours of use at rated torque and speed."""

    shape: float
    scale_h: float

    def remaining(self, used_h: float, probability: Array | float) -> Array:
        """Quantile of the remaining life [h] of a bearing that has survived `used_h`."""
        worn = (max(used_h, 0.0) / self.scale_h) ** self.shape
        rest = worn - np.log1p(-np.asarray(probability, dtype=float))
        return np.asarray(self.scale_h * rest ** (1.0 / self.shape) - max(used_h, 0.0))


def bearing_law(gear: Gear) -> Weibull:
    """The Weibull law through the maker's L10 and L50."""
    shape = math.log(math.log(2.0) / -math.log(0.9)) / math.log(gear.l50_h / gear.l10_h)
    return Weibull(shape, gear.l50_h / math.log(2.0) ** (1.0 / shape))


def bearing_use(gear: Gear, torque_cubic_mean_Nm: Array, speed_in_rpm: Array) -> Array:
    """Rated hours that one hour at these loads costs: (T/T_r)^3 N/N_r. Shape of the arguments."""
    load = np.abs(torque_cubic_mean_Nm) / gear.rated_torque_Nm
    return np.asarray(load**LOAD_EXPONENT * np.abs(speed_in_rpm) / gear.rated_speed_rpm)


def warmth_factor(temperature_degC: Array) -> Array:
    """How many times faster a bearing ages whose grease is this warm; 1 where it is cool, or nothing is known."""
    above = np.maximum(np.nan_to_num(np.asarray(temperature_degC, dtype=float), nan=COOL_DEGC) - COOL_DEGC, 0.0)
    return np.asarray(2.0 ** (above / HALVES_K))
