"""The guarded motion, one step per cycle: enable, move, stop. No bus and no clock; time is an argument.

A drive after CiA 402-2 is led by its controlword and answers with its statusword. Every step begins with doubt: what is
not known to be well ends the motion, by a ramp where the drive is trusted and by its quick stop where it is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from edge_daemon.config.settings import Excite
from edge_daemon.excite.limits import PLANNED_SHARE, Doubt, Feedback, MotionWatch
from edge_daemon.excite.profiles import PlannedMotion

SHUTDOWN, SWITCH_ON, ENABLE_OPERATION = 0x06, 0x07, 0x0F
QUICK_STOP, DISABLE_VOLTAGE = 0x02, 0x00
FAULT_BIT, INTERNAL_LIMIT_BIT, FOLLOWING_ERROR_BIT = 0x0008, 0x0800, 0x2000
STALE_CYCLES = 3
"""A drive that misses this many SYNCs is not heard."""
ENABLE_WITHIN_S = 2.0
"""The drive has this long from the first controlword to operation enabled; brakes take a few tenths of a second to
open."""
STANDSTILL_RAD_S = 0.1
"""This motor speed counts as standing: one revolution a minute."""
STANDSTILL_CYCLES = 5


class DriveState(Enum):
    """State of the drive as its statusword tells it (CiA 402-2, statusword)."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


_STATES = (
    (0x4F, 0x00, DriveState.NOT_READY),
    (0x4F, 0x40, DriveState.SWITCH_ON_DISABLED),
    (0x6F, 0x21, DriveState.READY),
    (0x6F, 0x23, DriveState.SWITCHED_ON),
    (0x6F, 0x27, DriveState.ENABLED),
    (0x6F, 0x07, DriveState.QUICK_STOP),
    (0x4F, 0x0F, DriveState.FAULT_REACTION),
    (0x4F, 0x08, DriveState.FAULT),
)


def state_of(statusword: int) -> DriveState:
    """The state in a statusword; UNKNOWN for a pattern the standard does not have."""
    return next((state for mask, bits, state in _STATES if statusword & mask == bits), DriveState.UNKNOWN)


class Stage(Enum):
    ENABLING = "enabling"
    MOVING = "moving"
    RAMPING = "ramping"
    STOPPING = "stopping"
    OVER = "over"


@dataclass(frozen=True, slots=True)
class Command:
    """What to send in this cycle."""

    controlword: int
    position_rad: float
    velocity_rad_s: float
    heartbeat: bool
    """False: let the drive miss this gateway, so that it stops by itself"""
    phase: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """How it ended."""

    completed: bool
    """the whole profile ran"""
    stopped: bool
    """the drive itself reported standstill"""
    reason: str
    """why it ended early; empty when completed"""


