"""The Modbus map: one table, and how a drive's state becomes its words.

Append-only: an address, once given, keeps its meaning for ever, because PLC programs are compiled against it. A new
quantity takes the next free place in `PLACES` and raises `MAP_VERSION`. The block has a fixed length with spare room,
so its end, and the sequence number there, do not move when it fills. Every 32-bit value lies on an even address,
and so does the boundary between the two reads that fetch the whole block (`READS`).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from edge_daemon.quantities import QUANTITIES, Quantity
from edge_daemon.records import NE107, Estimate, Snapshot, Status

Type = Literal["u16", "u32", "f32"]
WordOrder = Literal["big", "little"]

MAP_VERSION = 1
MARKER = 0x5357
"""'SW' in ASCII: a reader that finds it reads this map and not some other device"""
TEST_FLOAT = 12345.0
"""read it as a float first: any other number means that the word order is set wrong"""

LENGTH = 248
READS = ((0, 124), (124, 124))
"""(address, count) of the reads that fetch everything: a Modbus read has at most 125 registers, which is odd"""
_FIRST = 28
_STRIDE = 6
_SEQUENCE_END = LENGTH - 2
CAPACITY = (_SEQUENCE_END - _FIRST) // _STRIDE
"""quantities that fit"""

NEVER_MS = 0xFFFF_FFFF
"""data age before the first data, and the largest that fits (49 days)"""
_LARGEST_U16 = 0xFFFF
_LARGEST_F32 = 3.4028234e38
"""IEEE 754 binary32; a number beyond it cannot be told to a PLC and reads as invalid"""

PLACES: dict[str, int] = {
    "health_index": 28,
    "damage": 34,
    "rul_p10_h": 40,
    "rul_p50_h": 46,
    "rul_p90_h": 52,
    "stiffness": 58,
    "damping": 64,
    "coulomb_friction": 70,
    "kinematic_error": 76,
    "stiffness_change": 82,
    "noise_a0": 88,
    "noise_a1": 94,
    "noise_a2": 100,
    "noise_a3": 106,
    "noise_a4": 112,
    "noise_rms": 118,
    "ratio": 124,
    "ratcheting_events": 130,
    "torque_rms": 136,
    "torque_peak": 142,
    "torque_cubic_mean": 148,
    "speed_in": 154,
    "temperature": 160,
    "pressure": 166,
    "model_nrmse": 172,
    "model_noise_floor": 178,
    "model_rmse": 184,
}
"""First address of each quantity: value (f32), sd (f32), status (u16), age (u16). Append only."""

STATUS_CODES = {
    "valid": 0,
    "not_excited": 1,
    "warming_up": 2,
    "invalid": 3,
    "unknown": 4,
    "stale": 5,
}
"""0 and 1 come with a number; with all others value and sd read NaN"""

STATUS_MEANING = "0 valid, 1 valid but the motion does not excite it now, 2 warming up, 3 invalid, 4 unknown, 5 stale"
STATE_MEANING = (
    "NAMUR NE 107: 0 ok, 1 maintenance required, 2 out of specification, 3 function check, 4 failure (also: data stale)"
)


@dataclass(frozen=True, slots=True)
class Register:
    """One value of the map; `address` counts from 0, as it goes over the wire."""

    name: str
    address: int
    type: Type
    unit: str
    meaning: str

    @property
    def words(self) -> int:
        """Registers that it takes: 1 or 2."""
        return 1 if self.type == "u16" else 2


def _bits(name: str, address: int, meaning: str) -> Iterator[Register]:
    """Three words, a bit per quantity; quantity n (by address) is bit n % 16 of word n // 16."""
    for word in range(3):
        first = 16 * word
        text = f"bit b: quantity {first} + b of the list below {meaning}"
        yield Register(f"{name}_{word}", address + word, "u16", "1", text)


