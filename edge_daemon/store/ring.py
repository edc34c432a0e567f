"""The ring on disk: one SQLite file that never grows past its limit and survives power cuts.

`add_*` and `save_state` only buffer. `commit` writes everything in one transaction with a sync to the disk, so that
learned state never tells of data that is not there. When the file is full the oldest rows make room, each kind within
its share: blocks 72 %, snapshots (one a second) 13 %, published messages 10 %, hourly means 3 %, events 2 %. While
there is room any kind may use it.
"""

from __future__ import annotations

import math
import sqlite3
import threading
import zlib
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from edge_daemon.config.settings import StoreSettings as Settings
from edge_daemon.records import Block, Event, Snapshot
from edge_daemon.store.budget import SpaceBudget
from edge_daemon.store.codec import BlockEncoder, summed_size
from edge_daemon.store.hours import HourMeans, Mean, decode_means, hour_of
from edge_daemon.store.rows import (
    DAMAGE,
    SNAPSHOT_EVERY_S,
    SNAPSHOT_LEVEL,
    ChunkRow,
    SentRow,
    Waiting,
    in_runs,
    names_of,
    pack_estimates,
)
from edge_daemon.store.schema import StoreError, StoreFull, compact, is_damage, is_full, move_aside, open_writer
from edge_daemon.store.seal import is_whole, seal

__all__ = ["Store", "StoreError", "StoreFull"]

HOUR_SAVED_S = 300.0
"""The running hour's means are written this often, so that a power cut costs a twelfth of them at most."""


