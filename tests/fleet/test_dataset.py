"""The dataset on disk, read by DuckDB and pyarrow: each row once, at any moment."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import duckdb
import pyarrow.dataset
import pyarrow.parquet as pq
import pytest

from edge_daemon.errors import BadInput
from edge_daemon.fleet import dataset as module
from edge_daemon.fleet.batch import Batch
from edge_daemon.fleet.collector import route_of
from edge_daemon.fleet.dataset import Dataset, date_of
from edge_daemon.fleet.heard import heard
from edge_daemon.fleet.shares import SHARES, Shares

HEADS = ["gateway", "drive", "run", "topic", "sequence", "time_s", "historical"]
COLUMNS = [*HEADS, "name", "value", "sd", "status", "unit"]
KEY = "strainwave/v1/hall 2/cell-7/axis-1/load"
DAY = "2026-11-20"
DAY_S = 1_795_132_800.0


def batch(first: int, last: int, run: int = 5) -> Batch:
    route = route_of(KEY)
    assert route
    found = Batch(0.0)
    for number in range(first, last + 1):
        told = {
            n: {"value": number / 7, "sd": 0.1, "status": "valid", "unit": "N m"} for n in ("torque_rms", "speed_in")
        }
        raw = json.dumps({"run": run, "sequence": number, "time_s": DAY_S + number, "estimates": told}).encode()
        found.add(route.stream, heard(raw), [])
    return found


def rows(folder: Path) -> list[Any]:
    query = f"SELECT sequence, name, value FROM read_parquet('{folder}/site=*/date=*/*.parquet') ORDER BY ALL"
    return duckdb.sql(query).fetchall()


def test_the_dataset_is_read_as_it_stands(tmp_path: Path) -> None:
    folder = Dataset(tmp_path, 3)
    for first in (0, 10, 20):
        folder.append(("hall 2", DAY), batch(first, first + 9))
        expected = sorted((n, name, n / 7) for n in range(first + 10) for name in ("torque_rms", "speed_in"))
        assert rows(tmp_path) == expected
    folder.merge(("hall 2", DAY))
    assert rows(tmp_path) == expected
    (path,) = tmp_path.glob("site=*/date=*/*.parquet")
    assert path.parent == tmp_path / "site=hall%202" / f"date={DAY}"
    metadata = pq.read_metadata(path)
    assert metadata.schema.names == COLUMNS
    assert metadata.metadata[b"schema_version"] == b"1"
    table = pyarrow.dataset.dataset(tmp_path, partitioning="hive").to_table()
    assert set(table["site"].to_pylist()) == {"hall 2"} and table.num_rows == 60
    assert str(table.schema.field("name").type) == "string"


def test_merging_leaves_full_files_and_those_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FULL_ROWS", 50)
    for first in range(0, 50, 10):  # each time as after a restart
        Dataset(tmp_path, 0).append(("s", DAY), batch(first, first + 9))
    Dataset(tmp_path, 1).append(("s", DAY), batch(50, 59))
    last = Dataset(tmp_path, 0)
    last.append(("s", DAY), batch(60, 60))
    for _ in range(3):
        last.merge(("s", DAY))
    sizes = [pq.read_metadata(path).num_rows for path in sorted(tmp_path.glob("site=*/date=*/*.parquet"))]
    assert sorted(sizes) == [20, 42, 60] and len(rows(tmp_path)) == 122
    (runs,) = Dataset(tmp_path, 2).news().values()
    assert [(first, last) for first, last, _, _ in runs[5]] == [(0, 60)]
    assert len(list(tmp_path.rglob("*.parquet"))) == 3, "nothing unfinished is in sight"


def test_where_folders_cannot_be_exchanged_files_stay_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "exchanged", lambda left, right: False)
    folder = Dataset(tmp_path, 0)
    folder.append(("s", DAY), batch(0, 9))
    folder.append(("s", DAY), batch(10, 19))
    folder.merge(("s", DAY))
    assert len(rows(tmp_path)) == 40 and folder.crowded(2) == []


def test_what_is_there_is_known_again_from_the_files_alone(tmp_path: Path) -> None:
    Dataset(tmp_path, 0).append(("hall 2", DAY), batch(0, 4))
    Dataset(tmp_path, 1).append(("hall 2", DAY), batch(8, 9))
    fresh = Dataset(tmp_path, 2)
    (runs,) = fresh.news().values()
    assert [(first, last) for first, last, _, _ in runs[5]] == [(0, 4), (8, 9)]
    assert fresh.news() == {}, "nothing has changed since"
    (one,) = tmp_path.glob("site=*/date=*/part-000-*.parquet")
    bare = one.with_name("part-009-0.parquet")
    with pq.ParquetFile(one) as file:
        pq.write_table(file.read(), bare, store_schema=False)
    (runs,) = fresh.news().values()
    assert [(first, last) for first, last, _, _ in runs[5]] == [(0, 4)], "counted, where the metadata says nothing"


def test_a_damaged_file_is_put_aside_and_stops_no_reader(tmp_path: Path) -> None:
    folder = Dataset(tmp_path, 0)
    folder.append(("s", DAY), batch(0, 4))
    folder.append(("t", DAY), batch(0, 4))
    (path,) = tmp_path.glob("site=s/date=*/*.parquet")
    path.write_bytes(path.read_bytes()[:-40])
    fresh = Dataset(tmp_path, 0)
    fresh.news()
    assert fresh.set_aside == [path]
    assert len(rows(tmp_path)) == 10


KILLED = """
import sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from tests.fleet.test_dataset import DAY, Dataset, batch
folder = Dataset(Path({folder!r}), 0)
first = sum(len(spans) for runs in folder.news().values() for spans in runs.values())
for number in range(first, first + 1000):
    folder.append(("s", DAY), batch(number, number))
    if number % 3 == 2:
        folder.merge(("s", DAY))
    print(number, flush=True)
"""


@pytest.mark.slow
@pytest.mark.timeout(60)
def test_a_writer_killed_at_any_moment_leaves_each_row_once(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    told = -1
    for kill_after in (1, 7, 3, 12):
        code = KILLED.format(tests=str(root), folder=str(tmp_path))
        child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=root)
        assert child.stdout
        for _ in range(kill_after):
            told = int(child.stdout.readline())
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
        numbers = [row[0] for row in rows(tmp_path)]
        assert numbers == sorted([*range(numbers[-1] + 1)] * 2) and numbers[-1] >= told


def test_a_folder_that_cannot_be_made_is_said_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for make in (lambda: Dataset(tmp_path / "file", 0), lambda: Shares(tmp_path / "file")):
        with pytest.raises(BadInput, match="cannot be written"):
            make()


def test_a_day_is_that_of_the_message() -> None:
    assert date_of(DAY_S) == DAY and date_of(DAY_S - 0.001) == "2026-11-19"
    assert date_of(None) == date_of(float("nan")) == date_of(1e300) == date_of(-1.0) >= DAY


def test_shares_are_held_by_one_and_pass_on_when_he_goes(tmp_path: Path) -> None:
    first, second = Shares(tmp_path), Shares(tmp_path)
    assert {first.seat, second.seat} == {0, 1}
    mine, yours = first.wanted(), second.wanted()
    assert mine | yours == set(range(SHARES)) and not mine & yours
    assert all(first.take(share) for share in mine)
    assert not second.take(min(mine)) and second.take(min(yours))
    first.close()
    assert second.wanted() == set(range(SHARES)) and second.take(min(mine))
    second.close()
