"""Named arrays as the bytes of a checkpoint, and back: numpy's own archive, without pickles."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray


class BrokenArrays(ValueError):
    """Bytes that are no archive of arrays."""


def packed(**arrays: NDArray[Any]) -> bytes:
    """For `unpacked`."""
    blob = io.BytesIO()
    np.savez_compressed(blob, allow_pickle=False, **arrays)
    return blob.getvalue()


def unpacked(blob: bytes) -> dict[str, NDArray[Any]]:
    """The arrays by name. Raises `BrokenArrays`."""
    try:
        with np.load(io.BytesIO(blob), allow_pickle=False) as saved:
            return {name: saved[name] for name in saved}
    except Exception as error:  # a bit that turned makes an archive of another version, an encrypted one, or no Python
        raise BrokenArrays(str(error)) from error
