"""Known faults of strain wave gears as directions in the space of conditions: which one do the drifts point to?

A direction says how far each condition moves, in units of `matters`, when the fault has become plain. They are
judgement from the articles and from bench practice, not measurements: the product says "fits", never "is".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
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


@dataclass(frozen=True, slots=True)
class Pattern:
    name: str
    direction: Mapping[str, float]
    advice: str


PATTERNS: tuple[Pattern, ...] = (
    Pattern(
        "flexspline fatigue",
        {"stiffness": -1.0, "kinematic_error": 0.3, "hysteresis_area": 0.2, "noise_a1": 0.15},
        "lower the load, inspect the flexspline for cracks, plan a new gear",
    ),
    Pattern(
        "bearing wear",
        {"noise_a0": 1.0, "noise_a1": 0.8, "noise_a2": 0.3, "temperature_rise": 0.3, "coulomb_friction": 0.15},
        "listen to the wave generator bearing, sample the grease for metal, plan a new gear",
    ),
    Pattern(
        "lubricant",
        {"coulomb_friction": 1.0, "damping": 0.6, "temperature_rise": 0.6, "hysteresis_area": 0.4, "noise_a0": 0.3},
        "renew the lubricant, look for leaks",
    ),
    Pattern(
        "misalignment",
        {"kinematic_error": 1.0, "noise_a2": 0.6, "noise_a3": 0.5, "coulomb_friction": 0.3},
        "check concentricity and squareness of the wave generator and the circular spline",
    ),
    Pattern(
        "loose mounting",
        {"stiffness": -1.0, "damping": 0.8, "hysteresis_area": 0.8, "noise_a3": 0.5, "noise_a4": 0.8},
        "tighten the bolts of flexspline and circular spline to the maker's torque",
    ),
)
LEAST_FIT = 0.6
"""A pattern must explain this share of the drift to be named (guess)."""
BLUR = 0.3
"""A real fault strays from its direction by this share of its size in each condition (guess)."""

BASELINE = 0.2
"""After a change of season a baseline of a few weeks is off by this share of what matters, beyond its own sd, as seen
over simulated years."""


@dataclass(frozen=True, slots=True)
class Match:
    pattern: Pattern
    fit: float
    """share of the weighted drift that the pattern explains, 0 to 1"""


def match(drifts: Mapping[str, tuple[float, float]]) -> Match | None:
    """The pattern that explains the drifts best; None if none explains enough.

    `drifts`: condition -> (drift, sd), both in units of `matters`; conditions that are not measured are absent.
    """
    best: Match | None = None
    most = 0.0
    size = max((abs(drift) for drift, _ in drifts.values()), default=0.0)
    if size == 0.0:
        return None
    known = {name: sd**2 + BASELINE**2 for name, (_, sd) in drifts.items()}
    weight = {name: 1.0 / (variance + (BLUR * size) ** 2) for name, variance in known.items()}
    # noise and the baseline alone would make up this much of the total: it must not count against a pattern
    total = sum(weight[name] * (drift**2 - known[name]) for name, (drift, _) in drifts.items())
    for pattern in PATTERNS:
        along = {name: pattern.direction.get(name, 0.0) for name in drifts}
        length = sum(weight[name] * along[name] ** 2 for name in drifts)
        if length == 0.0:
            continue
        amount = sum(weight[name] * along[name] * drifts[name][0] for name in drifts) / math.sqrt(length)
        explained = max(amount, 0.0) ** 2
        fit = explained / max(total, explained, 1e-12)
        if fit > LEAST_FIT and explained > most:
            best, most = Match(pattern, fit), explained
    return best
