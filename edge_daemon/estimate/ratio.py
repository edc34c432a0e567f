"""Transmission ratio and encoder skew by regression over the whole observed travel, and ratcheting as lasting jumps.

Encoder steps are all that stands against the ratio, once what moves the twist is in the regression too (see `slope`).
A skew of the encoders is what an output-side viscous friction would look like too.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge_daemon.estimate.kinematics import FirSet
from edge_daemon.estimate.recursive import structure_share, widening
from edge_daemon.estimate.slope import COLUMNS, SKEW, SLOPE, ZEROS, Slope
from edge_daemon.estimate.streaming import ORDERS, Stretch
from edge_daemon.records import Array, Block, Estimate, Flaw, Status

MOVING_RAD = 3e-3
"""travel of the output in a block below which rounding errors stand still and do not average out (guess)"""
RESTART_S = 5.0
"""after this long of blocks that contradict, new level or not, it is the regression that is wrong: it starts over"""
MIN_SHARE = 3e-4
"""the ratio is valid when its sd is below this share of it: one tooth in a hundred is 1e-2"""
SKEW_SD_S = 1e-4
"""the skew is valid when its sd is below this: a tenth of a sample at 1 kHz"""
JUMP_TOLERANCE = 0.2
"""a jump counts as ratcheting when it is within this share of a pitch of whole pitches"""
LASTING_S = 1.0
"""a jump counts when the twist has stayed there for this long: twice what a frozen encoder goes unnoticed"""


class RatioEstimator:
    """`nominal` ratio with sign; of a strain wave gear it gives the teeth of the circular spline."""

    def __init__(self, nominal: float, fir: FirSet) -> None:
        self.nominal = nominal
        self.pitch_rad = 2 * math.pi / (2 * (abs(nominal) + 1))
        self.ratcheting_events = 0
        self.encoder_resets = 0
        self.time_s = math.nan
        self._slope = Slope()
        self._fir = fir
        self._refused_s = 0.0
        self._others = False
        self._sensors_rad2, self._freedom, self._bandwidth = math.nan, math.inf, 1.0
        self._lost = True
        self._forget_level()

    def _forget_level(self) -> None:
        self._level_rad = math.nan
        self._jump_rad = math.nan
        self._lasting = 0

    def update(
        self,
        block: Block,
        stretch: Stretch | None,
        stiffness: float = math.nan,
        error_rad: Array | None = None,
        others_Nm: Array | None = None,
    ) -> None:
        """Take in one block and the motion it completed. What the torsion balance knows of it: `stiffness` [N m/rad],
        NaN while unknown; `error_rad`, sine and cosine of each order of the kinematic error; `others_Nm` (n,), torque
        of effects other than spring and damper."""
        good = block.valid("theta_in_rad", "theta_out_rad")
        self._lost = not np.count_nonzero(good)
        if self._lost:
            return
        self.time_s = block.end_s
        motor, out = block.values["theta_in_rad"], block.values["theta_out_rad"]
        good &= np.isfinite(motor) & np.isfinite(out)
        whole = np.count_nonzero(good) == len(good)
        if not whole and self._was_reset(block):
            self.encoder_resets += 1
            self._forget_level()
        elif whole:
            self._watch(motor, out, block.size / block.rate_hz)
        elif good.sum() >= 2:
            self._watch(motor[good], out[good], block.size / block.rate_hz)
        if stretch is not None:
            self._regress(stretch, stiffness, error_rad, others_Nm)

    @staticmethod
    def _was_reset(block: Block) -> bool:
        """The conditioning saw a counter jump that no gear can make: no ratcheting, whatever the twist says."""
        return any(
            bool((block.flaws[name] & np.uint8(Flaw.RESET)).any())
            for name in ("theta_in_rad", "theta_out_rad")
            if name in block.flaws
        )

    def _regress(self, stretch: Stretch, stiffness: float, error_rad: Array | None, others_Nm: Array | None) -> None:
        motion, slope = stretch.motion, self._slope
        duration_s = len(motion) / motion.rate_hz
        bandwidth = self._bandwidth = self._fir.bandwidth * self._fir.rate_hz / motion.rate_hz
        if stretch.fresh:
            slope.let_go(ZEROS)
        if self._others != (others_Nm is not None):
            self._others = not self._others
            slope.start_over()
        spring_Nm = motion.torque_Nm if others_Nm is None else motion.torque_Nm - others_Nm
        rows = stretch.valid & np.isfinite(spring_Nm)
        out = motion.theta_out_rad
        if np.count_nonzero(rows) < 2 or out.max() - out.min() < MOVING_RAD:
            return
        error = error_rad if error_rad is not None else np.zeros(2 * len(ORDERS))
        joined = slope.columns(stretch, spring_Nm, error, rows)
        if not slope.take(joined, duration_s, bandwidth):
            self._refuse(duration_s)
            return
        self._refused_s = 0.0
        if slope.due:
            slope.wander(motion.rate_hz)
            slope.solve(bandwidth, stiffness)

    def _refuse(self, duration_s: float) -> None:
        """A jump that lasts is a new level; what no level mends is another gear."""
        before = self._refused_s
        self._refused_s += duration_s
        if before < LASTING_S <= self._refused_s:
            self._slope.let_go(ZEROS)
            self._slope.value = np.full(COLUMNS, math.nan)
            self._slope.noise_rad2 = math.nan
        elif self._refused_s >= RESTART_S:
            self._slope.start_over()
            self._refused_s = 0.0

    def _watch(self, motor: Array, out: Array, duration_s: float) -> None:
        """A jump of the twist between blocks or within one that lasts, by whole pitches."""
        half = len(motor) // 2
        before, after = self._level_rad, _middle(motor[half:] / self.nominal - out[half:])
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

    def know_noise(self, sensors_rad2: float, freedom: float) -> None:
        """Variance that the sensors alone give a filtered sample of the twist, and how many independent numbers there
        are in what else is left of it (`recursive.PATTERN_S`)."""
        self._sensors_rad2, self._freedom = sensors_rad2, freedom

    def _known(self, unknown: int) -> tuple[float, float]:
        """Value and sd. What a missing effect leaves in the twist repeats with the motion and does not average out."""
        value, sd = self._slope.known(unknown)
        if not math.isfinite(self._sensors_rad2):
            return value, sd
        lacking = structure_share(self._sensors_rad2, self._slope.noise_rad2)
        if lacking == 0.0:
            return value, sd
        return value, sd * float(widening(lacking, self._slope.samples * self._bandwidth, self._freedom))

    @property
    def skew(self) -> tuple[float, float]:
        """How much later the output encoder is sampled than the motor's [s], with sd; NaN before it is known."""
        value, sd = self._known(SKEW)
        return -value, sd

    def estimates(self) -> tuple[Estimate, ...]:
        """`ratio`, `ratcheting_events` and `encoder_skew`."""
        slope, sd = self._known(SLOPE)
        skew, skew_sd = self.skew
        counted = Status.VALID if math.isfinite(self._level_rad) else Status.WARMING_UP
        return (
            Estimate(
                "ratio",
                self.nominal * (1 + slope),
                abs(self.nominal) * sd,
                "1",
                self._status(slope, sd < MIN_SHARE),
                self.time_s,
            ),
            Estimate(
                "ratcheting_events",
                float(self.ratcheting_events),
                0.0,
                "1",
                Status.INVALID if self._lost else counted,
                self.time_s,
            ),
            Estimate("encoder_skew", skew, skew_sd, "s", self._status(skew, skew_sd < SKEW_SD_S), self.time_s),
        )

    def _status(self, value: float, good: bool) -> Status:
        if self._lost:
            return Status.INVALID
        if not math.isfinite(value):
            return Status.WARMING_UP
        return Status.VALID if good else Status.NOT_EXCITED

    def dump(self) -> dict[str, Any]:
        """What must outlive a restart."""
        return {"ratcheting_events": self.ratcheting_events, "slope": self._slope.dump()}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave."""
        events = int(state["ratcheting_events"])
        self._slope.load(state["slope"])
        self._slope.let_go(ZEROS)
        self.ratcheting_events = events


def _middle(values: Array) -> float:
    """The upper median; a tenth of the cost of numpy's."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])
