"""Every write and sync of the store fails in turn, and the power is cut between any two of them."""

from __future__ import annotations

import itertools
import random
import sys
from pathlib import Path

import pytest

from edge_daemon.store.reader import StoreReader
from edge_daemon.store.ring import Store, StoreError
from tests.store.faulty_files import FULL, SYNC_FAILED, WRITE_FAILED, FaultyFiles, sqlite_library
from tests.store.stored import SMALL, block, filled, same, sound

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or sqlite_library() is None, reason="SQLite is not a library of its own"
)
SECONDS = 12


def whole(path: Path) -> int:
    """Seconds that are stored without a gap from the beginning; each value is the one that was given."""
    with StoreReader(path) as reader:
        stored = list(reader.blocks("axis"))
        assert reader.damaged_rows == 0
    assert [row.sequence for row in stored] == list(range(len(stored)))
    assert all(same(row, block(row.sequence)) for row in stored)
    return len(stored) // 10


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_power_cut_at_any_write_keeps_what_was_committed(tmp_path: Path, seed: int) -> None:
    """What was not synced is dropped, torn or there before what came earlier."""
    rng = random.Random(seed)
    path, cuts = tmp_path / "s.sqlite", tmp_path / "cuts"
    committed, promised = 0, []

    def cut(number: int, call: str) -> int:
        if rng.random() < 0.3:
            folder = cuts / str(number)
            folder.mkdir(parents=True)
            files.after_cut(folder, rng)
            promised.append((folder, committed))
        return 0

    with FaultyFiles() as files:
        store = Store(SMALL, path)
        files.fails = cut
        for second in range(SECONDS):
            filled(store, second, second + 1)
            committed = second + 1
        files.fails = lambda number, call: 0
        store.close()
    assert len(promised) > 10
    for folder, seconds in promised:
        again = Store(SMALL, folder / path.name)
        assert again.notes == []
        assert seconds <= whole(folder / path.name) <= seconds + 1
        newest = again.load_state("newest")
        assert int(newest or b"-1") == whole(folder / path.name) - 1, "blocks and learned state are of one moment"
        again.close()


class Once:
    """The call of that number fails, and no other."""

    def __init__(self, number: int, code: int) -> None:
        self.kind = "sync" if code == SYNC_FAILED else "write"
        self.left, self.code = number, code

    def __call__(self, _: int, kind: str) -> int:
        self.left -= kind == self.kind
        return self.code if self.left == 0 and kind == self.kind else 0


@pytest.mark.slow
@pytest.mark.parametrize("code", [FULL, WRITE_FAILED, SYNC_FAILED])
def test_a_failure_of_any_call_loses_nothing(tmp_path: Path, code: int) -> None:
    """The first write or sync fails, in the next run the second, until there are none left to fail."""
    told = []
    for number in itertools.count(1):
        path, once, errors = tmp_path / f"{number}.sqlite", Once(number, code), 0
        with FaultyFiles() as files:
            store = Store(SMALL, path)
            files.fails = once
            for second in range(4):
                try:
                    filled(store, second, second + 1)
                except StoreError:
                    errors += 1
            store.commit()
            store.close()
        assert whole(path) == 4
        assert sound(path)
        if once.left > 0:
            break
        told.append(errors)
    assert len(told) > 4 and told[0] == 1 and max(told) == 1
