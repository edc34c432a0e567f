"""The configuration file: read, and held against itself and against what it names. Every mistake is one line.

`load` needs the file alone; `examined` also looks at everything the file names (decodings, models, gears), so that
what it lets pass can be started, and a running daemon never gives up a good configuration for a bad one.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec

from edge_daemon.acquire.drivers import signals_of, validate_source
from edge_daemon.channels import CHANNELS
from edge_daemon.effects.model import Model
from edge_daemon.effects.model_file import read_model
from edge_daemon.errors import BadInput
from edge_daemon.keys import expected, names
from edge_daemon.prognose.gears import Gear, find_gear
from edge_daemon.settings import (
    STALE_AFTER_S,
    CanSource,
    ChannelSettings,
    Dashboard,
    Drive,
    Excite,
    I2cSource,
    ModbusRead,
    ModbusSource,
    Settings,
    SettingsError,
    SourceSettings,
    Zenoh,
    unit_problem,
)
from edge_daemon.show.guard import Guard

BLOCK_S = (0.01, 10.0)
"""shorter blocks cost more than they tell, longer ones leave a PLC without news (both guesses)"""
WORDS = {"u32": 2, "i32": 2, "f32": 2, "waveform_f32": 2, "bands_f32": 4}
"""registers that one value takes, where it is not one"""
ENDPOINT = re.compile(r"(tcp|udp|tls|quic|ws|serial|unixsock-stream|vsock|unixpipe)/\S+")
NEEDED = {"torsion": ("theta_in_rad", "theta_out_rad"), "drive": ()}
"""channels without which a balance says nothing"""

PERIODS = 3.0
"""of a read pass before its channel counts as silent: one may fail and be repeated (guess)"""
EXCITE_PDOS = {0x180: ("statusword", "position_actual", "torque_actual"), 0x280: ("velocity_actual",)}
"""what `excite.drive_link` maps into the drive's first two PDOs: another reader must not take it for something else"""


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


# the file against itself


def contradictions(settings: Settings) -> Iterator[str]:
    """Each contradiction between sections, as `key path: what is wrong: what was expected`."""
    if not settings.drive:
        yield "drive: missing: expected at least one [[drive]]"
    yield from _duplicates("source name", [source.name for source in settings.sources])
    yield from _duplicates("drive.name", [drive.name for drive in settings.drive])
    yield from _duplicates("drive.modbus_device_id", [drive.modbus_device_id for drive in settings.drive])
    for i, bus in enumerate(settings.i2c):
        yield from _check_i2c(f"i2c[{i}]", bus)
    yield from _duplicates("i2c.bus", [bus.bus for bus in settings.i2c])
    for i, sensor in enumerate(settings.modbus):
        yield from _check_modbus(f"modbus[{i}]", sensor)
    lines = [sensor.serial for sensor in settings.modbus if sensor.transport == "rtu"]
    for line in _duplicates("modbus.serial", lines):
        yield f"{line}; devices of one line are reads of one [[modbus]], each with its device_id"
    known = {source.name for source in settings.sources}
    for i, drive in enumerate(settings.drive):
        yield from _check_drive(f"drive[{i}]", drive, known)
        if drive.excite:
            yield from _check_excite(f"drive[{i}].excite", drive.excite, settings.can)
    yield from _check_page(settings.dashboard)
    yield from _check_zenoh(settings.zenoh)
    yield from _check_ports(settings)


def _check_i2c(path: str, bus: I2cSource) -> Iterator[str]:
    yield from _duplicates(f"{path}.devices.name", [device.name for device in bus.devices])
    yield from _duplicates(f"{path}.devices.address", [device.address for device in bus.devices])
    for j, device in enumerate(bus.devices):
        burst = device.burst
        registers = [row.register for row in device.registers]
        if burst:
            registers += [burst.control_register, burst.status_register, burst.data_register]
        yield from _duplicates(f"{path}.devices[{j}]: register", registers)


def _check_modbus(path: str, sensor: ModbusSource) -> Iterator[str]:
    yield from _duplicates(f"{path}.reads.signal", [read.signal for read in sensor.reads])
    taken: dict[tuple[int, str, int], str] = {}
    for j, read in enumerate(sensor.reads):
        where = f"{path}.reads[{j}].address"
        last = read.address + _registers(read) - 1
        if last > 0xFFFF:
            yield f"{where}: {read.address}: {read.signal!r} ends at {last}: expected at most 65535"
            return
        for address in range(read.address, last + 1):
            other = taken.setdefault((read.device_id or sensor.device_id, read.table, address), read.signal)
            if other != read.signal:
                yield f"{where}: {read.address}: {read.signal!r} overlaps {other!r} at {address}: expected one of them"
                return


def _registers(read: ModbusRead) -> int:
    """How many a read takes; a queue stands at one."""
    return 1 if read.type.startswith("fifo") else WORDS.get(read.type, 1) * _values(read)


def _values(read: ModbusRead) -> int:
    return read.count if read.type.startswith(("waveform", "bands")) else 1


