"""What can go wrong with a simulated drive while it runs: one row per fault, from the physics of sensors and gears.

A fault of a sensor leaves the gear as it is; a fault of the gear leaves the sensors truthful. `planned` reads the
text that a person types, `follow` lets each fault begin and end when its time has come.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from edge_daemon.errors import BadInput
from edge_daemon.gear import steps
from edge_daemon.gear.torques import law
from edge_daemon.rig.live import STIFFNESS_LOSS, LiveDrive
from edge_daemon.rig.plant import Influence
from edge_daemon.rig.sensors import ENCODER_NOISE_STEPS, EncoderFace

FAULT_AFTER_S = 60.0
"""When a fault begins that was given no time [s]: the demonstration's drive is commissioned by then."""
UNITS: Mapping[str, Mapping[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "rad": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180, "arcmin": math.pi / 10_800},
    "1": {"": 1.0, "%": 0.01, "ppm": 1e-6},
    "bit": {"bit": 1.0, "bits": 1.0},
    "step": {"steps": 1.0, "step": 1.0},
    "K": {"K": 1.0},
    "N m": {"Nm": 1.0, "N m": 1.0, "mNm": 1e-3},
}
"""What a size may be followed by, for each unit of the table, and what that is in the unit."""

Act = Callable[[LiveDrive, float], None]
"""(drive, size): what happens to it."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that can go wrong; `end` undoes it, and is None where nothing but repair would."""

    name: str
    meaning: str
    begin: Act
    end: Callable[[LiveDrive], None] | None = None
    unit: str = ""
    """of its size; empty where there is no more or less of it"""
    usual: float = math.nan
    least: float = 0.0
    most: float = math.inf
    """the sizes that make sense"""

    def checked(self, size: float) -> float:
        """The size. Raises `BadInput` where it is none for this fault."""
        if not self.unit and math.isnan(size):
            return size
        if not self.unit:
            raise BadInput(f"fault {self.name}: it has no size")
        whole = "a whole number, " if self.unit == "bit" else ""
        if not self.least <= size <= self.most or (whole and size % 1):
            raise BadInput(f"fault {self.name}: {size:g} {self.unit}: expected {whole}{self.least:g} to {self.most:g}")
        return size

    def repair(self, drive: LiveDrive) -> None:
        """Undoes it. Raises `BadInput` where that cannot be."""
        if self.end is None:
            raise BadInput(f"fault {self.name}: it does not end")
        self.end(drive)


@dataclass(slots=True)
class PlannedFault:
    """A fault with its size and its time on the rig's clock."""

    fault: Fault
    begin_s: float
    end_s: float
    size: float
    _begun: bool = False
    _ended: bool = False

    def follow(self, drive: LiveDrive) -> None:
        """Begins or ends it if the drive's time has come to that."""
        if not self._begun and drive.time_s >= self.begin_s:
            self._begun = True
            self.fault.begin(drive, self.size)
        if self._begun and not self._ended and drive.time_s >= self.end_s:
            self._ended = True
            if self.fault.end:
                self.fault.end(drive)


def follow(plan: Iterable[PlannedFault], drive: LiveDrive) -> None:
    """Lets every fault of the plan begin or end whose time has come."""
    for fault in plan:
        fault.follow(drive)


# the sensors

Encoder = Callable[[LiveDrive], EncoderFace]


def _set(name: str, value: object) -> Callable[[EncoderFace], None]:
    return lambda encoder: setattr(encoder, name, value)


def _freeze(encoder: EncoderFace, size: float) -> None:
    encoder.frozen = True


def _stick(encoder: EncoderFace, size: float) -> None:
    encoder.stuck_bit = round(size)


def _scratch(encoder: EncoderFace, size: float) -> None:
    encoder.sticking_bit = round(size)


def _coarsen(encoder: EncoderFace, size: float) -> None:
    encoder.lost_bits = round(size)


def _delay(encoder: EncoderFace, size: float) -> None:
    encoder.delay_s = size


