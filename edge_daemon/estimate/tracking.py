"""The recursive estimate of one balance: stiffness, damping, friction and kinematic error of a drive, block by block.

Order of a block: is there excitation, what does the model of a moment ago predict, which samples are outliers, how
noisy is it, then the update. The constant and the kinematic error are always in the regression, so that neither
encoder zeros nor transmission error leak into stiffness; encoder noise in the columns is compensated with its exact
second moments (see `recursive`), because it shrinks a stiffness and never averages out.
"""

from __future__ import annotations

import math
import sys
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import lapack

from edge_daemon.estimate.change import SHIFT, StiffnessChange
from edge_daemon.estimate.dry import DryTwist
from edge_daemon.estimate.excitation import Excitation, SensorNoise
from edge_daemon.estimate.kinematics import FirSet, Mask
from edge_daemon.estimate.model_error import ModelError
from edge_daemon.estimate.prediction import DAMPING, can_be_predicted, gear_of, is_credible, rows_of
from edge_daemon.estimate.prior import STIFFNESS, prior
from edge_daemon.estimate.recursive import AmplitudeFilter, ColumnNoise, Compressed, NoiseLevel, compress, widening
from edge_daemon.estimate.regressors import (
    KINEMATIC,
    OFFSET,
    PP_WAVES,
    Key,
    Linearisation,
    Regressors,
    Sensors,
    TorqueNoise,
)
from edge_daemon.estimate.streaming import ORDERS, Stretch
from edge_daemon.records import Array, Estimate, Motion, Status
from edge_daemon.settings import Estimation

EXCITED = 4.0
"""twist and torque must vary by this many times the variance that sensor noise alone gives them"""
OUTLIER = 8.0
"""samples beyond this many sd are left out: an unmodelled friction is bounded by about 2, a glitch is not (guess)"""
SURPRISE = 4.0
"""a block whose innovation has this many times its expected variance is left out (chance 1e-4 with nine columns)"""
BREAK_BLOCKS = 10
"""after this many such blocks in a row it is the model that is wrong: doubt is given back"""
BREAK_DOUBT = 0.01
"""share of the prior variance given back then: a tenth of the prior sd"""
VALID_BELOW, INVALID_ABOVE = 0.05, 0.10
"""an amplitude turns valid when its doubt is below this share of the torque, and stays so up to the second"""
IDLE_S, ACTIVE_S = 5.0, 0.5
"""not excited after this long without excitation, excited again after this much of it"""
LOST_S = 2.0
"""invalid after this long without usable samples"""
PATTERN_S = 0.5
"""an effect that the model lacks repeats with the motion: it averages out no longer than this (guess, of the size of
a period of motion); more data do not make such an estimate more certain. Within it the pattern has as many degrees
of freedom as the motion, two per hertz of the motion's own bandwidth, not of the filter's: a friction turns round
when the motion does"""
COURSE_BLOCKS = 5
"""the peak-to-peak value of the kinematic error is found anew after this many"""
NOISE_GUESS = 0.1
"""of the torque: how wrong a model may be, until the data say how wrong it is"""
DRY_ROUND = 2.0
"""and once more with friction simulated, where that can be"""
HELD = 0.6
"""warm-ups after such a start during which predictions stay around what was known at it"""
LINEAR_ROUNDS, CURVED_ROUNDS = (1.0,), (0.6, 1.0, 1.4)
"""warm-ups after which to learn anew around what was found; a sign sees the kinematic error's rate in full, and only
the second time around what is left of it"""
FOLLOW_AFTER = 2.0
"""warm-ups after which the point of linearisation follows the newest estimate"""
FOLLOW_EVERY_S = 1.0
SMALLEST_NOISE = 1e-10
"""of the torque: noise-free data would otherwise divide by zero"""
KNOWN = 5.0
"""a stiffness of this many sd is good enough to refer the kinematic error to"""


