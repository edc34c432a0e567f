"""The noise of a motor's torque where a balance listens: what stays the same all along the recording.

A current is averaged and filtered before it is logged, so that its noise near half the sampling rate tells little of
that below. Motion, reversals and ripple come and go while noise is stationary: in short windows the powers of noise are
exponentially distributed at each frequency, and two quantiles of them over the windows agree on their mean (spectral
kurtosis; Antoni 2006, Mech. Syst. Signal Process. 20(2)). Where they do not, something else is heard.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial import KDTree

from edge_daemon.balance.drive_columns import drive_columns
from edge_daemon.motion.kinematics import FirSet
from edge_daemon.records import Array, Mask, Motion

WINDOW_S, LEAST_SAMPLES, LEAST_WINDOWS = 0.32, 24, 40
"""Length of a window: short beside the motion, long enough to part 3 Hz; in samples at the least; and how many of them
tell two quantiles to a fifth."""
DEGREE = 3
"""Degree of the polynomial that is taken out of each window: the motion's own torque."""
LOW, HIGH = 0.2, 0.8
"""The quantiles."""
LEAST_RATIO, MOST_RATIO = 0.6, 1.7
"""Mean power by the higher quantile over that by the lower one in noise: below it a tone is heard, above it what comes
and goes (on simulated joints the noise was 0.5 to 1.3 of the true one, and 0.04 to 2 where the quiet band alone told).
"""
LOWEST_HZ = 8.0
"""Below it a window holds the motion itself."""
NEIGHBOURS = 2
"""Frequencies on either side over which that ratio is averaged."""
LEAST_TOLD, TOP_THIRD = 0.5, 1 / 3
"""Of the frequencies at least a third must be of noise alone, and of the highest third this share: what seems so
among lower ones only is ripple that never ceases (so it was on a real joint)."""
LEAST_ALONE = 0.1
"""Share of a frequency's power that must not go with the motion for it to be told: what a window cuts off of a motion
leaves a hundredth (guess)."""
SLOW, MOVING = 1.5, 0.1
"""Windows from one reversal to the next on average, below which motion does not come and go but sounds in each of them;
a reversal goes from this share of the rms speed to as much the other way."""
APART_S, NEAREST, MOST_PAIRS, LEAST_PAIRS = 0.5, 60, 4000, 200
"""Instants so far apart share no noise of a filter; neighbours among which such a one is looked for; instants that are
tried at most, and pairs that tell a mean square to a tenth."""
LEAST_UNLIKE = 0.93
"""Mean square that differs at like motion, over that of the same residual set against the motion anew, from which on it
is noise: 0.94 to 1.07 of what exact models left on simulated joints, 0.04 to 0.92 where a law was missing."""
MOST_UNEVEN, PARTS = 2.5, 6
"""Noise is as loud all along: its mean square in the loudest part of a recording over that in the quietest at the most,
and in how many parts (1.1 to 2.0 of exact models; what a law left of a sweep, 8 and 37)."""
MOST_LOUD = 2.0
"""The same along speed and acceleration, over the mean of all (1.7 at the most of exact models, which lose some beside
reversals; 2.6 of a ripple by the load)."""
DRIVEN = ("velocity_out_rad_s", "acceleration_out_rad_s2")
TWISTED = ("twist_rad", "twist_rate_rad_s", "velocity_out_rad_s")
"""What tells the motion of a drive, and of a gear, beside the output's angle."""
OF_JOINT = frozenset(
    [
        "theta_in_rad",
        "theta_out_rad",
        "velocity_in_rad_s",
        "velocity_out_rad_s",
        "torque_in_Nm",
        "torque_out_Nm",
        "torque_model_Nm",
        "current_in_A",
        "temperature_degC",
        "profile_phase",
    ]
)
"""Channels that tell the motion and its torques, which noise is held against otherwise."""
PLACES, ROLLS = 24, 12
"""Places along an axis where a residual is averaged, and how often it is set against the axis anew: noise of hundreds
of independent samples leaves few per cent, low-passed noise of few up to a tenth."""
LINE, LINE_BESIDE = 25.0, 101
"""A line has this many times the mean power of so many frequencies about it: in noise one in ten million does."""
TOP_SHARE = 0.49
"""Highest frequency over the sampling rate."""
TRANSFORM = 4096
"""Samples over which the gain of a filter is laid out."""


