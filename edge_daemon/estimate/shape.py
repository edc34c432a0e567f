"""Shapes of a law tracked live: where friction falls from rest to motion, how wide a hysteresis or a gap is.

The amplitude filter (`recursive`) holds them; here they move. Windows of motion are gathered from the same stretches
and predicted at the sigma points of an unscented filter (`shape_filter`, `shape_laws`) that holds the amplitudes with
them, so that shape and amplitude do not fight. At first every window counts; a shape that is known moves no faster
than a gear wears or warms, and is looked at now and then: that is what keeps it cheap. What is found goes back into
the columns of the amplitude filter, by a small step at a time.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge_daemon.estimate.shape_filter import ShapeFilter
from edge_daemon.estimate.shape_laws import Law, Tracked, law_of
from edge_daemon.estimate.streaming import Stretch
from edge_daemon.estimate.tracking import BalanceTracker
from edge_daemon.estimate.window import LEAD, Window, window_of
from edge_daemon.records import Estimate, Status

WINDOW_S = 2.0
CHOICE = 6
"""windows after which the best of several starts stays"""
REOPENED = 0.3
"""share of the first doubt that the best start is given back then: far from the truth it learned too much too soon"""
LEARNING = 15
"""windows in a row, before rests come in between"""
REST_S = 90.0
"""between windows once a shape is known: a fiftieth of the time, for what moves by a per cent meanwhile"""
KNOWN_BELOW, LOST_ABOVE = 0.2, 0.3
"""sd of the shape's logarithm at which it turns valid, and up to which it stays so"""
SHOCK, BROKEN = 3.0, 5
"""a window with this many times the usual noise counts as a shock; so many of them in a row, and the search is new"""
STEP = 0.05
"""most that a shape moves in the columns of the amplitude filter after a window, once it has gone there"""
GIVEN_BACK = 0.01
"""share of the prior variance that the law's amplitudes are given back when it goes there at once"""


class ShapeWatch:
    """One shape of one drive; `rest_s` passes between windows once the shape is known."""

    def __init__(self, tracked: Tracked, law: Law, rest_s: float = REST_S) -> None:
        self._tracked, self._law, self._rest_s = tracked, law, rest_s
        self._filters: list[ShapeFilter] = []
        self._noises: list[float] = []
        self._windows = self._shocks = 0
        self._gathered: list[Stretch] = []
        self._length_s = self._resting_s = self._elapsed_s = 0.0
        self._valid = self._applied = False
        self._time_s = math.nan

    def update(self, stretch: Stretch | None, duration_s: float, tracker: BalanceTracker) -> None:
        """Gather what a block of `duration_s` completed; a full window is learned from."""
        self._elapsed_s += duration_s
        self._resting_s = max(self._resting_s - duration_s, 0.0)
        if stretch is None or not self._usable(stretch, tracker):
            if self._gathered:
                self._gathered, self._length_s = [], 0.0
                self._law.forget()
            return
        self._length_s += duration_s * bool(self._gathered)
        self._gathered.append(stretch)
        if self._length_s > WINDOW_S - duration_s / 2:
            self._learn(window_of(self._gathered), tracker)
            self._gathered, self._length_s = self._gathered[-1:], 0.0

    def _usable(self, stretch: Stretch, tracker: BalanceTracker) -> bool:
        if self._resting_s > 0 or stretch.arguments is None or len(stretch.arguments.motion) < LEAD:
            return False
        if tracker.error_status is not Status.VALID or not math.isfinite(tracker.stiffness):
            return False
        return bool(stretch.valid.all()) and not (stretch.fresh and self._gathered)

    def _learn(self, window: Window, tracker: BalanceTracker) -> None:
        if not self._filters:
            self._filters = self._law.starts(window, tracker)
            self._windows, self._elapsed_s = 0, window.seconds
        noises = [self._take(row, window, tracker) for row in self._filters]
        self._windows, self._elapsed_s = self._windows + 1, 0.0
        self._time_s = float(window.stretches[-1].motion.time_s[-1])
        if self._windows >= CHOICE and len(noises) > 1:
            self._filters = [self._filters[noises.index(min(noises))]]
            self._filters[0].reopen(REOPENED)
        self._filters = [row for row in self._filters if row.sound]
        self._watch(min(noises))
        if not self._filters:
            return
        if self._windows >= LEARNING:
            self._resting_s = self._rest_s
        limit = LOST_ABOVE if self._valid else KNOWN_BELOW
        self._valid = self._windows >= CHOICE and self._filters[0].sd[0] < limit
        if self._valid:
            self._apply(tracker)

    def _take(self, row: ShapeFilter, window: Window, tracker: BalanceTracker) -> float:
        found = self._law.rows(window, row.sigmas(self._elapsed_s), tracker)
        return row.update(found.seen, found.predicted, found.nuisance, found.bandwidth)

    def _watch(self, noise_sd: float) -> None:
        """A law that no longer fits is searched for anew; one shock passes."""
        usual = self._filters[0].noise_sd if self._filters else math.nan
        self._shocks = self._shocks + 1 if noise_sd > SHOCK * usual else 0
        if self._shocks >= BROKEN:
            self._filters, self._valid, self._shocks = [], False, 0

    def _apply(self, tracker: BalanceTracker) -> None:
        """Move the shape in the amplitude filter's columns: there at once when it is first known, then by steps."""
        row, regressors, filt = self._tracked, tracker.regressors, tracker.filter
        share = self._value / regressors.shape(row.effect, row.shape)
        if not self._applied and filt is not None:
            own = [GIVEN_BACK * (key[0] == row.effect) for key in regressors.keys]
            filt.forget(np.array(own))
        elif self._applied:
            share = min(max(share, 1 - STEP), 1 + STEP)
        regressors.reshape(row.effect, row.shape, share * regressors.shape(row.effect, row.shape))
        self._applied = True

    @property
    def _value(self) -> float:
        return math.exp(float(self._filters[0].value[0]))

    def estimates(self, tracker: BalanceTracker) -> tuple[Estimate, ...]:
        """The shape; NaN before it was known."""
        row, status = self._tracked, tracker.error_status
        if self._windows < CHOICE or not self._filters:
            status = Status.WARMING_UP if status is Status.VALID else status
            return (Estimate(row.quantity, math.nan, math.nan, row.unit, status, self._time_s),)
        sd = math.hypot(float(self._filters[0].sd[0]), row.errs)
        if status is Status.VALID and not self._valid:
            status = Status.NOT_EXCITED
        value = self._value if self._valid or self._applied else math.nan
        return (Estimate(row.quantity, value, value * sd, row.unit, status, self._time_s),)

    def dump(self) -> dict[str, Any]:
        """What was learned, as plain data; `load` takes it back."""
        done = self._windows >= CHOICE and len(self._filters) == 1
        return {
            "filter": self._filters[0].dump() if done else None,
            "windows": self._windows if done else 0,
            "valid": self._valid,
            "time_s": self._time_s if math.isfinite(self._time_s) else None,
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave. Raises KeyError, TypeError or ValueError when it does not fit."""
        self._filters = [ShapeFilter.load(state["filter"])] if state["filter"] is not None else []
        self._windows, self._valid = int(state["windows"]), bool(state["valid"])
        self._time_s = math.nan if state["time_s"] is None else float(state["time_s"])


def shape_watch(tracker: BalanceTracker, torque_measured: bool) -> ShapeWatch | None:
    """What tracks a shape of this drive's model; None where it has none that can be tracked: nothing is spent."""
    found = law_of(tracker.model, torque_measured)
    return ShapeWatch(*found) if found is not None else None
