"""The dataset on disk: `site=SITE/date=YYYY-MM-DD/part-WRITER-SERIAL.parquet`, right whenever somebody reads it.

A file is written out of sight, synced, and appears in one step; it never changes, and no name comes again. Small files
are merged by exchanging the partition's whole folder for one with the merged file, in one step as well. So each row is
seen once or not yet, never twice; a reader who listed the folder just before an exchange is told that a file is not
there, and asks again. Each file's metadata says which sequence numbers are in it: that is the whole account of what has
been collected, and it cannot disagree with the rows.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import shutil
import time
import zlib
from base64 import b85decode, b85encode
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote, unquote

import pyarrow as pa
import pyarrow.parquet as pq

from edge_daemon.errors import BadInput
from edge_daemon.fleet.batch import COLUMNS, WORDS, Batch
from edge_daemon.fleet.spans import Spans, StreamNumbers, joined

SCHEMA = "strainwave/fleet"
SCHEMA_VERSION = 1
FULL_ROWS = 2_000_000
"""A file with so many rows is not merged any further: about ten megabytes, which readers like (guess)."""
MOST_SMALL = 64
"""So many small files of one writer and day are merged: a reader opens them in 20 ms."""
ANY = "site=*/date=*"
_HERE, _EXCHANGE = -100, 2
"""AT_FDCWD and RENAME_EXCHANGE of linux/fcntl.h and linux/fs.h."""
GROUP_ROWS = 262_144
"""A row group has so many rows: what Parquet's readers split their work by."""
WORK = "_collect"
"""The locks are in this folder of the dataset; readers of Parquet pass over names that begin so."""
DAY_S = 86_400
LAST_TIME_S = 253_370_764_800.0
"""Beyond the year 9998 a time is taken for none."""

Partition = tuple[str, str]
"""Site and date."""


