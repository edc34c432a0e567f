"""Transmission ratio and encoder skew by regression over the whole observed travel.

twist = rho theta_out + level + torque / K - (B / K) dphi - skew omega - e, with R = nominal (1 + rho): eleven
unknowns, linear, their normal equations carried from block to block (information form), so that the slope keeps all
the travel seen. A level is let go in a few seconds, and at once where an encoder lost its zero: the slope then keeps
what it learned (marginalisation; Kay, Fundamentals of Statistical Signal Processing, 1993, section 8.6). Encoder steps
are all that stands against the ratio, once what moves the twist is in the regression too.

A skew of the encoders is what an output-side viscous friction would look like too. It turns speed into twist, and the
part of the twist that it makes swings with the speed, as that of every friction does: it adds itself to damping and
friction, while stiffness stands across it. `SkewWatch` says whether the timing carries what is read from the twist.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from edge_daemon.effects.catalogue import CATALOGUE, find
from edge_daemon.effects.effect import twin
from edge_daemon.effects.model import Model
from edge_daemon.motion.kinematics import FirSet
from edge_daemon.motion.noise_level import structure_share, widening
from edge_daemon.motion.streaming import ORDERS, Stretch
from edge_daemon.records import Array, Block, Estimate, Status

SLOPE, LEVEL, COMPLIANCE, LAG, SKEW = range(5)
WAVES = slice(SKEW + 1, SKEW + 1 + 2 * len(ORDERS))
COLUMNS = WAVES.stop
WATCHED = np.array([SLOPE, SKEW])
ZEROS = np.array([LEVEL, *range(WAVES.start, WAVES.stop)])
"""An encoder's lost zero changes these: the level, and the phase of the kinematic error."""
MEMORY_S = 3600.0
"""Teeth do not change; what imitates a slope (eccentricity, wind-up) may, so that an hour of motion is enough."""
LEVEL_MEMORY_S = 10.0
"""The level (mounts, bearings) wanders as much in this time as ten seconds of data tell of it: slower is let go."""
PRIOR_RAD = 1e-6
"""The prior is weighed by this twist noise, roughly any encoder's, for the prior is wide."""
PRIOR_SD = np.array([1.0, 10.0, 3e-4, 0.1, 0.02, *[1e-2] * (2 * len(ORDERS))])
"""Prior sd of the unknowns: slope 1, level 10 rad, the compliance of the softest gear, lag 0.1 s, skew 20 ms, waves
1e-2 rad."""
LOAD_SD = 1.0
"""Prior sd of the twist [rad] that a load or an eccentric encoder makes per unit of its column: none makes as much."""
COMPLIANCE_SHARE = 0.3
"""Sd of the prior compliance over itself once the torsion balance knows the stiffness: one sine cannot tell it from the
ratio, and what the balance knows from the same data must not count twice."""
MIN_FREEDOM = 60.0
"""Before anything is said there are so many independent samples more than unknowns."""
GATE = 8.0
"""A block whose residual is this many times the noise contradicts: a jump, a shock."""
SOLVE_EVERY_S = 0.5
"""Ten unknowns solved for more often would cost much and show nothing new."""
GROUP_S = 1.0
"""Residuals that stay alike for this long are found out by their sum over it, and widen the sd."""
GROUPS_KEPT = 200.0
NOTICED = 3.0
"""Beyond so many sd of the groups' scatter residuals are taken for alike."""
FAR_RAD = 10.0
"""The output angle is counted from nearby, for the digits' sake."""


