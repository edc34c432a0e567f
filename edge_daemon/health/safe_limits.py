"""Measured channels against what the installation may bear: force, pressure, temperature, torque.

A value beyond a safe limit is believed and raises an alarm; one beyond `minimum` or `maximum` is a flaw of the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from edge_daemon.health.alarms import Finding
from edge_daemon.records import NE107, Block

SAMPLES = 3
"""A limit counts as passed when so many samples of one block lie beyond: one alone may be a disturbed reading."""
BACK_SHARE = 0.02
"""An alarm goes when the value is back inside by this share of the limit."""


@dataclass(frozen=True, slots=True)
class SafeRange:
    """Of one channel, in its unit; infinite where there is none."""

    unit: str
    low: float = -math.inf
    high: float = math.inf


class SafeLimits:
    """One per drive: `follow` every block, `findings` as often as wanted."""

    def __init__(self, limits: Mapping[str, SafeRange]) -> None:
        self._limits = limits
        self._seen: dict[str, tuple[float, float]] = {}

    def follow(self, block: Block) -> None:
        """Take the lowest and highest believable values of a block; a channel without any keeps what it had."""
        for channel in self._limits:
            values = block.values.get(channel)
            if values is None:
                continue
            good = values[(block.flaws[channel] == 0) & np.isfinite(values)]
            if len(good) >= SAMPLES:
                ordered = np.sort(good)
                self._seen[channel] = (float(ordered[SAMPLES - 1]), float(ordered[-SAMPLES]))

    def findings(self) -> Iterator[Finding]:
        """Per limit whether it is passed; a passed one stays until a person has seen it."""
        for channel, (lowest, highest) in self._seen.items():
            limits = self._limits[channel]
            if math.isfinite(limits.high):
                yield _finding(channel, "above", highest, limits.high, limits.unit, 1.0)
            if math.isfinite(limits.low):
                yield _finding(channel, "below", lowest, limits.low, limits.unit, -1.0)


def _finding(channel: str, side: str, value: float, limit: float, unit: str, sign: float) -> Finding:
    text = (
        f"{channel} {value:.4g} {unit} is {side} its safe limit of {limit:.4g} {unit}: lower the load, find the cause, "
        "then acknowledge"
    )
    passed, back = sign * (value - limit) > 0, sign * (value - limit) > -BACK_SHARE * abs(limit)
    return Finding(f"{channel} {side} limit", NE107.OUT_OF_SPECIFICATION, passed, back, text, latching=True)
