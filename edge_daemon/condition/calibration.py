"""Raw values of one channel become SI values, with a reason for every one that must not be used.

An encoder's counter is unwrapped to a multi-turn angle. When it loses its reference (power cut in the encoder,
restart of the drive) the angle is carried on from where it was, so that one restart does not shift every later twist.
A jump that the gear itself can make, a slip by whole teeth, is marked but never corrected: it is what one looks for.
"""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.channels import CHANNELS
from edge_daemon.condition.grating import strain_line
from edge_daemon.condition.reference import Reference, Rules
from edge_daemon.config.settings import ChannelSettings
from edge_daemon.records import Array, Flags, Flaw
from edge_daemon.units import UNITS, unit_problem

MAX_RATE_RAD_S = {"theta_in_rad": 1000.0, "theta_out_rad": 50.0}
"""An angle without a configured `max_rate` moves no faster (guess: the fastest catalogue input is 8500 rpm = 890 rad/s,
and the lowest ratio of a strain wave gear is 30)."""
OTHER_ANGLE_RAD_S = 1000.0
SMALLEST_RESET_OUT_RAD = 0.11
"""A reset is larger than the coarsest tooth pitch, 2 pi / 60 teeth at ratio 30: a slip by one tooth must stay
visible."""
MOVED_RAD = {"theta_in_rad": 0.1, "theta_out_rad": 1e-3}
"""An angle that has changed by this has moved (guess: 0.1 rad of input is some tens of steps of a 17-bit output encoder
behind 100:1)."""
OTHER_MOVED_RAD = 0.1
STEPS_MOVED = 100.0
"""An angle that does not come in counts is read in this part of what counts as motion: 1e-5 rad at the output, a few
steps of a 20-bit encoder (guess)."""
LEAPS = {"temperature_degC": (5.0, 0.2), "temperature_ambient_degC": (5.0, 0.2)}
"""A housing's temperature changes by no more at once than the first [K], and then by the second in a second: kilograms
of metal (guess)."""
FROZEN_ANGLE_S = 0.5
"""An angle without a configured `frozen_after_s` may stand still for this long (guess: a reversal holds an output
encoder for less)."""


