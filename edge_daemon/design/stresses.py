"""What the stress field says: the worst places, and mean and amplitude over a turn where parts break."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge_daemon.design.drawing import MM, CupSection
from edge_daemon.design.materials import Material
from edge_daemon.design.solve import Solved
from edge_daemon.records import Array, Mask

TURN_STEPS = 72
"""Angles over half a turn at which stresses are taken: 2.5 degrees."""
FATIGUE_STEPS = 24
"""Angles over half a turn between which a stress swings: the largest swing of two waves is met to 1 %."""
EDGE_SHARE = 0.15
"""Of the rim's thickness about the edge of a rigid contact, within which stress has no bound and is not counted (guess:
the edge of a bearing's ring is rounded by about as much)."""


@dataclass(frozen=True, slots=True)
class Spot:
    """A place of the section: which part, radius and z [m], angle from the major axis [rad]."""

    part: str
    radius_m: float
    z_m: float
    angle_rad: float

    def to_json(self) -> dict[str, Any]:
        """In the units of drawings."""
        return {
            "part": self.part,
            "radius_mm": round(self.radius_m / MM, 4),
            "z_mm": round(self.z_m / MM, 4),
            "angle_deg": round(math.degrees(self.angle_rad), 2),
        }


@dataclass(frozen=True, slots=True)
class Fatigue:
    """The place of a region where it would break first; stresses [Pa]."""

    region: str
    spot: Spot
    amplitude_Pa: float
    mean_Pa: float
    safety: float


@dataclass(frozen=True, slots=True)
class Stresses:
    """All that a turn does; stresses [Pa]."""

    von_mises_Pa: float
    spot: Spot
    principal_max_Pa: float
    principal_max_spot: Spot
    principal_min_Pa: float
    principal_min_spot: Spot
    bending_Pa: float
    hoop_Pa: float
    rim: Fatigue
    diaphragm: Fatigue | None
    critical: Fatigue


def von_mises(stress: Array) -> Array:
    """(..., 6) to (...)."""
    rr, tt, zz = stress[..., 0], stress[..., 1], stress[..., 2]
    normal = 0.5 * ((rr - tt) ** 2 + (tt - zz) ** 2 + (zz - rr) ** 2)
    return np.asarray(np.sqrt(normal + 3.0 * np.sum(stress[..., 3:] ** 2, axis=-1)))


def principal(stress: Array) -> Array:
    """(..., 6) to (..., 3), rising."""
    rr, tt, zz, rz, rt, tz = np.moveaxis(stress, -1, 0)
    tensor = np.stack([np.stack(row, -1) for row in ((rr, rt, rz), (rt, tt, tz), (rz, tz, zz))], -2)
    return np.asarray(np.linalg.eigvalsh(tensor))


