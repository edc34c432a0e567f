"""The ring survives what happens to disks: kills, full ones, damage, files of another version."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.store.reader import StoreReader
from edge_daemon.store.ring import Store, StoreError, StoreFull
from tests.store.stored import SMALL, block, filled, same, sound

KILLED = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from edge_daemon.store.ring import Store
from stored import SMALL, filled
store = Store(SMALL, Path({path!r}))
for second in range(10_000):
    filled(store, second, second + 1)
    print(second, flush=True)
"""


@pytest.mark.parametrize("after", [1, 17, 60])
def test_a_kill_at_any_moment_loses_nothing_that_was_committed(tmp_path: Path, after: int) -> None:
    path = tmp_path / "s.sqlite"
    code = KILLED.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        for _ in range(after):
            committed = int(child.stdout.readline())
        child.send_signal(signal.SIGKILL)
        rest = child.stdout.read().split()
        committed = int(rest[-1]) if rest else committed
        child.wait(timeout=10)
    store = Store(SMALL, path)
    assert store.notes == []
    newest = store.load_state("newest")
    assert newest is not None
    assert int(newest) >= committed
    with StoreReader(path) as reader:
        stored = list(reader.blocks("axis"))
    assert len(stored) == 10 * (int(newest) + 1), "blocks and learned state are of one moment"
    assert all(same(row, block(number)) for number, row in enumerate(stored))
    store.close()
    assert sound(path)


LIMITED = """
import resource, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from edge_daemon.store.ring import Store, StoreFull
from stored import SMALL, filled
path = Path({path!r})
store = Store(SMALL, path)
filled(store, 0, 20)
soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
size = max(path.stat().st_size, path.with_name(path.name + "-wal").stat().st_size)
resource.setrlimit(resource.RLIMIT_FSIZE, (size + 10_000, hard))
full = 0
for second in range(20, 60):
    try:
        filled(store, second, second + 1)
    except StoreFull:
        full += 1
print("full", full, store.counters()["waiting_bytes"])
resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
filled(store, 60, 61)
store.close()
"""


def test_a_full_disk_is_told_loses_nothing_stored_and_the_rest_follows_when_there_is_space(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    code = LIMITED.format(tests=str(Path(__file__).parent), path=str(path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    word, times, waiting = done.stdout.split()
    assert word == "full"
    assert int(times) > 5
    assert int(waiting) > 10_000
    assert sound(path)
    with StoreReader(path) as reader:
        stored = list(reader.blocks("axis"))
    assert [row.sequence for row in stored] == list(range(610))
    assert all(same(row, block(row.sequence)) for row in stored)


def test_what_waits_is_bounded_while_nothing_can_be_written(tmp_path: Path) -> None:
    store = Store(SMALL, tmp_path / "file" / "s.sqlite")
    store.close()
    (tmp_path / "plain").write_text("")
    store = Store(SMALL, tmp_path / "plain" / "s.sqlite")
    assert "cannot be opened" in store.notes[0]
    large = {str(i): np.random.default_rng(i).normal(0, 1, 5000) for i in range(4)}
    for number in range(40):
        store.add_block(block(number, values=large))
        if number % 10 == 9:
            with pytest.raises(StoreError, match="cannot be opened"):
                store.commit()
    counters = store.counters()
    assert counters["waiting_bytes"] <= 2**20
    assert counters["dropped_blocks"] > 30
    (tmp_path / "plain").unlink()
    store.commit()
    with StoreReader(tmp_path / "plain" / "s.sqlite") as reader:
        assert [row.sequence for row in reader.blocks("axis")][-1] == 39


def test_a_full_database_is_told_as_full(tmp_path: Path) -> None:
    store = Store(SMALL, tmp_path / "s.sqlite")
    filled(store, 0, 2)
    assert store.database is not None
    store.database.execute("PRAGMA max_page_count = 1")
    with pytest.raises(StoreFull, match="no space left"):
        filled(store, 2, 40)
    store.database.execute("PRAGMA max_page_count = 2000")
    store.commit()
    with StoreReader(tmp_path / "s.sqlite") as reader:
        sequences = [row.sequence for row in reader.blocks("axis")]
    assert sequences == list(range(len(sequences)))


@pytest.mark.parametrize("damage", ["header", "pages", "text"])
def test_a_damaged_file_is_moved_aside_and_a_new_one_begun(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "s.sqlite"
    store = Store(SMALL, path)
    filled(store, 0, 30)
    store.close()
    content = bytearray(path.read_bytes())
    if damage == "header":
        content[:100] = os.urandom(100)
    elif damage == "pages":
        content[4096 * 2 : 4096 * 40] = os.urandom(4096 * 38)
    path.write_bytes(b"not a database at all, but long enough to be read as one" * 100 if damage == "text" else content)
    again = Store(SMALL, path)
    assert len(again.notes) == 1
    assert "moved aside" in again.notes[0]
    assert len(list(tmp_path.glob("s.sqlite.damaged-*"))) == 1
    filled(again, 40, 42)
    with StoreReader(path) as reader:
        assert len(list(reader.blocks("axis"))) == 20


def test_damage_found_while_running_costs_the_file_but_not_the_daemon(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    store = Store(SMALL, path)
    filled(store, 0, 30)
    assert store.database is not None
    store.database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    store.database.execute("PRAGMA cache_size = 0")
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(os.urandom(path.stat().st_size - 4096))
    with pytest.raises(StoreError, match="moved aside"):
        filled(store, 30, 31)
    filled(store, 31, 32)
    with StoreReader(path) as reader:
        assert [row.sequence for row in reader.blocks("axis")] == list(range(300, 320))
    assert "moved aside" in store.notes[-1]


def test_a_file_of_a_later_version_is_kept_aside_and_a_foreign_one_is_not_touched(tmp_path: Path) -> None:
    later = tmp_path / "later.sqlite"
    Store(SMALL, later).close()
    with sqlite3.connect(later) as database:
        database.execute("PRAGMA user_version = 99")
    assert "version 99" in Store(SMALL, later).notes[0]
    assert len(list(tmp_path.glob("later.sqlite.damaged-*"))) >= 1
    foreign = tmp_path / "foreign.sqlite"
    with sqlite3.connect(foreign) as database:
        database.execute("CREATE TABLE holiday (photo BLOB)")
    with pytest.raises(StoreError, match="another program"):
        Store(SMALL, foreign)
    with pytest.raises(StoreError, match="no store"):
        StoreReader(foreign)
    with pytest.raises(StoreError, match="no such file"):
        StoreReader(tmp_path / "absent.sqlite")
