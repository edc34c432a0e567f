"""A recording on disk with its truth sealed beside it: for practice, and for those who doubt the tool.

The seal only keeps an eye from falling on the answer; it is no encryption.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from pathlib import Path
from typing import cast

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.rig.recording import Simulated

SEAL_SUFFIX = ".sealed"
SEAL_FORMAT = "edge-daemon sealed truth 1"
DIGITS = 12
"""So many significant digits give an angle of 1000 rad to 1e-9 rad, far below an encoder's step."""


class SealError(BadInput):
    """One line: the recording has no seal, the seal is broken, or it belongs to another recording."""


def write(simulated: Simulated, file: Path) -> None:
    """The recording as Parquet if the name ends so, else CSV; nothing about its truth."""
    columns = {"time_s": simulated.time_s, **simulated.columns}
    if file.suffix == ".parquet":
        import pyarrow
        from pyarrow import parquet

        parquet.write_table(pyarrow.table(columns), file)
        return
    table = np.column_stack(list(columns.values()))
    np.savetxt(file, table, fmt=f"%.{DIGITS}g", delimiter=",", header=",".join(columns), comments="")


def seal(file: Path, truth: dict[str, object]) -> Path:
    """Puts `truth` beside the written recording as FILE.sealed; the path of the seal."""
    content = json.dumps({"truth": truth, "sha256": _digest(file)})
    sealed = file.with_name(file.name + SEAL_SUFFIX)
    sealed.write_text(f"{SEAL_FORMAT}\n{base64.b85encode(zlib.compress(content.encode())).decode()}\n")
    return sealed


def reveal(file: Path) -> dict[str, object]:
    """The truth that was sealed beside the recording. Raises `SealError`."""
    sealed = file.with_name(file.name + SEAL_SUFFIX)
    try:
        name, body = sealed.read_text().splitlines()[:2]
        content = json.loads(zlib.decompress(base64.b85decode(body)))
        digest, truth = content["sha256"], content["truth"]
    except OSError as error:
        raise SealError(f"{sealed}: cannot read: {error.strerror}") from error
    except (ValueError, zlib.error, KeyError, TypeError) as error:
        raise SealError(f"{sealed}: not a seal: expected a file written by simulate --hidden") from error
    if name != SEAL_FORMAT:
        raise SealError(f"{sealed}: format {name!r}: expected {SEAL_FORMAT!r}")
    if digest != _digest(file):
        raise SealError(f"{file}: changed since it was sealed: the truth beside it may not be its own")
    return cast("dict[str, object]", truth)


def _digest(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError as error:
        raise SealError(f"{file}: cannot read: {error.strerror}") from error