def _check_drive(path: str, drive: Drive, sources: set[str]) -> Iterator[str]:
    yield from _duplicates(f"{path}.channels.channel", [row.channel for row in drive.channels])
    for j, row in enumerate(drive.channels):
        where = f"{path}.channels[{j}]"
        if row.source not in sources:
            yield f"{where}.source: {row.source!r} is not a source: expected one of {sorted(sources)}"
        if row.channel not in CHANNELS and not row.channel.isidentifier():
            yield f"{where}.channel: {row.channel!r} is no name: expected one of {sorted(CHANNELS)} or an identifier"
        problem = unit_problem(row)
        if problem:
            yield f"{where}.unit: {problem}"
        yield from _check_limits(where, row)
    sound = drive.sound
    if sound and sound.source not in sources:
        yield f"{path}.sound.source: {sound.source!r} is not a source: expected one of {sorted(sources)}"
    if sound and sound.low_hz >= sound.high_hz:
        yield f"{path}.sound.low_hz: {sound.low_hz:g}: expected below high_hz ({sound.high_hz:g})"
    yield from _check_sound_angle(f"{path}.sound_angle", drive)
    if drive.estimation.cutoff_hz >= drive.rate_hz / 2:
        half = drive.rate_hz / 2
        yield f"{path}.estimation.cutoff_hz: {drive.estimation.cutoff_hz}: expected below half of rate_hz ({half})"
    block_s = drive.block_samples / drive.rate_hz
    if not BLOCK_S[0] <= block_s <= BLOCK_S[1]:
        limits = f"{BLOCK_S[0]:g} to {BLOCK_S[1]:g} s"
        yield f"{path}.block_samples: {drive.block_samples}: {block_s:.3g} s at rate_hz: expected a block of {limits}"


def _check_limits(where: str, row: ChannelSettings) -> Iterator[str]:
    """Limits rise; a safe one is reached before the sensor is disbelieved."""
    ladder = [(name, getattr(row, name)) for name in ("minimum", "safe_minimum", "safe_maximum", "maximum")]
    known = [(name, value) for name, value in ladder if value is not None]
    for (lower, low), (upper, high) in pairwise(known):
        if low >= high:
            yield f"{where}.{lower}: {low} is not below {upper} {high}"


def _check_sound_angle(path: str, drive: Drive) -> Iterator[str]:
    there = {row.channel for row in drive.channels}
    if drive.sound_angle is None:
        return
    if drive.sound is None:
        yield f"{path}: no [drive.sound]: expected the waveform that the angle is to be heard in"
    if "theta_in_rad" in there:
        yield f"{path}: there is a channel theta_in_rad: expected one or the other"
    if "theta_out_rad" not in there:
        yield f"{path}: no channel theta_out_rad: expected it, its angle tells where to listen"


def _check_excite(path: str, excite: Excite, buses: Sequence[CanSource]) -> Iterator[str]:
    yield from _duplicates(f"{path}.profile.name", [row.name for row in excite.profile])
    bus = next((row for row in buses if row.name == excite.source), None)
    if bus is None:
        yield f"{path}.source: {excite.source!r} is no CAN source: expected one of {sorted(row.name for row in buses)}"
    elif excite.sync and bus.sync_period_s is not None:
        yield f"{path}.sync: {bus.name!r} already produces SYNC: expected `sync = false`"
    elif bus.sync_period_s not in (None, excite.cycle_s):
        yield f"{path}.cycle_s: {excite.cycle_s}: expected the sync_period_s of {bus.name!r} ({bus.sync_period_s})"
    for j, pdo in enumerate(bus.pdo if bus else ()):
        mapped = EXCITE_PDOS.get(pdo.cob_id - excite.node)
        if mapped and pdo.objects != mapped:
            yield f"can {excite.source!r}: pdo[{j}].objects: a test motion maps {list(mapped)} there: expected the same"


def _check_page(page: Dashboard) -> Iterator[str]:
    if (page.tls_certificate is None) != (page.tls_key is None):
        missing = "tls_key" if page.tls_key is None else "tls_certificate"
        yield f"dashboard.{missing}: missing: expected both tls_certificate and tls_key, or neither"
    if page.tls_client_ca is not None and page.tls_certificate is None:
        yield "dashboard.tls_certificate: missing: expected one, because tls_client_ca is given"
    if page.enabled and not page.on_loopback and page.token_file is None and page.tls_client_ca is None:
        yield (
            "dashboard.token_file: missing: expected a file with a token, or tls_client_ca, "
            f"because {page.host!r} is not loopback"
        )


def _check_zenoh(link: Zenoh) -> Iterator[str]:
    for key, endpoints in (("listen", link.listen), ("connect", link.connect)):
        for j, endpoint in enumerate(endpoints):
            if not ENDPOINT.fullmatch(endpoint):
                yield f"zenoh.{key}[{j}]: {endpoint!r} is no endpoint: expected such as tcp/127.0.0.1:7447"
    if link.enabled and link.mode == "client" and not link.connect and not link.scouting:
        yield "zenoh.connect: empty: expected the router's endpoint, because mode is client"


def _check_ports(settings: Settings) -> Iterator[str]:
    """Our own listeners against each other; 0 is any free port."""
    taken: dict[int, str] = {}
    for name, row in (("modbus_server", settings.modbus_server), ("dashboard", settings.dashboard)):
        if not row.enabled or row.port == 0:
            continue
        if row.port in taken:
            yield f"{name}.port: {row.port}: {taken[row.port]} listens there: expected another"
        taken[row.port] = name
    for j, endpoint in enumerate(settings.zenoh.listen if settings.zenoh.enabled else ()):
        port = endpoint.rpartition(":")[2].partition("#")[0].partition("?")[0]
        if endpoint.startswith(("tcp/", "tls/", "ws/")) and port.isdecimal() and int(port) in taken:
            yield f"zenoh.listen[{j}]: {endpoint!r}: {taken[int(port)]} listens there: expected another port"


def _duplicates(path: str, names: Sequence[object]) -> Iterator[str]:
    seen: set[object] = set()
    for name in names:
        if name in seen:
            yield f"{path}: {name!r} appears twice: expected a different one for each"
        seen.add(name)


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
