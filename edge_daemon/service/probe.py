"""`check --probe`: every bus opened, every device read, first values in their units, and what else is there."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from edge_daemon.acquire.can_decode import layouts_of
from edge_daemon.acquire.can_listen import HeardMessage, HeardNode, listened, proposed
from edge_daemon.acquire.can_readers import LinkDown
from edge_daemon.acquire.canopen_objects import EMERGENCY_ID, EXTENDED, SYNC_ID
from edge_daemon.acquire.drivers import OpenI2c, open_source
from edge_daemon.acquire.source import Source, SourceLost
from edge_daemon.channels import CHANNELS
from edge_daemon.clock import Clock
from edge_daemon.condition.calibration import Calibration
from edge_daemon.config.settings import CanSource, ChannelSettings, Drive, Settings, SourceSettings
from edge_daemon.errors import BadInput
from edge_daemon.records import Bands, Burst, Readings
from edge_daemon.service.configuration import examined
from edge_daemon.text import number, progress, table

SLOWER = 0.8
"""An angle that comes at less than this share of the drive's rate leaves holes in its blocks (guess)."""
MOST_WAIT_S = 10.0
"""A signal that has not come by then does not come (guess; devices are asked once in one to five seconds)."""
LOOK_S = 0.1
USUAL = {
    "temperature_degC": (-40.0, 150.0),
    "temperature_ambient_degC": (-50.0, 80.0),
    "pressure_Pa": (2e4, 1e6),
    "torque_in_Nm": (-1e4, 1e4),
    "current_in_A": (-1e3, 1e3),
}
"""Where a gear works its channels read within these; far outside, a unit or scale is wrong (guess)."""


@dataclass(slots=True)
class Probed:
    """What one source gave."""

    found: dict[str, list[Readings | Burst | Bands]] = field(default_factory=dict)
    trouble: str = ""
    wanted: set[str] = field(default_factory=set)

    @property
    def complete(self) -> bool:
        """Whether every signal that a channel asks for has given a number, or a sound."""
        return all(len(self.of(name)[1]) or not isinstance(self.found.get(name, [None])[0], Readings | None)
                   for name in self.wanted)  # fmt: skip

    def take(self, record: Readings | Burst | Bands) -> None:
        """As a sink of readings."""
        self.found.setdefault(record.signal, []).append(record)

    def of(self, signal: str) -> tuple[np.ndarray, np.ndarray]:
        """(n,) times and (n,) finite raw values of a signal."""
        rows = [row for row in self.found.get(signal, ()) if isinstance(row, Readings)]
        if not rows:
            return np.empty(0), np.empty(0)
        time_s, value = np.concatenate([row.time_s for row in rows]), np.concatenate([row.value for row in rows])
        return time_s[np.isfinite(value)], value[np.isfinite(value)]


def tried(file: Path, seconds: float) -> int:
    """Prints what `probe` finds; 2 with one line where a channel gave nothing. Raises `BadInput`."""
    text, amiss = probe(file, seconds)
    print(text)
    if amiss:
        raise BadInput(amiss)
    return 0


def probe(file: Path, seconds: float, i2c_bus: OpenI2c | None = None) -> tuple[str, str]:
    """What `check --probe` prints, and what is amiss in one line, empty if nothing. Raises `BadInput`."""
    if not 0.0 < seconds < math.inf:
        raise BadInput(f"--seconds {seconds}: expected above 0")
    settings, base = examined(file, simulated=i2c_bus is not None), file.parent
    say, parts = progress("probe"), []
    for bus in settings.can:
        say(f"listens to {bus.name}", 0.1)
        parts.append(_listening(bus, base, seconds))
    say("reads every source", 0.5)
    probed = asyncio.run(_read(settings, base, seconds, i2c_bus))
    say("done", 1.0)
    parts += [f"{name}: {row.trouble}" for name, row in probed.items() if row.trouble]
    missing: list[str] = []
    for drive in settings.drive:
        rows = [_row(settings, drive, row, probed[row.source]) for row in drive.channels]
        sound = drive.sound
        if sound:
            rows.append(_sound_row(sound.source, sound.signal, probed[sound.source]))
        missing += [f"{drive.name} {row[0]}" for row in rows if row[1] == "-"]
        parts.append(f"drive {drive.name}\n{table(('channel', 'first value', 'unit', 'rate', 'from'), rows)}")
    parts += [f"note: {line}" for line in _remarks(settings, probed)]
    amiss = f"{file}: nothing came for {', '.join(missing)}: see above what is there" if missing else ""
    return "\n\n".join(filter(None, parts)), amiss


