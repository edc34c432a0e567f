"""CAN frames to numbers: the layout of each message, compiled once, applied to many frames at a time.

The layouts come from a DBC file (read by cantools) or from CANopen process data objects. All frames of one message
that arrived since the last look are decoded together by numpy, so that the cost per frame is a fraction of a
microsecond where a decoder per frame takes several.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edge_daemon.acquire.canopen_objects import EXTENDED, OBJECTS
from edge_daemon.config.settings import CanSource, FileSource, Pdo, SettingsError
from edge_daemon.records import Array

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

Bytes = NDArray[np.uint8]
WINDOW = 8
"""One 64-bit word holds this many bytes."""

MOST_DIGITS = 5
"""Of a size in a database: the longest message that there is has 1785 bytes (SAE J1939-21, transport)."""
SIZES = {
    "length in bytes": rb"^\s*BO_\s+\d+\s+\w+\s*:\s*(\d+)",
    "place and length in bits": rb"^\s*SG_\s[^:\n]*:\s*(-?\d+)\s*\|\s*(\d+)",
    "range of a multiplexer": rb"^\s*SG_MUL_VAL_\s[^;]*-\s*(\d{6,})",
}
"""Where a database says how long something is."""


@dataclass(frozen=True, slots=True)
class Field:
    """One signal in a message: value = raw * scale + offset."""

    name: str
    """as it appears in `Readings.signal`"""
    start: int
    """bit number of the least significant bit; from the first byte's lowest bit up if little-endian, from the last
    byte's lowest bit up if big-endian"""
    bits: int
    big_endian: bool = False
    signed: bool = False
    is_float: bool = False
    scale: float = 1.0
    offset: float = 0.0
    selector: int | None = None
    """position, among the fields, of the multiplexer that switches this one"""
    selected_by: tuple[int, ...] = ()
    """raw multiplexer values for which this field is present"""

    def bytes_of(self, length: int) -> tuple[int, int]:
        """First byte, and one past the last, in a message of `length` bytes."""
        low, high = self.start // 8, (self.start + self.bits - 1) // 8 + 1
        return (length - high, length - low) if self.big_endian else (low, high)

    @property
    def dtype(self) -> str | None:
        """numpy's name if the field is whole bytes that numpy knows, else None."""
        if self.start % 8 or self.bits not in (8, 16, 32, 64):
            return None
        kind = "f" if self.is_float else "i" if self.signed else "u"
        return f"{'>' if self.big_endian else '<'}{kind}{self.bits // 8}" if (kind, self.bits) != ("f", 8) else None

    def raw(self, data: Bytes) -> NDArray[np.generic]:
        """(n,) raw values from (n, length) bytes; for fields at odd bits."""
        first, end = self.bytes_of(data.shape[1])
        word = np.zeros((len(data), WINDOW), dtype=np.uint8)
        size = min(end - first, WINDOW)
        shift = np.uint64(self.start % 8)
        if self.big_endian:
            word[:, WINDOW - size :] = data[:, end - size : end]
            number, beyond = word.view(">u8")[:, 0].astype(np.uint64), data[:, first]
        else:
            word[:, :size] = data[:, first : first + size]
            number, beyond = word.view("<u8")[:, 0].astype(np.uint64), data[:, end - 1]
        number >>= shift
        if end - first > WINDOW:  # the ninth byte of a long signal that starts inside a byte
            number |= beyond.astype(np.uint64) << (np.uint64(64) - shift)
        spare = 64 - self.bits
        number <<= np.uint64(spare)
        if self.signed and not self.is_float:
            return number.view(np.int64) >> np.int64(spare)
        number >>= np.uint64(spare)
        return number.astype(f"u{self.bits // 8}").view(f"f{self.bits // 8}") if self.is_float else number


Decoded = tuple[Field, Array, NDArray[np.bool_] | None]
"""A field, its value in each of n frames, and which frames carry it (None: all)."""


class Layout:
    """How the bytes of one message are read."""

    def __init__(self, key: int, name: str, length: int, fields: tuple[Field, ...]) -> None:
        """`key` is the identifier, with `EXTENDED` for 29 bits; `length` in bytes."""
        self.key = key
        self.name = name
        self.length = length
        self.fields = fields
        aligned = [field for field in fields if field.dtype]
        self._aligned = {field.name for field in aligned}
        self._record = np.dtype(
            {
                "names": [field.name for field in aligned],
                "formats": [field.dtype for field in aligned],
                "offsets": [field.bytes_of(length)[0] for field in aligned],
                "itemsize": length,
            }
        )

    def decode(self, data: bytes) -> Iterator[Decoded]:
        """Each field with (n,) values and a mask of the frames that carry it (None = all).

        `data` holds n frames of `length` bytes, one after the other.
        """
        matrix = np.frombuffer(data, dtype=np.uint8).reshape(-1, self.length)
        records = np.frombuffer(data, dtype=self._record)
        raws: list[NDArray[np.generic]] = []
        masks: list[NDArray[np.bool_] | None] = []
        for field in self.fields:
            raw = records[field.name] if field.name in self._aligned else field.raw(matrix)
            mask = None
            if field.selector is not None:
                mask = np.isin(raws[field.selector], field.selected_by)
                outer = masks[field.selector]
                mask = mask if outer is None else mask & outer
            raws.append(raw)
            masks.append(mask)
            values = _floats(raw) if field.is_float else raw.astype(np.float64)
            if field.scale != 1.0 or field.offset != 0.0:
                values = values * field.scale + field.offset
            yield field, values, mask


def _floats(raw: NDArray[np.generic]) -> Array:
    with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN
        return raw.astype(np.float64)


