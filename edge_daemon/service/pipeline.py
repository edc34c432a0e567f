"""One drive from readings to its newest state: condition, estimate, prognose, in that order.

Synchronous and free of buses; the daemon calls it from its work loop, a test or a replay from a plain loop.
"""

from __future__ import annotations

import logging
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from edge_daemon import __version__
from edge_daemon.channels import CHANNELS
from edge_daemon.condition.conditioner import Conditioner
from edge_daemon.condition.gathering import Gathering
from edge_daemon.condition.scatter import ScatterWatch
from edge_daemon.config.settings import Drive
from edge_daemon.effects.model import Model
from edge_daemon.effects.model_file import read_model
from edge_daemon.errors import BadInput
from edge_daemon.health.alarms import Alarm, Finding
from edge_daemon.health.judge import HealthJudge
from edge_daemon.health.load_change import LoadChange
from edge_daemon.health.order_trends import OrderWatch
from edge_daemon.health.safe_limits import SafeLimits, SafeRange
from edge_daemon.health.trends import ConditionWatch
from edge_daemon.health.wiring import disputed, doubts, shifted
from edge_daemon.prognose.forecast import Forecast
from edge_daemon.prognose.life import LifeFollower
from edge_daemon.publish.messages import birth
from edge_daemon.quantities import QUANTITIES, of_topic
from edge_daemon.records import (
    NE107,
    Array,
    Bands,
    Block,
    Burst,
    Estimate,
    Event,
    Readings,
    Snapshot,
    SourceHealth,
    Status,
)
from edge_daemon.service.configuration import model_and_gear
from edge_daemon.service.priors import DrivePrior, PriorInbox, prior_of
from edge_daemon.service.recommission import Recommissioning
from edge_daemon.sound.kept_sound import CURRENT, KeptSound
from edge_daemon.sound.noise_estimator import NoiseEstimator
from edge_daemon.sound.sound_angle import MotorFromSound
from edge_daemon.text import fields_of
from edge_daemon.track.live import REREFERENCED, DriveEstimator, sensors_of
from edge_daemon.usage.gears import Gear

log = logging.getLogger(__name__)

FLAW_MEMORY_S = 0.3
"""The share of flawed samples per channel is averaged over this: random losses keep it, a hiccup is soon forgotten
(guess)."""
SILENT_AFTER_S = 2.0
"""No block for this long counts as all samples flawed, so that the state says so (guess)."""
OF_MOTION = frozenset(row.name for topic in ("stiffness", "model_error") for row in of_topic(topic))
"""Nothing but the motion of the drive tells these estimates."""


@dataclass(frozen=True, slots=True)
class PipelineStep:
    """What one turn of the work loop gave for one drive."""

    blocks: tuple[Block, ...]
    events: tuple[Event, ...]
    snapshot: Snapshot


