"""The faults of strain wave gears and of their sensors, one row each: what a fault does to which condition.

A row's signs say how far each condition moves, in units of what matters of it, when the fault has become plain. The
sources tell which conditions move and which way; how far is judgement (guess), and `posterior` takes it as such.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

RAVIOLA = "Raviola et al. (2021), Harmonic drive gear failures in industrial robots: an overview, PHM Europe 6(1)"
RANDALL = "Randall and Antoni (2011), Rolling element bearing diagnostics, MSSP 25, 485-520"
TUTTLE = "Tuttle (1992), Understanding and modeling the behavior of a harmonic drive, MIT AI-TR-1365, ch. 2"
LUGT = "Lugt (2013), Grease lubrication in rolling bearings, Wiley"
ALGEBRA = "follows from how the quantity is computed from the readings"


@dataclass(frozen=True, slots=True)
class GearFault:
    """One row. Rows of one `kind` ask for the same action; only finer sensors tell them apart."""

    name: str
    kind: str
    signs: Mapping[str, float]
    """condition -> how far it moves, in units of what matters; the others stay"""
    advice: str
    source: str
    both_ways: bool = False
    """whether the signs may all be turned round, as of a sensor whose gain may rise or fall"""
    exact: bool = False
    """whether only the signs move, and together: so errs a sensor that nothing else is computed from"""


_HEARD = {"noise_a0": 1.0, "noise_a1": 0.8, "noise_a2": 0.3, "temperature_rise": 0.3, "coulomb_friction": 0.15}
_LISTEN = "listen to the wave generator bearing, sample the grease for metal, plan a new gear"

FAULTS: tuple[GearFault, ...] = (
    GearFault(
        "flexspline crack",
        "flexspline fatigue",
        {"stiffness": -1.0, "kinematic_error": 0.3, "hysteresis_area": 0.2, "noise_a1": 0.15, "order_lobes": 0.8},
        "lower the load, inspect the flexspline for cracks, plan a new gear",
        RAVIOLA,
    ),
    GearFault(
        "bearing outer ring", "bearing wear", {**_HEARD, "order_outer": 2.0, "order_lobes": 0.4}, _LISTEN, RANDALL
    ),
    GearFault("bearing inner ring", "bearing wear", {**_HEARD, "order_inner": 2.0}, _LISTEN, RANDALL),
    GearFault("bearing ball", "bearing wear", {**_HEARD, "order_ball": 2.0, "order_cage": 0.5}, _LISTEN, RANDALL),
    GearFault("bearing cage", "bearing wear", {**_HEARD, "order_cage": 2.0, "noise_a3": 0.4}, _LISTEN, RANDALL),
    GearFault(
        "tooth wear",
        "tooth wear",
        {"kinematic_error": 0.8, "hysteresis_area": 0.6, "stiffness": -0.5, "noise_a1": 0.5, "order_teeth": 1.5},
        "sample the grease for metal, check the teeth and the lost motion, plan a new gear",
        RAVIOLA,
    ),
    GearFault(
        "lubricant starved",
        "lubricant",
        {"coulomb_friction": 1.0, "temperature_rise": 0.6, "noise_a0": 0.8, "noise_a1": 0.4, "hysteresis_area": 0.4},
        "renew the lubricant, look for leaks",
        LUGT,
    ),
    GearFault(
        "lubricant aged",
        "lubricant",
        {"coulomb_friction": 1.0, "damping": 0.7, "temperature_rise": 0.6, "hysteresis_area": 0.4, "noise_a0": 0.15},
        "renew the lubricant",
        LUGT,
    ),
    GearFault(
        "misalignment",
        "misalignment",
        {"kinematic_error": 1.0, "noise_a2": 0.6, "noise_a3": 0.5, "coulomb_friction": 0.3, "order_turn": 1.5},
        "check concentricity and squareness of the wave generator and the circular spline",
        TUTTLE,
    ),
    GearFault(
        "loose coupling",
        "loose mounting",
        {"stiffness": -1.0, "damping": 0.8, "hysteresis_area": 0.8, "noise_a3": 0.5, "noise_a4": 0.8},
        "tighten the bolts of flexspline, circular spline and couplings to the maker's torque",
        RAVIOLA,
    ),
    GearFault(
        "torque sensor gain",
        "sensor",
        {"stiffness": 3.0, "damping": 0.2, "coulomb_friction": 0.2, "hysteresis_area": 0.2},
        "check the torque sensor against a known load: all that is read in torque moved alike",
        ALGEBRA,
        both_ways=True,
        exact=True,
    ),
    GearFault(
        "sound sensor gain",
        "sensor",
        {f"noise_a{beta}": 1.0 for beta in range(5)},
        "check the sound sensor's mounting and gain: the noise moved alike at all frequencies",
        ALGEBRA,
        both_ways=True,
        exact=True,
    ),
    GearFault(
        "temperature sensor",
        "sensor",
        {"temperature_rise": 1.0, "damping": 0.6, "stiffness": 0.2, "coulomb_friction": 0.2, "noise_a0": -0.1},
        "check the temperature sensors: what hangs on warmth says that nothing became warmer",
        "follows from the baselines over temperature, which then correct for a warmth that is not there",
        both_ways=True,
    ),
    GearFault(
        "encoder off centre",
        "sensor",
        {"kinematic_error": 1.0},
        "check the encoder's disc and coupling: nothing but the angle's error grew",
        ALGEBRA,
        exact=True,
    ),
)
KINDS: tuple[str, ...] = tuple(dict.fromkeys(row.kind for row in FAULTS))
