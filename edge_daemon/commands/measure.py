"""`measure`: the stiffness of a gear from recordings, by one method or by all of them side by side."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from edge_daemon.commands.recordings import read_told
from edge_daemon.effects.model import Model
from edge_daemon.effects.model_file import read_model
from edge_daemon.errors import BadInput
from edge_daemon.recordings.recording import Recording
from edge_daemon.records import Array
from edge_daemon.stiffness.methods import METHODS, Method, MethodComparison, StiffnessMeasurement, compare_methods
from edge_daemon.stiffness.methods import measure as measured
from edge_daemon.text import number, table, with_sd, written_as_json

PHASE = "profile_phase"
"""A test motion leaves this column: 0 at rest, its parts counted from 1."""
NEEDED = ("theta_in_rad", "theta_out_rad")


@dataclass(frozen=True, slots=True)
class Attempt:
    """One method on one recording."""

    method: Method
    recording: Path
    found: StiffnessMeasurement | None
    reason: str
    """why there is none; empty where there is"""


def measure(arguments: argparse.Namespace) -> None:
    """The stiffness by `arguments.method`, or by all. Raises `BadInput` where no method finds any."""
    model = read_model(arguments.model)
    _check(arguments, model)
    methods: Sequence[Method] = METHODS if arguments.method == "all" else (arguments.method,)
    attempts = []
    for path in arguments.recording:
        recording = read_told(path)
        time_s, columns = _chosen(path, recording, arguments.phase)
        attempts += [_tried(method, path, time_s, columns, model, arguments.inertia_sd) for method in methods]
    best = _best(attempts, methods)
    if not best:
        raise BadInput("; ".join(f"{row.recording}: {row.reason}" for row in attempts))
    compared = compare_methods([row.found for row in best if row.found])
    if written_as_json(_document(attempts, best, compared), arguments.json):
        return
    print(_shown(attempts, best, compared))


def _check(arguments: argparse.Namespace, model: Model) -> None:
    where = f"{arguments.model}: joint"
    if model.balance != "torsion":
        raise BadInput(f"{where}.balance: {model.balance!r}: expected 'torsion': a stiffness wants two encoders")
    if not 0 < model.output_inertia_kg_m2 < math.inf:
        raise BadInput(f"{where}.output_inertia_kg_m2: missing: expected the inertia of all that turns with the output")
    if not 0 <= arguments.inertia_sd < math.inf:
        raise BadInput(f"--inertia-sd {arguments.inertia_sd}: expected 0 or more, in kg m^2")


def _chosen(path: Path, recording: Recording, phases: Sequence[int]) -> tuple[Array, Mapping[str, Array]]:
    """The rows to measure on: with a phase column only the motion itself, or the named parts of it."""
    missing = [name for name in NEEDED if name not in recording.columns]
    if missing:
        raise BadInput(f"{path}: no column {missing[0]}: expected it beside {', '.join(list(recording.columns)[:8])}")
    phase = recording.columns.get(PHASE)
    if phase is None:
        if phases:
            raise BadInput(f"{path}: no column {PHASE}: expected it for --phase")
        return recording.time_s, recording.columns
    kept = np.isin(phase, phases) if phases else phase > 0
    if np.count_nonzero(kept) < 2:
        there = sorted({int(part) for part in phase[np.isfinite(phase)]})
        raise BadInput(f"{path}: {PHASE}: no row of {phases or 'a motion'}: expected one of {there}")
    return recording.time_s[kept], {name: column[kept] for name, column in recording.columns.items()}


def _tried(
    method: Method, path: Path, time_s: Array, columns: Mapping[str, Array], model: Model, inertia_sd: float
) -> Attempt:
    try:
        found = measured(method, time_s, columns, model.ratio, model.output_inertia_kg_m2, inertia_sd, model.effects)
    except BadInput as error:
        return Attempt(method, path, None, str(error))
    if not (math.isfinite(found.stiffness_Nm_per_rad) and 0 < found.sd_Nm_per_rad < math.inf):
        return Attempt(method, path, None, f"{method}: this motion does not determine the stiffness")
    return Attempt(method, path, found, "")


def _best(attempts: Sequence[Attempt], methods: Sequence[Method]) -> list[Attempt]:
    """Per method the recording that suits it: fewest limits passed, then the smallest standard deviation.

    A method that moves is not judged on a recording that rests, if there is another: at rest it can but agree with the
    static one, and would hide what depends on speed.
    """
    rests = {row.recording for row in attempts if row.method == "static" and row.found}

    def rank(row: Attempt) -> tuple[bool, int, float]:
        assert row.found is not None
        passed = sum(not limit.kept for limit in row.found.limits)
        return row.method != "static" and row.recording in rests, passed, row.found.sd_Nm_per_rad

    rows = [[row for row in attempts if row.method == method and row.found] for method in methods]
    return [min(row, key=rank) for row in rows if row]


def _shown(attempts: Sequence[Attempt], best: Sequence[Attempt], compared: MethodComparison) -> str:
    rows, limits, lines = [], [], []
    for row in attempts:
        if row.found is None:
            lines.append(f"not measured: {row.recording}: {row.reason}")
            continue
        mark = "*" if len(attempts) > 1 and row in best else ""
        value = with_sd(row.found.stiffness_Nm_per_rad, row.found.sd_Nm_per_rad)
        harm = [limit.name for limit in row.found.limits if not limit.kept]
        rows.append((row.method, str(row.recording), value, mark, ", ".join(harm) or "none"))
        if row in best:
            limits += [(row.method, it.name, "no harm" if it.kept else "harms", it.detail) for it in row.found.limits]
    parts = [
        table(("method", "recording", "stiffness [N m/rad]", "best", "limits that harm"), rows),
        table(("method", "limit of its kind", "here", "seen"), limits),
    ]
    if lines:
        parts.append("\n".join(lines))
    if len(best) > 1:
        apart = [f"{a} - {b}: {z:+.1f} sd" for a, b, z in compared.pairs]
        parts.append("\n".join([*apart, f"verdict: {compared.verdict}"]))
    return "\n\n".join(parts)


def _document(attempts: Sequence[Attempt], best: Sequence[Attempt], compared: MethodComparison) -> dict[str, Any]:
    rows, failed = [], []
    for row in attempts:
        if row.found is None:
            failed.append({"method": row.method, "recording": str(row.recording), "reason": row.reason})
            continue
        it = row.found
        rows.append(
            {
                "method": row.method,
                "recording": str(row.recording),
                "value": it.stiffness_Nm_per_rad,
                "sd": it.sd_Nm_per_rad,
                "random_sd": it.random_sd_Nm_per_rad,
                "best": row in best,
                "limits": [{"name": x.name, "kept": x.kept, "detail": x.detail} for x in it.limits],
                "details": dict(it.details),
            }
        )
    several, first = len(best) > 1, next(row.found for row in best if row.found)
    return {
        "unit": "N m/rad",
        "measurements": rows,
        "failed": failed,
        "pairs": [{"a": a, "b": b, "difference_sd": z} for a, b, z in compared.pairs],
        "agree": compared.agree if several else None,
        "passed": list(compared.passed),
        "verdict": compared.verdict if several else f"{number(first.stiffness_Nm_per_rad)} N m/rad, by one method only",
    }
