"""Shapes of a law tracked live: where friction falls from rest to motion, how wide a hysteresis or a gap is.

The amplitude filter learns shapes too where the gear is simulated (`law_prediction`), from a value that is nearly
right, and holds them elsewhere; here they are searched for. Windows of motion are gathered from the same stretches
and predicted at the sigma points of an unscented filter (`shape_filter`, `shape_laws`) that holds the amplitudes with
them, so that shape and amplitude do not fight. At first every window counts; a shape that is known moves no faster
than a gear wears or warms, and is looked at now and then: that is what keeps it cheap. What is found goes back into
the columns of the amplitude filter, by a small step at a time.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge_daemon.motion.regressors import STIFFNESS
from edge_daemon.motion.streaming import Stretch
from edge_daemon.motion.window import LEAD, Window, window_of
from edge_daemon.records import Estimate, Status
from edge_daemon.track.shape_filter import SHOCK, ShapeFilter
from edge_daemon.track.shape_laws import Law, Tracked, law_of
from edge_daemon.track.tracking import BalanceTracker

WINDOW_S = 2.0
CHOICE = 6
"""The best of several starts stays after so many windows."""
LIGHTLY = 2.0
"""Behind the light filter about so many times the noise behind the balance filter is left."""
REOPENED = 0.3
"""The best start is given back this share of the first doubt then: far from the truth it learned too much too soon."""
SETTLED = 12
"""Nothing is valid before so many windows."""
LEARNING = 15
"""So many windows come in a row, before rests come in between."""
REST_S = 120.0
"""Between windows this long passes once a shape is known: a sixtieth of the time, for what moves by a per cent
meanwhile."""
KNOWN_BELOW, LOST_ABOVE = 0.2, 0.3
"""A shape turns valid at the first sd of its logarithm, and stays so up to the second."""
KNOWN = 2.0
"""A stiffness of this many sd is good enough to begin with: a wrong shape may well be what it is in doubt of."""
BROKEN = 5
"""After so many windows in a row that are shocks the search is new: one shock passes."""
STEP = 0.05
"""A shape moves at most so much in the columns of the amplitude filter after a window, once it has gone there."""

DISAGREES = 3.0
"""Two estimates of one shape differ beyond so many of their sd."""


class ShapeWatch:
    """One shape of one drive; `rest_s` passes between windows once the shape is known."""

    def __init__(self, tracked: Tracked, law: Law, rest_s: float = REST_S) -> None:
        self._tracked, self._law, self._rest_s = tracked, law, rest_s
        self._filters: list[ShapeFilter] = []
        self._windows = self._shocks = 0
        self._gathered: list[Stretch] = []
        self._length_s = self._resting_s = self._elapsed_s = 0.0
        self._valid = self._restored = False
        self._held = math.nan
        """the shape in the amplitude filter's columns; NaN as long as it is the model's"""
        self._time_s = math.nan
        self._path_rad = 0.0

    def update(self, stretch: Stretch | None, duration_s: float, tracker: BalanceTracker) -> None:
        """Gather what a block of `duration_s` completed; a full window is learned from."""
        self._elapsed_s += duration_s
        if self._restored:
            tracker.reshape(self._tracked.effect.name, self._tracked.shape.name, self._held)
            self._restored = False
        if self._tracked.effect.state_quantity:
            self._follow_path(stretch)
        self._resting_s = max(self._resting_s - duration_s, 0.0)
        if stretch is None or not self._usable(stretch, tracker):
            self._gathered, self._length_s = [], 0.0
            return
        self._length_s += duration_s * bool(self._gathered)
        self._gathered.append(stretch)
        if self._length_s > WINDOW_S - duration_s / 2:
            self._learn(window_of(self._gathered), tracker)
            self._gathered, self._length_s = self._gathered[-1:], 0.0

    def _follow_path(self, stretch: Stretch | None) -> None:
        """Twist gone through since the state began at nought."""
        if stretch is None or stretch.fresh:
            self._path_rad = 0.0
        elif stretch.arguments is not None:
            twist = stretch.motion.twist_rad
            self._path_rad += float(np.abs(twist[1:] - twist[:-1]).sum())

    def _usable(self, stretch: Stretch, tracker: BalanceTracker) -> bool:
        if self._resting_s > 0 or stretch.arguments is None or len(stretch.arguments.motion) < LEAD:
            return False
        filt, i = tracker.filter, tracker.regressors.index(*STIFFNESS)
        if tracker.error_status is not Status.VALID or filt is None or i is None:
            return False
        if not filt.value[i] > KNOWN * filt.sd[i]:
            return False
        follows = not self._gathered or not (stretch.fresh or _size(stretch) != _size(self._gathered[-1]))
        return follows and bool(stretch.valid.all())

    def _learn(self, window: Window, tracker: BalanceTracker) -> None:
        if not self._filters:
            self._filters = self._law.starts(window, tracker)
            self._windows, self._elapsed_s = 0, window.seconds
        shocks = [self._take(row, window, tracker) > SHOCK for row in self._filters]
        self._windows, self._elapsed_s = self._windows + 1, 0.0
        self._time_s = float(window.stretches[-1].motion.time_s[-1])
        self._shocks = self._shocks + 1 if all(shocks) else 0
        self._filters = [row for row in self._filters if row.sound and self._shocks < BROKEN]
        if not self._filters:
            self._valid, self._shocks, self._windows = False, 0, 0
            return
        if self._shocks:
            return
        if self._windows >= CHOICE and len(self._filters) > 1:
            self._filters = [min(self._filters, key=lambda row: row.newest_sd)]
            self._filters[0].reopen(REOPENED)
        if self._windows >= LEARNING:
            self._resting_s = self._rest_s
        limit = LOST_ABOVE if self._valid else KNOWN_BELOW
        seen = self._law.excited(self._filters[0].value)
        self._valid = self._windows >= SETTLED and seen and self._sd < limit
        if self._valid:
            self._apply(tracker)

    def _take(self, row: ShapeFilter, window: Window, tracker: BalanceTracker) -> float:
        found = self._law.rows(window, row.sigmas(self._elapsed_s), tracker)
        return row.update(found.seen, found.predicted, found.nuisance, found.bandwidth)

    def _apply(self, tracker: BalanceTracker) -> None:
        """Move the shape in the amplitude filter's columns: there at once when it is first known, then by steps. A
        filter that learns it as well is only told where the two disagree: alone it may begin too far from the truth."""
        place = self._tracked.effect.name, self._tracked.shape.name
        now, sd = tracker.shape(*place)
        moved = math.log(self._value / now)
        if math.isfinite(sd) and abs(moved) < DISAGREES * math.hypot(sd, self._sd):
            return
        if math.isfinite(self._held):
            moved = min(max(moved, -STEP), STEP)
        self._held = now * math.exp(moved)
        tracker.reshape(*place, self._held, min(abs(moved), 1.0), self._sd)

    @property
    def _value(self) -> float:
        return math.exp(float(self._filters[0].value[0]))

    @property
    def _sd(self) -> float:
        """Of its logarithm."""
        return math.hypot(float(self._filters[0].sd[0]), self._law.errs)

    def estimates(self, tracker: BalanceTracker) -> tuple[Estimate, ...]:
        """The shape, and the state of a Bouc-Wen hysteresis; NaN before the shape was known."""
        row, status = self._tracked, tracker.error_status
        value = sd = math.nan
        if self._windows < SETTLED or not self._filters:
            status = Status.WARMING_UP if status is Status.VALID else status
        elif self._valid or math.isfinite(self._held):
            value, sd = self._value, self._value * self._sd
        if status is Status.VALID and not self._valid:
            status = Status.NOT_EXCITED
        shape = Estimate(row.shape.quantity, value, sd, row.shape.unit, status, self._time_s)
        return (shape,) if not row.effect.state_quantity else (shape, self._state(tracker, shape))

    def _state(self, tracker: BalanceTracker, width: Estimate) -> Estimate:
        """Where the hysteresis stands in its loop now, -1 to 1: what its columns carry. Its beginning, which nobody
        knows, is forgotten over the path; noise of the twist moves it as it moves the twist."""
        state, time_s = tracker.remembered(self._tracked.effect.name)
        if not math.isfinite(state + width.value) or not self._filters:
            return Estimate(self._tracked.effect.state_quantity, math.nan, math.nan, "1", width.status, time_s)
        forgotten = math.exp(-self._path_rad / width.value)
        noise = LIGHTLY * math.sqrt(tracker.twist_noise_rad2) / width.value
        held = math.log(tracker.shape(self._tracked.effect.name, self._tracked.shape.name)[0] / width.value)
        wrong = self._law.spread / float(self._filters[0].sd[0]) * math.hypot(self._sd, held)
        sd = math.sqrt(wrong**2 + forgotten**2 + noise**2)
        return Estimate(self._tracked.effect.state_quantity, state, sd, "1", width.status, time_s)

    def dump(self) -> dict[str, Any]:
        """What was learned, as plain data; `load` takes it back."""
        done = self._windows >= SETTLED and len(self._filters) == 1
        return {
            "filter": self._filters[0].dump() if done else None,
            "windows": self._windows if done else 0,
            "valid": self._valid,
            "held": self._held if math.isfinite(self._held) else None,
            "time_s": self._time_s if math.isfinite(self._time_s) else None,
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave. Raises KeyError, TypeError or ValueError when it does not fit."""
        self._filters = [ShapeFilter.load(state["filter"])] if state["filter"] is not None else []
        self._windows, self._valid = int(state["windows"]), bool(state["valid"])
        self._held = math.nan if state["held"] is None else float(state["held"])
        self._restored = math.isfinite(self._held)
        self._time_s = math.nan if state["time_s"] is None else float(state["time_s"])


def _size(stretch: Stretch) -> int:
    return stretch.arguments.fresh if stretch.arguments is not None else 0


def shape_watch(tracker: BalanceTracker, torque_measured: bool) -> ShapeWatch | None:
    """What tracks a shape of this drive's model; None where it has none that can be tracked: nothing is spent."""
    found = law_of(tracker.model, torque_measured)
    return ShapeWatch(*found) if found is not None else None