class Slope:
    """The regression: information about [unknowns | twist], in units of one raw sample's noise."""

    def __init__(self, loads: int = 0) -> None:
        """`loads`: so many unknowns more, each a torque per output angle of a size that nobody knows."""
        self.unknowns = COLUMNS + loads
        self._prior_sd = np.append(PRIOR_SD, np.full(loads, LOAD_SD))
        self.start_over()

    def start_over(self) -> None:
        """Know nothing."""
        self.moments = np.zeros((self.unknowns + 1, self.unknowns + 1))
        self.samples = 0.0
        self.value = np.full(self.unknowns, math.nan)
        self.covariance = np.full((self.unknowns, self.unknowns), math.nan)
        self.noise_rad2 = self._slow_rad2 = math.nan
        """variance of a filtered twist sample; and of a raw one, if all noise were as dense as slow noise is"""
        self._from_rad = math.nan
        self._begin_group()
        self._scatter = np.zeros(3)
        self._forget_waiting()

    def columns(
        self, stretch: Stretch, spring_Nm: Array, loads: Array, error_rad: Array, rows: NDArray[np.bool_]
    ) -> Array:
        """(n, unknowns + 1) unknowns' columns and twist. `spring_Nm` (n,) torque that winds up spring and damper."""
        motion = stretch.motion
        if not abs(motion.theta_out_rad[0] - self._from_rad) < FAR_RAD:
            self._count_from(float(motion.theta_out_rad[0]))
        joined = np.empty((len(motion), self.unknowns + 1))
        joined[:, SLOPE] = motion.theta_out_rad - self._from_rad
        joined[:, LEVEL] = 1.0
        joined[:, COMPLIANCE] = spring_Nm
        joined[:, LAG] = motion.twist_rate_rad_s + stretch.kinematic_rate @ error_rad
        joined[:, SKEW] = motion.velocity_out_rad_s + motion.twist_rate_rad_s
        joined[:, WAVES] = stretch.kinematic
        joined[:, COLUMNS:-1] = loads
        joined[:, -1] = motion.twist_rad
        return joined if rows.all() else joined[rows]

    def _count_from(self, place_rad: float) -> None:
        if math.isfinite(self._from_rad):
            step = place_rad - self._from_rad
            self.moments[SLOPE] -= step * self.moments[LEVEL]
            self.moments[:, SLOPE] -= step * self.moments[:, LEVEL]
            self._waiting[SLOPE] -= step * self._waiting[LEVEL]
            self._waiting[:, SLOPE] -= step * self._waiting[:, LEVEL]
        self._from_rad = place_rad

    def let_go(self, unknowns: NDArray[np.intp]) -> None:
        """Forget these unknowns and keep what is known of the others."""
        self.moments += self._waiting
        self.samples += self._waiting_samples
        self._forget_waiting()
        m = self.moments
        inside = m[np.ix_(unknowns, unknowns)]
        ridge = np.diag(1e-12 * (1.0 + inside.diagonal()))
        self.moments = m - m[:, unknowns] @ np.linalg.solve(inside + ridge, m[unknowns])
        self.moments[unknowns] = self.moments[:, unknowns] = 0.0

    def take(self, joined: Array, duration_s: float) -> bool:
        """Take samples in; False, and nothing done, when they contradict what is known."""
        here = joined.T @ joined
        left = np.append(-self.value, 1.0)
        if math.isfinite(self.noise_rad2):
            products = left @ here
            if float(products @ left) > GATE**2 * self.noise_rad2 * len(joined) + PRIOR_RAD**2:
                return False
            self._follow_scatter(here, products, duration_s)
        self._waiting += here
        self._waiting_samples += len(joined)
        self._waiting_s += duration_s
        return True

    def wander(self, rate_hz: float) -> None:
        """What waited is taken in, and its time passes: the level moves a little, old motion fades."""
        duration_s, m = self._waiting_s, self.moments
        row = m[LEVEL].copy()
        drift = duration_s / (rate_hz * LEVEL_MEMORY_S**2)
        keep = 1.0 - min(duration_s / MEMORY_S, 1.0)
        m -= row[:, None] * (row / (1.0 / max(drift, 1e-300) + row[LEVEL]))
        m *= keep
        m += self._waiting
        self.samples = self.samples * keep + self._waiting_samples
        self._forget_waiting()

    def _forget_waiting(self) -> None:
        self._waiting = np.zeros_like(self.moments)
        self._waiting_samples = self._waiting_s = 0.0

    @property
    def due(self) -> bool:
        """Whether what waits is worth solving for."""
        return self._waiting_s >= SOLVE_EVERY_S

    def solve(self, bandwidth: float, stiffness: float, slow: float = 1.0) -> None:
        """The unknowns from all that was taken in. `bandwidth`: share of the samples that are independent; `slow`:
        density of the noise at low frequencies, where what tells the unknowns lies, over its mean."""
        mean, sd = np.zeros(self.unknowns), self._prior_sd
        if stiffness * PRIOR_SD[COMPLIANCE] > 1:
            mean[COMPLIANCE], sd = 1 / stiffness, sd.copy()
            sd[COMPLIANCE] = COMPLIANCE_SHARE / stiffness
        prior = (PRIOR_RAD / sd) ** 2
        right = self.moments[:-1, -1]
        matrix = self.moments[:-1, :-1] + np.diag(prior)
        scale = 1.0 / np.sqrt(matrix.diagonal())
        factor, failed = lapack.dpotrf(matrix * np.outer(scale, scale))
        freedom = self.samples * bandwidth - self.unknowns
        if failed or freedom < MIN_FREEDOM:
            return
        upper = np.triu(lapack.dpotri(factor)[0])
        inverse = (upper + np.triu(upper, 1).T) * np.outer(scale, scale)
        self.value = inverse @ (right + prior * mean)
        # not yy - value @ right: that would lose the digits that a wrong nominal ratio takes
        left = np.append(-self.value, 1.0)
        self.noise_rad2 = max(float(left @ self.moments @ left), 0.0) * bandwidth / freedom
        self._slow_rad2 = self.noise_rad2 / bandwidth * slow
        self.covariance = inverse * self._slow_rad2

    def _follow_scatter(self, here: Array, products: Array, duration_s: float) -> None:
        """Whether residuals add up over a second as independent ones would, along slope and skew."""
        pull = self.covariance[WATCHED] / self.covariance[WATCHED, WATCHED][:, None]
        reach = pull @ here[:-1, :-1]
        self._group += pull @ products[:-1]
        self._group_power += (reach * pull).sum(axis=1) * self._slow_rad2
        self._group_reach += reach
        self._group_s += duration_s
        if self._group_s >= GROUP_S:
            doubt = ((self._group_reach @ self.covariance) * self._group_reach).sum(axis=1)
            share = self._group**2 / np.maximum(self._group_power + doubt, 1e-300)
            self._scatter = (1 - 1 / GROUPS_KEPT) * self._scatter + np.array([*share, 1.0])
            self._begin_group()

    @property
    def scatter(self) -> Array:
        """(2,) of slope and skew: mean square of the groups' sums over that of independent residuals."""
        return self._scatter[:2] / max(float(self._scatter[2]), 1e-300)

    def _begin_group(self) -> None:
        self._group, self._group_power, self._group_s = np.zeros(2), np.zeros(2), 0.0
        self._group_reach = np.zeros((2, self.unknowns))

    def known(self, unknown: int) -> tuple[float, float]:
        """Value and sd; NaN before anything is known."""
        sd = math.sqrt(max(float(self.covariance[unknown, unknown]), 0.0))
        groups = self._scatter[2]
        if groups > 0:
            share = float(self.scatter[0 if unknown == SLOPE else 1])
            if share > 1 + NOTICED * math.sqrt(2 / groups):
                sd *= math.sqrt(share)
        return float(self.value[unknown]), sd

    @property
    def stiffness(self) -> float:
        """That the twist beside ratio, skew and waves tells [N m/rad]; NaN unless it is four sd off nothing."""
        compliance, sd = self.known(COMPLIANCE)
        return 1.0 / compliance if compliance > SURE * sd else math.nan

    def dump(self) -> dict[str, Any]:
        """Plain data; `load` takes it back."""
        known = math.isfinite(self._from_rad)
        return {
            "moments": (self.moments + self._waiting).ravel().tolist(),
            "samples": self.samples + self._waiting_samples,
            "from_rad": self._from_rad if known else None,
            "scatter": self._scatter.tolist(),
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave. Raises KeyError, TypeError or ValueError when it does not fit."""
        moments = np.array(state["moments"], dtype=float).reshape(self.moments.shape)
        scatter = np.array(state["scatter"], dtype=float).reshape(3)
        samples = float(state["samples"])
        if not (np.isfinite(moments).all() and np.isfinite(scatter).all() and math.isfinite(samples)):
            raise ValueError("state is not finite")
        self.start_over()
        self.moments, self.samples, self._scatter = moments, samples, scatter
        self._from_rad = math.nan if state["from_rad"] is None else float(state["from_rad"])


MOVING_RAD = 3e-3
"""Below this travel of the output in a block rounding errors stand still and do not average out (guess)."""
RESTART_S = 5.0
"""After this long of blocks that contradict, new level or not, it is the regression that is wrong, and it starts
over."""
MIN_SHARE = 3e-4
"""The ratio is valid when its sd is below this share of it: one tooth in a hundred is 1e-2."""
SKEW_SD_S = 1e-4
"""The skew is valid when its sd is below this: a tenth of a sample at 1 kHz."""
TEETH_SURE, TEETH_BETTER = 4.0, 0.7
"""A ratio this many sd from that of before is another one; one that is known better, by the second factor, is kept."""
LASTING_S = 1.0
"""A jump is a new level when the twist has stayed there for this long: twice what a frozen encoder goes unnoticed."""


class RatioEstimator:
    """`nominal` ratio with sign."""

    def __init__(self, nominal: float, fir: FirSet, loads: int = 0) -> None:
        """`loads`: how many torques of unknown size follow the output angle, and may look like another ratio."""
        self.nominal = nominal
        self.time_s = math.nan
        self.slope = Slope(loads)
        self._fir = fir
        self._refused_s = 0.0
        self._others = False
        self._sensors_rad2, self._slow, self._freedom, self._bandwidth = math.nan, 1.0, math.inf, 1.0
        self._lost = True
        self._teeth = (math.nan, math.nan)
        """slope and sd as they were best known"""
        self.shift = 0.0
        """by which share another ratio is seen than before, which no gear can make; 0 while it is the same"""

    def update(
        self,
        block: Block,
        stretch: Stretch | None,
        stiffness: float = math.nan,
        error_rad: Array | None = None,
        others_Nm: Array | None = None,
        loads: Array | None = None,
    ) -> None:
        """Take in one block and the motion it completed. What the torsion balance knows of it: `stiffness` [N m/rad],
        NaN while unknown; `error_rad`, sine and cosine of each order of the kinematic error; `others_Nm` (n,), torque
        of effects other than spring and damper; `loads` (n, m), what follows the output angle, of unknown size."""
        self._lost = not np.count_nonzero(block.valid("theta_in_rad", "theta_out_rad"))
        if self._lost:
            return
        self.time_s = block.end_s
        if stretch is None:
            return
        error_rad = np.zeros(2 * len(ORDERS)) if error_rad is None else error_rad
        loads = np.zeros((len(stretch.motion), self.slope.unknowns - COLUMNS)) if loads is None else loads
        self._regress(stretch, stiffness, error_rad, others_Nm, loads)

    def _regress(
        self, stretch: Stretch, stiffness: float, error_rad: Array, others_Nm: Array | None, loads: Array
    ) -> None:
        motion, slope = stretch.motion, self.slope
        duration_s = len(motion) / motion.rate_hz
        bandwidth = self._bandwidth = self._fir.bandwidth * self._fir.rate_hz / motion.rate_hz
        if stretch.fresh:
            slope.let_go(ZEROS)
        if self._others != (others_Nm is not None):
            self._others = not self._others
            slope.start_over()
        spring_Nm = motion.torque_Nm if others_Nm is None else motion.torque_Nm - others_Nm
        rows = stretch.valid & np.isfinite(spring_Nm) & np.isfinite(loads).all(axis=1)
        out = motion.theta_out_rad
        if np.count_nonzero(rows) < 2 or out.max() - out.min() < MOVING_RAD:
            return
        joined = slope.columns(stretch, spring_Nm, loads, error_rad, rows)
        if not slope.take(joined, duration_s):
            self._refuse(duration_s)
            return
        self._refused_s = 0.0
        if slope.due:
            slope.wander(motion.rate_hz)
            slope.solve(bandwidth, stiffness, self._slow)
            self._compare()

    def start_over(self) -> None:
        """What was learned is of another gear, or of wrong readings; what the teeth are stays."""
        self.slope.start_over()

    def _compare(self) -> None:
        """With the ratio of before: teeth do not change, and what is not theirs is doubt about the ratio."""
        (value, sd), (before, before_sd) = self._known(SLOPE), self._teeth
        if not sd < MIN_SHARE:
            return
        apart = abs(value - before)
        agree = not apart > TEETH_SURE * math.hypot(sd, before_sd)
        self.shift = 0.0 if agree else value - before
        if agree and not sd > TEETH_BETTER * before_sd:
            self._teeth = (value, sd)

    def _refuse(self, duration_s: float) -> None:
        """A jump that lasts is a new level; what no level mends is another gear."""
        before = self._refused_s
        self._refused_s += duration_s
        if before < LASTING_S <= self._refused_s:
            self.slope.let_go(ZEROS)
            self.slope.value = np.full(self.slope.unknowns, math.nan)
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
        sd = math.hypot(sd, self.shift)
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
        return {"slope": self.slope.dump(), "teeth": [*self._teeth] if math.isfinite(sum(self._teeth)) else None}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave."""
        teeth = state.get("teeth")
        self.slope.load(state["slope"])
        self._teeth = (float(teeth[0]), float(teeth[1])) if teeth is not None else (math.nan, math.nan)
        self.slope.let_go(ZEROS)


TIMING_SHARE = 0.1
"""A skew that makes more than this share of the twist must be removed before torque effects are named (guess)."""
HIDING_SHARE = 1.0
"""A skew that makes more of the twist than the torque does leaves no stiffness to be told (guess; with six times as
much one came out at a fortieth of its size)."""
SURE = 4.0
"""A skew of this many sd is one."""
BACK_SHARE = 0.7
"""The timing carries again below this share of TIMING_SHARE."""
EVERY_BLOCKS = 2
"""One block in so many is looked at."""
KEEP = 0.95
"""From one block to the next so much of speed's and torque's power is kept: about ten seconds."""


def _models_skew(model: Model) -> bool:
    """Whether a model has an effect that takes the skew out of damping and friction: itself, or what looks like it."""
    skew = find("encoder_skew", "torsion")
    rows = [row for effect in model.effects if (row := CATALOGUE.get((model.balance, effect.name)))]
    return any(row is skew or twin(row, skew) for row in rows)


class SkewWatch:
    """Follows the skew against what the gear is twisted by."""

    def __init__(self, model: Model) -> None:
        self._modelled = _models_skew(model)
        self._speed = self._torque = 0.0
        self._blocks = 0
        self._told = False
        """whether the skew is known now"""
        self.carries = True
        """False while damping and friction cannot be told from skew"""
        self.share = 0.0
        """twist that the skew makes over that of the torque, rms over rms"""

    @property
    def hides_spring(self) -> bool:
        """Whether most of the twist is of the skew, and whatever else is told from it is of it too."""
        return not self._modelled and self._told and self.share > HIDING_SHARE

    def update(self, stretch: Stretch | None, skew: tuple[float, float], stiffness: float) -> None:
        """`skew` [s] with sd, and `stiffness` [N m/rad], NaN while unknown."""
        self._blocks += 1
        if stretch is None or self._blocks % EVERY_BLOCKS or not stretch.valid.all():
            return
        speed, torque = stretch.motion.velocity_out_rad_s, stretch.motion.torque_Nm
        self._speed = KEEP * self._speed + float(speed @ speed)
        self._torque = KEEP * self._torque + float(torque @ torque)
        value_s, sd_s = skew
        self._told = math.isfinite(value_s)
        if not stiffness > 0 or not math.isfinite(value_s) or not self._torque > 0:
            return
        self.share = abs(value_s) * stiffness * math.sqrt(self._speed / self._torque)
        limit = TIMING_SHARE if self.carries else BACK_SHARE * TIMING_SHARE
        self.carries = self._modelled or not (self.share > limit and abs(value_s) > SURE * sd_s)
