"""The models of many units fitted anew to their recordings, on Dask: after the catalogue has grown, or as they are."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from edge_daemon.effects.model import Model
from edge_daemon.effects.model_file import read_model
from edge_daemon.effects.model_undo import rewrite
from edge_daemon.errors import BadInput
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.compare import compare
from edge_daemon.fleet.engine import mapped
from edge_daemon.recordings.recording import Recording, read_recording
from edge_daemon.service.subsample import shortened
from edge_daemon.text import number, table, written_as_json

SUFFIXES = (".csv", ".parquet")
WORTH = 0.9
"""An effect stays in a unit's model where the held-out error falls to this share or below (guess): one that the gear
does not have leaves that error as it was, or larger."""


@dataclass(frozen=True, slots=True)
class RefittedUnit:
    """What became of one unit's model; `left_out` says why nothing could."""

    unit: str
    before: float
    after: float
    noise_floor: float
    kept: bool
    """whether the effect stays in the model"""
    left_out: str = ""

    def to_json(self) -> dict[str, Any]:
        """One row of `units`."""
        if self.left_out:
            return {"unit": self.unit, "left_out": self.left_out}
        errors = {"nrmse_before": self.before, "nrmse_after": self.after, "noise_floor_nrmse": self.noise_floor}
        return {"unit": self.unit, **errors, "kept": self.kept}


def refit(arguments: argparse.Namespace) -> None:
    """Fit every unit's model anew; with `--effect`, with and without that one more."""
    units = list(_units(arguments.folder))
    if not units:
        raise BadInput(f"{arguments.folder}: no folder with a model (.toml) and recordings: expected one for each unit")
    work = partial(_refitted, folder=arguments.folder, effect=arguments.effect, write=arguments.write)
    found = mapped(work, units, arguments.scheduler)
    told = {"effect": arguments.effect, "written": arguments.write, "units": [row.to_json() for row in found]}
    if not written_as_json(told, arguments.json):
        print(*_lines(found, arguments.effect, arguments.write), sep="\n")


def _units(folder: Path) -> Iterator[Path]:
    """Model files that stand alone in a folder with recordings."""
    for parent in sorted({path.parent for path in folder.rglob("*.toml")}):
        models = [path for path in parent.glob("*.toml") if not path.name.endswith(".columns.toml")]
        if len(models) == 1 and _recordings(parent):
            yield models[0]


def _recordings(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix in SUFFIXES)


def _refitted(model_file: Path, folder: Path, effect: str | None, write: bool) -> RefittedUnit:
    """One unit's model, wherever Dask computes it; what is wrong with one unit does not hold up the others."""
    unit = str(model_file.parent.relative_to(folder))
    try:
        model = read_model(model_file)
        recordings = shortened([read_recording(path) for path in _recordings(model_file.parent)])
        row, better = _fitted(unit, model, recordings, effect)
        if write:
            rewrite(model_file, better, f"add {effect}" if row.kept else "fit")
    except BadInput as error:
        return RefittedUnit(unit, 0.0, 0.0, 0.0, False, str(error))
    return row


def _fitted(unit: str, model: Model, recordings: Sequence[Recording], effect: str | None) -> tuple[RefittedUnit, Model]:
    if effect is None or model.effect(effect) is not None:
        found = compare(recordings, model)
        error = found.error
        return RefittedUnit(unit, error.nrmse, error.nrmse, error.noise_floor_nrmse, effect is not None), found.model
    done = add_effect(model, effect, recordings, unit)
    row = (unit, done.before.nrmse, done.after.nrmse, done.after.noise_floor_nrmse)
    if done.after.nrmse <= WORTH * done.before.nrmse:
        return RefittedUnit(*row, True), done.model
    return RefittedUnit(*row, False), compare(recordings, model).model


def _lines(found: Sequence[RefittedUnit], effect: str | None, write: bool) -> Iterator[str]:
    done = sorted((row for row in found if not row.left_out), key=lambda row: row.after / max(row.before, 1e-12))
    head = ("unit", "error before %", "after %", "sensor noise %", effect or "")
    cells = [
        (row.unit, *(number(100 * value, 3) for value in (row.before, row.after, row.noise_floor)), _word(row, effect))
        for row in done
    ]
    yield table(head, cells) if done else "no model could be fitted"
    if effect:
        yield f"{sum(row.kept for row in done)} of {len(done)} units have {effect}"
    yield "models written" if write else "nothing written: --write changes the models"
    yield from (f"left out: {row.unit}: {row.left_out}" for row in found if row.left_out)


def _word(row: RefittedUnit, effect: str | None) -> str:
    return "" if effect is None else "kept" if row.kept else "not in this one"
