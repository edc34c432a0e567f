"""The white noise of encoders and of a torque, from the recording itself: where motion does not reach, between samples
that rest, and of an encoder's step. Wild samples are taken out before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from edge_daemon.channels import MOTOR_TORQUES
from edge_daemon.motion.kinematics import uniform
from edge_daemon.records import Array, Mask

ANGLES, SPEED = ("theta_in_rad", "theta_out_rad"), "velocity_out_rad_s"
SPIKE = 20.0
"""A sample whose deviation from its neighbours' mean is so many times the 90 % quantile is no motion (guess: impacts in
a worn gear stay below ten)."""
MANY_STEPS = 8.0
"""Of an encoder, between two samples, from which on a third that is the same was not read (guess)."""
MOST_AGAIN = 0.1
"""Of the samples that are so far apart, from which on an encoder is coarse, or read more often than it tells (guess).
"""
QUIET_QUANTILE = 0.1
"""A torque's noise is this quantile of the powers in the quiet band, for a torque may well hold tones there."""
LEAST_WHOLE = 4000
"""A noise spectrum needs so many samples without a hole: fewer let the motion leak into the quiet band."""
REST_SD, LEAST_RESTING = 4.0, 60
"""Change of an angle over six samples, in its noise, that is rest, and how many of those tell a torque's noise: in
motion a gear is loud, and its noise is no sensor's."""
LEAST_RESTS = 0.5
"""Share of the samples that equal the one before from which on a channel's step is coarse: below it what is rounded off
changes from sample to sample, and the spectrum shows it as noise."""
UNEVEN = 0.005
"""Stamps count as uneven from this scatter of the sampling interval over itself."""
QUIET_BAND = (0.36, 0.48)
"""In this band over the sampling rate encoders hold nothing but noise."""
TORQUE_BAND = (0.12, 0.48)
"""The same for the torque of a drive, whose amplifier is often louder near half the sampling rate than where a balance
listens."""
ALIKE = 0.8
"""Noise of a twist over that of both encoders below which these have a part of theirs alike (guess: apart 0.98 to 1.02
were seen, a robot's log had 0.05)."""
SPEEDS, LEAST_OF_A_SPEED = 12, 40
"""The noise of an angle is looked at for so many speeds, each of so many samples (guesses)."""
STILL = 1e-3
"""Power of the noise at one speed over that at all below which it is a step that was not left (guess)."""
WINDOW, LEAST_WINDOWS = 128, 20
"""Samples of a window that parts the quiet band from motion, and how many tell a noise to a few per cent."""
SEED = 3
"""The noise of one unit is always the same."""


@dataclass(frozen=True, slots=True)
class NoiseOfSensors:
    """White noise per sample, sd at each sensor itself; 0 of one that is not there."""

    theta_in_rad: float
    theta_out_rad: float
    torque: float
    """of a measured torque [N m] or current [A]"""
    velocity: float
    """of a measured speed of the output [rad/s]"""
    shaken: float = 1.0
    """by how much more both angles seem to have: a stamp that errs moves them together, and no twist with them"""


def noise_of_sensors(
    time_s: Array, columns: Mapping[str, Array], ratio: float, drive: bool, by_motor: bool = False
) -> NoiseOfSensors:
    """Noise of encoders and torque, of two encoders without what both have alike; of a drive's only encoder at least
    its rounding. `by_motor`: the output torque is reckoned from the motor's, and leaps where its friction turns round.
    """
    into, out = (angle_noise(time_s, columns.get(name)) for name in ANGLES)
    velocity = sensor_noise(time_s, columns.get(SPEED))
    out = max(out, rounding(columns["theta_out_rad"])) if drive else out
    shaken, both = 1.0, math.hypot(into / ratio, out)
    if not drive and {"theta_in_rad", "theta_out_rad"} <= columns.keys():
        twist = angle_noise(time_s, columns["theta_in_rad"] / ratio - columns["theta_out_rad"])
        shaken = both / twist if 0 < twist < ALIKE * both else 1.0
    torque = next((columns[name] for name in _torques(drive) if name in columns), None)
    torque_noise = _of_torque(time_s, torque, columns["theta_out_rad"] if drive or by_motor else None, out)
    return NoiseOfSensors(into / shaken, out / shaken, torque_noise, velocity, shaken)


