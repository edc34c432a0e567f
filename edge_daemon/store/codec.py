"""Blocks as compact bytes and back, to the last bit.

An encoder's angle is a whole number of counts times the size of a count; its 52 mantissa bits look random, its counts
do not. Where a channel turns out to be such a multiple, the counts' second differences are kept and the product is
formed again on reading; it is checked on writing that the result is the same. Anything else keeps its 64 bits.
Missing samples (NaN) are kept as a bit mask.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array, Block, Flags

LEVEL = 1
"""Level of zlib: measured on encoder and torque channels, level 6 saves 1 % of the bytes for a fifth more time."""
MOST_COUNT = 2.0**52
"""A larger count is not exact as a float."""
TRIALS = 8
"""A channel may show its step in so many chunks before it is taken for continuous."""
RETRY_EVERY = 200
"""A continuous channel is looked at again after so many chunks."""
GCD_VALUES = 32
"""The common step is sought in so many differences."""
REFINEMENTS = 16
SMALLEST_STEP_ULP = 65_536.0
"""A common step closer to rounding error than this is an accident."""
WHOLE = {"<i1": 2**7, "<i2": 2**15, "<i4": 2**31, "<i8": 2**63}
"""Types of whole numbers, and what each does not hold any more."""


class Packed(msgspec.Struct, array_like=True, frozen=True):
    """One channel. `step` 0: float bits, else counts of this step; `first`: the two first counts."""

    step: float
    dtype: str
    first: tuple[int, int]
    data: bytes
    missing: bytes
    flaws: bytes


class Chunk(msgspec.Struct, array_like=True, frozen=True):
    """Consecutive blocks of one drive with the same channels and rate."""

    rate_hz: float
    sequences: tuple[int, ...]
    starts_s: tuple[float, ...]
    sizes: tuple[int, ...]
    channels: dict[str, Packed]


class BlockEncoder:
    """Remembers each channel's step, so that it is sought once."""

    def __init__(self) -> None:
        self._steps: dict[tuple[str, str], float] = {}
        self._failed: dict[tuple[str, str], int] = {}

    def encode(self, blocks: Sequence[Block]) -> bytes:
        """One chunk of consecutive blocks of one drive with the same rate and channels."""
        first = blocks[0]
        channels = {}
        for name in first.values:
            values = np.concatenate([block.values[name] for block in blocks])
            flaws = np.concatenate([block.flaws[name] for block in blocks])
            channels[name] = self._pack((first.drive, name), values, flaws)
        chunk = Chunk(
            first.rate_hz,
            tuple(block.sequence for block in blocks),
            tuple(block.start_s for block in blocks),
            tuple(block.size for block in blocks),
            channels,
        )
        return msgspec.msgpack.encode(chunk)

    def _pack(self, key: tuple[str, str], values: Array, flaws: Flags) -> Packed:
        marks = zlib.compress(flaws.tobytes(), LEVEL) if flaws.any() else b""
        absent = np.isnan(values)
        missing = b""
        if absent.any():
            missing = zlib.compress(np.packbits(absent).tobytes(), LEVEL)
            values = _filled(values, absent)
        step = self._step(key, values)
        if step:
            counts = np.rint(values / step).astype(np.int64)
            first, data, dtype = _second_differences(counts)
            return Packed(step, dtype, first, data, missing, marks)
        bits = values.view(np.int64)
        bits = np.concatenate((bits[:1], bits[1:] - bits[:-1]))
        return Packed(0.0, "<i8", (0, 0), _shuffled(bits), missing, marks)

    def _step(self, key: tuple[str, str], values: Array) -> float:
        """The known or found step that gives back every value exactly; 0 if there is none."""
        known = self._steps.get(key, 0.0)
        if known and is_multiple(values, known):
            return known
        failed = self._failed.get(key, 0)
        if failed >= TRIALS and failed % RETRY_EVERY:
            self._failed[key] = failed + 1
            return 0.0
        found = common_step(values)
        if found:
            self._steps[key] = found
            self._failed[key] = 0
        else:
            self._failed[key] = failed + 1
        return found


def decode(drive: str, data: bytes) -> Iterable[Block]:
    """The blocks of a chunk, oldest first. Raises `msgspec.DecodeError`, `zlib.error` or `ValueError` on damage."""
    chunk = msgspec.msgpack.decode(data, type=Chunk)
    size = sum(chunk.sizes)
    unpacked = {name: _unpack(packed, size) for name, packed in chunk.channels.items()}
    first = 0
    for sequence, start_s, length in zip(chunk.sequences, chunk.starts_s, chunk.sizes, strict=True):
        part = slice(first, first + length)
        first += length
        yield Block(
            drive,
            sequence,
            start_s,
            chunk.rate_hz,
            {name: values[part] for name, (values, _) in unpacked.items()},
            {name: flaws[part] for name, (_, flaws) in unpacked.items()},
        )