def _drop(encoder: EncoderFace, size: float) -> None:
    encoder.loss = size


def _shake(encoder: EncoderFace, size: float) -> None:
    encoder.noise_steps = size


def _start_drift(encoder: EncoderFace, size: float) -> None:
    encoder.drift = size


def _end_drift(encoder: EncoderFace) -> None:
    encoder.drift = encoder.delay_s = 0.0


def _repeat(encoder: EncoderFace, size: float) -> None:
    encoder.repeated = size


def _garble(encoder: EncoderFace, size: float) -> None:
    encoder.bit_errors = size


def _burst(encoder: EncoderFace, size: float) -> None:
    encoder.burst_steps = size


def _off_centre(encoder: EncoderFace, size: float) -> None:
    encoder.turn_with(1.0)
    encoder.eccentric_rad = size


def _count_right(encoder: EncoderFace) -> None:
    encoder.turn_with(1.0)


@dataclass(frozen=True, slots=True)
class _EncoderFault:
    """A fault that either encoder can have; `usual_in`: of the motor's, where the two differ."""

    name: str
    meaning: str
    begin: Callable[[EncoderFace, float], None]
    end: Callable[[EncoderFace], None] | None
    unit: str = ""
    usual: float = math.nan
    most: float = math.inf
    usual_in: float | None = None
    least: float = 0.0

    def rows(self) -> tuple[Fault, Fault]:
        """For the output's encoder under its own name, for the motor's with `_in` after it."""
        usual_in = self.usual if self.usual_in is None else self.usual_in
        return (
            self._row("", "output encoder", lambda drive: drive.encoder_out, self.usual),
            self._row("_in", "motor encoder", lambda drive: drive.encoder_in, usual_in),
        )

    def _row(self, suffix: str, whose: str, encoder: Encoder, usual: float) -> Fault:
        begin, end = self.begin, self.end
        return Fault(
            self.name + suffix,
            f"{whose}: {self.meaning}",
            lambda drive, size: begin(encoder(drive), size),
            None if end is None else lambda drive: end(encoder(drive)),
            self.unit,
            usual,
            self.least,
            self.most,
        )


# fmt: off
_ENCODER_FAULTS = (
    _EncoderFault("frozen", "the position stands still while stamps go on", _freeze, _set("frozen", False)),
    _EncoderFault("stuck_bit", "the bit of this number, 0 the finest, always reads 1",
                  _stick, _set("stuck_bit", None), "bit", 8, 30),
    _EncoderFault("sticking_bit", "the bit of this number reads 1 in two fifths of the turn",
                  _scratch, _set("sticking_bit", None), "bit", 6, 30),
    _EncoderFault("scaled", "it counts too much of the motion by this share (too little below zero)",
                  lambda encoder, size: encoder.turn_with(1.0 + size), _count_right, "1", 0.01, 1.0, least=-0.99),
    _EncoderFault("offset", "the coupling slips on its shaft by this angle, once",
                  lambda encoder, size: encoder.slip(size), None, "rad", 1e-3, 7.0, usual_in=0.1, least=-7.0),
    _EncoderFault("latch_shift", "each position is older than its stamp by this time",
                  _delay, _set("delay_s", 0.0), "s", 3e-4, 0.05),
    _EncoderFault("dropped", "this share of its frames gets lost", _drop, _set("loss", 0.0), "1", 0.1, 1.0),
    _EncoderFault("coarse", "the finest bits, as many as this, read 0", _coarsen, _set("lost_bits", 0), "bit", 8, 30),
    _EncoderFault("noisy", "its reading scatters with this standard deviation",
                  _shake, _set("noise_steps", ENCODER_NOISE_STEPS), "step", 30.0, 1e6),
    _EncoderFault("sign_flipped", "it counts backward", lambda encoder, size: encoder.turn_with(-1.0), _count_right),
    _EncoderFault("clock_drift", "its positions grow older against their stamps by this share of the time",
                  _start_drift, _end_drift, "1", 1e-4, 0.01),
    _EncoderFault("repeated", "this share of its frames tells the position of the one before",
                  _repeat, _set("repeated", 0.0), "1", 0.2, 1.0),
    _EncoderFault("bit_errors", "this share of its frames has one wrong bit",
                  _garble, _set("bit_errors", 0.0), "1", 0.01, 1.0),
    _EncoderFault("bursts", "its reading scatters with this standard deviation, 50 ms long twice a second",
                  _burst, _set("burst_steps", 0.0), "step", 300.0, 1e6),
    _EncoderFault("eccentric", "its disc has moved on its shaft: an error once per turn with this amplitude",
                  _off_centre, _set("eccentric_rad", 0.0), "rad", 1e-4, 0.1, usual_in=1e-2),
    _EncoderFault("reset", "it starts again from about zero", lambda encoder, size: encoder.start_again(), None),
)
# fmt: on


