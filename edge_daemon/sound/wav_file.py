"""The samples of a WAV file, first channel, in stretches: a long recording never stands in memory as a whole.

PCM of 8 to 32 bits and floating point, plain or extensible (Microsoft & IBM, Multimedia Programming Interface 1.0,
1991; WAVEFORMATEXTENSIBLE, 2001; RF64 after EBU Tech 3306). A file that was cut off is read as far as it goes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.records import Array

PCM, FLOAT, EXTENSIBLE = 1, 3, 0xFFFE
WIDTHS = {PCM: (8, 16, 24, 32), FLOAT: (32, 64)}
UNKNOWN_SIZE = (0, 0xFFFFFFFF)
"""A recorder that never came back to write its length, or RF64, leaves one of these in the data chunk."""
STRETCH = 1 << 19
"""So many samples are read at a time: 4 MiB of doubles."""


class WavError(BadInput):
    """One line: file, what about it, what was expected."""


@dataclass(frozen=True, slots=True)
class Wav:
    """Where the samples are and what they mean."""

    path: Path
    rate_hz: float
    channels: int
    bits: int
    """that hold a sample in the file"""
    valid_bits: int
    """of them that say something"""
    floating: bool
    offset: int
    frames: int
    promised: int
    """frames by the header; more than there are where the file was cut off"""

    @property
    def step(self) -> float:
        """Size of a count in parts of full scale; 0 for floating point."""
        return 0.0 if self.floating else 2.0 ** (1 - self.valid_bits)

    def stretches(self, size: int = STRETCH) -> Iterator[Array]:
        """(m,) first channel in parts of full scale, `size` samples at a time."""
        frame = self.channels * self.bits // 8
        with self.path.open("rb") as file:
            file.seek(self.offset)
            left = self.frames
            while left > 0:
                data = file.read(min(size, left) * frame)
                found = len(data) // frame
                if not found:
                    return
                yield self._samples(data[: found * frame])
                left -= found

    def _samples(self, data: bytes) -> Array:
        if self.floating:
            kind = "<f4" if self.bits == 32 else "<f8"
            return np.frombuffer(data, kind).reshape(-1, self.channels)[:, 0].astype(np.float64)
        width = self.bits // 8
        raw = np.frombuffer(data, np.uint8).reshape(-1, self.channels, width)[:, 0]
        if width == 1:
            return (raw[:, 0].astype(np.float64) - 128.0) / 128.0
        wide = np.zeros((len(raw), 4), dtype=np.uint8)
        wide[:, 4 - width :] = raw
        counts: Array = wide.view("<i4")[:, 0] / 2.0**31
        return counts


def open_wav(path: Path) -> Wav:
    """What a WAV file holds. Raises `WavError`."""
    try:
        with path.open("rb") as file:
            return _header(path, file)
    except OSError as error:
        raise WavError(f"{path}: cannot read: {error.strerror}") from error
    except struct.error as error:
        raise WavError(f"{path}: not a PCM WAV file: it ends early") from error


def _header(path: Path, file: BinaryIO) -> Wav:
    form, _, kind = struct.unpack("<4sI4s", file.read(12))
    if form not in (b"RIFF", b"RF64") or kind != b"WAVE":
        raise WavError(f"{path}: not a PCM WAV file: expected it to begin with RIFF....WAVE")
    end = path.stat().st_size
    layout, long_size = None, 0
    while True:
        name, size = struct.unpack("<4sI", file.read(8))
        at = file.tell()
        if name == b"ds64":
            (long_size,) = struct.unpack("<8xQ", file.read(16))
        elif name == b"fmt ":
            layout = _layout(path, file.read(size))
        elif name == b"data":
            break
        file.seek(at + size + size % 2)
    if layout is None:
        raise WavError(f"{path}: not a PCM WAV file: no fmt chunk before its data")
    rate_hz, channels, bits, valid_bits, floating = layout
    promised = long_size or end - at if size in UNKNOWN_SIZE else size
    frame = channels * bits // 8
    there = min(end - at, promised)
    return Wav(path, rate_hz, channels, bits, valid_bits, floating, at, there // frame, promised // frame)


def _layout(path: Path, chunk: bytes) -> tuple[float, int, int, int, bool]:
    """Rate, channels, bits, valid bits, whether floating point."""
    tag, channels, rate_hz, _, _, bits = struct.unpack("<HHIIHH", chunk[:16])
    valid_bits = bits
    if tag == EXTENSIBLE and len(chunk) >= 26:
        given, _, tag = struct.unpack("<HIH", chunk[18:26])
        valid_bits = given if 0 < given <= bits else bits
    if bits not in WIDTHS.get(tag, ()) or channels == 0 or rate_hz == 0:
        what = f"format {tag}, {bits} bits, {channels} channels, {rate_hz} Hz"
        raise WavError(f"{path}: header: {what}: expected PCM of 8, 16, 24 or 32 bits, or float of 32 or 64")
    return float(rate_hz), channels, bits, valid_bits, tag == FLOAT
