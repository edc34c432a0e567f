"""What the page computes, in a process of its own: compare, diagnose or extend a drive's model on a stretch of data.

Run by the daemon as `python -m edge_daemon.service.model_job`; the result is JSON on standard output, progress is
lines of `share words` on standard error. It works on files only, never talks to the daemon; a model changed is noticed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from edge_daemon.discover.discover import discover
from edge_daemon.effects.model import Model
from edge_daemon.effects.model_file import read_model
from edge_daemon.effects.model_undo import rewrite
from edge_daemon.errors import BadInput
from edge_daemon.explain.add import add_effect, remove_effect
from edge_daemon.explain.compare import compare
from edge_daemon.explain.interpretation import AXES, BINS, SHOWN_S, filled
from edge_daemon.explain.results import Comparison, OrderSpectrum, Series
from edge_daemon.recordings.recording import read_recording, write_recording
from edge_daemon.records import Array
from edge_daemon.service.model_report import of_diagnosis
from edge_daemon.service.model_versions import version
from edge_daemon.service.subsample import shortened
from edge_daemon.show.report import broken
from edge_daemon.store.export import recording_of
from edge_daemon.store.reader import StoreReader
from edge_daemon.text import shorts, write_json, write_text

MOST_ROWS = 200_000
"""A recording of so many rows is compared within what the unit's MemoryMax leaves beside the daemon."""
MOST_POINTS = 1500
DRAWN = [name for name in AXES if name != "direction"]
"""The direction is not drawn, since the twist rate shows it as well."""


def main(argv: Sequence[str] | None = None) -> int:
    """Exit 0 with JSON, 2 with one line on standard error."""
    arguments = _parser().parse_args(argv)
    try:
        write_json(arguments.run(arguments), "-")
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    except MemoryError:
        print("more memory is needed than may be had: choose a shorter stretch or recording", file=sys.stderr)
        return 2
    return 0


def _parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="edge_daemon.service.model_job")
    commands = top.add_subparsers(required=True)
    look = commands.add_parser("look")
    look.add_argument("--store", type=Path)
    look.add_argument("--drive", default="")
    look.add_argument("--seconds", type=float, default=30.0)
    look.add_argument("--until", type=float)
    look.set_defaults(run=_look)
    extend = commands.add_parser("extend")
    extend.add_argument("effect")
    extend.add_argument("--expression")
    extend.add_argument("--without", action="store_true", help="take the effect out instead")
    extend.add_argument("--write", action="store_true")
    extend.set_defaults(run=_extend)
    report = commands.add_parser("report")
    report.add_argument("--out", type=Path, required=True)
    report.set_defaults(run=_report)
    between = commands.add_parser("between")
    between.add_argument("versions", nargs=2)
    between.set_defaults(run=_between)
    for command in (look, extend, report, between):
        command.add_argument("--recording", type=Path, required=True)
        command.add_argument("--model", type=Path, required=True)
    return top


def _say(share: float, words: str) -> None:
    print(f"{share:.2f} {words}", file=sys.stderr, flush=True)


def _look(arguments: argparse.Namespace) -> dict[str, Any]:
    """Compare and diagnose; with `--store`, the recording is taken from there first."""
    if arguments.store:
        _say(0.02, "reading the stored data")
        _take(arguments)
    model, recordings = read_model(arguments.model), shortened([read_recording(arguments.recording)], MOST_ROWS)
    _say(0.1, "comparing")
    found = compare(recordings, model)
    _say(0.3, "trying effects")
    verdict = discover(recordings, model, lambda what, share: _say(0.3 + 0.69 * share, f"trying {what}"))
    _say(1.0, "done")
    return {
        "compare": found.to_json(),
        "diagnose": verdict.to_json(),
        "plots": _plots(found),
        "lineage": _lineage(model),
        "effects": [row.name for row in model.effects],
    }


def _take(arguments: argparse.Namespace) -> None:
    """Writes the asked stretch of stored data where the recording is expected."""
    drive, seconds, until_s = arguments.drive, arguments.seconds, arguments.until
    with StoreReader(arguments.store) as reader:
        end_s = reader.newest_s() if until_s is None else until_s
        time_s, columns = recording_of(reader, drive, end_s - seconds, end_s if until_s is not None else np.inf)
    if not len(time_s):
        when = "in the last" if until_s is None else f"before {datetime.fromtimestamp(end_s, UTC):%F %T} UTC, for"
        raise BadInput(f"no stored samples of {drive} {when} {seconds:g} s: are blocks kept ([store] keep_blocks)?")
    write_recording(arguments.recording, time_s, columns)


def _report(arguments: argparse.Namespace) -> dict[str, Any]:
    """Writes the page that `diagnose --report` writes."""
    model, recordings = read_model(arguments.model), shortened([read_recording(arguments.recording)], MOST_ROWS)
    verdict = discover(recordings, model, lambda what, share: _say(0.05 + 0.7 * share, f"trying {what}"))
    _say(0.8, "drawing")
    title = f"{arguments.model.name} against {arguments.recording.name}"
    write_text(arguments.out, of_diagnosis(verdict, compare(recordings, model), title))
    _say(1.0, "done")
    return {"bytes": arguments.out.stat().st_size}


