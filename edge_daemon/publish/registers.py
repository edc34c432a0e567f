"""The Modbus map: one table, and the documents that are generated from it.

Append-only: an address, once given, keeps its meaning for ever, because PLC programs are compiled against it. A new
quantity takes the next free place in `PLACES` and raises `MAP_VERSION`. Blocks of one shape follow one another, each
with a head, spare room and an end of its own, so nothing moves when one fills, and a program written for one reads
the next one too. Every 32-bit value lies on an even address, and so does the boundary between the two reads that
fetch a whole block (`READS`).
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Literal

from edge_daemon.quantities import QUANTITIES, Quantity

Type = Literal["u16", "u32", "f32"]

MAP_VERSION = 5
MARKER = 0x5357
"""'SW' in ASCII: a reader that finds it reads this map and not some other device"""
TEST_FLOAT = 12345.0
"""Read it as a float first: any other number means that the word order is set wrong."""

LENGTH = 248
"""A block has so many registers."""
BLOCKS = 2
"""The map has so many blocks; when the last one fills, the next begins where it ends."""
TOTAL = BLOCKS * LENGTH
"""The whole map has so many registers."""
READS = tuple((first, LENGTH // 2) for first in range(0, TOTAL, LENGTH // 2))
"""(address, count) of the reads that fetch everything: a Modbus read has at most 125 registers, which is odd"""
FIRST = 28
"""The first quantity of a block stands so far from its beginning."""
STRIDE = 6
"""Each quantity takes so many registers."""
_SEQUENCE_END = LENGTH - 2
CAPACITY = (_SEQUENCE_END - FIRST) // STRIDE
"""So many quantities fit into a block."""

NEVER_MS = 0xFFFF_FFFF
"""Data age before the first data, and the largest that fits (49 days)."""

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
    "encoder_skew": 190,
    "sound_angle_sd": 196,
    "sound_angle_slips": 202,
    "stribeck_speed": 208,
    "hysteresis_width": 214,
    "hysteresis_state": 220,
    "half_gap": 226,
    "hysteresis_area": 232,
    "temperature_rise": 238,
    "temperature_ambient": 276,
    "energy_lost_per_cycle": 282,
    "efficiency": 288,
    "operating_hours": 294,
    "turns_in": 300,
    "turns_out": 306,
    "load_cycles": 312,
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


def named(name: str, block: int) -> str:
    """What the head's register of this name is called in a block: under its own name in the first."""
    return name if block == 0 else f"{name}_block{block + 1}"


def block_and_bit(address: int) -> tuple[int, int]:
    """The block in which the quantity at this address is, and its number there, which is its bit."""
    return address // LENGTH, (address % LENGTH - FIRST) // STRIDE


