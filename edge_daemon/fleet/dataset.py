"""The dataset on disk: `site=SITE/date=YYYY-MM-DD/part-WRITER-SERIAL.parquet`, right whenever somebody reads it.

A file is written beside the dataset, synced, and takes its name in one step. It grows by being replaced under its own
name by itself with more rows, until it is full; a row never moves to another file. So a reader sees each row once or
not yet, never twice, and no file goes away under his hands. Each file's metadata says which sequence numbers are in it:
that is the whole account of what has been collected, and it cannot disagree with the rows.
"""

from __future__ import annotations

import json
import os
import time
import zlib
from base64 import b85decode, b85encode
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from edge_daemon.errors import BadInput
from edge_daemon.fleet.heard import Heard, Row
from edge_daemon.fleet.spans import Numbers, Spans, joined

SCHEMA = "strainwave/fleet"
SCHEMA_VERSION = 1
FULL_ROWS = 2_000_000
"""A file with so many rows is full, about ten megabytes: what growing further would cost in writing outweighs what
readers gain (guess)."""
GROUP_ROWS = 262_144
"""A row group has so many rows: what Parquet's readers split their work by."""
BASE = 85
WORK = "_collect"
"""Locks and unfinished files are in this folder of the dataset; readers of Parquet pass over names that begin so."""
_WORDS = {name: pa.dictionary(pa.int32(), pa.string()) for name in ("gateway", "drive", "topic", "name", "status", "unit")}
COLUMNS = pa.schema(
    [
        *((name, _WORDS[name]) for name in ("gateway", "drive")),
        ("run", pa.int64()),
        ("topic", _WORDS["topic"]),
        ("sequence", pa.int64()),
        ("time_s", pa.float64()),
        ("historical", pa.bool_()),
        ("name", _WORDS["name"]),
        ("value", pa.float64()),
        ("sd", pa.float64()),
        ("status", _WORDS["status"]),
        ("unit", _WORDS["unit"]),
    ]
)
"""The columns in order; words are dictionaries in memory and plain strings to whoever reads the file."""
LAST_TIME_S = 253_370_764_800.0
"""Beyond the year 9998 a time is taken for none."""

Partition = tuple[str, str]
"""Site and date."""


def date_of(time_s: float | None) -> str:
    """The day of a message in UTC; today where it has no time."""
    known = time_s is not None and 0.0 <= time_s < LAST_TIME_S
    return datetime.fromtimestamp(time_s if known else time.time(), UTC).strftime("%Y-%m-%d")  # type: ignore[arg-type]


class Batch:
    """Rows of one partition that wait to be written, by column: a message's own columns once for all its rows."""

    __slots__ = ("_heads", "_rows", "began_s", "numbers", "rows")

    def __init__(self, began_s: float) -> None:
        self.began_s = began_s
        self.numbers: Numbers = {}
        self.rows = 0
        self._heads: tuple[list[str], list[str], list[int], list[str], list[int], list[float | None], list[bool]] = (
            *([], [], [], [], [], [], []),
        )
        self._rows: tuple[list[int], list[str], list[float | None], list[float | None], list[str | None], list[str | None]]
        self._rows = ([], [], [], [], [], [])

    def add(self, key: str, words: tuple[str, str, str, str], message: Heard, beside: list[Row]) -> None:
        """Take a message in. `words`: site, gateway, drive, topic."""
        _, gateway, drive, topic = words
        for column, value in zip(
            self._heads,
            (gateway, drive, message.run, topic, message.sequence, message.time_s, message.historical),
            strict=True,
        ):
            column.append(value)  # type: ignore[arg-type]
        counts, names, values, sds, statuses, units = self._rows
        told = message.estimates.values()
        names.extend(message.estimates)
        values.extend([row.value for row in told])
        sds.extend([row.sd for row in told])
        statuses.extend([row.status for row in told])
        units.extend([row.unit for row in told])
        for row in beside:
            for column, cell in zip(self._rows[1:], row, strict=True):
                column.append(cell)  # type: ignore[arg-type]
        count = len(told) + len(beside)
        counts.append(count)
        self.rows += count
        runs = self.numbers.get(key)
        if runs is None:
            runs = self.numbers[key] = {}
        spans = runs.get(message.run)
        if spans is None:
            spans = runs[message.run] = Spans()
        spans.add(message.sequence, message.time_s if message.time_s is not None else float("nan"))

    def table(self) -> pa.Table:
        """All rows in the dataset's columns, sorted so that like stands beside like: it takes half the space."""
        counts, *rest = self._rows
        of_message = np.repeat(np.arange(len(counts)), counts)
        heads = [pa.array(column, type=_plain(name)) for column, name in zip(self._heads, COLUMNS.names, strict=False)]
        spread = [_coded(column).take(pa.array(of_message)) for column in heads]
        tails = [_coded(pa.array(column, type=_plain(name))) for column, name in zip(rest, COLUMNS.names[7:], strict=True)]
        table = pa.Table.from_arrays([*spread, *tails], schema=COLUMNS)
        order = [_codes(table[name]) for name in ("sequence", "name", "topic", "run", "drive", "gateway")]
        return table.take(pa.array(np.lexsort(order)))