class Calibration:
    """Stateful: readings must be handed over in order of time, each once. Raises `ValueError` for a wrong unit."""

    def __init__(self, row: ChannelSettings, rate_hz: float) -> None:
        problem = "" if row.counts_per_turn else unit_problem(row.unit, row.channel)
        if problem:
            raise ValueError(f"{row.channel}: unit: {problem}")
        self._row = row
        known = CHANNELS.get(row.channel)
        self.angle = row.counts_per_turn is not None or (known is not None and known.angle)
        self._gain, self._bias = _line(row)
        self._reference = Reference(_rules(row, self.angle, self._gain, 1.0 / rate_hz))
        self.frozen_after_s = row.frozen_after_s or (FROZEN_ANGLE_S if self.angle else None)
        """None: a value that stands still is none of this channel's flaws"""
        self._leap = LEAPS.get(row.channel)
        self._believed = (math.nan, math.nan)
        """when and what was last measured that can be"""
        self._changed_s = math.nan
        self._anchor = math.nan
        self._moves = MOVED_RAD.get(row.channel, OTHER_MOVED_RAD)
        self.step = (abs(self._gain) if row.counts_per_turn else self._moves / STEPS_MOVED) if self.angle else math.inf
        """how finely an angle is read [rad]; inf for another channel"""
        self.moved_s = -math.inf
        """when this angle was last seen to have moved; -inf: never, or not an angle"""

    @property
    def gain(self) -> float:
        """SI per raw unit, sign included."""
        return self._gain

    @property
    def resets(self) -> int:
        """How often the counter lost its reference so far, lost turns in a gap included."""
        return self._reference.resets

    @property
    def jumps(self) -> tuple[int, float]:
        """How often the value jumped further than its rate allows and stayed, and the newest such jump [SI]."""
        return self._reference.jumps, self._reference.newest_jump * self._gain

    def apply(
        self, time_s: Array, raw: Array, ahead: tuple[Array, Array] | None = None, moved_s: float = -math.inf
    ) -> tuple[Array, Flags]:
        """(n,) SI values and (n,) flaws of n >= 1 readings with ascending times.

        `ahead`: times and raw values that have arrived already but are handed over later; they tell a glitch from a
        reset. `moved_s`: when another angle of the drive last moved.
        """
        good = np.isfinite(raw)
        if np.count_nonzero(good) == len(raw):
            return self._apply(time_s, raw, ahead, moved_s)
        values = np.full(len(raw), math.nan)
        flaws = np.full(len(raw), int(Flaw.DEVICE), dtype=np.uint8)
        if good.any():
            values[good], flaws[good] = self._apply(time_s[good], raw[good], ahead, moved_s)
        return values, flaws

    def _apply(
        self, time_s: Array, raw: Array, ahead: tuple[Array, Array] | None, moved_s: float
    ) -> tuple[Array, Flags]:
        flaws = np.zeros(len(raw), dtype=np.uint8)
        before = self._reference.raw
        total = self._reference.follow(time_s, raw, flaws, ahead)
        values = total * self._gain
        if self._bias:
            values += self._bias
        self._mark_range(values, flaws)
        if self._leap is not None:
            self._mark_leaps(time_s, values, flaws, *self._leap)
        if self.frozen_after_s is not None:
            self._mark_frozen(time_s, raw, before, flaws, moved_s, self.frozen_after_s)
        if self.angle:
            self._notice_motion(time_s, values)
        return values, flaws

    def _mark_range(self, values: Array, flaws: Flags) -> None:
        minimum, maximum = self._row.minimum, self._row.maximum
        if minimum is not None and values[values.argmin()] < minimum:
            flaws[values < minimum] |= np.uint8(Flaw.RANGE)
        if maximum is not None and values[values.argmax()] > maximum:
            flaws[values > maximum] |= np.uint8(Flaw.RANGE)

    def _mark_leaps(self, time_s: Array, values: Array, flaws: Flags, slack: float, rate: float) -> None:
        """What the thing that is measured cannot do; the longer it lasts, the more it may have done."""
        for i, (at_s, value) in enumerate(zip(time_s.tolist(), values.tolist(), strict=True)):
            before_s, before = self._believed
            if abs(value - before) > slack + rate * (at_s - before_s):
                flaws[i] |= np.uint8(Flaw.RATE)
            elif not flaws[i]:
                self._believed = (at_s, value)

    def _mark_frozen(
        self, time_s: Array, raw: Array, before: float, flaws: Flags, moved_s: float, after_s: float
    ) -> None:
        """Frozen: unchanged for `after_s`, and the drive has moved since the last change."""
        if math.isnan(self._changed_s):
            self._changed_s = float(time_s[0])
        if len(raw) > 1 and raw[-1] != raw[-2] and time_s[-1] - self._changed_s <= after_s:
            self._changed_s = float(time_s[-1])  # the usual case: it moves, nothing to look for
            return
        changed = np.empty(len(raw), dtype=bool)
        changed[0] = raw[0] != before
        np.not_equal(raw[1:], raw[:-1], out=changed[1:])
        newest = np.maximum.accumulate(np.where(changed, np.arange(len(raw)), -1))
        since_s = np.where(newest >= 0, time_s[newest], self._changed_s)
        self._changed_s = float(since_s[-1])
        flaws[(time_s - since_s > after_s) & (since_s < moved_s)] |= np.uint8(Flaw.FROZEN)

    def _notice_motion(self, time_s: Array, values: Array) -> None:
        if math.isnan(self._anchor):
            self._anchor = float(values[0])
        for index in (len(values) // 2, -1):
            if abs(values[index] - self._anchor) > self._moves:
                self._anchor = float(values[index])
                self.moved_s = float(time_s[index])


def _line(row: ChannelSettings) -> tuple[float, float]:
    """Gain and bias from raw to SI, sign included."""
    if row.counts_per_turn is not None:
        gain, bias = 2 * math.pi / row.counts_per_turn, row.offset
    elif row.unit == "SI":
        gain, bias = row.scale, row.offset
    else:
        unit = UNITS[row.unit]
        gain, bias = row.scale * unit.factor, row.offset * unit.factor + unit.offset
    if row.grating_nm is not None:
        per_nm, at_0 = strain_line(row.grating_nm)
        gain, bias = gain * per_nm, bias + gain * at_0
    return (-gain, -bias) if row.reverse else (gain, bias)


def _rules(row: ChannelSettings, angle: bool, gain: float, period_s: float) -> Rules:
    rate = row.max_rate
    if rate is None:
        rate = MAX_RATE_RAD_S.get(row.channel, OTHER_ANGLE_RAD_S) if angle else math.inf
    per_raw = abs(gain) or 1.0
    return Rules(
        period_s=period_s,
        raw_per_rad=1.0 / per_raw,
        rate=rate / per_raw,
        smallest_reset=(SMALLEST_RESET_OUT_RAD if row.channel == "theta_out_rad" else 0.0) / per_raw,
        wrap=row.wrap_counts,
        follows=angle,
        whole=row.counts_per_turn is not None,
    )
