"""Which teeth carry the torque, and how much each: the gaps of the loaded flanks closed in turn by one rotation.

All teeth of a lobe turn together against the circular spline; each pushes back in proportion to how far its flank has
been pressed beyond its gap. The rim's own give between teeth is left out: in truth a few more teeth share the load.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge_daemon.design.drawing import MM, Drawing
from edge_daemon.design.teeth import Engagement
from edge_daemon.records import Array

TOOTH_N_per_m2 = 14e9
"""Force per face width and deflection of one pair of steel teeth (ISO 6336-1:2006, 5.3: 14 N per mm and um)."""
LOBES = 2
SMALLEST_SHARE = 0.001
"""A tooth with less of the torque is not listed."""


def tooth_forces(gap_m: Array, force_N: float, stiffness_N_per_m: float) -> Array:
    """(n,) forces of teeth whose flanks stand (n,) apart, when they carry a force together; NaN gaps carry nothing."""
    order = np.argsort(gap_m)
    gaps = gap_m[order][: np.isfinite(gap_m).sum()]
    closed = (force_N / stiffness_N_per_m + np.cumsum(gaps)) / np.arange(1, len(gaps) + 1)
    carrying = int(np.flatnonzero(closed > gaps).max(initial=0))
    forces = stiffness_N_per_m * np.maximum(closed[carrying] - gap_m, 0.0)
    return np.asarray(np.nan_to_num(forces))


def tooth_load(drawing: Drawing, met: Engagement) -> dict[str, Any] | None:
    """The teeth of one lobe under the drawing's torque; None without teeth in mesh or without torque.

    The leading flanks before the major axis are, by symmetry, the trailing ones behind it."""
    torque = drawing.load.torque_Nm
    gaps = np.concatenate((met.gap_trailing_m[:0:-1], met.gap_leading_m))
    angles = np.concatenate((-met.angles_rad[:0:-1], met.angles_rad))
    if drawing.teeth is None or not torque > 0.0 or not np.isfinite(gaps).any():
        return None
    radius = 0.5 * met.module_m * drawing.teeth.flexspline
    whole = torque / (LOBES * radius)
    width = (drawing.flexspline.rim_width_mm or drawing.flexspline.length_mm) * MM
    forces = tooth_forces(gaps, whole, TOOTH_N_per_m2 * width)
    loaded = angles[forces > 0.0]
    return {
        "torque_Nm": torque,
        "loaded_share": LOBES * len(loaded) / drawing.teeth.flexspline,
        "from_deg": math.degrees(float(loaded.min())),
        "to_deg": math.degrees(float(loaded.max())),
        "largest_force_N": float(forces.max()),
        "largest_share": float(forces.max() / (LOBES * whole)),
        "arc": [
            {"angle_deg": round(math.degrees(angle), 2), "force_N": force, "share": force / (LOBES * whole)}
            for angle, force in zip(angles.tolist(), forces.tolist(), strict=True)
            if force > SMALLEST_SHARE * LOBES * whole
        ],
    }
