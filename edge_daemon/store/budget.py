"""How the file stays under its limit: pages are counted before they are needed, and the oldest rows make room.

Deleted pages are used again, so the file itself need not shrink. The journal (WAL) has a reserve of its own.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from pathlib import Path

from edge_daemon.store.schema import PAGE_BYTES, StoreError

SHARES = {"chunk": 0.72, "snapshot": 0.13, "message": 0.10, "hour": 0.03, "event": 0.02}
"""The data has these shares when the file is full."""
JOURNAL_SHARE = 1 / 8
MOST_JOURNAL_BYTES = 32 * 2**20
MOST_CHECKPOINT_PAGES = 1000
"""The journal is written back at this size (SQLite's own default), or at a quarter of its reserve if that is less."""
MOST_BUFFER_BYTES = 16 * 2**20
"""So much is kept in memory while the disk is full: a few minutes of one drive."""
INDEX_BYTES = 65_536
"""The journal's index file has so many bytes: one page of it covers 4096 pages of journal."""
SLACK_PAGES = 24
"""Inserts may need so many pages for inner nodes of the tables and indices (guess: 12 trees, a split each)."""
USABLE_BYTES = PAGE_BYTES - 4
"""An overflow page holds so many bytes."""
ROW_BYTES = 120
"""Beside the data a row takes so many bytes: its other columns, its index entries, partly filled pages (guess)."""
SNAPSHOT_BYTES = 1000
"""One snapshot takes so many bytes with its row (guess: 30 estimates of 25 bytes)."""
EVENT_BYTES = 200
BATCH_ROWS = {"chunk": 4, "snapshot": 64, "message": 256, "hour": 8, "event": 64}
"""So many rows are deleted at a time, a hundred kilobytes or less."""
CUT_PAGES = 5000
"""So many pages are freed in one transaction when a file is cut down."""


class SpaceBudget:
    """Limits derived from the largest size of file plus journal [bytes]."""

    def __init__(self, most_bytes: int) -> None:
        journal = int(min(most_bytes * JOURNAL_SHARE, MOST_JOURNAL_BYTES))
        self._journal_bytes = journal
        self._checkpoint_pages = min(journal // PAGE_BYTES // 4, MOST_CHECKPOINT_PAGES)
        self.transaction_bytes = journal // 4
        self.buffer_bytes = int(min(most_bytes / 8, MOST_BUFFER_BYTES))
        self._pages = (most_bytes - journal - INDEX_BYTES) // PAGE_BYTES
        self._slack = SLACK_PAGES
        self._bytes: dict[str, int] = {}
        self.deleted = 0

    def attach(self, database: sqlite3.Connection) -> None:
        """Set the limits on a connection."""
        database.execute(f"PRAGMA wal_autocheckpoint = {self._checkpoint_pages}")
        database.execute(f"PRAGMA journal_size_limit = {self._journal_bytes // 2}")
        database.execute(f"PRAGMA max_page_count = {self._pages}")  # of a file that is larger SQLite keeps the size
        self.recount(database)

    def cut(self, database: sqlite3.Connection) -> bool:
        """Where the file is larger than the limit, as after a change of settings, delete down to it; True if so."""
        self.recount(database)
        if _pragma(database, "page_count") <= self._pages:
            return False
        while (over := self._over(database, self._slack)) > 0:
            database.execute("BEGIN IMMEDIATE")
            deleted = self.deleted
            self._free(database, min(over, CUT_PAGES))
            database.execute("COMMIT")
            if self.deleted == deleted:
                break
        return True

    def recount(self, database: sqlite3.Connection) -> None:
        """Bytes of data per kind, from the file."""
        self._bytes = {
            "chunk": _number(database, f"SELECT coalesce(sum(length(data) + {ROW_BYTES}), 0) FROM chunk"),  # noqa: S608
            "snapshot": _number(database, f"SELECT coalesce(sum(length(data) + {ROW_BYTES}), 0) FROM snapshot"),  # noqa: S608
            "message": _number(database, f"SELECT coalesce(sum(length(data) + {ROW_BYTES}), 0) FROM message"),  # noqa: S608
            "hour": _number(database, "SELECT coalesce(sum(length(data)), 0) FROM hour"),
            "event": _number(database, f"SELECT count(*) * {EVENT_BYTES} FROM event"),  # noqa: S608
        }

    def add(self, kind: str, size: int) -> None:
        """A row with so many bytes of data was inserted."""
        self._bytes[kind] += size + ROW_BYTES

    def make_room(
        self,
        database: sqlite3.Connection,
        chunk_sizes: Iterable[int],
        snapshots: int,
        events: int,
        message_sizes: Iterable[int] = (),
    ) -> None:
        """Delete the oldest rows until these fit. Inside the transaction that inserts them."""
        need = self._slack + sum(-(-(size + ROW_BYTES) // USABLE_BYTES) + 1 for size in chunk_sizes)
        small = snapshots * SNAPSHOT_BYTES + events * EVENT_BYTES + sum(size + ROW_BYTES for size in message_sizes)
        need += -(-small // USABLE_BYTES)
        over = self._over(database, need)
        if over > 0:
            self._free(database, over)

    def _over(self, database: sqlite3.Connection, need: int) -> int:
        """Pages that are too many once `need` more are used."""
        return _pragma(database, "page_count") - _pragma(database, "freelist_count") + need - self._pages

    def _free(self, database: sqlite3.Connection, pages: int) -> None:
        """Delete the oldest rows of whichever kind exceeds its share most, until so many pages are free."""
        enough = _pragma(database, "freelist_count") + pages
        left = dict(self._bytes)
        while left and _pragma(database, "freelist_count") < enough:
            kind = max(left, key=lambda name: left[name] / SHARES[name])
            if not self._delete_oldest(database, kind):
                del left[kind]
                continue
            left[kind] = self._bytes[kind]

    def _delete_oldest(self, database: sqlite3.Connection, kind: str) -> int:
        """How many rows of a kind were deleted."""
        key, size = {"hour": ("hour", "length(data)"), "event": ("id", str(EVENT_BYTES))}.get(
            kind, ("id", f"length(data) + {ROW_BYTES}")
        )
        rows = database.execute(
            f"SELECT {key}, {size} FROM {kind} ORDER BY {key} LIMIT {BATCH_ROWS[kind]}"  # noqa: S608
        ).fetchall()
        if not rows:
            return 0
        database.execute(f"DELETE FROM {kind} WHERE {key} <= ?", (rows[-1][0],))  # noqa: S608
        self._bytes[kind] -= sum(row[1] for row in rows)
        self.deleted += len(rows)
        return len(rows)

    def hold_journal(self, database: sqlite3.Connection, path: Path) -> None:
        """Empty a journal that a reader has kept from being written back. Raises `StoreError` if it still does."""
        journal = path.with_name(path.name + "-wal")
        if not journal.exists() or journal.stat().st_size <= self._journal_bytes // 2:
            return
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        if journal.stat().st_size > self._journal_bytes // 2:
            raise StoreError(
                f"{path}: a reader holds the journal at {journal.stat().st_size} bytes: it must finish first"
            )

    def was_full(self) -> None:
        """The disk or the limit said no: keep more distance, within reason."""
        self._slack = min(2 * self._slack, self._pages // 8)


def _pragma(database: sqlite3.Connection, name: str) -> int:
    return _number(database, f"PRAGMA {name}")


def _number(database: sqlite3.Connection, query: str) -> int:
    return int(database.execute(query).fetchone()[0])