def in_block(block: int) -> tuple[str, ...]:
    """The quantities of a block, in order."""
    return tuple(name for name, address in PLACES.items() if address // LENGTH == block)


def _bits(name: str, block: int, place: int, meaning: str) -> Iterator[Register]:
    """Three words, a bit per quantity; quantity n of the block (by address) is bit n % 16 of word n // 16."""
    for word in range(3):
        first = 16 * word
        text = f"bit b: quantity {first} + b of the list below {meaning}"
        yield Register(f"{named(name, block)}_{word}", block * LENGTH + place + word, "u16", "1", text)


def _head(block: int) -> Iterator[Register]:
    """Every block begins with the same rows, so that it is known for what it is and seen to be torn."""

    def row(name: str, place: int, type: Type, unit: str, meaning: str) -> Register:
        return Register(named(name, block), block * LENGTH + place, type, unit, meaning)

    yield row("marker", 0, "u16", "1", f"always {MARKER} (0x{MARKER:04X}): this is the map")
    yield row("map_version", 1, "u16", "1", "grows when registers are appended; old addresses keep their meaning")
    yield row("sequence", 2, "u32", "1", "counts changes of this block; not equal to sequence_end: read again")
    yield row("heartbeat", 4, "u16", "1", "moves while the gateway works, at least once a second")
    yield row("state", 5, "u16", "1", STATE_MEANING)
    yield row("data_age_ms", 6, "u32", "ms", f"age of the newest data; {NEVER_MS} = none yet")
    yield row("test_float", 8, "f32", "1", f"constant, always {TEST_FLOAT}: anything else means a wrong word order")
    yield row("data_time_s", 10, "u32", "s", "instant of the newest data, seconds since 1970-01-01 UTC; 0 = none")
    yield from _bits("usable", block, 12, "has a number")
    yield row("block_length", 15, "u16", "1", f"registers of this block: {LENGTH}")
    yield from _bits("not_usable", block, 16, "reads NaN: warming up, invalid, unknown or stale")
    held = "keeps its last learned number because the motion does not excite it now"
    yield row("quantities", 19, "u16", "1", "how many quantities this version lists")
    yield from _bits("not_excited", block, 20, held)


def _of_quantity(row: Quantity, address: int) -> Iterator[Register]:
    yield Register(row.name, address, "f32", row.unit, row.meaning)
    yield Register(f"{row.name}_sd", address + 2, "f32", row.unit, f"standard deviation of {row.name}")
    yield Register(f"{row.name}_status", address + 4, "u16", "1", STATUS_MEANING)
    yield Register(f"{row.name}_age_s", address + 5, "u16", "s", f"since {row.name} was last estimated; 65535 = never")


def _block(block: int) -> Iterator[Register]:
    yield from _head(block)
    for name in in_block(block):
        yield from _of_quantity(QUANTITIES[name], PLACES[name])
    end, text = named("sequence_end", block), "equal to sequence, or the block was torn: read again"
    yield Register(end, block * LENGTH + _SEQUENCE_END, "u32", "1", text)


REGISTERS: tuple[Register, ...] = tuple(row for block in range(BLOCKS) for row in _block(block))
"""The whole map by address; addresses in between are reserved and read 0."""

BY_NAME = {row.name: row for row in REGISTERS}

COLUMNS = ("name", "address", "type", "unit", "meaning")

_HOST = "127.0.0.1"
_PORT = 5020
_DEVICE_ID = 1
_POLL_S = 1
"""A reader polls so often in the generated configurations; a gear does not change faster."""

_DECIMALS = {"N m/rad": 1, "h": 1, "degC": 2, "Pa": 0, "N m": 4, "rad/s": 3}
"""Home Assistant rounds to so many digits after the point, by unit."""
_MOST_DECIMALS = 12
"""All other units keep so many digits: a noise coefficient of 1e-8 or a skew of a microsecond would read 0."""

_INTRODUCTION = f"""# Modbus registers

Generated by `edge-daemon registers`; do not edit. Map version {MAP_VERSION}.

- One device id per drive. Input registers (function 04); the same block, read-only, as holding registers (function 03).
- Addresses count from 0, as on the wire. A tool that counts from 1 adds one (30001 or 40001 is address 0).
- 32-bit values are big-endian, most significant word first, unless the gateway's `word_order` is `little`;
  `test_float` tells: it must read 12345.0.
- The map has {BLOCKS} blocks of {LENGTH} registers and one shape: what stands at an address of the first has its like
  {LENGTH} further on in the second, under the same name with `_block2`. A program needs the second only for what is
  new there. Reads of {READS[0][1]} from {", ".join(str(first) for first, _ in READS)} fetch everything.
  Any read inside the map succeeds; registers not listed are reserved and read 0.
- `sequence` and `sequence_end` differ only if the block changed between two reads: then read again.
- A number that is warming up, invalid, unknown or stale reads NaN, and its status says why; never the last good number.
- The map is append-only: an address keeps its meaning for ever.
"""


def render(format: str) -> str:
    """The map as `md`, `csv`, `json`, `telegraf` or `homeassistant`, with a final newline.

    Raises ValueError for another format.
    """
    if format not in FORMATS:
        raise ValueError(f"format: {format!r}: expected one of {', '.join(FORMATS)}")
    return FORMATS[format]()


def _markdown() -> str:
    lines = [_INTRODUCTION, f"| {' | '.join(COLUMNS)} |", "|---|---:|---|---|---|"]
    lines += [f"| `{row.name}` | {row.address} | {row.type} | {row.unit} | {row.meaning} |" for row in REGISTERS]
    lines += ["", "## Quantities and their bits", "", "| block | number | quantity | bit |", "|---:|---:|---|---|"]
    for name, address in PLACES.items():
        block, n = block_and_bit(address)
        lines.append(f"| {block + 1} | {n} | `{name}` | word {n // 16}, bit {n % 16} |")
    return "\n".join(lines) + "\n"


def _csv() -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([getattr(row, column) for column in COLUMNS] for row in REGISTERS)
    return out.getvalue()


def _json() -> str:
    document = {
        "map_version": MAP_VERSION,
        "length": TOTAL,
        "reads": [{"address": first, "count": count} for first, count in READS],
        "registers": [asdict(row) for row in REGISTERS],
    }
    return json.dumps(document, indent=2) + "\n"


_TELEGRAF_TYPES = {"u16": ("AB", "UINT16"), "u32": ("ABCD", "UINT32"), "f32": ("ABCD", "FLOAT32")}
STATES = ("state", "data_age_ms", "heartbeat")
"""Registers beside the quantities that a home's screen can use."""
GROWING = ("operating_hours", "turns_in", "turns_out", "load_cycles")
"""Quantities that only grow, so that a recorder adds them up."""
_HOME_ASSISTANT_UNITS = {
    "degC": ("°C", "temperature"),
    "K": ("K", "temperature"),
    "Pa": ("Pa", "pressure"),
    "h": ("h", "duration"),
    "s": ("s", "duration"),
    "ms": ("ms", "duration"),
    "J": ("J", "energy"),
}
"""Home Assistant's own word for a unit, and the device class that goes with it."""
_HOME_ASSISTANT_TYPES = {"u16": "uint16", "u32": "uint32", "f32": "float32"}


def _telegraf() -> str:
    head = f"""\
# Telegraf: one [[inputs.modbus]] per drive; set controller and slave_id.
# Telegraf before 1.28 calls the type FLOAT32-IEEE. With word_order = "little" write CDAB for ABCD.
[[inputs.modbus]]
  name = "strainwave"
  slave_id = {_DEVICE_ID}
  timeout = "1s"
  controller = "tcp://{_HOST}:{_PORT}"
  configuration_type = "register"
  input_registers = [
"""
    return head + "".join(_telegraf_row(row) for row in REGISTERS) + "  ]\n"


def _telegraf_row(row: Register) -> str:
    order, kind = _TELEGRAF_TYPES[row.type]
    words = list(range(row.address, row.address + row.words))
    fields = f'name = "{row.name}", byte_order = "{order}", data_type = "{kind}", scale = 1.0, address = {words}'
    return f"    {{ {fields} }},\n"


def _home_assistant() -> str:
    head = f"""\
# Home Assistant: merge into configuration.yaml; one hub per gateway, one list of sensors per drive (slave).
# With word_order = "little" add `swap: word` to every 32-bit sensor.
modbus:
  - name: strainwave
    type: tcp
    host: {_HOST}
    port: {_PORT}
    sensors:
"""
    return head + "".join(_home_assistant_row(row) for row in REGISTERS if row.name in QUANTITIES or row.name in STATES)


def _home_assistant_row(row: Register) -> str:
    lines = [
        f"- name: {json.dumps(row.name)}",
        f"  unique_id: {json.dumps(f'strainwave_{_DEVICE_ID}_{row.name}')}",
        f"  slave: {_DEVICE_ID}",
        f"  address: {row.address}",
        "  input_type: input",
        f"  data_type: {_HOME_ASSISTANT_TYPES[row.type]}",
        f"  scan_interval: {_POLL_S}",
    ]
    if row.type == "f32":
        lines.append(f"  precision: {_DECIMALS.get(row.unit, _MOST_DECIMALS)}")
    unit, kind = _HOME_ASSISTANT_UNITS.get(row.unit, (row.unit, ""))
    if row.unit != "1":
        lines.append(f"  unit_of_measurement: {json.dumps(unit, ensure_ascii=False)}")
    if kind:
        lines.append(f"  device_class: {kind}")
    if row.type == "f32":
        lines.append(f"  state_class: {'total_increasing' if row.name in GROWING else 'measurement'}")
    return "".join(f"      {line}\n" for line in lines)


FORMATS: dict[str, Callable[[], str]] = {
    "md": _markdown,
    "csv": _csv,
    "json": _json,
    "telegraf": _telegraf,
    "homeassistant": _home_assistant,
}