class Store:
    """Opening never fails for a reason that may pass: without a file `notes` says why, and `commit` tries again.

    Raises `StoreError` only where the file belongs to another program.
    """

    def __init__(self, settings: Settings, path: Path) -> None:
        self._path = path
        self._keep_blocks = settings.keep_blocks
        self._budget = SpaceBudget(settings.max_mib * 2**20)
        self.notes: list[str] = []
        self._adding = threading.Lock()
        self._writing = threading.Lock()
        self._encoder = BlockEncoder()
        self._blocks: deque[Block] = deque()
        self._block_bytes = 0
        self._fresh = Waiting(self._budget.buffer_bytes)
        self._waiting = Waiting(self._budget.buffer_bytes)
        self._kept: dict[str, tuple[float, int]] = {}
        self._hours: dict[str, HourMeans] = {}
        self._hours_due_s: dict[str, float] = {}
        self._ids: dict[tuple[str, str | bytes], int] = {}
        self.database: sqlite3.Connection | None = None
        self._lost_blocks = 0
        self._commits = 0
        self._failed = self._damaged_rows = 0
        try:
            self._open()
        except StoreError as error:
            if path.exists() and "another program" in str(error):
                raise
            self.notes.append(str(error))

    # in

    def add_block(self, block: Block) -> None:
        """Buffer a block; the oldest goes when the buffer is full."""
        if not self._keep_blocks:
            return
        with self._adding:
            self._blocks.append(block)
            self._block_bytes += summed_size((block,))
            while self._block_bytes > self._budget.buffer_bytes:
                self._block_bytes -= summed_size((self._blocks.popleft(),))
                self._lost_blocks += 1

    def add_snapshot(self, snapshot: Snapshot) -> None:
        """Buffer a snapshot: one a second of data time, and each that changes the state."""
        if not math.isfinite(snapshot.time_s):
            return
        with self._adding:
            kept_s, state = self._kept.get(snapshot.drive, (-math.inf, -1))
            if snapshot.state == state and kept_s <= snapshot.time_s < kept_s + SNAPSHOT_EVERY_S:
                return
            self._kept[snapshot.drive] = (snapshot.time_s, snapshot.state)
            self._fresh.add_snapshots((snapshot,))

    def add_event(self, event: Event) -> None:
        """Buffer an event."""
        with self._adding:
            self._fresh.add_events((event,))

    def add_messages(self, rows: Iterable[SentRow]) -> None:
        """Buffer what was published."""
        with self._adding:
            self._fresh.add_messages(rows)

    def save_state(self, key: str, blob: bytes) -> None:
        """Buffer learned state; it replaces what the key had."""
        with self._adding:
            self._fresh.states[key] = blob

    def load_state(self, key: str) -> bytes | None:
        """What the key has, buffered or stored; None if nothing, or if the file cannot be read."""
        with self._adding:
            for buffer in (self._fresh, self._waiting):
                if key in buffer.states:
                    return buffer.states[key]
        with self._writing:
            if self.database is None:
                return None
            try:
                row = self.database.execute("SELECT data, crc FROM state WHERE key = ?", (key,)).fetchone()
            except sqlite3.Error:
                return None
            if row is None:
                return None
            if not is_whole(row[1], key, row[0]):
                self._set_aside(f"what was learned ({key})")
                return None
            return bytes(row[0])

    # to disk

    def commit(self) -> None:
        """Write what is buffered, synced. May block: call it from a thread.

        Raises `StoreFull` where there is no space and `StoreError` for any other trouble; what was not written stays
        buffered, within bounds, for the next call.
        """
        with self._writing:
            self._take_fresh()
            if not self._waiting:
                return
            try:
                if self.database is None:
                    self._open()
                self._write()
            except sqlite3.Error as error:
                self._failed += 1
                raise self._translated(error) from error
            except StoreError:
                self._failed += 1
                raise
            self._commits += 1

    def close(self) -> None:
        """Write the running hours' means and close. What could not be written is lost."""
        with self._writing:
            if self.database is None:
                return
            with suppress(sqlite3.Error), self._transaction():
                self._write_hours(all_of_them=True)
            self.database.close()
            self.database = None

    def counters(self) -> Mapping[str, int]:
        """Sizes now and totals since the start."""
        with self._adding:
            waiting_bytes = self._block_bytes + self._waiting.chunk_bytes
        return {
            "bytes": file_bytes(self._path),
            "waiting_bytes": waiting_bytes,
            "commits": self._commits,
            "failed_commits": self._failed,
            "dropped_blocks": self._lost_blocks + self._waiting.dropped_blocks,
            "dropped_snapshots": self._waiting.dropped_snapshots + self._fresh.dropped_snapshots,
            "dropped_events": self._waiting.dropped_events + self._fresh.dropped_events,
            "dropped_messages": self._waiting.dropped_messages + self._fresh.dropped_messages,
            "deleted_rows": self._budget.deleted,
            "damaged_rows": self._damaged_rows,
        }

    def _open(self) -> None:
        database, notes = open_writer(self._path)
        self.notes.extend(notes)
        try:
            if self._budget.cut(database):
                problem = compact(self._path, database)
                self.notes.extend([problem] if problem else [])
                database, _ = open_writer(self._path)
        except sqlite3.Error as error:
            database.close()
            raise StoreError(f"{self._path}: cannot be opened for writing: {error}") from error
        self.database = database
        self._ids.clear()
        self._hours.clear()
        self._budget.attach(self.database)

    def _take_fresh(self) -> None:
        """Pack what was added since the last commit and put it behind what still waits."""
        with self._adding:
            blocks, self._blocks, self._block_bytes = self._blocks, deque(), 0
            fresh, self._fresh = self._fresh, Waiting(self._budget.buffer_bytes)
            self._waiting.add_snapshots(fresh.snapshots)
            self._waiting.add_events(fresh.events)
            self._waiting.add_messages(fresh.messages)
            self._waiting.states.update(fresh.states)
            self._waiting.dropped_snapshots += fresh.dropped_snapshots
            self._waiting.dropped_events += fresh.dropped_events
            self._waiting.dropped_messages += fresh.dropped_messages
        for run in in_runs(blocks):
            data = self._encoder.encode(run)
            row = ChunkRow(run[0].drive, run[0].start_s, run[-1].end_s, len(run), data)
            with self._adding:
                self._waiting.add_chunks((row,))

    def _write(self) -> None:
        """A long backlog takes several transactions; learned state goes with the last, never ahead of its data."""
        assert self.database is not None
        while len(self._waiting.chunks) > 1 and self._waiting.chunk_bytes > self._budget.transaction_bytes:
            self._write_chunks_only()
        self._budget.hold_journal(self.database, self._path)
        waiting = self._waiting
        with self._transaction():
            sizes = [len(row.data) for row in waiting.chunks]
            sent = [(row.drive, row.run, row.topic, row.sequence, _packed(row)) for row in waiting.messages]
            packed = [len(row[-1]) for row in sent]
            self._budget.make_room(self.database, sizes, len(waiting.snapshots), len(waiting.events), packed)
            for row in waiting.chunks:
                self._insert_chunk(row)
            for snapshot in waiting.snapshots:
                self._insert_snapshot(snapshot)
            events = [(row.drive, row.time_s, int(row.severity), row.source, row.message) for row in waiting.events]
            self.database.executemany(
                "INSERT INTO event (drive, time_s, severity, source, message, crc) VALUES (?, ?, ?, ?, ?, ?)",
                [(*row, seal(*row)) for row in events],
            )
            self.database.executemany(
                "INSERT INTO message (drive, run, topic, sequence, data, crc) VALUES (?, ?, ?, ?, ?, ?)",
                [(*row, seal(*row)) for row in sent],
            )
            for size in packed:
                self._budget.add("message", size)
            self.database.executemany(
                "INSERT OR REPLACE INTO state (key, data, crc) VALUES (?, ?, ?)",
                [(key, blob, seal(key, blob)) for key, blob in waiting.states.items()],
            )
            self._write_hours()
        with self._adding:
            self._waiting = Waiting(
                self._budget.buffer_bytes,
                dropped_blocks=waiting.dropped_blocks,
                dropped_snapshots=waiting.dropped_snapshots,
                dropped_events=waiting.dropped_events,
                dropped_messages=waiting.dropped_messages,
            )

    def _write_chunks_only(self) -> None:
        assert self.database is not None
        self._budget.hold_journal(self.database, self._path)
        batch: list[ChunkRow] = []
        size = 0
        for row in self._waiting.chunks:
            if batch and size + len(row.data) > self._budget.transaction_bytes:
                break
            batch.append(row)
            size += len(row.data)
        with self._transaction():
            self._budget.make_room(self.database, [len(row.data) for row in batch], 0, 0)
            for row in batch:
                self._insert_chunk(row)
        with self._adding:
            for _ in batch:
                self._waiting.chunk_bytes -= len(self._waiting.chunks.popleft().data)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """All or nothing, whatever goes wrong inside."""
        assert self.database is not None
        self.database.execute("BEGIN IMMEDIATE")
        try:
            yield
            self.database.execute("COMMIT")
        except BaseException:
            self._roll_back()
            self._ids.clear()  # a name that was given its number here has none now
            self._hours.clear()
            self._budget.recount(self.database)
            raise

    def _insert_chunk(self, row: ChunkRow) -> None:
        assert self.database is not None
        stored = (self._drive_id(row.drive), row.start_s, row.end_s, row.data)
        self.database.execute(
            "INSERT INTO chunk (drive, start_s, end_s, data, crc) VALUES (?, ?, ?, ?, ?)", (*stored, seal(*stored))
        )
        self._budget.add("chunk", len(row.data))

    def _insert_snapshot(self, snapshot: Snapshot) -> None:
        assert self.database is not None
        data = pack_estimates(snapshot)
        names = names_of(snapshot)
        drive, reasons = self._drive_id(snapshot.drive), "\n".join(snapshot.reasons)
        row = (drive, snapshot.time_s, snapshot.sequence, int(snapshot.state), reasons)
        self.database.execute(
            "INSERT INTO snapshot (drive, time_s, sequence, state, reasons, nameset, data, crc)"
            " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (*row, self._id("nameset", "names", names), data, seal(*row, names, data)),
        )
        self._budget.add("snapshot", len(data))
        self._count_hour(snapshot)

    def _count_hour(self, snapshot: Snapshot) -> None:
        assert self.database is not None
        hour = hour_of(snapshot.time_s)
        current = self._hours.get(snapshot.drive)
        if current is None or current.hour != hour:
            if current is not None:
                self._write_hour(snapshot.drive, current)
            current = self._hours[snapshot.drive] = HourMeans(hour, self._means_so_far(snapshot.drive, hour))
            self._hours_due_s[snapshot.drive] = snapshot.time_s + HOUR_SAVED_S
        current.add(snapshot)

    def _means_so_far(self, drive: str, hour: int) -> dict[str, Mean]:
        """What an earlier run stored of this hour; nothing where that cannot be read."""
        assert self.database is not None
        key = (self._drive_id(drive), hour)
        found = self.database.execute("SELECT data, crc FROM hour WHERE drive = ? AND hour = ?", key).fetchone()
        if found is None:
            return {}
        with suppress(*DAMAGE):
            if is_whole(found[1], *key, found[0]):
                return decode_means(found[0])
        self._set_aside("the means of this hour")
        return {}

    def _write_hours(self, *, all_of_them: bool = False) -> None:
        for drive, hour in self._hours.items():
            newest_s = self._kept.get(drive, (0.0, 0))[0]
            if all_of_them or newest_s >= self._hours_due_s.get(drive, 0.0):
                self._write_hour(drive, hour)
                self._hours_due_s[drive] = newest_s + HOUR_SAVED_S

    def _write_hour(self, drive: str, hour: HourMeans) -> None:
        assert self.database is not None
        row = (self._drive_id(drive), hour.hour, hour.encode())
        self.database.execute(
            "INSERT OR REPLACE INTO hour (drive, hour, data, crc) VALUES (?, ?, ?, ?)", (*row, seal(*row))
        )

    def _drive_id(self, name: str) -> int:
        return self._id("drive", "name", name)

    def _id(self, table: str, column: str, value: str | bytes) -> int:
        """The number of a name, given one if it is new."""
        assert self.database is not None
        number = self._ids.get((table, value))
        if number is None:
            self.database.execute(f"INSERT OR IGNORE INTO {table} ({column}) VALUES (?)", (value,))  # noqa: S608
            row = self.database.execute(f"SELECT id FROM {table} WHERE {column} = ?", (value,)).fetchone()  # noqa: S608
            number = self._ids[table, value] = int(row[0])
        return number

    # trouble

    def _set_aside(self, what: str) -> None:
        """A row that is not as it was written is never loaded, and told."""
        self._damaged_rows += 1
        self.notes.append(f"{self._path}: {what} was changed on the disk since it was written, and is not loaded")

    def _translated(self, error: sqlite3.Error) -> StoreError:
        """The error as ours; a damaged file is moved aside at once, so that the next call can begin a new one."""
        if is_damage(error):
            if self.database is not None:
                self.database.close()
                self.database = None
            aside = move_aside(self._path)
            self.notes.append(f"{self._path}: {error}: moved aside as {aside.name}; a new store is begun")
            return StoreError(self.notes[-1])
        if is_full(error):
            self._budget.was_full()
            return StoreFull(f"{self._path}: no space left: {error}: what was stored is intact")
        return StoreError(f"{self._path}: cannot be written: {error}")

    def _roll_back(self) -> None:
        if self.database is not None and self.database.in_transaction:
            with suppress(sqlite3.Error):
                self.database.execute("ROLLBACK")


def _packed(row: SentRow) -> bytes:
    return zlib.compress(row.payload, SNAPSHOT_LEVEL)


def file_bytes(path: Path) -> int:
    """Bytes on disk, journal and its index included."""
    parts = (path.with_name(path.name + suffix) for suffix in ("", "-wal", "-shm"))
    return sum(part.stat().st_size for part in parts if part.exists())
