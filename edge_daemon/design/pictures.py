"""The page of a design: its section, its deformed shape, where it is stressed, and the front of a search."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge_daemon.design.drawing import MM, Drawing
from edge_daemon.design.optimise import AIMS, Optimum
from edge_daemon.design.solve import Solved, solve
from edge_daemon.design.stresses import von_mises
from edge_daemon.design.words import ROWS, contact_words, place
from edge_daemon.records import Array
from edge_daemon.show.report import Bars, Cloud, Figure, Line, ReportSection, ReportTable, render_report
from edge_daemon.text import number

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


def page(
    drawing: Drawing,
    document: dict[str, Any],
    found: Optimum | None = None,
    best: dict[str, Any] | None = None,
    against: tuple[Drawing, dict[str, Any]] | None = None,
) -> str:
    """The section, the deformed shape, stresses, contact and teeth; of a search also its front and slopes."""
    solved = solve(drawing)
    sections = [_figures(document, against), _section(solved), _shape(solved), _stress(solved, document)]
    sections.append(_pressure(document))
    if document["teeth"]:
        sections.append(_teeth(document["teeth"]))
    if best:
        sections += [_front(best), _slopes(best)]
    lead = f"{drawing.flexspline.kind}, {document['material']['name']}, contact {contact_words(document['contact'])}"
    return render_report("Flexspline design", lead, sections)


def _figures(document: dict[str, Any], against: tuple[Drawing, dict[str, Any]] | None) -> ReportSection:
    head = ["figure", *(["first"] if against else []), "value", "unit"]
    rows = [
        [name, *([number(against[1][key])] if against and key in against[1] else []), number(document[key]), unit]
        for name, key, unit in ROWS
        if key in document and (not against or key in against[1])
    ]
    verdict = f"largest stress {number(document['stress_von_mises_max_MPa'])} MPa: {place(document['where'])}"
    return ReportSection("Figures", verdict, "; ".join(document["notes"]), ReportTable(head, rows))


def _section(solved: Solved) -> ReportSection:
    z, radius, _ = outline(solved)
    marks = [Line(z, radius, "as drawn")]
    for angle, name in ((0.0, "major axis"), (0.5 * np.pi, "minor axis")):
        bent_z, bent_radius, factor = outline(solved, angle)
        marks.append(Line(bent_z, bent_radius, f"{name}, {factor:.3g} times", thin=True))
    verdict = "The section, and how it bends at both axes of the wave generator."
    return ReportSection("Section", verdict, "", Figure("from the open end [mm]", "radius [mm]", marks))


def _shape(solved: Solved) -> ReportSection:
    x, y, factor = open_end(solved)
    radius = float(solved.mesh.nodes[int(solved.mesh.numbers[0, -1]), 0]) * 1e3
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    marks = [Line(radius * np.cos(turn), radius * np.sin(turn), "round", thin=True), Line(x, y, "deformed")]
    verdict = f"The open end, its deflection drawn {factor:.3g} times as large."
    return ReportSection("Deformed shape", verdict, "", Figure("major axis [mm]", "minor axis [mm]", marks))


def _stress(solved: Solved, document: dict[str, Any]) -> ReportSection:
    length, inner, outer = along_the_section(solved)
    marks = [Line(length, inner, "bore side"), Line(length, outer, "teeth's side")]
    step = "a larger fillet or a thinner rim" if "step" in document["where"]["part"] else "see the slopes of a search"
    figure = Figure("along the section [mm]", "von Mises, worst of a turn [MPa]", marks)
    return ReportSection("Stress", f"Worst at: {place(document['where'])}.", step, figure)


def _pressure(document: dict[str, Any]) -> ReportSection:
    contact = document["contact"]
    line = Line(np.array(contact["angles_deg"]), np.array(contact["force_N_per_mm"]), "force")
    verdict = f"The wave generator touches on {contact['touching_share']:.0%} of a quarter turn."
    figure = Figure("from the major axis [deg]", "force per length around [N/mm]", [line])
    return ReportSection(
        "Contact", verdict, "measure the bearing's width and stiffness: they decide the stress", figure
    )


def _teeth(teeth: dict[str, Any]) -> ReportSection:
    angles = np.array([row["angle_deg"] for row in teeth["arc"]])
    gaps = np.array([float("nan") if row["gap_mm"] is None else row["gap_mm"] for row in teeth["arc"]], dtype=float)
    depth = np.array([row["depth_mm"] for row in teeth["arc"]])
    marks = [Line(angles, gaps, "flank gap"), Line(angles, depth, "depth", thin=True)]
    verdict = (
        f"{teeth['engaged_share']:.0%} of the teeth reach in; interference {number(teeth['interference_mm'], 2)} mm."
    )
    return ReportSection("Teeth", verdict, "", Figure("from the major axis [deg]", "[mm]", marks))


def _front(best: dict[str, Any]) -> ReportSection:
    front = best["front"]
    stress, deflection, volume = (np.array([row[key] for row in front]) for key in AIMS)
    marks = [
        Cloud(volume, stress, "front"),
        Cloud(np.array([best["best"]["volume_mm3"]]), np.array([best["best"]["stress_von_mises_max_MPa"]]), "best F"),
    ]
    span = f"{deflection.min():.3g} to {deflection.max():.3g} mm" if front else "none"
    verdict = f"{len(front)} designs that none beats in stress, deflection ({span}) and volume at once."
    return ReportSection("Front", verdict, "", Figure("volume [mm3]", "largest von Mises stress [MPa]", marks))


def _slopes(best: dict[str, Any]) -> ReportSection:
    rows = [(row["name"], row["change_per_percent"]["objective"]) for row in best["variables"]]
    sizes = [0.0 if value is None else float(value) for _, value in rows]
    bars = Bars([name for name, _ in rows], sizes, [number(size, 2) for size in sizes])
    verdict = f"Held by: {', '.join(best['binding']) or 'nothing'}."
    return ReportSection("Sensitivity", verdict, "", Figure("F, % per % of the bounds", "", [bars]))
