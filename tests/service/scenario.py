"""The chain of one drive on a simulated gear in which something goes wrong, in simulated time and in one thread.

What the daemon says is held against what the simulated drive knows to be true, step by step.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from edge_daemon.config.reading import load
from edge_daemon.config.settings import Drive
from edge_daemon.records import NE107, Array, Burst, Estimate, Event, Readings, Status
from edge_daemon.rig.faults import PlannedFault, follow
from edge_daemon.rig.live import LiveDrive, Samples, live_drive
from edge_daemon.rig.motion import MotorCourse, MotorMotion
from edge_daemon.rig.plant import Plant
from edge_daemon.rig.sensors import AMBIENT_DEGC
from edge_daemon.service.history import History
from edge_daemon.service.pipeline import Pipeline, open_pipeline

CONFIG = Path(__file__).parents[2] / "config"
START_S = 1_700_000_000.0
"""Unix time at the drive's time zero"""
STEP_S = 0.1
"""of simulated time between two looks at the state, as the daemon's work loop does"""
DRIVE_EVERY = 10
"""samples between two frames of the servo drive"""
SOUND_HZ, SOUND_SAMPLES = 25_600.0, 8192
WRONG_SD = 5.0
"""beyond which a number that is called usable is wrong"""
SEED = 3
COMPLETE = ("linear_stiffness", "viscous_damping", "kinematic_error", "coulomb_friction")
"""a model that has all that the demonstration's gear has"""

MODEL = """[joint]
balance = "torsion"
ratio = 100.0
output_inertia_kg_m2 = 0.05
"""


def model_text(effects: Iterable[str]) -> str:
    """A model file of these effects, nothing fitted."""
    return MODEL + "".join(f'\n[[effect]]\nname = "{name}"\n' for name in effects)


def drive_settings(baseline_after_s: float = 30.0) -> Drive:
    """Those of the demonstration, commissioned sooner."""
    row = load(CONFIG / "demo.toml").drive[0]
    return msgspec.structs.replace(
        row, estimation=msgspec.structs.replace(row.estimation, baseline_after_s=baseline_after_s)
    )


@dataclass(frozen=True, slots=True)
class Look:
    """What the daemon said at one instant, beside the truth."""

    time_s: float
    """of the drive"""
    state: NE107
    said: tuple[str, ...]
    """reasons of the state, and the events of this step that ask for attention"""
    estimates: Mapping[str, Estimate]
    truth: Mapping[str, float]
    """of the instants that the estimates are of"""

    def usable(self, name: str) -> bool:
        """Whether there is a number of this name that one may use."""
        return name in self.estimates and self.estimates[name].usable

    def off_sd(self, name: str, standing: float = 0.0) -> float:
        """How far it is from the truth, in its own standard deviations, beyond what is `standing` already."""
        estimate = self.estimates[name]
        off = max(0.0, abs(estimate.value - self.truth[name]) - standing)
        return off / max(estimate.sd, 1e-300) if off else 0.0

    def wrong(self, standing: Mapping[str, float]) -> tuple[str, ...]:
        """Names of the numbers that are called usable and are not true."""
        return tuple(
            name
            for name in self.truth
            if self.usable(name) and not self.off_sd(name, standing.get(name, 0.0)) <= WRONG_SD
        )

    def standing(self) -> dict[str, float]:
        """By how much each number that is wrong already is."""
        return {name: abs(self.estimates[name].value - self.truth[name]) for name in self.wrong({})}

    def valid(self) -> tuple[str, ...]:
        """The numbers of the gear that are valid."""
        return tuple(n for n in OF_THE_GEAR if n in self.estimates and self.estimates[n].status is Status.VALID)

    def right(self, standing: Mapping[str, float], needed: Iterable[str]) -> bool:
        """Whether all that one needs is valid, and nothing wrong."""
        return set(needed) <= set(self.valid()) and not self.wrong(standing)


PAST_STEPS = 2000
"""So many steps back the truth is remembered: a number is held against what was true when it says that it was."""
OF_THE_GEAR = ("stiffness", "damping", "coulomb_friction", "kinematic_error", "ratio")


class Tape:
    """How the gear moved: what goes wrong with its sensors leaves that as it is, and one course serves them all."""

    def __init__(self) -> None:
        self.steps: dict[tuple[float, ...], tuple[Array, Array, tuple[float, float, float]]] = {}

    def __deepcopy__(self, memo: object) -> Tape:
        return self