def _plain(name: str) -> pa.DataType:
    kind = COLUMNS.field(name).type
    return pa.string() if pa.types.is_dictionary(kind) else kind


def _coded(column: pa.Array) -> pa.Array:
    return column.dictionary_encode() if pa.types.is_string(column.type) else column


def _codes(column: pa.ChunkedArray) -> np.ndarray:
    whole = column.combine_chunks()
    part = whole.indices if pa.types.is_dictionary(whole.type) else whole
    return np.asarray(part.to_numpy(zero_copy_only=False))


class PartFile:
    """One file that grows."""

    def __init__(self, path: Path) -> None:
        """Raises `OSError` or `pa.ArrowException` where it is there and cannot be read."""
        self.path = path
        self.rows = 0
        self.numbers: Numbers = {}
        if path.exists():
            metadata = pq.read_metadata(path)
            self.rows = metadata.num_rows
            self.numbers = numbers_in(path, metadata.metadata)

    def grow(self, batch: Batch, work: Path) -> None:
        """Replace the file by itself with the batch's rows. All or nothing; raises `OSError` or `pa.ArrowException`."""
        table = batch.table()
        numbers: Numbers = {}
        joined(numbers, self.numbers)
        joined(numbers, batch.numbers)
        draft = work / f"{self.path.name}.{zlib.crc32(str(self.path).encode()):08x}.draft"
        try:
            self._write(draft, table, numbers)
            _sync(draft)
            self.path.parent.mkdir(parents=True, exist_ok=True)
            draft.replace(self.path)
            _sync(self.path.parent)
        finally:
            with suppress(OSError):
                draft.unlink(missing_ok=True)
        self.rows += table.num_rows
        self.numbers = numbers

    def _write(self, draft: Path, table: pa.Table, numbers: Numbers) -> None:
        words = list(_WORDS)
        writer = pq.ParquetWriter(
            draft, COLUMNS, store_schema=False, compression="zstd", use_dictionary=[*words, "run", "historical"]
        )
        with writer:
            for part in _groups(self._before(), table):
                writer.write_table(part, row_group_size=GROUP_ROWS)
            writer.add_key_value_metadata(
                {"schema": SCHEMA, "schema_version": str(SCHEMA_VERSION), "numbers": packed_numbers(numbers)}
            )

    def _before(self) -> Iterator[pa.Table]:
        if not self.rows:
            return
        with pq.ParquetFile(self.path, read_dictionary=list(_WORDS)) as old:
            for at in range(old.num_row_groups):
                yield old.read_row_group(at).cast(COLUMNS)


def _groups(before: Iterator[pa.Table], new: pa.Table) -> Iterator[pa.Table]:
    """Row groups of about `GROUP_ROWS`: the small ones of earlier growth are put together."""
    waiting: list[pa.Table] = []
    for part in before:
        waiting.append(part)
        if sum(one.num_rows for one in waiting) >= GROUP_ROWS:
            yield pa.concat_tables(waiting).unify_dictionaries()
            waiting = []
    yield pa.concat_tables([*waiting, new]).unify_dictionaries()


