"""Blocks to motion, continuously: one linear-phase filter for both sides, its history kept between blocks.

Where a model holds effects that are not linear (a sign, a hysteresis), their arguments pass a lighter filter first:
the balance filter would blunt a reversal before the effect sees it, and belongs on the columns that come of them.

What comes out lags what went in by the filter's delay; the times say so. Samples with flaws are bridged for the
filter's sake, and everything within the filter's reach of them is marked invalid. A gap starts the filter anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge_daemon.estimate.kinematics import FirSet, filters
from edge_daemon.records import Array, Block, Flaw, Motion

Mask = NDArray[np.bool_]

ORDERS = (1, 2, 4)
"""kinematic error per wave generator turn: two lobes make 2 dominant, eccentricity 1, their overtone 4"""
ANGLES = {"theta_in_rad", "theta_out_rad"}
TWIST, OUT, WAVES, MOTOR = 0, 1, slice(2, 2 + 2 * len(ORDERS)), 2 + 2 * len(ORDERS)
"""places of the signals to be filtered; those before MOTOR are differentiated too; a torque and slow channels follow"""
ARGUMENT_SHARE = 0.34
"""cut-off of the light filter over the sampling rate: as wide as its edge allows below one half"""
JITTER_ORDER = 12
"""the differences of this order hold what lies above 0.35 of the sampling rate: noise, and no motion of a gear; a
kinematic error at a tenth of the sampling rate is left by a millionth"""
JITTER = np.array([(-1.0) ** i * math.comb(JITTER_ORDER, i) for i in range(JITTER_ORDER + 1)])
JITTER /= math.sqrt(float(JITTER @ JITTER))
JITTER_SHARE, JITTER_QUANTILE = 0.5, 0.45494
"""the square that this share of normal numbers stays below: impacts and reversals of friction are among the rest"""
GAP_SAMPLES = 0.5
"""a block that starts this far from where the last one ended leaves a gap"""


@dataclass(frozen=True, slots=True)
class Arguments:
    """Lightly filtered motion, for effects that are not linear."""

    motion: Motion
    """samples that no stretch before held; the filter's whole reach of them after a start"""
    kinematic: Array
    """(m, 2 * len(ORDERS)) as in `Stretch`"""
    kinematic_rate: Array
    balance: Array
    """(n, fresh + reach) the balance filter as a matrix, to be put on the columns of these and of earlier samples"""
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
    jitter_rad2: tuple[float, float] = (math.nan, math.nan)
    """variance of the white noise of motor and output angle, measured here; NaN where it could not be"""
    arguments: Arguments | None = None
    """None where nobody asked for them"""


@dataclass(frozen=True, slots=True)
class Frame:
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
    reset: bool