@dataclass(slots=True)
class TapedPlant(Plant):
    """A plant without memory beside its state, which is integrated once for all scenes that fork from one."""

    tape: Tape = field(default_factory=Tape)
    sound: int = 0
    """influences of the gear as it was made"""

    def run(
        self, time_s: Array, motor: MotorCourse, temperature_degC: Array, *, compiled: bool = False
    ) -> tuple[Array, Array]:
        if len(self.influences) != self.sound or not len(time_s):
            return Plant.run(self, time_s, motor, temperature_degC, compiled=True)
        key = (float(time_s[0]), float(len(time_s)), self.phi_rad, self.dphi_rad_s, self.stiffness_scale)
        if key not in self.tape.steps:
            twist, rate = Plant.run(self, time_s, motor, temperature_degC, compiled=True)
            self.tape.steps[key] = twist, rate, (self.phi_rad, self.dphi_rad_s, self._change)
        twist, rate, (self.phi_rad, self.dphi_rad_s, self._change) = self.tape.steps[key]
        return twist, rate


@dataclass
class Scene:
    """One drive, its chain, and what is going to happen to it."""

    folder: Path
    drive: LiveDrive
    pipeline: Pipeline
    plan: list[PlannedFault] = field(default_factory=list)
    models: list[tuple[float, Sequence[str]]] = field(default_factory=list)
    """(time [s], effects): when the model's file is written anew"""
    commissioned_Nm_per_rad: float = math.nan
    history: History | None = None
    """where blocks are stored, and another model's reference is learned from"""
    told: list[str] = field(default_factory=list)
    """all events so far"""
    past: deque[tuple[float, dict[str, float]]] = field(default_factory=lambda: deque(maxlen=PAST_STEPS))
    """end of each of the newest steps and what was true in it"""

    def fork(self) -> Scene:
        """A scene that goes on from here by itself."""
        return copy.deepcopy(self)

    def restart(self) -> None:
        """The daemon ends and begins again, with what it keeps."""
        kept = self.pipeline.state()
        self.pipeline = open_pipeline(self.pipeline.drive, self.folder)
        assert self.pipeline.restore(kept) == ()

    def run(self, until_s: float) -> Iterator[Look]:
        """What is said, step by step, up to this time of the drive."""
        while self.drive.time_s < until_s - 1e-9:
            yield self._step(self.drive.time_s + STEP_S)

    def _step(self, until_s: float) -> Look:
        events = [*self._change_model(self.drive.time_s)]
        follow(self.plan, self.drive)
        first = round(self.drive.time_s * 1000)
        for record in self.records(self.drive.advance(until_s), first):
            self.pipeline.push(record)
        step = self.pipeline.step(START_S + until_s, ())
        if self.history is not None:
            for block in step.blocks:
                self.history.add_block(block)
            events += self.pipeline.recommission(self.history.file, START_S + until_s)
        self.told += [event.message for event in (*events, *step.events)]
        said = [event.message for event in (*events, *step.events) if event.severity is not NE107.OK]
        now = step.snapshot
        self.past.append((until_s, self._truth(now.estimates)))
        return Look(until_s, now.state, (*now.reasons, *said), now.estimates, self._true_then(now.estimates))

    def _true_then(self, estimates: Mapping[str, Estimate]) -> dict[str, float]:
        """What was true at the instant of each estimate; of those that are not known, what is true now."""
        found = dict(self.past[-1][1])
        for name in found.keys() & estimates.keys():
            at_s = estimates[name].time_s - START_S
            found[name] = next((true[name] for end_s, true in self.past if end_s > at_s - 1e-6), found[name])
        return found

    def _change_model(self, now_s: float) -> Iterator[Event]:
        while self.models and self.models[0][0] <= now_s:
            _, effects = self.models.pop(0)
            self.pipeline.model_file.write_text(model_text(effects))
            yield from self.pipeline.follow_model(START_S + now_s)

    def records(self, samples: Samples, first: int) -> Iterator[Readings | Burst]:
        time_s = START_S + samples.time_s
        yield from _kept("EncoderIn1.Position", time_s, samples.counts_in, samples.kept_in)
        yield from _kept("EncoderOut1.Position", time_s, samples.counts_out, samples.kept_out)
        told = samples.kept_drive & ((first + np.arange(len(samples))) % DRIVE_EVERY == 0)
        yield from _kept("Drive1.Torque", time_s, np.round(samples.motor_torque_Nm, 3), told)
        yield from _kept("Drive1.Current", time_s, np.round(samples.motor_current_A, 2), told)
        if round(self.drive.time_s / STEP_S) % round(1.0 / STEP_S) == 0:
            yield from self._slow(START_S + self.drive.time_s)

    def _slow(self, now_s: float) -> Iterator[Readings | Burst]:
        at = np.array([now_s])
        temperature, pressure = self.drive.housing.measured()
        yield Readings("housing1", "gear.temperature", at, np.array([temperature]))
        yield Readings("housing1", "gear.pressure", at, np.array([pressure]))
        yield Readings("air1", "temperature", at, np.array([AMBIENT_DEGC]))
        sound = self.drive.sound(SOUND_SAMPLES, SOUND_HZ)
        yield Burst("housing1", "acoustic.sound", now_s - SOUND_SAMPLES / SOUND_HZ, SOUND_HZ, sound)

    def _truth(self, estimates: Mapping[str, Estimate]) -> dict[str, float]:
        drive, effects = self.drive, self.drive.truth["parameters"]
        assert isinstance(effects, dict)
        grown = next((row.size for row in self.plan if row.fault.name == "friction" and "friction" in drive.added), 0.0)
        stiffness = drive.plant.joint.stiffness_Nm_per_rad * drive.plant.stiffness_scale
        change = estimates.get("stiffness_change")
        if change is not None and change.usable and math.isnan(self.commissioned_Nm_per_rad):
            self.commissioned_Nm_per_rad = stiffness
        return {
            "stiffness": stiffness,
            "damping": drive.plant.joint.damping_Nms_per_rad,
            "coulomb_friction": effects["coulomb_friction.level_Nm"] + grown,
            "kinematic_error": 2 * effects["kinematic_error.order2_rad"],
            "ratio": drive.plant.joint.ratio,
            "stiffness_change": stiffness / self.commissioned_Nm_per_rad - 1.0,
            "temperature": drive.housing.temperature_degC,
        }