def stresses_of(solved: Solved) -> Stresses:
    """The worst of the whole part, the open end's bending, and both places of fatigue."""
    angles = math.pi * np.arange(TURN_STEPS) / TURN_STEPS
    stress = solved.stress(angles)
    counted = _counted(solved)
    effective = np.where(counted, von_mises(stress), 0.0)
    worst = np.unravel_index(int(effective.argmax()), effective.shape)
    surface = np.flatnonzero(_surface(solved) & counted)
    ends = principal(stress[:, surface])
    high = np.unravel_index(int(ends[..., 2].argmax()), ends.shape[:2])
    low = np.unravel_index(int(ends[..., 0].argmin()), ends.shape[:2])
    first = solved.mesh.numbers[0]
    rim, diaphragm = _fatigue(solved, stress[:: TURN_STEPS // FATIGUE_STEPS], counted)
    return Stresses(
        von_mises_Pa=float(effective[worst]),
        spot=_spot(solved, int(worst[1]), angles[worst[0]]),
        principal_max_Pa=float(ends[(*high, 2)]),
        principal_max_spot=_spot(solved, int(surface[high[1]]), angles[high[0]]),
        principal_min_Pa=float(ends[(*low, 0)]),
        principal_min_spot=_spot(solved, int(surface[low[1]]), angles[low[0]]),
        bending_Pa=float(np.abs(0.5 * (stress[:, first[-1], 1] - stress[:, first[0], 1])).max()),
        hoop_Pa=float(np.abs(stress[:, first, 1]).max()),
        rim=rim,
        diaphragm=diaphragm,
        critical=min((place for place in (rim, diaphragm) if place), key=lambda place: (_known(place), place.safety)),
    )


def _known(place: Fatigue) -> float:
    """Places come by amplitude where no strength is known."""
    return -place.amplitude_Pa if math.isnan(place.safety) else 0.0


def _surface(solved: Solved) -> Mask:
    """Nodes on a face."""
    rows = np.zeros(solved.mesh.points.shape[:2], dtype=bool)
    rows[:, [0, -1]] = rows[0] = True
    return rows.ravel()


def _counted(solved: Solved) -> Mask:
    """All nodes but those at the edge of a rigid contact."""
    drawing, nodes = solved.drawing, solved.rings.nodes
    generator = drawing.wave_generator
    if generator.contact == "line" or (generator.contact == "one-sided" and generator.bearing_stiffness_N_per_mm3):
        return np.ones(len(nodes), dtype=bool)
    touched = solved.pressed.places_m
    bore, reach = float(solved.mesh.points[0, 0, 0]), EDGE_SHARE * drawing.flexspline.rim_thickness_mm * MM
    far = np.ones(len(nodes), dtype=bool)
    for edge in (touched.min(), touched.max()):
        if edge > reach:
            far &= np.hypot(nodes[:, 0] - bore, nodes[:, 1] - edge) > reach
    return far


def _spot(solved: Solved, node: int, angle: float) -> Spot:
    radius, z = (float(value) for value in solved.rings.nodes[node])
    return Spot(_part(solved, radius / MM, z / MM), radius, z, float(angle))


def _part(solved: Solved, radius: float, z: float) -> str:
    """The name of a place [mm]."""
    body = solved.drawing.flexspline
    if body.kind == "pancake":
        return "rim"
    section = CupSection(body)
    start, foot = section.corner()
    if z <= section.rim_width + 1e-9:
        return "rim"
    if z <= section.step()[3] + 1e-9 and section.step()[1] > 0.0:
        return "step of the rim"
    if z <= start:
        return "wall"
    if section.side * (radius - foot) <= 0.0:
        return "fillet of the diaphragm"
    near_hub = abs(radius - section.hub) < section.diaphragm(section.hub)
    return "diaphragm at the hub" if near_hub else "diaphragm"


def _fatigue(solved: Solved, stress: Array, counted: Mask) -> tuple[Fatigue, Fatigue | None]:
    """The rim with its step, and the diaphragm with its fillet. `stress` (angles, n, 6)."""
    body, nodes = solved.drawing.flexspline, solved.rings.nodes
    faces = np.flatnonzero(_surface(solved) & counted)
    amplitude, mean, half = swing(stress[:, faces])
    safety = np.array([solved.material.safety(a, m) for a, m in zip(amplitude, mean, strict=True)])
    if body.kind == "pancake":
        return _weakest("rim", solved, faces, amplitude, mean, safety, half), None
    section = CupSection(body)
    fore = nodes[faces, 1] <= section.step()[3] * MM + 1e-9
    aft = nodes[faces, 1] >= section.corner()[0] * MM - 1e-9
    parts = [
        _weakest(name, solved, faces[at], amplitude[at], mean[at], safety[at], half[at])
        for name, at in (("rim", fore), ("diaphragm fillet", aft))
    ]
    return parts[0], parts[1]


def _weakest(
    region: str, solved: Solved, nodes: Any, amplitude: Array, mean: Array, safety: Array, half: Array
) -> Fatigue:
    worst = int(amplitude.argmax() if np.isnan(safety).any() else safety.argmin())
    angle = math.pi * int(half[worst]) / FATIGUE_STEPS
    spot = _spot(solved, int(nodes[worst]), angle)
    return Fatigue(region, spot, float(amplitude[worst]), float(mean[worst]), float(safety[worst]))


def swing(stress: Array) -> tuple[Array, Array, Array]:
    """Amplitude and mean of each node's stress over a turn (angles, n, 6), and the angle's number where a swing begins.

    Amplitude: half the largest von Mises stress of a difference between two angles. Mean: von Mises of their middle,
    negative where the middle is mostly pressure.
    """
    count = stress.shape[1]
    amplitude, mean, first = np.zeros(count), np.zeros(count), np.zeros(count, dtype=int)
    for i in range(len(stress)):
        halves = 0.5 * von_mises(stress[i] - stress[i + 1 :])
        if not halves.size:
            continue
        best = halves.argmax(axis=0)
        larger = np.flatnonzero(halves.max(axis=0) > amplitude)
        amplitude[larger] = halves.max(axis=0)[larger]
        middle = 0.5 * (stress[i, larger] + stress[i + 1 + best[larger], larger])
        mean[larger] = np.where(middle[:, :3].sum(axis=1) < -von_mises(middle), -1.0, 1.0) * von_mises(middle)
        first[larger] = i
    return amplitude, mean, first


def yield_safety(material: Material, von_mises_Pa: float) -> float:
    """Against the first yielding; NaN where the strength is not known."""
    return material.yield_Pa / von_mises_Pa if von_mises_Pa > 0.0 else math.inf
