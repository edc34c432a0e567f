"""The configuration file, read and held against itself. Every mistake is one line."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from edge_daemon.config.contradictions import contradictions
from edge_daemon.config.keys import expected, names
from edge_daemon.config.settings import STALE_AFTER_S, ChannelSettings, Settings, SettingsError
from edge_daemon.text import closest, read_toml

PERIODS = 3.0
"""A channel counts as silent after so many periods of its read: one may fail and be repeated (guess)."""


def load(path: Path) -> Settings:
    """Settings from a TOML file. Raises `SettingsError` with one line."""
    document = read_toml(path, SettingsError)
    try:
        settings = msgspec.convert(document, Settings)
    except msgspec.ValidationError as error:
        raise SettingsError(f"{path}: {_where(str(error), document)}") from error
    problem = next(_endless("", document), None) or next(contradictions(settings), None)
    if problem:
        raise SettingsError(f"{path}: {problem}")
    return patient(settings)


def patient(settings: Settings) -> Settings:
    """The settings with each channel that is read slowly waited for: a chip that is asked once a second is not silent
    in between."""
    drives = []
    for drive in settings.drive:
        rows = []
        for row in drive.channels:
            every_s = read_every_s(settings, row)
            if row.stale_after_s is None and every_s is not None:
                row = msgspec.structs.replace(row, stale_after_s=max(STALE_AFTER_S, PERIODS * every_s))
            rows.append(row)
        drives.append(msgspec.structs.replace(drive, channels=tuple(rows)))
    return msgspec.structs.replace(settings, drive=tuple(drives))


def read_every_s(settings: Settings, row: ChannelSettings) -> float | None:
    """How often a channel is read; None of what comes by itself."""
    for bus in settings.i2c:
        for device in bus.devices:
            if row.source == bus.name and row.signal.startswith(f"{device.name}."):
                return device.period_s
    for sensor in settings.modbus:
        for read in sensor.reads:
            if row.source == sensor.name and row.signal == read.signal:
                return read.period_s
    return None


def _where(message: str, document: Mapping[str, Any]) -> str:
    """msgspec's `what - at `$.path`` as `path: what stands there: what was expected`."""
    found = re.fullmatch(r"(.*?)(?: - at `\$\.?(.*)`)?", message, re.DOTALL)
    what, where = found.groups() if found else (message, None)
    where = where or ""
    absent = re.search(r"missing required field `(.*)`", what)
    if absent:
        key = f"{where}.{absent[1]}" if where else absent[1]
        return f"{key}: missing: expected {expected(key)}"
    unknown = re.search(r"unknown field `(.*)`", what)
    if unknown:
        close = closest(unknown[1], names())
        hint = f": did you mean `{close}`?" if close else ""
        return f"{where or 'top level'}: unknown key `{unknown[1]}`{hint}"
    takes, value = expected(where), _at(document, where)
    if takes.startswith("tables") and isinstance(value, Mapping):
        return f"{where}: a single table: expected {takes.removeprefix('tables ')}"
    if takes:
        return f"{where}: {_shown(value)}: expected {takes}{_close(value, takes)}"
    return f"{where or 'top level'}: {what[0].lower()}{what[1:]}"


def _at(document: Any, where: str) -> Any:
    """What the file has at `drive[0].channels[1].scale`; None if that cannot be followed."""
    try:
        for key, number in re.findall(r"([^.\[\]]+)|\[(\d+)\]", where):
            document = document[int(number)] if number else document[key]
    except (KeyError, IndexError, TypeError):
        return None
    return document


def _shown(value: Any) -> str:
    return "a table" if isinstance(value, Mapping) else repr(value)[:60]


def _close(value: Any, takes: str) -> str:
    choices = takes.removeprefix("one of ").split(", ") if takes.startswith("one of ") else []
    close = closest(str(value), choices)
    return f": did you mean {close!r}?" if close else ""


def _endless(path: str, value: Any) -> Iterator[str]:
    """TOML knows nan and inf; no setting means anything with them."""
    if isinstance(value, float) and not math.isfinite(value):
        yield f"{path}: {value}: expected a finite number"
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _endless(f"{path}.{key}" if path else key, item)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from _endless(f"{path}[{i}]", item)
