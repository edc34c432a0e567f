"""The vocabulary that every stage shares: what travels from sensor to reader.

`acquire` yields `Readings`, `Burst` and `Bands`; `condition` yields `Block`; `estimate` and `prognose` yield
`Estimate`; a drive's newest state is a `Snapshot`. All are frozen: a stage returns a new record, it never edits
one. Times are seconds since the Unix epoch on the gateway's clock (see `clock`), which never runs backward.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum, IntFlag
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Flags = NDArray[np.uint8]


class Recorded(Protocol):
    """A recording: what `recordings.recording.Recording` is, and any stand-in."""

    @property
    def time_s(self) -> Array: ...

    @property
    def columns(self) -> Mapping[str, Array]: ...


class Flaw(IntFlag):
    """Why a sample must not be used; 0 means valid. One byte per sample in `Block.flaws`."""

    MISSING = 1
    """no reading arrived for this instant"""
    RANGE = 2
    """outside the configured range"""
    RATE = 4
    """changed faster than the configured rate"""
    FROZEN = 8
    """has not changed for longer than the configured time although the drive moves"""
    STALE = 16
    """the source has been silent for longer than the configured time"""
    RESET = 32
    """the counter jumped: reset, lost reference, or a slip of the coupling"""
    DEVICE = 64
    """the device itself reports an error (status bit, CRC, bus error)"""


class Status(Enum):
    """What an estimate is worth."""

    WARMING_UP = "warming_up"
    VALID = "valid"
    NOT_EXCITED = "not_excited"
    INVALID = "invalid"


class NE107(IntEnum):
    """Device status after NAMUR NE 107 (2017); the number is what a PLC reads, worst highest."""

    OK = 0
    MAINTENANCE_REQUIRED = 1
    OUT_OF_SPECIFICATION = 2
    FUNCTION_CHECK = 3
    FAILURE = 4


@dataclass(frozen=True, slots=True)
class Readings:
    """A batch of samples of one signal of one source, as the device gave them (counts or its own unit)."""

    source: str
    signal: str
    time_s: Array
    """(n,) when each sample was taken, as well as the source knows"""
    value: Array
    """(n,) raw value; NaN where the device answered with an error"""


@dataclass(frozen=True, slots=True)
class Burst:
    """A stretch of waveform, sampled evenly by the sensor itself."""

    source: str
    signal: str
    time_s: float
    """of the first sample"""
    rate_hz: float
    value: Array
    """(n,) raw value"""


@dataclass(frozen=True, slots=True)
class Bands:
    """A power spectral density that the sensor computed itself."""

    source: str
    signal: str
    time_s: float
    frequency_hz: Array
    """(n,) band centres"""
    psd: Array
    """(n,) power per hertz"""
    averages: float
    """independent averages behind each value"""


GAP_SAMPLES = 0.5
"""A block that starts this far from where the last one ended leaves a gap."""


@dataclass(frozen=True, slots=True)
class Block:
    """Arrays on one uniform time base, SI units; a flaw byte per sample and channel."""

    drive: str
    sequence: int
    start_s: float
    rate_hz: float
    values: Mapping[str, Array]
    """channel name -> (n,); NaN where MISSING"""
    flaws: Mapping[str, Flags]
    """channel name -> (n,) of `Flaw` bits, 0 = valid"""

    @property
    def size(self) -> int:
        """Samples per channel; 0 for a block without channels."""
        return len(next(iter(self.values.values()), ()))

    @property
    def end_s(self) -> float:
        """The instant after the last sample: the next block's start if nothing is missing."""
        return self.start_s + self.size / self.rate_hz

    @property
    def time_s(self) -> Array:
        """(n,) instant of each sample."""
        return self.start_s + np.arange(self.size) / self.rate_hz

    def starts_at(self, instant_s: float) -> bool:
        """Whether nothing is missing since this instant, the end of the block before; not if it is NaN."""
        return abs(self.start_s - instant_s) * self.rate_hz <= GAP_SAMPLES

    def continues(self, before: Block) -> bool:
        """Whether it goes on where the one before ended, at its rate and with its channels."""
        alike = self.values.keys() == before.values.keys() and self.flaws.keys() == before.flaws.keys()
        return alike and self.rate_hz == before.rate_hz and self.starts_at(before.end_s)

    def valid(self, *channels: str) -> NDArray[np.bool_]:
        """(n,) True where all the named channels are present and free of flaws."""
        flawed = np.zeros(self.size, dtype=bool)
        for channel in channels:
            flawed |= self.flaws[channel] != 0 if channel in self.flaws else True
        return ~flawed


