"""Offsets as a drive takes them: CiA 402 position, velocity and torque offset (0x60B0, 0x60B1, 0x60B2).

The same bytes go over CANopen (a PDO) and EtherCAT (CoE). Offsets are bounded, and faded in and out, so that nothing
steps: neither when compensation is switched on, nor when an estimate ceases to be valid.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from edge_daemon.compensate.feedforward import Offsets

POSITION_OFFSET, VELOCITY_OFFSET, TORQUE_OFFSET = 0x60B0, 0x60B1, 0x60B2
COUNTS_MAX, MILLE_MAX = 2**31 - 1, 2**15 - 1
"""What 32 and 16 bits with a sign hold."""


@dataclass(frozen=True, slots=True)
class OffsetBounds:
    """At the motor: largest offsets, and how long fading takes."""

    position_rad: float = 0.5
    velocity_rad_s: float = 20.0
    torque_Nm: float = 0.5
    fade_s: float = 0.5


@dataclass(frozen=True, slots=True)
class DriveScale:
    """How the drive counts: counts per motor turn, rated torque [N m] (torques are in thousandths of it)."""

    counts_per_rad: float
    rated_torque_Nm: float


@dataclass(slots=True)
class OffsetStream:
    """One cycle after another. `valid` false fades out from where it stands; true again fades in."""

    bounds: OffsetBounds
    scale: DriveScale
    share: float = 0.0
    """0 off, 1 full"""
    bounded: int = 0
    """cycles in which a bound held"""
    _last: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def step(self, position_rad: float, velocity_rad_s: float, torque_Nm: float, valid: bool, passed_s: float) -> bytes:
        """The PDO of one cycle: position and velocity offset [counts, counts/s], torque offset [thousandths]."""
        wanted = (position_rad, velocity_rad_s, torque_Nm)
        if not all(abs(value) < float("inf") for value in wanted):
            valid = False
        if valid:
            self._last = wanted
        rise = passed_s / self.bounds.fade_s if self.bounds.fade_s > 0.0 else 1.0
        self.share = min(max(self.share + (rise if valid else -rise), 0.0), 1.0)
        limits = (self.bounds.position_rad, self.bounds.velocity_rad_s, self.bounds.torque_Nm)
        held = [min(max(value, -limit), limit) for value, limit in zip(self._last, limits, strict=True)]
        self.bounded += any(abs(value) > limit for value, limit in zip(self._last, limits, strict=True))
        return self._packed(*(smooth(self.share) * value for value in held))

    def _packed(self, position: float, velocity: float, torque: float) -> bytes:
        counts = [round(min(max(v * self.scale.counts_per_rad, -COUNTS_MAX), COUNTS_MAX)) for v in (position, velocity)]
        mille = round(min(max(1000.0 * torque / self.scale.rated_torque_Nm, -MILLE_MAX), MILLE_MAX))
        return struct.pack("<iih", *counts, mille)


def streamed(found: Offsets, rate_hz: float, stream: OffsetStream) -> Iterator[str]:
    """A motion's offsets as CSV, one line a cycle; they fade in at its begin and out before its end."""
    yield "time_s,position_offset_counts,velocity_offset_counts_per_s,torque_offset_mille,pdo_hex"
    count, passed_s = len(found.position_rad), 1.0 / rate_hz
    last = count - round(stream.bounds.fade_s * rate_hz)
    for k in range(count):
        wanted = float(found.position_rad[k]), float(found.velocity_rad_s[k]), float(found.torque_Nm[k])
        sent = stream.step(*wanted, valid=k < last, passed_s=passed_s)
        position, velocity, torque = struct.unpack("<iih", sent)
        yield f"{k * passed_s:.6g},{position},{velocity},{torque},{sent.hex()}"


def smooth(share: float) -> float:
    """A ramp without corners from 0 to 1: 3 s^2 - 2 s^3."""
    return share * share * (3.0 - 2.0 * share)
