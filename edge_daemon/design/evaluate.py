"""A design's figures: the one document that `evaluate`, `optimise`, `compare` and the report read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge_daemon.design.drawing import MM, Drawing
from edge_daemon.design.limits import buckling_torque_Nm, natural_frequencies, ratcheting_torque_Nm
from edge_daemon.design.solve import LINE_SHARE, Solved, solve, wall_shear_Pa
from edge_daemon.design.stresses import TURN_STEPS, Fatigue, Stresses, stresses_of, yield_safety
from edge_daemon.design.teeth import Engagement, engagement
from edge_daemon.design.tooth_load import tooth_load

COARSE = 2.0 / 3.0
"""Fineness of the second mesh, which tells how far the first is from its limit: two elements for each three."""


@dataclass(frozen=True, slots=True)
class Figures:
    """What F and its constraints are made of: stresses [Pa], lengths [m]."""

    solved: Solved
    stresses: Stresses
    deflection_m: float
    shear_Pa: float
    objective: float

    @property
    def mass_kg(self) -> float:
        return self.solved.volume_m3 * self.solved.material.density_kg_m3


def figures(drawing: Drawing, fineness: float = 1.0) -> Figures:
    """One solution and what it says. Raises `DesignError`."""
    solved = solve(drawing, fineness)
    stresses = stresses_of(solved)
    angles = math.pi * np.arange(TURN_STEPS) / TURN_STEPS
    deflection = float(np.sqrt((solved.displacement(angles) ** 2).sum(axis=2)).max())
    objective = objective_of(drawing, stresses.von_mises_Pa, deflection, solved.volume_m3)
    return Figures(solved, stresses, deflection, wall_shear_Pa(drawing), objective)


def objective_of(drawing: Drawing, von_mises_Pa: float, deflection_m: float, volume_m3: float) -> float:
    """F = w1 sigma_max [MPa] + w2 delta_max [mm] + w3 V [mm3] (article 2)."""
    parts = (von_mises_Pa * 1e-6, deflection_m / MM, volume_m3 / MM**3)
    return sum(weight * part for weight, part in zip(drawing.optimise.weights, parts, strict=True))


def evaluate(drawing: Drawing) -> dict[str, Any]:
    """The JSON of `design evaluate`."""
    found, coarse = figures(drawing), figures(drawing, COARSE)
    solved, material = found.solved, found.solved.material
    teeth = engagement(solved)
    fatigue = [place for place in (found.stresses.rim, found.stresses.diaphragm) if place]
    return {
        **headline(found),
        "stress_hoop_max_MPa": found.stresses.hoop_Pa * 1e-6,
        "stress_principal_max_MPa": found.stresses.principal_max_Pa * 1e-6,
        "where_principal_max": found.stresses.principal_max_spot.to_json(),
        "stress_principal_min_MPa": found.stresses.principal_min_Pa * 1e-6,
        "where_principal_min": found.stresses.principal_min_spot.to_json(),
        "fatigue": [_fatigue(place, solved) for place in fatigue],
        "safety_yield": yield_safety(material, found.stresses.von_mises_Pa),
        "buckling_Nm": buckling_torque_Nm(solved),
        "ratcheting_Nm": ratcheting_torque_Nm(solved),
        "natural_frequencies": [
            {"harmonic": mode.harmonic, "frequency_hz": mode.frequency_hz} for mode in natural_frequencies(solved.rings)
        ],
        "teeth": {**teeth.to_json(), "load": tooth_load(drawing, teeth)} if teeth else None,
        "contact": _contact(solved),
        "material": {"name": material.name, "surface": material.surface, "source": material.source},
        "weights": list(drawing.optimise.weights),
        "mesh": {
            "elements": int(solved.mesh.elements.shape[1]),
            "nodes": len(solved.rings.nodes),
            "harmonics": [int(n) for n in solved.pressed.harmonics],
            "change_on_refinement": _changes(headline(coarse), headline(found)),
        },
        "notes": [*notes(found), *_clash(teeth)],
    }


def headline(found: Figures) -> dict[str, Any]:
    """The contract's own figures."""
    solved, stresses = found.solved, found.stresses
    return {
        "stress_bending_MPa": stresses.bending_Pa * 1e-6,
        "stress_shear_MPa": found.shear_Pa * 1e-6,
        "stress_von_mises_max_MPa": stresses.von_mises_Pa * 1e-6,
        "where": stresses.spot.to_json(),
        "deflection_max_mm": found.deflection_m / MM,
        "volume_mm3": solved.volume_m3 / MM**3,
        "mass_kg": found.mass_kg,
        "torsional_stiffness_Nm_per_rad": solved.stiffness_Nm_per_rad,
        "safety_fatigue": stresses.critical.safety,
        "objective": found.objective,
    }


