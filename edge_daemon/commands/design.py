"""Commands about a flexspline as drawn: design evaluate, optimise, compare. No daemon, no bus."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomlkit

from edge_daemon.acquire.recording import read_recording
from edge_daemon.design.drawing import DesignError, Drawing, read_drawing
from edge_daemon.design.evaluate import evaluate
from edge_daemon.design.life import LoadRow, gear_of, gear_text, life_curve, life_h
from edge_daemon.design.optimise import AIMS, Optimum, document_of, optimise
from edge_daemon.design.pictures import along_the_section, open_end, outline
from edge_daemon.design.solve import Solved, solve
from edge_daemon.errors import BadInput
from edge_daemon.show.report import Bars, Cloud, Figure, Line, ReportSection, ReportTable, render_report
from edge_daemon.text import number, progress, table, write_text, written_as_json

ROWS = (
    ("bending stress at the open end", "stress_bending_MPa", "MPa"),
    ("shear in the wall", "stress_shear_MPa", "MPa"),
    ("largest von Mises stress", "stress_von_mises_max_MPa", "MPa"),
    ("largest deflection", "deflection_max_mm", "mm"),
    ("volume", "volume_mm3", "mm3"),
    ("mass", "mass_kg", "kg"),
    ("torsional stiffness", "torsional_stiffness_Nm_per_rad", "N m/rad"),
    ("fatigue safety", "safety_fatigue", ""),
    ("yield safety", "safety_yield", ""),
    ("buckling torque, estimate", "buckling_Nm", "N m"),
    ("ratcheting torque, estimate", "ratcheting_Nm", "N m"),
    ("objective F", "objective", ""),
    ("life under the loads", "life_h", "h"),
)


def design_evaluate(arguments: argparse.Namespace) -> None:
    """All figures of one design."""
    drawing, started = read_drawing(arguments.file), time.perf_counter()
    document = _evaluated(drawing, arguments.file)
    seconds = time.perf_counter() - started
    if arguments.gear:
        solved = solve(drawing)
        write_text(arguments.gear, gear_text(gear_of(solved, life_curve(solved), drawing.name or arguments.file.stem)))
    if arguments.report:
        write_text(arguments.report, _page(drawing, document))
    if written_as_json(document, arguments.json):
        return
    _tell(document)
    print(f"{seconds:.2f} s for two meshes and the life")


def _evaluated(drawing: Drawing, file: Path, loads: Sequence[LoadRow] | None = None) -> dict[str, Any]:
    """The document of `evaluate`, with the life under measured loads where there are any."""
    try:
        document = evaluate(drawing)
        loads = _loads(drawing, file) if loads is None else loads
        if loads:
            document["life_h"] = life_h(life_curve(solve(drawing)), loads)
    except DesignError as error:
        raise DesignError(f"{file}: {error}") from error
    measured = drawing.load.stiffness_Nm_per_rad
    if measured:
        document["stiffness_measured_over_design"] = measured / document["torsional_stiffness_Nm_per_rad"]
    return document


def _loads(drawing: Drawing, file: Path) -> list[LoadRow]:
    """Rows of torque, speed and hours: from the design's own file, or from a history that a gateway wrote."""
    spectrum = drawing.load.spectrum
    if not isinstance(spectrum, str):
        return list(spectrum or [])
    read = read_recording(file.parent / spectrum, time="time_h", least=2)
    columns = dict(read.columns)
    names = ("torque_cubic_mean_Nm", "speed_in_rpm")
    missing = [name for name in names if name not in columns]
    if missing:
        raise BadInput(f"{file.parent / spectrum}: {missing[0]} is missing: a spectrum needs {' and '.join(names)}")
    hours = np.diff(read.time_s, append=2 * read.time_s[-1] - read.time_s[-2])
    rows = np.column_stack([*(np.abs(columns[name]) for name in names), hours])
    return [(t, s, h) for t, s, h in rows[np.isfinite(rows).all(axis=1)].tolist() if h > 0]


def design_optimise(arguments: argparse.Namespace) -> None:
    """The least F within the file's bounds and constraints."""
    drawing = read_drawing(arguments.file)
    if arguments.weights:
        drawing = _weighted(drawing, arguments.weights)
    started = time.perf_counter()
    try:
        found = optimise(drawing, progress("optimise"))
    except DesignError as error:
        raise DesignError(f"{arguments.file}: {error}") from error
    document = document_of(found)
    document["seconds"] = time.perf_counter() - started
    best = found.drawing()
    if arguments.out:
        write_text(arguments.out, _as_toml(best))
    if arguments.gear:
        solved = solve(best)
        write_text(arguments.gear, gear_text(gear_of(solved, life_curve(solved), arguments.file.stem)))
    if arguments.report:
        write_text(arguments.report, _page(best, evaluate(best), found, document))
    if not written_as_json(document, arguments.json):
        _tell_optimum(document)


