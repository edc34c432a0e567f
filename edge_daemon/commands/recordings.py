"""Recordings as commands read them: what was repaired in a file is said on standard error."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from edge_daemon.recordings.column_map import ColumnMap, beside, column_map, keep, kept
from edge_daemon.recordings.recording import Recording, read_recording


def read_told(path: Path) -> Recording:
    """The recording of a file; what was repaired in it is said on standard error. Raises `BadInput`."""
    recording = read_recording(path)
    for line in recording.notes.lines():
        print(f"{path}: {line}", file=sys.stderr)
    return recording


def named_columns(path: Path, arguments: argparse.Namespace) -> ColumnMap:
    """How a recording's columns are to be read: what `--columns` and `--map` say, upon what is kept beside it; names
    begin anew. Raises `BadInput`."""
    given = column_map(getattr(arguments, "columns", None), getattr(arguments, "mapped", ()))
    known = ColumnMap() if given.names else kept(path)
    return ColumnMap(given.names or known.names, {**known.formulas, **given.formulas})


def columns_told(path: Path, used: ColumnMap) -> Iterator[str]:
    """How the columns of a recording that was read are named; what is new is kept beside it, once it has served."""
    if not used:
        return
    try:
        if used != kept(path):
            keep(path, used)
    except OSError as error:
        yield f"how its columns are named cannot be kept beside it: {error.strerror}"
    else:
        yield f"columns are named as {beside(path).name} says"