def packed_numbers(numbers: Numbers) -> str:
    """Numbers as text for a file's metadata."""
    plain = {key: {str(run): list(spans) for run, spans in runs.items()} for key, runs in numbers.items()}
    return b85encode(zlib.compress(json.dumps(plain).encode(), 1)).decode()


def numbers_in(path: Path, metadata: dict[bytes, bytes] | None) -> Numbers:
    """Which numbers a file says it holds; counted from its rows where it says nothing."""
    packed = (metadata or {}).get(b"numbers")
    if packed is None:
        return _counted(path)
    plain = json.loads(zlib.decompress(b85decode(packed)))
    return {key: {int(run): Spans(map(tuple, spans)) for run, spans in runs.items()} for key, runs in plain.items()}


def _counted(path: Path) -> Numbers:
    site = unquote(path.parent.parent.name.removeprefix("site="))
    columns = ["gateway", "drive", "topic", "run", "sequence", "time_s"]
    found: Numbers = {}
    table = pq.read_table(path, columns=columns, partitioning=None)
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
        self._open: dict[Partition, PartFile] = {}
        self._seen: dict[Path, tuple[int, int, int]] = {}
        self.set_aside: list[Path] = []
        self.work = folder / WORK / f"writer-{writer:03d}"
        try:
            self.work.mkdir(parents=True, exist_ok=True)
            for left in self.work.glob("*.draft"):
                left.unlink()
        except OSError as error:
            raise BadInput(f"{folder}: cannot be written: {error.strerror}") from error

    def news(self) -> Numbers:
        """The numbers in all files that are new or have changed since the last call."""
        found: Numbers = {}
        for path in sorted(self.folder.glob("site=*/date=*/*.parquet")):
            try:
                state = path.stat()
                mark = (state.st_mtime_ns, state.st_size, state.st_ino)
                if self._seen.get(path) != mark:
                    joined(found, numbers_in(path, pq.read_metadata(path).metadata))
                    self._seen[path] = mark
            except FileNotFoundError:
                continue
            except (pa.ArrowException, ValueError, OSError):
                self._put_aside(path)
        return found

    def rows_in_open_file(self, partition: Partition) -> int:
        """Rows that are written again when this partition grows."""
        part = self._open.get(partition)
        return part.rows if part else 0

    def append(self, partition: Partition, batch: Batch) -> None:
        """Write a batch into its partition. All or nothing; raises `OSError` or `pa.ArrowException`."""
        part = self._open.get(partition) or self._newest(partition)
        if part.rows >= FULL_ROWS:
            part = PartFile(self._path(partition, _serial(part.path) + 1))
        part.grow(batch, self.work)
        self._open[partition] = part

    def forget(self, keep: set[Partition]) -> None:
        """Drop what is known of open files but these; it is read again when needed."""
        for partition in self._open.keys() - keep:
            del self._open[partition]

    def _newest(self, partition: Partition) -> PartFile:
        """The last file of this writer, or its first."""
        folder = self._path(partition, 0).parent
        known = sorted(folder.glob(f"part-{self._writer:03d}-*.parquet"))
        if not known:
            return PartFile(self._path(partition, 0))
        try:
            return PartFile(known[-1])
        except (pa.ArrowException, ValueError, OSError):
            self._put_aside(known[-1])
            return PartFile(self._path(partition, _serial(known[-1]) + 1))

    def _path(self, partition: Partition, serial: int) -> Path:
        site, date = partition
        return self.folder / f"site={quote(site, safe='')}" / f"date={date}" / f"part-{self._writer:03d}-{serial:06d}.parquet"

    def _put_aside(self, path: Path) -> None:
        """A file that was damaged on the disk must not stop every reader; what was in it is asked for again."""
        with suppress(OSError):
            path.rename(path.with_name(f"{path.name}.damaged"))
            self.set_aside.append(path)


def _serial(path: Path) -> int:
    return int(path.stem.rpartition("-")[2])