def _weighted(drawing: Drawing, text: str) -> Drawing:
    try:
        first, second, third = (float(part) for part in text.split(","))
    except ValueError as error:
        raise BadInput(f"--weights {text}: expected three numbers W1,W2,W3") from error
    wishes = msgspec.structs.replace(drawing.optimise, weights=(first, second, third))
    return msgspec.structs.replace(drawing, optimise=wishes)


def _as_toml(drawing: Drawing) -> str:
    def known(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: known(inner) for key, inner in value.items() if inner is not None}
        return list(value) if isinstance(value, tuple) else value

    return tomlkit.dumps(known(msgspec.to_builtins(drawing)))


def design_compare(arguments: argparse.Namespace) -> None:
    """Two designs side by side, both under the loads of the first."""
    first, second = read_drawing(arguments.first), read_drawing(arguments.second)
    loads = _loads(first, arguments.first) or _loads(second, arguments.second)
    documents = [
        _evaluated(drawing, file, loads) for drawing, file in ((first, arguments.first), (second, arguments.second))
    ]
    changes = {
        key: documents[1][key] / documents[0][key] - 1.0
        for _, key, _ in ROWS
        if all(isinstance(document.get(key), float) and document[key] for document in documents)
    }
    whole = {"a": documents[0], "b": documents[1], "change": changes}
    if arguments.report:
        write_text(arguments.report, _page(second, documents[1], against=(first, documents[0])))
    if written_as_json(whole, arguments.json):
        return
    rows = [
        (name, number(documents[0][key]), number(documents[1][key]), f"{changes.get(key, float('nan')):+.1%}", unit)
        for name, key, unit in ROWS
        if key in documents[0]
    ]
    print(table(("figure", arguments.first.name, arguments.second.name, "change", "unit"), rows))


def _tell(document: dict[str, Any]) -> None:
    changes = document["mesh"]["change_on_refinement"]
    rows = [
        (name, number(document[key]), unit, f"{changes[key]:+.2%}" if key in changes else "")
        for name, key, unit in ROWS
        if key in document
    ]
    print(table(("figure", "value", "unit", "finer mesh"), rows))
    print(f"largest stress: {place(document['where'])}; contact: {_contact(document['contact'])}")
    for row in document["fatigue"]:
        print(
            f"{row['region']}: amplitude {number(row['amplitude_MPa'])} MPa about {number(row['mean_MPa'])} MPa,"
            f" safety {number(row['safety'], 3)}, {place(row['where'])}"
        )
    modes = ", ".join(
        f"{row['frequency_hz']:.0f} Hz ({row['harmonic']})" for row in document["natural_frequencies"][:5]
    )
    print(f"natural frequencies (waves around): {modes}")
    teeth = document["teeth"]
    if teeth:
        print(
            f"teeth: {teeth['engaged_share']:.0%} engaged, {teeth['touching_share']:.0%} touch;"
            f" interference {number(teeth['interference_mm'], 2)} mm"
        )
    for note in document["notes"]:
        print(f"  {note}")


def _tell_optimum(document: dict[str, Any]) -> None:
    start, best = document["start"], document["best"]
    rows = [
        (name, number(start[key]) if start else "-", number(best[key]), unit) for name, key, unit in ROWS if key in best
    ]
    print(table(("figure", "start", "best", "unit"), rows))
    knobs = [
        (
            row["name"],
            number(row["start"] or float("nan")),
            number(row["value"]),
            f"{row['lower']:.4g} to {row['upper']:.4g}",
            number(row["change_per_percent"]["objective"], 2),
        )
        for row in document["variables"]
    ]
    print(table(("variable", "start", "best", "bounds", "F, % per % of the bounds"), knobs))
    print(f"largest stress: {place(best['where'])}; wave generator: {document['shape']}")
    print(f"held by: {', '.join(document['binding']) or 'nothing: the optimum lies inside'}")
    told = f"{document['evaluations']} designs in {document['seconds']:.0f} s"
    print(f"{told}; {len(document['front'])} of them on the front of stress, deflection and volume")


def _contact(contact: dict[str, Any]) -> str:
    width = f", {number(contact['width_mm'])} mm wide" if contact["width_mm"] else ""
    return f"{contact['kind']}{width}, {contact['shape']}"


def place(spot: dict[str, Any]) -> str:
    """A place in words."""
    return (
        f"{spot['part']} (radius {spot['radius_mm']:.2f} mm, {spot['z_mm']:.2f} mm from the open end,"
        f" {spot['angle_deg']:.0f} deg from the major axis)"
    )


# the report


def _page(
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
    lead = f"{drawing.flexspline.kind}, {document['material']['name']}, contact {_contact(document['contact'])}"
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
