"""Transmission ratio and encoder skew by regression over the whole observed travel.

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
from edge_daemon.records import Array, Block, Estimate, Status

MOVING_RAD = 3e-3
"""travel of the output in a block below which rounding errors stand still and do not average out (guess)"""
RESTART_S = 5.0
"""after this long of blocks that contradict, new level or not, it is the regression that is wrong: it starts over"""
MIN_SHARE = 3e-4
"""the ratio is valid when its sd is below this share of it: one tooth in a hundred is 1e-2"""
SKEW_SD_S = 1e-4
"""the skew is valid when its sd is below this: a tenth of a sample at 1 kHz"""
LASTING_S = 1.0
"""a jump is a new level when the twist has stayed there for this long: twice what a frozen encoder goes unnoticed"""


class RatioEstimator:
    """`nominal` ratio with sign."""

    def __init__(self, nominal: float, fir: FirSet) -> None:
        self.nominal = nominal
        self.time_s = math.nan
        self.slope = Slope()
        self._fir = fir
        self._refused_s = 0.0
        self._others = False
        self._sensors_rad2, self._slow, self._freedom, self._bandwidth = math.nan, 1.0, math.inf, 1.0
        self._lost = True

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
        self._lost = not np.count_nonzero(block.valid("theta_in_rad", "theta_out_rad"))
        if self._lost:
            return
        self.time_s = block.end_s
        if stretch is not None:
            self._regress(stretch, stiffness, error_rad, others_Nm)

    def _regress(self, stretch: Stretch, stiffness: float, error_rad: Array | None, others_Nm: Array | None) -> None:
        motion, slope = stretch.motion, self.slope
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
        if not slope.take(joined, duration_s):
            self._refuse(duration_s)
            return
        self._refused_s = 0.0
        if slope.due:
            slope.wander(motion.rate_hz)
            slope.solve(bandwidth, stiffness, self._slow)

    def _refuse(self, duration_s: float) -> None:
        """A jump that lasts is a new level; what no level mends is another gear."""
        before = self._refused_s
        self._refused_s += duration_s
        if before < LASTING_S <= self._refused_s:
            self.slope.let_go(ZEROS)
            self.slope.value = np.full(COLUMNS, math.nan)
            self.slope.noise_rad2 = math.nan
        elif self._refused_s >= RESTART_S:
            self.slope.start_over()
            self._refused_s = 0.0

    def know_noise(self, sensors_rad2: float, slow: float, freedom: float) -> None:
        """Variance that the sensors alone give a filtered sample of the twist, how much more of it is `slow` once the
        wind-up is taken off (`SensorNoise.slow`), and how many independent numbers there are in what else is left
        (`recursive.PATTERN_S`)."""
        self._sensors_rad2, self._slow, self._freedom = sensors_rad2, slow, freedom

    def _known(self, unknown: int) -> tuple[float, float]:
        """Value and sd. What a missing effect leaves in the twist repeats with the motion and does not average out."""
        value, sd = self.slope.known(unknown)
        if not math.isfinite(self._sensors_rad2):
            return value, sd
        lacking = structure_share(self._sensors_rad2 / self._slow, self.slope.noise_rad2)
        if lacking == 0.0:
            return value, sd
        return value, sd * float(widening(lacking, self.slope.samples * self._bandwidth, self._freedom))

    @property
    def skew(self) -> tuple[float, float]:
        """How much later the output encoder is sampled than the motor's [s], with sd; NaN before it is known."""
        value, sd = self._known(SKEW)
        return -value, sd

    def estimates(self) -> tuple[Estimate, ...]:
        """`ratio` and `encoder_skew`."""
        slope, sd = self._known(SLOPE)
        skew, skew_sd = self.skew
        return (
            Estimate(
                "ratio",
                self.nominal * (1 + slope),
                abs(self.nominal) * sd,
                "1",
                self._status(slope, sd < MIN_SHARE),
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
        return {"slope": self.slope.dump()}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave."""
        self.slope.load(state["slope"])
        self.slope.let_go(ZEROS)