class Pipeline:
    """The chain of one drive and the state it keeps between blocks."""

    def __init__(
        self,
        drive: Drive,
        model_file: Path,
        model: Model,
        gear: Gear | None,
        prior: DrivePrior | None = None,
        sound_bytes: float = math.inf,
    ) -> None:
        self.drive = drive
        self._model_file = model_file
        self._model = model
        self._model_stamp = _stamp(model_file)
        self._conditioner = Conditioner(drive)
        self._measured = {row.channel for row in drive.channels}
        self._gathering = Gathering()
        self._estimator = DriveEstimator(drive, model)
        self._scatter, self._failure = _scatter_watch(drive, model), ""
        self._noise = NoiseEstimator(drive.sound, drive.estimation.baseline_after_s) if drive.sound else None
        self._kept = KeptSound(drive.sound, sound_bytes) if drive.sound else None
        self._motor = self._motor_from_sound()
        self._prior = prior or DrivePrior(gear)
        self._life = LifeFollower(gear, drive.name, self._prior.at)
        self._watch = ConditionWatch(drive.name, gear)
        self._order_watch = OrderWatch(drive.name, gear)
        self._order_meanings: dict[str, str] = {}
        self._load = LoadChange()
        self._safe = SafeLimits(safe_limits_of(drive))
        self._judge = HealthJudge(drive.name, gear, {row.channel: row.source for row in drive.channels})
        self._estimates: dict[str, Estimate] = {}
        self._sounds: list[Burst | Bands] = []
        self._flawed: dict[str, float] = {}
        self._before: dict[str, Any] | None = None
        self._model_is_new = False
        self._recommissioning = Recommissioning(drive)
        self._restarted = False
        """with another model than before, which is still to be told"""
        self._time_s = math.nan
        self._sequence = 0

    def push(self, record: Readings | Burst | Bands) -> None:
        """Take what a source delivered; records of other drives are ignored."""
        if isinstance(record, Readings):
            self._conditioner.push(record)
            return
        sound = self.drive.sound
        if sound and (record.source, record.signal) == (sound.source, sound.signal):
            self._sounds.append(record)
            if self._motor is not None and isinstance(record, Burst):
                self._motor.hear(record)

    def _motor_from_sound(self) -> MotorFromSound | None:
        """What supplies the motor angle where a drive has no encoder for it."""
        wanted, noise = self.drive.sound_angle, self._noise
        if wanted is None or noise is None:
            return None

        def floor() -> Callable[[Array], Array] | None:
            return noise.fit.psd if noise.fit is not None and noise.warm else None

        return MotorFromSound(wanted, self._model.ratio, self.drive.estimation.cutoff_hz, floor)

    def step(self, now_s: float, sources: Sequence[SourceHealth]) -> PipelineStep:
        """Process everything that has arrived."""
        blocks = tuple(self._conditioner.blocks(now_s))
        self._hear()
        if self._motor is not None:
            blocks = self._motor.blocks(blocks)
            self._take(self._motor.estimates())
            self._estimator.heard_motor(self._motor.sd_rad)
        for block in blocks:
            for gathered in self._gathering.push(block):
                self._failure = self._conditioner.stamp_failure or self._scatter.see(gathered)
                self._take_motion(self._estimator.update(gathered, bool(self._failure)))
                self._take(self._load.judge(self._estimates))
                torque_Nm = self._estimator.torque_Nm
                self._take(self._life.update(gathered, self._over_years(), torque_Nm, background=True))
            hours = block.size / block.rate_hz / 3600.0
            self._watch.update(hours, self._over_years())
            self._order_watch.update(hours, self._estimates, self._order_meanings)
            self._safe.follow(block)
            self._count_flaws(block)
            self._time_s = block.end_s
        self._take(_outlived(self._estimates, self._time_s))
        self._notice_silence(now_s)
        events = (*self._conditioner.take_events(), *self._noticed())
        mine = {row.source for row in self.drive.channels}
        mine_now = [source for source in sources if source.source in mine]
        disputes = (
            *doubts(self._estimates, self._model.ratio),
            shifted(self._estimator.ratio_shift),
            disputed(self._failure or self._estimator.contradiction),
            _changed(self._estimator.changed and not self._failure),
        )
        others = (*disputes, self._load.finding(), *self._watch.findings(), *self._order_watch.findings())
        health = self._judge.judge(now_s, self._estimates, mine_now, self._flawed, (*others, *self._safe.findings()))
        self._take((health.index,))
        for event in health.events:
            if self._kept is not None and event.severity is not NE107.OK:
                self._kept.alarm(event.message)
        self._sequence += len(blocks)
        snapshot = Snapshot(
            self.drive.name,
            self._sequence,
            self._time_s,
            health.state,
            health.reasons,
            dict(self._estimates),
            {"model_error": self._model_error(), "stiffness": {"orders": [*self._orders()]}},
        )
        return PipelineStep(blocks, (*events, *health.events), snapshot)

    def _over_years(self) -> Mapping[str, Estimate]:
        """The estimates as trends and life want them: a stiffness that another model sees is no loss of it."""
        stiffness = self._estimates.get("stiffness")
        if stiffness is None:
            return self._estimates
        return {**self._estimates, "stiffness": self._estimator.baseline.referred(stiffness)}

    def _noticed(self) -> Iterable[Event]:
        """What the estimates noticed by themselves, as events."""
        if self._restarted:
            self._restarted = False
            text = f"another model than before the restart; {REREFERENCED}"
            yield Event(self.drive.name, self._time_s, NE107.OK, "model", text)
        for text in self._estimator.take_notices():
            yield Event(self.drive.name, self._time_s, NE107.MAINTENANCE_REQUIRED, "estimate", text)

    def _orders(self) -> Iterator[dict[str, Any]]:
        """The waves of the model, each with its newest size."""
        for row in self._estimator.orders():
            self._order_meanings[row.estimate.name] = row.meaning
            found = self._estimates.get(row.estimate.name, row.estimate)
            value, sd = (found.value, found.sd) if found.usable else (None, None)
            yield {
                "name": found.name,
                "meaning": row.meaning,
                "effect": row.effect,
                **row.wave._asdict(),
                "value": value,
                "sd": sd,
                "unit": found.unit,
                "status": found.status.value,
                "time_s": found.time_s,
            }

    def _model_error(self) -> dict[str, Any]:
        """Which model the error is of, by operating regime, and what the model before it came to."""
        regimes = self._estimator.model_error_by_regime().items()
        return {
            "effects": [effect.name for effect in self._model.effects],
            "before": self._before,
            "regimes": [{**fields_of(regime), **fields_of(error)} for regime, error in regimes],
        }

    def due_forecast(self) -> Callable[[], Forecast] | None:
        """The forecast of remaining life, if one is due: it takes a while, so run it in any thread."""
        return self._life.forecast_task()

    def accept(self, forecast: Forecast) -> None:
        """Take over what a forecast returned."""
        self._life.accept(forecast)

    def take_prior(self, now_s: float, inbox: PriorInbox) -> tuple[Event, ...]:
        """Forecast with what the fleet has signed for this gear, if that is new."""
        found = inbox.newest(self._life.gear.name) if self._life.gear else None
        change = self._prior.offer(*found) if found else ""
        if not change:
            return ()
        self._life.renew()
        return (Event(self.drive.name, now_s, NE107.OK, "life", change),)

    def _take(self, estimates: Iterable[Estimate]) -> None:
        self._estimates.update((estimate.name, estimate) for estimate in estimates)

    def _take_motion(self, estimates: Sequence[Estimate]) -> None:
        """What the motion tells; numbers that only the model before had go."""
        if self._model_is_new:
            told, self._model_is_new = {row.name for row in estimates}, False
            self._estimates = {n: row for n, row in self._estimates.items() if n in told or not _of_motion(n)}
        self._take(estimates)

    def _hear(self) -> None:
        speed = self._estimates.get("speed_in")
        speed_rad_s = speed.value if speed and speed.usable else math.nan
        sounds, self._sounds = self._sounds, []
        for sound in sounds:
            if self._noise is not None:
                self._take(self._noise.update(sound, speed_rad_s))
            if self._kept is not None:
                self._kept.hear(sound, speed_rad_s)

    def _count_flaws(self, block: Block) -> None:
        for channel, flaws in block.flaws.items():
            if channel not in self._measured:  # a motor angle heard in the sound comes and goes with the speed
                continue
            share = float(np.count_nonzero(flaws)) / max(len(flaws), 1)
            keep = math.exp(-block.size / block.rate_hz / FLAW_MEMORY_S)
            self._flawed[channel] = keep * self._flawed.get(channel, share) + (1 - keep) * share

    def _notice_silence(self, now_s: float) -> None:
        if now_s - self._time_s > SILENT_AFTER_S:
            self._flawed = dict.fromkeys(self._flawed, 1.0)

    # the model

    def follow_model(self, now_s: float) -> tuple[Event, ...]:
        """Take the model file over if it has changed on disk; a broken one is reported and the old model stays."""
        stamp = _stamp(self._model_file)
        if stamp == self._model_stamp:
            return ()
        self._model_stamp = stamp
        try:
            model = read_model(self._model_file)
        except BadInput as error:
            return (Event(self.drive.name, now_s, NE107.MAINTENANCE_REQUIRED, "model", f"not taken over: {error}"),)
        if _structure(model) == _structure(self._model):
            self._model = model
            return ()
        before = self._estimates.get("model_nrmse")
        nrmse = before.value if before is not None and before.usable else None
        self._before = {"effects": [effect.name for effect in self._model.effects], "nrmse": nrmse}
        change = f"now of {', '.join(effect.name for effect in model.effects)}"
        change += f"; error so far {nrmse:.1%}" if nrmse is not None else ""
        again = model.ratio != self._model.ratio
        self._model = model
        self._estimator.replace_model(model)
        self._watch.model_changed()
        self._order_watch.model_changed()
        self._model_is_new = True
        self._load = LoadChange()
        change += f"; {REREFERENCED}"
        self._motor = self._motor_from_sound() if again else self._motor
        return (Event(self.drive.name, now_s, NE107.OK, "model", change),)

    def recommission(self, store: Path, now_s: float) -> tuple[Event, ...]:
        """A piece of learning another model's reference from what is stored; the event that it ends with."""
        told = self._recommissioning.step(self._estimator.model, self._estimator.baseline, store)
        return (Event(self.drive.name, now_s, NE107.OK, "estimate", told),) if told else ()

    def meta(self) -> dict[str, Any]:
        """The birth document of this drive."""
        gear = self._life.gear
        model = {
            "balance": self._model.balance,
            "ratio": self._model.ratio,
            "output_inertia_kg_m2": self._model.output_inertia_kg_m2,
            "effects": [effect.name for effect in self._model.effects],
        }
        return birth(gear=gear.name if gear else None, model=model, versions={"edge_daemon": __version__})

    # for a person

    @property
    def estimator(self) -> DriveEstimator:
        """What is estimated, for a closer look; read only."""
        return self._estimator

    @property
    def noise(self) -> NoiseEstimator | None:
        """The sound's spectrum and its fit, for a closer look; None when no sound is configured."""
        return self._noise

    @property
    def life(self) -> LifeFollower:
        """Loads and life so far, for a closer look; read only."""
        return self._life

    @property
    def model_file(self) -> Path:
        """Where the model is; a change of it is taken over."""
        return self._model_file

    @property
    def alarms(self) -> Sequence[Alarm]:
        """What is raised, worst first; read only."""
        return self._judge.alarms.raised

    def acknowledge(self, now_s: float, key: str | None = None, who: str = "") -> tuple[Event, ...]:
        """A person has seen one alarm of this drive, or all; the events that this makes."""
        return self._judge.acknowledge(now_s, key, who)

    # what survives a restart

    def state(self) -> dict[str, bytes]:
        """Checkpoints by part."""
        return {
            "estimates": self._estimator.state(),
            "life": self._life.state(),
            **({"prior": self._prior.state()} if self._prior.fleet else {}),
            "trends": self._watch.state(),
            "orders": self._order_watch.state(),
            "alarms": self._judge.state(),
            **({"sound": self._noise.state()} if self._noise else {}),
            **(self._kept.state() if self._kept else {}),
        }

    def restore(self, parts: Mapping[str, bytes]) -> tuple[str, ...]:
        """Take checkpoints over; the names of the parts that did not fit this drive, model or version."""
        restores = {
            "estimates": self._estimator.restore,
            "life": self._life.restore,
            "prior": self._prior.restore,
            "trends": self._watch.restore,
            "orders": self._order_watch.restore,
            "alarms": self._judge.restore,
        }
        if self._noise:
            restores["sound"] = self._noise.restore
        if self._kept:
            restores[CURRENT] = self._kept.restore
        unfit = tuple(name for name, blob in parts.items() if name in restores and not _taken(restores[name], blob))
        if "estimates" in unfit and self._estimator.baseline.is_rereferenced:
            self._watch.model_changed()
            self._order_watch.model_changed()
            self._restarted = True
        return unfit

    LEARNED = ("estimates", "sound")
    """of these, what a drive that fails at once starts without"""
    PARTS = ("estimates", "life", "prior", "trends", "orders", "alarms", "sound", CURRENT)


