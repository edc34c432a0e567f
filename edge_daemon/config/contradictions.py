"""The configuration held against itself: each contradiction as `key path: what is wrong: what was expected`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

from edge_daemon.channels import CHANNELS
from edge_daemon.config.settings import (
    CanSource,
    ChannelSettings,
    DashboardSettings,
    Drive,
    Excite,
    I2cSource,
    ModbusRead,
    ModbusSource,
    Settings,
    Zenoh,
)
from edge_daemon.units import unit_problem

BLOCK_S = (0.01, 10.0)
"""Shorter blocks cost more than they tell, and longer ones leave a PLC without news (guess, both)."""
WORDS = {"u32": 2, "i32": 2, "f32": 2, "waveform_f32": 2, "bands_f32": 4}
"""A value takes so many registers where it is not one."""
ENDPOINT = re.compile(r"(tcp|udp|tls|quic|ws|serial|unixsock-stream|vsock|unixpipe)/\S+")
EXCITE_PDOS = {0x180: ("statusword", "position_actual", "torque_actual"), 0x280: ("velocity_actual",)}
"""The runner of `excite.drive_link` maps these into the drive's first two PDOs: another reader must not take them for
something else."""


def contradictions(settings: Settings) -> Iterator[str]:
    """All of them; a person is told the first."""
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
        last = read.address + registers_of(read) - 1
        if last > 0xFFFF:
            yield f"{where}: {read.address}: {read.signal!r} ends at {last}: expected at most 65535"
            return
        for address in range(read.address, last + 1):
            other = taken.setdefault((read.device_id or sensor.device_id, read.table, address), read.signal)
            if other != read.signal:
                yield f"{where}: {read.address}: {read.signal!r} overlaps {other!r} at {address}: expected one of them"
                return


def registers_of(read: ModbusRead) -> int:
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
        problem = "" if row.counts_per_turn else unit_problem(row.unit, row.channel)
        if problem:
            yield f"{where}.unit: {problem}"
        yield from _check_limits(where, row)
        yield from _check_scale(where, row)
        yield from _check_counter(where, row)
        if row.grating_nm is not None and not any(one.channel == "temperature_degC" for one in drive.channels):
            yield f"{where}.grating_nm: no channel temperature_degC: expected it, a grating feels warmth too"
    yield from _check_shared(path, drive.channels)
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


def _check_scale(where: str, row: ChannelSettings) -> Iterator[str]:
    if row.scale == 0.0:
        yield f"{where}.scale: 0: every reading would be the same: expected another number"


def _check_counter(where: str, row: ChannelSettings) -> Iterator[str]:
    """A counter rolls over after whole turns, within one turn by an equal part of it, or at a power of two."""
    turn, wrap = row.counts_per_turn, row.wrap_counts
    if turn is None:
        return
    if row.unit not in ("SI", "rad"):
        yield f"{where}.unit: {row.unit!r}: counts_per_turn makes radians of counts: expected one or the other"
    for name, other in (("scale", row.scale != 1.0), ("grating_nm", row.grating_nm is not None)):
        if other:
            value = getattr(row, name)
            yield f"{where}.{name}: {value:g}: counts_per_turn makes radians of counts: expected one or the other"
    if wrap is not None and wrap % turn and turn % wrap and math.log2(wrap) % 1:
        near = round(wrap / turn) * turn or turn
        yield (
            f"{where}.wrap_counts: {wrap:.12g}: no whole turns of {turn:.12g} counts, and no power of two: "
            f"expected such as {near:.12g}"
        )


def _check_shared(path: str, rows: Sequence[ChannelSettings]) -> Iterator[str]:
    """One signal cannot be two different things of one kind, such as both angles: their twist would be its shadow."""
    taken: dict[tuple[str, str, str], str] = {}
    for j, row in enumerate(rows):
        if row.channel in CHANNELS:
            other = taken.setdefault((row.source, row.signal, CHANNELS[row.channel].unit), row.channel)
            if other != row.channel:
                yield f"{path}.channels[{j}].signal: {row.signal!r} is {other} already: expected that of {row.channel}"


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


def _check_page(page: DashboardSettings) -> Iterator[str]:
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
    secret = [endpoint for endpoint in (*link.listen, *link.connect) if endpoint.startswith(("tls/", "quic/"))]
    listens = link.mode != "client" and any(endpoint in secret for endpoint in link.listen)
    if secret and link.tls is None:
        yield f"zenoh.tls: missing: expected it with ca, because of {secret[0]!r}"
    if link.tls is not None and not secret:
        yield "zenoh.listen: expected an endpoint such as tls/0.0.0.0:7447, here or in connect, because of [zenoh.tls]"
    if link.tls is not None and (link.tls.certificate is None) != (link.tls.key is None):
        yield "zenoh.tls.key: expected both certificate and key, or neither"
    if link.tls is not None and listens and link.tls.certificate is None:
        yield "zenoh.tls.certificate: missing: expected one to listen with"
    if (link.user is None) != (link.password_file is None):
        yield "zenoh.password_file: expected both user and password_file, or neither"


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
