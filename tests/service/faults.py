"""Faults of sensors and of the gear, put into the readings of the demonstration's drive, and what its pipeline says.

Nothing waits: the drive is simulated at once, its readings are spoiled from an instant on, and the pipeline is fed as
fast as it goes. `FAULTS` names them; each row says which channels a person should be led to.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
from scipy.interpolate import CubicSpline

from edge_daemon.config.reading import load
from edge_daemon.effects.model_file import read_model
from edge_daemon.records import NE107, Estimate, Event, Readings, Status
from edge_daemon.rig.live import DEMO_JOINT, SCALE_S, STIFFNESS_LOSS, LiveDrive, live_drive
from edge_daemon.rig.plant import Influence
from edge_daemon.rig.simulated import WARM_UP_K
from edge_daemon.rig.truths import TRUTHS, Scale, scale_of
from edge_daemon.service.pipeline import Pipeline

CONFIG = Path(__file__).parents[2] / "config"
MODEL = "axis.model.toml"
START_S = 1_000_000.0
BLOCK_S = 0.1
RATE_HZ = 1000.0
MOTOR, OUT = "theta_in_rad", "theta_out_rad"
SIGNALS = {MOTOR: "EncoderIn1.Position", OUT: "EncoderOut1.Position"}
STEPS = {MOTOR: 2.0**17, OUT: 2.0**24}
"""counts per turn of the demonstration's encoders"""


@dataclass(frozen=True)
class Played:
    """Readings of both encoders: (n,) instants and counts, and which of them arrive."""

    time_s: np.ndarray
    counts: dict[str, np.ndarray]
    kept: dict[str, np.ndarray]

    def spoiled(self, channel: str, counts: np.ndarray | None = None, kept: np.ndarray | None = None) -> Played:
        """With other counts or losses of one channel."""
        return replace(
            self,
            counts=self.counts if counts is None else {**self.counts, channel: counts},
            kept=self.kept if kept is None else {**self.kept, channel: kept},
        )


Span = np.ndarray
"""(n,) where the fault is present"""
Spoil = Callable[[Played, Span, float], Played]


def _frozen(channel: str) -> Spoil:
    def spoil(played: Played, span: Span, _size: float) -> Played:
        counts = played.counts[channel]
        return played.spoiled(channel, np.where(span, counts[np.argmax(span)], counts))

    return spoil


def _stuck_bit(channel: str) -> Spoil:
    def spoil(played: Played, span: Span, bit: float) -> Played:
        counts = played.counts[channel].astype(np.int64)
        return played.spoiled(channel, np.where(span, counts & ~(1 << int(bit)), counts).astype(float))

    return spoil


def _coarse(channel: str) -> Spoil:
    def spoil(played: Played, span: Span, bits: float) -> Played:
        counts, step = played.counts[channel], 2.0**bits
        return played.spoiled(channel, np.where(span, np.floor(counts / step) * step, counts))

    return spoil


def _scaled(channel: str) -> Spoil:
    """The counter counts on, faster by `share` than it did."""

    def spoil(played: Played, span: Span, share: float) -> Played:
        counts = played.counts[channel]
        steps = np.diff(counts, prepend=counts[0]) * np.where(span, 1.0 + share, 1.0)
        return played.spoiled(channel, np.rint(counts[0] + np.cumsum(steps)))

    return spoil


def _flipped(channel: str) -> Spoil:
    return lambda played, span, _size: _scaled(channel)(played, span, -2.0)


def _skewed(channel: str) -> Spoil:
    """Sampled later by `shift_s` than the stamp says."""

    def spoil(played: Played, span: Span, shift_s: float) -> Played:
        counts = played.counts[channel]
        shifted = np.rint(CubicSpline(played.time_s, counts)(played.time_s + shift_s))
        return played.spoiled(channel, np.where(span, shifted, counts))

    return spoil


def _dropped(channel: str) -> Spoil:
    def spoil(played: Played, span: Span, share: float) -> Played:
        lost = np.random.default_rng(1).random(len(span)) < share
        return played.spoiled(channel, kept=played.kept[channel] & ~(span & lost))

    return spoil


def _offset(channel: str) -> Spoil:
    def spoil(played: Played, span: Span, turns: float) -> Played:
        return played.spoiled(channel, played.counts[channel] + np.where(span, np.rint(turns * STEPS[channel]), 0.0))

    return spoil


def _reset(channel: str) -> Spoil:
    def spoil(played: Played, span: Span, _size: float) -> Played:
        counts = played.counts[channel]
        return played.spoiled(channel, np.where(span, counts - counts[np.argmax(span)], counts))

    return spoil


def _exchanged(played: Played, span: Span, _size: float) -> Played:
    one, other = played.counts[MOTOR], played.counts[OUT]
    swapped = {MOTOR: np.where(span, other, one), OUT: np.where(span, one, other)}
    return replace(played, counts=swapped)


def _gap(played: Played, span: Span, _size: float) -> Played:
    return replace(played, kept={name: kept & ~span for name, kept in played.kept.items()})


@dataclass(frozen=True)
class Fault:
    """A row of `FAULTS`."""

    spoil: Spoil
    sizes: tuple[float, ...]
    channels: tuple[str, ...]
    """those that a person must be led to; empty where nothing is to be told within seconds"""