def _taken(restore: Callable[[bytes], bool], blob: bytes) -> bool:
    """Whether a part took its checkpoint back; bytes that its codec chokes on are no reason to stop a drive."""
    try:
        return restore(blob)
    except (ValueError, TypeError, LookupError, ArithmeticError, zlib.error) as error:
        log.warning("a checkpoint cannot be read: %s", error)
        return False


def _outlived(estimates: Mapping[str, Estimate], now_s: float) -> tuple[Estimate, ...]:
    """What a motion told that was last seen long ago, as invalid.

    The estimators count the time of blocks, and where only slow sensors go on, blocks are few and gathered late.
    """
    seen = estimates.get("model_nrmse")
    if seen is None or not now_s - seen.time_s > SILENT_AFTER_S:
        return ()
    return tuple(replace(row, status=Status.INVALID) for name, row in estimates.items() if _of_motion(name))


def _of_motion(name: str) -> bool:
    return name in OF_MOTION or name not in QUANTITIES


def _changed(now: bool) -> Finding:
    """What is said before it is known whether the gear or its load has changed, or an encoder errs."""
    text = (
        "theta_in_rad and theta_out_rad tell of another gear or load than before: it is not known yet which changed, "
        "or whether an encoder errs; nothing is learned meanwhile"
    )
    return Finding("change", NE107.FUNCTION_CHECK, now, now, text)


