"""Several collectors share one folder: who of them writes what, settled by locks that end with their process.

Each collector has a seat of its own, a locked file, and writes only files of its number. The drives are spread over a
fixed number of shares; a collector takes in only drives of the shares whose locks it holds. Each works out from the
taken seats which shares are its own, gives back the others once what it heard of them is written, and takes over those
of a collector that has gone.
"""

from __future__ import annotations

import fcntl
import os
import zlib
from pathlib import Path

from edge_daemon.errors import BadInput
from edge_daemon.fleet.dataset import WORK

SHARES = 32
"""Drives are spread over so many shares: a fair part for up to eight collectors, within a tenth."""
SEATS = 64
"""So many collectors may share a folder."""


def share_of(drive_key: str) -> int:
    """Which share a drive, site/gateway/drive, belongs to."""
    return zlib.crc32(drive_key.encode()) % SHARES


class Shares:
    """The locks of one collector."""

    def __init__(self, folder: Path) -> None:
        """Takes a seat. Raises `BadInput` where the folder cannot be written or has no seat left."""
        self._folder = folder / WORK
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._seat_handle, self.seat = self._take_seat()
        except OSError as error:
            raise BadInput(f"{folder}: cannot be written: {error.strerror}") from error
        self._held: dict[int, int] = {}

    @property
    def held(self) -> set[int]:
        """Shares whose drives are this collector's."""
        return set(self._held)

    def wanted(self) -> set[int]:
        """Shares that should be this collector's, given who sits there now."""
        seats = [seat for seat in range(SEATS) if seat == self.seat or self._is_taken(seat)]
        mine = seats.index(self.seat)
        return {share for share in range(SHARES) if share % len(seats) == mine}

    def take(self, share: int) -> bool:
        """Whether the share was free and is now held."""
        handle = _lock(self._folder / f"share-{share:02d}.lock")
        if handle is not None:
            self._held[share] = handle
        return handle is not None

    def give_back(self, share: int) -> None:
        """Let another have it; what was heard of it must be written."""
        os.close(self._held.pop(share))

    def close(self) -> None:
        """Give back all, and the seat."""
        for share in list(self._held):
            self.give_back(share)
        os.close(self._seat_handle)

    def _take_seat(self) -> tuple[int, int]:
        for seat in range(SEATS):
            handle = _lock(self._seat_file(seat))
            if handle is not None:
                return handle, seat
        raise BadInput(f"{self._folder.parent}: {SEATS} collectors write here already")

    def _seat_file(self, seat: int) -> Path:
        return self._folder / f"seat-{seat:02d}.lock"

    def _is_taken(self, seat: int) -> bool:
        path = self._seat_file(seat)
        if not path.exists():
            return False
        handle = _lock(path, fcntl.LOCK_SH)
        if handle is None:
            return True
        os.close(handle)
        return False


def _lock(path: Path, kind: int = fcntl.LOCK_EX) -> int | None:
    """A handle that holds the lock; None where somebody else does."""
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    return handle
