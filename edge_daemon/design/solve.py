"""One design solved: the deformed shape under its wave generator and the twist under its torque."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.design.contact import Pressed, held_shape, one_sided
from edge_daemon.design.drawing import MM, CupSection, Drawing
from edge_daemon.design.harmonics import Elastic, Rings, isotropic, orthotropic
from edge_daemon.design.materials import Material, find_material
from edge_daemon.design.mesh import Meridian, meridian
from edge_daemon.design.shapes import Shape, deflection
from edge_daemon.records import Array

ANGLES = 16
"""Angles of a one-sided contact on a quarter: with 24 the reference cup's stresses move by less than 1 %."""
HELD_HARMONICS = 12
"""Harmonics of a shape that is followed exactly; the last of a four-force shape bends 2 % as much as the second."""
LEAST_AMPLITUDE = 1e-6
"""Amplitudes below this share of the largest bend nothing."""
LINE_SHARE = 1.0 / 3.0
"""Of the rim's width, a contact's width that the file leaves out (guess: the ball's groove of a flexible bearing)."""
TOOTH_FILL = 0.5
"""Share of the pitch that a tooth takes at its middle height."""
TOOTH_HEIGHT = 2.0
"""Height of a flexspline's tooth, in modules (Ivanov 1981: 1.8 to 2.25)."""


@dataclass(frozen=True, slots=True)
class Solved:
    """A solved flexspline in SI; n nodes, h harmonics."""

    drawing: Drawing
    material: Material
    rings: Rings
    pressed: Pressed
    torsion: Array
    """(3 n,) displacement under the torque [m]"""
    torque_Nm: float
    stiffness_Nm_per_rad: float
    contact_width_mm: float | None

    @property
    def mesh(self) -> Meridian:
        return self.rings.mesh

    @property
    def volume_m3(self) -> float:
        return self.rings.volume_m3 * (2.0 if self.mesh.mirrored else 1.0)

    def displacement(self, angles: Array) -> Array:
        """(angles, n, 3) [m]: radial, tangential, axial."""
        waves = np.multiply.outer(angles, self.pressed.harmonics)
        fields = self.pressed.displacement.reshape(len(self.pressed.harmonics), -1, 3)
        moved = np.einsum("ah,hnc->anc", np.cos(waves), fields)
        moved[:, :, 1] = np.sin(waves) @ fields[:, :, 1] + self.torsion[1::3]
        return np.asarray(moved)

    def stress(self, angles: Array) -> Array:
        """(angles, n, 6) [Pa], of the wave generator and the torque together."""
        waves = np.multiply.outer(angles, self.pressed.harmonics)
        fields = np.array(
            [
                _nominal_at_clamp(self.rings, self.rings.stresses(int(n), field))
                for n, field in zip(self.pressed.harmonics, self.pressed.displacement, strict=True)
            ]
        )
        whole = np.einsum("ah,hnc->anc", np.cos(waves), fields)
        whole[:, :, 4:] = np.einsum("ah,hnc->anc", np.sin(waves), fields[:, :, 4:])
        return np.asarray(whole + _nominal_at_clamp(self.rings, self.rings.stresses(0, self.torsion)))


def solve(drawing: Drawing, fineness: float = 1.0) -> Solved:
    """Raises `DesignError` where the design cannot be."""
    body, generator, material = drawing.flexspline, drawing.wave_generator, find_material(drawing.material)
    width = contact_width_mm(drawing)
    mesh = meridian(body, fineness, width if width is not None else 0.0)
    rings = Rings(mesh, Elastic(_stiffness(drawing, mesh, material), material.density_kg_m3))
    bore_mm = float(mesh.points[0, 0, 0]) / MM
    shape = deflection(generator, bore_mm)
    if width is None:
        harmonics = np.arange(2.0, 2 * HELD_HARMONICS + 1, 2)
        sizes = MM * _amplitudes(shape, harmonics)
        told = np.abs(sizes) > LEAST_AMPLITUDE * np.abs(sizes).max()
        pressed = held_shape(rings, _held_nodes(drawing, mesh), sizes[told], harmonics[told])
    else:
        nodes = _touched(mesh, width * MM)
        angles = np.linspace(0.0, 0.5 * math.pi, ANGLES + 1)
        pressed = one_sided(rings, nodes, MM * shape(angles), _softness(drawing, mesh, nodes))
    torsion, stiffness = twist(rings, drawing.load.torque_Nm)
    return Solved(drawing, material, rings, pressed, torsion, drawing.load.torque_Nm, stiffness, width)


def contact_width_mm(drawing: Drawing) -> float | None:
    """None where the shape is followed exactly."""
    generator, body = drawing.wave_generator, drawing.flexspline
    if generator.contact != "one-sided":
        return None
    rim = body.length_mm if body.kind == "pancake" else (body.rim_width_mm or body.length_mm)
    return generator.contact_width_mm or LINE_SHARE * rim


