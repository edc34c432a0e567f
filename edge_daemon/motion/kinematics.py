"""Angles to motion: value, rate and acceleration through one linear-phase kernel.

The kernel is a sinc under a Gaussian window, g(t) = 2 fc sinc(2 fc t) exp(-t^2 / 2 s^2). Its samples smooth, the
samples of its derivatives differentiate; since all three come from the same g, both sides of a balance keep the same
magnitude and delay at every frequency, and what the filter removes it removes from both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from edge_daemon.channels import MOTOR_TORQUES
from edge_daemon.errors import BadInput
from edge_daemon.records import Array, Mask, Motion

TRANSITION = 0.15
"""The filter's edge has this standard deviation over its cut-off: a compromise of sharpness and length."""
SAMPLES_PER_CUTOFF = 3.2
"""What has passed a filter is still sampled in full at this rate over its cut-off."""
BRIDGE_S = 0.006
"""Holes up to this long lose nothing that a balance of 100 Hz needs: a motion of 30 Hz turns by one radian in it."""
REACH = 5.5
"""The kernel reaches so many standard deviations of its window to either side: the rest is 3e-7."""


class KinematicsError(BadInput):
    """One line: what about the recording keeps the motion from being computed."""


@dataclass(frozen=True, slots=True)
class FirSet:
    """Three odd-length kernels with one delay. `np.convolve(x, taps)` order: newest sample first."""

    rate_hz: float
    cutoff_hz: float
    value: Array
    """(2 * delay + 1,) smooths; sums to one"""
    first: Array
    """same length: smoothed first derivative [1/s]; exact on a ramp"""
    second: Array
    """same length: smoothed second derivative [1/s^2]; exact on a parabola"""

    @property
    def delay(self) -> int:
        """Samples between the middle of the kernel and its newest end."""
        return len(self.value) // 2

    @property
    def beyond(self) -> Array:
        """(k,) takes out all up to the cut-off, however softly `value` ends there: a tenth of any frequency is left of
        both, where a filter and what it takes out have a quarter in common."""
        return _beyond(self.rate_hz, self.cutoff_hz)

    @property
    def bandwidth(self) -> float:
        """What `value` leaves of the variance of white noise: the share of its samples that are independent."""
        return float(self.value @ self.value)

    @property
    def step(self) -> int:
        """Every how many samples still hold all that passes, with a margin: the filter is dark at 1.45 cut-offs."""
        return max(1, int(self.rate_hz / (SAMPLES_PER_CUTOFF * self.cutoff_hz)))

    def apply(self, kernel: Array, signal: Array) -> Array:
        """`signal` (n,) or (n, k) through `kernel` without delay, same shape. Beyond its ends a signal goes on as its
        reflection in the end point, with the same slope: good enough to begin a simulation with, but half a kernel's
        samples at either end are not to be judged by."""
        with np.errstate(invalid="ignore"):  # of a formula that overflows
            return _convolve_valid(reflected(signal, len(kernel) // 2), kernel)


def filters(rate_hz: float, cutoff_hz: float, transition: float = TRANSITION) -> FirSet:
    """Kernels whose gain is one half at `cutoff_hz`. Raises ValueError unless that leaves room below rate / 2.

    They differentiate without a delay of their own: of a sine at 5 Hz the second derivative is -(2 pi 5)^2 of itself.

    >>> fir = filters(rate_hz=1000.0, cutoff_hz=100.0)
    >>> angle = np.sin(2 * np.pi * 5.0 * np.arange(1000) / 1000.0)
    >>> middle = slice(fir.delay, -fir.delay)
    >>> round(float((np.convolve(angle, fir.second, "valid") / angle[middle])[100] / (2 * np.pi * 5.0) ** 2), 5)
    -1.0
    """
    if not 0 < cutoff_hz <= rate_hz / 2 / (1 + transition):
        raise ValueError(f"cutoff_hz = {cutoff_hz}: expected above 0 and below {rate_hz / 2 / (1 + transition):.4g}")
    width_s = 1 / (2 * math.pi * transition * cutoff_hz)
    half = math.ceil(REACH * width_s * rate_hz)
    t = np.arange(-half, half + 1) / rate_hz
    value, first, second = _kernel(t, cutoff_hz, width_s)
    value /= value.sum()
    first /= -(t @ first)
    second -= value * second.sum()
    second /= t**2 @ second / 2
    return FirSet(rate_hz, cutoff_hz, value, first, second)


def _kernel(t: Array, cutoff_hz: float, width_s: float) -> tuple[Array, Array, Array]:
    """Windowed sinc and its first two derivatives at the instants `t`, up to a common factor."""
    w = 2 * math.pi * cutoff_hz
    x = w * t
    near = np.abs(x) < 1e-4
    safe = np.where(near, 1.0, x)
    s0 = np.where(near, 1 - x**2 / 6, np.sin(safe) / safe)
    s1 = np.where(near, -x / 3, (np.cos(safe) - np.sin(safe) / safe) / safe)
    s2 = np.where(near, -1 / 3 + x**2 / 10, -np.where(near, 1.0, np.sin(safe) / safe) - 2 * s1 / safe)
    g0 = np.exp(-(t**2) / (2 * width_s**2))
    g1 = -t / width_s**2 * g0
    g2 = (t**2 / width_s**4 - 1 / width_s**2) * g0
    return s0 * g0, w * s1 * g0 + s0 * g1, w**2 * s2 * g0 + 2 * w * s1 * g1 + s0 * g2


def reflected(signal: Array, reach: int) -> Array:
    """`signal` (n,) or (n, k) and so many samples more at either end, reflected in the end point, the slope kept."""
    if len(signal) <= reach:  # to and fro
        ends = [(reach, reach)] + [(0, 0)] * (signal.ndim - 1)
        return np.pad(signal, ends, mode="reflect", reflect_type="odd")
    before = 2.0 * signal[0] - signal[reach:0:-1]
    return np.concatenate((before, signal, 2.0 * signal[-1] - signal[-2 : -reach - 2 : -1]))


def _convolve_valid(signal: Array, kernel: Array) -> Array:
    """(n - len(kernel) + 1, ...) of the convolution along the first axis."""
    length = fft.next_fast_len(len(signal) + len(kernel) - 1, real=True)
    shape = (-1,) + (1,) * (signal.ndim - 1)
    spectrum = fft.rfft(signal, length, axis=0) * _spectrum(kernel.tobytes(), length).reshape(shape)
    full: Array = fft.irfft(spectrum, length, axis=0)
    return full[len(kernel) - 1 : len(signal)]


@lru_cache(maxsize=16)
def _beyond(rate_hz: float, cutoff_hz: float) -> Array:
    """What is left after the smoothing kernel was taken off three times."""
    rest = -filters(rate_hz, cutoff_hz).value
    rest[len(rest) // 2] += 1.0
    out: Array = np.convolve(np.convolve(rest, rest), rest)
    return out


@lru_cache(maxsize=16)
def _spectrum(kernel: bytes, length: int) -> NDArray[np.complex128]:
    """Of a kernel, padded; a bench asks for the same one a thousand times."""
    return fft.rfft(np.frombuffer(kernel), length)


SLOW = ("temperature_", "pressure_")
"""Channels that some loggers write when they change: between two values they are known, however far apart these are."""
SPARSE = 4
"""A grid has at most this many times the samples, unless pauses are cut (guess: three quarters of a recording lost)."""
GAP_STEPS = 2.5
"""A longer time between samples, in steps of the grid, is a gap: two samples are lost."""
CROSS, MEET = 0.03, 0.25
"""Steps of which some samples are apart where stamps err enough to cross each other, and below which no cubic is laid
through two then: it swings out far beside them (guesses; a robot's late ticks were 0.06 apart at the least)."""
DECIMALS_S = tuple(10.0**-n for n in range(8))
"""Units to which loggers round their stamps."""
ROUNDED_WITHIN, ROUNDED_BESIDE, LEAST_UNEVEN = 0.02, 0.1, 0.5
"""Parts of such a unit: up to which a stamp is a multiple of it, by which those of an even clock differ beside it, and
by which the steps of an uneven one differ at the least (guesses)."""
OFF_ITS_CLOCK, EVEN, ROUNDING = 0.3, 1e-3, 1e-5
"""Steps by which stamps lie off an even clock at the most for it to be theirs, up to which they are those of the grid,
and up to which they are off it by rounding alone (guesses: of a wave of four samples the second leaves a thousandth).
"""
PAUSE_S = 5.0
"""A pause that is cut leaves so much, several times the reach of any filter here."""


class UniformColumns(NamedTuple):
    """Columns on an even time base."""

    time_s: Array
    columns: dict[str, Array]
    """(n,) each, lost samples bridged by cubics, gaps by straight lines"""
    valid: Mask
    """False where a bridged gap lies"""


def interval_left_s(time_s: Array) -> float:
    """Of a logger that loses most frames, the interval in which half of its time lies: at the median one, between the
    few that came in time, all would be gaps. 0 of any other."""
    steps = np.diff(time_s)
    steps = np.sort(steps[(steps > 0) & (steps < PAUSE_S)])
    if not len(steps):
        return 0.0
    left_s = float(steps[np.searchsorted(np.cumsum(steps), steps.sum() / 2)])
    return left_s if left_s > max(GAP_STEPS * float(np.median(steps)), BRIDGE_S) else 0.0


def sampled(time_s: Array, columns: Mapping[str, Array], step_s: float) -> tuple[Array, Mapping[str, Array]]:
    """What is known of the columns at even instants, so far apart."""
    even = uniform(time_s, columns, step_s)
    return even.time_s[even.valid], {name: column[even.valid] for name, column in even.columns.items()}


def uniform(time_s: Array, columns: Mapping[str, Array], step_s: float | None = None) -> UniformColumns:
    """The columns on an even grid: along the clock that the stamps lie about, else at the median interval from the
    first on, or at what is told. NaN and gaps longer than 2.5 intervals, of the grid or of a channel that is read less
    often, and than `BRIDGE_S` are bridged and marked, and so is what lies as far before the first known value or after
    the last. Raises `KinematicsError` when time does not grow or fewer than 3 samples are left."""
    time_s = np.asarray(time_s, dtype=float)
    order = np.argsort(time_s, kind="stable")
    order = order[np.concatenate(([True], np.diff(time_s[order]) > 0))] if len(order) else order
    order = order[np.isfinite(time_s[order])]
    if len(order) < 3:
        raise KinematicsError(f"time_s: {len(order)} distinct instants: expected at least 3")
    time = unrounded(time_s[order])
    start_s, own_s = _clock(time)
    start_s, step_s = (time[0], step_s) if step_s else (start_s, own_s)
    if time[-1] - time[0] > SPARSE * step_s * len(time):
        time = _without_pauses(time, max(PAUSE_S, SPARSE * step_s))
    if time[-1] - time[0] > 20 * step_s * len(time):
        raise KinematicsError("time_s: mostly gaps: expected an even sampling rate")
    grid = start_s + step_s * np.arange(math.floor((time[-1] - start_s) / step_s + 0.5) + 1)
    out, valid = {}, np.ones(len(grid), dtype=bool)
    for name, column in columns.items():
        out[name], good = _onto(grid, time, np.asarray(column, dtype=float)[order], step_s, name.startswith(SLOW))
        valid &= good
    return UniformColumns(grid, out, valid)


def _clock(time: Array) -> tuple[float, float]:
    """First instant and interval of the even clock about which rising stamps (n,) scatter, samples lost or not; the
    first stamp and the median interval where they follow none. A grid along the clock lies near every sample, where a
    cubic loses 3 thousandths of a wave of four samples; one that slides over them loses 3 hundredths."""
    steps = np.diff(time)
    usual = float(np.median(steps))
    count = np.concatenate(([0.0], np.cumsum(np.rint(steps / usual))))
    if (np.diff(count) < 1).any():
        return float(time[0]), usual
    step_s, start_s = np.polyfit(count, time, 1)
    off = float(np.abs(time - start_s - step_s * count).max()) / step_s
    if not ROUNDING < off < OFF_ITS_CLOCK:
        return float(time[0]), usual
    return float(start_s + step_s * (start_s < time[0] - EVEN * step_s)), float(step_s)


def unrounded(time: Array) -> Array:
    """(n,) rising stamps as they most likely were before they were written with a few decimals, by the even clock whose
    they are, samples lost or not; as they are where that says nothing.

    A clock of 350 Hz written to 10 us errs by a pattern of seven samples: lines at 50 and 100 Hz, of which the second
    derivative of an angle makes more than the noise of a torque. Of what stamps are off their clock rounding is a
    twelfth of its unit squared; the rest is the clock's own jitter (Wiener's share of the two).
    """
    steps = np.diff(time)
    usual = float(np.quantile(steps, 0.5, method="lower"))  # one of them, of which some may lie on either side
    unit = next((unit for unit in DECIMALS_S if unit < usual and _is_multiple(time, unit)), 0.0)
    if not unit or np.ptp(steps) < LEAST_UNEVEN * unit:
        return time
    usual = float(np.mean(steps[np.abs(steps - usual) < 1.5 * unit]))
    count = np.concatenate(([0.0], np.cumsum(np.rint(steps / usual))))
    mean, start = np.polyfit(count, time, 1)
    count = np.rint((time - start) / mean)
    if (np.diff(count) < 1).any():
        return time
    mean, start = np.polyfit(count, time, 1)
    off = time - start - mean * count
    rounded = np.ptp(off) <= (1.0 + ROUNDED_BESIDE) * unit
    own = 0.0 if rounded else max(0.0, 1.0 - unit**2 / 12 / float(np.var(off)))
    return np.asarray(time - (1.0 - own) * off)


def _is_multiple(time: Array, unit: float) -> bool:
    counts = time / unit
    return bool(np.abs(counts - np.rint(counts)).max() < ROUNDED_WITHIN)


def _without_pauses(time: Array, longest_s: float) -> Array:
    """(n,) the stamps with every longer pause cut to this: a clock that was set, or a night between two tests, must not
    ask for memory."""
    steps = np.diff(time, prepend=time[0])
    return np.asarray(time[0] + np.cumsum(np.minimum(steps, longest_s)))


def _onto(grid: Array, time: Array, column: Array, step_s: float, slow: bool) -> tuple[Array, Mask]:
    finite = np.isfinite(column)
    if finite.sum() < 3:
        return np.full(len(grid), math.nan), np.ones(len(grid), dtype=bool)
    known = time[finite]
    if len(known) == len(grid) and np.allclose(known, grid, rtol=0, atol=EVEN * step_s):
        return column[finite], np.ones(len(grid), dtype=bool)
    following = np.clip(np.searchsorted(known, grid), 1, len(known) - 1)
    longest_s = max(GAP_STEPS * max(step_s, float(np.median(np.diff(known)))), BRIDGE_S)
    bridged = (known[following] - known[following - 1] > longest_s) & (not slow)
    bridged |= (grid < known[0] - longest_s) | (grid > known[-1] + longest_s)
    on_sample = np.minimum(np.abs(known[following] - grid), np.abs(grid - known[following - 1])) < 0.5 * step_s
    return _cubic(grid, known, column[finite], following), ~bridged | on_sample


def _cubic(grid: Array, known: Array, column: Array, following: NDArray[np.intp]) -> Array:
    """(n,) cubic through the two samples on either side (Lagrange); straight where gaps or ends leave fewer, or two of
    them nearly meet.

    A straight bridge over one lost sample at 1 kHz errs by more than the twist of a stiff gear.
    """
    straight: Array = np.interp(grid, known, column)
    first = np.clip(following - 2, 0, max(len(known) - 4, 0))
    if len(known) < 4:
        return straight
    at = known[first[:, None] + np.arange(4)]
    weights = np.ones_like(at)
    for i in range(4):
        for j in range(4):
            if j != i:
                weights[:, i] *= (grid - at[:, j]) / (at[:, i] - at[:, j])
    smooth = (weights * column[first[:, None] + np.arange(4)]).sum(axis=1)
    step = float(np.median(np.diff(known)))
    dense = at[:, 3] - at[:, 0] < max(8 * step, 2.5 * BRIDGE_S)
    if np.diff(known).min() < CROSS * step:
        dense &= np.diff(at, axis=1).min(axis=1) > MEET * step
    inside = (grid >= at[:, 1]) & (grid <= at[:, 2])
    return np.where(dense & inside, smooth, straight)


class Kinematics(NamedTuple):
    """What `motion_of` gives."""

    motion: Motion
    valid: Mask
    """(n,) False near the ends and around gaps, within the filter's reach"""


def motion_of(
    even: UniformColumns,
    ratio: float,
    inertia_kg_m2: float,
    cutoff_hz: float,
    *,
    drive: bool = False,
) -> Kinematics:
    """The motion in a recording, all of it through one linear-phase filter at `cutoff_hz`.

    Columns are named as in `channels.CHANNELS`. The torque is `torque_out_Nm`, or inertia times acceleration where
    that is absent; with `drive` it is `torque_in_Nm`, or `current_in_A` in ampere. Raises `KinematicsError`.
    """
    if "theta_out_rad" not in even.columns:
        raise KinematicsError("theta_out_rad: missing: expected the output angle")
    if not drive and "theta_in_rad" not in even.columns:
        raise KinematicsError('theta_in_rad: missing: expected the motor angle (or balance = "drive")')
    rate = (len(even.time_s) - 1) / (even.time_s[-1] - even.time_s[0])
    fir = filters(rate, cutoff_hz)
    if len(even.time_s) <= 2 * fir.delay + 1:
        raise KinematicsError(f"{len(even.time_s)} samples: expected more than {2 * fir.delay + 1} for this cut-off")
    valid = spread_invalid(even.valid, fir.delay)
    return Kinematics(_motion(even, fir, ratio, inertia_kg_m2, drive), valid)


def spread_invalid(valid: Mask, reach: int) -> Mask:
    """`valid` with every gap, and both ends, widened by the filter's reach in samples."""
    bad = np.concatenate((np.ones(reach), ~valid, np.ones(reach)))
    running = np.concatenate(([0.0], np.cumsum(bad)))
    inside: Mask = running[2 * reach + 1 :] - running[: len(valid)] < 0.5
    return inside


def _motion(even: UniformColumns, fir: FirSet, ratio: float, inertia: float, drive: bool) -> Motion:
    smooth = {name: fir.apply(fir.value, column) for name, column in even.columns.items()}
    out = even.columns["theta_out_rad"]
    motor = even.columns.get("theta_in_rad")
    twist = np.full(len(out), math.nan) if motor is None else motor / ratio - out
    acceleration = fir.apply(fir.second, out)
    known = MOTOR_TORQUES if drive else ("torque_out_Nm",)
    torque = next((smooth[name] for name in known if name in smooth), inertia * acceleration)
    return Motion(
        rate_hz=fir.rate_hz,
        ratio=ratio,
        time_s=even.time_s,
        theta_in_rad=ratio * smooth["theta_out_rad"] if motor is None else smooth["theta_in_rad"],
        theta_out_rad=smooth["theta_out_rad"],
        twist_rad=fir.apply(fir.value, twist),
        twist_rate_rad_s=fir.apply(fir.first, twist),
        velocity_out_rad_s=fir.apply(fir.first, out),
        acceleration_out_rad_s2=acceleration,
        torque_Nm=torque,
        temperature_degC=smooth.get("temperature_degC", np.full(len(out), math.nan)),
        extra={name: column for name, column in smooth.items() if name not in ("theta_in_rad", "theta_out_rad")},
        driven_rad_s=None if motor is None else fir.apply(fir.first, motor) / ratio,
        driven_rad_s2=None if motor is None else fir.apply(fir.second, motor) / ratio,
    )