def _extend(arguments: argparse.Namespace) -> dict[str, Any]:
    """Add an effect or take one out; the model file changes only with `--write`."""
    _say(0.1, f"fitting {'without' if arguments.without else 'with'} {arguments.effect}")
    model, recordings = read_model(arguments.model), shortened([read_recording(arguments.recording)], MOST_ROWS)
    if arguments.without:
        done = remove_effect(model, arguments.effect, recordings, arguments.recording.name)
    else:
        done = add_effect(model, arguments.effect, recordings, arguments.recording.name, arguments.expression or None)
    if arguments.write:
        rewrite(arguments.model, done.model, f"{'remove' if arguments.without else 'add'} {arguments.effect}")
    _say(1.0, "done")
    return {**done.to_json(), "lineage": _lineage(done.model), "effects": [row.name for row in done.model.effects]}


def _between(arguments: argparse.Namespace) -> dict[str, Any]:
    """Two versions of the model on one recording: the error of each, and every parameter of either."""
    recordings = shortened([read_recording(arguments.recording)], MOST_ROWS)
    rows, values = [], []
    for i, key in enumerate(arguments.versions):
        _say(0.1 + 0.4 * i, f"comparing {key}")
        found = compare(recordings, version(arguments.model, key))
        error = {"nrmse": found.error.nrmse, "noise_floor_nrmse": found.error.noise_floor_nrmse}
        rows.append({"key": key, **error, "effects": [row.name for row in found.model.effects]})
        values.append({(row.effect, row.name): row.to_json() for row in found.parameters})
    names = list(dict.fromkeys([*values[0], *values[1]]))
    parameters = [{"effect": name[0], "name": name[1], "of": [side.get(name) for side in values]} for name in names]
    _say(1.0, "done")
    return {"versions": rows, "parameters": parameters}


def _lineage(model: Model) -> list[dict[str, object]]:
    return [{"change": row.change, "nrmse": row.nrmse} for row in model.lineage]


# what plots need


def _plots(found: Comparison) -> dict[str, Any]:
    series = found.series
    unit = found.error.unit
    spectra = [_spectrum(row, unit) for row in found.spectra if len(row.at)]
    if series is None or not len(series.time_s):
        return {"unit": unit, "side_by_side": None, "residual": [], "spectra": spectra}
    shares = {row.axis: row.share for row in found.where}
    axes = sorted((axis for axis in DRAWN if axis in shares), key=lambda axis: -shares[axis])
    residuals = [row for axis in axes if (row := _against(series, axis, unit)) is not None]
    return {"unit": unit, "side_by_side": _side_by_side(series), "residual": residuals, "spectra": spectra}


def _side_by_side(series: Series) -> dict[str, Any]:
    inside = series.time_s - series.time_s[0] < SHOWN_S
    every = max(1, int(inside.sum()) // MOST_POINTS)
    columns = {"time_s": series.time_s - series.time_s[0], "measured": series.torque, "modelled": series.modelled}
    columns["residual"] = series.residual
    rows = broken(*(values[inside][::every] for values in columns.values()))
    time_s = np.interp(np.arange(len(rows[0])), np.flatnonzero(np.isfinite(rows[0])), rows[0][np.isfinite(rows[0])])
    return {name: shorts(values) for name, values in zip(columns, (time_s, *rows[1:]), strict=True)}


def _against(series: Series, axis: str, unit: str) -> dict[str, Any] | None:
    """Mean and scatter of the residual over equally filled bins of one axis; None where the axis was not measured."""
    row = AXES[axis]
    at: Array = np.asarray(getattr(series, row.field))
    good = np.isfinite(at) & np.isfinite(series.residual)
    if good.sum() < 10 * BINS:
        return None
    at, values = at[good] % row.period if row.period else at[good], series.residual[good]
    if axis == "time":
        at = at - at[0]
    parts = filled(at)
    mean = np.array([values[part].mean() for part in parts])
    sd = np.array([values[part].std() for part in parts])
    centre = np.array([at[part].mean() for part in parts])
    rows = {"at": centre, "mean": mean, "low": mean - sd, "high": mean + sd}
    return {"axis": axis, "unit": row.unit or unit, **{name: shorts(values) for name, values in rows.items()}}


def _spectrum(row: OrderSpectrum, unit: str) -> dict[str, Any]:
    """At most `MOST_POINTS` lines, each the largest of its neighbours: a peak is what it is looked at for."""
    width = -(-len(row.at) // MOST_POINTS)
    starts = np.arange(0, len(row.at), width)
    peak = np.maximum.reduceat(row.amplitude, starts)
    return {"axis": row.axis, "at": shorts(row.at[starts]), "amplitude": shorts(peak), "unit": unit}


if __name__ == "__main__":
    sys.exit(main())
