"""A drive's state as the words of the Modbus map."""

from __future__ import annotations

import math
import struct
from typing import Literal

from edge_daemon.publish.registers import (
    BLOCKS,
    BY_NAME,
    LENGTH,
    MAP_VERSION,
    MARKER,
    NEVER_MS,
    PLACES,
    REGISTERS,
    STATUS_CODES,
    TEST_FLOAT,
    TOTAL,
    Type,
    block_and_bit,
    in_block,
    named,
)
from edge_daemon.records import NE107, Estimate, Snapshot, Status

WordOrder = Literal["big", "little"]

_LARGEST_U16 = 0xFFFF
_LARGEST_F32 = 3.4028234e38
"""IEEE 754 binary32; a number beyond it cannot be told to a PLC and reads as invalid"""
_DOUBLE_WORDS = tuple(row.address for row in REGISTERS if row.words == 2)


def encode(
    snapshot: Snapshot | None,
    *,
    now_s: float,
    sequence: int,
    heartbeat: int,
    stale_after_s: float,
    word_order: WordOrder = "big",
) -> list[int]:
    """The `TOTAL` words of one drive at `now_s`; `snapshot` is None before the first.

    What is not usable, and everything once the data is older than `stale_after_s`, reads NaN.
    """
    age_s = _age_s(snapshot, now_s)
    stale = not age_s <= stale_after_s
    words = bytearray(2 * TOTAL)
    head = {
        "marker": MARKER,
        "map_version": MAP_VERSION,
        "sequence": sequence & 0xFFFF_FFFF,
        "sequence_end": sequence & 0xFFFF_FFFF,
        "heartbeat": heartbeat & 0xFFFF,
        "state": _state(snapshot, stale),
        "data_age_ms": min(round(age_s * 1e3), NEVER_MS) if math.isfinite(age_s) else NEVER_MS,
        "test_float": TEST_FLOAT,
        "data_time_s": int(snapshot.time_s) & 0xFFFF_FFFF if snapshot and math.isfinite(age_s) else 0,
        "block_length": LENGTH,
    }
    for block in range(BLOCKS):
        for name, value in head.items():
            _put(words, named(name, block), value)
        _put(words, named("quantities", block), len(in_block(block)))
        _put_quantities(words, block, snapshot, stale, now_s)
    if word_order == "little":
        _swap(words)
    return list(struct.unpack(f">{TOTAL}H", words))


def _age_s(snapshot: Snapshot | None, now_s: float) -> float:
    if snapshot is None or not math.isfinite(snapshot.time_s):
        return math.inf
    return max(0.0, now_s - snapshot.time_s)


def _state(snapshot: Snapshot | None, stale: bool) -> int:
    """Before the first data a check is running; data that stopped coming is a failure."""
    if snapshot is None or not math.isfinite(snapshot.time_s):
        return max(NE107.FUNCTION_CHECK, snapshot.state if snapshot else NE107.OK)
    return NE107.FAILURE if stale else snapshot.state


def _put_quantities(words: bytearray, block: int, snapshot: Snapshot | None, stale: bool, now_s: float) -> None:
    bits = {"usable": 0, "not_usable": 0, "not_excited": 0}
    for name in in_block(block):
        address = PLACES[name]
        estimate = snapshot.estimates.get(name) if snapshot else None
        code = _code(estimate, stale)
        usable = code <= STATUS_CODES["not_excited"]
        bit = 1 << block_and_bit(address)[1]
        bits["usable" if usable else "not_usable"] |= bit
        bits["not_excited"] |= bit if code == STATUS_CODES["not_excited"] else 0
        value, sd = (estimate.value, estimate.sd) if estimate and usable else (math.nan, math.nan)
        struct.pack_into(">ffHH", words, 2 * address, value, sd, code, _estimate_age_s(estimate, now_s))
    for field, value in bits.items():
        for word in range(3):
            _put(words, f"{named(field, block)}_{word}", value >> 16 * word & 0xFFFF)


def _code(estimate: Estimate | None, stale: bool) -> int:
    if estimate is None:
        return STATUS_CODES["unknown"]
    if stale:
        return STATUS_CODES["stale"]
    if estimate.status is Status.WARMING_UP:
        return STATUS_CODES["warming_up"]
    if not estimate.usable or max(abs(estimate.value), abs(estimate.sd)) > _LARGEST_F32:
        return STATUS_CODES["invalid"]
    return STATUS_CODES[estimate.status.value]


def _estimate_age_s(estimate: Estimate | None, now_s: float) -> int:
    if estimate is None or not math.isfinite(estimate.time_s):
        return _LARGEST_U16
    return int(min(max(0.0, now_s - estimate.time_s), _LARGEST_U16))


_FORMATS: dict[Type, str] = {"u16": ">H", "u32": ">I", "f32": ">f"}


def _put(words: bytearray, name: str, value: float) -> None:
    row = BY_NAME[name]
    struct.pack_into(_FORMATS[row.type], words, 2 * row.address, value)


def _swap(words: bytearray) -> None:
    """Least significant word first, bytes within a word as Modbus orders them."""
    for address in _DOUBLE_WORDS:
        at = 2 * address
        words[at : at + 4] = words[at + 2 : at + 4] + words[at : at + 2]
