"""The configuration file: read, and held against itself and against what it names. Every mistake is one line.

`load` needs the file alone; `examined` also looks at everything the file names (decodings, models, gears), so that
what it lets pass can be started, and a running daemon never gives up a good configuration for a bad one.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from edge_daemon.acquire.drivers import signals_of, validate_source
from edge_daemon.contradictions import contradictions
from edge_daemon.effects.model import Model
from edge_daemon.effects.model_file import read_model
from edge_daemon.errors import BadInput
from edge_daemon.keys import expected, names
from edge_daemon.prognose.gears import Gear, find_gear
from edge_daemon.settings import STALE_AFTER_S, ChannelSettings, Drive, Settings, SettingsError, SourceSettings
from edge_daemon.show.guard import Guard

NEEDED = {"torsion": ("theta_in_rad", "theta_out_rad"), "drive": ()}
"""channels without which a balance says nothing"""

PERIODS = 3.0
"""of a read pass before its channel counts as silent: one may fail and be repeated (guess)"""


def load(path: Path) -> Settings:
    """Settings from a TOML file. Raises `SettingsError` with one line."""
    try:
        document = tomllib.loads(path.read_text("utf-8-sig"))
        settings = msgspec.convert(document, Settings)
    except OSError as error:
        raise SettingsError(f"{path}: cannot read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path}: not a text file: expected TOML in UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{path}: not valid TOML: {error}") from error
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


def examined(path: Path) -> Settings:
    """Settings of which everything that can be known without opening a bus is right. Raises `BadInput`."""
    settings = load(path)
    base = path.parent
    for source in settings.sources:
        _named(path, source, base)
    if settings.dashboard.enabled:
        Guard(settings.dashboard, base)
    problem = next(_unknown_signals(settings, base), None)
    for i, drive in enumerate(settings.drive):
        try:
            model, _ = model_and_gear(drive, base)
        except BadInput as error:
            raise SettingsError(f"{path}: drive[{i}].{error}") from error
        problem = problem or next(_missing_channels(f"drive[{i}]", drive, model), None)
    if problem:
        raise SettingsError(f"{path}: {problem}")
    return settings


def model_and_gear(drive: Drive, base: Path) -> tuple[Model, Gear | None]:
    """What a drive names; files are relative to `base`. Raises `BadInput`, which begins with the key."""
    try:
        model = read_model(base / drive.model)
    except BadInput as error:
        raise SettingsError(f"model: {error}") from error
    if drive.gear is None:
        return model, None
    beside = base / drive.gear
    try:
        return model, find_gear(str(beside) if beside.suffix == ".toml" else drive.gear)
    except BadInput as error:
        raise SettingsError(f"gear: {error}") from error


def _named(path: Path, source: SourceSettings, base: Path) -> None:
    """`validate_source`, its complaint with the configuration's name. Raises `SettingsError`."""
    try:
        validate_source(source, base)
    except BadInput as error:
        raise SettingsError(f"{path}: {error}") from error


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
        close = difflib.get_close_matches(unknown[1], names(), n=1)
        hint = f": did you mean `{close[0]}`?" if close else ""
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
    close = difflib.get_close_matches(str(value), choices, n=1)
    return f": did you mean {close[0]!r}?" if close else ""


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


# the file against what it names


def _unknown_signals(settings: Settings, base: Path) -> Iterator[str]:
    known = {source.name: signals_of(source, base) for source in settings.sources}
    for i, drive in enumerate(settings.drive):
        wanted = [(f"drive[{i}].channels[{j}]", row.source, row.signal) for j, row in enumerate(drive.channels)]
        if drive.sound:
            wanted.append((f"drive[{i}].sound", drive.sound.source, drive.sound.signal))
        for where, source, signal in wanted:
            there = known[source]
            if there is not None and signal not in there:
                close = difflib.get_close_matches(signal, there, n=3, cutoff=0.0)
                such = f"such as {', '.join(close)}" if close else "a decoding there first: `dbc` or `pdo`"
                yield f"{where}.signal: {signal!r} is no signal of {source!r}: expected {such}"


def _missing_channels(path: str, drive: Drive, model: Model) -> Iterator[str]:
    there = {row.channel for row in drive.channels}
    if drive.sound_angle:  # the motor's tone gives what an encoder does not
        there.add("theta_in_rad")
    for channel in NEEDED[model.balance]:
        if channel not in there:
            close = difflib.get_close_matches(channel, there, n=1, cutoff=0.8)
            hint = f": did you mean it by {close[0]!r}?" if close else ""
            yield f"{path}.channels: {channel}: missing: a model of balance {model.balance!r} needs it{hint}"
