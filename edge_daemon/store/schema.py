"""The file: its tables, how it is opened, and what happens to one that is damaged."""

from __future__ import annotations

import contextlib
import os
import sqlite3
import time
from contextlib import suppress
from pathlib import Path

from edge_daemon.errors import BadInput

APPLICATION_ID = 0x45444744
"""This marks an SQLite file as ours ("EDGD")."""
VERSION = 3
"""Version of the tables: a file of a later one is moved aside, not touched."""
PAGE_BYTES = 4096
BUSY_MS = 2000
"""Another process that writes is waited for this long."""
CHECKED_BYTES = 64 * 2**20
"""A file up to this size is checked page by page at start; reading a larger one from an SD card would delay the start
(guess: 40 MB/s, 1.6 s)."""
KEPT_ASIDE = 2
"""So many damaged files are kept for inspection; older ones are deleted, so that damage cannot fill the disk."""

TABLES = """
CREATE TABLE drive (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE);
CREATE TABLE nameset (id INTEGER PRIMARY KEY, names BLOB NOT NULL UNIQUE);
CREATE TABLE chunk (
  id INTEGER PRIMARY KEY, drive INTEGER NOT NULL, start_s REAL NOT NULL, end_s REAL NOT NULL, data BLOB NOT NULL,
  crc INTEGER);
CREATE INDEX chunk_time ON chunk (drive, end_s);
CREATE TABLE snapshot (
  id INTEGER PRIMARY KEY, drive INTEGER NOT NULL, time_s REAL NOT NULL, sequence INTEGER NOT NULL,
  state INTEGER NOT NULL, reasons TEXT NOT NULL, nameset INTEGER NOT NULL, data BLOB NOT NULL,
  crc INTEGER);
CREATE INDEX snapshot_time ON snapshot (drive, time_s);
CREATE TABLE hour (
  drive INTEGER NOT NULL, hour INTEGER NOT NULL, data BLOB NOT NULL, crc INTEGER,
  PRIMARY KEY (drive, hour)) WITHOUT ROWID;
CREATE TABLE event (
  id INTEGER PRIMARY KEY, drive TEXT NOT NULL, time_s REAL NOT NULL, severity INTEGER NOT NULL,
  source TEXT NOT NULL, message TEXT NOT NULL, crc INTEGER);
CREATE INDEX event_time ON event (time_s);
CREATE TABLE IF NOT EXISTS message (
  id INTEGER PRIMARY KEY, drive TEXT NOT NULL, run INTEGER NOT NULL, topic TEXT NOT NULL, sequence INTEGER NOT NULL,
  data BLOB NOT NULL, crc INTEGER);
CREATE INDEX IF NOT EXISTS message_number ON message (drive, run, topic, sequence);
CREATE TABLE state (key TEXT PRIMARY KEY, data BLOB NOT NULL, crc INTEGER) WITHOUT ROWID;
"""
MESSAGES = TABLES[TABLES.index("CREATE TABLE IF NOT EXISTS message") : TABLES.index("CREATE TABLE state")]
"""What was published, by its number, is kept since version 3."""
SEALED = ("chunk", "snapshot", "hour", "event", "state")
"""Tables whose rows carry a checksum since version 2."""


class StoreError(BadInput):
    """The store cannot be read or written now; one line with the file and the reason."""


class StoreFull(StoreError):
    """No space: what was stored before is intact, what is new stays buffered."""


def open_writer(path: Path) -> tuple[sqlite3.Connection, list[str]]:
    """A connection to the file, made anew where needed, and what was repaired.

    A damaged file or one of a later version is moved aside. Raises `StoreError` where the file cannot be opened or
    belongs to something else.
    """
    notes: list[str] = []
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        connection, problem = _try_open(path)
        if connection is None:
            aside = move_aside(path)
            notes.append(f"{path}: {problem}: moved aside as {aside.name}; a new store is begun")
            connection, problem = _try_open(path)
        if connection is None:
            raise StoreError(f"{path}: {problem}")
    except (OSError, sqlite3.Error) as error:
        raise StoreError(f"{path}: cannot be opened for writing: {error}") from error
    return connection, notes


def _try_open(path: Path) -> tuple[sqlite3.Connection | None, str]:
    """An open, checked, current file; or None and why it cannot be used. Raises `sqlite3.Error` where it may later."""
    connection = sqlite3.connect(path, timeout=BUSY_MS / 1000, isolation_level=None, check_same_thread=False)
    connection.text_factory = legible
    try:
        problem = _prepare(connection, path)
    except sqlite3.DatabaseError as error:
        connection.close()
        if is_damage(error):
            return None, str(error)
        raise
    except BaseException:
        connection.close()
        raise
    if problem:
        connection.close()
        return None, problem
    return connection, ""


