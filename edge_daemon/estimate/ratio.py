"""Transmission ratio by regression over angle increments, and ratcheting as lasting jumps of the twist.

Increments over one stretch of filtered angles, not samples near standstill. The twist moves with the torque, and
always against the motion's own acceleration: left in, it would bias the ratio, so that what the estimated stiffness
explains of it is taken out, and so is the kinematic error as far as it is known. What remains (the rest of it, encoder
noise of both) is noise of the input side and measured: the output's share of it is a thousandth of a usual increment
at the least.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge_daemon.estimate.streaming import Stretch
from edge_daemon.records import Array, Block, Estimate, Flaw, Status

MEMORY_BLOCKS = 600.0
"""the ratio is that of about the last minute of motion"""
MOVING_RAD = 3e-3
"""output increments below this tell more about twist than about teeth (guess: ten times a kinematic error)"""
MIN_SHARE = 3e-4
"""the ratio is valid when its sd is below this share of it: one tooth in a hundred is 1e-2"""
JUMP_TOLERANCE = 0.2
"""a jump counts as ratcheting when it is within this share of a pitch of whole pitches"""
LASTING_S = 1.0
"""a jump counts when the twist has stayed there for this long: twice what a frozen encoder goes unnoticed"""
MIN_BLOCKS = 5


class RatioEstimator:
    """`nominal` ratio with sign; pitch of one tooth at the output from `teeth` of the circular spline if known."""

    def __init__(self, nominal: float, teeth: int | None = None) -> None:
        self.nominal = nominal
        self.pitch_rad = 2 * math.pi / (teeth if teeth is not None else 2 * (abs(nominal) + 1))
        self.ratcheting_events = 0
        self.encoder_resets = 0
        self.time_s = math.nan
        self._moments = np.zeros(4)
        self._lost = True
        self._forget_level()

    def _forget_level(self) -> None:
        self._level_rad = math.nan
        self._jump_rad = math.nan
        self._lasting = 0

    def update(self, block: Block, stretch: Stretch | None, stiffness: float, error_rad: Array | None = None) -> None:
        """Take in one block and the motion it completed; `stiffness` [N m/rad] NaN while unknown. `error_rad`: sine
        and cosine of each order of the kinematic error, as far as it is known."""
        good = block.valid("theta_in_rad", "theta_out_rad")
        self._lost = not good.any()
        if self._lost:
            return
        self.time_s = block.end_s
        motor, out = block.values["theta_in_rad"], block.values["theta_out_rad"]
        good &= np.isfinite(motor) & np.isfinite(out)
        if self._was_reset(block):
            self.encoder_resets += 1
            self._forget_level()
        elif good.sum() >= 2:
            self._watch(motor[good], out[good], block.size / block.rate_hz)
        if stretch is not None and stretch.valid.all():
            self._regress(stretch, stiffness, error_rad)

    @staticmethod
    def _was_reset(block: Block) -> bool:
        """The conditioning saw a counter jump that no gear can make: no ratcheting, whatever the twist says."""
        return any(
            bool(np.any(block.flaws[name] & np.uint8(Flaw.RESET)))
            for name in ("theta_in_rad", "theta_out_rad")
            if name in block.flaws
        )

    def _regress(self, stretch: Stretch, stiffness: float, error_rad: Array | None) -> None:
        motion = stretch.motion
        step_in = float(motion.theta_in_rad[-1] - motion.theta_in_rad[0])
        step_out = float(motion.theta_out_rad[-1] - motion.theta_out_rad[0])
        if abs(step_out) < MOVING_RAD:
            return
        if stiffness > 0:
            step_out += float(motion.torque_Nm[-1] - motion.torque_Nm[0]) / stiffness
            if error_rad is not None:
                step_out -= float((stretch.kinematic[-1] - stretch.kinematic[0]) @ error_rad)
        keep = 1.0 - 1.0 / MEMORY_BLOCKS
        self._moments = keep * self._moments + np.array([step_out**2, step_out * step_in, step_in**2, 1.0])

    def _watch(self, motor: Array, out: Array, duration_s: float) -> None:
        """A jump of the twist between blocks or within one that lasts, by whole pitches."""
        twist = motor / self.nominal - out
        before, after = self._level_rad, _middle(twist[len(twist) // 2 :])
        if not math.isfinite(before):
            self._level_rad = after
            return
        jump = after - before
        if abs(jump) < (1 - JUMP_TOLERANCE) * self.pitch_rad:
            self._level_rad, self._lasting = before + 0.5 * jump, 0
            return
        same = self._lasting > 0 and abs(jump - self._jump_rad) < JUMP_TOLERANCE * self.pitch_rad
        self._lasting, self._jump_rad = self._lasting + 1 if same else 1, jump
        if self._lasting * duration_s >= LASTING_S:
            pitches = round(jump / self.pitch_rad)
            if abs(jump - pitches * self.pitch_rad) < JUMP_TOLERANCE * self.pitch_rad:
                self.ratcheting_events += abs(pitches)
            self._level_rad, self._lasting = after, 0

    def _slope(self) -> tuple[float, float]:
        """Slope of input over output increments through zero, with sd; NaN before enough motion."""
        out2, cross, in2, blocks = (float(v) for v in self._moments)
        if blocks < MIN_BLOCKS or out2 <= 0:
            return math.nan, math.nan
        slope = cross / out2
        left = max(in2 - slope * cross, 0.0) / (blocks - 1)
        return slope, math.sqrt(left / out2)

    def estimates(self) -> tuple[Estimate, Estimate]:
        """`ratio` and `ratcheting_events`."""
        slope, sd = self._slope()
        known = math.isfinite(slope)
        good = known and sd < MIN_SHARE * abs(slope)
        status = Status.VALID if good else Status.NOT_EXCITED if known else Status.WARMING_UP
        counted = Status.VALID if math.isfinite(self._level_rad) else Status.WARMING_UP
        if self._lost:
            status = counted = Status.INVALID
        return (
            Estimate("ratio", slope, sd, "1", status, self.time_s),
            Estimate("ratcheting_events", float(self.ratcheting_events), 0.0, "1", counted, self.time_s),
        )

    def dump(self) -> dict[str, Any]:
        """What must outlive a restart."""
        return {"ratcheting_events": self.ratcheting_events, "moments": self._moments.tolist()}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave."""
        self.ratcheting_events = int(state["ratcheting_events"])
        self._moments = np.array(state["moments"], dtype=float).reshape(4)


def _middle(values: Array) -> float:
    """The upper median; a tenth of the cost of numpy's."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])
