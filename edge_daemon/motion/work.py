"""Work that passes the gear and work that stays in it, over the last minute of motion.

The loop of torque over twist encloses what flexspline, teeth and their friction keep per load cycle. Where the motor's
torque is measured, work at the motor minus work at the output is what the whole drive keeps, and their ratio is its
efficiency. A spring, a rotor and an inertia give back what they take, so over whole cycles they count for nothing.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge_daemon.motion.streaming import Stretch
from edge_daemon.records import Array, Block, Estimate, Status

WINDOW_S = 60.0
"""All figures are those of the last minute of motion, as the loads are."""
LEAST_CYCLES = 10.0
"""Load cycles from which a loss per cycle is told (guess)."""
CYCLE_SHARE = 0.25
"""A load cycle passes the mean torque upward, by this share of its rms to either side (guess): noise does not."""
MOST_EFFICIENCY_SD = 0.2
"""An efficiency is no number for anybody when its standard deviation is above this (guess)."""
TORQUE_LAG_SD_S = 3e-3
"""A servo drive tells its torque with this doubt of the instant [s]: its filter, and a bus without stamps (guess)."""


class _Part(NamedTuple):
    """Sums over one block; what was not measured is NaN."""

    end_s: float
    loop_J: float
    """torque times twist rate, summed"""
    loop_J_per_s: float
    """what an error of the encoders' skew makes of it, per second of it"""
    cycles: float
    taken_J: float = math.nan
    """work that went in, at motor or output"""
    given_J: float = math.nan
    """work that came out, at motor or output"""
    late_J_per_s: float = math.nan
    """what a motor torque that comes late makes of the work at the motor, per second of lag"""


class WorkEstimator:
    """`update` with every block, `estimates` at any time."""

    def __init__(self) -> None:
        self._parts: deque[_Part] = deque()
        self._mean_Nm = self._rms_Nm = 0.0
        self._above = False
        self._usable = self._motor = False
        self._skew_sd_s = math.nan

    def update(
        self, block: Block, stretch: Stretch | None, felt_rate: Callable[[Stretch], Array], skew_sd_s: float
    ) -> None:
        """Take in a block and the motion that it completed; `felt_rate`: the twist's, freed of the kinematic error."""
        self._motor = "torque_in_Nm" in block.values and "theta_in_rad" in block.values
        self._usable, self._skew_sd_s = stretch is not None and bool(stretch.valid.all()), skew_sd_s
        if stretch is None or not self._usable:
            return
        motion = stretch.motion
        torque, end_s = motion.torque_Nm, float(motion.time_s[-1])
        loop = float(torque @ felt_rate(stretch)) / motion.rate_hz
        skewed = float(torque @ motion.acceleration_out_rad_s2) / motion.rate_hz
        part = _Part(end_s, loop, skewed, self._cycles(torque))
        if self._motor:
            part = _with_motor(part, block, stretch)
        self._parts.append(part)
        while self._parts[0].end_s < end_s - WINDOW_S:
            self._parts.popleft()

    def _cycles(self, torque_Nm: Array) -> float:
        """How often the torque passed its mean upward."""
        share = min(1.0, 1.0 / (len(self._parts) + 1))
        self._mean_Nm += share * (float(torque_Nm.mean()) - self._mean_Nm)
        self._rms_Nm += share * (float(torque_Nm.std()) - self._rms_Nm)
        off = torque_Nm - self._mean_Nm
        far = off[np.abs(off) > CYCLE_SHARE * self._rms_Nm] > 0
        if not len(far):
            return 0.0
        passed = np.concatenate(([self._above], far))
        self._above = bool(far[-1])
        return float(np.count_nonzero(passed[1:] & ~passed[:-1]))

    def estimates(self, twist: Status) -> tuple[Estimate, ...]:
        """`hysteresis_area`, and where the motor's torque is measured `energy_lost_per_cycle` and `efficiency`.

        `twist`: the status of the stiffness, without which nobody knows the kinematic error that the twist must be
        freed of; work at motor and output needs no twist.
        """
        end_s = self._parts[-1].end_s if self._parts else math.nan
        sums = dict(zip(_Part._fields, np.array(self._parts).reshape(-1, len(_Part._fields)).T, strict=True))
        cycles = float(sums["cycles"].sum())
        known = Status.WARMING_UP if cycles < LEAST_CYCLES else Status.VALID
        known = known if self._usable else Status.INVALID
        loop, sd = _per_cycle(sums["loop_J"], cycles, self._skew_sd_s * float(sums["loop_J_per_s"].sum()))
        area = Estimate("hysteresis_area", loop, sd, "J", twist if known is Status.VALID else known, end_s)
        return (area, *self._of_the_drive(sums, known, end_s)) if self._motor else (area,)

    def _of_the_drive(self, sums: dict[str, Array], status: Status, end_s: float) -> tuple[Estimate, ...]:
        known = np.isfinite(sums["taken_J"])
        sums = {name: values[known] for name, values in sums.items()}
        taken, given, cycles = (float(sums[name].sum()) for name in ("taken_J", "given_J", "cycles"))
        late = TORQUE_LAG_SD_S * float(sums["late_J_per_s"].sum())
        lost, lost_sd = _per_cycle(sums["taken_J"] - sums["given_J"], cycles, late)
        share, sd = (given / taken, lost_sd * cycles / taken) if taken > 0 else (math.nan, math.nan)
        told = status if sd <= MOST_EFFICIENCY_SD else Status.INVALID
        status = status if math.isfinite(lost) else Status.INVALID
        return (
            Estimate("energy_lost_per_cycle", lost, lost_sd, "J", status, end_s),
            Estimate("efficiency", share, sd, "1", told, end_s),
        )


def _per_cycle(parts_J: Array, cycles: float, wrong_J: float) -> tuple[float, float]:
    """Work per cycle [J] and its sd: the scatter of the parts, and what is wrong with their sum."""
    if len(parts_J) < 2 or not cycles > 0:
        return math.nan, math.nan
    chance = float(parts_J.std(ddof=1)) * math.sqrt(len(parts_J))
    return float(parts_J.sum()) / cycles, math.hypot(chance, wrong_J) / cycles


def _with_motor(part: _Part, block: Block, stretch: Stretch) -> _Part:
    """The same with the work at both ends of the drive; as it is where the motor's torque has flaws."""
    if not block.valid("torque_in_Nm", "theta_in_rad").all():
        return part
    torque, speed = block.values["torque_in_Nm"], np.gradient(block.values["theta_in_rad"]) * block.rate_hz
    read = _read(torque)
    each_s = block.size / block.rate_hz / len(read)
    at_motor = torque[read] * speed[read] * each_s
    at_output = stretch.motion.torque_Nm * stretch.motion.velocity_out_rad_s / stretch.motion.rate_hz
    late = float(torque[read] @ np.gradient(speed)[read]) * block.rate_hz * each_s
    return part._replace(
        taken_J=float(np.maximum(at_motor, 0).sum() - np.minimum(at_output, 0).sum()),
        given_J=float(np.maximum(at_output, 0).sum() - np.minimum(at_motor, 0).sum()),
        late_J_per_s=late,
    )


def _read(held: Array) -> NDArray[np.intp]:
    """Where a slow sensor was read: between its readings the last one is held, and is true no longer."""
    changed = np.flatnonzero(np.diff(held)) + 1
    return changed if len(changed) else np.arange(len(held))
