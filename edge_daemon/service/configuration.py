"""The configuration held against everything it names: decodings, models, gears. Every mistake is one line.

What `examined` lets pass can be started, so that a running daemon never gives up a good configuration for a bad one.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from edge_daemon.acquire.can_decode import Field, layouts_of
from edge_daemon.acquire.canopen_objects import OBJECTS
from edge_daemon.acquire.drivers import signals_of, validate_source
from edge_daemon.acquire.i2c_presets import PRESETS
from edge_daemon.channels import CHANNELS
from edge_daemon.config.reading import load
from edge_daemon.config.settings import ChannelSettings, Drive, Settings, SettingsError, SourceSettings, zenoh_files
from edge_daemon.effects.model import Model
from edge_daemon.effects.model_file import read_model
from edge_daemon.errors import BadInput
from edge_daemon.service.priors import key_of, prior_of
from edge_daemon.show.guard import Guard
from edge_daemon.text import closest, near
from edge_daemon.usage.gears import Gear, find_gear

NEEDED = {"torsion": ("theta_in_rad", "theta_out_rad"), "drive": ()}
"""Without these channels a balance says nothing."""


def examined(path: Path, simulated: bool = False) -> Settings:
    """Settings of which everything that can be known without opening a bus is right; `simulated`: buses that begin with
    `sim:` are there. Raises `BadInput`."""
    settings = load(path)
    base = path.parent
    for source in settings.sources:
        _named(path, source, base, simulated)
    for key, file in zenoh_files(settings.zenoh).items():
        if not readable(base / file):
            raise SettingsError(f"{path}: zenoh.{key}: {base / file}: cannot read: expected a file")
    try:
        key_of(settings.zenoh, base)
    except BadInput as error:
        raise SettingsError(f"{path}: zenoh.prior_key_file: {error}") from error
    if settings.dashboard.enabled:
        Guard(settings.dashboard, base)
    problem = next(_unknown_signals(settings, base), None) or next(misread(settings, base), None)
    for i, drive in enumerate(settings.drive):
        try:
            model, gear = model_and_gear(drive, base)
            prior_of(drive, gear, base)
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


def readable(file: Path) -> bool:
    """Whether this process may read a file."""
    return file.is_file() and os.access(file, os.R_OK)


def _named(path: Path, source: SourceSettings, base: Path, simulated: bool) -> None:
    """`validate_source`, its complaint with the configuration's name. Raises `SettingsError`."""
    try:
        validate_source(source, base, simulated)
    except BadInput as error:
        raise SettingsError(f"{path}: {error}") from error


def _unknown_signals(settings: Settings, base: Path) -> Iterator[str]:
    known = {source.name: signals_of(source, base) for source in settings.sources}
    for i, drive in enumerate(settings.drive):
        wanted = [(f"drive[{i}].channels[{j}]", row.source, row.signal) for j, row in enumerate(drive.channels)]
        if drive.sound:
            wanted.append((f"drive[{i}].sound", drive.sound.source, drive.sound.signal))
        for where, source, signal in wanted:
            there = known[source]
            if there is not None and signal not in there:
                close = near(signal, there, most=3, cutoff=0.0)
                such = f"such as {', '.join(close)}" if close else "a decoding there first: `dbc` or `pdo`"
                yield f"{where}.signal: {signal!r} is no signal of {source!r}: expected {such}"


def misread(settings: Settings, base: Path) -> Iterator[str]:
    """Channels that take what their signal gives for something else: its unit, its width, its zero."""
    for i, drive in enumerate(settings.drive):
        for j, row in enumerate(drive.channels):
            where = f"drive[{i}].channels[{j}]"
            gives = _given_by_preset(settings, row)
            if gives and row.unit not in (gives, "SI") and (row.scale, row.offset) == (1.0, 0.0):
                yield (
                    f"{where}.unit: {row.unit!r}: the preset gives {row.signal!r} in {gives}: "
                    f'expected unit = "{gives}", or a scale'
                )
            yield from _miscounted(where, row, _field_of(settings, row, base))


def _given_by_preset(settings: Settings, row: ChannelSettings) -> str:
    """The unit of a signal that a preset converts; empty where the configuration itself says what a count is."""
    device, _, signal = row.signal.partition(".")
    named = [part for bus in settings.i2c if bus.name == row.source for part in bus.devices if part.name == device]
    return next((PRESETS[part.preset].signals.get(signal, "") for part in named if part.preset), "")


def _field_of(settings: Settings, row: ChannelSettings, base: Path) -> Field | None:
    """How the bytes of a channel's signal are read; None of what does not come in frames."""
    bus = next((bus for bus in settings.can if bus.name == row.source), None)
    layouts = layouts_of(bus, base).values() if bus else ()
    return next((field for layout in layouts for field in layout.fields if field.name == row.signal), None)


def _miscounted(where: str, row: ChannelSettings, field: Field | None) -> Iterator[str]:
    if field is None:
        return
    if row.wrap_counts is not None and not field.is_float and row.wrap_counts > (ends := 2**field.bits * field.scale):
        yield (
            f"{where}.wrap_counts: {row.wrap_counts:.16g}: {row.signal!r} has {field.bits} bits and rolls over at "
            f"{ends:.16g} at the latest: expected at most that"
        )
    counted = OBJECTS.get(field.name.partition(":")[2])
    if counted is None or row.counts_per_turn or row.scale != 1.0 or row.channel not in CHANNELS:
        return
    if CHANNELS[row.channel].angle:
        yield f"{where}.counts_per_turn: missing: {row.signal!r} is in counts: expected those of one turn"
    elif counted.meaning.startswith("per mille"):
        rated = counted.meaning.removeprefix("per mille of ")
        yield f"{where}.scale: missing: {row.signal!r} is in per mille: expected a thousandth of {rated}"


def _missing_channels(path: str, drive: Drive, model: Model) -> Iterator[str]:
    there = {row.channel for row in drive.channels}
    if drive.sound_angle:  # the motor's tone gives what an encoder does not
        there.add("theta_in_rad")
    for channel in NEEDED[model.balance]:
        if channel not in there:
            close = closest(channel, there, cutoff=0.8)
            hint = f": did you mean it by {close!r}?" if close else ""
            yield f"{path}.channels: {channel}: missing: a model of balance {model.balance!r} needs it{hint}"