def dbc_layouts(path: Path) -> list[Layout]:
    """The layouts of a DBC file's messages. Signals are named `Message.Signal`. Raises `SettingsError`."""
    import cantools.database
    from cantools.database.errors import Error

    try:
        if endless := next(_endless(path.read_bytes()), None):
            raise SettingsError(f"dbc: {path}: {endless}")
        database = cantools.database.load_file(path)
    except OSError as error:
        raise SettingsError(f"dbc: {path}: cannot read: {error.strerror}") from error
    except (Error, UnicodeDecodeError, ValueError) as error:
        reason = (str(error).splitlines() or [""])[0]
        raise SettingsError(f"dbc: {path}: not a database of CAN messages: {reason}") from error
    if not isinstance(database, cantools.database.Database):
        raise SettingsError(f"dbc: {path}: a diagnostics file: expected a database of CAN messages")
    try:
        return [_dbc_layout(message) for message in database.messages if message.length]
    except SettingsError as error:
        raise SettingsError(f"dbc: {path}: {error}") from error


def _endless(text: bytes) -> Iterator[str]:
    """Sizes for which the reader of databases would take all memory: they are laid out before they are held against
    each other."""
    for kind, pattern in SIZES.items():
        for found in re.finditer(pattern, text, re.MULTILINE):
            if any(len(number) > MOST_DIGITS for number in found.groups()):
                shown = found[0].decode("latin-1").strip()[:60]
                yield f"{shown}: expected a {kind} of no more than {MOST_DIGITS} digits"


def _dbc_layout(message: Message) -> Layout:
    """Multiplexers first, outer before inner, so that a field's selector is known when it is decoded."""
    usable = [signal for signal in message.signals if signal.length <= 64]
    ordered: list[Signal] = [signal for signal in usable if signal.multiplexer_signal is None]
    inner = [signal for signal in usable if signal.multiplexer_signal is not None]
    while inner:
        known = {signal.name for signal in ordered}
        ready = [signal for signal in inner if signal.multiplexer_signal in known]
        if not ready:
            break
        ordered += ready
        inner = [signal for signal in inner if signal not in ready]
    position = {signal.name: i for i, signal in enumerate(ordered)}
    fields = tuple(_dbc_field(message, signal, position) for signal in ordered)
    key = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    return Layout(key, message.name, message.length, fields)


def _dbc_field(message: Message, signal: Signal, position: dict[str, int]) -> Field:
    big_endian = signal.byte_order == "big_endian"
    start = signal.start
    if big_endian:  # the file names the most significant bit, numbered within its byte
        from_front = 8 * (signal.start // 8) + 7 - signal.start % 8
        start = 8 * message.length - from_front - signal.length
    selector, name = signal.multiplexer_signal, f"{message.name}.{signal.name}"
    if not 0 <= start <= 8 * message.length - signal.length:
        raise SettingsError(f"{name}: bit {start}: expected {signal.length} bits within {message.length} bytes")
    return Field(
        name=name,
        start=start,
        bits=signal.length,
        big_endian=big_endian,
        signed=signal.is_signed,
        is_float=signal.is_float,
        scale=_number(signal.scale, f"{name}: scale"),
        offset=_number(signal.offset, f"{name}: offset"),
        selector=None if selector is None else position[selector],
        selected_by=tuple(signal.multiplexer_ids or ()),
    )


def _number(value: float, where: str) -> float:
    """A factor of a database; cantools reads whole ones of any length."""
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise SettingsError(f"{where}: larger than any number that can be reckoned with: expected a finite one")
    return number


def pdo_layouts(pdos: Iterable[Pdo]) -> list[Layout]:
    """The layouts of CANopen process data objects. Signals are named `node:object`. Raises `SettingsError`."""
    return [_pdo_layout(f"pdo[{i}]", pdo) for i, pdo in enumerate(pdos)]


def _pdo_layout(where: str, pdo: Pdo) -> Layout:
    fields: list[Field] = []
    start = 0
    for name in pdo.objects:
        row = OBJECTS.get(name)
        if row is None:
            raise SettingsError(f"{where}.objects: {name!r} is not in the table: expected one of {sorted(OBJECTS)}")
        if not name.startswith("padding"):
            fields.append(Field(f"{pdo.node}:{name}", start, row.bits, signed=row.signed))
        start += row.bits
    if start > 64:
        raise SettingsError(f"{where}.objects: {start} bits: expected at most 64 in one frame")
    if len({field.name for field in fields}) < max(len(fields), 1):
        raise SettingsError(f"{where}.objects: {list(pdo.objects)}: expected one or more different objects")
    return Layout(pdo.cob_id, f"{pdo.node}:0x{pdo.cob_id:03X}", start // 8, tuple(fields))


def by_key(layouts: Iterable[Layout]) -> dict[int, Layout]:
    """Layouts by identifier. Raises `SettingsError` if two claim the same."""
    table: dict[int, Layout] = {}
    for layout in layouts:
        other = table.setdefault(layout.key, layout)
        if other is not layout:
            identifier = layout.key & ~EXTENDED
            raise SettingsError(
                f"identifier 0x{identifier:X} is claimed by {other.name} and {layout.name}: expected one of them"
            )
    return table


def layouts_of(settings: CanSource | FileSource, base: Path) -> dict[int, Layout]:
    """All layouts of a source by identifier; the DBC file is relative to `base`. Raises `SettingsError`."""
    return by_key([*(dbc_layouts(base / settings.dbc) if settings.dbc else []), *pdo_layouts(settings.pdo)])