def date_of(time_s: float | None) -> str:
    """The day of a message in UTC; today where it has no time."""
    known = time_s is not None and 0.0 <= time_s < LAST_TIME_S
    return _date(int((time_s if known and time_s is not None else time.time()) // DAY_S))


@lru_cache(4096)
def _date(day: int) -> str:
    return datetime.fromtimestamp(day * DAY_S, UTC).strftime("%Y-%m-%d")


def _written(draft: Path, parts: Iterable[pa.Table], numbers: StreamNumbers) -> None:
    """Write and sync a file that nobody sees yet."""
    with pq.ParquetWriter(
        draft, COLUMNS, store_schema=False, compression="zstd", use_dictionary=[*WORDS, "run", "historical"]
    ) as writer:
        for part in _groups(parts):
            writer.write_table(part, row_group_size=GROUP_ROWS)
        writer.add_key_value_metadata(
            {"schema": SCHEMA, "schema_version": str(SCHEMA_VERSION), "numbers": packed_numbers(numbers)}
        )
    _sync(draft)


def _read(paths: Iterable[Path]) -> Iterator[pa.Table]:
    for path in paths:
        with pq.ParquetFile(path, read_dictionary=list(WORDS)) as old:
            for at in range(old.num_row_groups):
                yield old.read_row_group(at).cast(COLUMNS)


def _groups(parts: Iterable[pa.Table]) -> Iterator[pa.Table]:
    """Row groups of about `GROUP_ROWS` from smaller ones."""
    waiting: list[pa.Table] = []
    for part in parts:
        waiting.append(part)
        if sum(one.num_rows for one in waiting) >= GROUP_ROWS:
            yield pa.concat_tables(waiting).unify_dictionaries()
            waiting = []
    if waiting:
        yield pa.concat_tables(waiting).unify_dictionaries()


def packed_numbers(numbers: StreamNumbers) -> str:
    """StreamNumbers as text for a file's metadata."""
    plain = {key: {str(run): list(spans) for run, spans in runs.items()} for key, runs in numbers.items()}
    return b85encode(zlib.compress(json.dumps(plain).encode(), 1)).decode()


def numbers_in(path: Path, metadata: dict[bytes, bytes] | None) -> StreamNumbers:
    """Which numbers a file says it holds; counted from its rows where it says nothing."""
    packed = (metadata or {}).get(b"numbers")
    if packed is None:
        return _counted(path)
    return unpacked_numbers(packed)


def unpacked_numbers(packed: str | bytes) -> StreamNumbers:
    """The numbers of `packed_numbers`. Raises `ValueError` or `zlib.error` on damage."""
    plain = json.loads(zlib.decompress(b85decode(packed)))
    return {key: {int(run): Spans(map(tuple, spans)) for run, spans in runs.items()} for key, runs in plain.items()}


def _counted(path: Path) -> StreamNumbers:
    site = unquote(path.parent.parent.name.removeprefix("site="))
    columns = ["gateway", "drive", "topic", "run", "sequence", "time_s"]
    found: StreamNumbers = {}
    with pq.ParquetFile(path) as file:
        table = file.read(columns=columns)
    for gateway, drive, topic, run, sequence, time_s in zip(*(table[c].to_pylist() for c in columns), strict=True):
        spans = found.setdefault(f"{site}/{gateway}/{drive}/{topic}", {}).setdefault(run, Spans())
        spans.add(sequence, float("nan") if time_s is None else time_s)
    return found


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class Dataset:
    """A folder as one writer sees it. Files of other writers are only read."""

    def __init__(self, folder: Path, writer: int) -> None:
        """Raises `BadInput` where the folder cannot be made."""
        self.folder = folder
        self._writer = writer
        self._small: dict[Partition, dict[Path, int]] = {}
        self._seen: set[Path] = set()
        self._serial = 0
        self._can_exchange = True
        self.set_aside: list[Path] = []
        try:
            (folder / WORK).mkdir(parents=True, exist_ok=True)
            self._work = _out_of_sight(folder) / f"writer-{writer:03d}"
            shutil.rmtree(self._work, ignore_errors=True)
            self._work.mkdir(parents=True)
            self._gate = (folder / WORK / "names.lock").open("w")
        except OSError as error:
            raise BadInput(f"{folder}: cannot be written: {error.strerror}") from error

    def close(self) -> None:
        """Leave nothing behind but the files."""
        shutil.rmtree(self._work, ignore_errors=True)
        with suppress(OSError):
            self._work.parent.rmdir()
        self._gate.close()

    def news(self) -> StreamNumbers:
        """The numbers in all files that are there and were not yet at the last call."""
        found: StreamNumbers = {}
        while True:
            gone = False
            for path in sorted(self.folder.glob(f"{ANY}/*.parquet")):
                try:
                    if path not in self._seen:
                        joined(found, numbers_in(path, pq.read_metadata(path).metadata))
                        self._seen.add(path)
                except FileNotFoundError:
                    gone = True  # merged meanwhile: its rows are in a file that was not there when we looked
                except (pa.ArrowException, zlib.error, ValueError, OSError):
                    self._put_aside(path)
            if not gone:
                return found

    def append(self, partition: Partition, batch: Batch) -> None:
        """Write a batch into a new file. All or nothing; raises `OSError` or `pa.ArrowException`."""
        small = self._small_files(partition)
        path = self._new_name(partition)
        draft = self._work / f"{path.name}.draft"
        try:
            _written(draft, [batch.table()], batch.numbers())
            path.parent.mkdir(parents=True, exist_ok=True)
            with self._names(fcntl.LOCK_SH):
                draft.rename(path)
                _sync(path.parent)
        finally:
            with suppress(OSError):
                draft.unlink(missing_ok=True)
        self._seen.add(path)
        if batch.rows < FULL_ROWS:
            small[path] = batch.rows

    def crowded(self, most: int = MOST_SMALL) -> list[Partition]:
        """Partitions in which this writer has so many small files that they should be one."""
        return [partition for partition, small in self._small.items() if len(small) >= most and self._can_exchange]

    def merge(self, partition: Partition) -> None:
        """Put the small files of this writer together. Raises `OSError` or `pa.ArrowException`; all or nothing.

        The merged file and what else is in the partition stand in a folder that takes the old one's place in one step.
        """
        small = self._small[partition]
        chosen, rows = [], 0
        for path, count in sorted(small.items()):
            if rows < FULL_ROWS:
                chosen.append(path)
                rows += count
        if len(chosen) < 2:
            return
        numbers: StreamNumbers = {}
        for path in chosen:
            joined(numbers, numbers_in(path, pq.read_metadata(path).metadata))
        merged, folder = self._new_name(partition), self._work / "exchange"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        try:
            _written(folder / merged.name, _read(chosen), numbers)
            with self._names(fcntl.LOCK_EX):
                for other in merged.parent.iterdir():
                    if other not in chosen:
                        (folder / other.name).hardlink_to(other)
                _sync(folder)
                self._can_exchange = exchanged(folder, merged.parent)
                _sync(merged.parent.parent)
        finally:
            shutil.rmtree(folder, ignore_errors=True)  # after the exchange these are the old files
        if self._can_exchange:
            self._seen.add(merged)
            for path in chosen:
                del small[path]
            if rows < FULL_ROWS:
                small[merged] = rows

    def _small_files(self, partition: Partition) -> dict[Path, int]:
        """Rows of each file of this writer that is not full, known from the folder at the first call."""
        if partition not in self._small:
            found = self._small[partition] = {}
            for path in self._folder(partition).glob(f"part-{self._writer:03d}-*.parquet"):
                with suppress(pa.ArrowException, OSError):
                    rows = pq.read_metadata(path).num_rows
                    if rows < FULL_ROWS:
                        found[path] = rows
        return self._small[partition]

    def _folder(self, partition: Partition) -> Path:
        site, date = partition
        return self.folder / f"site={quote(site, safe='')}" / f"date={date}"

    def _new_name(self, partition: Partition) -> Path:
        """A name that no file ever had: readers may remember what was under an old one."""
        self._serial = max(self._serial + 1, time.time_ns() // 1000)
        return self._folder(partition) / f"part-{self._writer:03d}-{self._serial}.parquet"

    @contextmanager
    def _names(self, how: int) -> Iterator[None]:
        """Files appear while nobody exchanges their folder."""
        fcntl.flock(self._gate, how)
        try:
            yield
        finally:
            fcntl.flock(self._gate, fcntl.LOCK_UN)

    def _put_aside(self, path: Path) -> None:
        """A file that was damaged on the disk must not stop every reader; what was in it is asked for again."""
        with suppress(OSError):
            path.rename(path.with_name(f"{path.name}.damaged"))
            self.set_aside.append(path)


def known_drives(folder: Path) -> set[str]:
    """Drives (site/gateway/drive) of which there is anything. Raises `BadInput` for a folder that is no dataset."""
    files = list(folder.glob(f"{ANY}/*.parquet"))
    if not files:
        raise BadInput(f"{folder}: no files: expected what `fleet collect` writes: {ANY}/*.parquet")
    found: set[str] = set()
    for path in files:
        with suppress(pa.ArrowException, zlib.error, ValueError, OSError):
            found |= {key.rpartition("/")[0] for key in numbers_in(path, pq.read_metadata(path).metadata)}
    return {drive for drive in found if not drive.endswith("/_gateway")}


def _out_of_sight(folder: Path) -> Path:
    """Where unfinished files stand: beside the dataset, for some readers look into every folder of it; in it only where
    its own folder cannot be written or is another file system."""
    beside = folder.absolute().parent
    if os.access(beside, os.W_OK) and beside.stat().st_dev == folder.stat().st_dev:
        return beside / f".{folder.absolute().name}.collect"
    return folder / WORK


def exchanged(left: Path, right: Path) -> bool:
    """Let two folders take each other's name in one step (Linux, renameat2); False where this file system cannot."""
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "renameat2"):
        return False
    done: int = libc.renameat2(_HERE, os.fsencode(left), _HERE, os.fsencode(right), _EXCHANGE)
    return done == 0
