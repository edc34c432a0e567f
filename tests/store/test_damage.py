"""Bits that the medium turned: never loaded, never fatal, always told."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.records import NE107, Event
from edge_daemon.store.reader import StoreReader
from edge_daemon.store.ring import Store
from edge_daemon.store.schema import StoreError
from tests.store.stored import EPOCH_S, SMALL, block, filled, same, snapshot

SECONDS = 5


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "s.sqlite"
    store = Store(SMALL, file)
    filled(store, 0, SECONDS)
    store.add_event(Event("axis", EPOCH_S, NE107.OK, "daemon", "measuring"))
    store.commit()
    store.close()
    return file


def turned(path: Path, table: str, column: str, where: str = "1") -> None:
    """One bit in the middle of a value, as SQLite itself would never notice."""
    with sqlite3.connect(path) as database:
        rows = database.execute(f"SELECT {column} FROM {table} WHERE {where} LIMIT 1").fetchall()
        data = bytearray(rows[0][0] if isinstance(rows[0][0], bytes) else rows[0][0].encode())
        data[len(data) // 2] ^= 0x10
        value = bytes(data) if isinstance(rows[0][0], bytes) else data.decode("latin-1")
        database.execute(f"UPDATE {table} SET {column} = ? WHERE {column} = ?", (value, rows[0][0]))


def test_a_chunk_that_was_changed_is_left_out_and_the_rest_is_read(path: Path) -> None:
    turned(path, "chunk", "data")
    with StoreReader(path) as reader:
        found = list(reader.blocks("axis"))
        assert reader.damaged_rows == 1
    given = [block(n) for n in range(10 * SECONDS)]
    assert len(found) == 10 * (SECONDS - 1)
    assert all(any(same(one, other) for other in given) for one in found)


def test_a_changed_time_is_told_from_the_one_that_was_written(path: Path) -> None:
    with sqlite3.connect(path) as database:
        database.execute("UPDATE snapshot SET time_s = time_s + 1e-3 WHERE id = 2")
    with StoreReader(path) as reader:
        rows = reader.estimates("axis", ["stiffness"])
        assert reader.damaged_rows == 1 and len(rows) == SECONDS - 1


def test_what_was_learned_is_not_loaded_from_a_changed_row(path: Path) -> None:
    turned(path, "state", "data")
    store = Store(SMALL, path)
    assert store.load_state("newest") is None
    assert store.counters()["damaged_rows"] == 1 and "newest" in store.notes[-1]
    store.save_state("newest", b"again")
    store.commit()
    assert store.load_state("newest") == b"again"
    store.close()


def test_a_changed_event_or_hour_is_left_out(path: Path) -> None:
    turned(path, "event", "message")
    turned(path, "hour", "data")
    with StoreReader(path) as reader:
        assert reader.events() == [] and reader.hours("axis") == []
        assert reader.damaged_rows == 2
    store = Store(SMALL, path)
    store.add_snapshot(snapshot(SECONDS))
    store.commit()
    assert "hour" in store.notes[-1]
    store.close()


@pytest.mark.parametrize("name", [b"chunk", b"state", b"snapshot"])
def test_a_byte_in_a_tables_name_costs_the_file_but_not_the_daemon(path: Path, name: bytes) -> None:
    content = bytearray(path.read_bytes())
    at = content.index(b"CREATE TABLE " + name) + len(b"CREATE TABLE ")
    content[at] = 0xFF
    known = content.index(b"table" + name + name)
    content[known + 5] = content[known + 5 + len(name)] = 0xFF
    path.write_bytes(content)
    store = Store(SMALL, path)
    assert "moved aside" in store.notes[0]
    filled(store, 0, 1)
    store.close()


def test_a_store_of_before_the_checksums_is_taken_over_and_read(path: Path) -> None:
    with sqlite3.connect(path) as database:
        for table in ("chunk", "snapshot", "event"):
            database.execute(f"ALTER TABLE {table} DROP COLUMN crc")
        for table, key in (("hour", "drive, hour"), ("state", "key")):
            columns = "drive, hour, data" if table == "hour" else "key, data"
            database.execute(f"CREATE TABLE old_{table} AS SELECT {columns} FROM {table}")
            database.execute(f"DROP TABLE {table}")
            types = {"hour": "drive INTEGER NOT NULL, hour INTEGER NOT NULL, data BLOB NOT NULL"}
            made = types.get(table, "key TEXT NOT NULL, data BLOB NOT NULL")
            database.execute(f"CREATE TABLE {table} ({made}, PRIMARY KEY ({key})) WITHOUT ROWID")
            database.execute(f"INSERT INTO {table} SELECT * FROM old_{table}")
            database.execute(f"DROP TABLE old_{table}")
        database.execute("PRAGMA user_version = 1")
    with StoreReader(path) as reader:
        assert len(list(reader.blocks("axis"))) == 10 * SECONDS
    store = Store(SMALL, path)
    assert store.notes == [] and store.load_state("newest") == str(SECONDS - 1).encode()
    filled(store, SECONDS, SECONDS + 1)
    store.close()
    turned(path, "chunk", "data", f"start_s > {EPOCH_S + SECONDS - 0.5}")
    with StoreReader(path) as reader:
        assert len(list(reader.blocks("axis"))) == 10 * SECONDS and reader.damaged_rows == 1


def test_export_says_what_it_leaves_out_and_salvage_copies_the_rest(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turned(path, "chunk", "data")
    assert main(["export", "--store", str(path), "--out", str(tmp_path / "e.csv")]) == 0
    assert "1 rows were changed on the disk and left out" in capsys.readouterr().out
    assert main(["salvage", str(path)]) == 0
    assert "chunk" in capsys.readouterr().out
    with StoreReader(path.with_name("s.sqlite.salvaged")) as reader:
        assert len(list(reader.blocks("axis"))) == 10 * (SECONDS - 1) and reader.damaged_rows == 0
        assert len(reader.estimates("axis", ["stiffness"])) == SECONDS
    assert main(["salvage", str(path)]) == 2


def test_no_flip_of_one_bit_is_fatal_or_comes_back_as_another_value(path: Path, tmp_path: Path) -> None:
    """Anywhere in the file: what is read afterwards was written, or is not read."""
    rng, whole = np.random.default_rng(7), path.read_bytes()
    given = {row.start_s: row for row in (block(n) for n in range(10 * SECONDS))}
    states = {str(second).encode() for second in range(SECONDS)}
    for trial in range(60):
        file = tmp_path / f"{trial}.sqlite"
        content = bytearray(whole)
        content[int(rng.integers(100, len(content)))] ^= 1 << int(rng.integers(8))
        file.write_bytes(content)
        try:
            with StoreReader(file) as reader:
                for drive in reader.drives():
                    assert all(same(row, given[row.start_s]) for row in reader.blocks(drive) if drive == "axis")
                    assert all(row.value == 1.0 for row in reader.estimates(drive, ["stiffness"]))
        except StoreError:
            pass
        store = Store(SMALL, file)
        assert store.load_state("newest") in {None, *states}
        filled(store, SECONDS, SECONDS + 1)
        store.close()