def _unpack(packed: Packed, size: int) -> tuple[Array, Flags]:
    raw = _unshuffled(packed.data, packed.dtype)
    if packed.step:
        counts = np.empty(size, dtype=np.int64)
        counts[: min(size, 2)] = packed.first[:size]
        if size > 2:
            slope = np.cumsum(raw) + (packed.first[1] - packed.first[0])
            counts[2:] = np.cumsum(slope) + packed.first[1]
        with np.errstate(over="ignore"):
            values: Array = np.asarray(counts * packed.step, dtype=np.float64)
        if not np.isfinite(values).all():
            raise ValueError(f"counts times {packed.step:g} are beyond all numbers")
    else:
        values = np.cumsum(raw).view(np.float64)
    if packed.missing:
        bits = np.frombuffer(zlib.decompress(packed.missing), dtype=np.uint8)
        values[np.unpackbits(bits, count=size).astype(bool)] = math.nan
    if not packed.flaws:
        return values, np.zeros(size, dtype=np.uint8)
    return values, np.frombuffer(zlib.decompress(packed.flaws), dtype=np.uint8).copy()


def _filled(values: Array, absent: NDArray[np.bool_]) -> Array:
    """NaN replaced by the value before, so that differences stay small."""
    if absent.all():
        return np.zeros_like(values)
    newest = np.maximum.accumulate(np.where(absent, -1, np.arange(len(values))))
    newest[newest < 0] = int(np.argmin(absent))
    filled: Array = values[newest]
    return filled


def _second_differences(counts: NDArray[np.int64]) -> tuple[tuple[int, int], bytes, str]:
    """The two first counts, and the second differences in the narrowest type that holds them."""
    first = (int(counts[0]), int(counts[1]) if len(counts) > 1 else 0)
    bends = np.diff(counts, n=2)
    widest = int(np.abs(bends).max()) if len(bends) else 0
    dtype = next(name for name, most in WHOLE.items() if widest < most)
    return first, _shuffled(bends.astype(dtype)), dtype


def _shuffled(whole: NDArray[np.integer]) -> bytes:
    """Bytes of equal weight side by side compress better."""
    width = whole.dtype.itemsize
    return zlib.compress(whole.view(np.uint8).reshape(-1, width).T.tobytes(), LEVEL)


def _unshuffled(data: bytes, dtype: str) -> NDArray[np.int64]:
    if dtype not in WHOLE:
        raise ValueError(f"numbers of type {dtype!r}: expected one of {', '.join(WHOLE)}")
    width = np.dtype(dtype).itemsize
    flat = np.frombuffer(zlib.decompress(data), dtype=np.uint8).reshape(width, -1)
    return np.ascontiguousarray(flat.T).reshape(-1).view(dtype).astype(np.int64)


def is_multiple(values: Array, step: float) -> bool:
    """True where every value is exactly a whole number times `step`, and small enough for that to be unique."""
    counts = np.rint(values / step)
    return bool(np.abs(counts).max() < MOST_COUNT and (counts * step == values).all())


def common_step(values: Array) -> float:
    """The largest step of which all (n,) values are exact whole multiples; 0 if there is none.

    Euclid's algorithm on differences finds it to rounding; the neighbouring floats are then tried for exactness.
    """
    if not np.isfinite(values).all():
        return 0.0
    largest = float(np.abs(values).max())
    if largest == 0.0:
        return 1.0
    ulp = float(np.spacing(largest))
    tolerance = SMALLEST_STEP_ULP * ulp
    apart = np.abs(np.diff(values))
    apart = np.unique(apart[apart > tolerance])[:GCD_VALUES]
    rough = float(apart[0]) if len(apart) else largest
    for distance in apart[1:].tolist():
        rough = _gcd(distance, rough, tolerance)
        if rough <= tolerance:
            return 0.0
    best = _refined(rough, values, largest)
    if not best:
        return 0.0
    for candidate in (best, *_neighbours(best), float(f"{best:.9g}")):
        if candidate > 0 and is_multiple(values, candidate):
            return candidate
    return 0.0


def _refined(rough: float, values: Array, largest: float) -> float:
    """A step from ever longer distances: each tells how many steps the next one holds."""
    spans = np.sort(np.abs(values - values[0]))
    for span in (*spans[np.linspace(0, len(spans) - 1, REFINEMENTS).astype(int)].tolist(), largest):
        count = round(span / rough)
        if count:
            rough = span / count
    return rough if round(largest / rough) else 0.0


def _neighbours(step: float) -> tuple[float, ...]:
    below, above = math.nextafter(step, 0.0), math.nextafter(step, math.inf)
    return below, above, math.nextafter(below, 0.0), math.nextafter(above, math.inf)


def _gcd(a: float, b: float, tolerance: float) -> float:
    """Greatest common divisor of two floats that are multiples of it to within `tolerance`."""
    for _ in range(100):
        if b <= tolerance:
            return a
        a, b = b, abs(a - round(a / b) * b)
    return 0.0


def summed_size(blocks: Iterable[Block]) -> int:
    """Bytes of arrays in memory."""
    return sum(_size(block.values) + _size(block.flaws) for block in blocks)


def _size(arrays: Mapping[str, Array] | Mapping[str, Flags]) -> int:
    return sum(array.nbytes for array in arrays.values())
