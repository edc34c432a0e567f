"""All estimates that the motion of one drive tells, from blocks as they come: the composition of this room.

Time is that of the data throughout; the same blocks give the same estimates, live or replayed.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any

import msgspec
import numpy as np

from edge_daemon.config.settings import ChannelSettings, Drive
from edge_daemon.effects.model import Model
from edge_daemon.encoders.contradiction import ReadingWatch
from edge_daemon.encoders.ratio import RatioEstimator, SkewWatch
from edge_daemon.encoders.zeros import ZeroWatch
from edge_daemon.motion.kinematics import filters
from edge_daemon.motion.load import LoadEstimator
from edge_daemon.motion.prediction_error import Regime, RegimeError
from edge_daemon.motion.regressors import DAMPING, STIFFNESS, AmplitudeKey, EncoderNoise, Regressors
from edge_daemon.motion.streaming import MotionFrame, MotionStream, Stretch
from edge_daemon.motion.work import WorkEstimator
from edge_daemon.records import Array, Block, Estimate, Status
from edge_daemon.track.baseline import Baseline
from edge_daemon.track.change import SHIFT
from edge_daemon.track.orders import OrderEstimate, orders_of
from edge_daemon.track.shape import ShapeWatch, shape_watch
from edge_daemon.track.tracking import BalanceTracker

STATE_VERSION = 8
"""Version of the checkpoint's layout and meaning; another one is not taken back."""
QUANTISATION = 1 / math.sqrt(12)
"""A rounding error has this sd, in steps."""
NOTICES = 20
"""So many notices are kept for whoever takes them; older ones go."""
LOOP_S = 2.0
"""So much motion is kept for the torque-twist loop."""
SHOCK_S = 3.0
"""Time from the first contradiction to agreement, up to which it was a shock or a slip (guess)."""
UNKNOWN_STEP_RAD = 0.0
"""An angle whose resolution nobody stated gets no noise compensated for."""

TURNED_SD_RAD = 0.01
"""A motor's zero that was found anew from a second of the kinematic error is off by no more (guess;
0.002 were measured)."""
REREFERENCED = "what the stiffness lost so far is kept until its reference is learned anew with this model"
"""What becomes of the stiffness's course where another model takes over."""
WARY_S = 10.0
"""For so long after wrong readings a gear that seems to be another one may be their doing (guess)."""
KEPT_EVERY_S = 2.0
"""Time between two learned states that are kept: the older of them is from before a fault that shows now."""
LEARNED = ("tracker", "ratio", "shape")
"""Parts that wrong readings must not teach anything."""
Part = BalanceTracker | RatioEstimator | ZeroWatch | LoadEstimator | Baseline | ShapeWatch
"""A checkpoint holds these."""


