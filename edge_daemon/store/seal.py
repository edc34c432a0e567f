"""A checksum beside every row, so that a bit that the medium turned is told from what was written.

SQLite checks its pages' structure, not what stands in them: of a flipped bit inside a value it says nothing.
"""

from __future__ import annotations

import zlib


def seal(*parts: object) -> int:
    """Checksum (CRC-32) over the columns of a row, each with its length."""
    pieces: list[bytes] = []
    for part in parts:
        raw = part if isinstance(part, bytes) else _written(part)
        pieces += (len(raw).to_bytes(8, "big"), raw)
    return zlib.crc32(b"".join(pieces))


def _written(part: object) -> bytes:
    return (repr(float(part)) if isinstance(part, float) else str(part)).encode("utf-8", "surrogatepass")


def is_whole(sealed: int | None, *parts: object) -> bool:
    """Whether a row is as it was written; a row from before there were checksums is believed."""
    return sealed is None or sealed == seal(*parts)
