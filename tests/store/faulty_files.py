"""A layer between SQLite and its files: it can fail any write or sync, and knows what a power cut would have left.

The system's own layer (VFS, sqlite.org/c3ref/vfs.html) does the work; of the table of functions that it gives each file
a copy is changed, so that writes, syncs and truncations pass through here.
"""

from __future__ import annotations

import ctypes
import os
import random
import sqlite3
from collections.abc import Callable
from ctypes import CFUNCTYPE, POINTER, c_char_p, c_int, c_int64, c_void_p, string_at
from dataclasses import dataclass, field
from pathlib import Path

FULL, WRITE_FAILED, SYNC_FAILED = 13, 10 | 3 << 8, 10 | 4 << 8
"""SQLITE_FULL is ENOSPC; SQLITE_IOERR_WRITE and _FSYNC are EIO."""
SECTOR = 512
"""The smallest piece that a medium writes whole."""
VFS_BYTES, METHODS_BYTES = 168, 152
"""Of version 3 of both structures, with 64-bit pointers."""
X_NAME, X_OPEN, X_WRITE, X_TRUNCATE, X_SYNC = 24, 40, 24, 32, 40
"""Where the functions stand in them."""
OPEN = CFUNCTYPE(c_int, c_void_p, c_void_p, c_void_p, c_int, c_void_p)
WRITE = CFUNCTYPE(c_int, c_void_p, c_void_p, c_int, c_int64)
TRUNCATE = CFUNCTYPE(c_int, c_void_p, c_int64)
SYNC = CFUNCTYPE(c_int, c_void_p, c_int)


@dataclass(slots=True)
class Media:
    """A file as it is on the medium, and what was written since its last sync, in order."""

    synced: bytearray = field(default_factory=bytearray)
    since: list[tuple[int, bytes | None]] = field(default_factory=list)
    """offset and data; None: cut off there"""

    def settle(self) -> None:
        """A sync came back."""
        for change in self.since:
            _apply(self.synced, *change)
        self.since.clear()

    def after_cut(self, rng: random.Random) -> bytes:
        """What a power cut may leave: of what was not synced each write there, dropped or torn, in any order."""
        left, changes = bytearray(self.synced), list(self.since)
        rng.shuffle(changes)
        for offset, data in changes:
            fate = rng.choice(("kept", "dropped", "torn"))
            if fate == "torn" and data:
                data = data[: SECTOR * rng.randrange(len(data) // SECTOR + 1)]
            if fate != "dropped" and data != b"":
                _apply(left, offset, data)
        return bytes(left)


def _apply(content: bytearray, offset: int, data: bytes | None) -> None:
    if data is None:
        del content[offset:]
        return
    content.extend(bytes(max(0, offset + len(data) - len(content))))
    content[offset : offset + len(data)] = data


class FaultyFiles:
    """Use as a context manager: SQLite's files that are opened meanwhile are watched.

    `fails` is asked with the number of each write or sync of a file on disk and says what it ends with (0: done).
    """

    def __init__(self, fails: Callable[[int, str], int] = lambda number, call: 0) -> None:
        self.fails = fails
        self.calls = 0
        self.media: dict[Path, Media] = {}
        self._files: dict[int, Path] = {}
        self._kept: list[object] = []
        library = sqlite_library()
        assert library is not None
        self._library = library

    def __enter__(self) -> FaultyFiles:
        self._usual = self._library.sqlite3_vfs_find(None)
        own = ctypes.create_string_buffer(string_at(self._usual, VFS_BYTES), VFS_BYTES)
        self._open_usual = OPEN(_pointer(own, X_OPEN))
        opened = OPEN(self._opened)
        _point(own, X_OPEN, opened)
        name = ctypes.create_string_buffer(b"faulty")
        _point(own, X_NAME, name)
        self._kept += [own, opened, name]
        self._own = ctypes.addressof(own)
        assert self._library.sqlite3_vfs_register(self._own, 1) == 0
        return self

    def __exit__(self, *_: object) -> None:
        self._library.sqlite3_vfs_register(self._usual, 1)
        self._library.sqlite3_vfs_unregister(self._own)

    def after_cut(self, folder: Path, rng: random.Random) -> None:
        """Writes what a power cut now would leave, under the same names, into `folder`."""
        for path, media in self.media.items():
            if path.exists():
                (folder / path.name).write_bytes(media.after_cut(rng))

    def _opened(self, vfs: int, name: int | None, file: int, flags: int, out: int | None) -> int:
        result = int(self._open_usual(vfs, name, file, flags, out))
        if result == 0 and name is not None:
            path = Path(os.fsdecode(string_at(name)))
            self._files[file] = path
            if path not in self.media or not path.stat().st_size:
                self.media[path] = Media(bytearray(path.read_bytes()))
            self._watch(file)
        return result

    def _watch(self, file: int) -> None:
        """Puts our functions into the file's table."""
        place = ctypes.cast(file, POINTER(c_void_p))
        usual = ctypes.create_string_buffer(string_at(place[0] or 0, METHODS_BYTES), METHODS_BYTES)
        write, truncate = WRITE(_pointer(usual, X_WRITE)), TRUNCATE(_pointer(usual, X_TRUNCATE))
        sync = SYNC(_pointer(usual, X_SYNC))

        def written(it: int, data: int, length: int, offset: int) -> int:
            result = self._failed("write", it) or int(write(it, data, length, offset))
            if result == 0:
                self.media[self._files[it]].since.append((offset, string_at(data, length)))
            return result

        def truncated(it: int, size: int) -> int:
            result = int(truncate(it, size))
            if result == 0:
                self.media[self._files[it]].since.append((size, None))
            return result

        def synced(it: int, flags: int) -> int:
            result = self._failed("sync", it) or int(sync(it, flags))
            if result == 0:
                self.media[self._files[it]].settle()
            return result

        own = WRITE(written), TRUNCATE(truncated), SYNC(synced)
        for offset, function in zip((X_WRITE, X_TRUNCATE, X_SYNC), own, strict=True):
            _point(usual, offset, function)
        self._kept += [usual, write, truncate, sync, own]
        place[0] = ctypes.addressof(usual)

    def _failed(self, call: str, file: int) -> int:
        self.calls += 1
        return self.fails(self.calls, call)


def _pointer(buffer: ctypes.Array[ctypes.c_char], offset: int) -> int:
    return int.from_bytes(buffer.raw[offset : offset + 8], "little")


def _point(buffer: ctypes.Array[ctypes.c_char], offset: int, to: object) -> None:
    address = ctypes.cast(to, c_void_p).value or 0  # type: ignore[arg-type]
    buffer[offset : offset + 8] = address.to_bytes(8, "little")


def sqlite_library() -> ctypes.CDLL | None:
    """The very library that Python's sqlite3 uses; None where it is linked in, or pointers are not of 64 bits."""
    names = {row.split()[-1] for row in Path("/proc/self/maps").read_text().splitlines() if "libsqlite3" in row}
    if len(names) != 1 or not sqlite3.sqlite_version or ctypes.sizeof(c_void_p) != 8:
        return None
    library = ctypes.CDLL(names.pop())
    library.sqlite3_vfs_find.restype = c_void_p
    library.sqlite3_vfs_find.argtypes = [c_char_p]
    library.sqlite3_vfs_register.argtypes = [c_void_p, c_int]
    library.sqlite3_vfs_unregister.argtypes = [c_void_p]
    return library
