"""The Modbus map: one table, and the documents that are generated from it.

Append-only: an address, once given, keeps its meaning for ever, because PLC programs are compiled against it. A new
quantity takes the next free place in `PLACES` and raises `MAP_VERSION`. The block has a fixed length with spare room,
so its end, and the sequence number there, do not move when it fills. Every 32-bit value lies on an even address,
and so does the boundary between the two reads that fetch the whole block (`READS`).
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

MAP_VERSION = 4
MARKER = 0x5357
"""'SW' in ASCII: a reader that finds it reads this map and not some other device"""
TEST_FLOAT = 12345.0
"""Read it as a float first: any other number means that the word order is set wrong."""

LENGTH = 248
READS = ((0, 124), (124, 124))
"""(address, count) of the reads that fetch everything: a Modbus read has at most 125 registers, which is odd"""
FIRST = 28
"""The first quantity stands at this address."""
STRIDE = 6
"""Each quantity takes so many registers."""
_SEQUENCE_END = LENGTH - 2
CAPACITY = (_SEQUENCE_END - FIRST) // STRIDE
"""So many quantities fit into the block."""

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
    yield Register(
        "test_float", 8, "f32", "1", f"constant, always {TEST_FLOAT}: anything else means a wrong word order"
    )
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
- The block has {LENGTH} registers; {" and ".join(f"{count} from {first}" for first, count in READS)} fetch it in two
  reads. Any read inside the block succeeds; registers not listed are reserved and read 0.
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
    lines += ["", "## Quantities and their bits", "", "| number | quantity | bit |", "|---:|---|---|"]
    lines += [f"| {n} | `{name}` | word {n // 16}, bit {n % 16} |" for n, name in enumerate(PLACES)]
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
        "length": LENGTH,
        "reads": [{"address": first, "count": count} for first, count in READS],
        "registers": [asdict(row) for row in REGISTERS],
    }
    return json.dumps(document, indent=2) + "\n"


_TELEGRAF_TYPES = {"u16": ("AB", "UINT16"), "u32": ("ABCD", "UINT32"), "f32": ("ABCD", "FLOAT32")}
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
    return head + "".join(_home_assistant_row(row) for row in REGISTERS)


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
    if row.unit != "1":
        lines.append(f"  unit_of_measurement: {json.dumps(row.unit)}")
    return "".join(f"      {line}\n" for line in lines)


FORMATS: dict[str, Callable[[], str]] = {
    "md": _markdown,
    "csv": _csv,
    "json": _json,
    "telegraf": _telegraf,
    "homeassistant": _home_assistant,
}
