"""What can still be read of a damaged store, copied row by row into a new one."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

from edge_daemon.store.schema import StoreError, legible, open_writer
from edge_daemon.store.seal import is_whole, seal

COLUMNS = {
    "drive": ("id", "name"),
    "nameset": ("id", "names"),
    "chunk": ("drive", "start_s", "end_s", "data"),
    "snapshot": ("drive", "time_s", "sequence", "state", "reasons", "nameset", "data"),
    "hour": ("drive", "hour", "data"),
    "event": ("drive", "time_s", "severity", "source", "message"),
    "message": ("drive", "run", "topic", "sequence", "data"),
    "state": ("key", "data"),
}
"""The columns of each table that its checksum covers; names come before what refers to them."""
WITHOUT_NUMBERS = ("hour", "state")
"""These tables are read in one go, for their rows have no number to go on from."""


def salvaged(store: Path, target: Path) -> dict[str, tuple[int, int]]:
    """Table -> rows kept and lost. Raises `StoreError` where there is nothing to read, or `target` exists."""
    if not store.is_file():
        raise StoreError(f"{store}: no such file: expected a store")
    if target.exists():
        raise StoreError(f"{target}: exists: expected a new file")
    with closing(sqlite3.connect(f"file:{quote(str(store.absolute()))}?mode=ro", uri=True)) as old:
        old.text_factory = legible
        new, _ = open_writer(target)
        with closing(new):
            new.execute("BEGIN")
            done = {name: _copied(old, new, name) for name in COLUMNS}
            new.execute("COMMIT")
    if not any(kept for kept, _ in done.values()):
        raise StoreError(f"{store}: nothing in it can be read as a store")
    return done


def _copied(old: sqlite3.Connection, new: sqlite3.Connection, table: str) -> tuple[int, int]:
    columns = COLUMNS[table]
    names = {row[0]: row[1] for row in new.execute("SELECT id, names FROM nameset")}
    sealed = table not in ("drive", "nameset")
    into = (*columns, "crc") if sealed else columns
    insert = f"INSERT OR IGNORE INTO {table} ({', '.join(into)}) VALUES ({', '.join('?' * len(into))})"  # noqa: S608
    kept = lost = 0
    for row in _rows(old, table, columns):
        if row is None:
            lost += 1
            continue
        values, crc = row
        covered = tuple(names.get(v, b"") if name == "nameset" else v for name, v in zip(columns, values, strict=True))
        if not is_whole(crc, *covered):
            lost += 1
            continue
        new.execute(insert, (*values, seal(*covered)) if sealed else values)
        kept += 1
    return kept, lost


def _rows(
    old: sqlite3.Connection, table: str, columns: tuple[str, ...]
) -> Iterator[tuple[tuple[Any, ...], Any] | None]:
    """Each row with its checksum; None for a stretch that cannot be read."""
    try:
        crc = "crc" if any(row[1] == "crc" for row in old.execute(f"PRAGMA table_info({table})")) else "NULL"
    except sqlite3.DatabaseError:
        return
    wanted = f"{', '.join(columns)}, {crc}"
    if table in WITHOUT_NUMBERS:
        try:
            for row in old.execute(f"SELECT {wanted} FROM {table}"):  # noqa: S608
                yield row[:-1], row[-1]
        except sqlite3.DatabaseError:
            yield None
        return
    yield from _numbered(old, table, wanted)


def _numbered(old: sqlite3.Connection, table: str, wanted: str) -> Iterator[tuple[tuple[Any, ...], Any] | None]:
    """Rows by number; what cannot be read is stepped over, further each time."""
    number, step = 0, 1
    while True:
        query = f"SELECT rowid, {wanted} FROM {table} WHERE rowid > ? ORDER BY rowid"  # noqa: S608
        try:
            for row in old.execute(query, (number,)):
                number, step = row[0], 1
                yield row[1:-1], row[-1]
            return
        except sqlite3.DatabaseError:
            yield None
            number, step = number + step, 2 * step
            if step > 2**40:
                return
