"""`map`: the stiffness over the twist, from recordings, beside what the maker promises."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge_daemon.commands.recordings import read_told
from edge_daemon.effects.model_file import read_model
from edge_daemon.explain.add import extended
from edge_daemon.stiffness.stiffness_map import Form, StiffnessMap, stiffness_map
from edge_daemon.text import number, table, with_sd, written_as_json
from edge_daemon.usage.gears import Gear, find_gear

SURE = 2.0
"""The ends must differ from the middle by so many standard deviations."""
SHOWN = 9
"""So many twists are printed; the JSON has them all."""


@dataclass(frozen=True, slots=True)
class Range:
    """One of the maker's straight ranges beside what was measured at its middle."""

    name: str
    torque_Nm: tuple[float, float]
    maker_Nm_per_rad: float
    found: tuple[float, float] | None
    """stiffness and sd; None where the torque did not reach into the range"""


def command(arguments: argparse.Namespace) -> None:
    """K(phi) in four forms. Raises `BadInput`."""
    model = read_model(arguments.model)
    gear = find_gear(arguments.gear) if arguments.gear else None
    found = stiffness_map([read_told(path) for path in arguments.recording], model, extended)
    ranges = maker_ranges(found, gear) if gear else []
    if written_as_json(_document(found, ranges, gear), arguments.json):
        return
    print(_shown(found, ranges, gear))


def maker_ranges(found: StiffnessMap, gear: Gear) -> list[Range]:
    """The maker's K1, K2, K3 beside the measured curve, at the middle of what was reached of each range."""
    reach = float(min(-found.torque_Nm[0], found.torque_Nm[-1]))
    corners = (0.0, gear.corner_1_Nm, gear.corner_2_Nm, math.inf)
    makers = (gear.stiffness_1_Nm_per_rad, gear.stiffness_2_Nm_per_rad, gear.stiffness_3_Nm_per_rad)
    rows = []
    for i, maker in enumerate(makers):
        low, high = corners[i], corners[i + 1]
        if maker is None or low is None or high is None:
            continue
        inside = low < reach
        rows.append(
            Range(f"K{i + 1}", (low, high), maker, _at(found, (low + min(high, reach)) / 2) if inside else None)
        )
    return rows


def _at(found: StiffnessMap, torque_Nm: float) -> tuple[float, float]:
    """Mean of the curve at +- this torque, and its sd."""
    both = (-torque_Nm, torque_Nm)
    value = np.interp(both, found.torque_Nm, found.best.stiffness_Nm_per_rad)
    sd = np.interp(both, found.torque_Nm, found.best.sd_Nm_per_rad)
    return float(value.mean()), float(sd.max())


def _shown(found: StiffnessMap, ranges: list[Range], gear: Gear | None) -> str:
    low, high = float(found.torque_Nm[0]), float(found.torque_Nm[-1])
    parts = [f"torque from {number(low)} to {number(high)} N m, twist from {number(found.twist_rad[0])} to "
             f"{number(found.twist_rad[-1])} rad"]  # fmt: skip
    pick = np.linspace(0, len(found.twist_rad) - 1, SHOWN).round().astype(int)
    heads = ["twist [rad]", *(f"{form.name} [N m/rad]" for form in found.forms)]
    rows = [[number(found.twist_rad[i]), *(_cell(form, i) for form in found.forms)] for i in pick]
    rows.append(["held-out error", *(f"{form.nrmse:.3%}" for form in found.forms)])
    parts.append(table(heads, rows))
    parts.append(table(("form", "number", "value", "unit"), _numbers(found)))
    if gear:
        parts.append(_against(ranges, gear))
    parts.append(f"verdict: {verdict(found)}")
    return "\n\n".join(parts)


def _cell(form: Form, i: int) -> str:
    return with_sd(float(form.stiffness_Nm_per_rad[i]), float(form.sd_Nm_per_rad[i]))


def _numbers(found: StiffnessMap) -> list[tuple[str, str, str, str]]:
    rows = []
    for form in found.forms:
        if form.name != "table":
            rows += [(form.name, key, with_sd(value, sd), unit) for key, (value, sd, unit) in form.numbers.items()]
    return rows


def _against(ranges: list[Range], gear: Gear) -> str:
    if not ranges:
        return f"{gear.name}: the maker's stiffness is not in the catalogue"
    rows = []
    for row in ranges:
        span = f"{number(row.torque_Nm[0])} .. {number(row.torque_Nm[1])}" if math.isfinite(row.torque_Nm[1]) else (
            f"above {number(row.torque_Nm[0])}"
        )  # fmt: skip
        if row.found is None:
            rows.append((row.name, span, number(row.maker_Nm_per_rad), "not reached", "", "more torque"))
            continue
        value, sd = row.found
        change = f"{value / row.maker_Nm_per_rad - 1:+.1%}"
        rows.append((row.name, span, number(row.maker_Nm_per_rad), with_sd(value, sd), change, ""))
    heads = (gear.name, "torque [N m]", "maker [N m/rad]", "here [N m/rad]", "difference", "needs")
    return table(heads, rows)


def verdict(found: StiffnessMap) -> str:
    """One line: which form, and what it says."""
    best = found.best
    if best.name == "linear":
        return "one stiffness describes this gear over the whole range; nothing is gained by a curve"
    ends = best.stiffness_Nm_per_rad[[0, -1]]
    middle = float(np.interp(0.0, found.twist_rad, best.stiffness_Nm_per_rad))
    if not abs(ends.mean() - middle) > SURE * float(best.sd_Nm_per_rad[[0, -1]].max()):
        return (
            f"no curve can be told: what the {best.name} bends is within its uncertainty; what else the model lacks "
            "comes first: edge-daemon diagnose"
        )
    way = "stiffens" if ends.mean() > middle else "softens"
    least = f"the {best.name} describes it best (held-out error {best.nrmse:.3%})"
    if best.name == "table":
        return f"the gear {way} with twist by a law of neither form; {least}"
    return f"the gear {way} with twist, {ends.mean() / middle - 1:+.0%} at the ends; {least}: add {best.name}_stiffness"


def _document(found: StiffnessMap, ranges: list[Range], gear: Gear | None) -> dict[str, Any]:
    return {
        "unit": "N m/rad",
        "twist_rad": found.twist_rad.tolist(),
        "torque_Nm": found.torque_Nm.tolist(),
        "forms": [
            {
                "form": form.name,
                "nrmse": form.nrmse,
                "stiffness": form.stiffness_Nm_per_rad.tolist(),
                "sd": form.sd_Nm_per_rad.tolist(),
                "numbers": {key: {"value": v, "sd": s, "unit": u} for key, (v, s, u) in form.numbers.items()},
            }
            for form in found.forms
        ],
        "best": found.best.name,
        "gear": gear.name if gear else None,
        "maker": [
            {
                "range": row.name,
                "torque_Nm": [x if math.isfinite(x) else None for x in row.torque_Nm],
                "maker": row.maker_Nm_per_rad,
                "value": row.found[0] if row.found else None,
                "sd": row.found[1] if row.found else None,
            }
            for row in ranges
        ],
        "verdict": verdict(found),
    }