class NoiseSpectrum(NamedTuple):
    """Power of one sample's noise by frequency, as white noise of that power would have it at all of them."""

    frequency_hz: Array
    power: Array

    def through(self, fir: FirSet) -> float:
        """Mean square behind a filter."""
        frequency = np.fft.rfftfreq(TRANSFORM, 1 / fir.rate_hz)
        gain = np.abs(np.fft.rfft(fir.value, TRANSFORM)) ** 2
        return float(np.mean(np.interp(frequency, self.frequency_hz, self.power) * gain))


def torque_noise(motion: Motion, known: Mask, fir: FirSet, accelerated: float) -> float:
    """Mean square that noise of the torque leaves behind a filter: the least of what the torque says and what a first
    look at the drive leaves of it, whose ripple is gone but whose laws may be wrong; 0 where neither says anything.
    Tones that never cease sound like noise, so it is no more than the motion itself leaves open. Of the encoder's noise
    inertia times acceleration leaves the mean square `accelerated` there, which is heard in all that a look leaves."""
    if not _comes_and_goes(motion, known):
        return 0.0
    torque, columns = np.nan_to_num(motion.torque_Nm), np.nan_to_num(drive_columns(motion))
    behind = fir.apply(fir.value, np.column_stack((columns, torque)))[known]
    size = np.sqrt(np.mean(behind[:, :-1] ** 2, axis=0)) + 1e-300
    found = np.linalg.lstsq(behind[:, :-1] / size, behind[:, -1], rcond=1e-8)[0] / size
    moved = (motion.acceleration_out_rad_s2, np.sign(motion.velocity_out_rad_s))
    signals = ((motion.rate_hz, y, known) for y in (torque, torque - columns @ found))
    raw, rest = (stationary_noise(*signal, moved) or stationary_noise(*signal) for signal in signals)
    heard = [raw.through(fir)] if raw else []
    heard += [rest.through(fir) - accelerated] if rest else []
    left = behind[:, -1] - behind[:, :-1] @ found
    return max(min(*heard, unlike_at_like_motion(motion, known, left) - accelerated), 0.0) if heard else 0.0


def _comes_and_goes(motion: Motion, known: Mask) -> bool:
    """Whether the motion lasts over windows; of one that does not, all torque would be heard as noise."""
    speed = motion.velocity_out_rad_s[known]
    signs = np.sign(speed[np.abs(speed) > MOVING * np.sqrt(np.mean(speed**2))])
    return float(np.count_nonzero(np.diff(signs))) * SLOW * WINDOW_S * motion.rate_hz < len(speed)


def is_noise(motion: Motion, known: Mask | NDArray[np.intp], left: Array, courses: Sequence[str] = DRIVEN) -> bool:
    """Whether what a model leaves is noise, of whatever colour: it is as loud all along, holds no tone, is no curve of
    the motion, and differs between instants of the same motion as between any others. `courses` tell the motion beside
    the output's angle: of a drive, or of a gear."""
    parts = [float(np.mean(part**2)) for part in np.array_split(left, PARTS)]
    if max(parts) > MOST_UNEVEN * min(parts) or _in_lines(motion.time_s[known], left) > 1 - LEAST_UNLIKE:
        return False
    axes = [motion.theta_out_rad, *(getattr(motion, name) for name in courses)]
    if any(_in_a_curve(axis[known], left) > 1 - LEAST_UNLIKE for axis in (*axes, *_beside(motion))):
        return False
    way = np.sign(motion.velocity_out_rad_s[known])
    if _comes_by_itself(left, way) > 1 - LEAST_UNLIKE:
        return False
    if any(_in_a_curve(axis[known], left * way) > 1 - LEAST_UNLIKE for axis in _beside(motion)):
        return False
    if any(_loudest(np.abs(axis[known]), left) > MOST_LOUD for axis in axes[1:]):
        return False
    own, other = _alike(motion, known, courses)
    if len(own) < LEAST_PAIRS:
        return False
    unlike = [float(np.mean((row[own] - row[other]) ** 2)) for row in _moved(left)]
    return unlike[0] > LEAST_UNLIKE * float(np.median(unlike[1:]))