class _Equation(NamedTuple):
    """Rows of a regression."""

    motion: Motion
    columns: Array
    """(n, k)"""
    torque: Array
    """(n,)"""
    good: Mask
    """(n,)"""
    usable: Mask
    """samples of the stretch"""
    noise: TorqueNoise


class BalanceTracker:
    """Amplitudes of one model, held against one drive's motion."""

    def __init__(
        self, regressors: Regressors, fir: FirSet, sensors: Sensors, settings: Estimation, torque_measured: bool = False
    ) -> None:
        self.regressors = regressors
        self.model = regressors.model
        self.errors = ModelError()
        self._curved = regressors.curved & (regressors.index(*STIFFNESS) is not None)
        self._rounds: tuple[float, ...] = CURVED_ROUNDS if self._curved.any() else LINEAR_ROUNDS
        self.resets = 0
        self.restarts = 0
        """of the prediction of a dry gear, from nothing"""
        self.changes = 0
        """sudden ones, of the stiffness, so far"""
        self.last_change = 0
        """-1 a loss, 1 a gain"""
        spring = (STIFFNESS, DAMPING, (OFFSET, OFFSET))
        self._is_stiffness = np.array([key == STIFFNESS for key in regressors.keys], dtype=float)
        self._others = np.array([key not in spring and key[0] != KINEMATIC for key in regressors.keys])
        self._settings = settings
        self._noise = SensorNoise(regressors, fir, sensors, torque_measured)
        self._fir = fir
        self._dry = DryTwist(self.model.ratio) if can_be_predicted(self.model, torque_measured) else None
        if self._dry is not None:
            self._rounds = (*CURVED_ROUNDS, DRY_ROUND)
        self._rate_hz = fir.rate_hz
        self._bandwidth = fir.bandwidth
        self._start_over()

    def _start_over(self) -> None:
        """Know nothing but the model file."""
        if self._dry is not None:
            self._dry.forget()
        self._rate_hz, self._bandwidth = self._fir.rate_hz, self._fir.bandwidth
        k = len(self.regressors.keys)
        self.filter: AmplitudeFilter | None = None
        self._level = NoiseLevel(0.0)
        self._torque_rms = 0.0
        self._change = StiffnessChange()
        self._excitation = Excitation(k, self._rate_hz)
        self._excited_s = 0.0
        self._idle_s = self._active_s = self._lost_s = self._elapsed_s = 0.0
        self._was_idle = False
        self._breaks = 0
        self._point: Linearisation | None = None
        self._round = 0
        self._around: Array | None = None
        self._course, self._course_age = (math.nan, math.nan), 0
        self._held_until_s = 0.0
        self._followed_s = 0.0
        self._valid = np.zeros(k, dtype=bool)
        self._wider = np.ones(k)
        self.sd = np.full(k, math.nan)
        """(k,) standard deviations of the amplitudes, what the model lacks included; NaN before anything is known"""
        self.others_Nm: Array | None = None
        """(n,) torque of the newest stretch that is neither spring's nor damper's; None while none is known"""
        self.time_s = math.nan

    def update(self, stretch: Stretch | None, duration_s: float) -> None:
        """Take in what a block of `duration_s` completed; None when it completed nothing usable."""
        self._elapsed_s += duration_s
        self.others_Nm = None
        if stretch is None:
            self._lost_s += duration_s
            return
        self.time_s = float(stretch.motion.time_s[-1])
        if stretch.motion.rate_hz != self._rate_hz and not self._predicts:
            self._sampled_at(stretch.motion.rate_hz)
        self._noise.follow(stretch.jitter_rad2)
        if stretch.fresh:
            self._reopen_constant()
        equation = self._equation(stretch)
        self._lost_s = 0.0 if equation.usable.any() else self._lost_s + duration_s
        if self._is_excited(stretch, equation.usable):
            self._idle_s, self._active_s = 0.0, self._active_s + duration_s
            self._excited_s += duration_s * float(equation.usable.mean())
            if np.count_nonzero(equation.good) > 1:
                self._learn(stretch, equation)
            self._refresh_sd()
            self._linearise()
        else:
            self._idle_s, self._active_s = self._idle_s + duration_s, 0.0
        self._judge()

    def _equation(self, stretch: Stretch) -> _Equation:
        """What this stretch says about the amplitudes: the balance of torques, or where a gear with dry friction is
        known well enough to be simulated, measured against predicted twist."""
        if self._predicts and self.filter is not None:
            assert self._point is not None
            if is_credible(self.filter.value, self._point, self.regressors):
                return self._predicted(stretch, self.filter)
            self._start_over()
            self.restarts += 1
        columns, torque = self.regressors.equation(stretch, self._point or Linearisation())
        good = stretch.valid
        if not math.isfinite(float(columns.sum() + torque.sum())):
            good = good & np.isfinite(torque) & np.isfinite(columns).all(axis=1)
        if self._others.any() and self._settled and self.filter is not None:
            self.others_Nm = columns[:, self._others] @ self.filter.value[self._others]
        return _Equation(stretch.motion, columns, torque, good, good, self._noise.torque)

    def _predicted(self, stretch: Stretch, filt: AmplitudeFilter) -> _Equation:
        """Measured minus predicted twist, as torques: linear around the newest amplitudes."""
        assert self._dry is not None and self._point is not None and stretch.arguments is not None
        usable, light = stretch.valid, stretch.arguments
        if stretch.fresh or not usable.all() or not self._is_excited(stretch, usable):
            self._dry.forget()
        held = self._around is not None and self._excited_s < self._held_until_s
        value = self._around if held and self._around is not None else filt.value
        gear = gear_of(value, self._point, self.regressors)
        seen = self._dry.predict(light, gear)
        n, k = len(light.motion), len(value)
        white = TorqueNoise(
            ColumnNoise(np.zeros((k, k)), np.zeros(k)), gear.stiffness**2 * self._noise.twist_rad2 / self._fir.bandwidth
        )
        if seen is None or not seen.settled:
            return _Equation(light.motion, np.zeros((n, k)), np.zeros(n), np.zeros(n, dtype=bool), usable, white)
        self.others_Nm = self._dry.friction_Nm(light.balance)
        columns, torque = rows_of(seen, gear, value, self._point, self.regressors)
        good = np.isfinite(torque) if usable.all() else np.zeros(n, dtype=bool)
        return _Equation(light.motion, columns, torque, good, usable, white)

    @property
    def _predicts(self) -> bool:
        return self._dry is not None and self._point is not None and self._round >= len(CURVED_ROUNDS)

    def _sampled_at(self, rate_hz: float) -> None:
        """The rate of the stretches: fewer samples, of which more are independent."""
        self._rate_hz = rate_hz
        self._bandwidth = self._fir.bandwidth * self._fir.rate_hz / rate_hz
        self._excitation.rate_hz = rate_hz
        self._noise.sampled_at(rate_hz)

    def heard_motor(self, sd_rad: float) -> None:
        """White noise of a motor angle that comes from sound [rad]; NaN while it is not heard."""
        self._noise.heard(sd_rad)

    def _reopen_constant(self) -> None:
        self.regressors.forget_states()
        offset = self.regressors.offset
        if self.filter is not None and offset is not None:
            share = np.zeros(len(self.regressors.keys))
            share[offset] = 1.0
            self.filter.forget(share)
        self._refresh_sd()

    def _is_excited(self, stretch: Stretch, good: Mask) -> bool:
        if np.count_nonzero(good) < 2:
            return False
        motion = stretch.motion
        moved = _variance(motion.torque_Nm, good) > EXCITED * self._noise.torque.torque
        if self.model.balance == "drive":
            return bool(moved and np.ptp(motion.theta_out_rad[good]) > 0)
        return bool(moved and _variance(motion.twist_rad, good) > EXCITED * self._noise.twist_rad2)

    def _learn(self, stretch: Stretch, equation: _Equation) -> None:
        _, columns, torque, good, usable, noise = equation
        if self.filter is None:
            self._torque_rms = math.sqrt(float(np.mean(torque[good] ** 2)))
            self._level = self._new_level()
            self.filter = prior(self.regressors, columns[good], self._torque_rms, self._settings.stiffness_drift_per_h)
        if self._point is None:
            columns[:, self._curved] = 0.0
        value = self.filter.value
        if self._settled:
            error = torque - columns @ value
            self.errors.add(equation.motion, equation.motion.torque_Nm, error, good, noise.variance(value))
            doubt = np.einsum("ij,ij->i", columns @ self.filter.covariance, columns)
            kept = good & (error**2 < OUTLIER**2 * (self._level.sd**2 * self._bandwidth + doubt))
            block = compress(columns[kept], torque[kept])
            if kept.sum() < good.sum() / 2 or self._is_surprised(self.filter, block):
                self._on_break(self.filter, compress(columns[good], torque[good]), noise.inside)
                return
            self._breaks, good = 0, kept
        else:
            block = compress(columns[good], torque[good])
        self._absorb(self.filter, block, noise)
        self._follow_power(columns[good], stretch.motion.torque_Nm[usable])

    @property
    def _settled(self) -> bool:
        """Learned a first time, and again around what was found: from here on predictions mean something."""
        return self._excited_s >= 2 * self._settings.warm_up_s

    def _absorb(self, filt: AmplitudeFilter, block: Compressed, noise: TorqueNoise) -> None:
        value = filt.value
        self._level.floor = math.sqrt(noise.variance(value) / self._bandwidth)
        self._level.before(block, self._bandwidth)
        doubt = float(np.sum((block.factor @ filt.covariance) * block.factor))
        innovation = block.target - block.factor @ value
        self._level.after(innovation, doubt)
        if self._settled and self._changed(filt, block, innovation, noise.inside):
            filt.forget(self._is_stiffness * (2 * SHIFT * value / filt.scale) ** 2)
        noise_sd = max(self._level.sd, SMALLEST_NOISE * float(np.linalg.norm(block.target)), sys.float_info.min)
        filt.update(block, noise_sd, self._elapsed_s, noise.inside)
        self._elapsed_s = 0.0
        if not filt.finite:
            self._start_over()
            self.restarts += 1

    def _changed(self, filt: AmplitudeFilter, block: Compressed, innovation: Array, noise: ColumnNoise) -> bool:
        """A sudden change of stiffness, against the doubt that a missing effect leaves too."""
        i = self.regressors.index(*STIFFNESS)
        if i is None or not filt.value[i] > 0:
            return False
        wider = float(self._wider[i]) ** 2 if self._level.structure > 0 else 1.0
        variance = (self._level.sd**2 + SMALLEST_NOISE**2) * wider
        column, kept = block.factor[:, i], np.eye(len(innovation))
        if (offset := self.regressors.offset) is not None:  # a softer spring also gives less for the hidden zero
            column = column + block.factor[:, offset] * (float(filt.value[offset]) / float(filt.value[i]))
        spread = block.factor @ filt.covariance @ block.factor.T + variance * kept
        weighed = lapack.dposv(spread, column)[1]
        inside = block.samples * (float(noise.torque[i]) - float(noise.columns[i] @ filt.value)) / variance
        energy = float(column @ weighed) - block.samples * float(noise.columns[i, i]) / variance
        found = self._change.follow(
            float(innovation @ weighed) - inside, energy, float(filt.value[i]), float(filt.sd[i])
        )
        if found:
            self.changes, self.last_change = self.changes + 1, found
        return found != 0

    def _follow_power(self, columns: Array, torque: Array) -> None:
        stiffness = self.regressors.index(*STIFFNESS)
        if self._point is not None and stiffness is not None:
            columns = columns.copy()
            columns[:, stiffness] += self._point.zero_rad
        self._excitation.follow(columns, torque)

    def _is_surprised(self, filt: AmplitudeFilter, block: Compressed) -> bool:
        """Whether the columns explain far more of this block than the amplitudes so far do."""
        innovation = block.target - block.factor @ filt.value
        doubt = float(np.sum((block.factor @ filt.covariance) * block.factor))
        return bool(innovation @ innovation > SURPRISE * (len(innovation) * self._level.sd**2 + doubt))

    def _on_break(self, filt: AmplitudeFilter, block: Compressed, noise: ColumnNoise) -> None:
        """A block that contradicts all before: a shock passes, a changed gear stays, and then the data are right."""
        if not self._predicts and self._changed(filt, block, block.target - block.factor @ filt.value, noise):
            filt.forget(BREAK_DOUBT * self._is_stiffness)
            self._breaks = 0
            return
        self._breaks += 1
        if self._breaks >= BREAK_BLOCKS and self._predicts:
            self._start_over()  # a prediction around wrong amplitudes leads further astray: the balance first
            self.restarts += 1
        elif self._breaks >= BREAK_BLOCKS:
            filt.forget(np.full(len(filt.value), BREAK_DOUBT))
            self._level = self._new_level()
            self._breaks = 0
            self.resets += 1

    def _new_level(self) -> NoiseLevel:
        return NoiseLevel(self._level.floor, NOISE_GUESS * self._torque_rms / math.sqrt(self._bandwidth))

    def _linearise(self) -> None:
        """After the warm-up, learn everything anew around what it found; follow the newest only after as long again.

        Right after the new start the estimates are those of a block or two, and no point to linearise around.
        """
        filt, place = self.filter, self.regressors.kinematic
        again = self._round < len(self._rounds)
        due_s = self._settings.warm_up_s * (self._rounds[self._round] if again else FOLLOW_AFTER)
        due_s = max(due_s, self._followed_s + FOLLOW_EVERY_S * (not again))
        if filt is None or place.start == place.stop or self._excited_s < due_s:
            return
        stiffness, damping = self.amplitude(STIFFNESS), self.amplitude(DAMPING)
        if stiffness is None or not stiffness[0] > KNOWN * stiffness[1]:
            return
        damping_s = max(damping[0], 0.0) / stiffness[0] if damping is not None else 0.0
        if again:
            self._round += 1
            if self._predicts:
                self._bandwidth, self._rate_hz = 1.0, self._fir.rate_hz
                self._around, self._held_until_s = filt.value, self._excited_s + HELD * self._settings.warm_up_s
            filt.forget(np.ones(len(self.regressors.keys)))
            self._level = self._new_level()
        offset = self.regressors.offset
        zero_rad = float(filt.value[offset]) / stiffness[0] if offset is not None else 0.0
        before = self._point or Linearisation()
        error_rad = before.whole_error(stiffness[0], filt.value[place])
        self._point = Linearisation(stiffness[0], damping_s, error_rad, zero_rad)
        filt.rebase(*self.regressors.rebasing(before, self._point))
        self._followed_s = self._excited_s

    @property
    def error_rad(self) -> Array:
        """Sine and cosine [rad] of the kinematic error; zeros where there is none to know."""
        point, stiffness = self._point or Linearisation(), self.amplitude(STIFFNESS)
        place = self.regressors.kinematic
        if self.filter is None or stiffness is None or not stiffness[0] > 0 or place.start == place.stop:
            return np.zeros(2 * len(ORDERS))
        return point.whole_error(stiffness[0], self.filter.value[place])

    def _inflation(self, filt: AmplitudeFilter) -> Array:
        """(k,) factor on the filter's sd: the part of the error that is structure, not noise, does not average."""
        # a law of friction that is not quite right looks just like the other amplitudes
        freedom = 1.0 if self._predicts else self.pattern_freedom
        return widening(self._level.structure, filt.samples * self._bandwidth, freedom)

    @property
    def pattern_freedom(self) -> float:
        """Independent numbers in what the model lacks, however long the motion goes on: see `PATTERN_S`."""
        cutoff_hz = self._bandwidth * self._rate_hz / 2
        motion_hz = self._excitation.motion_hz(self._noise)
        return max(2 * PATTERN_S * (min(motion_hz, cutoff_hz) if motion_hz > 0 else cutoff_hz), 1.0)

    @property
    def twist_noise_rad2(self) -> float:
        """Variance that the sensors alone give a filtered sample of the twist."""
        return self._noise.twist_rad2

    def _refresh_sd(self) -> None:
        if self.filter is not None:
            self._wider = self._inflation(self.filter)
            self.sd = self.filter.sd * self._wider

    def _judge(self) -> None:
        """Which amplitudes are known well enough, with hysteresis."""
        idle = self._idle_s > IDLE_S or (self._was_idle and self._active_s < ACTIVE_S)
        self._was_idle = idle
        excitation = self._excitation
        if self.filter is None or not excitation.torque > 0:
            return
        doubt = self.sd * np.sqrt(excitation.columns / excitation.torque)
        limit = np.where(self._valid, INVALID_ABOVE, VALID_BELOW)
        self._valid = (doubt < limit) & self.filter.trusted
        known = (STIFFNESS, DAMPING)
        self.regressors.tie({key: self.filter.value[i] for key in known if (i := self._known(key)) is not None})

    def _known(self, key: Key) -> int | None:
        """The column of an amplitude that is known well enough."""
        i = self.regressors.index(*key)
        return i if i is not None and bool(self._valid[i]) else None

    def amplitude(self, key: Key) -> tuple[float, float] | None:
        """Value and sd of one amplitude, None when the model lacks it or nothing was learned yet."""
        i = self.regressors.index(*key)
        if i is None or self.filter is None:
            return None
        return float(self.filter.value[i]), float(self.sd[i])

    def estimate(self, name: str, unit: str, key: Key) -> Estimate:
        """One amplitude as an estimate; NaN while nothing is known of it."""
        found = self.amplitude(key)
        status = self._status(self._known(key) is not None, key)
        if found is None:
            return Estimate(name, math.nan, math.nan, unit, status, self.time_s)
        if key == STIFFNESS and status is Status.VALID and found[0] <= 0:
            status = Status.INVALID
        if key == STIFFNESS and status is not Status.VALID and not found[0] > found[1]:
            found = (math.nan, found[1])  # below one sd it may as well be nothing: no number for anybody to act on
        return Estimate(name, *found, unit, status, self.time_s)

    def spring(self, twist_rad: Array) -> tuple[Array, Array] | None:
        """(n,) torque [N m] of the gear's springs alone at (n,) twists [rad], and its sd; None before one is known."""
        columns, places = self.regressors.springs(twist_rad)
        if self.filter is None or STIFFNESS not in self.regressors.keys:
            return None
        wider = self._wider[places]
        covariance = self.filter.covariance[np.ix_(places, places)] * np.outer(wider, wider)
        variance = np.einsum("ij,jk,ik->i", columns, covariance, columns)
        return columns @ self.filter.value[places], np.sqrt(np.maximum(variance, 0.0))

    def _status(self, known: bool, key: Key) -> Status:
        if self._lost_s > LOST_S or self.regressors.index(*key) is None:
            return Status.INVALID
        if self._was_idle:
            return Status.NOT_EXCITED
        if self.filter is None or not self._settled:
            return Status.WARMING_UP
        return Status.VALID if known else Status.NOT_EXCITED

    @property
    def stiffness(self) -> float:
        """[N m/rad]; NaN unless it is known well enough."""
        i = self._known(STIFFNESS)
        return float(self.filter.value[i]) if i is not None and self.filter is not None else math.nan

    def felt(self, stretch: Stretch) -> Array:
        """(n,) twist [rad] as the gear feels it: zero and kinematic error put right as far as they are known."""
        stiffness, filt = self.amplitude(STIFFNESS), self.filter
        twist: Array = stretch.motion.twist_rad
        if stiffness is None or filt is None or not stiffness[0] > KNOWN * stiffness[1]:
            return twist
        offset = self.regressors.offset
        zero_rad = filt.value[offset] / stiffness[0] if offset is not None else 0.0
        return np.asarray(twist + stretch.kinematic @ self.error_rad + zero_rad)

    @property
    def error_status(self) -> Status:
        """What the model error is worth: it needs a model that has learned, not one that is identified."""
        if self._lost_s > LOST_S:
            return Status.INVALID
        if math.isnan(self.errors.nrmse):
            return Status.NOT_EXCITED if self._was_idle else Status.WARMING_UP
        return Status.NOT_EXCITED if self._was_idle else Status.VALID

    def kinematic_error(self) -> Estimate:
        """Peak to peak [rad] at the output."""
        stiffness, place = self.amplitude(STIFFNESS), self.regressors.kinematic
        known = self._known(STIFFNESS) is not None and bool(self._valid[place].all())
        status = self._status(known, STIFFNESS)
        if stiffness is None or self.filter is None or place.start == place.stop or not stiffness[0] > 0:
            return Estimate("kinematic_error", math.nan, math.nan, "rad", status, self.time_s)
        if self._course_age == 0:
            self._course = self._peak_to_peak(stiffness[0], self.filter)
        self._course_age = (self._course_age + 1) % COURSE_BLOCKS
        return Estimate("kinematic_error", *self._course, "rad", status, self.time_s)

    def _peak_to_peak(self, stiffness: float, filt: AmplitudeFilter) -> tuple[float, float]:
        """Of the kinematic error [rad], with sd."""
        place = self.regressors.kinematic
        course = PP_WAVES @ self.error_rad
        top, bottom = int(course.argmax()), int(course.argmin())
        value, spread = _extreme(course, top) - _extreme(course, bottom), PP_WAVES[top] - PP_WAVES[bottom]
        spread = spread * self._wider[place] / stiffness
        sd = math.sqrt(max(float(spread @ filt.covariance[place, place] @ spread), 0.0))
        return value, sd

    def dump(self) -> dict[str, Any]:
        """What was learned, as plain data; `load` takes it back."""
        return {
            "filter": self.filter.dump() if self.filter is not None else None,
            "level": self._level.dump(),
            "excitation": self._excitation.dump(),
            "noise": self._noise.dump(),
            "excited_s": self._excited_s,
            "round": self._round,
            "point": self._point.dump() if self._point is not None else None,
            "torque_rms": self._torque_rms,
            "valid": self._valid.tolist(),
            "time_s": self.time_s if math.isfinite(self.time_s) else None,
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave. Raises KeyError, TypeError or ValueError when it does not fit this model."""
        k = len(self.regressors.keys)
        filt = AmplitudeFilter.load(state["filter"]) if state["filter"] is not None else None
        if filt is not None and len(filt.value) != k:
            raise ValueError("another number of amplitudes")
        valid = np.array(state["valid"], dtype=bool)
        if valid.shape != (k,):
            raise ValueError("another number of amplitudes")
        self._excitation.load(state["excitation"])
        self._noise.load(state["noise"])
        self._level = NoiseLevel.load(state["level"])
        self._excited_s = float(state["excited_s"])
        self.time_s = math.nan if state["time_s"] is None else float(state["time_s"])
        self.filter, self._valid = filt, valid
        self._round, self._torque_rms = int(state["round"]), float(state["torque_rms"])
        self._point = Linearisation.load(state["point"]) if state["point"] is not None else None
        self._followed_s = self._excited_s
        self._reopen_constant()


def _extreme(course: Array, i: int) -> float:
    """The extreme next to place i of one period, whose first place is its last: of the parabola through three."""
    one_turn = len(course) - 1
    before, here, after = (float(course[(i + j) % one_turn]) for j in (-1, 0, 1))
    bend = before - 2 * here + after
    return here - (after - before) ** 2 / (8 * bend) if bend else here


def _variance(values: Array, good: Mask) -> float:
    """Of the good ones; a third of the cost of numpy's."""
    values = values if good.all() else values[good]
    off = values - values.sum() / len(values)
    return float(off @ off) / len(values)
