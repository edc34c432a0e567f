"""Hourly means of estimates: small enough to keep for years."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec

from edge_daemon.records import Snapshot

HOUR_S = 3600.0


class Mean(msgspec.Struct, array_like=True):
    """One quantity over one hour."""

    unit: str
    count: int = 0
    mean: float = 0.0
    squares: float = 0.0
    """sum of squared deviations from the mean (Welford 1962)"""
    lowest: float = math.inf
    highest: float = -math.inf
    sd: float = 0.0
    """mean of the standard deviations that the estimates came with"""

    def add(self, value: float, sd: float) -> None:
        """Take one estimate."""
        self.count += 1
        away = value - self.mean
        self.mean += away / self.count
        self.squares += away * (value - self.mean)
        self.lowest, self.highest = min(self.lowest, value), max(self.highest, value)
        self.sd += (sd - self.sd) / self.count


@dataclass(slots=True)
class HourMeans:
    """The hour of one drive that is being filled."""

    hour: int
    """hours since the epoch"""
    means: dict[str, Mean]

    def add(self, snapshot: Snapshot) -> None:
        """Take what is usable."""
        for name, estimate in snapshot.estimates.items():
            if estimate.usable:
                mean = self.means.get(name)
                if mean is None:
                    mean = self.means[name] = Mean(estimate.unit)
                mean.add(estimate.value, estimate.sd)

    def encode(self) -> bytes:
        """For `decode_means`."""
        return msgspec.msgpack.encode(self.means)


def decode_means(data: bytes) -> dict[str, Mean]:
    """Raises `msgspec.DecodeError` on damage."""
    return msgspec.msgpack.decode(data, type=dict[str, Mean])


def hour_of(time_s: float) -> int:
    """Hours since the epoch."""
    return math.floor(time_s / HOUR_S)
