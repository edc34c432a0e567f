"""The columns of an uploaded recording, as the page asks about them: first rows, guesses, and what a person answered.

Only the head of a CSV file is read here; the file itself is read by the child process that compares.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edge_daemon.channels import CHANNELS
from edge_daemon.errors import BadInput
from edge_daemon.recordings.column_map import ColumnMap, beside, keep, kept
from edge_daemon.recordings.column_meaning import TIME, formula_of, meaning, units_of
from edge_daemon.service.column_guess import Guess, guessed

HEAD_BYTES = 16_384
ROWS_SHOWN = 5
NUMBER = re.compile(r"[-+]?[\d.,]+([eE][-+]?\d+)?")


def preview(path: Path) -> dict[str, Any]:
    """`columns`: each with its `name`, first `values`, guessed `channel` and `unit`; `units` by channel; `ready`: it
    can be compared as it is. No columns of Parquet, which has its own names. Raises `BadInput`."""
    if path.suffix == ".parquet":
        return {"columns": [], "units": {}, "ready": True}
    names, rows = _head(path)
    known = kept(path)
    nameless = names == _numbered(len(names))
    guesses = guessed(path, _mark(path), len(names)) if nameless else [_named(name) for name in names]
    columns = [
        {"name": name, "values": [row[i] for row in rows if i < len(row)], **guess}
        for i, (name, guess) in enumerate(zip(names, guesses, strict=True))
    ]
    there = set(names) | set(known.formulas)
    ready = TIME in there and bool(there & {"theta_in_rad", "theta_out_rad"})
    return {"columns": columns, "units": {name: list(units_of(name)) for name in (TIME, *CHANNELS)}, "ready": ready}


def keep_columns(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Keeps, beside the file, what each column is: `name`, `channel` (empty: not wanted), `unit`, `reverse`. Raises
    `BadInput`."""
    names, _ = _head(path)
    formulas: dict[str, str] = {}
    for row in rows:
        name, channel, unit = (str(row.get(key, "")) for key in ("name", "channel", "unit"))
        if not channel:
            continue
        if name not in names:
            raise BadInput(f"column {name[:40]!r}: expected one of {', '.join(names[:8])}")
        if channel in formulas:
            raise BadInput(f"{channel}: chosen for two columns: expected one")
        formulas[channel] = formula_of(name, channel, unit, reverse=row.get("reverse") is True)
    if TIME not in formulas:
        raise BadInput(f"{TIME}: chosen for no column: expected one")
    headerless = names == _numbered(len(names))
    plain = {channel: formula for channel, formula in formulas.items() if formula != channel}
    try:
        if plain or headerless:
            keep(path, ColumnMap(tuple(names) if headerless else (), plain))
        else:
            beside(path).unlink(missing_ok=True)
    except OSError as error:
        raise BadInput(f"{path.name}: what its columns are cannot be kept: {error.strerror}") from error


def _named(name: str) -> Guess:
    channel, unit = meaning(name)
    return {"channel": channel, "unit": unit}


def _head(path: Path) -> tuple[list[str], list[list[str]]]:
    """Column names, numbered where there is no header, and the first rows. Raises `BadInput`."""
    try:
        with path.open("rb") as file:
            text = file.read(HEAD_BYTES).decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise BadInput(f"{path.name}: cannot read: {error.strerror}") from error
    lines = [line for line in text.splitlines()[: ROWS_SHOWN + 20] if line.strip() and not line.startswith("#")]
    if not lines:
        raise BadInput(f"{path.name}: empty: expected rows of numbers")
    mark = _mark_of(lines[0])
    cells = [[cell.strip().strip('"') for cell in line.split(mark)] for line in lines[: ROWS_SHOWN + 1]]
    if all(NUMBER.fullmatch(cell) for cell in cells[0]):
        return _numbered(len(cells[0])), cells[:ROWS_SHOWN]
    return cells[0], cells[1:]


def _mark(path: Path) -> str:
    with path.open("rb") as file:
        return _mark_of(file.readline(HEAD_BYTES).decode("utf-8-sig", errors="replace"))


def _mark_of(line: str) -> str:
    return next((one for one in ";\t" if one in line), ",")


def _numbered(count: int) -> list[str]:
    return [f"column_{i + 1}" for i in range(count)]
