"""What a test motion may never pass: the whole profile before it starts, the measured motion in every cycle.

A profile is planned to stay within `PLANNED_SHARE` of each limit, so that a drive that overshoots a little does not
stop the test, while a measured value is held to the limit itself.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from edge_daemon.config.settings import Excite, ExciteLimits
from edge_daemon.errors import BadInput
from edge_daemon.excite.profiles import PlannedMotion

PLANNED_SHARE = 0.9
ACCELERATION_CYCLES = 8
"""Measured acceleration is the speed's change over this many cycles: one cycle's difference is mostly encoder steps."""
FROZEN_CYCLES = 12
"""As many equal positions while the target moves mean a lost encoder."""
FROZEN_COUNTS = 8
"""... moves at least this many counts in that time"""


class LimitError(BadInput):
    """One line: which limit the profile would pass, by how much."""


@dataclass(frozen=True, slots=True)
class Feedback:
    """What the drive reported at the last SYNC; motor side."""

    position_rad: float
    velocity_rad_s: float
    torque_Nm: float
    statusword: int
    time_s: float
    """when it arrived, on the runner's monotonic clock"""


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why the motion must end."""

    reason: str
    hard: bool
    """True: the drive's own quick stop at once; False: a ramp of targets will do, all that it needs still works"""


def check_profile(
    course: PlannedMotion, start_rad: float, limits: ExciteLimits, temperature_degC: float = math.nan
) -> None:
    """Raise `LimitError` unless the whole course, begun at `start_rad` (drive's position), stays within the limits."""
    for name, needed, limit in most_of(course, limits):
        if not needed <= PLANNED_SHARE * limit:
            allowed = PLANNED_SHARE * limit
            raise LimitError(f"limits.{name}: the profile needs {needed:.4g}: expected at most {allowed:.4g}")
    lowest, highest = (start_rad + float(f(course.position_rad)) for f in (np.min, np.max))
    if limits.minimum_rad is not None and not lowest >= limits.minimum_rad:
        raise LimitError(
            f"limits.minimum_rad: the profile goes down to {lowest:.4g}: expected {limits.minimum_rad:.4g}"
        )
    if limits.maximum_rad is not None and not highest <= limits.maximum_rad:
        raise LimitError(f"limits.maximum_rad: the profile goes up to {highest:.4g}: expected {limits.maximum_rad:.4g}")
    problem = temperature_problem(limits, temperature_degC)
    if problem:
        raise LimitError(f"limits.temperature_degC: {problem}")


def most_of(course: PlannedMotion, limits: ExciteLimits) -> list[tuple[str, float, float]]:
    """(name of the limit, what the course needs of it, the limit)."""
    columns = (course.position_rad, course.velocity_rad_s, course.acceleration_rad_s2)
    travel, speed, acceleration = (float(np.abs(column).max()) for column in columns)
    return [
        ("travel_rad", travel, limits.travel_rad),
        ("speed_rad_s", speed, limits.speed_rad_s),
        ("acceleration_rad_s2", acceleration, limits.acceleration_rad_s2),
        ("torque_Nm", limits.inertia_kg_m2 * acceleration, limits.torque_Nm),
    ]


def temperature_problem(limits: ExciteLimits, temperature_degC: float) -> str:
    """Why the temperature forbids motion; empty when it does not. NaN is unknown, and unknown forbids."""
    if limits.temperature_degC is None:
        return ""
    if math.isnan(temperature_degC):
        return "temperature is not known"
    if temperature_degC > limits.temperature_degC:
        return f"temperature {temperature_degC:.1f} degC is above {limits.temperature_degC:g}"
    return ""


class MotionWatch:
    """Holds each cycle's feedback against the limits; remembers a few cycles for acceleration and a frozen encoder."""

    def __init__(self, settings: Excite, start_rad: float) -> None:
        self._limits = settings.limits
        self._start_rad = start_rad
        self._cycle_s = settings.cycle_s
        self._step_rad = 2 * math.pi / settings.counts_per_turn
        self._speeds: deque[float] = deque(maxlen=ACCELERATION_CYCLES + 1)
        self._positions: deque[float] = deque(maxlen=FROZEN_CYCLES)
        self._targets: deque[float] = deque(maxlen=FROZEN_CYCLES)

    def doubt(self, seen: Feedback, target_rad: float) -> Doubt | None:
        """The first limit that the measured motion has reached. `target_rad`: in force when `seen` was latched."""
        self._speeds.append(seen.velocity_rad_s)
        self._positions.append(seen.position_rad)
        self._targets.append(target_rad)
        reason = self._frozen() or self._passed(seen, target_rad)
        return Doubt(reason, hard=True) if reason else None

    def _passed(self, seen: Feedback, target_rad: float) -> str:
        limits = self._limits
        rows = (
            ("travel", abs(seen.position_rad - self._start_rad), limits.travel_rad, "rad"),
            ("speed", abs(seen.velocity_rad_s), limits.speed_rad_s, "rad/s"),
            ("torque", abs(seen.torque_Nm), limits.torque_Nm, "N m"),
            ("following error", abs(seen.position_rad - target_rad), limits.following_error_rad, "rad"),
            ("acceleration", self._acceleration(), limits.acceleration_rad_s2, "rad/s^2"),
        )
        for name, value, limit, unit in rows:
            if not value <= limit:
                return f"{name} limit reached: {value:.4g} of {limit:g} {unit}"
        if limits.minimum_rad is not None and not seen.position_rad >= limits.minimum_rad:
            return f"position limit reached: {seen.position_rad:.4g} below {limits.minimum_rad:g} rad"
        if limits.maximum_rad is not None and not seen.position_rad <= limits.maximum_rad:
            return f"position limit reached: {seen.position_rad:.4g} above {limits.maximum_rad:g} rad"
        return ""

    def _acceleration(self) -> float:
        if len(self._speeds) <= ACCELERATION_CYCLES:
            return 0.0
        return abs(self._speeds[-1] - self._speeds[0]) / (ACCELERATION_CYCLES * self._cycle_s)

    def _frozen(self) -> str:
        if len(self._positions) < FROZEN_CYCLES or len(set(self._positions)) > 1:
            return ""
        moved = max(self._targets) - min(self._targets)
        return (
            "encoder lost: its position is frozen while the target moves"
            if moved > FROZEN_COUNTS * self._step_rad
            else ""
        )