def _header() -> Iterator[Register]:
    yield Register("marker", 0, "u16", "1", f"always {MARKER} (0x{MARKER:04X}): this is the map")
    yield Register("map_version", 1, "u16", "1", "grows when registers are appended; old addresses keep their meaning")
    yield Register("sequence", 2, "u32", "1", "counts changes of this block; not equal to sequence_end: read again")
    yield Register("heartbeat", 4, "u16", "1", "moves while the gateway works, at least once a second")
    yield Register("state", 5, "u16", "1", STATE_MEANING)
    yield Register("data_age_ms", 6, "u32", "ms", f"age of the newest data; {NEVER_MS} = none yet")
    yield Register("test_float", 8, "f32", "1", f"always {TEST_FLOAT}: anything else means a wrong word order")
    yield Register("data_time_s", 10, "u32", "s", "instant of the newest data, seconds since 1970-01-01 UTC; 0 = none")
    yield from _bits("usable", 12, "has a number")
    yield Register("block_length", 15, "u16", "1", f"registers of this block: {LENGTH}")
    yield from _bits("not_usable", 16, "reads NaN: warming up, invalid, unknown or stale")
    yield Register("quantities", 19, "u16", "1", "how many quantities this version lists")
    yield from _bits("not_excited", 20, "keeps its last learned number because the motion does not excite it now")


def _of_quantity(row: Quantity, address: int) -> Iterator[Register]:
    yield Register(row.name, address, "f32", row.unit, row.meaning)
    yield Register(f"{row.name}_sd", address + 2, "f32", row.unit, f"standard deviation of {row.name}")
    yield Register(f"{row.name}_status", address + 4, "u16", "1", STATUS_MEANING)
    yield Register(f"{row.name}_age_s", address + 5, "u16", "s", f"since {row.name} was last estimated; 65535 = never")


def _table() -> Iterator[Register]:
    yield from _header()
    for name, address in PLACES.items():
        yield from _of_quantity(QUANTITIES[name], address)
    yield Register("sequence_end", _SEQUENCE_END, "u32", "1", "equal to sequence, or the block was torn: read again")


REGISTERS: tuple[Register, ...] = tuple(_table())
"""the whole map, by address; addresses in between are reserved and read 0"""

BY_NAME = {row.name: row for row in REGISTERS}
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
    """The `LENGTH` words of one drive at `now_s`; `snapshot` is None before the first.

    What is not usable, and everything once the data is older than `stale_after_s`, reads NaN.
    """
    age_s = _age_s(snapshot, now_s)
    stale = not age_s <= stale_after_s
    words = bytearray(2 * LENGTH)
    _put(words, "marker", MARKER)
    _put(words, "map_version", MAP_VERSION)
    _put(words, "sequence", sequence & 0xFFFF_FFFF)
    _put(words, "sequence_end", sequence & 0xFFFF_FFFF)
    _put(words, "heartbeat", heartbeat & 0xFFFF)
    _put(words, "state", _state(snapshot, stale))
    _put(words, "data_age_ms", min(int(age_s * 1e3), NEVER_MS) if math.isfinite(age_s) else NEVER_MS)
    _put(words, "test_float", TEST_FLOAT)
    _put(words, "data_time_s", int(snapshot.time_s) & 0xFFFF_FFFF if snapshot and math.isfinite(age_s) else 0)
    _put(words, "block_length", LENGTH)
    _put(words, "quantities", len(PLACES))
    _put_quantities(words, snapshot, stale, now_s)
    if word_order == "little":
        _swap(words)
    return list(struct.unpack(f">{LENGTH}H", words))


def _age_s(snapshot: Snapshot | None, now_s: float) -> float:
    if snapshot is None or not math.isfinite(snapshot.time_s):
        return math.inf
    return max(0.0, now_s - snapshot.time_s)


def _state(snapshot: Snapshot | None, stale: bool) -> int:
    """Before the first data a check is running; data that stopped coming is a failure."""
    if snapshot is None or not math.isfinite(snapshot.time_s):
        return max(NE107.FUNCTION_CHECK, snapshot.state if snapshot else NE107.OK)
    return NE107.FAILURE if stale else snapshot.state


def _put_quantities(words: bytearray, snapshot: Snapshot | None, stale: bool, now_s: float) -> None:
    bits = {"usable": 0, "not_usable": 0, "not_excited": 0}
    for name, address in PLACES.items():
        estimate = snapshot.estimates.get(name) if snapshot else None
        code = _code(estimate, stale)
        usable = code <= STATUS_CODES["not_excited"]
        bit = 1 << (address - _FIRST) // _STRIDE
        bits["usable" if usable else "not_usable"] |= bit
        bits["not_excited"] |= bit if code == STATUS_CODES["not_excited"] else 0
        value, sd = (estimate.value, estimate.sd) if estimate and usable else (math.nan, math.nan)
        struct.pack_into(">ffHH", words, 2 * address, value, sd, code, _estimate_age_s(estimate, now_s))
    for field, value in bits.items():
        for word in range(3):
            _put(words, f"{field}_{word}", value >> 16 * word & 0xFFFF)


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