def _sensor(name: str, value: object = None) -> Act:
    """Sets a field of the drive to `value`, or to the size where there is none."""
    return lambda drive, size: setattr(drive, name, size if value is None else value)


def _restored(name: str, value: object) -> Callable[[LiveDrive], None]:
    return lambda drive: setattr(drive, name, value)


def _scale_torque(drive: LiveDrive, size: float) -> None:
    drive.torque_gain = 1.0 + size


def _warm_sensor(drive: LiveDrive, size: float) -> None:
    drive.housing.sensor_error_K = size


# the gear itself


def _wear(drive: LiveDrive, size: float) -> None:
    drive.wear += size / STIFFNESS_LOSS


def _wear_on(drive: LiveDrive, size: float) -> None:
    drive.wear_per_s = size / 60.0 / STIFFNESS_LOSS


def _added(name: str, of_size: Callable[[LiveDrive, float], Influence]) -> tuple[Act, Callable[[LiveDrive], None]]:
    """What gives the gear a further influence, and what takes it away."""

    def begin(drive: LiveDrive, size: float) -> None:
        influence = drive.added[name] = of_size(drive, size)
        drive.plant.influences = [*drive.plant.influences, influence]

    def end(drive: LiveDrive) -> None:
        gone = drive.added.pop(name)
        drive.plant.influences = [row for row in drive.plant.influences if row is not gone]

    return begin, end


def _gap(drive: LiveDrive, size: float) -> Influence:
    return Influence(twist=law(steps.DEAD_ZONE, 0.5 * size, drive.plant.joint.stiffness_Nm_per_rad))


def _dry_friction(drive: LiveDrive, size: float) -> Influence:
    return Influence(twist=law(steps.COULOMB, size))


def _payload(drive: LiveDrive, size: float) -> Influence:
    return Influence(inertia=1.0 + size)


def _weight(drive: LiveDrive, size: float) -> Influence:
    return Influence(load=True, twist=law(steps.GRAVITY, size, 0.0))


# fmt: off
_OF_THE_DRIVE = (
    Fault("exchanged", "the encoders' cables are plugged the wrong way round",
          _sensor("exchanged", True), _restored("exchanged", False)),
    Fault("torque_lag", "motor torque and current are told late by this time",
          _sensor("torque_delay_s"), _restored("torque_delay_s", 0.0), "s", 0.005, 0.0, 0.05),
    Fault("torque_scaled", "motor torque and current read too much by this share",
          _scale_torque, _restored("torque_gain", 1.0), "1", 0.2, -2.0, 10.0),
    Fault("torque_limited", "motor torque and current are told up to this and no further",
          _sensor("torque_limit_Nm"), _restored("torque_limit_Nm", math.inf), "N m", 0.2, 0.0, 1000.0),
    Fault("silent", "the drive's bus is cut: nothing that it latches arrives",
          _sensor("silent", True), _restored("silent", False)),
    Fault("temperature_off", "the housing's thermometer reads too much by this",
          _warm_sensor, lambda drive: _warm_sensor(drive, 0.0), "K", 30.0, -200.0, 200.0),
    Fault("wear", "the gear itself: its stiffness falls by this share", _wear, None, "1", 0.1, 0.0, STIFFNESS_LOSS),
    Fault("wearing", "the gear itself: its stiffness falls by this share in a minute, for as long as it lasts",
          _wear_on, _restored("wear_per_s", 0.0), "1", 0.01, 0.0, 1.0),
    Fault("backlash", "the gear itself: a gap of this twist opens at zero torque",
          *_added("backlash", _gap), "rad", 5e-5, 0.0, 0.01),
    Fault("friction", "the gear itself: dry friction of its twist grows by this",
          *_added("friction", _dry_friction), "N m", 1.0, 0.0, 50.0),
    Fault("payload", "the machine: the inertia on the output grows by this share",
          *_added("payload", _payload), "1", 0.1, -0.5, 10.0),
    Fault("weight", "the machine: an unbalanced weight makes this torque on the output",
          *_added("weight", _weight), "N m", 5.0, 0.0, 1000.0),
)
# fmt: on