def _of_torque(time_s: Array, torque: Array | None, angle: Array | None, angle_noise: float) -> float:
    """Sd of the measured torque's noise: the least of what its quiet band and its changes say, and of a motor's, beside
    which the angle is given, its rests."""
    noise = sensor_noise(time_s, torque, QUIET_QUANTILE, QUIET_BAND if angle is None else TORQUE_BAND)
    if torque is None:
        return noise
    steady = [_noise_of_differences(time_s, torque)]  # friction that turns round is in any band, but at few samples
    if angle is not None:
        resting = np.abs(angle - np.roll(angle, 6)) <= REST_SD * angle_noise
        steady.append(_noise_of_differences(time_s, torque, resting[6:]))
    return max(min([noise, *(other for other in steady if other)]), rounding(torque))


def _torques(drive: bool) -> tuple[str, ...]:
    return MOTOR_TORQUES if drive else ("torque_out_Nm",)


def without_spikes(angle: Array) -> Array:
    """(n,) the angle with single wild samples replaced by NaN: transmission errors, that no joint could follow, and
    what was read a second time while it moves on, or one late after that."""
    if len(angle) < 5:
        return angle
    middle = np.where(_read_again(angle), math.nan, angle)
    off = np.zeros(len(middle))
    off[1:-1] = np.abs(middle[1:-1] - (middle[:-2] + middle[2:]) / 2)
    usual = float(np.nanquantile(off, 0.9))
    peak = off >= np.maximum(np.roll(off, 1), np.roll(off, -1))
    return np.where(peak & (off > SPIKE * usual) & (usual > 0), math.nan, middle)


def _read_again(angle: Array) -> Mask:
    """(n,) samples that are the one before to the last bit, between steps that are many of the encoder's, and the next
    where that is one late as well: nearer to where a straight line across both was then than to where it is."""
    again, step = np.zeros(len(angle), dtype=bool), np.diff(angle)
    size = np.abs(step)
    moved = np.flatnonzero(size > 0)
    least = MANY_STEPS * float(size[moved].min(initial=math.inf))
    for start, end in zip(moved[:-1].tolist(), moved[1:].tolist(), strict=True):
        if end - start > 1 and min(size[start], size[end]) > least and step[start] * step[end] > 0:
            again[start + 2 : end + 1] = True
            if end + 2 < len(angle):
                again[end + 1] = abs(step[end]) < 0.5 * abs(angle[end + 2] - angle[end])
    rare = np.count_nonzero(again) < MOST_AGAIN * np.count_nonzero(size > least)
    return again if rare else np.zeros(len(angle), dtype=bool)


