"""Torques that depend on the twist or the output from instant to instant, as the simulated drive feels them.

Torque is on the output side, positive with the twist; loads on the output count negative. `steps` says what each does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from edge_daemon.gear import steps

MEMORY = {steps.BOUC_WEN: 1, steps.LUGRE: 1, steps.DAHL: 1}
"""So many numbers each law remembers, a slipping spring one more for each spring."""
SHARP = dict.fromkeys(
    (steps.STRIBECK, steps.BOUC_WEN, steps.DAHL, steps.MAXWELL_SLIP, steps.LOPSIDED_SLIP, steps.PIECEWISE), 2
)
SHARP[steps.DEAD_ZONE] = 4
"""So many times as many steps these need, because of their corners, that a number fitted to 30 s at 24 bits moves by
less than 0.3 of its deviation."""


@dataclass(frozen=True, slots=True)
class GearLaw:
    """A law that `steps` knows: a `plant.TwistTorque` that can be compiled."""

    kind: int
    numbers: tuple[float, ...]

    @property
    def start(self) -> tuple[float, ...]:
        slipping = self.kind in (steps.MAXWELL_SLIP, steps.LOPSIDED_SLIP)
        springs = len(self.numbers) // 2 if slipping else 0
        return (0.0,) * MEMORY.get(self.kind, springs)

    @property
    def fineness(self) -> int:
        """Steps that it needs where another needs one."""
        return SHARP.get(self.kind, 1)

    def at(
        self, z: Sequence[float], step_s: float, phi: float, dphi: float, speed: float, angle: float
    ) -> tuple[float, float]:
        return steps.torque_of(self.kind, self.numbers, z, step_s, phi, dphi, speed, angle)

    def grown(self, z: Sequence[float], step_s: float, dphi: float) -> Sequence[float]:
        after = [*z]
        steps.remember(self.kind, self.numbers, after, step_s, dphi)
        return after


def law(kind: int, *numbers: float) -> GearLaw:
    """A law by its kind and its numbers, in this order:

    POLYNOMIAL k1, k2; PIECEWISE two corners [rad] and the steps of stiffness there; DEAD_ZONE half gap, stiffness that
    is gone in it; COULOMB level; STRIBECK level, level at rest, speed; BOUC_WEN level, knee [rad], beta, exponent;
    MAXWELL_SLIP stiffness and limit [rad] of each spring; LUGRE level, level at rest, speed, bristles' stiffness and
    damping; DAHL level, stiffness at rest; GRAVITY size, phase; OUTPUT_FRICTION viscous, level; SPEED_WAVE size, period
    [rad/s]; TWIST_TIMES_ANGLE stiffness, order, phase; LOPSIDED_SLIP twist [rad] at which the limits are twice those
    at none, number of springs, and stiffness and limit of each.
    """
    return GearLaw(kind, numbers)