class Sequence:
    """One run of one course. `start_rad` is where the drive stands, in its own position."""

    def __init__(self, settings: Excite, course: PlannedMotion, start_rad: float, now_s: float) -> None:
        self._settings = settings
        self._course = course
        self._start_rad = start_rad
        self._watch = MotionWatch(settings, start_rad)
        self._began_s = now_s
        self._row = 0
        self._target = (start_rad, 0.0)
        self._before_rad = start_rad
        self._heard_s = now_s
        self._still = 0
        self.stage = Stage.ENABLING
        self.reason = ""
        self.stopped = False

    @property
    def outcome(self) -> Outcome:
        """Valid once the stage is OVER."""
        return Outcome(not self.reason and self.stopped, self.stopped, self.reason)

    def step(self, now_s: float, seen: Feedback | None, doubt: Doubt | None) -> Command:
        """The command of this cycle. `seen`: newest feedback; `doubt`: what the runner knows beside it."""
        fresh = seen is not None and seen.time_s > self._heard_s
        if seen is not None:
            self._heard_s = max(self._heard_s, seen.time_s)
        if self.stage in (Stage.ENABLING, Stage.MOVING, Stage.RAMPING):
            self._heed(now_s, doubt or self._own_doubt(now_s, seen, fresh))
        if self.stage is Stage.ENABLING:
            return self._enable(seen)
        if self.stage is Stage.MOVING:
            return self._move(now_s)
        if self.stage is Stage.RAMPING:
            return self._ramp(now_s)
        return self._stop(now_s, seen if fresh else None)

    def end(self, reason: str, now_s: float) -> None:
        """Quick stop from now on, whatever runs."""
        self._heed(now_s, Doubt(reason, hard=True))

    def _heed(self, now_s: float, doubt: Doubt | None) -> None:
        if doubt is None or self.stage in (Stage.STOPPING, Stage.OVER):
            return
        if not self.reason:
            self.reason = doubt.reason
        if doubt.hard or self.stage is Stage.ENABLING:
            self._to_stopping(now_s)
        elif self.stage is Stage.MOVING:
            self.stage = Stage.RAMPING

    def _to_stopping(self, now_s: float) -> None:
        self.stage, self._began_s, self._still = Stage.STOPPING, now_s, 0

    def _own_doubt(self, now_s: float, seen: Feedback | None, fresh: bool) -> Doubt | None:
        if now_s - self._heard_s > STALE_CYCLES * self._settings.cycle_s:
            return Doubt("feedback is stale: the drive or the bus is silent", hard=True)
        if seen is None or not fresh:
            return None
        state = state_of(seen.statusword)
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
            return Doubt(f"the drive reports a fault (statusword 0x{seen.statusword:04X})", hard=True)
        if self.stage is Stage.ENABLING:
            away = abs(seen.position_rad - self._start_rad)
            if not away <= self._settings.limits.following_error_rad:  # once enabled it would leap back
                return Doubt(f"the axis moved by {away:.3g} rad before it was enabled", hard=True)
            late = now_s - self._began_s > ENABLE_WITHIN_S
            return Doubt(f"the drive stays in '{state.value}'", hard=True) if late else None
        if state is not DriveState.ENABLED:
            return Doubt(f"the drive left operation: '{state.value}'", hard=True)
        if seen.statusword & (INTERNAL_LIMIT_BIT | FOLLOWING_ERROR_BIT):
            return Doubt(f"the drive reports a limit (statusword 0x{seen.statusword:04X})", hard=True)
        return self._watch.doubt(seen, self._before_rad)

    def _enable(self, seen: Feedback | None) -> Command:
        state = state_of(seen.statusword) if seen else DriveState.NOT_READY
        if state is DriveState.ENABLED:
            self.stage = Stage.MOVING
        words = {
            DriveState.READY: SWITCH_ON,
            DriveState.SWITCHED_ON: ENABLE_OPERATION,
            DriveState.ENABLED: ENABLE_OPERATION,
        }
        # until it is enabled the target is where it is: a drive that wakes up holds its place and leaps nowhere
        at_rad = seen.position_rad if seen and state is not DriveState.ENABLED else self._start_rad
        return self._command(words.get(state, SHUTDOWN), at_rad, 0.0)

    def _move(self, now_s: float) -> Command:
        row = self._row
        if row >= len(self._course):
            self._to_stopping(now_s)
            return self._command(ENABLE_OPERATION, self._target[0], 0.0)
        self._row += 1
        position = self._start_rad + float(self._course.position_rad[row])
        speed = float(self._course.velocity_rad_s[row])
        return self._command(ENABLE_OPERATION, position, speed, int(self._course.phase[row]))

    def _ramp(self, now_s: float) -> Command:
        cycle_s = self._settings.cycle_s
        position, speed = self._target
        slowed = max(0.0, abs(speed) - PLANNED_SHARE * self._settings.limits.acceleration_rad_s2 * cycle_s)
        following = math.copysign(slowed, speed)
        if slowed == 0.0:
            self._to_stopping(now_s)
        return self._command(ENABLE_OPERATION, position + 0.5 * (speed + following) * cycle_s, following)

    def _stop(self, now_s: float, seen: Feedback | None) -> Command:
        """Quick stop until the drive says that it stands, then no voltage. Silence or delay costs it our heartbeat."""
        if seen is not None:
            self._still = self._still + 1 if abs(seen.velocity_rad_s) < STANDSTILL_RAD_S else 0
        at_rad = seen.position_rad if seen else self._target[0]
        if self._still >= STANDSTILL_CYCLES:
            self.stage, self.stopped = Stage.OVER, True
            return self._command(DISABLE_VOLTAGE, at_rad, 0.0)
        silent = now_s - self._heard_s > STALE_CYCLES * self._settings.cycle_s
        if now_s - self._began_s > self._settings.stop_within_s:
            self.stage = Stage.OVER
            self.reason = (self.reason or "profile done") + "; standstill was not confirmed in time"
            return self._command(DISABLE_VOLTAGE, at_rad, 0.0, heartbeat=False)
        return self._command(QUICK_STOP, at_rad, 0.0, heartbeat=not silent)

    def _command(
        self, word: int, position_rad: float, speed_rad_s: float, phase: int = 0, heartbeat: bool = True
    ) -> Command:
        self._before_rad = self._target[0]
        self._target = (position_rad, speed_rad_s)
        return Command(word, position_rad, speed_rad_s, heartbeat, phase)
