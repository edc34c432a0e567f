"""Commands about a flexspline as drawn: design evaluate, optimise, compare. No daemon, no bus."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from edge_daemon.design.drawing import DesignError, Drawing, drawing_text, read_drawing, weighted
from edge_daemon.design.evaluate import evaluate
from edge_daemon.design.life import LoadRow, gear_of, gear_text, life_curve, life_h, load_rows
from edge_daemon.design.optimise import document_of, optimise
from edge_daemon.design.pictures import page
from edge_daemon.design.solve import solve
from edge_daemon.design.words import changes_of, tell, tell_change, tell_optimum
from edge_daemon.errors import BadInput
from edge_daemon.recordings.recording import read_recording
from edge_daemon.text import progress, write_text, written_as_json


def design_evaluate(arguments: argparse.Namespace) -> None:
    """All figures of one design."""
    drawing, started = read_drawing(arguments.file), time.perf_counter()
    document = _evaluated(drawing, arguments.file)
    seconds = time.perf_counter() - started
    if arguments.gear:
        solved = solve(drawing)
        write_text(arguments.gear, gear_text(gear_of(solved, life_curve(solved), drawing.name or arguments.file.stem)))
    if arguments.report:
        write_text(arguments.report, page(drawing, document))
    if written_as_json(document, arguments.json):
        return
    tell(document)
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
    return load_rows(read.time_s, *(columns[name] for name in names))


def design_optimise(arguments: argparse.Namespace) -> None:
    """The least F within the file's bounds and constraints."""
    drawing = read_drawing(arguments.file)
    if arguments.weights:
        drawing = weighted(drawing, arguments.weights)
    started = time.perf_counter()
    try:
        found = optimise(drawing, progress("optimise"))
    except DesignError as error:
        raise DesignError(f"{arguments.file}: {error}") from error
    document = document_of(found)
    document["seconds"] = time.perf_counter() - started
    best = found.drawing()
    if arguments.out:
        write_text(arguments.out, drawing_text(best))
    if arguments.gear:
        solved = solve(best)
        write_text(arguments.gear, gear_text(gear_of(solved, life_curve(solved), arguments.file.stem)))
    if arguments.report:
        write_text(arguments.report, page(best, evaluate(best), found, document))
    if not written_as_json(document, arguments.json):
        tell_optimum(document)


def design_compare(arguments: argparse.Namespace) -> None:
    """Two designs side by side, both under the loads of the first."""
    first, second = read_drawing(arguments.first), read_drawing(arguments.second)
    loads = _loads(first, arguments.first) or _loads(second, arguments.second)
    documents = [
        _evaluated(drawing, file, loads) for drawing, file in ((first, arguments.first), (second, arguments.second))
    ]
    changes = changes_of(*documents)
    whole = {"a": documents[0], "b": documents[1], "change": changes}
    if arguments.report:
        write_text(arguments.report, page(second, documents[1], against=(first, documents[0])))
    if written_as_json(whole, arguments.json):
        return
    tell_change(documents, changes, (arguments.first.name, arguments.second.name))
