"""A design's life under loads, and the design as a gear of `life --gear`.

The wave generator's bending is the amplitude and the torque's shear the mean, so that cycles to failure are a curve
over the torque. The maker's law of `usage` goes through two promises, 1e4 cycles at the momentary and 1e7 at the
repeated peak; a design's own curve gives those two torques.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge_daemon.design.drawing import DesignError
from edge_daemon.design.limits import buckling_torque_Nm, ratcheting_torque_Nm
from edge_daemon.design.materials import KNEE_CYCLES
from edge_daemon.design.solve import Solved, twist
from edge_daemon.design.stresses import stresses_of
from edge_daemon.records import Array
from edge_daemon.usage.damage import MOMENTARY_CYCLES, REPEATED_CYCLES, REPEATED_OVER_RATED
from edge_daemon.usage.gears import Gear

TORQUES = 10
"""Points of the curve of cycles over torque, which bends little."""
PART_OF_GEAR = 0.55
"""Stiffness of a whole gear over that of its flexspline alone (guess: teeth and bearing yield as much again)."""
SOFTER_1, SOFTER_2 = 0.55, 0.87
"""K1 and K2 over K3: the catalogue's median at ratio 80 and more."""
CORNER_1, CORNER_2 = 0.135, 0.48
"""T1 and T2 over the rated torque: the catalogue's median."""
L10_H, L50_H = 7000.0, 35000.0
"""Of the wave generator's bearing, which is no part of the drawing: the maker's for its plain series."""

LoadRow = tuple[float, float, float]
"""Torque [N m], speed of the wave generator [rpm], hours or share of time."""


@dataclass(frozen=True, slots=True)
class LifeCurve:
    """What is used of the fatigue strength over the torque; Basquin's line goes on below the endurance limit."""

    torques_Nm: Array
    used: Array
    """1 / safety, rising almost in a straight line"""
    slope: float

    @property
    def endless_Nm(self) -> float:
        """Below this torque the safety is above 1; 0 where it never is."""
        return float(np.interp(1.0, self.used, self.torques_Nm)) if self.used[0] < 1.0 else 0.0

    @property
    def cycles(self) -> Array:
        """Cycles to failure at `torques_Nm`."""
        return np.asarray(KNEE_CYCLES * self.used**-self.slope)

    def at(self, torque_Nm: Array | float) -> Array:
        """Cycles at torques; beyond the last one the line goes on."""
        torque = np.abs(np.asarray(torque_Nm, dtype=float))
        rise = (self.used[-1] - self.used[-2]) / (self.torques_Nm[-1] - self.torques_Nm[-2])
        beyond = np.maximum(torque - self.torques_Nm[-1], 0.0) * rise
        used: Array = np.interp(torque, self.torques_Nm, self.used) + beyond
        return np.asarray(KNEE_CYCLES * used**-self.slope)

    def torque_for(self, cycles: float) -> float:
        """The torque that fails after so many cycles; NaN where none on the curve does."""
        logs = np.log(self.cycles)
        if not logs[-1] <= math.log(cycles) <= logs[0]:
            return math.nan
        return float(np.interp(-math.log(cycles), -logs, self.torques_Nm))


def life_curve(solved: Solved) -> LifeCurve:
    """Raises `DesignError` where the strength is not known."""
    material = solved.material
    if math.isnan(material.ultimate_Pa):
        raise DesignError("material.ultimate_MPa: a life needs it")
    unit = twist(solved.rings, 1.0)[0]
    most = material.ultimate_Pa / max(stresses_of(_loaded(solved, unit, 1.0, False)).von_mises_Pa, 1.0)
    torques = np.linspace(0.0, most, TORQUES)
    safety = np.array([stresses_of(_loaded(solved, unit, float(t))).critical.safety for t in torques])
    return LifeCurve(torques, np.maximum.accumulate(1.0 / safety), material.slope)


def _loaded(solved: Solved, unit: Array, torque_Nm: float, bent: bool = True) -> Solved:
    """The same under another torque, with or without its wave generator."""
    pressed = solved.pressed
    if not bent:
        pressed = dataclasses.replace(pressed, displacement=np.zeros_like(pressed.displacement))
    return dataclasses.replace(solved, torsion=torque_Nm * unit, torque_Nm=torque_Nm, pressed=pressed)