async def _read(settings: Settings, base: Path, seconds: float, i2c_bus: OpenI2c | None) -> dict[str, Probed]:
    probed = {source.name: Probed() for source in settings.sources}
    for drive in settings.drive:
        for row in drive.channels:
            probed[row.source].wanted.add(row.signal)
        if drive.sound:
            probed[drive.sound.source].wanted.add(drive.sound.signal)
    running = [_source(row, base, seconds, i2c_bus, probed[row.name]) for row in settings.sources]
    await asyncio.gather(*running)
    return probed


async def _source(settings: SourceSettings, base: Path, seconds: float, i2c_bus: OpenI2c | None, into: Probed) -> None:
    """Reads for so long, and a while longer for a signal that is still missing: some are asked seldom."""
    source: Source = open_source(settings, base, i2c_bus)
    task = asyncio.create_task(source.run(into.take, Clock()))
    until_s = time.monotonic() + max(seconds, MOST_WAIT_S)
    await asyncio.wait([task], timeout=seconds)
    while not task.done() and not into.complete and time.monotonic() < until_s:
        await asyncio.wait([task], timeout=LOOK_S)
    health = source.health()
    if not task.done():
        task.cancel()
    try:
        await task
    except asyncio.CancelledError:
        into.trouble = health.reason if health.state != "ok" else ""
    except SourceLost as error:
        into.trouble = str(error).removeprefix(f"{settings.name}: ")


# what is on a CAN bus


def _listening(bus: CanSource, base: Path, seconds: float) -> str:
    head = f"{bus.name} ({bus.interface}:{bus.channel})"
    try:
        heard, nodes = listened(bus, seconds)
    except LinkDown as error:
        return f"{head}: {error}"
    if not heard and not nodes:
        return f"{head}: silent for {seconds:g} s: {_why_silent(bus)}"
    known = _known(bus, base)
    rows = [
        (
            f"0x{row.identifier:X}",
            str(row.length),
            _per_s(row.rate_hz),
            known.get(row.identifier | (EXTENDED if row.extended else 0), "-"),
            row.meaning or "-",
        )
        for row in heard
    ]
    parts = [head, table(("identifier", "bytes", "rate", "configured as", "after CiA 301"), rows)] if rows else [head]
    parts += [f"  node {n.node}: {_who(n)}" for n in nodes]
    parts += [f"  {line}" for line in _proposals(bus, heard, nodes, known)]
    return "\n".join(parts)


def _why_silent(bus: CanSource) -> str:
    if bus.sync_period_s is not None:
        return "its nodes may wait for SYNC, which is produced below"
    return "bit rate, termination, power; or its nodes wait to be started: `start_nodes = true`"


def _known(bus: CanSource, base: Path) -> dict[int, str]:
    """Identifier -> message of the configuration."""
    return {key: layout.name for key, layout in layouts_of(bus, base).items()}


def _who(node: HeardNode) -> str:
    kind = {402: "a drive (CiA 402)", 406: "an encoder (CiA 406)"}.get(node.profile, "no profile known here")
    mapped = "; ".join(f"0x{key:03X} carries {', '.join(names)}" for key, names in node.pdos.items())
    return f"{kind}{f'; {mapped}' if mapped else '; nothing is mapped into its PDOs: `map_pdos = true` does it'}"


