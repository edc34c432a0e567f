"""Commands about a flexspline as drawn: design evaluate, optimise, compare. No daemon, no bus."""

from __future__ import annotations

import argparse
import time
from typing import Any

from edge_daemon.design.drawing import read_drawing
from edge_daemon.design.evaluate import evaluate
from edge_daemon.text import number, table, written_as_json

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
)


def design_evaluate(arguments: argparse.Namespace) -> None:
    """All figures of one design."""
    started = time.perf_counter()
    document = evaluate(read_drawing(arguments.file))
    seconds = time.perf_counter() - started
    if written_as_json(document, arguments.json):
        return
    _tell(document)
    print(f"{seconds:.2f} s for two meshes")


def _tell(document: dict[str, Any]) -> None:
    changes = document["mesh"]["change_on_refinement"]
    rows = [
        (name, number(document[key]), unit, f"{changes[key]:+.2%}" if key in changes else "")
        for name, key, unit in ROWS
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


def _contact(contact: dict[str, Any]) -> str:
    width = f", {number(contact['width_mm'])} mm wide" if contact["width_mm"] else ""
    return f"{contact['kind']}{width}, {contact['shape']}"


def place(spot: dict[str, Any]) -> str:
    """A place in words."""
    return (
        f"{spot['part']} (radius {spot['radius_mm']:.2f} mm, {spot['z_mm']:.2f} mm from the open end,"
        f" {spot['angle_deg']:.0f} deg from the major axis)"
    )