def life_h(curve: LifeCurve, loads: Sequence[LoadRow]) -> float:
    """Hours until damage reaches 1 (Miner) under loads that repeat; endless where no load reaches the endurance limit.

    Once one load does, those below it count as well, by the line that goes on (elementary Miner's rule).
    """
    rows = np.array(loads, dtype=float).reshape(-1, 3)
    if not rows.size or not (rows[:, 2] > 0).any() or (np.abs(rows[:, 0]) <= curve.endless_Nm).all():
        return math.inf
    per_h = float(np.sum(rows[:, 2] * 120.0 * rows[:, 1] / curve.at(rows[:, 0])) / rows[:, 2].sum())
    return 1.0 / per_h if per_h > 0.0 else math.inf


def load_rows(time_h: Array, torque_Nm: Array, speed_in_rpm: Array) -> list[LoadRow]:
    """A history's rows, each until the next one; what is not known is left out."""
    hours = np.diff(time_h, append=2 * time_h[-1] - time_h[-2])
    rows = np.column_stack([np.abs(torque_Nm), np.abs(speed_in_rpm), hours])
    return [(t, s, h) for t, s, h in rows[np.isfinite(rows).all(axis=1)].tolist() if h > 0]


def gear_of(solved: Solved, curve: LifeCurve, name: str) -> Gear:
    """The design as `life --gear` reads it. Raises `DesignError` where it fails under its wave generator alone."""
    teeth, body = solved.drawing.teeth, solved.drawing
    if teeth is None:
        raise DesignError("[teeth] is missing: a gear has a ratio")
    ratcheting, buckling = ratcheting_torque_Nm(solved), buckling_torque_Nm(solved)
    repeated = curve.torque_for(REPEATED_CYCLES)
    if math.isnan(repeated) and curve.cycles[0] < REPEATED_CYCLES:
        raise DesignError(
            f"this flexspline fails after {curve.cycles[0]:.2g} cycles under its wave generator alone: it is no gear"
        )
    known = [limit for limit in (ratcheting, buckling) if not math.isnan(limit)]
    momentary = min([curve.torque_for(MOMENTARY_CYCLES), *known], key=lambda t: math.inf if math.isnan(t) else t)
    if math.isnan(momentary):
        momentary = float(curve.torques_Nm[-1])
    repeated = min(momentary / 1.5, repeated) if not math.isnan(repeated) else momentary / 1.5
    rated = repeated / REPEATED_OVER_RATED
    stiffness = body.load.stiffness_Nm_per_rad or PART_OF_GEAR * solved.stiffness_Nm_per_rad
    return Gear(
        name=name,
        ratio=teeth.flexspline / (teeth.circular_spline - teeth.flexspline),
        rated_torque_Nm=rated,
        repeated_peak_Nm=repeated,
        momentary_peak_Nm=momentary,
        ratcheting_Nm=None if math.isnan(ratcheting) else ratcheting,
        buckling_Nm=None if math.isnan(buckling) else buckling,
        l10_h=L10_H,
        l50_h=L50_H,
        corner_1_Nm=CORNER_1 * rated,
        corner_2_Nm=CORNER_2 * rated,
        stiffness_1_Nm_per_rad=SOFTER_1 * stiffness,
        stiffness_2_Nm_per_rad=SOFTER_2 * stiffness,
        stiffness_3_Nm_per_rad=stiffness,
        source="finite elements of its drawing; bearing and teeth as usual",
    )


def gear_text(gear: Gear) -> str:
    """As TOML."""
    lines = ["# written by edge-daemon design; damage law: 1e4 cycles at the momentary, 1e7 at the repeated peak"]
    for name in gear.__struct_fields__:
        value = getattr(gear, name)
        if value is not None:
            lines.append(f"{name} = {value!r}" if isinstance(value, float) else f'{name} = "{value}"')
    return "\n".join(lines) + "\n"
