"""What a configuration may say, and yet hardly means: the place, what stands there and what to put."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import tomlkit

from edge_daemon.channels import CHANNELS
from edge_daemon.config.contradictions import registers_of
from edge_daemon.config.reading import read_every_s
from edge_daemon.config.settings import ChannelSettings, Drive, Gateway, ModbusSource, Settings
from edge_daemon.effects.torque_source import INERTIA, SENSOR, torque_source
from edge_daemon.service.configuration import model_and_gear
from edge_daemon.text import closest

ENCODER_BITS = range(10, 33)
"""Encoders have so many bits; hardly one has so few counts."""
LAST_I2C_ADDRESS = 0x77
"""Addresses above are reserved (UM10204, section 3.1.12)."""
REFERENCES = {"input": 30001, "holding": 40001}
"""Manuals number the first register so; on the wire it is 0 (Modbus application protocol V1.1b3, section 4.4)."""
RATIO_OFF = 0.5
"""Ratios are given to the tooth: the next one is at least one away."""
LIMITS_APART = 10.0
"""Limits of one motion, at the motor and at the output, hardly differ by so much (guess)."""
LONGEST_SILENCE_S = 60.0
"""Nobody waits longer for a channel that estimates are made of; who thinks in milliseconds writes more (guess)."""
LOCAL = re.compile(r"/(127\.|localhost|\[::1\])|^(unix|serial|vsock)")
"""An endpoint that only this computer reaches, or who is wired to it."""
CAN_FRAME_BITS, CAN_BITS_PER_S = 111, 1_000_000
"""A frame of eight bytes without stuffed bits (ISO 11898-1), and the fastest classical bus."""
RTU_CHARACTER_BITS, RTU_REST = 11, 20
"""Bits of a character; characters of a request, of an answer's frame and of silence (Modbus over serial line V1.02)."""
I2C_READ_S = 0.5e-3
"""A register of two bytes with both addresses at 100 kHz (UM10204): six bytes of nine bits."""
FLEETING = re.compile(r"^/dev/tty(USB|ACM)\d+$")
"""A port by the order in which adapters were plugged in."""


def notes(settings: Settings, file: Path) -> Iterator[str]:
    """Each remark as a line."""
    yield from _fleet(settings)
    yield from _buses(settings)
    yield from _decimal_addresses(file)
    yield from _references(settings)
    yield from _shared_angles(settings)
    for i, drive in enumerate(settings.drive):
        for j, row in enumerate(drive.channels):
            yield from _channel(f"drive[{i}].channels[{j}]", row, read_every_s(settings, row) or 0.0)
        yield from _drive(f"drive[{i}]", drive, file.parent)


def _fleet(settings: Settings) -> Iterator[str]:
    if settings.zenoh.enabled and settings.gateway == Gateway():
        known = f"site {settings.gateway.site!r}, name {settings.gateway.name!r}"
        yield f"gateway: {known}: so is called every gateway that states none: give this one names of its own"
    for j, endpoint in enumerate(settings.zenoh.listen if settings.zenoh.enabled else ()):
        if not endpoint.startswith("tls/") and not settings.zenoh.users_file and not LOCAL.search(endpoint):
            yield f"zenoh.listen[{j}]: {endpoint!r}: whoever reaches it gets in: expected tls/ and [zenoh.tls]"


def _buses(settings: Settings) -> Iterator[str]:
    """What a bus ignores, cannot carry, or loses when it is plugged in again."""
    for i, bus in enumerate(settings.can):
        bits_per_s = bus.bitrate or CAN_BITS_PER_S
        if bus.interface == "socketcan" and bus.bitrate is not None:
            bits_per_s = CAN_BITS_PER_S
            yield f"can[{i}].bitrate: not used with socketcan: `ip link set {bus.channel} type can bitrate ...` sets it"
        if bus.sync_period_s is not None:
            least_s = CAN_FRAME_BITS * (1 + len(bus.pdo)) / bits_per_s
            yield from _too_fast(f"can[{i}].sync_period_s", bus.sync_period_s, least_s, "SYNC and its answers take")
    for i, wires in enumerate(settings.i2c):
        for j, device in enumerate(wires.devices):
            yield from _too_fast(f"i2c[{i}].devices[{j}].period_s", device.period_s, I2C_READ_S, "a read takes")
    for i, sensor in enumerate(settings.modbus):
        if sensor.transport != "rtu":
            continue
        if FLEETING.match(sensor.serial or ""):
            yield (
                f"modbus[{i}].serial: {sensor.serial!r}: another adapter may have this name after the next start: "
                "expected the one under /dev/serial/by-id/"
            )
        share = sum(_line_s(sensor, registers_of(read)) / read.period_s for read in sensor.reads)
        if share > 1.0:
            taken = f"at {sensor.baud} baud the line is taken {share:.1f} times"
            yield f"modbus[{i}].reads: {taken}: expected longer periods"