class MotionStream:
    """`push` blocks, get stretches. Holds no clock: a gap is what the blocks' own times say."""

    def __init__(self, frame: Frame, fir: FirSet) -> None:
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
        self._history: Array | None = None
        self._bad = np.zeros(0, dtype=bool)
        self._names: tuple[str, ...] = ()
        self._balance: tuple[str, ...] = ()
        self._next_s = math.nan
        self._twist_zero_rad = math.nan
        self._fresh = True

    def push(self, block: Block) -> Stretch | None:
        """The stretch this block completes; None while the filter fills or where a needed channel is missing."""
        balance = self._channels(block)
        if not balance:
            return None
        names = (*balance, *self._slow_names(block))
        late_samples = abs(block.start_s - self._next_s) * block.rate_hz
        bad = self._unusable(block, balance)
        if names != self._names or not late_samples <= GAP_SAMPLES or bad.reset:
            self.restarts += self._history is not None
            self._forget_history()
            self._names, self._balance = names, balance
        self._next_s = block.end_s
        signals, marks = self._signals(block, bad.marks), bad.marks
        if self._history is None:
            self._history = np.empty((0, signals.shape[1]))
        joined, marks = np.concatenate([self._history, signals]), np.concatenate([self._bad, marks])
        reach = 2 * (self.fir.delay + self._lag)
        self._history, self._bad = joined[-reach:], marks[-reach:]
        self.step = next(step for step in range(self.fir.step, 0, -1) if block.size % step == 0)
        if len(joined) <= reach:
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
        torque = next(((name,) for name in ("torque_in_Nm", "current_in_A") if name in present), ())
        return (*(out or motor), *torque) if (out or motor) and torque else ()

    @staticmethod
    def _unusable(block: Block, names: tuple[str, ...]) -> _Unusable:
        """Samples that must not count; after an encoder's reset its zero is a new one, so all before it go too."""
        marks = ~block.valid(*names)
        last_reset = -1
        for name in names:
            marks |= ~np.isfinite(block.values[name])
            resets = np.flatnonzero(block.flaws[name] & np.uint8(Flaw.RESET)) if name in block.flaws else ()
            last_reset = max(last_reset, *resets) if len(resets) else last_reset
        marks[: last_reset + 1] = True
        return _Unusable(marks, last_reset >= 0)

    def _signals(self, block: Block, bad: Mask) -> Array:
        """(n, c) signals to filter, gaps bridged."""
        values = {name: _bridged(block.values[name], bad) for name in self._balance}
        ratio = self.frame.ratio
        out = values["theta_out_rad"] if "theta_out_rad" in values else values["theta_in_rad"] / ratio
        motor = values.get("theta_in_rad", out * ratio)
        twist = motor / ratio - out
        if not math.isfinite(self._twist_zero_rad) and not bad.all():
            self._twist_zero_rad = float(twist[~bad].mean())
        twist = twist - (self._twist_zero_rad if math.isfinite(self._twist_zero_rad) else 0.0)
        torque = next((values[name] for name in self._balance if name not in ANGLES), None)
        others = [_held(block, name) for name in self._slow_names(block)]
        columns = [twist, out, *_waves(motor), motor, *([] if torque is None else [torque]), *others]
        joined = np.empty((block.size, len(columns)))
        for i, column in enumerate(columns):
            joined[:, i] = column
        return joined

    def _slow_names(self, block: Block) -> tuple[str, ...]:
        """Channels beyond the balance's that pass its filter with it, where they are measured."""
        return tuple(name for name in ("temperature_degC", *self.frame.extra) if name in block.values)

    def _stretch(self, block: Block, joined: Array, marks: Mask) -> Stretch:
        reach, lag = 2 * (self.fir.delay + self._lag), self._lag
        n = len(joined) - reach
        if marks.any():
            running = np.concatenate(([0], np.cumsum(marks)))
            valid = (running[reach + 1 :] == running[:n])[(n - 1) % self.step :: self.step]
        else:
            valid = np.ones(-(-n // self.step), dtype=bool)
        motion, waves, rates = self._filtered(block, joined[lag : len(joined) - lag], self.fir, lag)
        arguments = self._arguments(block, joined, n) if self._light is not None else None
        fresh, self._fresh = self._fresh, False
        self._turn = not self._turn  # every other stretch tells enough of the noise
        new = joined[reach - JITTER_ORDER :] if self._turn and not marks.any() else joined[:0]
        return Stretch(motion, valid, waves, rates, fresh, (_jitter(new[:, MOTOR]), _jitter(new[:, OUT])), arguments)

    def _arguments(self, block: Block, joined: Array, n: int) -> Arguments:
        assert self._light is not None
        new = joined if self._fresh else joined[-(n + 2 * self._lag) :]
        both, _ = self._filters(self.fir, n + 2 * self.fir.delay)
        _, second = self._filters(self._light, len(new))
        twist, raw = second @ new[:, TWIST], new[self._lag : len(new) - self._lag, TWIST]
        return Arguments(*self._filtered(block, new, self._light, 0), both[: len(both) // 2], twist, raw, n)

    def _filtered(self, block: Block, joined: Array, fir: FirSet, lag: int) -> tuple[Motion, Array, Array]:
        """Motion, waves and their rates; the newest sample of `joined` is `lag` samples before the block's last."""
        both, second = self._filters(fir, len(joined))
        n, frame, step = len(both) // 2, self.frame, 1 if fir is self._light else self.step
        smooth = both[:n] @ joined
        rate = both[n:] @ joined[:, :MOTOR]
        acceleration = second @ joined[:, OUT]
        measured = len(self._balance) > len(ANGLES & set(self._balance))
        slow = MOTOR + 1 + measured
        named = dict(zip(self._names[len(self._balance) :], smooth.T[slow:], strict=True))
        unknown = np.full(n, math.nan)
        newest_s = block.end_s - (1 + fir.delay + lag) / block.rate_hz
        motion = Motion(
            rate_hz=block.rate_hz / step,
            ratio=frame.ratio,
            time_s=newest_s - np.arange(float(n - 1), -1.0, -1.0) * (step / block.rate_hz),
            theta_in_rad=smooth[:, MOTOR],
            theta_out_rad=smooth[:, OUT],
            twist_rad=smooth[:, TWIST],
            twist_rate_rad_s=rate[:, TWIST],
            velocity_out_rad_s=rate[:, OUT],
            acceleration_out_rad_s2=acceleration,
            torque_Nm=smooth[:, MOTOR + 1] if measured else frame.inertia_kg_m2 * acceleration,
            temperature_degC=named.get("temperature_degC", unknown),
            extra={name: named.get(name, unknown) for name in frame.extra},
        )
        return motion, smooth[:, WAVES], rate[:, WAVES]

    def _filters(self, fir: FirSet, n: int) -> tuple[Array, Array]:
        """Banded matrices, (rows, n): value above first derivative, and second derivative; every `step`-th row, but
        all of the light filter. For short blocks faster than any transform."""
        light = fir is self._light
        key = light, n, 1 if light else self.step
        made = self._matrices.get(key)
        if made is None:
            rows = [_banded(kernel, n)[:: -key[2]][::-1] for kernel in (fir.value, fir.first, fir.second)]
            made = (np.concatenate(rows[:2]), np.ascontiguousarray(rows[2]))
            self._matrices = {other: kept for other, kept in self._matrices.items() if other[0] is not light}
            self._matrices[key] = made
        return made


def _jitter(angle: Array) -> float:
    """Variance of the white noise in an angle; NaN for too few samples."""
    if len(angle) <= 2 * JITTER_ORDER:
        return math.nan
    squares = np.convolve(angle, JITTER, "valid") ** 2
    rank = int(JITTER_SHARE * len(squares))
    return float(np.partition(squares, rank)[rank]) / JITTER_QUANTILE


def _waves(motor: Array) -> list[Array]:
    """Sine and cosine of each of ORDERS, the higher ones by doubling the angle."""
    angle = motor % (2 * math.pi)
    s1, c1 = np.sin(angle), np.cos(angle)
    s2, c2 = 2 * s1 * c1, 1 - 2 * s1**2
    return [s1, c1, s2, c2, 2 * s2 * c2, 1 - 2 * s2**2]


def _banded(kernel: Array, n: int) -> Array:
    rows = n - len(kernel) + 1
    matrix = np.zeros((rows, n))
    for i in range(rows):
        matrix[i, i : i + len(kernel)] = kernel[::-1]
    return matrix


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
