"""A design's document in words, for a terminal."""

from __future__ import annotations

from typing import Any

from edge_daemon.text import number, table

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


def tell(document: dict[str, Any]) -> None:
    changes = document["mesh"]["change_on_refinement"]
    rows = [
        (name, number(document[key]), unit, f"{changes[key]:+.2%}" if key in changes else "")
        for name, key, unit in ROWS
        if key in document
    ]
    print(table(("figure", "value", "unit", "finer mesh"), rows))
    print(f"largest stress: {place(document['where'])}; contact: {contact_words(document['contact'])}")
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
        if load := teeth["load"]:
            arc = f"{load['from_deg']:.0f} to {load['to_deg']:.0f} degrees from the major axis"
            print(
                f"under {number(load['torque_Nm'])} N m {load['loaded_share']:.0%} of the teeth carry, {arc};"
                f" the most loaded {number(load['largest_force_N'], 3)} N"
            )
    for note in document["notes"]:
        print(f"  {note}")


def tell_optimum(document: dict[str, Any]) -> None:
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


def contact_words(contact: dict[str, Any]) -> str:
    width = f", {number(contact['width_mm'])} mm wide" if contact["width_mm"] else ""
    return f"{contact['kind']}{width}, {contact['shape']}"


def place(spot: dict[str, Any]) -> str:
    """A place in words."""
    return (
        f"{spot['part']} (radius {spot['radius_mm']:.2f} mm, {spot['z_mm']:.2f} mm from the open end,"
        f" {spot['angle_deg']:.0f} deg from the major axis)"
    )


def changes_of(first: dict[str, Any], second: dict[str, Any]) -> dict[str, float]:
    """Relative change of each figure that both have."""
    both = [key for _, key, _ in ROWS if all(isinstance(d.get(key), float) and d[key] for d in (first, second))]
    return {key: second[key] / first[key] - 1.0 for key in both}


def tell_change(documents: list[dict[str, Any]], changes: dict[str, float], names: tuple[str, str]) -> None:
    """Two designs side by side."""
    rows = [
        (name, number(documents[0][key]), number(documents[1][key]), f"{changes.get(key, float('nan')):+.1%}", unit)
        for name, key, unit in ROWS
        if key in documents[0]
    ]
    print(table(("figure", *names, "change", "unit"), rows))