@dataclass(frozen=True, slots=True)
class Motion:
    """What the effects see: (n,) arrays on one uniform time base, SI, frames and signs of docs/outputs.md.

    The twist is `theta_in / ratio - theta_out` [rad]. Rates are derived by the same linear-phase filter as the
    side of the balance they stand on. A channel that was not measured is an array of NaN.
    """

    rate_hz: float
    ratio: float
    time_s: Array
    theta_in_rad: Array
    theta_out_rad: Array
    twist_rad: Array
    twist_rate_rad_s: Array
    velocity_out_rad_s: Array
    acceleration_out_rad_s2: Array
    torque_Nm: Array
    """the measured or configured-inertia side of the balance; current [A] in a drive balance without a constant"""
    temperature_degC: Array
    extra: Mapping[str, Array] = field(default_factory=dict)
    """further channels by name, for a user's own effects"""
    transmitted_Nm: Array | None = None
    """what passes the gear to the load as a model tells it, unit of the balance; None where no model did"""
    motor_Nm: Array | None = None
    """the motor's torque as it tells it, all friction within, but for what is `of_motor` itself"""
    external_Nm: Array | None = None
    """what stands against the gear outside beside the inertia; None where it is that alone"""
    drag_Nm: Array | None = None
    """what the torque rises by per relative rise of the speed, as a model tells it; None where no effect asks for it"""
    bending: Mapping[str, Array] = field(default_factory=dict)
    """by effect, (n, k) what it rises by per twist, of springs that bend where an error of the angles moves that"""
    bend_Nm_per_rad: Array | None = None
    """(n,) what all of them rise by, as a model tells it"""
    built_up: Array | None = None
    """how far dry friction has built up after a reversal, -1 to 1, as presliding of a model tells it; None without"""
    rubs_beside: Array | None = None
    """level of what rubs beside bristles, over theirs, as a model tells it; None without"""
    lead: Array | None = None
    """by how much an error of the angle, as a model tells it, raises the speed of what it moves, over that"""
    driven_rad_s: Array | None = None
    driven_rad_s2: Array | None = None
    """speed and acceleration of the motor, seen from the output; None where only those of the output are told apart"""
    inertia_kg_m2: float = 0.0
    """that makes the torque out of the output's acceleration as it was measured; 0 where that is not said"""

    def __len__(self) -> int:
        return len(self.time_s)

    def between(self, a: int, b: int) -> Motion:
        """Samples a to b of it."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        arrays: dict[str, Any] = {name: v[a:b] for name, v in values.items() if isinstance(v, np.ndarray)}
        return replace(self, extra={name: column[a:b] for name, column in self.extra.items()}, **arrays)


@dataclass(frozen=True, slots=True)
class Estimate:
    """One number, how far to trust it, and when it was true."""

    name: str
    value: float
    sd: float
    unit: str
    status: Status
    time_s: float

    @property
    def usable(self) -> bool:
        """A finite value with a finite standard deviation, neither warming up nor invalid."""
        return (
            self.status in (Status.VALID, Status.NOT_EXCITED) and math.isfinite(self.value) and math.isfinite(self.sd)
        )


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened and that a person may want to know about."""

    drive: str
    """empty for the gateway itself"""
    time_s: float
    severity: NE107
    source: str
    """which part of the daemon or which sensor"""
    message: str


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The newest state of one drive: what every reader (PLC, fleet, page, store) gets."""

    drive: str
    sequence: int
    time_s: float
    """end of the newest block; NaN before the first"""
    state: NE107
    reasons: tuple[str, ...]
    """why the state is not OK, most important first; empty when OK"""
    estimates: Mapping[str, Estimate]
    """by the names of `quantities.QUANTITIES`; a missing name is unknown"""
    details: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """topic -> what it says beyond its estimates, ready for JSON"""


@dataclass(frozen=True, slots=True)
class SourceHealth:
    """How one source of readings is doing."""

    source: str
    state: str
    """`starting`, `ok`, `degraded` (some devices or frames fail) or `down`"""
    reason: str
    """empty when ok"""
    last_s: float
    """when the newest reading arrived; NaN before the first"""
    counters: Mapping[str, int]
    """readings, errors, drops, ...; they only grow"""


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """How one way out (fleet, PLCs, page, store) is doing."""

    link: str
    state: str
    """`off`, `starting`, `ok`, `degraded` (works, but something is lost) or `down`"""
    reason: str
    """empty when ok"""
    figures: Mapping[str, float]
    """counters and levels by name: published, dropped, queued, bytes, ..."""


@dataclass(frozen=True, slots=True)
class TaskHealth:
    """How one supervised task is doing."""

    name: str
    state: str
    """`running`, `waiting` (for its next try), `finished`"""
    restarts: int
    reason: str
    """of the last failure; empty if none"""


@dataclass(frozen=True, slots=True)
class GatewayState:
    """The whole gateway at one instant: what the page and the metrics show."""

    site: str
    gateway: str
    version: str
    started_s: float
    now_s: float
    snapshots: Mapping[str, Snapshot]
    """newest by drive, in the order of the configuration"""
    sources: tuple[SourceHealth, ...]
    tasks: tuple[TaskHealth, ...]
    events: tuple[Event, ...]
    """the latest, oldest first"""
    links: tuple[LinkHealth, ...]