def _comes_by_itself(left: Array, way: Array) -> float:
    """Share of the power in a friction that comes and goes by the clock, beyond what chance puts there: what the same
    residual has against the way (m,) of other instants."""
    place = np.arange(len(left)) * PLACES // len(left)
    count = np.bincount(place, minlength=PLACES)
    rows = (left * other for other in _moved(way))
    shares = [float(np.sum(np.bincount(place, row, PLACES) ** 2 / count) / (left @ left)) for row in rows]
    return shares[0] - float(np.median(shares[1:]))


def _beside(motion: Motion) -> list[Array]:
    """(n,) what sensors beside the joint tell."""
    told = [column for name, column in motion.extra.items() if name not in OF_JOINT]
    return [column for column in (motion.temperature_degC, *told) if np.isfinite(column).all() and np.ptp(column) > 0]


def _loudest(axis: Array, left: Array) -> float:
    """Mean square in the loudest part of an axis over that of all: a ripple that the load makes grows along one."""
    power = float(np.mean(left**2))
    return max(float(np.mean(part**2)) for part in np.array_split(left[np.argsort(axis)], PARTS)) / power


def _in_a_curve(axis: Array, left: Array) -> float:
    """Share of the power in the mean at each place of one axis, beyond what chance puts there: what the same residual
    has at other instants. Motion may never come back to the same place of all axes."""
    place = np.searchsorted(np.quantile(axis, np.linspace(0, 1, PLACES + 1)[1:-1]), axis)
    count = np.maximum(np.bincount(place, minlength=PLACES), 1)
    shares = [float(np.sum(np.bincount(place, row, PLACES) ** 2 / count) / (left @ left)) for row in _moved(left)]
    return shares[0] - float(np.median(shares[1:]))


