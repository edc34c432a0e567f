"""Blocks to motion, continuously: one linear-phase filter for both sides, its history kept between blocks.

Where a model holds effects that are not linear (a sign, a hysteresis), their arguments pass a lighter filter first:
the balance filter would blunt a reversal before the effect sees it, and belongs on the columns that come of them.

What comes out lags what went in by the filter's delay; the times say so. Samples with flaws are bridged for the
filter's sake, and everything within the filter's reach of them is marked invalid. A gap starts the filter anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np

from edge_daemon.channels import MOTOR_ORDERS, MOTOR_TORQUES
from edge_daemon.motion.filter_matrix import FilterMatrix, banded, piece_of, windows_of
from edge_daemon.motion.kinematics import FirSet, filters
from edge_daemon.records import Array, Block, Flaw, Mask, Motion

ORDERS = MOTOR_ORDERS
"""Orders of the kinematic error that is followed live; the waves are made by doubling the angle, so these three."""
ANGLES = {"theta_in_rad", "theta_out_rad"}
TWIST, OUT, WAVES, MOTOR = 0, 1, slice(2, 2 + 2 * len(ORDERS)), 2 + 2 * len(ORDERS)
"""Places of the signals to be filtered; those before MOTOR are differentiated too; a torque and slow channels
follow."""
ARGUMENT_SHARE = 0.34
"""Cut-off of the light filter over the sampling rate: as wide as its edge allows below one half."""
JITTER_ORDER = 12
"""The differences of this order hold what lies above 0.35 of the sampling rate: noise, and no motion of a gear; a
kinematic error at a tenth of the sampling rate is left by a millionth."""
JITTER = np.array([(-1.0) ** i * math.comb(JITTER_ORDER, i) for i in range(JITTER_ORDER + 1)])
JITTER /= math.sqrt(float(JITTER @ JITTER))
JITTER_SHARE, JITTER_QUANTILE = 0.5, 0.45494
"""This share of normal numbers has a square below the quantile: impacts and reversals of friction are among the
rest."""


@dataclass(frozen=True, slots=True)
class Arguments:
    """Lightly filtered motion, for effects that are not linear."""

    motion: Motion
    """samples that no stretch before held; the filter's whole reach of them after a start"""
    kinematic: Array
    """(m, 2 * len(ORDERS)) as in `Stretch`"""
    kinematic_rate: Array
    balance: FilterMatrix
    """to be put on the columns of these and of earlier samples"""
    twist_acceleration_rad_s2: Array
    """(m,)"""
    twist_unfiltered_rad: Array
    """(m,) at the same instants"""
    fresh: int
    """samples at full rate that this stretch has before the next"""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Motion at the instants that the newest block completed."""

    motion: Motion
    valid: Mask
    """(n,) False within the filter's reach of a sample that must not be used"""
    kinematic: Array
    """(n, 2 * len(ORDERS)) sine and cosine of each order of the motor angle, smoothed like the twist"""
    kinematic_rate: Array
    """same shape: their smoothed rates [1/s]"""
    fresh: bool
    """the zero of an encoder may have moved since the last stretch"""
    zero_rad: float = math.nan
    """of the encoders' twist, where that of `motion` has its own"""
    jitter_rad2: tuple[float, float] = (math.nan, math.nan)
    """variance of the white noise of motor and output angle, measured here; NaN where it could not be"""
    torque_jitter: float = math.nan
    """the same of the measured torque, square of its unit"""
    arguments: Arguments | None = None
    """None where nobody asked for them"""
    unfiltered: Array = field(default_factory=lambda: np.empty((MOTOR + 1, 0)))
    """(MOTOR + 1, block) signals of the newest block; flaws bridged"""


@dataclass(frozen=True, slots=True)
class MotionFrame:
    """How one joint's channels become motion."""

    ratio: float
    inertia_kg_m2: float
    drive: bool
    """drive balance: the torque is the motor's, and the motor angle may be missing"""
    extra: tuple[str, ...] = ()
    """further channels that the model uses"""
    arguments: bool = False
    """whether effects of the model want the lightly filtered motion too"""


class _Unusable(NamedTuple):
    marks: Mask
    some: bool
    reset: bool