class DriveEstimator:
    """One drive's estimates. Raises `effects.model.ModelError` for a model that names an unknown effect."""

    def __init__(self, drive: Drive, model: Model) -> None:
        self.drive = drive
        self._sensors = sensors_of(drive)
        self._rest: tuple[Estimate, ...] = ()
        self._load = LoadEstimator()
        self._work = WorkEstimator()
        self._notices: deque[str] = deque(maxlen=NOTICES)
        self.baseline = Baseline(drive.estimation.baseline_after_s)
        """that the stiffness is held against"""
        self._take_model(model)
        self._readings = ReadingWatch(model.ratio)
        self._held, self._held_from_s, self._wary_until_s = False, math.nan, -math.inf
        self._sensor_failed = False
        """whether an encoder's own samples said so while this was held"""
        self._ratio = self._new_ratio(model)
        self.zeros = ZeroWatch(model.ratio)
        """of the encoders"""
        self._newest: deque[Stretch] = deque()

    def _take_model(self, model: Model) -> None:
        drive = self.drive
        names = tuple(row.channel for row in drive.channels)
        regressors = Regressors(model, names)
        fir = filters(drive.rate_hz, drive.estimation.cutoff_hz)
        drives = model.balance == "drive"
        measured = drives or "torque_out_Nm" in names
        frame = MotionFrame(
            model.ratio, model.output_inertia_kg_m2, drives, regressors.extra, regressors.wants_arguments
        )
        self.model = model
        self._skew = SkewWatch(model)
        self._changes_told = self._restarts_told = 0
        self._stream = MotionStream(frame, fir)
        self.tracker = BalanceTracker(regressors, fir, self._sensors, drive.estimation, measured)
        """of the model in force; another model has another one"""
        self._shape = shape_watch(self.tracker, measured)
        self._learned: deque[tuple[float, dict[str, Any]]] = deque(maxlen=2)

    def replace_model(self, model: Model) -> None:
        """Estimate another model's parameters from now on; ratio, load and what the stiffness lost so far go on, and so
        does what is known of the readings."""
        before, loads = self.model, self.tracker.regressors.loads
        self._take_model(model)
        if model.ratio != before.ratio:
            self.zeros, self._readings = ZeroWatch(model.ratio), ReadingWatch(model.ratio)
        if model.ratio != before.ratio or len(loads) != len(self.tracker.regressors.loads):
            self._ratio = self._new_ratio(model)
        self.baseline.rereference(fingerprint(before), fingerprint(model))

    def _new_ratio(self, model: Model) -> RatioEstimator:
        return RatioEstimator(model.ratio, self._stream.fir, len(self.tracker.regressors.loads))

    def update(self, block: Block, failed: bool = False) -> tuple[Estimate, ...]:
        """Every estimate after this block, in which one of the encoders may have `failed` by its own samples."""
        block, duration_s = self.zeros.carried(block), block.size / block.rate_hz
        stretch = self._stream.push(block)
        if stretch is not None and self._has_both_angles:
            stretch = self._examined(stretch, failed)
        if stretch is not None:
            self._newest.append(stretch)
            while len(self._newest) * duration_s > LOOP_S:
                self._newest.popleft()
        self._load.update(block, stretch)
        self._learn(block, stretch, duration_s)
        self._watch_stiffness()
        told = (*self._told_of_gear(duration_s), *self._model_error())
        if self._held:
            told = tuple(replace(row, status=Status.INVALID) for row in told)
        slips = (self.zeros.estimate(),) if self._has_both_angles else ()
        self._rest = (*told, *slips, *self._load.estimates())
        return self._rest

    def _told_of_gear(self, duration_s: float) -> Iterator[Estimate]:
        """What the balance and the two angles tell."""
        yield from self._stiffness(duration_s)
        if self._shape is not None:
            yield from self._shape.estimates(self.tracker)
        if self._has_both_angles:
            yield from self._ratio.estimates()
        yield from self._losses()
        yield from (row.estimate for row in self.orders())

    def orders(self) -> Iterator[OrderEstimate]:
        """The size of every wave of the model, as it is known now."""
        for row in orders_of(self.tracker):
            held = replace(row.estimate, status=Status.INVALID) if self._held else row.estimate
            yield row._replace(estimate=held)

    @property
    def contradiction(self) -> str:
        """Why the readings contradict the gear; empty while they agree, or while it is not known yet."""
        return self._readings.cause.text if self._readings.cause is not None else ""

    @property
    def changed(self) -> bool:
        """Whether gear, load or an encoder is another one than before, and it is not known yet which."""
        return self.tracker.learner.breaks and not self._held

    @property
    def ratio_shift(self) -> float:
        """By which share the encoders turn in another ratio than before, as no teeth do; 0 while they do not."""
        return self._ratio.shift

    def _examined(self, stretch: Stretch, failed: bool) -> Stretch:
        """The stretch, not to be learned from while its readings contradict the gear or a zero may have moved."""
        readings, track = self._readings, self.tracker
        if failed:
            readings.suspend(len(stretch.motion) / stretch.motion.rate_hz)
        else:
            readings.see(stretch, self._ratio.slope, track.error_rad, track.stiffness)
        track.learner.wary = self._held or float(stretch.motion.time_s[-1]) < self._wary_until_s
        lost = self._hold(failed or readings.lasting_s > 0.0, float(stretch.motion.time_s[-1]))
        self._sensor_failed = failed or (self._sensor_failed and self._held)
        if not failed and readings.cause is None and not lost:
            stretch = self.zeros.judge(stretch, self._ratio.slope)
            if self.zeros.moved:
                self.tracker.turned(TURNED_SD_RAD)
                self._stream.restart()
        return _withheld(stretch) if self._held or lost else stretch

    def _hold(self, contradicted: bool, time_s: float) -> bool:
        """Learn nothing from readings that contradict the gear; what was learned just before goes too. True where they
        agree again after a while of wrong readings: nobody knows then where the encoders count from, and this stretch
        is not counted as the next ones are. A shock or a slip is the zeros' affair."""
        if contradicted and not self._held:
            self._held, self._held_from_s = True, time_s
            for name, state in self._learned[0][1].items() if self._learned else ():
                self._parts()[name].load(state)
        elif self._held and not contradicted:
            self._held, self._wary_until_s = False, time_s + WARY_S
            self.tracker.doubt()
            if self._sensor_failed or time_s - self._held_from_s > SHOCK_S:
                self.zeros.lose(self._readings.turned_rad)
                if self._readings.turned_rad:
                    self.tracker.turned(TURNED_SD_RAD)
                self._stream.restart()
                return True
        return False

    def _learn(self, block: Block, stretch: Stretch | None, duration_s: float) -> None:
        track, before = self.tracker, self.tracker.refutations
        track.update(stretch, duration_s)
        if track.refutations > before:
            self._ratio.start_over()
        if self._shape is not None:
            self._shape.update(stretch, duration_s, track)
        self._work.update(block, stretch, track.felt_rate, self._ratio.skew[1])
        if self._held:
            return  # ratio and timing are those of the readings
        self._ratio.update(block, track.balanced, track.stiffness, track.error_rad, track.others_Nm, track.loads)
        self._ratio.know_noise(track.twist_noise_rad2, track.slow_noise, track.pattern_freedom)
        self._watch_timing(stretch)
        known = track.stiffness > 0 or STIFFNESS not in track.regressors.keys
        if stretch is not None and known and not (self._learned and track.time_s - self._learned[-1][0] < KEPT_EVERY_S):
            parts = self._parts()
            self._learned.append((track.time_s, {name: parts[name].dump() for name in LEARNED if name in parts}))

    def heard_motor(self, sd_rad: float) -> None:
        """White noise of the motor angle [rad], where it comes from sound (`sound_angle`); NaN while it does not."""
        self.tracker.heard_motor(sd_rad)

    @cached_property
    def _has_both_angles(self) -> bool:
        return {"theta_in_rad", "theta_out_rad"} <= {row.channel for row in self.drive.channels}

    def _stiffness(self, duration_s: float) -> tuple[Estimate, ...]:
        track, keys = self.tracker, self.tracker.regressors.keys
        rows: list[Estimate] = []
        if STIFFNESS in keys:
            stiffness = track.estimate("stiffness", "N m/rad", STIFFNESS)
            rows.append(replace(stiffness, status=Status.INVALID) if self._skew.hides_spring else stiffness)
        damping: AmplitudeKey = ("viscous_friction", "coefficient") if self.model.balance == "drive" else DAMPING
        if damping in keys:
            rows.append(self._timed(track.estimate("damping", "N m s/rad", damping)))
        coulomb = next((key for key in keys if key[0] == "coulomb_friction"), None)
        if coulomb is not None:
            rows.append(self._timed(track.estimate("coulomb_friction", "N m", coulomb)))
        if STIFFNESS in keys:
            rows.append(track.kinematic_error())
            rows.append(self.baseline.follow(rows[0], duration_s))
        return tuple(rows)

    def _losses(self) -> tuple[Estimate, ...]:
        """Where both angles tell the twist: what stays in the gear of the work that passes it."""
        if not self._has_both_angles or self.model.balance == "drive":
            return ()
        stiffness = self.tracker.estimate("stiffness", "N m/rad", STIFFNESS)
        area, *others = self._work.estimates(stiffness.status)
        return (self._timed(area), *others)

    def _timed(self, estimate: Estimate) -> Estimate:
        """Marked invalid where the timing of the encoders cannot carry it."""
        return estimate if self._skew.carries else replace(estimate, status=Status.INVALID)

    def _model_error(self) -> tuple[Estimate, ...]:
        errors, time_s = self.tracker.errors, self.tracker.time_s
        status = self.tracker.error_status
        share = errors.relative_sd
        return (
            Estimate("model_nrmse", errors.nrmse, errors.nrmse * share, "1", status, time_s),
            Estimate("model_noise_floor", errors.noise_floor, errors.noise_floor * share, "1", status, time_s),
            Estimate("model_rmse", errors.rmse, errors.rmse * share, "N m", status, time_s),
        )

    @property
    def torque_Nm(self) -> Array | None:
        """(n,) output torque of the newest block [N m], NaN where unusable; None if nobody knows it."""
        if not self._newest or self.model.balance == "drive":
            return None
        newest = self._newest[-1]
        return np.where(newest.valid, newest.motion.torque_Nm, np.nan)

    def loop(self) -> tuple[Array, Array]:
        """(n,) twist [rad] as the gear feels it and (n,) torque [N m] of the last two seconds; NaN where unusable."""
        newest = list(self._newest)
        if not newest:
            return np.empty(0), np.empty(0)
        twist = np.concatenate([np.where(row.valid, self.tracker.felt(row), np.nan) for row in newest])
        return twist, np.concatenate([row.motion.torque_Nm for row in newest])

    def spring(self, twist_rad: Array) -> tuple[Array, Array] | None:
        """(n,) torque [N m] over (n,) twists [rad] as the stiffness known now makes it, and its sd; None if unknown."""
        return self.tracker.spring(twist_rad)

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """All that is known now."""
        return self._rest

    @property
    def stiffness_changes(self) -> tuple[int, int]:
        """Sudden changes of stiffness noticed since the start of this model, and which way the last went (-1, 1)."""
        return self.tracker.learner.changes, self.tracker.learner.last_change

    def take_notices(self) -> tuple[str, ...]:
        """What a person may want to know of, since the last call."""
        notices = tuple(self._notices)
        self._notices.clear()
        return notices

    def _watch_timing(self, stretch: Stretch | None) -> None:
        before = self._skew.carries
        self._skew.update(stretch, self._ratio.skew, self._ratio.slope.stiffness)
        if self._skew.carries is not before:
            skew_us = 1e6 * self._ratio.skew[0]
            told = "are told from it again" if self._skew.carries else "cannot be told from it and are not reported"
            self._notices.append(
                f"encoder skew (or output-side friction) of {skew_us:.3g} us makes {self._skew.share:.0%} of the "
                f"twist: damping and friction {told}"
            )

    def _watch_stiffness(self) -> None:
        count, which = self.stiffness_changes
        if count > self._changes_told:
            lost = "lower" if which < 0 else "higher"
            self._notices.append(f"stiffness is suddenly {lost}, by about {SHIFT:.0%} or more: it is learned anew")
        self._changes_told = count
        if abs(self.baseline.apart) > SHIFT:
            self._notices.append(
                f"the stiffness is {self.baseline.apart:+.1%} beside what was last seen before the model was "
                "exchanged: the models differ, or the gear has changed meanwhile"
            )
            self.baseline.apart = 0.0
        if self.tracker.restarts > self._restarts_told:
            self._notices.append("the motion contradicts what was learned of the gear: it is learned anew")
        self._restarts_told = self.tracker.restarts
        self._notices.extend(self.zeros.take_notices())

    def model_error_by_regime(self) -> dict[Regime, RegimeError]:
        """Where the model fails: its error per speed, direction, torque and temperature."""
        return self.tracker.errors.by_regime()

    def state(self) -> bytes:
        """A checkpoint for `restore`."""
        return msgspec.json.encode(
            {
                "key": self._key(),
                "tracker": self.tracker.dump(),
                "ratio": self._ratio.dump(),
                "zeros": self.zeros.dump(),
                "load": self._load.dump(),
                "baseline": self.baseline.dump(),
                "readings": self._readings.dump(),
                **({"shape": self._shape.dump()} if self._shape is not None else {}),
            }
        )

    def restore(self, blob: bytes) -> bool:
        """Take a checkpoint back; False when it is of another drive, model or version.

        Of another model or version what the stiffness lost so far is taken over all the same."""
        try:
            state: dict[str, Any] = msgspec.json.decode(blob, type=dict[str, Any])
            if state.get("key") != self._key():
                self._take_baseline(state)
                return False
            before = {name: part.dump() for name, part in self._parts().items()}
            try:
                for name, part in self._parts().items():
                    part.load(state[name])
                self._readings.load(state.get("readings", {}))
            except (KeyError, TypeError, ValueError, AttributeError):
                for name, part in self._parts().items():
                    part.load(before[name])
                self._take_baseline(state)
                return False
        except msgspec.DecodeError:
            return False
        return True

    def _take_baseline(self, state: dict[str, Any]) -> None:
        """Of another model or version of this drive what the stiffness lost so far is taken over, and nothing else."""
        name, model, _ = self._key()
        key = state.get("key")
        if isinstance(key, list) and len(key) == 3 and key[0] == name:
            with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):
                self.baseline.load(state["baseline"])
                if key[1] != model:
                    self.baseline.rereference(key[1], model)

    def _parts(self) -> dict[str, Part]:
        parts: dict[str, Part] = {
            "tracker": self.tracker,
            "ratio": self._ratio,
            "zeros": self.zeros,
            "load": self._load,
            "baseline": self.baseline,
        }
        if self._shape is not None:
            parts["shape"] = self._shape
        return parts

    def _key(self) -> list[str]:
        return [self.drive.name, fingerprint(self.model), str(STATE_VERSION)]