def _proposals(
    bus: CanSource, heard: list[HeardMessage], nodes: list[HeardNode], known: dict[int, str]
) -> Iterator[str]:
    for row in heard:
        line = proposed(row, nodes)
        if line and row.identifier not in known:
            yield f"pdo could have: {line}"
    there = {row.identifier for row in heard if not row.extended}
    states = {row.node: row.payload[0] & 0x7F for row in heard if row.meaning.startswith("heartbeat") and row.payload}
    for node in sorted({pdo.node for pdo in bus.pdo}):
        if states.get(node) == 127 and not bus.start_nodes:
            yield f"node {node} waits to be started: by its master, or by this gateway with `start_nodes = true`"
    others = sorted(there - known.keys() - {0, SYNC_ID})
    if known and not there & known.keys() and others and bus.sync_period_s is None:
        yield f"none of the {len(known)} configured messages came, but others did: another bus, node or DBC file?"
    for pdo in bus.pdo:
        mapped = next((n.pdos[pdo.cob_id] for n in nodes if pdo.cob_id in n.pdos), None)
        if mapped is not None and mapped != pdo.objects and not bus.map_pdos:
            yield f"pdo 0x{pdo.cob_id:03X}: objects: {list(pdo.objects)}: node {pdo.node} sends {list(mapped)} in it"
        if EMERGENCY_ID + pdo.node in there:
            yield f"node {pdo.node} has sent an emergency: look at its own error list"


# what the channels read


def _row(settings: Settings, drive: Drive, row: ChannelSettings, probed: Probed) -> tuple[str, ...]:
    time_s, raw = probed.of(row.signal)
    unit = CHANNELS[row.channel].unit if row.channel in CHANNELS else row.unit
    place = f"{row.source} {row.signal}"
    if not len(raw):
        return (row.channel, "-", unit, "-", place)
    value, _ = Calibration(row, drive.rate_hz).apply(time_s[:1], raw[:1])
    return (row.channel, number(float(value[0]), 6), unit, _per_s(_rate_hz(time_s)), place)


def _sound_row(source: str, signal: str, probed: Probed) -> tuple[str, ...]:
    rows = probed.found.get(signal, [])
    kind = f"{len(rows[0].value)} samples" if rows and isinstance(rows[0], Burst) else "bands" if rows else "-"
    return ("sound", kind, "", f"{len(rows)} times" if rows else "-", f"{source} {signal}")


def _per_s(rate_hz: float) -> str:
    return f"{rate_hz:.0f} /s" if rate_hz >= 10 else f"{number(rate_hz, 2)} /s"


def _rate_hz(time_s: np.ndarray) -> float:
    span_s = float(time_s[-1] - time_s[0]) if len(time_s) > 1 else 0.0
    return (len(time_s) - 1) / span_s if span_s > 0 else math.nan


def _remarks(settings: Settings, probed: dict[str, Probed]) -> Iterator[str]:
    """What the values themselves give away."""
    for i, drive in enumerate(settings.drive):
        for j, row in enumerate(drive.channels):
            time_s, raw = probed[row.source].of(row.signal)
            if len(raw):
                yield from _remarked(f"drive[{i}].channels[{j}]", drive, row, time_s, raw)


def _remarked(where: str, drive: Drive, row: ChannelSettings, time_s: np.ndarray, raw: np.ndarray) -> Iterator[str]:
    if row.wrap_counts is not None and float(np.ptp(raw)) >= row.wrap_counts:
        yield f"{where}.wrap_counts: {row.wrap_counts:.12g}: read {raw.min():.12g} to {raw.max():.12g}: expected more"
    known = CHANNELS.get(row.channel)
    if known is not None and known.angle and _rate_hz(time_s) < SLOWER * drive.rate_hz:
        rate = number(_rate_hz(time_s), 4)
        yield f"drive {drive.name}: rate_hz: {drive.rate_hz:g}: {row.channel} comes {rate} times a second"
    low, high = USUAL.get(row.channel, (-math.inf, math.inf))
    value = float(Calibration(row, drive.rate_hz).apply(time_s[:1], raw[:1])[0][0])
    if not low <= value <= high:
        yield f"{where}: reads {number(value)} {known.unit if known else row.unit}: unit, scale or offset?"
