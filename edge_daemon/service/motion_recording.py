"""What a test motion was like: the drive's channels on its bus, with the marks of the profile, as a recording."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import can
import canopen
import numpy as np
from canopen.sync import SyncProducer
from msgspec import structs

from edge_daemon.acquire.can_decode import layouts_of
from edge_daemon.acquire.can_inbox import Inbox
from edge_daemon.acquire.can_readers import take_message
from edge_daemon.acquire.source import Tally
from edge_daemon.clock import Clock
from edge_daemon.condition.calibration import Calibration
from edge_daemon.condition.conditioner import Conditioner
from edge_daemon.config.settings import CanSource, ChannelSettings, Drive
from edge_daemon.records import Array, Readings

FLUSH_EVERY_S = 0.05
"""Frames wait this long before they are decoded: the delay with which a silent encoder is noticed."""
ANGLES = ("theta_in_rad", "theta_out_rad")
TEMPERATURE = "temperature_degC"
FEED_S = 1.0
"""A recording is conditioned in pieces of this length."""
LONGEST_S = 3600.0
"""What comes after this much of a recording is not kept (a test motion takes a minute)."""


class StampedSync(SyncProducer):
    """SYNC of which somebody else learns just before it goes out."""

    def __init__(self, network: canopen.Network, sent: Callable[[], None]) -> None:
        super().__init__(network)
        self._sent = sent

    def transmit(self, count: int | None = None) -> None:
        """One SYNC."""
        self._sent()
        super().transmit(count)


class MotionLog(can.Listener):
    """Takes all frames of the bus, from the bus's thread; knows how fresh the drive's channels are."""

    def __init__(self, bus: CanSource, base: Path, drive: Drive, clock: Clock) -> None:
        """Raises `SettingsError` if the bus's decoding does not fit together."""
        self._clock = clock
        self._drive = drive
        synced = {pdo.cob_id for pdo in bus.pdo if pdo.synchronous is not False}
        self._inbox = Inbox(bus.name, layouts_of(bus, base), bus.stamps, Tally(bus.name), synced)
        self._by_kernel = bus.interface == "socketcan"
        self._rows = [row for row in drive.channels if row.source == bus.name]
        self._readings: list[Readings] = []
        self._heard_s: dict[tuple[str, str], float] = {}
        self._temperature = math.nan
        self._flushed_s = self._opened_s = clock.time_s()
        self._synced_s = math.inf
        self._broken = ""
        self._lock = threading.Lock()
        warm = next((row for row in drive.channels if row.channel == TEMPERATURE), None)
        self._warm = None if warm is None else (warm, Calibration(warm, drive.rate_hz))

    # from the bus

    def on_message_received(self, msg: can.Message) -> None:
        """One frame; the name is python-can's."""
        now_s = self._clock.time_s()
        arrived_s = self._clock.from_wall_s(msg.timestamp) if self._by_kernel and msg.timestamp else now_s
        with self._lock:
            take_message(self._inbox, msg, arrived_s)
        if now_s - self._flushed_s >= FLUSH_EVERY_S:
            self.flush()

    def on_error(self, exc: Exception) -> None:
        """The bus's thread has met something; the name is python-can's."""
        self._broken = f"the bus cannot be read: {type(exc).__name__}: {next(iter(str(exc).splitlines()), '')}"

    def synchronised(self) -> None:
        """This gateway sends SYNC now."""
        now_s = self._clock.time_s()
        self._synced_s = min(self._synced_s, now_s)
        self._inbox.synchronised(now_s)

    def flush(self) -> None:
        """Decode what waits."""
        with self._lock:
            self._flushed_s = self._clock.time_s()
            found = list(self._inbox.flush(0.0, self._flushed_s))
        for readings in found:
            self.take(readings)

    def take(self, record: Any) -> None:
        """Readings of any source or the runner's marks; whatever else a source delivers is ignored."""
        if not isinstance(record, Readings) or not len(record.time_s):
            return
        if float(record.time_s[-1]) - self._opened_s < LONGEST_S:
            self._readings.append(record)
        self._heard_s[record.source, record.signal] = float(record.time_s[-1])
        if self._warm and (record.source, record.signal) == (self._warm[0].source, self._warm[0].signal):
            values, flaws = self._warm[1].apply(record.time_s, record.value)
            self._temperature = math.nan if flaws[-1] else float(values[-1])

    # during the motion

    def temperature_degC(self) -> float:
        """The newest; NaN if unknown or stale."""
        return self._temperature if self._warm and not self._late(self._warm[0]) else math.nan

    def doubts(self) -> str:
        """What is wrong with the bus, or which encoder has fallen silent since the first SYNC; empty if nothing."""
        if self._broken:
            return self._broken
        for row in self._rows:
            if row.channel in ANGLES and self._late(row):
                return f"{row.channel} is silent: nothing of {row.signal!r} for {row.patience_s:g} s"
        return ""

    def _late(self, row: ChannelSettings) -> bool:
        since_s = self._heard_s.get((row.source, row.signal), -math.inf)
        if row.channel in ANGLES:  # before the first SYNC a synchronous encoder has nothing to answer
            if self._synced_s == math.inf:
                return False
            since_s = max(since_s, self._synced_s)
        return self._clock.time_s() - since_s > row.patience_s

    # afterwards

    def recording(self) -> tuple[Array, dict[str, Array]]:
        """`time_s` (n,) and (n,) per channel, SI, flawed samples NaN; the marks as `profile_phase`."""
        self.flush()
        sources = {reading.source for reading in self._readings}
        marks = ChannelSettings(channel="profile_phase", source="excite", signal=f"{self._drive.name}.profile_phase")
        rows = (*(row for row in self._drive.channels if row.source in sources), marks)
        size = max(1, round(FEED_S * self._rate_hz()))
        drive = structs.replace(self._drive, channels=rows, rate_hz=self._rate_hz(), block_samples=size)
        blocks = list(_conditioned(drive, sorted(self._readings, key=lambda reading: float(reading.time_s[-1]))))
        if not blocks:
            return np.empty(0), {}
        time_s = np.concatenate([block.time_s for block in blocks])
        kept = time_s <= max(self._heard_s.values())
        columns = {
            name: np.concatenate([np.where(b.flaws[name] == 0, b.values[name], math.nan) for b in blocks])[kept]
            for name in blocks[0].values
        }
        if "profile_phase" in columns:  # before the first mark nothing had begun
            columns["profile_phase"] = np.nan_to_num(columns["profile_phase"], nan=0.0)
        return time_s[kept], {name: column for name, column in columns.items() if np.isfinite(column).any()}

    def _rate_hz(self) -> float:
        """Of the encoders as they came: a recording has no more instants than they had."""
        periods = [
            float(np.median(np.diff(times)))
            for row in self._rows
            if row.channel in ANGLES and len(times := self._times(row)) > 1
        ]
        return min([self._drive.rate_hz, *(1 / period for period in periods if period > 0)])

    def _times(self, row: ChannelSettings) -> Array:
        parts = [x.time_s for x in self._readings if (x.source, x.signal) == (row.source, row.signal)]
        return np.concatenate(parts) if parts else np.empty(0)


def _conditioned(drive: Drive, readings: Sequence[Readings]) -> Iterator[Any]:
    """The blocks of all readings, fed in the order of time so that nothing overflows."""
    conditioner, fed_s = Conditioner(drive), -math.inf
    for record in readings:
        conditioner.push(record)
        newest_s = float(record.time_s[-1])
        if newest_s > fed_s + FEED_S / 2:
            fed_s = newest_s
            yield from conditioner.blocks(newest_s)
    yield from conditioner.blocks(math.inf)