def _stiffness(drawing: Drawing, mesh: Meridian, material: Material) -> Array:
    """(elements, 6, 6) [Pa]; a toothed rim is stiffer along its teeth."""
    plain = isotropic(material.youngs_Pa, material.poisson)
    whole = np.repeat(plain[None], mesh.elements.shape[1], axis=0)
    teeth, body = drawing.teeth, drawing.flexspline
    if body.teeth_add_stiffness and teeth:
        module = teeth.module_mm or 2.0 * body.mean_radius_mm / teeth.flexspline
        axial = 1.0 + TOOTH_FILL * TOOTH_HEIGHT * module / body.rim_thickness_mm
        rim = mesh.elements.max(axis=0) < mesh.rim_stations * mesh.points.shape[1]
        whole[rim] = orthotropic(material.youngs_Pa, material.poisson, axial)
    return whole


def _amplitudes(shape: Shape, harmonics: Array) -> Array:
    """Cosine amplitudes of a shape at its harmonics."""
    angles = 2.0 * np.pi * np.arange(720) / 720
    return np.asarray(2.0 * np.cos(np.outer(harmonics, angles)) @ shape(angles) / 720)


def _held_nodes(drawing: Drawing, mesh: Meridian) -> Array:
    """The rim's middle circle, or the bore under the rim."""
    at = mesh.numbers
    if drawing.wave_generator.contact == "bore":
        return np.asarray(at[: mesh.rim_stations, 0])
    middle = int(np.argmin(np.abs(mesh.points[: mesh.rim_stations, 0, 1] - mesh.rim_middle_m)))
    return np.asarray(at[middle, [at.shape[1] // 2]])


def _touched(mesh: Meridian, width_m: float) -> Array:
    """Nodes of the bore within the contact's width about the rim's middle."""
    z = mesh.points[: mesh.rim_stations, 0, 1]
    inside = np.flatnonzero(np.abs(z - mesh.rim_middle_m) <= 0.5 * width_m * (1.0 + 1e-9) + 1e-12)
    return np.asarray(mesh.numbers[inside, 0])


def _softness(drawing: Drawing, mesh: Meridian, nodes: Array) -> Array:
    """Closing of the bearing per force per radian on each node [m rad/N]."""
    stiffness = drawing.wave_generator.bearing_stiffness_N_per_mm3
    if stiffness is None or len(nodes) < 3:
        return np.zeros(len(nodes))
    places = mesh.nodes[nodes]
    return np.asarray(1.0 / (stiffness * 1e9 * places[:, 0] * line_weights(places[:, 1])))


def line_weights(places: Array) -> Array:
    """Simpson's weights of nodes on a line of second-order elements."""
    weights = np.zeros(len(places))
    lengths = places[2::2] - places[:-2:2]
    for offset, share in ((0, 1.0), (1, 4.0), (2, 1.0)):
        weights[offset : offset + 2 * len(lengths) : 2] += share * lengths / 6.0
    return weights


def twist(rings: Rings, torque_Nm: float) -> tuple[Array, float]:
    """Displacement (3 n,) under a torque spread evenly over the rim's outer face, and the stiffness [N m/rad].

    The rotation is the mean over that face. A pancake is twisted between its two halves.
    """
    mesh = rings.mesh
    nodes = mesh.numbers[: mesh.rim_stations, -1]
    places = mesh.nodes[nodes]
    weights = line_weights(places[:, 1])
    forces = np.zeros((rings.size, 1))
    forces[3 * nodes + 1, 0] = weights * places[:, 0]
    forces /= 2.0 * math.pi * float(np.sum(weights * places[:, 0] ** 2))
    field = rings.solve(0, forces)[:, 0]
    rotation = float(np.sum(weights * field[3 * nodes + 1] / places[:, 0]) / weights.sum())
    return torque_Nm * field, 1.0 / (rotation * (2.0 if mesh.mirrored else 1.0))


def _nominal_at_clamp(rings: Rings, stress: Array) -> Array:
    """The same with the clamp's own membrane and bending stress within half a thickness of it.

    Between a clamped and a free face linear elasticity has no bounded stress; the boss's own fillet, which bounds it,
    is not drawn.
    """
    mesh = rings.mesh
    if mesh.mirrored:
        return stress
    middle = mesh.points[:, mesh.points.shape[1] // 2]
    thick = float(np.linalg.norm(mesh.points[-1, -1] - mesh.points[-1, 0]))
    near = np.flatnonzero(np.linalg.norm(middle - middle[-1], axis=1) <= 0.5 * thick)
    rows = np.linspace(-1.0, 1.0, mesh.points.shape[1])
    weights = line_weights(rows)
    weights /= weights.sum()
    field = stress.copy().reshape(*mesh.points.shape[:2], 6)
    mean, slope = weights @ field[-1], (weights * rows) @ field[-1] / float(weights @ rows**2)
    field[near] = mean + rows[:, None] * slope
    return field.reshape(-1, 6)


def wall_shear_Pa(drawing: Drawing) -> float:
    """Mean shear through the wall half way between the diaphragm and the rim's step."""
    body, torque = drawing.flexspline, drawing.load.torque_Nm
    if body.kind == "pancake":
        thick, radius = body.rim_thickness_mm * MM, body.mean_radius_mm * MM
    else:
        section = CupSection(body)
        begin = body.rim_width_mm + body.rim_thickness_mm - section.step()[0]  # type: ignore[operator]
        half = 0.5 * (begin + section.inner_face(section.bore))
        thick = section.wall(half) * MM
        radius = section.bore * MM + 0.5 * thick
    return torque / (2.0 * math.pi * radius**2 * thick)
