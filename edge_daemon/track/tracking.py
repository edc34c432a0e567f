"""The recursive estimate of one balance: stiffness, damping, friction and kinematic error of a drive, block by block.

A block becomes rows of a regression, the rows are learned from (`learning`), what is then known is judged (`judging`)
and read (`known`). The constant and the kinematic error are always in it, so that neither encoder zeros nor
transmission error leak into stiffness; encoder noise in columns is compensated with its second moments (`recursive`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge_daemon.config.settings import Estimation
from edge_daemon.effects.drive_waves import LEADING_SHARE, leads
from edge_daemon.effects.effect import Effect
from edge_daemon.integrator import machine_code
from edge_daemon.motion.excitation import Excitation, SensorNoise, is_excited, one_way
from edge_daemon.motion.kinematics import FirSet
from edge_daemon.motion.linear_simulation import LinearPrediction, is_linear
from edge_daemon.motion.noise_level import ColumnNoise, NoiseLevel, widening
from edge_daemon.motion.prediction_error import PredictionError
from edge_daemon.motion.reach import Reach
from edge_daemon.motion.regressors import (
    DAMPING,
    OFFSET,
    STIFFNESS,
    AmplitudeKey,
    EncoderNoise,
    Equation,
    Linearisation,
    Regressors,
)
from edge_daemon.motion.streaming import ORDERS, Stretch
from edge_daemon.records import Array, Estimate, Status
from edge_daemon.track.consistency import Consistency
from edge_daemon.track.law_prediction import LawPrediction, can_be_simulated, is_credible
from edge_daemon.track.measurement_update import MeasurementUpdate
from edge_daemon.track.model_bias import ModelBias
from edge_daemon.track.prior import held_shapes
from edge_daemon.track.recursive import PATTERN_S, AmplitudeFilter
from edge_daemon.track.relinearisation import ADEQUATE, BALANCE, CURVED, LINEAR, SIMULATED, Relinearisation
from edge_daemon.track.state import AmplitudeState
from edge_daemon.track.validity import LOST_S, DivergenceTimeout, Validity

SIMULATION_ERROR = 3e-6
"""A simulated gear errs by this share of the torque, however long it is looked at: its integrator's steps (measured
against one of a thousand steps per sample on gears of 2e4 to 1e5 N m/rad)."""
WARY = 2.0
"""Deviations are wider by this for a while after readings were wrong or the gear has changed: what follows is not quite
clean, or linear around another gear (guess; up to six deviations of before were seen)."""
CONFIRMING_BLOCKS = 2
"""The first block after something went wrong may tell no more than where the encoders count from."""
LOAD_KNOWN = 0.1
"""Doubt of what passes the gear, over the torque, below which friction may be told by it (guess)."""
RESHAPED = 0.1
"""A shape moves by this share when it is first known, and not when it follows the gear."""


class BalanceTracker:
    """Amplitudes of one model, held against one drive's motion."""

    def __init__(
        self,
        regressors: Regressors,
        fir: FirSet,
        sensors: EncoderNoise,
        settings: Estimation,
        torque_measured: bool = False,
    ) -> None:
        self.regressors = regressors
        self.model = regressors.model
        self._known = AmplitudeState(regressors)
        self.learner = MeasurementUpdate(self._known, settings.stiffness_drift_per_h)
        """takes blocks in"""
        self._lacking = ModelBias(regressors)
        self._reach = Reach(regressors, held_shapes(regressors))
        self._consistency = Consistency(len(regressors.keys))
        self._warm_up_s = settings.warm_up_s
        self._judge = Validity(len(regressors.keys), settings.warm_up_s)
        self._curved = regressors.curved & (regressors.index(*STIFFNESS) is not None)
        self._restarts = 0
        """of the simulation of a gear with laws, from nothing"""
        spring = (STIFFNESS, DAMPING, (OFFSET, OFFSET))
        self._others = np.array([key not in spring for key in regressors.keys])
        self._others[regressors.kinematic] = False
        self._others[regressors.loads] = False
        rows = [effect for effect, _, _ in regressors.rows]
        hidden = {effect.name for effect in rows if effect.told_by == "zeros"}
        hidden |= {effect.name for effect in rows if leads(effect) and not self._states(effect, LEADING_SHARE.name)}
        self._told = np.array([key[0] not in hidden for key in regressors.keys])
        self._reached = np.ones(len(regressors.keys), dtype=bool)
        """(k,) whether the motion surely comes to the range that an amplitude stands for"""
        self._noise = SensorNoise(regressors, fir, sensors, torque_measured)
        self._fir = fir
        self._prediction: LawPrediction | LinearPrediction | None = None
        schedule = CURVED if self._curved.any() else BALANCE
        if can_be_simulated(regressors, torque_measured):
            self._prediction, schedule = LawPrediction(regressors, fir), SIMULATED
        elif is_linear(self.model, torque_measured) and len(regressors.rows) == 2:
            self._prediction, schedule = LinearPrediction(regressors, fir), LINEAR
        if not isinstance(self._prediction, LawPrediction):
            regressors.hold(held_shapes(regressors))
        self._rounds = Relinearisation(self._known, settings.warm_up_s, schedule)
        self._patience = DivergenceTimeout()
        self.time_s = self.moved_s = math.nan
        """newest sample, and newest of a motion that tells the amplitudes"""
        self._seen_s = np.full(len(regressors.keys), math.nan)
        """(k,) newest sample of a motion that tells each amplitude by itself"""
        self._came_s = math.nan
        """newest sample that came, whatever it was worth"""
        self._zero_rad = math.nan
        """that the twist is counted from"""
        self._unconfirmed = 0
        """so many blocks have yet to bear out what was learned before something went wrong"""
        self._unseen = 0
        """so many blocks after a gap have yet to tell of now what was learned before it"""
        self._reset()

    def _states(self, effect: Effect, name: str) -> bool:
        """Whether the model file knows a shape: around a wrong share an error of the transmission is surely none."""
        own = self.model.effect(effect.name)
        return own is not None and name in own.parameters and own.parameters[name].identified

    def _reset(self) -> None:
        """Know nothing but the model file."""
        self._known.forget()
        for part in (self.learner, self._judge, self._rounds):
            part.start_over()
        self._lacking.forget()
        self._reach.forget()
        self._consistency.begin()
        if self._prediction is not None:
            self._prediction.forget()
        self._rate_hz = self._fir.rate_hz
        self._excitation = Excitation(len(self.regressors.keys), self._rate_hz)
        self.regressors.gear_load.forget()
        self._load_sd = math.inf
        """of what passes the gear, in the newest block"""
        self.balanced: Stretch | None = None
        """the newest stretch whose torques are known; None while none is"""
        self.others_Nm: Array | None = None
        """(n,) torque in it that is neither spring's nor damper's nor a load's; None while none is known"""
        self.loads: Array | None = None
        """(n, m) columns in it that follow the output angle; None where there are none"""
        self._newest: Stretch | None = None
        self.regressors.forget_states()

    def _start_over(self) -> None:
        self._reset()
        self._restarts += 1

    def update(self, stretch: Stretch | None, duration_s: float) -> None:
        """Take in what a block of `duration_s` completed; None when it completed nothing usable."""
        self.learner.elapsed_s += duration_s
        self.learner.recent.pass_by(duration_s)
        self.balanced, self.others_Nm, self.loads, self._newest = stretch, None, None, stretch
        if stretch is None:
            self._judge.missed(duration_s)
            return
        absent_s = float(stretch.motion.time_s[0]) - self._came_s
        self._came_s = float(stretch.motion.time_s[-1])
        if stretch.valid.any():  # what was last seen is no younger for samples that tell nothing
            self.time_s = float(stretch.motion.time_s[-1])
        if stretch.motion.rate_hz != self._rate_hz:
            self._sampled_at(stretch.motion.rate_hz)
        self._noise.follow(stretch.jitter_rad2, stretch.torque_jitter, stretch.unfiltered.shape[1])
        self._noise.at(float(np.mean(stretch.motion.temperature_degC)))
        if stretch.fresh:
            self._known.move_zero(stretch.zero_rad - self._zero_rad)
            self._zero_rad = stretch.zero_rad
            self.learner.rest()
            self._reopen_constant()
            self._unseen = self._unseen or (CONFIRMING_BLOCKS if math.isfinite(self.moved_s) else 0)
        excited = is_excited(stretch.motion, stretch.valid, self._noise, self.model.balance == "drive")
        equation = self._equation(stretch, excited)
        if self._judge.is_lost or absent_s > LOST_S:
            self.doubt()
        if absent_s > LOST_S:
            self._wander(absent_s)
        self._judge.saw(equation.usable, excited, duration_s)
        if not excited:
            self._rest(duration_s)
        else:
            if np.count_nonzero(equation.good) > 1:
                self._learn(stretch, equation)
            self._refresh_sd()
            self._linearise(duration_s)
            self._lose_patience(duration_s)
            self.moved_s = self.moved_s if self._unconfirmed or self._unseen else self.time_s
        self._weigh()

    def _rest(self, duration_s: float) -> None:
        """What cannot be watched may change, by no more than what is stated: so much is it in doubt."""
        if self._judge.rests and self.filter is not None:
            self.doubt()
            self._wander(duration_s)

    def _wander(self, unseen_s: float) -> None:
        if self.filter is not None:
            self.filter.wander(unseen_s)
            self._refresh_sd()

    def _equation(self, stretch: Stretch, excited: bool) -> Equation:
        """The balance of torques, or where the gear is known well enough, measured against predicted twist."""
        point = self._known.point
        if self._rounds.predicts and self.filter is not None and point is not None:
            if is_credible(self.filter.value, point, self.regressors):
                return self._predicted(stretch, excited, self.filter, point)
            self._start_over()
        columns, torque = self.regressors.equation(stretch, self._known.point or Linearisation())
        if len(self.regressors.loads):
            self.loads = self.regressors.load_columns(columns)
        usable = stretch.valid
        if not math.isfinite(float(columns.sum() + torque.sum())):
            usable = usable & np.isfinite(torque) & np.isfinite(columns).all(axis=1)
        drives = self.model.balance == "drive"
        good = usable & one_way(stretch.motion, self._fir, self._noise) if drives else usable
        if self._others.any() and self._judge.settled and self.filter is not None:
            self.others_Nm = columns[:, self._others] @ self.filter.value[self._others]
        held = None
        if self.filter is not None and self.regressors.held and (self._known.point or not self._curved.any()):
            held = self.regressors.torque_of_doubt(columns, self.filter.value)
        return Equation(stretch.motion, columns, torque, good, usable, self._noise.torque, held)

    def _predicted(self, stretch: Stretch, excited: bool, filt: AmplitudeFilter, point: Linearisation) -> Equation:
        """Measured minus predicted twist, as torques: linear around the newest amplitudes."""
        assert self._prediction is not None
        if stretch.fresh or not excited:
            self._prediction.forget()
        around = self._rounds.around(filt, self._judge.excited_s)
        equation = self._prediction.equation(stretch, around, point, self._noise)
        self.balanced, self.others_Nm = self._prediction.balanced or (None, None)
        if self.others_Nm is not None and self._rounds.holds:
            self.others_Nm = np.full_like(self.others_Nm, math.nan)  # of a gear that is only roughly known
        return equation

    def _sampled_at(self, rate_hz: float) -> None:
        """The rate of the stretches: fewer samples, of which more are independent."""
        self._rate_hz = self._excitation.rate_hz = rate_hz
        self._noise.sampled_at(rate_hz)

    @property
    def _bandwidth(self) -> float:
        """Share of a regression's samples that are independent."""
        return 1.0 if self._rounds.predicts else self._fir.bandwidth * self._fir.rate_hz / self._rate_hz

    def heard_motor(self, sd_rad: float) -> None:
        """White noise of a motor angle that comes from sound [rad]; NaN while it is not heard."""
        self._noise.heard(sd_rad)

    def _reopen_constant(self) -> None:
        self.regressors.forget_states()
        self._known.reopen_constant()
        self._refresh_sd()

    def shape(self, effect: str, name: str) -> tuple[float, float]:
        """A shape as it is known now, and the sd of its logarithm; NaN the sd of one that is held."""
        held, i = self.regressors.shape(effect, name), self.regressors.index(effect, name)
        if i is None or self.filter is None or not self.simulates:
            return held, math.nan
        return held * math.exp(float(self.filter.value[i])), float(self.filter.sd[i])

    def reshape(self, effect: str, name: str, value: float, moved: float = 0.0, sd: float = math.nan) -> None:
        """Let a shape be `value`, which a search has found, from now on, with this `sd` of its logarithm. What was
        learned with another is in doubt by the share `moved` of itself; after more than a step, noise and what is left
        are others too."""
        before, i, filt = self.regressors.shape(effect, name), self.regressors.index(effect, name), self.filter
        self.regressors.reshape(effect, name, value)
        if (effect, name) in self.regressors.held and math.isfinite(sd):
            self.regressors.hold({**self.regressors.held, (effect, name): sd})
        if filt is None:
            return
        if i is not None:
            offset = np.zeros(len(filt.value))
            offset[i] = -filt.value[i] if moved else math.log(before / value)
            filt.rebase(np.eye(len(offset)), offset)
            self._rounds.let_go()
        share = (moved * filt.value / filt.scale) ** 2
        share[self.regressors.shaping] = moved**2
        filt.forget(share)
        if moved > RESHAPED:
            self._lacking.forget()
            self.learner.begin_level(self._bandwidth)
            self.learner.rest()

    @property
    def simulates(self) -> bool:
        """Whether the gear is simulated with its laws, so that their shapes are learned with the amplitudes."""
        return self._rounds.predicts and isinstance(self._prediction, LawPrediction)

    def doubt(self) -> None:
        """The gear was not seen for a while: nothing of it is valid before its motion bears it out."""
        self._unconfirmed = CONFIRMING_BLOCKS

    def turned(self, sd_rad: float) -> None:
        """The motor's zero is where it was but for this sd: so much the phase of the kinematic error is in doubt."""
        filt, place = self.filter, self.regressors.kinematic
        if filt is None:
            return
        doubt = np.zeros(len(filt.value))
        waves = filt.value[place].reshape(-1, 2)
        orders = np.array(ORDERS, dtype=float)[: len(waves)]
        doubt[place] = np.repeat(orders * np.hypot(waves[:, 0], waves[:, 1]) * sd_rad, 2)
        for effect, _, own in self.regressors.rows:
            for i, wave in enumerate(effect.waves):
                if wave.angle != "output" and own.start + 2 * i + 2 <= own.stop:
                    at = slice(own.start + 2 * i, own.start + 2 * i + 2)
                    doubt[at] = wave.order * np.hypot(*filt.value[at]) * sd_rad
        filt.forget((doubt / filt.scale) ** 2)

    def _learn(self, stretch: Stretch, equation: Equation) -> None:
        learner, columns = self.learner, equation.columns
        if self.filter is None:
            learner.begin(equation, self._bandwidth)
        if self._known.point is None:
            columns[:, self._curved] = 0.0
        found = learner.mends + learner.changes
        taken = learner.take(equation, self._bandwidth, self._judge.settled, self.simulates)
        if learner.mends + learner.changes > found:
            self._unseen = 0  # what is learned anew is not of before the gap
        if learner.astray:
            self._start_over()
        elif taken is not None:
            self._unconfirmed, self._unseen = max(self._unconfirmed - 1, 0), max(self._unseen - 1, 0)
            duration_s = len(stretch.motion) / stretch.motion.rate_hz
            if self.simulates and not self._rounds.holds and self.filter is not None:
                self._consistency.follow(*self.filter.step, duration_s)
            rows = columns[taken]
            if self.filter is not None:
                self._load_sd = self.regressors.gear_load.sd(rows, self.filter.covariance)
            self._reach.follow(self.felt(stretch)[stretch.valid], duration_s)
            self._follow_power(rows, stretch.motion.torque_Nm[equation.usable])
            self._follow_lacking(rows, equation.torque[taken], equation.noise.inside)

    def _follow_power(self, columns: Array, torque: Array) -> None:
        point, stiffness = self._known.point, self.regressors.index(*STIFFNESS)
        if point is not None and stiffness is not None:
            columns = columns.copy()
            columns[:, stiffness] += point.zero_rad
        self._excitation.follow(columns, torque)

    def _follow_lacking(self, columns: Array, torque: Array, noise: ColumnNoise) -> None:
        filt, point = self.filter, self._known.point
        if filt is None or (point is None and self.regressors.index(*STIFFNESS) is not None):
            return
        zero_rad = point.zero_rad if point is not None else 0.0
        self._lacking.follow(columns, torque, zero_rad, self.learner.level.sd, noise, filt.value)

    def _linearise(self, duration_s: float) -> None:
        filt, point, structure = self.filter, self._known.point, self.learner.level.structure
        if isinstance(self._prediction, LawPrediction):
            self._rounds.adequate = machine_code.is_ready()
        elif self._prediction is not None and filt is not None and point is not None:
            self._rounds.adequate = structure < ADEQUATE and self._prediction.is_ready(filt.value, filt.sd, point)
            if self._rounds.gives_up(structure, duration_s, self.learner.refused):
                filt.forget(np.ones(len(filt.value)))
                self.learner.begin_level(self._bandwidth)
        if self._rounds.move(self._judge.excited_s) or self._is_loaded_anew():
            self.learner.begin_level(self._bandwidth)
            self._lacking.begin()
            self._consistency.begin()

    def _is_loaded_anew(self) -> bool:
        """Whether friction of the load is learned anew, with all else, since what passes the gear is told better."""
        filt, known = self.filter, self._load_sd < LOAD_KNOWN * math.sqrt(self._excitation.torque)
        load, so_far = self.regressors.gear_load, (self._judge.excited_s, self._warm_up_s)
        if filt is None or not known or not load.is_renewed(filt.value, *so_far):
            return False
        filt.forget(np.ones(len(filt.value)))
        return True

    @property
    def pattern_freedom(self) -> float:
        """Independent numbers in what the model lacks, however long the motion goes on: see `PATTERN_S`."""
        cutoff_hz = self._fir.rate_hz / 2 * (1.0 if self._rounds.predicts else self._fir.bandwidth)
        motion_hz = self._excitation.motion_hz(self._noise)
        return max(2 * PATTERN_S * (min(motion_hz, cutoff_hz) if motion_hz > 0 else cutoff_hz), 1.0)

    @property
    def twist_noise_rad2(self) -> float:
        """Variance that the sensors alone give a filtered sample of the twist."""
        return self._noise.twist_rad2

    @property
    def slow_noise(self) -> float:
        """See `SensorNoise.slow`."""
        return self._noise.slow(self.stiffness)

    def _refresh_sd(self) -> None:
        """The part of the error that is structure, not noise, does not average out."""
        if self.filter is None:
            return
        # a law of friction that is not quite right looks just like the other amplitudes
        self._known.freedom = 1.0 if self._rounds.predicts else self.pattern_freedom
        level = self.learner.level
        structure = level.structure
        if self.simulates and level.sd > 0:
            structure = max(structure, min(SIMULATION_ERROR**2 * self._excitation.torque / level.sd**2, 1.0))
        wider = widening(structure, self.filter.samples * self._bandwidth, self._known.freedom)
        wider *= WARY if self.learner.wary or self.learner.is_mending else 1.0
        others = np.hypot(self._lacking.doubt, self.filter.held_sd)
        wider = np.hypot(wider * self._consistency.wider, others / self.filter.sd)
        beyond = self._reach.wider(self.filter.value, wider * self.filter.sd)
        self._reached = np.isfinite(beyond)
        self._known.wider = wider * np.where(self._reached, beyond, 1.0)

    def _weigh(self) -> None:
        # what was learned anew since a rest is no longer of before it
        self._judge.rest(bool(self._unconfirmed) and not self.learner.is_mending)
        if self.filter is None or not self._excitation.torque > 0:
            return
        trusted = self.filter.trusted & self._told & self._is_referred & self._reached
        refused = 1.0 if self._unconfirmed and not self._judge.rests else self.learner.contradicted
        recent_sd = self.learner.recent.sd(self.filter.value, self._known.sd, self.filter.scale)
        self._judge.weigh(self._known.sd, recent_sd, trusted, refused, self._excitation)
        # what is learned anew is not of when it was last seen
        self._seen_s[self._judge.told if self.learner.is_mending else self._judge.seen] = self.moved_s
        known = (STIFFNESS, DAMPING)
        newest = {key: self.filter.value[i] for key in known if (i := self._well_known(key)) is not None}
        factors = self.regressors.tie(newest)
        if factors is not None:
            self.filter.rebase(np.diag(factors), np.zeros(len(factors)))

    @property
    def _is_referred(self) -> bool:
        """Whether a stiffness was found that the kinematic error could be referred to: before that, waves of the motor
        angle may stand in for spring and damper, and no amplitude means what its name says."""
        place = self.regressors.kinematic
        return self._known.point is not None or place.start == place.stop

    @property
    def _is_told(self) -> bool:
        """Whether the twist stands out of the encoders' noise."""
        i = self.regressors.index(*STIFFNESS)
        return i is None or (self.filter is not None and bool(self.filter.trusted[i]))

    def _lose_patience(self, duration_s: float) -> None:
        """Begin anew where all that was learned is nonsense."""
        if self._tells_stiffness or not self._judge.settled:
            self._patience.renew(self._tells_stiffness)
            return
        level = self.learner.level
        left, noise = (self._bandwidth * sd**2 for sd in (level.sd, level.floor))
        if self._patience.ends(duration_s, self._excitation.torque, left, noise):
            self._reset()

    @property
    def _tells_stiffness(self) -> bool:
        """Whether there is a number that stands for the stiffness, or none is asked for."""
        stiffness = self.amplitude(STIFFNESS)
        found = stiffness is None or stiffness[0] > stiffness[1]
        return found and self._is_referred and self._is_told

    def _well_known(self, key: AmplitudeKey) -> int | None:
        """The column of an amplitude that is known well enough."""
        i = self.regressors.index(*key)
        return i if i is not None and bool(self._judge.valid[i]) else None

    @property
    def filter(self) -> AmplitudeFilter | None:
        """Over the amplitudes; None before the first block with excitation."""
        return self._known.filter

    @property
    def errors(self) -> PredictionError:
        """Of the model of a moment ago, by operating condition."""
        return self.learner.errors

    @property
    def restarts(self) -> int:
        """How often the motion has contradicted what was learned, so that it is learned anew."""
        return self._restarts + self.learner.mends

    @property
    def refutations(self) -> int:
        """How often the motion has contradicted what was learned by more than another gear does."""
        return self._restarts + self.learner.resets

    def amplitude(self, key: AmplitudeKey) -> tuple[float, float] | None:
        """Value and sd of one amplitude, None when the model lacks it or nothing was learned yet."""
        return self._known.amplitude(key)

    @property
    def stiffness(self) -> float:
        """[N m/rad]; NaN unless it is known well enough."""
        i = self._well_known(STIFFNESS)
        return float(self.filter.value[i]) if i is not None and self.filter is not None else math.nan

    @property
    def error_rad(self) -> Array:
        """Sine and cosine [rad] of the kinematic error; zeros where there is none to know."""
        return self._known.error_rad

    def remembered(self, effect: str) -> tuple[float, float]:
        """What an effect with memory remembers now, and when that is [s]; NaN while it is not known."""
        if self._newest is None or self._newest.arguments is None:
            return math.nan, math.nan
        if self.simulates and isinstance(self._prediction, LawPrediction):
            return self._prediction.remembered(self._newest)
        state = self.regressors.state(effect)
        return (math.nan if state is None else float(state[1])), float(self._newest.arguments.motion.time_s[-1])

    def felt(self, stretch: Stretch) -> Array:
        """(n,) twist [rad] as the gear feels it: zero and kinematic error put right as far as they are known."""
        return self._known.felt(stretch)

    def felt_rate(self, stretch: Stretch) -> Array:
        """(n,) twist rate [rad/s] as the gear feels it."""
        return self._known.felt_rate(stretch)

    def spring(self, twist_rad: Array) -> tuple[Array, Array] | None:
        """(n,) torque [N m] of the gear's springs alone at (n,) twists [rad], and its sd; None before one is known."""
        return self._known.spring(twist_rad)

    def estimate(self, name: str, unit: str, key: AmplitudeKey) -> Estimate:
        """One amplitude as an estimate; NaN while nothing is known of it."""
        found = self.amplitude(key)
        i = self._well_known(key)
        status = self._status(i is not None and bool(self._judge.seen[i]), key)
        if found is None:
            return Estimate(name, math.nan, math.nan, unit, status, self.moved_s)
        if key == STIFFNESS and status is Status.VALID and found[0] <= 0:
            status = Status.INVALID
        # no number for anybody to act on: one that is not yet its own, a stiffness below one sd may as well be nothing
        nothing = not self._is_referred or (key == STIFFNESS and not (found[0] > found[1] and self._is_told))
        if status is not Status.VALID and nothing:
            found = (math.nan, found[1])
        return Estimate(name, *found, unit, status, self._seen_at([self.regressors.index(*key) or 0]))

    def _seen_at(self, places: list[int]) -> float:
        """When a motion last told these amplitudes [s]; none of those so far, when there last was any."""
        seen_s = self._seen_s[places]
        return float(seen_s.min()) if np.isfinite(seen_s).all() else self.moved_s

    def among(self, places: list[int]) -> tuple[Array, Array]:
        """(n,) amplitudes at these places and their (n, n) covariance, what the model lacks included; NaN before
        anything is known."""
        if self.filter is None or not self._is_referred:
            return np.full(len(places), math.nan), np.full((len(places), len(places)), math.nan)
        wider = self._known.wider[places]
        return self.filter.value[places], self.filter.covariance[np.ix_(places, places)] * np.outer(wider, wider)

    def kinematic_error(self) -> Estimate:
        """Peak to peak [rad] at the output."""
        place = self.regressors.kinematic
        told = self._judge.valid & self._judge.seen
        known = self._well_known(STIFFNESS) is not None and bool(told[place].all())
        course = (self._known.course() if self._is_referred else None) or (math.nan, math.nan)
        seen_s = self._seen_at([*range(place.start, place.stop)])
        return Estimate("kinematic_error", *course, "rad", self._status(known, STIFFNESS), seen_s)

    def _status(self, known: bool, key: AmplitudeKey) -> Status:
        if self.regressors.index(*key) is None:
            return Status.INVALID
        return self._judge.status(known, self.filter is not None)

    @property
    def error_status(self) -> Status:
        """What the model error is worth."""
        return self._judge.error_status(self.errors.nrmse)

    def dump(self) -> dict[str, Any]:
        """What was learned, as plain data; `load` takes it back."""
        point = self._known.point
        return {
            "filter": self.filter.dump() if self.filter is not None else None,
            "level": self.learner.level.dump(),
            "excitation": self._excitation.dump(),
            "noise": self._noise.dump(),
            "excited_s": self._judge.excited_s,
            "round": self._rounds.count,
            "load_rounds": self.regressors.gear_load.rounds,
            "point": point.dump() if point is not None else None,
            "shapes": self._held_shapes.tolist(),
            "torque_rms": self.learner.torque_rms,
            "lacking": self._lacking.dump(),
            "valid": self._judge.valid.tolist(),
            "time_s": self.time_s if math.isfinite(self.time_s) else None,
            "moved_s": self.moved_s if math.isfinite(self.moved_s) else None,
            "zero_rad": self._zero_rad if math.isfinite(self._zero_rad) else None,
        }

    @property
    def _held_shapes(self) -> Array:
        """(s,) shapes that those which are learned are counted from."""
        return np.array([self.regressors.shape(effect, row.name) for effect, row in self.regressors.free])

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave. Raises KeyError, TypeError or ValueError when it does not fit this model."""
        k = len(self.regressors.keys)
        filt = AmplitudeFilter.load(state["filter"]) if state["filter"] is not None else None
        valid = np.array(state["valid"], dtype=bool)
        if valid.shape != (k,) or (filt is not None and len(filt.value) != k):
            raise ValueError("another number of amplitudes")
        self._excitation.load(state["excitation"])
        self._noise.load(state["noise"])
        self.learner.level = NoiseLevel.load(state["level"], self.model.balance == "drive")
        self.learner.torque_rms = float(state["torque_rms"])
        self._lacking.load(state["lacking"])
        self._judge.excited_s = self._rounds.followed_s = float(state["excited_s"])
        self._judge.valid = valid
        self.time_s = math.nan if state["time_s"] is None else float(state["time_s"])
        self.moved_s = math.nan if state["moved_s"] is None else float(state["moved_s"])
        if math.isnan(self._came_s):  # after a restart; what is learned again of a moment ago came since
            self._came_s = self.time_s
        self._zero_rad = math.nan if state["zero_rad"] is None else float(state["zero_rad"])
        if filt is not None:
            offset = np.zeros(k)
            offset[self.regressors.shaping] = np.log(np.array(state["shapes"], dtype=float) / self._held_shapes)
            filt.rebase(np.eye(k), offset)
        self._known.filter = filt
        self._rounds.count = int(state["round"])
        if filt is not None:
            self.regressors.gear_load.take_up(int(state["load_rounds"]), filt.value)
        self._known.point = Linearisation.load(state["point"]) if state["point"] is not None else None
        self._reopen_constant()