def _kept(signal: str, time_s: Array, value: Array, kept: Array) -> Iterator[Readings]:
    if kept.any():
        yield Readings("can0", signal, time_s[kept], np.asarray(value[kept], dtype=np.float64))


def scene(folder: Path, effects: Iterable[str] = COMPLETE, seed: int = SEED, baseline_after_s: float = 30.0) -> Scene:
    """The demonstration's drive with a model of these effects, files in `folder`."""
    (folder / "axis.model.toml").write_text(model_text(effects))
    drive = live_drive(seed)
    drive.plant = TapedPlant(
        drive.plant.joint,
        drive.plant.influences,
        step_s=drive.plant.step_s,
        sound=len(drive.plant.influences),
    )
    return Scene(folder, drive, open_pipeline(drive_settings(baseline_after_s), folder))


def resting(motion: MotorMotion, begin_s: float, end_s: float, speed_rad_s: float = 0.0) -> MotorMotion:
    """The same motion with a rest between two instants [s], or with one speed of the motor meanwhile: time slows down
    to nothing within half a second."""

    def course(time_s: Array) -> MotorCourse:
        off, on = _step(time_s - begin_s), _step(time_s - end_s)
        found = motion.course(time_s - off[0] + on[0])
        pace, bend = 1.0 - off[1] + on[1], on[2] - off[2]
        return MotorCourse(
            found.angle + speed_rad_s * (off[0] - on[0]),
            found.speed * pace + speed_rad_s * (off[1] - on[1]),
            found.acceleration * pace**2 + found.speed * bend + speed_rad_s * (off[2] - on[2]),
        )

    return MotorMotion("resting", (course,))


def _step(since_s: Array) -> tuple[Array, Array, Array]:
    """Integral [s], value and rate [1/s] of a step that takes half a second."""
    x = np.clip(2.0 * since_s, 0.0, 1.0)
    whole = 0.5 * (x**4 * (2.5 - 3.0 * x + x**2)) + np.maximum(since_s - 0.5, 0.0)
    return whole, x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 60.0 * x**2 * (1.0 - x) ** 2


def shaken(it: Scene, signals: Sequence[str], size_s: float, span_s: tuple[float, float]) -> Scene:
    """The scene with one in five packets of these signals stamped by so much too early or too late."""
    records, rng = it.records, np.random.default_rng(9)

    def stamped(samples: Samples, first: int) -> Iterator[Readings | Burst]:
        off_s = size_s * rng.choice([-1.0, 1.0]) * (rng.random() < 0.2)
        for record in records(samples, first):
            if isinstance(record, Readings) and record.signal in signals and within(record.time_s[0], span_s):
                record = Readings(record.source, record.signal, record.time_s + off_s, record.value)
            yield record

    it.records = stamped  # type: ignore[method-assign]
    return it


def within(time_s: float, span_s: tuple[float, float]) -> bool:
    return span_s[0] <= time_s - START_S < span_s[1]
