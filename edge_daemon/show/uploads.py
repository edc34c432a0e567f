"""Recordings that a person brings to the page: bounded in size and number, checked to be what their name says."""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import BinaryIO

from edge_daemon.errors import BadInput

SUFFIXES = (".csv", ".parquet")
MOST_BYTES = 64 * 2**20
"""One recording has no more bytes: about ten minutes of four channels at 1 kHz as CSV."""
KEPT = 4
"""So many of the newest uploads are kept; older ones make room."""
HEAD_BYTES = 64 * 2**10
"""The header of a CSV file must stand within so many bytes."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}\.(csv|parquet)")
MAGIC = b"PAR1"
COLUMNS = ".columns.toml"
"""Ending of what says beside a recording how its columns are to be read."""
PARTIAL = ".partial"


class Uploads:
    """A folder of uploaded recordings; made with the first of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._busy = False

    def files(self) -> dict[str, Path]:
        """Name -> file of what was uploaded."""
        with contextlib.suppress(OSError):
            return {path.name: path for path in sorted(self.folder.iterdir()) if path.suffix in SUFFIXES}
        return {}

    async def take(self, name: str, body: AsyncIterator[bytes]) -> int:
        """Write a recording piece by piece; its size. Raises `BadInput`, and leaves nothing, for what is none."""
        if not NAME.fullmatch(name):
            raise BadInput(
                f"name {name[:40]!r}: expected letters, digits, dots, _ and - that end in {' or '.join(SUFFIXES)}"
            )
        if self._busy:
            raise BadInput("another recording is being uploaded: wait for it")
        self._busy = True
        part = self.folder / f"{name}{PARTIAL}"
        try:
            await asyncio.to_thread(self.folder.mkdir, parents=True, exist_ok=True)
            size = await _write(part, body)
            await asyncio.to_thread(_check, part, name)
            part.replace(self.folder / name)
            (self.folder / f"{name}{COLUMNS}").unlink(missing_ok=True)
            self._make_room()
        except OSError as error:
            raise BadInput(f"{name}: cannot be kept: {error.strerror}") from error
        finally:
            part.unlink(missing_ok=True)
            self._busy = False
        return size

    def _make_room(self) -> None:
        rows = sorted(self.files().values(), key=lambda path: path.stat().st_mtime_ns)
        for path in rows[:-KEPT]:
            path.unlink(missing_ok=True)
            path.with_name(f"{path.name}{COLUMNS}").unlink(missing_ok=True)


async def _write(part: Path, body: AsyncIterator[bytes]) -> int:
    size = 0
    file: BinaryIO = await asyncio.to_thread(part.open, "wb")
    try:
        async for piece in body:
            size += len(piece)
            if size > MOST_BYTES:
                raise BadInput(f"larger than {MOST_BYTES // 2**20} MiB: upload a shorter recording, or Parquet")
            await asyncio.to_thread(file.write, piece)
    finally:
        file.close()
    return size


def _check(part: Path, name: str) -> None:
    with part.open("rb") as file:
        head = file.read(HEAD_BYTES)
        file.seek(max(file.seek(0, 2) - len(MAGIC), 0))
        tail = file.read()
    if name.endswith(".parquet"):
        if not (head.startswith(MAGIC) and tail == MAGIC):
            raise BadInput(f"{name}: is no Parquet file")
        return
    try:
        text = head.decode("utf-8-sig") if len(head) < HEAD_BYTES else head.decode("utf-8-sig", errors="ignore")
    except UnicodeDecodeError as error:
        raise BadInput(f"{name}: is no text in UTF-8: expected CSV with a header") from error
    if "\0" in text or not re.search(r"\d[^\n]*[,;\t][^\n]*\d", text):
        raise BadInput(f"{name}: no rows of numbers with commas, semicolons or tabs between: expected CSV")
