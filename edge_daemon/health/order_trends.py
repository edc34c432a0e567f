"""Whether what repeats with an angle has grown since commissioning: teeth that wear, a disc or a wave generator that
comes off centre.

A wave is no logarithm away from nothing: a tooth's starts in the noise. Its size is therefore counted in units of what
it was while the drive was commissioned, and of no less than what noise and the gear as a whole make of it; what it
gains on that is watched as every other condition is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec
import numpy as np

from edge_daemon.health.alarms import Finding
from edge_daemon.health.control_chart import (
    BATCH,
    FALSE_ALARMS_PER_YEAR,
    HOURS_PER_YEAR,
    RECENT,
    WINDOW_H,
    Chart,
    freeze,
    judge,
    regressors,
    threshold,
)
from edge_daemon.health.trends import COMMISSION_H, state_of
from edge_daemon.records import NE107, Estimate
from edge_daemon.usage.gears import Gear

GROWN = 0.5
"""A wave that is larger by half is worth telling (guess)."""
NOISE_SD = 3.0
"""A wave of fewer deviations may be noise, and counts as one of so many."""
LITTLE = 0.02
"""A wave of less than this share of what it is part of does no harm, and counts as one of this share (guess)."""
WHOLE = {"rad": "kinematic_error", "N m/rad": "stiffness", "N m": "torque_rms"}
"""What a wave of each unit is part of."""
TOLD = 3
"""So many waves that have grown most are told."""


class _Wave(msgspec.Struct):
    """One wave since it was first seen."""

    chart: Chart
    meaning: str
    size: float = math.nan
    """the unit it is counted in; NaN while the drive is commissioned"""
    least: list[float] = msgspec.field(default_factory=list)
    """of each window of commissioning, the size below which it counts for nothing"""


class _State(msgspec.Struct):
    key: tuple[str, str]
    waves: dict[str, _Wave]
    sums: dict[str, tuple[float, float, float]]
    hours: float
    observed_h: float
    changed_h: float


class OrderWatch:
    """`update` with every block's estimates; `findings` go to the health judge."""

    def __init__(self, drive: str, gear: Gear | None = None, commission_h: float = COMMISSION_H) -> None:
        self.drive, self.gear, self.commission_h = drive, gear, commission_h
        self._waves: dict[str, _Wave] = {}
        self._sums: dict[str, tuple[float, float, float]] = {}
        """of value and sd, and the hours of them"""
        self._hours = self._observed_h = 0.0
        self._changed_h = math.nan

    def update(self, hours: float, estimates: Mapping[str, Estimate], orders: Mapping[str, str]) -> None:
        """Take in estimates that held for `hours`; `orders`: what each wave among them is. Unusable ones do not
        count."""
        self._hours += hours
        for name in (*orders, *WHOLE.values(), "temperature", "speed_in"):
            found = estimates.get(name)
            if found is not None and found.usable:
                value, sd, weight = self._sums.get(name, (0.0, 0.0, 0.0))
                self._sums[name] = (value + found.value * hours, sd + found.sd * hours, weight + hours)
        if self._hours >= WINDOW_H:
            self._close_window({name: estimates[name].unit for name in orders if name in estimates}, orders)

    def model_changed(self) -> None:
        """Another model sees other waves in the same gear: they get a baseline anew."""
        self._waves, self._sums = {}, {}
        self._changed_h = self._observed_h

    def _close_window(self, units: Mapping[str, str], orders: Mapping[str, str]) -> None:
        means = {name: (value / weight, sd / weight) for name, (value, sd, weight) in self._sums.items() if weight > 0}
        self._observed_h += self._hours
        self._hours, self._sums = 0.0, {}
        state = state_of({name: value for name, (value, _) in means.items()}, self.gear)
        for name, unit in units.items():
            if name not in means:
                continue
            value, sd = means[name]
            wave = self._waves.setdefault(name, _Wave(Chart(), orders[name]))
            if math.isnan(wave.size):
                whole = means.get(WHOLE.get(unit, ""), (0.0, 0.0))[0]
                wave.least.append(max(NOISE_SD * sd, LITTLE * abs(whole)))
                self._commission(wave, (*state, value))
            else:
                x = regressors(np.array([state]))[0]
                judge(wave.chart, GROWN, x, value / wave.size, self._limit)

    def _commission(self, wave: _Wave, row: tuple[float, float, float, float]) -> None:
        rows = wave.chart.rows
        rows.append(row)
        if len(rows) * WINDOW_H >= self.commission_h:
            wave.size = max(float(np.median([value for *_, value in rows])), float(np.median(wave.least)), 1e-300)
            wave.chart.rows = [(warm, load, speed, value / wave.size) for warm, load, speed, value in rows]
            freeze(wave.chart)
            wave.least = []

    @property
    def _limit(self) -> float:
        """All waves together raise as many false alarms as all conditions do."""
        return threshold(FALSE_ALARMS_PER_YEAR, HOURS_PER_YEAR / (WINDOW_H * BATCH), 2 * max(len(self._waves), 1))

    def growth(self) -> dict[str, tuple[float, float]]:
        """Wave -> (by how many times its size of commissioning it is larger, sd), of those that have grown."""
        found = {}
        for name, wave in self._waves.items():
            recent = wave.chart.recent[-min(max(wave.chart.moving, 1), RECENT) :]
            if wave.chart.drifted and np.mean(recent) > 0.0:
                found[name] = (float(np.mean(recent)), wave.chart.batch_sd / math.sqrt(len(recent)))
        return found

    def findings(self) -> tuple[Finding, ...]:
        """What has grown, in one finding."""
        grown = sorted(self.growth().items(), key=lambda row: -row[1][0])
        told = ", ".join(f"{self._waves[name].meaning} {by:+.0%} (± {sd:.0%})" for name, (by, sd) in grown[:TOLD])
        since = "commissioning" if math.isnan(self._changed_h) else f"the model changed at {self._changed_h:.0f} h"
        text = f"grown since {since}: {told}; inspect what repeats so, teeth, bearing or the discs of the encoders"
        return (Finding("orders", NE107.MAINTENANCE_REQUIRED, bool(grown), bool(grown), text, latching=True),)

    def state(self) -> bytes:
        """Everything that `restore` needs."""
        key = (self.drive, self.gear.name if self.gear else "")
        saved = _State(key, self._waves, self._sums, self._hours, self._observed_h, self._changed_h)
        return msgspec.msgpack.encode(saved)

    def restore(self, blob: bytes) -> bool:
        """True if taken over; False, and nothing changed, if broken or of another drive or gear."""
        try:
            saved = msgspec.msgpack.decode(blob, type=_State)
        except msgspec.MsgspecError:
            return False
        if saved.key != (self.drive, self.gear.name if self.gear else ""):
            return False
        self._waves, self._sums, self._hours = saved.waves, saved.sums, saved.hours
        self._observed_h, self._changed_h = saved.observed_h, saved.changed_h
        return True
