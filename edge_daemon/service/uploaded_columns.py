"""The columns of an uploaded recording, as the page asks about them: first rows, guesses, and what a person answered.

Only the head of a CSV file is read here; the file itself is read by the child process that compares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edge_daemon.channels import CHANNELS
from edge_daemon.errors import BadInput
from edge_daemon.recordings.column_map import ColumnMap, beside, keep, kept
from edge_daemon.recordings.column_meaning import TIME, formula_of, meaning, units_of
from edge_daemon.recordings.csv_file import read_head
from edge_daemon.service.column_guess import Guess, guessed

ROWS_SHOWN = 5


def preview(path: Path) -> dict[str, Any]:
    """`columns`: each with its `name`, first `values`, guessed `channel` and `unit`; `units` by channel; `ready`: it
    can be compared as it is. No columns of Parquet, which has its own names. Raises `BadInput`."""
    if path.suffix == ".parquet":
        return {"columns": [], "units": {}, "ready": True}
    head = read_head(path, ROWS_SHOWN)
    known = kept(path)
    names = head.names or _numbered(head.columns)
    guesses = [_named(name) for name in head.names] or guessed(path, head.delimiter, head.columns)
    columns = [
        {"name": name, "values": [row[i] for row in head.rows if i < len(row)], **guess}
        for i, (name, guess) in enumerate(zip(names, guesses, strict=True))
    ]
    there = set(names) | set(known.formulas)
    ready = TIME in there and bool(there & {"theta_in_rad", "theta_out_rad"})
    return {"columns": columns, "units": {name: list(units_of(name)) for name in (TIME, *CHANNELS)}, "ready": ready}


def keep_columns(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Keeps, beside the file, what each column is: `name`, `channel` (empty: not wanted), `unit`, `reverse`. Raises
    `BadInput`."""
    head = read_head(path, ROWS_SHOWN)
    names = head.names or _numbered(head.columns)
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
    plain = {channel: formula for channel, formula in formulas.items() if formula != channel}
    try:
        if plain or not head.names:
            keep(path, ColumnMap(() if head.names else tuple(names), plain))
        else:
            beside(path).unlink(missing_ok=True)
    except OSError as error:
        raise BadInput(f"{path.name}: what its columns are cannot be kept: {error.strerror}") from error


def _named(name: str) -> Guess:
    channel, unit = meaning(name)
    return {"channel": channel, "unit": unit}


def _numbered(count: int) -> list[str]:
    return [f"column_{i + 1}" for i in range(count)]