def _too_fast(where: str, stated_s: float, least_s: float, what: str) -> Iterator[str]:
    if stated_s < least_s:
        yield f"{where}: {stated_s:g}: {what} {least_s:.2g} s: expected a longer one"


def _line_s(sensor: ModbusSource, registers: int) -> float:
    """How long a read takes the serial line."""
    return RTU_CHARACTER_BITS * (RTU_REST + 2 * registers) / sensor.baud


def _decimal_addresses(file: Path) -> Iterator[str]:
    """I2C addresses written as `i2cdetect` prints them, which TOML takes for decimal; of presets `examined` tells."""
    for i, bus in enumerate(tomlkit.parse(file.read_text("utf-8-sig")).get("i2c", [])):
        for j, device in enumerate(bus["devices"]):
            text = device["address"].as_string()
            if "preset" not in device and text.isdecimal() and int(text, 16) <= LAST_I2C_ADDRESS:
                yield (
                    f"i2c[{i}].devices[{j}].address: {text} is 0x{int(text):02X}: "
                    f"i2cdetect prints addresses without 0x: did you mean 0x{text}?"
                )


def _references(settings: Settings) -> Iterator[str]:
    """Modbus registers as manuals number them."""
    for i, sensor in enumerate(settings.modbus):
        for j, read in enumerate(sensor.reads):
            first = REFERENCES[read.table]
            if first <= read.address < first + 9999:
                yield (
                    f"modbus[{i}].reads[{j}].address: {read.address}: a manual's reference: did you mean "
                    f"{read.address - first}, as on the wire?"
                )


def _shared_angles(settings: Settings) -> Iterator[str]:
    """Two drives may share a motor; an encoder that is both their outputs is one of a copied section."""
    taken: dict[tuple[str, str], str] = {}
    for i, drive in enumerate(settings.drive):
        for j, row in enumerate(drive.channels):
            other = taken.setdefault((row.source, row.signal), drive.name) if row.channel == "theta_out_rad" else ""
            if other and other != drive.name:
                yield f"drive[{i}].channels[{j}].signal: {row.signal!r} is theta_out_rad of {other} as well"


def _channel(where: str, row: ChannelSettings, every_s: float) -> Iterator[str]:
    """`every_s`: 0 for what comes by itself."""
    bits = row.counts_per_turn or 0.0
    if bits in ENCODER_BITS:
        yield f"{where}.counts_per_turn: {bits:g}: did you mean {1 << int(bits)}, an encoder of {bits:g} bits?"
    close = closest(row.channel, CHANNELS, cutoff=0.75)
    if row.channel not in CHANNELS and close:
        yield (
            f"{where}.channel: {row.channel!r} is stored as a column of your own, "
            f"and nothing is estimated from it: did you mean {close!r}?"
        )
    if row.patience_s <= every_s:
        yield (
            f"{where}.stale_after_s: {row.patience_s:g}: {row.signal!r} is read every "
            f"{every_s:g} s, so that {row.channel} is silent in between: expected some periods"
        )
    elif row.channel in CHANNELS and row.patience_s > LONGEST_SILENCE_S and row.patience_s > 10.0 * every_s:
        yield (
            f"{where}.stale_after_s: {row.patience_s:g}: so many seconds it is not told that {row.channel} is silent: "
            f"did you mean {row.patience_s / 1000.0:g}?"
        )


def _drive(where: str, drive: Drive, base: Path) -> Iterator[str]:
    """Where channels, model and gear do not go together."""
    model, gear = model_and_gear(drive, base)
    if gear is not None and abs(abs(model.ratio) - gear.ratio) > RATIO_OFF:
        yield f"{base / drive.model}: joint.ratio: {model.ratio:g}: the gear {gear.name} has {gear.ratio:g}"
    rates = {row.channel: row.max_rate for row in drive.channels if row.max_rate is not None}
    motor, output = rates.get("theta_in_rad"), rates.get("theta_out_rad")
    if motor and output and not 1.0 / LIMITS_APART < motor / (output * abs(model.ratio)) < LIMITS_APART:
        yield (
            f"{where}.channels: max_rate {motor:g} rad/s of theta_in_rad and {output:g} of theta_out_rad: "
            f"through the gear that is {output * abs(model.ratio):g}: expected limits of one motion"
        )
    source = torque_source((row.channel for row in drive.channels), model.output_inertia_kg_m2)
    if model.balance == "torsion" and source not in (SENSOR, INERTIA):
        yield (
            f"{base / drive.model}: joint.output_inertia_kg_m2: missing: without it, or a channel torque_out_Nm, "
            f"there is no torque, and drive {drive.name} gets no stiffness"
        )