def without_glitches(torque: Array) -> Array:
    """(n,) a torque with samples replaced by NaN that lie far off both neighbours, to the same side, while these agree:
    what a converter or a bus makes of it, and no step of friction."""
    kept = np.array(torque, dtype=float)
    place = np.flatnonzero(np.isfinite(kept))
    known = kept[place]
    if len(known) < 5:
        return kept
    before, after = known[1:-1] - known[:-2], known[1:-1] - known[2:]
    off = np.where(before * after > 0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    usual = float(np.quantile(np.abs(before + after), 0.9)) / 2
    wild = (off > SPIKE * usual) & (usual > 0) & (np.abs(known[2:] - known[:-2]) < 0.5 * off)
    kept[place[1:-1][wild]] = math.nan
    return kept


def sensor_noise(
    time_s: Array, angle: Array | None, quantile: float = 0.5, band: tuple[float, float] = QUIET_BAND
) -> float:
    """sd of the white noise of a channel, from the band that motion does not reach; 0 if not measured.

    Between uneven stamps the motion itself jumps like noise: there it is that of the values at even instants, over what
    the same interpolation leaves of noise of one unit.
    """
    if angle is None:
        return 0.0
    if not uneven(time_s):
        return _noise_of(time_s, angle, quantile, band)
    even_s, *rows = _beside_unit_noise(time_s, angle)
    seen, left = (_noise_of(even_s, row, quantile, band) for row in rows)
    return seen / left if left else 0.0


def angle_noise(time_s: Array, angle: Array | None) -> float:
    """The same of an angle, as the mean of all speeds: an instant that errs, told by its stamp or not, moves a fast
    joint far and a slow one hardly, and one stretch tells little of another. A coarse one leaps, which is no noise of
    its own."""
    if angle is None or rounding(angle):
        return sensor_noise(time_s, angle)
    if uneven(time_s):
        return _noise_of_windows(*_beside_unit_noise(time_s, angle)[1:]) or sensor_noise(time_s, angle)
    whole = _whole_enough(time_s, angle) is not None
    return max(sensor_noise(time_s, angle), 0.0 if whole else _noise_of_speeds(time_s, angle))


def _beside_unit_noise(time_s: Array, channel: Array) -> tuple[Array, Array, Array]:
    """Even instants, a channel at these, and noise of one unit as the same interpolation leaves it; NaN in gaps."""
    unit = np.where(np.isfinite(channel), np.random.default_rng(SEED).normal(size=len(channel)), math.nan)
    even = uniform(time_s, {"channel": np.asarray(channel, dtype=float), "unit": unit})
    seen, left = (np.where(even.valid, even.columns[name], math.nan) for name in ("channel", "unit"))
    return even.time_s, seen, left


def _noise_of_windows(angle: Array, unit: Array) -> float:
    """sd of an angle's noise in the quiet band, on average over all windows without a gap (Welch 1967, IEEE Trans. AU
    15(2)), over what noise of one unit has there; 0 where there are too few of them."""
    rows = [_windows(np.diff(column, 6)) for column in (angle, unit)]
    known = np.isfinite(rows[0]).all(axis=1) & np.isfinite(rows[1]).all(axis=1)
    if np.count_nonzero(known) < LEAST_WINDOWS:
        return 0.0
    band = np.arange(*(math.ceil(share * WINDOW) for share in QUIET_BAND))
    gain = (2 * np.sin(math.pi * band / WINDOW)) ** 6
    spectra = (np.abs(np.fft.rfft(row[known] * np.blackman(WINDOW), axis=1)[:, band]) / gain for row in rows)
    seen, left = (float(np.median(np.mean(row**2, axis=0))) for row in spectra)
    return math.sqrt(seen / left)


def _windows(column: Array) -> Array:
    """(w, n) windows of a column, each half over the next."""
    return np.lib.stride_tricks.sliding_window_view(column, WINDOW)[:: WINDOW // 2]


def rounding(column: Array) -> float:
    """sd of what a coarse step rounds off, which no spectrum shows where a channel rests in one step for long; 0 of a
    fine one."""
    steps = np.abs(np.diff(column))
    moved = steps[steps > 0]
    coarse = 0 < len(moved) < (1 - LEAST_RESTS) * len(steps)
    return float(moved.min()) / math.sqrt(12) if coarse else 0.0


def uneven(time_s: Array) -> bool:
    """Whether samples came at uneven instants, lost ones and gaps aside."""
    steps = np.diff(time_s)
    usual = float(np.median(steps))
    single = steps[(steps > 0.5 * usual) & (steps < 1.5 * usual)]
    return len(single) > 0 and float(single.std()) > UNEVEN * usual


def _noise_of(time_s: Array, angle: Array, quantile: float, among: tuple[float, float] = QUIET_BAND) -> float:
    """Powers of white noise are exponentially distributed: any quantile of them gives the mean."""
    whole = _whole_enough(time_s, angle)
    if whole is None:
        return _noise_of_differences(time_s, angle)
    angle = whole
    window = np.blackman(len(angle))
    power = np.abs(np.fft.rfft((angle - angle.mean()) * window)) ** 2 / (window @ window)
    low, high = (int(share * len(angle)) for share in among)
    return math.sqrt(float(np.quantile(power[low:high], quantile)) / -math.log1p(-quantile))


def _whole_enough(time_s: Array, angle: Array) -> Array | None:
    """The longest run without missing values, spikes or gaps; None where it is too short for a spectrum."""
    step_s = float(np.median(np.diff(time_s)))
    broken = ~np.isfinite(angle) | (np.diff(time_s, prepend=time_s[0] - step_s) > 1.5 * step_s)
    edges = np.concatenate(([0], np.flatnonzero(broken), [len(angle)]))
    longest = int(np.argmax(np.diff(edges)))
    run: Array = np.asarray(angle[edges[longest] + (longest > 0) : edges[longest + 1]], dtype=float)
    return run if len(run) >= min(LEAST_WHOLE, len(angle) // 2) else None


def _noise_of_differences(time_s: Array, angle: Array, among: Mask | None = None) -> float:
    """sd of white noise from sixth differences, where no run is long enough for a spectrum: they take out all that
    moves more slowly than a twentieth of the sampling rate."""
    sixth, even = _sixth_differences(time_s, angle)
    if among is None:
        return _usual(sixth[even])
    sixth = sixth[even & among]
    return _usual(sixth) if len(sixth) >= LEAST_RESTING else 0.0


def _noise_of_speeds(time_s: Array, angle: Array) -> float:
    """The same of an angle whose noise may grow with its speed, on average over all samples; 0 where these are too few.
    The most usual of each speed tells it: where a joint speeds up, its motion reaches into the differences."""
    sixth, even = _sixth_differences(time_s, angle)
    pace = (angle[6:] - angle[:-6])[even] ** 2
    if len(pace) < SPEEDS * LEAST_OF_A_SPEED:
        return 0.0
    groups = np.array_split(np.argsort(pace), SPEEDS)
    power = np.array([_usual(sixth[even][rows]) for rows in groups]) ** 2
    resting, growing = power_by_speed(power, np.array([np.median(pace[rows]) for rows in groups]))
    return math.sqrt(resting + growing * float(np.mean(pace)))


def power_by_speed(power: Array, square: Array) -> tuple[float, float]:
    """Power of a noise that does not know the speed, and of one that grows with its square, over that, from the power
    (n,) at so many squares (n,); each errs by a share of its own."""
    known, unit = np.maximum(power, max(STILL * float(power.mean()), 1e-300)), float(square.mean()) or 1.0
    columns = np.stack((np.ones(len(power)), square / unit), axis=1)
    resting, growing = np.linalg.lstsq(columns / known[:, None], power / known, rcond=None)[0].clip(0.0)
    return float(resting), float(growing) / unit


def _sixth_differences(time_s: Array, angle: Array) -> tuple[Array, Mask]:
    """(n - 6,) sixth differences, and which of them are known and reach over no gap."""
    step_s = float(np.median(np.diff(time_s)))
    even = np.ptp(np.lib.stride_tricks.sliding_window_view(time_s, 7)[:, [0, 6]], axis=1) < 6.5 * step_s
    sixth = np.diff(angle, 6)
    return sixth, even & np.isfinite(sixth)


def _usual(sixth: Array) -> float:
    """sd of the noise in sixth differences, whose squared coefficients sum to 924, from their median; 0 of none."""
    return float(np.median(np.abs(sixth))) / 0.6745 / math.sqrt(924) if len(sixth) else 0.0
