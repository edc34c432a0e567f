"""A checksum beside every row, so that a bit that the medium turned is told from what was written.

SQLite checks its pages' structure, not what stands in them: of a flipped bit inside a value it says nothing.
"""

from __future__ import annotations

import zlib


def seal(*parts: object) -> int:
    """Checksum (CRC-32) over the columns of a row, each with its length."""
    found = 0
    for part in parts:
        if isinstance(part, bytes):
            raw = part
        else:
            raw = (repr(float(part)) if isinstance(part, float) else str(part)).encode("utf-8", "surrogatepass")
        found = zlib.crc32(raw, zlib.crc32(len(raw).to_bytes(8, "big"), found))
    return found


def is_whole(sealed: int | None, *parts: object) -> bool:
    """Whether a row is as it was written; a row from before there were checksums is believed."""
    return sealed is None or sealed == seal(*parts)