def _changes(coarse: dict[str, Any], fine: dict[str, Any]) -> dict[str, float]:
    """Relative change of each figure from the coarser mesh to the one that is told."""
    return {
        key: fine[key] / coarse[key] - 1.0
        for key, value in fine.items()
        if isinstance(value, float) and math.isfinite(value) and coarse[key]
    }


def _fatigue(place: Fatigue, solved: Solved) -> dict[str, Any]:
    cycles = solved.material.cycles(place.amplitude_Pa, place.mean_Pa)
    speed = solved.drawing.load.speed_in_rpm
    return {
        "region": place.region,
        "where": place.spot.to_json(),
        "amplitude_MPa": place.amplitude_Pa * 1e-6,
        "mean_MPa": place.mean_Pa * 1e-6,
        "safety": place.safety,
        "cycles_to_failure": cycles,
        "life_h": cycles / (120.0 * speed) if speed else math.inf,
    }


def _contact(solved: Solved) -> dict[str, Any]:
    """Under which contact the stresses hold, and where it presses hardest."""
    pressed, generator = solved.pressed, solved.drawing.wave_generator
    line = pressed.force_N_per_rad.sum(axis=0)
    return {
        "kind": generator.contact,
        "width_mm": solved.contact_width_mm,
        "bearing_stiffness_N_per_mm3": generator.bearing_stiffness_N_per_mm3,
        "shape": generator.shape,
        "angles_deg": [round(math.degrees(angle), 3) for angle in pressed.angles_rad],
        "force_N_per_mm": (line / (float(solved.mesh.points[0, 0, 0]) / MM)).tolist(),
        "touching_share": float((line > 1e-6 * np.abs(line).max()).mean()),
    }


def _clash(teeth: Engagement | None) -> list[str]:
    """Teeth that do not part at the minor axis."""
    if teeth is None or teeth.depth_m[-1] <= 0.0:
        return []
    return ["the teeth do not part at the minor axis: with this deflection it cannot be put together"]


def notes(found: Figures) -> list[str]:
    """What a reader has to know to use the figures."""
    drawing, told = found.solved.drawing, []
    generator = drawing.wave_generator
    if generator.contact == "one-sided" and generator.contact_width_mm is None:
        width = found.solved.contact_width_mm
        told.append(f"contact_width_mm is not given: {width:.3g} mm, {LINE_SHARE:.0%} of the rim, were taken")
    if generator.contact == "one-sided" and generator.bearing_stiffness_N_per_mm3 is None:
        told.append("the bearing is taken as rigid: bearing_stiffness_N_per_mm3 is not given")
    if generator.contact != "line" and not generator.bearing_stiffness_N_per_mm3:
        told.append("stress at the very edge of a rigid contact has no bound and is left out")
    if math.isnan(found.stresses.critical.safety):
        told.append("material: no ultimate_MPa, so that no fatigue safety can be told")
    if drawing.teeth is None:
        told.append("no [teeth]: engagement and ratcheting are not told")
    return told
