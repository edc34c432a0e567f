"""Fatigue damage of the flexspline: dD/dN = C (tau_amp / (tau_ult (1 - gamma dK)))^m (article 2, life model).

A cycle is half a turn of the wave generator: each turn bends every point of the flexspline twice, at the stress that
the output torque sets. The maker counts its allowance of momentary peaks in the same way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.records import Array
from edge_daemon.usage.gears import Gear

CYCLES_PER_TURN = 2.0
"""The cam of the wave generator has two lobes."""
MOMENTARY_CYCLES = 1e4
"""The maker allows so many half turns at the momentary peak torque in a life (maker's catalogue CSF/CSG p. 12)."""
REPEATED_CYCLES = 1e7
"""The gear bears so many half turns at the repeated peak torque (guess: the usual knee of steel's S-N curve; the maker
says `repeatedly`)."""
GAMMA = 1.0
"""The remaining section, and so its strength, shrinks as the stiffness does (guess)."""
REPEATED_OVER_RATED = 2.1
MOMENTARY_OVER_RATED = 3.7
"""A gear whose limits are unknown has those of the catalogue's median."""
MOST_LOSS = 0.9
"""The share gamma * dK is held below this: beyond, the law's denominator means nothing."""


@dataclass(frozen=True, slots=True)
class DamageLaw:
    """`C` is damage per cycle at the ultimate torque; damage 1 is failure."""

    C: float
    m: float
    gamma: float
    ultimate_Nm: float

    def per_cycle(self, torque_amplitude_Nm: Array | float, stiffness_loss: Array | float = 0.0) -> Array:
        """dD/dN for a torque amplitude [N m] and a relative stiffness loss (0.1 = 10 % softer)."""
        weaker = 1.0 - np.clip(self.gamma * np.asarray(stiffness_loss, dtype=float), 0.0, MOST_LOSS)
        return np.asarray(self.C * (np.abs(torque_amplitude_Nm) / (self.ultimate_Nm * weaker)) ** self.m)

    def sharpened(self, stiffness_loss: Array | float, sd: Array | float) -> tuple[Array, Array]:
        """How many times as much a cycle damages as in a gear that has lost nothing, and that number's sd.

        To first order in the sd of the loss: d ln(dD/dN) / d(dK) = m gamma / (1 - gamma dK).
        """
        weaker = 1.0 - np.clip(self.gamma * np.asarray(stiffness_loss, dtype=float), 0.0, MOST_LOSS)
        factor = weaker**-self.m
        return np.asarray(factor), np.asarray(factor * self.m * self.gamma * np.asarray(sd) / weaker)

    def per_hour(
        self, torque_amplitude_Nm: Array | float, speed_in_rpm: Array | float, stiffness_loss: Array | float = 0.0
    ) -> Array:
        """dD/dt per hour at a wave generator speed [rpm]."""
        cycles = CYCLES_PER_TURN * 60.0 * np.abs(speed_in_rpm)
        return np.asarray(cycles * self.per_cycle(torque_amplitude_Nm, stiffness_loss))


def counted(gear: Gear, stiffness_loss: float, sd: float) -> str:
    """What the loss of stiffness does to the damage that is counted, in a sentence; NaN for a loss not known."""
    if not math.isfinite(stiffness_loss):
        return "no loss of stiffness is known yet: damage counts as in a gear that has lost none"
    factor, factor_sd = damage_law(gear).sharpened(max(stiffness_loss, 0.0), sd)
    times = f"{float(factor):.3g} ± {float(factor_sd):.1g} times"
    return (
        f"stiffness lost {stiffness_loss:.1%} ± {sd:.1%}: each cycle damages the flexspline {times} as much as when new"
    )


def damage_law(gear: Gear) -> DamageLaw:
    """The law through the maker's two promises: 1e4 cycles at the momentary, 1e7 at the repeated peak torque."""
    repeated = gear.repeated_peak_Nm or REPEATED_OVER_RATED * gear.rated_torque_Nm
    momentary = gear.momentary_peak_Nm or MOMENTARY_OVER_RATED * gear.rated_torque_Nm
    ultimate = gear.buckling_Nm or momentary
    m = math.log(REPEATED_CYCLES / MOMENTARY_CYCLES) / math.log(momentary / repeated)
    return DamageLaw((ultimate / momentary) ** m / MOMENTARY_CYCLES, m, GAMMA, ultimate)
