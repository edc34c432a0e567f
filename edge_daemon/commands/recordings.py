"""Recordings as commands read them: what was repaired in a file is said on standard error."""

from __future__ import annotations

import sys
from pathlib import Path

from edge_daemon.acquire.recording import Recording, read_recording


def read_told(path: Path) -> Recording:
    """The recording of a file; what was repaired in it is said on standard error. Raises `BadInput`."""
    recording = read_recording(path)
    for line in recording.notes.lines():
        print(f"{path}: {line}", file=sys.stderr)
    return recording
