"""The samples of a sound file, first channel, in stretches: a long recording never stands in memory as a whole.

WAV, RF64, FLAC, AIFF and what else libsndfile reads without loss. A file that was cut off is read as far as it goes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge_daemon.errors import BadInput
from edge_daemon.records import Array

SUFFIXES = (".wav", ".wave", ".rf64", ".w64", ".flac", ".aif", ".aiff", ".au", ".caf")
"""Files of these names are sound; other names are tables."""
BITS = {"PCM_S8": 8, "PCM_U8": 8, "PCM_16": 16, "PCM_24": 24, "PCM_32": 32, "FLOAT": 0, "DOUBLE": 0}
"""Bits of a sample by kind, 0 for floating point; a kind that loses some of the sound is refused: it shapes noise."""
UNKNOWN_BYTES = (0, 0xFFFFFFFF)
"""A recorder that never came back to write its length leaves one of these."""
STRETCH = 1 << 19
"""So many samples are read at a time: 4 MiB of doubles."""


class RecordedSoundError(BadInput):
    """One line: file, what about it, what was expected."""


@dataclass(frozen=True, slots=True)
class RecordedSound:
    """What a file holds and what its samples mean."""

    path: Path
    rate_hz: float
    channels: int
    step: float
    """size of a count in parts of full scale; 0 for floating point"""
    frames: int
    promised: int
    """frames by the header; more than there are where the file was cut off"""

    @property
    def floating(self) -> bool:
        """Whether samples are no counts."""
        return self.step == 0.0

    def stretches(self, size: int = STRETCH) -> Iterator[Array]:
        """(m,) first channel in parts of full scale, `size` samples at a time."""
        with _opened(self.path) as file:
            for samples in file.blocks(size, dtype="float64", always_2d=True):
                yield samples[:, 0].copy()


def open_sound(path: Path) -> RecordedSound:
    """What a sound file holds. Raises `RecordedSoundError`."""
    with _opened(path) as file:
        bits = BITS.get(file.subtype)
        if bits is None:
            what = f"{file.subtype_info}, {file.frames} samples"
            raise RecordedSoundError(f"{path}: {what}: expected PCM or floating point samples, such as WAV or FLAC")
        step = 2.0 ** (1 - bits) if bits else 0.0
        return RecordedSound(path, float(file.samplerate), file.channels, step, file.frames, _promised(file))


def _opened(path: Path) -> Any:
    """The open file. Raises `RecordedSoundError`."""
    import soundfile

    try:
        with path.open("rb"):
            return soundfile.SoundFile(str(path))
    except OSError as error:
        raise RecordedSoundError(f"{path}: cannot read: {error.strerror}") from error
    except soundfile.LibsndfileError as error:
        raise RecordedSoundError(f"{path}: no sound file that can be read: {error.error_string}") from error


def _promised(file: Any) -> int:
    """Frames by the header, which libsndfile tells in words where they are not there."""
    told = re.search(r"^data : (\d+) \(should be (\d+)\)", file.extra_info, re.MULTILINE)
    frames: int = file.frames
    if told is None or int(told[1]) in UNKNOWN_BYTES or not int(told[2]):
        return frames
    return round(frames * int(told[1]) / int(told[2]))