class MotionStream:
    """`push` blocks, get stretches. Holds no clock: a gap is what the blocks' own times say."""

    def __init__(self, frame: MotionFrame, fir: FirSet) -> None:
        self.frame = frame
        self.fir = fir
        self.restarts = 0
        self._turn = False
        self.step = 1
        """every how many samples a stretch has one; what passes the filter needs no more"""
        self._light = filters(fir.rate_hz, ARGUMENT_SHARE * fir.rate_hz) if frame.arguments else None
        self._lag = self._light.delay if self._light is not None else 0
        self._matrices: dict[tuple[bool, int, int], tuple[Array, Array]] = {}
        self._forget_history()

    def _forget_history(self) -> None:
        self._history: Array | None = None  # (c, reach): signals by rows, as the filter takes them
        self._bad = np.zeros(0, dtype=bool)
        self._names: tuple[str, ...] = ()
        self._balance: tuple[str, ...] = ()
        self._next_s = math.nan
        self._twist_zero_rad = math.nan
        self._fresh = True

    def restart(self) -> None:
        """What comes is counted from elsewhere."""
        self.restarts += self._history is not None
        self._forget_history()

    def push(self, block: Block) -> Stretch | None:
        """The stretch this block completes; None while the filter fills or where a needed channel is missing."""
        balance = self._channels(block)
        if not balance:
            return None
        names = (*balance, *self._slow_names(block))
        bad = self._unusable(block, balance)
        if names != self._names or not block.starts_at(self._next_s) or bad.reset:
            self.restart()
            self._names, self._balance = names, balance
        self._next_s = block.end_s
        joined, marks = self._joined(block, bad), np.concatenate([self._bad, bad.marks])
        reach = 2 * (self.fir.delay + self._lag)
        self._history, self._bad = joined[:, -reach:], marks[-reach:]
        self.step = _step(self.fir.step, block.size)
        if len(marks) <= reach:
            return None
        return self._stretch(block, joined, marks)

    def _channels(self, block: Block) -> tuple[str, ...]:
        """Channels that enter the balance, () when one that must be there is not; their flaws count."""
        present = block.values
        out = ("theta_out_rad",) if "theta_out_rad" in present else ()
        motor = ("theta_in_rad",) if "theta_in_rad" in present else ()
        if not self.frame.drive:
            torque = ("torque_out_Nm",) if "torque_out_Nm" in present else ()
            known = torque or math.isfinite(self.frame.inertia_kg_m2)
            return (*out, *motor, *torque) if out and motor and known else ()
        torque = next(((name,) for name in MOTOR_TORQUES if name in present), ())
        return (*(out or motor), *torque) if (out or motor) and torque else ()

    @staticmethod
    def _unusable(block: Block, names: tuple[str, ...]) -> _Unusable:
        """Samples that must not count; after an encoder's reset its zero is a new one, so all before it go too."""
        marks, some, last_reset = np.zeros(block.size, dtype=bool), False, -1
        for name in names:
            finite, flaws = np.isfinite(block.values[name]), block.flaws.get(name)
            if np.count_nonzero(finite) == len(marks) and flaws is not None and not np.count_nonzero(flaws):
                continue  # nearly always
            some = True
            marks |= ~finite | ~block.valid(name)
            if flaws is not None:
                last_reset = max(last_reset, *np.flatnonzero(flaws & np.uint8(Flaw.RESET)).tolist(), -1)
        marks[: last_reset + 1] = True
        return _Unusable(marks, some, last_reset >= 0)

    def _joined(self, block: Block, bad: _Unusable) -> Array:
        """(c, n) signals to filter: what is kept of earlier blocks and, gaps bridged, this one."""
        values = {
            name: _bridged(block.values[name], bad.marks) if bad.some else block.values[name] for name in self._balance
        }
        ratio, extra = self.frame.ratio, self._names[len(self._balance) :]
        out = values["theta_out_rad"] if "theta_out_rad" in values else values["theta_in_rad"] / ratio
        motor = values["theta_in_rad"] if "theta_in_rad" in values else out * ratio
        twist = motor / ratio - out
        if not math.isfinite(self._twist_zero_rad) and not bad.marks.all():
            self._twist_zero_rad = float(twist[~bad.marks].mean())
        known = 0 if self._history is None else self._history.shape[1]
        joined = np.empty((MOTOR + 1 + self._measured + len(extra), known + len(out)))
        if self._history is not None:
            joined[:, :known] = self._history
        new = joined[:, known:]
        new[TWIST] = twist - self._twist_zero_rad if math.isfinite(self._twist_zero_rad) else twist
        new[OUT], new[MOTOR] = out, motor
        _waves(motor, new[WAVES])
        if self._measured:
            torque = next(values[name] for name in self._balance if name not in ANGLES)
            new[MOTOR + 1] = -torque if self.frame.drive and ratio < 0.0 else torque
        for i, name in enumerate(extra, MOTOR + 1 + self._measured):
            new[i] = _held(block, name)
        return joined

    @property
    def _measured(self) -> bool:
        """Whether there is a torque among the signals, after the motor angle."""
        return self._balance[-1] not in ANGLES

    def _slow_names(self, block: Block) -> tuple[str, ...]:
        """Channels beyond the balance's that pass its filter with it, where they are measured."""
        return tuple(name for name in ("temperature_degC", *self.frame.extra) if name in block.values)

    def _stretch(self, block: Block, joined: Array, marks: Mask) -> Stretch:
        reach, lag = 2 * (self.fir.delay + self._lag), self._lag
        n, flawless = len(marks) - reach, not np.count_nonzero(marks)
        if not flawless:
            running = np.concatenate(([0], np.cumsum(marks)))
            valid = (running[reach + 1 :] == running[:n])[(n - 1) % self.step :: self.step]
        else:
            valid = _all_valid(-(-n // self.step))
        motion, waves, rates = self._filtered(block, joined[:, lag : len(marks) - lag], self.fir, lag)
        arguments = self._arguments(block, joined, n) if self._light is not None else None
        fresh, self._fresh = self._fresh, False
        self._turn = not self._turn  # every other stretch tells enough of the noise
        new = joined[:, reach - JITTER_ORDER :] if self._turn and flawless else joined[:, :0]
        unfiltered = joined[: MOTOR + 1, joined.shape[1] - block.size :]
        jitter = _jitter(new[MOTOR]), _jitter(new[OUT])
        zero_rad = self._twist_zero_rad
        torque = _jitter(new[MOTOR + 1]) if self._measured else math.nan
        return Stretch(motion, valid, waves, rates, fresh, zero_rad, jitter, torque, arguments, unfiltered)

    def _arguments(self, block: Block, joined: Array, n: int) -> Arguments:
        assert self._light is not None
        new = joined if self._fresh else joined[:, -(n + 2 * self._lag) :]
        piece = piece_of(n, self.step)
        both, _ = self._filters(self.fir, piece)
        balance = FilterMatrix(both[: len(both) // 2], piece, n + 2 * self.fir.delay)
        twist = self._smoothed(new[: TWIST + 1], self._light, TWIST)[2]
        raw = new[TWIST, self._lag : new.shape[1] - self._lag]
        return Arguments(*self._filtered(block, new, self._light, 0), balance, twist, raw, n)

    def _filtered(self, block: Block, joined: Array, fir: FirSet, lag: int) -> tuple[Motion, Array, Array]:
        """Motion, waves and their rates; the newest sample of `joined` is `lag` samples before the block's last."""
        frame, step = self.frame, 1 if fir is self._light else self.step
        smooth, rate, acceleration = self._smoothed(joined, fir)
        n = len(acceleration)
        measured = self._measured
        named = dict(zip(self._names[len(self._balance) :], smooth[MOTOR + 1 + measured :], strict=True))
        unknown = _unmeasured(n)
        newest_s = block.end_s - (1 + fir.delay + lag) / block.rate_hz
        motion = Motion(
            rate_hz=block.rate_hz / step,
            ratio=frame.ratio,
            time_s=newest_s - _ages(n, step / block.rate_hz),
            theta_in_rad=smooth[MOTOR],
            theta_out_rad=smooth[OUT],
            twist_rad=smooth[TWIST],
            twist_rate_rad_s=rate[TWIST],
            velocity_out_rad_s=rate[OUT],
            acceleration_out_rad_s2=acceleration,
            torque_Nm=smooth[MOTOR + 1] if measured else frame.inertia_kg_m2 * acceleration,
            temperature_degC=named.get("temperature_degC", unknown),
            extra={name: named.get(name, unknown) for name in frame.extra},
            inertia_kg_m2=0.0 if measured else frame.inertia_kg_m2,
        )
        return motion, smooth[WAVES].T, rate[WAVES].T

    def _smoothed(self, joined: Array, fir: FirSet, bent: int = OUT) -> tuple[Array, Array, Array]:
        """(c, n) values of the (c, m) signals and their rates, and (n,) second derivative of one of them, a piece at a
        time: the filters are matrices, and their zeros should stay few."""
        reach = 2 * fir.delay
        piece = piece_of(joined.shape[1] - reach, 1 if fir is self._light else self.step)
        both, second = self._filters(fir, piece)
        windows, rows = windows_of(joined, piece, piece + reach), len(second)
        filtered = windows @ both.T
        smooth, rate = (part.reshape(len(joined), -1) for part in (filtered[..., :rows], filtered[..., rows:]))
        return smooth, rate, (windows[bent] @ second.T).ravel()

    def _filters(self, fir: FirSet, piece: int) -> tuple[Array, Array]:
        """Banded matrices, (rows, piece + reach): value above first derivative, and second derivative; every `step`-th
        row, but all of the light filter. For short pieces faster than any transform."""
        light = fir is self._light
        key = light, piece, 1 if light else self.step
        made = self._matrices.get(key)
        if made is None:
            size = piece + 2 * fir.delay
            rows = [banded(kernel, size)[:: -key[2]][::-1] for kernel in (fir.value, fir.first, fir.second)]
            made = (np.concatenate(rows[:2]), np.ascontiguousarray(rows[2]))
            self._matrices = {other: kept for other, kept in self._matrices.items() if other[0] is not light}
            self._matrices[key] = made
        return made


def _jitter(signal: Array) -> float:
    """Variance of the white noise in an angle or a torque; NaN for too few samples."""
    if len(signal) <= 2 * JITTER_ORDER:
        return math.nan
    squares = np.convolve(signal, JITTER, "valid") ** 2
    rank = int(JITTER_SHARE * len(squares))
    squares.partition(rank)
    return float(squares[rank]) / JITTER_QUANTILE


def _waves(motor: Array, rows: Array) -> None:
    """Fill (6, n) rows with sine and cosine of each of ORDERS, the higher ones by doubling the angle."""
    angle = motor % (2 * math.pi)
    np.sin(angle, out=rows[0])
    np.cos(angle, out=rows[1])
    for sine, cosine, twice_sine, twice_cosine in (rows[:4], rows[2:]):
        twice_sine[:] = 2 * sine * cosine
        twice_cosine[:] = 1 - 2 * sine * sine


@cache
def _step(most: int, size: int) -> int:
    """The largest step up to `most` that divides a block of `size` samples."""
    return next(step for step in range(most, 0, -1) if size % step == 0)


@cache
def _all_valid(n: int) -> Mask:
    """(n,) True, read only."""
    valid = np.ones(n, dtype=bool)
    valid.setflags(write=False)
    return valid


@cache
def _unmeasured(n: int) -> Array:
    """(n,) NaN, read only."""
    unknown = np.full(n, math.nan)
    unknown.setflags(write=False)
    return unknown


@cache
def _ages(n: int, period_s: float) -> Array:
    """(n,) how much older than the newest each of n even samples is [s]."""
    return np.arange(float(n - 1), -1.0, -1.0) * period_s


def _bridged(values: Array, bad: Mask) -> Array:
    """`values` with straight lines over the marked samples; zeros if all are marked."""
    if not bad.any():
        return values
    if bad.all():
        return np.zeros(len(values))
    index = np.arange(len(values))
    return np.interp(index, index[~bad], values[~bad])


def _held(block: Block, name: str) -> Array:
    """A slow channel with its own flaws bridged; NaN where it was not measured."""
    values = block.values.get(name)
    if values is None:
        return np.full(block.size, math.nan)
    bad = ~block.valid(name) | ~np.isfinite(values)
    return np.full(block.size, math.nan) if bad.all() else _bridged(values, bad)
