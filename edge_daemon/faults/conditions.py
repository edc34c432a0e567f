"""What is watched of a gear, and how much of a change is worth telling."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Condition:
    """An estimate that is watched; its logarithm if `relative`."""

    name: str
    relative: bool
    matters: float
    """the smallest change worth telling: relative, or in the condition's own unit"""
    meaning: str


CONDITIONS: tuple[Condition, ...] = (
    Condition("stiffness", True, 0.01, "stiffness"),
    Condition("damping", True, 0.15, "damping of the twist"),
    Condition("coulomb_friction", True, 0.15, "friction"),
    Condition("hysteresis_area", True, 0.15, "hysteresis loop"),
    Condition("kinematic_error", True, 0.10, "kinematic error"),
    Condition("noise_a0", True, 0.25, "noise at high frequency"),
    Condition("noise_a1", True, 0.25, "noise, slope 1"),
    Condition("noise_a2", True, 0.25, "noise, slope 2"),
    Condition("noise_a3", True, 0.25, "noise, slope 3"),
    Condition("noise_a4", True, 0.25, "noise at low frequency"),
    Condition("ratio", True, 1e-4, "transmission ratio"),
    Condition("temperature_rise", False, 5.0, "temperature above ambient"),
)
"""A technician would act on changes of this size, and half of it never raises an alarm (guess)."""
LINES: tuple[Condition, ...] = (
    Condition("order_outer", True, 0.7, "line of the bearing's outer ring"),
    Condition("order_inner", True, 0.7, "line of the bearing's inner ring"),
    Condition("order_ball", True, 0.7, "line of the bearing's balls"),
    Condition("order_cage", True, 0.7, "line of the bearing's cage"),
    Condition("order_lobes", True, 0.7, "twice a turn of the wave generator"),
    Condition("order_turn", True, 0.7, "once a turn of the wave generator"),
    Condition("order_teeth", True, 0.7, "tooth pass"),
)
"""Power of a line at an order per turn of the wave generator; doubled, it can be told by eye (guess)."""
KNOWN = {row.name: row for row in (*CONDITIONS, *LINES)}