def safe_limits_of(drive: Drive) -> dict[str, SafeRange]:
    """The safe limits that the configuration states, by channel."""
    limits = {}
    for row in drive.channels:
        low = -math.inf if row.safe_minimum is None else row.safe_minimum
        high = math.inf if row.safe_maximum is None else row.safe_maximum
        if math.isfinite(low) or math.isfinite(high):
            unit = CHANNELS[row.channel].unit if row.channel in CHANNELS else row.unit
            limits[row.channel] = SafeRange(unit, low, high)
    return limits


def open_pipeline(drive: Drive, base: Path, prior_key: bytes | None = None, sound_bytes: float = math.inf) -> Pipeline:
    """The chain of one drive from its settings; files are relative to `base`. Raises `BadInput`."""
    model, gear = model_and_gear(drive, base)
    prior = DrivePrior(gear, prior_of(drive, gear, base), prior_key)
    return Pipeline(drive, base / drive.model, model, gear, prior, sound_bytes)


def _scatter_watch(drive: Drive, model: Model) -> ScatterWatch:
    """Of the encoders' own samples."""
    sensors = sensors_of(drive)
    turns = {"theta_in_rad": model.ratio, "theta_out_rad": 1.0}
    return ScatterWatch(turns, {name: getattr(sensors, name) for name in turns})


def _stamp(file: Path) -> tuple[int, int]:
    """Changes whenever the file does; zeros while it is away."""
    try:
        found = file.stat()
    except OSError:
        return (0, 0)
    return (found.st_mtime_ns, found.st_size)


def _structure(model: Model) -> tuple[Any, ...]:
    """What makes a model another one for the live estimator: fitted values do not."""
    rows = [(row.name, row.expression, row.waves) for row in model.effects]
    return (model.balance, model.ratio, model.output_inertia_kg_m2, rows)
