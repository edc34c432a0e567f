"""Which teeth touch: flanks of the deformed flexspline in the spaces of the circular spline, tooth by tooth.

The rim carries its teeth as rigid bodies: each moves with the rim's outer face, radially and around, and leans with its
slope. Profiles are told by half the tooth's thickness over its height.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge_daemon.design.drawing import MM, Toothing
from edge_daemon.design.limits import PRESSURE_ANGLE
from edge_daemon.design.solve import Solved
from edge_daemon.records import Array, Mask

ADDENDUM, DEDENDUM = 0.8, 1.0
"""Of a tooth above and below its pitch line, in modules (Ivanov 1981: shortened teeth, so that tips pass)."""
HEIGHTS = 25
"""Places on a flank at which the gap is taken."""
TOUCH_SHARE = 0.02
"""Of the module: flanks nearer than this touch under load (guess: some tooth deflection)."""


@dataclass(frozen=True, slots=True)
class Engagement:
    """Teeth over a quarter from the major axis: angles [rad], depth and flank gaps [m]."""

    angles_rad: Array
    depth_m: Array
    """how far a tooth's tip stands beyond the circular spline's tips; negative where it has left"""
    gap_m: Array
    """smaller of both flanks' gaps; negative is interference, NaN where a tooth stands outside"""
    gap_leading_m: Array
    gap_trailing_m: Array
    module_m: float

    def to_json(self) -> dict[str, Any]:
        """The contract's part on teeth, and the arc itself."""
        engaged = self.depth_m > 0.0
        touching = engaged & (self.gap_m <= TOUCH_SHARE * self.module_m)
        worst = float(np.nanmin(self.gap_m)) if engaged.any() else math.nan
        play = self.gap_leading_m + self.gap_trailing_m
        return {
            "module_mm": self.module_m / MM,
            "engaged_share": _around(self.angles_rad, engaged),
            "touching_share": _around(self.angles_rad, touching),
            "engaged_to_deg": math.degrees(float(self.angles_rad[engaged].max())) if engaged.any() else 0.0,
            "depth_max_mm": float(self.depth_m.max()) / MM,
            "backlash_min_mm": float(np.nanmin(play)) / MM if engaged.any() else math.nan,
            "interference_mm": max(-worst, 0.0) / MM if math.isfinite(worst) else math.nan,
            "arc": [
                {"angle_deg": round(math.degrees(a), 2), "depth_mm": d / MM, "gap_mm": g / MM}
                for a, d, g in zip(self.angles_rad, self.depth_m.tolist(), self.gap_m.tolist(), strict=True)
            ],
        }


def _around(angles: Array, where: Mask) -> float:
    """Share of the teeth for which it holds; the first and the last stand for half a step."""
    weights = np.ones(len(angles))
    weights[[0, -1]] = 0.5
    return float(weights[where].sum() / weights.sum())


def engagement(solved: Solved) -> Engagement | None:
    """None without teeth in the file."""
    teeth = solved.drawing.teeth
    if teeth is None:
        return None
    mesh = solved.mesh
    middle = int(np.argmin(np.abs(mesh.points[: mesh.rim_stations, 0, 1] - mesh.rim_middle_m)))
    node = int(mesh.numbers[middle, -1])
    root = float(mesh.nodes[node, 0])
    module = teeth.module_mm * MM if teeth.module_mm else _own_module_m(teeth, root)
    angles = np.arange(0, teeth.flexspline // 4 + 1) * 2.0 * math.pi / teeth.flexspline
    moved = solved.displacement(angles)[:, node]
    turned = moved[:, 1] - (solved.torsion[3 * node + 1])
    return _arc(teeth, module, root, angles, moved[:, 0], turned)


def _own_module_m(teeth: Toothing, root_m: float) -> float:
    """Teeth whose roots lie on the rim."""
    return 2.0 * root_m / (teeth.flexspline - 2.0 * DEDENDUM)


def _arc(teeth: Toothing, module: float, root: float, angles: Array, out: Array, around: Array) -> Engagement:
    """The circular spline's pitch is the flexspline's at its own number of teeth: with a deflection of as many modules
    as half the difference of the numbers, the pitch lines touch at the major axis and both flanks just fit."""
    pitch_f = root + DEDENDUM * module
    pitch_c = pitch_f * teeth.circular_spline / teeth.flexspline
    half = flank(teeth, module)
    shift = pitch_f * angles * (1.0 - teeth.flexspline / teeth.circular_spline) + around
    lean = (around - np.gradient(out, angles)) / root
    heights = np.linspace(-DEDENDUM, ADDENDUM, HEIGHTS) * module
    tip_c = pitch_c - ADDENDUM * module
    depth = pitch_f + out + ADDENDUM * module - tip_c
    leading, trailing = np.full((2, len(angles)), np.nan)
    for k in np.flatnonzero(depth > 0.0):
        radius = pitch_f + heights + out[k]
        inside = radius >= tip_c
        play = 0.5 * math.pi * module - half(pitch_c - radius) - half(heights)
        centre = shift[k] + lean[k] * heights
        leading[k] = float((play - centre)[inside].min())
        trailing[k] = float((play + centre)[inside].min())
    return Engagement(angles, depth, np.fmin(leading, trailing), leading, trailing, module)


def flank(teeth: Toothing, module: float) -> Callable[[Array], Array]:
    """Half a tooth's thickness over the height above its pitch line [m].

    An involute of so many teeth is a straight flank; the S-profile is two arcs, convex above and hollow below
    (Ishikawa 1989, US patent 4823638).
    """
    slope = math.tan(math.radians(teeth.pressure_angle_deg or PRESSURE_ANGLE[teeth.profile]))
    middle = 0.25 * math.pi * module
    if teeth.profile == "involute":
        return lambda height: middle - slope * height
    bend = 0.25 * slope / module
    return lambda height: middle - slope * height - bend * np.sign(height) * height**2
