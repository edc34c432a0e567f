"""Where a counter counts from: roll-over, lost turns, glitches, resets.

Works in raw units, so that sums of counts stay whole numbers and an angle is exactly counts times the size of a count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.condition.alignment import largest
from edge_daemon.records import Array, Flags, Flaw

GLITCH_SAMPLES = 3
"""A jump that is back within so many samples was a glitch, not a reset (guess: a corrupted frame or two)."""
RESET_MARGIN = GLITCH_SAMPLES + 1.0
"""A loss of reference jumps this many times further than `max_rate` allows; less cannot be told from a glitch."""
GUARD_SAMPLES = 2
"""So many samples on each side of a reset are not trusted (guess)."""
JUMPS_PER_CALL = 32
"""So many jumps are looked at one by one; more in one stretch are noise, and all are marked."""
SPEED_SAMPLES = 16
"""The speed that bridges a reset or a gap is told from so many samples (guess)."""
GAP_PERIODS = 1.5
"""Something is missing between neighbours further apart than this many periods."""
ACCELERATION_RAD_S2 = 2e4
"""No larger acceleration is believed, which bounds how far the speed tells turns (guess: 1 N m on 5e-5 kg m2, a small
servo at its peak)."""


@dataclass(frozen=True, slots=True)
class Rules:
    """What a channel may do, in raw units."""

    period_s: float
    """nominal distance of readings"""
    raw_per_rad: float
    rate: float
    """largest believable change per second; inf: any"""
    smallest_reset: float
    """a smaller jump is never taken for a reset"""
    wrap: float | None
    """the counter rolls over at this"""
    follows: bool
    """an angle: carried on after a reset"""
    whole: bool
    """raw values are whole counts"""

    @property
    def quiet(self) -> float:
        """A step up to this, one period after the last, is plausible and no roll-over."""
        return min(self.rate * self.period_s, math.inf if self.wrap is None else self.wrap / 2)


@dataclass(slots=True)
class _Stretch:
    """The readings of one call, (n,) each; `steps`, `shift` and `flaws` are edited while they are looked at."""

    time_s: Array
    raw: Array
    steps: Array
    """from the reading before, roll-overs taken off"""
    shift: Array
    """what each reading adds to the running origin"""
    flaws: Flags
    ahead: tuple[Array, Array] | None
    """time and value of readings that will follow, as far as they are known"""
    last_s: float
    last: float
    """the newest trusted reading before"""

    def before(self, index: int) -> tuple[float, float]:
        """Time and value of the reading before one."""
        return (self.last_s, self.last) if index == 0 else (float(self.time_s[index - 1]), float(self.raw[index - 1]))

    def after(self, index: int) -> tuple[Array, Array]:
        """Times and values of those within which a glitch is over."""
        later = slice(index + 1, index + 1 + GLITCH_SAMPLES)
        time_s, raw = self.time_s[later], self.raw[later]
        if self.ahead is None:
            return time_s, raw
        missing = GLITCH_SAMPLES - len(raw)
        return np.concatenate((time_s, self.ahead[0][:missing])), np.concatenate((raw, self.ahead[1][:missing]))

    def mark(self, first: int, end: int, flaw: Flaw) -> None:
        """From `first` up to, not including, `end`."""
        self.flaws[max(first, 0) : end] |= np.uint8(flaw)


class Reference:
    """Adds to a counter what roll-overs and resets took away. `raw` is the newest trusted reading, NaN at first."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._quiet = rules.quiet
        self._time_s = math.nan
        self.raw = math.nan
        self._origin = 0.0
        self._speed = 0.0
        self._doubtful = 0
        self._guard = 0
        self.resets = 0
        self.jumps = 0
        """steps further than the rate allows that stayed and were kept: the gear may have made them"""
        self.newest_jump = 0.0

    def follow(self, time_s: Array, raw: Array, flaws: Flags, ahead: tuple[Array, Array] | None) -> Array:
        """(n,) raw values on the continued scale; marks RATE and RESET in `flaws`."""
        if math.isnan(self.raw):
            self.raw, self._time_s = float(raw[0]), float(time_s[0]) - self._rules.period_s
        was_guarded = self._guard > 0
        if was_guarded:
            flaws[: self._guard] |= np.uint8(Flaw.RESET)
            self._guard = max(self._guard - len(raw), 0)
        gapless = self._no_gap(time_s)
        if gapless and self._is_quiet(raw):  # nearly always
            total = raw + self._origin if self._origin else raw
            self._remember(time_s, raw, None, len(raw) - 1, was_guarded)
            return total
        steps = np.diff(raw, prepend=self.raw)
        shift = self._rolls(steps)
        trusted = len(raw) - 1
        if not gapless or largest(steps) > self._quiet:  # more than a roll-over
            trusted = self._judge(_Stretch(time_s, raw, steps, shift, flaws, ahead, self._time_s, self.raw))
        total = raw + (np.cumsum(shift) + self._origin)
        if trusted >= 0:
            self._origin += float(shift[: trusted + 1].sum())
            self._remember(time_s, raw, steps, trusted, bool(flaws.any()))
        else:
            self._doubtful += len(raw)
        return total

    def _is_quiet(self, raw: Array) -> bool:
        """True where no step is a jump or a roll-over."""
        if abs(float(raw[0]) - self.raw) > self._quiet:
            return False
        return len(raw) == 1 or largest(raw[1:] - raw[:-1]) <= self._quiet

    def _rolls(self, steps: Array) -> Array:
        """(n,) what roll-overs add to the running origin; taken off the steps."""
        wrap = self._rules.wrap
        if wrap is None:
            return np.zeros_like(steps)
        rolls: Array = np.rint(steps / wrap) * -wrap
        steps += rolls
        return rolls

    def _no_gap(self, time_s: Array) -> bool:
        """True where no gap can hide a turn."""
        rules = self._rules
        return rules.wrap is None or bool(time_s[-1] - self._time_s < (len(time_s) + 0.5) * rules.period_s)

    def _judge(self, on: _Stretch) -> int:
        """Settles gaps and jumps one by one; the index of the last reading that can be trusted, -1 for none."""
        rules, last = self._rules, len(on.raw) - 1
        dt_s = np.diff(on.time_s, prepend=on.last_s)
        if rules.wrap is not None:
            self._bridge(on, dt_s, rules.wrap)
        jumps = np.flatnonzero(np.abs(on.steps) > rules.rate * np.maximum(dt_s, rules.period_s))
        if not rules.follows or len(jumps) > JUMPS_PER_CALL:
            on.flaws[jumps] |= np.uint8(Flaw.RATE)
            return last
        settled = -1
        for jump in jumps.tolist():
            if jump <= settled:
                continue
            settled = self._settle(on, jump)
            if settled < 0:
                return int(jump) - 1
        return last

    def _settle(self, on: _Stretch, jump: int) -> int:
        """The index up to which the jump is explained; -1 where only later readings can tell."""
        back = self._returns(on, jump)
        if back is not None:
            return self._glitch(on, jump, back)
        known = len(on.raw) - jump + (0 if on.ahead is None else len(on.ahead[1])) - 1
        known += self._doubtful if jump == 0 else 0
        if known < GLITCH_SAMPLES:
            on.mark(jump, len(on.raw), Flaw.RATE)
            return -1
        self._stays(on, jump)
        return jump

    def _returns(self, on: _Stretch, jump: int) -> int | None:
        """Index of the reading, `ahead` counted on, that is back where it was before the jump; None: it stays away."""
        before_s, before = on.before(jump)
        later_s, later = on.after(jump)
        for i, (at_s, value) in enumerate(zip(later_s.tolist(), later.tolist(), strict=True)):
            away = value - before
            if abs(away - self._roll(away)) <= self._rules.rate * (at_s - before_s):
                return jump + 1 + i
        return None

    def _glitch(self, on: _Stretch, jump: int, back: int) -> int:
        """What lies between does not count; -1 where it is not over yet."""
        on.mark(jump, back, Flaw.RATE)
        if back >= len(on.raw):
            return -1
        on.shift[jump:back] = 0.0
        on.shift[back] = -self._roll(float(on.raw[back]) - on.before(jump)[1])
        return back

    def _stays(self, on: _Stretch, jump: int) -> None:
        """A jump that the gear may have made is marked and kept; a larger one is a lost reference, and taken off."""
        rules, step = self._rules, float(on.steps[jump])
        dt_s = max(float(on.time_s[jump]) - on.before(jump)[0], rules.period_s)
        beyond = step - self._expected(on, jump, dt_s)
        if abs(step) <= max(RESET_MARGIN * rules.rate * dt_s, rules.smallest_reset):
            on.mark(jump, jump + 1, Flaw.RATE)
            self.jumps += 1
            self.newest_jump = beyond
            return
        on.shift[jump] -= beyond
        end = jump + GUARD_SAMPLES + 1
        on.mark(jump - GUARD_SAMPLES, end, Flaw.RESET)
        self._guard = max(end - len(on.raw), 0)
        self.resets += 1

    def _bridge(self, on: _Stretch, dt_s: Array, wrap: float) -> None:
        """Turns taken inside a gap follow from the speed before it; a gap too long for that loses the reference."""
        period_s = max(self._rules.period_s, float(dt_s.min()))
        for gap in np.flatnonzero(dt_s > GAP_PERIODS * period_s).tolist()[:JUMPS_PER_CALL]:
            gap_s = float(dt_s[gap])
            turns = round((self._expected(on, gap, gap_s) - float(on.steps[gap])) / wrap) * wrap
            on.steps[gap] += turns
            on.shift[gap] += turns
            unknown = 0.5 * ACCELERATION_RAD_S2 * self._rules.raw_per_rad * gap_s**2
            if min(unknown, self._rules.rate * gap_s) > wrap / 2:
                on.mark(gap, gap + 1, Flaw.RESET)
                self.resets += 1

    def _roll(self, step: float) -> float:
        wrap = self._rules.wrap
        return 0.0 if wrap is None else round(step / wrap) * wrap

    def _expected(self, on: _Stretch, index: int, dt_s: float) -> float:
        """Step that the speed before `index` makes in `dt_s`."""
        first = max(index - SPEED_SAMPLES, 0)
        speed = self._speed
        if index - first >= 2:
            speed = float(on.steps[first + 1 : index].sum()) / float(on.time_s[index - 1] - on.time_s[first])
        step = speed * dt_s
        return float(round(step)) if self._rules.whole else step

    def _remember(self, time_s: Array, raw: Array, steps: Array | None, trusted: int, flawed: bool) -> None:
        """Position and speed at the newest trusted reading; `steps` None: those of the raw values."""
        first = max(trusted - SPEED_SAMPLES, -1)
        before_s, before = (self._time_s, self.raw) if first < 0 else (float(time_s[first]), float(raw[first]))
        if not flawed:
            travel = float(raw[trusted]) - before if steps is None else float(steps[first + 1 : trusted + 1].sum())
            speed = travel / (float(time_s[trusted]) - before_s)
            self._speed += (speed - self._speed) * (trusted - first) / SPEED_SAMPLES
        self._doubtful = len(raw) - 1 - trusted
        self.raw, self._time_s = float(raw[trusted]), float(time_s[trusted])
