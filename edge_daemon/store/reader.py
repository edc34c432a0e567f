"""The store as another process sees it: read only, always the newest commit, never in the writer's way.

Every query is short, so that the journal can be written back while someone reads a long span.
"""

from __future__ import annotations

import math
import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import quote

from edge_daemon.records import NE107, Block, Estimate, Event, Status
from edge_daemon.store.codec import decode
from edge_daemon.store.hours import HOUR_S, Mean, decode_means
from edge_daemon.store.rows import DAMAGE, unpack_estimates
from edge_daemon.store.schema import APPLICATION_ID, BUSY_MS, VERSION, StoreError, legible
from edge_daemon.store.seal import is_whole

CHUNKS_AT_ONCE = 16
"""One query fetches so many rows."""


class StoreReader:
    """Use as a context manager. Raises `StoreError` for a file that is absent, damaged or no store.

    A row that is not as it was written is left out and counted in `damaged_rows`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        if not path.exists():
            raise StoreError(f"{path}: no such file")
        uri = f"file:{quote(str(path.absolute()))}?mode=ro"
        try:
            self.database = _connect(uri)
        except sqlite3.OperationalError:
            self.database = _connect(f"{uri}&immutable=1")  # a medium that cannot be written: nobody writes it now
        except sqlite3.DatabaseError as error:
            raise StoreError(f"{path}: cannot be read: {error}") from error
        mark, version = self._one("PRAGMA application_id"), self._one("PRAGMA user_version")
        if mark != APPLICATION_ID or version > VERSION:
            self.close()
            raise StoreError(f"{path}: is no store of this program, or of a later version of it")
        self._version = version
        self._crc = "crc" if version >= 2 else "NULL"  # rows of version 1 have none
        self.damaged_rows = 0

    def __enter__(self) -> StoreReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self.database.close()

    def drives(self) -> tuple[str, ...]:
        """Names of the drives that have blocks or snapshots, sorted."""
        return tuple(row[0] for row in self._rows("SELECT name FROM drive ORDER BY name"))

    def newest_s(self) -> float:
        """End of the newest block or time of the newest snapshot; NaN in an empty store."""
        found = [self._one("SELECT max(end_s) FROM chunk"), self._one("SELECT max(time_s) FROM snapshot")]
        known = [time_s for time_s in found if time_s is not None]
        return max(known) if known else math.nan

    def blocks(self, drive: str, since_s: float = -math.inf, until_s: float = math.inf) -> Iterator[Block]:
        """Blocks that reach into [since_s, until_s), in order of time."""
        end_s, last = since_s, -1
        while True:
            rows = self._rows(
                f"SELECT chunk.id, {self._crc}, chunk.drive, start_s, end_s, data FROM chunk"  # noqa: S608
                " JOIN drive ON drive.id = chunk.drive WHERE drive.name = ?"
                " AND end_s >= ? AND (end_s > ? OR chunk.id > ?) AND start_s < ? ORDER BY end_s, chunk.id LIMIT ?",
                (drive, end_s, end_s, last, until_s, CHUNKS_AT_ONCE),
            )
            for number, crc, *stored in rows:
                last, end_s = number, stored[2]
                for block in self._decoded(drive, crc, *stored):
                    if block.end_s > since_s and block.start_s < until_s:
                        yield block
            if len(rows) < CHUNKS_AT_ONCE:
                return

    def estimates(
        self,
        drive: str,
        names: Sequence[str],
        since_s: float = -math.inf,
        until_s: float = math.inf,
        limit: int = 10_000,
    ) -> list[Estimate]:
        """Estimates in [since_s, until_s), at most `limit`, in order of time.

        One a second where that fits the limit, else evenly thinned. Times from before the oldest snapshot are answered
        by hourly means, whose standard deviation is the mean of the estimates' own.
        """
        most = max(limit // max(len(names), 1), 1)
        where = "FROM snapshot s JOIN drive d ON d.id = s.drive WHERE d.name = ? AND s.time_s >= ? AND s.time_s < ?"
        span = (drive, since_s, until_s)
        count, first_s, last_s = self._rows(f"SELECT count(*), min(s.time_s), max(s.time_s) {where}", span)[0]
        found = self._hourly(drive, names, since_s, min(until_s, first_s if count else math.inf), most)
        most = max(most - len(found), 1)
        bucket_s = 0.0 if count <= most else (last_s - first_s) / most
        group = "" if not bucket_s else f"GROUP BY CAST((s.time_s - {first_s!r}) / {bucket_s!r} AS INTEGER)"
        rows = self._rows(
            f"SELECT {'max(s.time_s)' if bucket_s else 's.time_s'}, {self._snapshot_columns} FROM snapshot s"  # noqa: S608
            " JOIN drive d ON d.id = s.drive JOIN nameset n ON n.id = s.nameset"
            f" WHERE d.name = ? AND s.time_s >= ? AND s.time_s < ? {group} ORDER BY s.time_s DESC LIMIT ?",
            (*span, most),
        )
        for _, *stored in reversed(rows):
            estimates = self._unpacked(*stored)
            found.extend(estimates[name] for name in names if name in estimates)
        return found

    def hours(
        self, drive: str, since_s: float = -math.inf, until_s: float = math.inf
    ) -> list[tuple[float, dict[str, Mean]]]:
        """Start of each hour in the span [s] and the means of its usable estimates by name, in order of time."""
        found = []
        for hour, data in self.packed_hours(drive, since_s, until_s):
            try:
                found.append((hour * HOUR_S, decode_means(data)))
            except DAMAGE:
                self.damaged_rows += 1
        return found

    def packed_hours(self, drive: str, since_s: float, until_s: float) -> list[tuple[int, bytes]]:
        """Hours since the epoch and their means as stored, in order of time."""
        rows = self._rows(
            f"SELECT {self._crc}, drive.id, hour, data FROM hour JOIN drive ON drive.id = hour.drive"  # noqa: S608
            " WHERE drive.name = ? AND hour >= ? AND hour < ? ORDER BY hour",
            (drive, math.floor(since_s / HOUR_S) if math.isfinite(since_s) else since_s, until_s / HOUR_S),
        )
        return [(row[2], row[3]) for row in rows if self._checks(*row)]

    def first_snapshot_s(self, drive: str) -> float:
        """Time of the oldest snapshot of a drive; infinite where there is none."""
        query = "SELECT min(time_s) FROM snapshot WHERE drive = (SELECT id FROM drive WHERE name = ?)"
        found = self._rows(query, (drive,))[0][0]
        return math.inf if found is None else float(found)

    def newest_of_each(
        self, drive: str, since_s: float, until_s: float, width_s: float
    ) -> Iterator[tuple[float, dict[str, Estimate]]]:
        """The newest snapshot of each `width_s` in [since_s, until_s) that has one, in order of time: a seek each."""
        number = self._rows("SELECT id FROM drive WHERE name = ?", (drive,))
        query = (
            f"SELECT s.time_s, {self._snapshot_columns} FROM snapshot s JOIN nameset n ON n.id = s.nameset"  # noqa: S608
            " WHERE s.drive = ? AND s.time_s >= ? AND s.time_s < ? ORDER BY s.time_s {} LIMIT 1"
        )
        newest, next_one = query.format("DESC"), query.format("ASC")
        begin_s = since_s
        while number and begin_s < until_s:
            end_s = min(begin_s + width_s, until_s)
            rows = self._rows(newest, (number[0][0], begin_s, end_s))
            if rows:
                time_s, *stored = rows[0]
                yield time_s, self._unpacked(*stored)
                begin_s = end_s
                continue
            ahead = self._rows(next_one, (number[0][0], end_s, until_s))
            if not ahead:
                return
            begin_s += width_s * max(math.floor((ahead[0][0] - begin_s) / width_s), 1)

    def _hourly(self, drive: str, names: Sequence[str], since_s: float, until_s: float, most: int) -> list[Estimate]:
        hours = [row for row in self.hours(drive, since_s, until_s) if row[0] + HOUR_S <= until_s]
        hours = hours[:: -max(-(-len(hours) // most), 1)][::-1]
        return [
            Estimate(name, mean.mean, mean.sd, mean.unit, Status.VALID, start_s + HOUR_S / 2)
            for start_s, means in hours
            for name in names
            if (mean := means.get(name)) is not None
        ]

    def events(self, limit: int = 1000) -> list[Event]:
        """The newest `limit` events of all drives and the gateway, oldest first."""
        rows = self._rows(
            f"SELECT {self._crc}, drive, time_s, severity, source, message FROM event"  # noqa: S608
            " ORDER BY time_s DESC, id DESC LIMIT ?",
            (limit,),
        )
        whole = [row[1:] for row in reversed(rows) if self._checks(*row)]
        return [Event(row[0], row[1], NE107(row[2]), row[3], row[4]) for row in whole]

    def sent(self, drive: str, run: int, topic: str, span: tuple[int, int], most: int) -> list[bytes]:
        """Payloads of what was published under a topic in a run, of the numbers in `span` (both ends), oldest first."""
        if self._version < 3:
            return []
        rows = self._rows(
            "SELECT crc, drive, run, topic, sequence, data FROM message"
            " WHERE drive = ? AND run = ? AND topic = ? AND sequence BETWEEN ? AND ? ORDER BY sequence LIMIT ?",
            (drive, run, topic, *span, most),
        )
        found = []
        for row in rows:
            if self._checks(*row):
                try:
                    found.append(zlib.decompress(row[-1]))
                except zlib.error:
                    self.damaged_rows += 1
        return found

    def sent_spans(self, drive: str) -> list[tuple[int, str, int, int]]:
        """Run, topic, first and last number of what was published of a drive and is still there."""
        if self._version < 3:
            return []
        return self._rows(
            "SELECT run, topic, min(sequence), max(sequence) FROM message WHERE drive = ? GROUP BY run, topic", (drive,)
        )

    def states(self, prefix: str) -> dict[str, bytes]:
        """What is kept under keys that begin so, by the rest of the key."""
        query = f"SELECT {self._crc}, key, data FROM state WHERE substr(key, 1, ?) = ? ORDER BY key"  # noqa: S608
        rows = self._rows(query, (len(prefix), prefix))
        return {row[1][len(prefix) :]: row[2] for row in rows if self._checks(*row)}

    def _rows(self, query: str, values: tuple[object, ...] = ()) -> list[Any]:
        try:
            return self.database.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise self.damaged(error) from error

    def _one(self, query: str) -> Any:
        return self._rows(query)[0][0]

    def _checks(self, crc: int | None, *stored: object) -> bool:
        """Whether a row is as it was written; counted if not."""
        whole = is_whole(crc, *stored)
        self.damaged_rows += not whole
        return whole

    def _decoded(self, drive: str, crc: int | None, *stored: Any) -> list[Block]:
        """The blocks of a chunk; none where it was changed on the disk."""
        if not self._checks(crc, *stored):
            return []
        try:
            return list(decode(drive, stored[-1]))
        except DAMAGE:
            self.damaged_rows += 1
            return []

    @property
    def _snapshot_columns(self) -> str:
        """What `_unpacked` takes."""
        crc = "s.crc" if self._crc == "crc" else self._crc
        return f"{crc}, s.drive, s.time_s, s.sequence, s.state, s.reasons, n.names, s.data"

    def _unpacked(self, crc: int | None, *stored: Any) -> dict[str, Estimate]:
        """A snapshot's estimates; none where it was changed on the disk."""
        if not self._checks(crc, *stored):
            return {}
        try:
            return unpack_estimates(*stored[-2:])
        except DAMAGE:
            self.damaged_rows += 1
            return {}

    def damaged(self, error: Exception) -> StoreError:
        """The error of a row that cannot be read, as ours."""
        return StoreError(f"{self._path}: cannot be read: {error}")


def _connect(uri: str) -> sqlite3.Connection:
    database = sqlite3.connect(uri, uri=True, timeout=BUSY_MS / 1000, isolation_level=None, check_same_thread=False)
    database.text_factory = legible
    try:
        database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.Error:
        database.close()
        raise
    return database
