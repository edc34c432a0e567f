"""What the gear carries: torque rms, peak and cubic mean, motor speed, temperature and pressure."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from edge_daemon.motion.streaming import Stretch
from edge_daemon.records import Array, Block, Estimate, Status

WINDOW_S = 60.0
"""Rms, peak and mean speed are those of the last minute."""
SLOW_CHANNELS = (
    ("temperature", "degC", "temperature_degC", 1.0),
    ("temperature_ambient", "degC", "temperature_ambient_degC", 1.0),
    ("pressure", "Pa", "pressure_Pa", 100.0),
)
"""A quantity, its unit, its channel, and the sd of a reading before readings have shown theirs (guess: what makers of
common parts promise of one, BMP280 data sheet 1.14, table 2)."""
SLOW_READINGS = 60
"""The scatter of a slow channel is known from so many readings (a minute at one a second)."""
FEWEST_STEPS = 5
"""Of fewer differences the scatter may come out at a third of itself once in fifty times."""
STILL_RAD_S = 1.0
"""Motor speeds below this turn no bearing that counts for its life (guess)."""


class _Part(NamedTuple):
    end_s: float
    samples: int
    torque_square: float
    torque_peak: float
    speed_sum: float


class LoadEstimator:
    """Sums over a window of stretches, and over the service life for the cubic mean."""

    def __init__(self) -> None:
        self._parts: deque[_Part] = deque()
        self._peaks: deque[_Part] = deque()  # those that no later one exceeds, the largest first
        self._samples = 0
        self._square = self._travel = 0.0
        self._turned = 0.0
        self._cubed = 0.0
        self._slow_means = [SlowMean(*row) for row in SLOW_CHANNELS]
        self._slow: dict[str, Estimate] = {}
        self._lost = True
        self.time_s = math.nan

    def update(self, block: Block, stretch: Stretch | None) -> None:
        """Take in a block's slow channels and the motion it completed."""
        for mean in self._slow_means:
            if mean.channel in block.values:
                self._slow[mean.name] = mean.update(block)
        good = stretch.valid & np.isfinite(stretch.motion.torque_Nm) if stretch is not None else np.zeros(0, dtype=bool)
        usable = np.count_nonzero(good)
        self._lost = not usable
        if stretch is None or self._lost:
            return
        torque, speed = stretch.motion.torque_Nm, self._speed(stretch)
        self._add(
            torque if usable == len(good) else torque[good],
            speed if usable == len(good) else speed[good],
            float(stretch.motion.time_s[-1]),
            stretch.motion.rate_hz,
        )

    @staticmethod
    def _speed(stretch: Stretch) -> Array:
        return np.abs(stretch.motion.velocity_out_rad_s * stretch.motion.ratio)

    def _add(self, torque: Array, speed: Array, end_s: float, rate_hz: float) -> None:
        self.time_s = end_s
        size = np.abs(torque)
        self._count(_Part(end_s, len(torque), float(torque @ torque), float(size.max()), float(speed.sum())), 1)
        while self._parts and self._parts[0].end_s < end_s - WINDOW_S:
            self._count(self._parts[0], -1)
        turning = speed * (speed > STILL_RAD_S) / rate_hz
        self._turned += float(turning.sum())
        self._cubed += float(turning @ (size * size * size))

    def _count(self, part: _Part, sign: int) -> None:
        """Let a part into the window (+1) or out of it (-1)."""
        if sign > 0:
            self._parts.append(part)
            while self._peaks and self._peaks[-1].torque_peak <= part.torque_peak:
                self._peaks.pop()
            self._peaks.append(part)
        else:
            if self._parts.popleft() is self._peaks[0]:
                self._peaks.popleft()
        self._samples += sign * part.samples
        self._square += sign * part.torque_square
        self._travel += sign * part.speed_sum

    def estimates(self) -> tuple[Estimate, ...]:
        """The quantities of the topic `load` that this drive's channels allow; sd of a plain mean is its scatter's."""
        n = self._samples
        status = Status.INVALID if self._lost else Status.VALID
        if n == 0:
            status = Status.WARMING_UP if not self._lost else Status.INVALID
        rms = math.sqrt(max(self._square, 0.0) / n) if n else math.nan
        peak = self._peaks[0].torque_peak if self._peaks else math.nan
        speed = self._travel / n if n else math.nan
        cubic = (self._cubed / self._turned) ** (1 / 3) if self._turned > 0 else math.nan
        cubic_status = status if self._turned > 0 else Status.NOT_EXCITED if n else status
        relative = 1 / math.sqrt(2 * len(self._parts)) if self._parts else math.nan
        t = self.time_s
        return (
            Estimate("torque_rms", rms, rms * relative, "N m", status, t),
            Estimate("torque_peak", peak, peak * relative, "N m", status, t),
            Estimate("torque_cubic_mean", cubic, cubic * relative, "N m", cubic_status, t),
            Estimate("speed_in", speed, speed * relative, "rad/s", status, t),
            *self._slow.values(),
            *self._rise(),
        )

    def _rise(self) -> tuple[Estimate, ...]:
        """Housing above the air around it, where both are measured."""
        gear, air = self._slow.get("temperature"), self._slow.get("temperature_ambient")
        if gear is None or air is None:
            return ()
        status = Status.VALID if gear.usable and air.usable else Status.INVALID
        sd = math.hypot(gear.sd, air.sd)
        return (Estimate("temperature_rise", gear.value - air.value, sd, "K", status, min(gear.time_s, air.time_s)),)

    def dump(self) -> dict[str, Any]:
        """What must outlive a restart: the service life so far."""
        return {"turned_rad": self._turned, "cubed": self._cubed}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave."""
        self._turned, self._cubed = float(state["turned_rad"]), float(state["cubed"])


class SlowMean:
    """Mean of a slow channel over a block. Its samples are one held reading, so their scatter says nothing: the sd is
    that from reading to reading, of the latest that differed (their differences over sqrt 2, so that drift counts
    little); `unknown_sd` until there are a few, as of a coarse sensor in an even room, or right after a start."""

    def __init__(self, name: str, unit: str, channel: str, unknown_sd: float) -> None:
        self.name, self.unit, self.channel = name, unit, channel
        self._readings: deque[float] = deque(maxlen=SLOW_READINGS)
        self._sd = self._unknown_sd = unknown_sd

    def update(self, block: Block) -> Estimate:
        """The estimate at the block's end; INVALID without a valid sample."""
        values = block.values[self.channel]
        good = values[block.valid(self.channel) & np.isfinite(values)]
        if not len(good):
            return Estimate(self.name, math.nan, math.nan, self.unit, Status.INVALID, block.end_s)
        if not self._readings or good[-1] != self._readings[-1]:
            self._readings.append(float(good[-1]))
            steps = np.diff(np.array(self._readings))
            if len(steps) >= FEWEST_STEPS:
                self._sd = math.sqrt(float(steps @ steps) / (2 * len(steps)))
        return Estimate(self.name, float(good.mean()), self._sd, self.unit, Status.VALID, block.end_s)