def _of_each(name: str, make: Callable[[str], Spoil], sizes: tuple[float, ...] = (0.0,), both: bool = False):
    """A row for each encoder; with `both`, either may be at fault as far as anybody can know."""
    for word, channel in (("in", MOTOR), ("out", OUT)):
        yield f"{name}_{word}", Fault(make(channel), sizes, (MOTOR, OUT) if both else (channel,))


FAULTS: dict[str, Fault] = dict(
    (
        *_of_each("frozen", _frozen),
        *_of_each("stuck_bit", _stuck_bit, (3.0, 10.0, 14.0)),
        *_of_each("resolution_lost", _coarse, (4.0, 8.0)),
        *_of_each("scaled", _scaled, (1e-4, 0.01, 0.5), both=True),
        *_of_each("flipped", _flipped, both=True),
        *_of_each("skewed", _skewed, (5e-5, 3e-4, 1e-3, 3e-3), both=True),
        *_of_each("dropped", _dropped, (0.01, 0.1, 0.5)),
        *_of_each("offset", _offset, (1e-4, 0.01, 0.3)),
        *_of_each("reset", _reset),
        ("exchanged", Fault(_exchanged, (0.0,), (MOTOR, OUT))),
        ("gap", Fault(_gap, (0.0,), ())),
    )
)


@lru_cache(maxsize=4)
def healthy(seconds: float, seed: int = 3) -> Played:
    """The demonstration's drive as it is."""
    return played_of(live_drive(seed), seconds)


def worn(seconds: float, at_s: float, loss: float, seed: int = 3) -> Played:
    """The same drive, whose stiffness drops at once by this share."""

    def wear(drive: LiveDrive) -> None:
        drive.wear = loss / STIFFNESS_LOSS

    return _changing(live_drive(seed), seconds, at_s, wear)


def loose(seconds: float, at_s: float, half_gap_rad: float, seed: int = 3) -> Played:
    """The same drive, in which a backlash opens at once."""

    def open_gap(drive: LiveDrive) -> None:
        row = TRUTHS["backlash"]
        names = list(row.draw(np.random.default_rng(0), _scale(drive), DEMO_JOINT))
        made: Influence = row.build({names[0]: half_gap_rad, **dict.fromkeys(names[1:], 1.0)}, DEMO_JOINT)
        drive.plant.influences = [*drive.plant.influences, made]

    return _changing(live_drive(seed), seconds, at_s, open_gap)


def _scale(drive: LiveDrive) -> Scale:
    return scale_of(drive.plant.joint, drive.motion, SCALE_S, WARM_UP_K)


def _changing(drive: LiveDrive, seconds: float, at_s: float, change: Callable[[LiveDrive], None]) -> Played:
    before = played_of(drive, at_s)
    change(drive)
    after = played_of(drive, seconds)
    return Played(
        np.concatenate((before.time_s, after.time_s)),
        {name: np.concatenate((before.counts[name], after.counts[name])) for name in SIGNALS},
        {name: np.concatenate((before.kept[name], after.kept[name])) for name in SIGNALS},
    )


def played_of(drive: LiveDrive, until_s: float) -> Played:
    """What its encoders latch from now until `until_s`."""
    samples = drive.advance(until_s)
    return Played(
        samples.time_s,
        {MOTOR: samples.counts_in.astype(float), OUT: samples.counts_out.astype(float)},
        {MOTOR: samples.kept_in, OUT: samples.kept_out},
    )


def spoiled(played: Played, name: str, size: float, from_s: float, until_s: float = math.inf) -> Played:
    """With the fault `name` of this size in a span of time."""
    span = (played.time_s >= from_s) & (played.time_s < until_s)
    return FAULTS[name].spoil(played, span, size)


@dataclass(frozen=True)
class Told:
    """What the drive says at one instant of its own time."""

    time_s: float
    state: NE107
    reasons: tuple[str, ...]
    estimates: dict[str, Estimate]
    events: tuple[Event, ...]

    def valid(self, name: str) -> bool:
        """Whether this estimate is called valid."""
        return name in self.estimates and self.estimates[name].status is Status.VALID


def pipeline_in(folder: Path, model: str | None = None) -> Pipeline:
    """The demonstration's drive, its model file in `folder`."""
    drive = load(CONFIG / "demo.toml").drive[0]
    encoders = tuple(row for row in drive.channels if row.channel in SIGNALS)
    drive = msgspec.structs.replace(drive, channels=encoders, sound=None)
    file = folder / MODEL
    if model is None:
        shutil.copy(CONFIG / MODEL, file)
    else:
        file.write_text(model, encoding="utf-8")
    return Pipeline(drive, file, read_model(file), None)


def told(pipeline: Pipeline, played: Played, from_s: float = 0.0, until_s: float = math.inf) -> Iterator[Told]:
    """Feeds a pipeline and yields what it says after each block."""
    first, last = np.searchsorted(played.time_s, (from_s, until_s))
    step = round(BLOCK_S * RATE_HZ)
    for begin in range(int(first), int(last), step):
        here = slice(begin, min(begin + step, int(last)))
        for channel, signal in SIGNALS.items():
            kept = played.kept[channel][here]
            times = START_S + played.time_s[here][kept]
            pipeline.push(Readings("can0", signal, times, played.counts[channel][here][kept]))
        now_s = float(played.time_s[here][-1])
        found = pipeline.step(START_S + now_s, ())
        yield Told(now_s, found.snapshot.state, found.snapshot.reasons, dict(found.snapshot.estimates), found.events)