def _withheld(stretch: Stretch) -> Stretch:
    """Without anything to learn from, the noise of its angles included."""
    return replace(stretch, valid=np.zeros(len(stretch.valid), dtype=bool), jitter_rad2=(math.nan, math.nan))


def fingerprint(model: Model) -> str:
    """Tells models apart by what they are made of; their fitted amplitudes may change."""
    rows = [[row.name, row.expression, *row.waves] for row in model.effects]
    parts = [model.balance, repr(model.ratio), repr(model.output_inertia_kg_m2), rows]
    return hashlib.sha256(msgspec.json.encode(parts)).hexdigest()


def sensors_of(drive: Drive) -> EncoderNoise:
    """Noise of both encoders: their quantisation and what the configuration adds."""
    rows = {row.channel: row for row in drive.channels}
    settings = drive.estimation
    return EncoderNoise(
        theta_in_rad=math.hypot(_rounding_rad(rows.get("theta_in_rad")), settings.encoder_noise_in_rad),
        theta_out_rad=math.hypot(_rounding_rad(rows.get("theta_out_rad")), settings.encoder_noise_out_rad),
    )


def _rounding_rad(row: ChannelSettings | None) -> float:
    if row is None or row.counts_per_turn is None:
        return UNKNOWN_STEP_RAD
    return 2 * math.pi / row.counts_per_turn * QUANTISATION