def _prepare(connection: sqlite3.Connection, path: Path) -> str:
    """Check, or create, the tables; why the file cannot be used, empty if it can."""
    tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    mark = connection.execute("PRAGMA application_id").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if tables and mark != APPLICATION_ID:
        raise StoreError(f"{path}: is an SQLite file of another program: expected a store, or no file")
    if version > VERSION:
        return f"is of version {version}, this program knows {VERSION}"
    if tables:
        problem = _damage(connection, path) or _misshapen(connection, version)
        if problem:
            return problem
    else:
        connection.execute(f"PRAGMA page_size = {PAGE_BYTES}")
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA temp_store = MEMORY")
    if not tables:
        connection.executescript(
            f"BEGIN IMMEDIATE; {TABLES}"
            f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {VERSION}; COMMIT;"
        )
    elif version < VERSION:
        steps = "".join(f"ALTER TABLE {table} ADD COLUMN crc INTEGER; " for table in SEALED if version < 2)
        steps += MESSAGES
        connection.executescript(f"BEGIN IMMEDIATE; {steps}PRAGMA user_version = {VERSION}; COMMIT;")
    else:
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("ROLLBACK")
    return ""


def legible(raw: bytes) -> str:
    """Text from the file, also where a byte of it was turned: SQLite's module would refuse the whole row."""
    return raw.decode("utf-8", "replace")


def _columns(connection: sqlite3.Connection) -> set[tuple[str, str]]:
    query = "SELECT m.name, c.name FROM sqlite_master m JOIN pragma_table_info(m.name) c WHERE m.type = 'table'"
    return {(table, column) for table, column in connection.execute(query)}


def _misshapen(connection: sqlite3.Connection, version: int) -> str:
    """Which table or column is not there, as where a byte of its name was turned; empty if all are."""
    with contextlib.closing(sqlite3.connect(":memory:")) as fresh:
        fresh.executescript(TABLES)
        wanted = _columns(fresh)
    lost = {
        row
        for row in wanted - _columns(connection)
        if version >= (3 if row[0] == "message" else 2 if row[1] == "crc" else 1)
    }
    return f"damaged: {'.'.join(min(lost))} is not there" if lost else ""


def _damage(connection: sqlite3.Connection, path: Path) -> str:
    """What is broken; empty if nothing was found. A large file is only sampled."""
    if path.stat().st_size <= CHECKED_BYTES:
        found = connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
        return "" if found == "ok" else f"damaged: {' '.join(str(found).split())}"
    for table in ("chunk", "snapshot", "event"):
        for order in ("ASC", "DESC"):
            connection.execute(f"SELECT * FROM {table} ORDER BY rowid {order} LIMIT 1").fetchall()  # noqa: S608
    connection.execute("SELECT * FROM state").fetchall()
    return ""


def compact(path: Path, connection: sqlite3.Connection) -> str:
    """Close the connection and give the file's free pages back to the file system; why not, empty if it worked.

    The copy is complete and synced before it takes the file's place.
    """
    smaller = path.with_name(path.name + ".compact")
    try:
        smaller.unlink(missing_ok=True)
        connection.execute("VACUUM INTO ?", (str(smaller),))
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        connection.close()
        with smaller.open("rb") as file:
            os.fsync(file.fileno())
        for suffix in ("-wal", "-shm"):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        smaller.replace(path)
    except (OSError, sqlite3.Error) as error:
        connection.close()
        with suppress(OSError):
            smaller.unlink(missing_ok=True)
        return f"{path}: larger than its limit and cannot be made smaller: {error}"
    return ""


def is_damage(error: sqlite3.Error) -> bool:
    """True where the file itself is broken, not the disk or the moment."""
    return _primary(error) in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def is_full(error: sqlite3.Error) -> bool:
    """True where nothing can be appended: no space, a quota, a limit of the file system or the process."""
    return _primary(error) == sqlite3.SQLITE_FULL or getattr(error, "sqlite_errorcode", 0) == sqlite3.SQLITE_IOERR_WRITE


def _primary(error: sqlite3.Error) -> int:
    return int(getattr(error, "sqlite_errorcode", 0)) & 0xFF


def move_aside(path: Path) -> Path:
    """Rename the file and its journal, out of the way but not lost; where the file now is."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    aside = path.with_name(f"{path.name}.damaged-{stamp}")
    serial = 1
    while aside.exists():
        serial += 1
        aside = path.with_name(f"{path.name}.damaged-{stamp}-{serial}")
    for suffix in ("-wal", "-shm", ""):
        part = path.with_name(path.name + suffix)
        if part.exists():
            part.rename(aside.with_name(aside.name + suffix))
    kept = sorted(p for p in path.parent.glob(f"{path.name}.damaged-*") if not p.name.endswith(("-wal", "-shm")))
    for old in kept[:-KEPT_ASIDE]:
        for suffix in ("-wal", "-shm", ""):
            old.with_name(old.name + suffix).unlink(missing_ok=True)
    return aside
