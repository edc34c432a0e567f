"""One recording ready for regression: what its rows are, and which blocks of it can be held out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.quiet_input import QuietFilter
from edge_daemon.balance.reversals import UnknownDirections, without_unknown
from edge_daemon.balance.sensor_noise import NoiseOfSensors
from edge_daemon.motion.kinematics import FirSet, KinematicsError
from edge_daemon.records import Array, Mask, Motion

BLOCK_S = 1.25
"""A block of the hold-out is longer than any memory of the residual."""
LEAST_BLOCKS = 6
LEAST_KNOWN = 20
"""So many samples beside reversals are needed: of fewer any effect leaves nothing (guess)."""
SHORTER_BLOCKS_S = (0.5, 0.25)
"""Where recordings are too short for such blocks they are shorter, down to two guards and a half."""


@dataclass(frozen=True, slots=True)
class Angles:
    """Both angles as read, on the even time base of the motion, (n,) each."""

    theta_in_rad: Array
    theta_out_rad: Array
    valid: Mask
    """False within a filter's reach of a gap"""


@dataclass(frozen=True, slots=True)
class PreparedMotion:
    """One recording, ready."""

    motion: Motion
    """at full rate, arguments filtered"""
    fir: FirSet
    """the balance filter"""
    step: int
    """decimation"""
    rows: NDArray[np.intp]
    """(m,) samples of the full rate that are kept: valid, outside guards"""
    block: NDArray[np.intp]
    """(m,) number of the hold-out block"""
    target: Array
    """(m,) torque (or current) through the balance filter"""
    sensors: NoiseOfSensors
    moments: tuple[float, float, float]
    """of the balance filter's power gain: what it leaves of white noise and of its derivatives"""
    seconds: float
    """time that the kept rows stand for"""
    input_rad_s: Array
    """(n,) speed of the input over the ratio, free of the encoder's noise above the motion; empty in a drive balance"""
    zero_rad: float = 0.0
    """difference of the encoders' zeros, taken out of the twist"""
    angles: Angles | None = None
    """None where the torque is measured, or one of them is not"""
    unsure: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """(n,) samples in which nothing tells the friction of the motor"""
    unknown: tuple[UnknownDirections, ...] = ()
    """what nothing tells of friction at reversals: left out of target and columns"""
    remarks: tuple[str, ...] = ()
    """what was left out of the recording and why, a line each"""
    late_s: Mapping[str, float] = field(default_factory=dict)
    """by how much channels were moved"""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """channels that tell nothing beside others, and the line that says so"""
    block_s: float = BLOCK_S
    """length of the hold-out's blocks"""
    quiet_twist: QuietFilter | None = None
    quiet_torque: QuietFilter | None = None
    """What twist and torque pass before they move friction, where their noise would shake it."""
    by_motor: bool = False
    """whether the torque is the motor's, times the ratio"""
    odd: bool = False
    """whether stretches are left out that a first look cannot tell"""
    acceleration_noise: float = 0.0
    """Mean square that sensor noise leaves in the acceleration of a drive balance."""
    heard_hz: Array = field(default_factory=lambda: np.empty(0))
    heard: Array = field(default_factory=lambda: np.empty(0))
    """By frequency (k,) the share of that (k,): together one."""
    drive_floor: float = 0.0
    """rms that sensor noise leaves in a drive balance: of the torque, and of a first look at inertia times
    acceleration. It is the same for every model, or a model that bends the inertia would look as good as its noise."""

    def project(self, columns: Array) -> Array:
        """(m, k) of columns (n, k) through the balance filter."""
        return without_unknown(self.fir.apply(self.fir.value, columns)[self.rows], self.unknown)

    def felt(self, motion: Motion) -> Motion:
        """A motion of it as friction feels it, without the sensors' noise."""
        if self.quiet_twist is not None:
            twist, rate = (self.quiet_twist(column) for column in (motion.twist_rad, motion.twist_rate_rad_s))
            motion = replace(motion, twist_rad=twist, twist_rate_rad_s=rate)
        return motion if self.quiet_torque is None else replace(motion, torque_Nm=self.quiet_torque(motion.torque_Nm))

    @property
    def known(self) -> int:
        """Rows less what nothing tells of them at reversals."""
        return len(self.rows) - sum(int(row.basis.shape[1]) for row in self.unknown)

    @property
    def freedom(self) -> float:
        """Independent observations: twice the bandwidth times the time, whatever the sampling rate."""
        return 2 * self.fir.cutoff_hz * self.seconds


def from_zero(prepared: PreparedMotion, zero_rad: float) -> PreparedMotion:
    """A trial whose twist counts from another difference of the encoders' zeros."""
    twist = prepared.motion.twist_rad + (prepared.zero_rad - zero_rad)
    return replace(prepared, motion=replace(prepared.motion, twist_rad=twist), zero_rad=zero_rad)


def from_torque_zero(prepared: PreparedMotion, zero_Nm: float) -> PreparedMotion:
    """A trial whose measured torque counts from another zero."""
    torque = prepared.motion.torque_Nm - zero_Nm
    target = without_unknown(prepared.fir.apply(prepared.fir.value, torque)[prepared.rows], prepared.unknown)
    return replace(prepared, motion=replace(prepared.motion, torque_Nm=torque), target=target)


def blocks_of(trials: Sequence[PreparedMotion]) -> int:
    """Number of blocks that can be held out."""
    return sum(len(np.unique(trial.block)) for trial in trials)


def enough(trials: Sequence[PreparedMotion]) -> None:
    """Raises `KinematicsError` where all recordings together are too short to hold blocks out."""
    if blocks_of(trials) < LEAST_BLOCKS:
        seconds, wanted = (
            sum(trial.seconds for trial in trials),
            f"{LEAST_BLOCKS} stretches of {SHORTER_BLOCKS_S[-1]:g} s",
        )
        found = f"{seconds:.3g} s of motion without gaps"
        raise KinematicsError(f"{found}: expected at least {wanted}, there are {blocks_of(trials)}")
    known = sum(trial.known for trial in trials)
    if known < LEAST_KNOWN:
        raise KinematicsError(f"{known} samples tell the direction of motion: expected at least {LEAST_KNOWN}")