def _moved(left: Array) -> list[Array]:
    """A residual (m,) as it is, and then beside the motion of other instants."""
    return [np.roll(left, len(left) * k // ROLLS) for k in range(ROLLS)]


def _in_lines(time_s: Array, left: Array) -> float:
    """Share of the power in lines of the spectrum: what comes from outside follows the clock, and no motion."""
    step_s = float(np.min(np.diff(time_s)))
    even = np.zeros(round((time_s[-1] - time_s[0]) / step_s) + 1)
    even[np.round((time_s - time_s[0]) / step_s).astype(int)] = left
    power = np.abs(np.fft.rfft(even)) ** 2
    usual = median_filter(power, LINE_BESIDE, mode="nearest") / math.log(2)
    return float(power[power > LINE * usual].sum() / power.sum())


def unlike_at_like_motion(motion: Motion, known: Mask, left: Array) -> float:
    """Mean square of what differs between instants of the same motion at different times (Rice 1984, Ann. Stat. 12(4)):
    what follows the motion by any law is the same in both. `left` (m,) is of the rows that are `known`; infinite where
    too few of them are alike."""
    own, other = _alike(motion, known)
    return float(np.mean((left[own] - left[other]) ** 2)) / 2 if len(own) >= LEAST_PAIRS else math.inf


def _alike(
    motion: Motion, known: Mask | NDArray[np.intp], courses: Sequence[str] = DRIVEN
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(k,) rows of those that are known, and of the same motion at another time to each."""
    angle = motion.theta_out_rad
    rows = (np.sin(angle), np.cos(angle), *(getattr(motion, name) for name in courses))
    place = np.stack([row[known] / (np.std(row[known]) + 1e-300) for row in rows], axis=1)
    every = max(1, len(place) // MOST_PAIRS)
    near = np.asarray(KDTree(place).query(place[::every], k=min(NEAREST, len(place)))[1])
    time_s, forward = motion.time_s[known], motion.velocity_out_rad_s[known] > 0
    alike = (np.abs(time_s[near] - time_s[::every, None]) > APART_S) & (forward[near] == forward[::every, None])
    own, other = np.nonzero(alike & (np.cumsum(alike, axis=1) == 1))
    return own * every, near[own, other]


def stationary_noise(rate_hz: float, torque: Array, known: Mask, moved: Sequence[Array] = ()) -> NoiseSpectrum | None:
    """The noise of a torque (n,) on an even time base, of windows that are `known` (n,) throughout, where little of it
    goes with what is `moved` (n,); None where they are too few, or nothing in them stays the same."""
    size = max(LEAST_SAMPLES, round(WINDOW_S * rate_hz))
    if len(torque) < size:
        return None
    whole = np.lib.stride_tricks.sliding_window_view(known, size)[:: size // 2].all(axis=1)
    if np.count_nonzero(whole) < LEAST_WINDOWS:
        return None
    heard, *moving = (_heard(signal, size)[whole] for signal in (torque, *moved))
    power = np.abs(heard) ** 2
    own = np.sum(np.abs(_alone(heard, *moving)) ** 2, axis=0) > LEAST_ALONE * np.sum(power, axis=0)
    low, high = (np.quantile(power, q, axis=0) / -math.log1p(-q) for q in (LOW, HIGH))
    ratio = high / np.maximum(low, 1e-300)
    width = 2 * NEIGHBOURS + 1
    ratio = np.convolve(np.pad(ratio, NEIGHBOURS, "edge"), np.full(width, 1 / width), "valid")
    frequency = np.fft.rfftfreq(size, 1 / rate_hz)
    listened = (frequency >= LOWEST_HZ) & (frequency < TOP_SHARE * rate_hz)
    told = listened & own & (ratio > LEAST_RATIO) & (ratio < MOST_RATIO)
    top = listened & (frequency > (1 - TOP_THIRD) * TOP_SHARE * rate_hz)
    sure = told[top].sum() >= LEAST_TOLD * top.sum() and told.sum() >= TOP_THIRD * listened.sum()
    return NoiseSpectrum(np.asarray(frequency[told], dtype=float), low[told]) if sure and told.any() else None


def _heard(signal: Array, size: int) -> NDArray[np.complex128]:
    """(w, f) spectra of a signal (n,) in windows of a size, less its slow course; white noise has its power in each."""
    windows = np.lib.stride_tricks.sliding_window_view(signal, size)[:: size // 2]
    slow = np.linalg.qr(np.vander(np.linspace(-1, 1, size), DEGREE + 1))[0]
    taper = np.hanning(size)
    return np.fft.rfft((windows - (windows @ slow) @ slow.T) * taper, axis=1) / math.sqrt(float(taper @ taper))


def _alone(torque: NDArray[np.complex128], *moved: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """(w, f) spectra of a torque less what goes with others (w, f) over the windows: what a linear gear of any order
    makes of the motion is no noise (coherent output power; Bendat & Piersol 2010, Random Data, 7.1)."""
    beside = list(moved)
    while beside:
        own, *beside = beside
        torque, *beside = (row - own * _share(own, row) for row in (torque, *beside))
    return torque


def _share(own: NDArray[np.complex128], row: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """(f,) what of one spectrum (w, f) goes with another at each frequency."""
    return np.asarray(np.sum(own.conj() * row, axis=0) / np.maximum(np.sum(np.abs(own) ** 2, axis=0), 1e-300))
