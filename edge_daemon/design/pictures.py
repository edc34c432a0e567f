"""What a report shows of a design, as curves: no drawing here."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.design.drawing import MM
from edge_daemon.design.solve import Solved
from edge_daemon.design.stresses import von_mises
from edge_daemon.records import Array

MAGNIFIED = 0.15
"""A deformed shape is drawn so large that its greatest deflection is this share of the radius."""


def outline(solved: Solved, angle_rad: float | None = None) -> tuple[Array, Array, float]:
    """z and radius [mm] around the section, deformed at an angle where one is given, and by how much enlarged."""
    mesh = solved.mesh
    rim = np.concatenate([mesh.numbers[:, 0], mesh.numbers[::-1, -1], mesh.numbers[:1, 0]])
    places = mesh.nodes[rim] / MM
    if angle_rad is None:
        return places[:, 1], places[:, 0], 1.0
    moved = solved.displacement(np.array([angle_rad]))[0, rim] / MM
    factor = MAGNIFIED * float(places[:, 0].max()) / max(float(np.abs(moved).max()), 1e-12)
    return places[:, 1] + factor * moved[:, 2], places[:, 0] + factor * moved[:, 0], factor


def open_end(solved: Solved) -> tuple[Array, Array, float]:
    """The open end's circle, deformed: x and y [mm], and by how much enlarged."""
    angles = np.linspace(0.0, 2.0 * math.pi, 361)
    node = int(solved.mesh.numbers[0, -1])
    moved = solved.displacement(angles)[:, node] / MM
    radius = float(solved.mesh.nodes[node, 0]) / MM
    factor = MAGNIFIED * radius / max(float(np.abs(moved).max()), 1e-12)
    out, around = radius + factor * moved[:, 0], angles + factor * moved[:, 1] / radius
    return out * np.cos(around), out * np.sin(around), factor


def along_the_section(solved: Solved) -> tuple[Array, Array, Array]:
    """Length along the section [mm] from the open end, and the largest von Mises stress [MPa] of either face."""
    angles = math.pi * np.arange(36) / 36
    worst = von_mises(solved.stress(angles)).max(axis=0).reshape(solved.mesh.points.shape[:2]) * 1e-6
    middle = solved.mesh.points[:, solved.mesh.points.shape[1] // 2] / MM
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    return length, worst[:, 0], worst[:, -1]