FAULTS: dict[str, Fault] = {
    row.name: row for row in (*(row for kind in _ENCODER_FAULTS for row in kind.rows()), *_OF_THE_DRIVE)
}
"""Whatever can happen to a simulated drive, by name."""


# what a person types

PLANNED = re.compile(r"(?P<name>\w+)(?:@(?P<begin>[^:-]*)(?:-(?P<end>[^:]*))?)?(?::(?P<size>.*))?")
SIZE = re.compile(r"(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(?P<unit>\D*)", re.IGNORECASE)


def planned(text: str) -> PlannedFault:
    """`NAME[@SECONDS[-SECONDS]][:SIZE]`, as `latch_shift@60:0.3ms` or `frozen_in@60-90`. Raises `BadInput`."""
    parts = PLANNED.fullmatch(text.strip())
    if parts is None:
        raise BadInput(f"fault {text!r}: expected NAME[@SECONDS[-SECONDS]][:SIZE]")
    fault = known_fault(parts["name"])
    begin_s = _seconds(text, parts["begin"], FAULT_AFTER_S)
    end_s = _seconds(text, parts["end"], math.inf)
    if end_s <= begin_s:
        raise BadInput(f"fault {text!r}: ends at {end_s:g} s: expected after it begins at {begin_s:g} s")
    if end_s < math.inf and fault.end is None:
        raise BadInput(f"fault {text!r}: {fault.name} does not end by itself")
    return PlannedFault(fault, begin_s, end_s, size_of(fault, parts["size"]))


def known_fault(name: str) -> Fault:
    """The row of this name. Raises `BadInput`."""
    if name in FAULTS:
        return FAULTS[name]
    close = get_close_matches(name, FAULTS, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"expected one of {', '.join(FAULTS)}"
    raise BadInput(f"fault {name!r}: unknown: {hint}")


def _seconds(text: str, given: str | None, usual: float) -> float:
    if given is None:
        return usual
    try:
        value = float(given.removesuffix("s"))
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise BadInput(f"fault {text!r}: time {given!r}: expected seconds, not below 0")
    return value


def size_of(fault: Fault, given: str | None) -> float:
    """The size [the fault's unit] as a person writes it, `0.3ms` or `5%`; the usual one for None."""
    if given is None:
        return fault.usual
    parts = SIZE.fullmatch(given.strip())
    if not fault.unit:
        raise BadInput(f"fault {fault.name}: size {given!r}: it has no size")
    known = UNITS[fault.unit]
    unit = parts["unit"].strip() if parts else ""
    if parts is None or unit not in {"", *known}:
        raise BadInput(
            f"fault {fault.name}: size {given!r}: expected a number with one of: {', '.join(filter(None, known))}"
        )
    return fault.checked(float(parts["number"]) * known.get(unit, 1.0))


def listed() -> list[tuple[str, str, str]]:
    """Every fault as name, usual size and meaning, for a table."""
    return [(row.name, f"{row.usual:g} {row.unit}" if row.unit else "", row.meaning) for row in FAULTS.values()]
