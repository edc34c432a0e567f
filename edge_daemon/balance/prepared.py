"""A recording made ready for regression: motion, and both sides of the balance through one filter.

The arguments of the effects are filtered lightly (twice the torsional resonance and more), the columns that come of
them and the torque then share the balance filter. What passes is decimated to a rate at which samples still count.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.one_encoder import (
    UNSURE_SD,
    measured_velocity,
    odd_stretch,
    rough_fit,
    unit_noise,
    usual_speed,
    whitening,
)
from edge_daemon.balance.one_encoder import (
    argument_hz as argument_cutoff_hz,
)
from edge_daemon.balance.quiet_input import quiet_input
from edge_daemon.balance.reversals import UnknownDirections, unknown_directions, without_unknown
from edge_daemon.balance.torque_noise import torque_noise as heard_noise
from edge_daemon.effects.model import Model
from edge_daemon.effects.torque_source import MOTOR, torque_source, with_motor_torque
from edge_daemon.motion.kinematics import FirSet, KinematicsError, filters, motion_of, spread_invalid, uniform
from edge_daemon.records import Array, Mask, Motion

BALANCE_HZ = 100.0
"""Both sides of the balance are cut off here, where the sampling rate allows."""
ARGUMENT_HZ = 280.0
"""The effects' arguments are cut off here: above twice the torsional resonances met (60 to 130 Hz)."""
BALANCE_SHARE = 0.16
"""The balance's cut-off is at most this share of the sampling rate."""
ARGUMENT_SHARE = 0.34
"""The arguments' cut-off is at most this share of the sampling rate: the filter's edge must end below one half."""
DRIVE_SHARE = 0.4
"""A drive balance is cut off at this share of the sampling rate: its ripple reaches high and it needs no second
derivative twice."""
SAMPLES_PER_CUTOFF = 3.2
"""Decimated rate over the balance cut-off: the filter is dark at 1.45 cut-offs."""
BLOCK_S = 1.25
"""A block of the hold-out is longer than any memory of the residual."""
GUARD_S = 0.1
"""So much is left out between blocks, so that the filter carries nothing from one to the next."""
STANDSTILL_SHARE = 0.03
"""A single-encoder drive counts as standing below this share of its rms speed."""
LEAST_BLOCKS = 6
LEAST_KNOWN = 20
"""So many samples beside reversals are needed: of fewer any effect leaves nothing (guess)."""
LARGEST_TWIST_RAD = 0.015
"""No gear stands so far under load (sizes 14 to 32 reach 0.007 to 0.012 rad at their momentary limit)."""
ZERO_TIMES = 10.0
"""A mean twist counts as a difference of the encoders' zeros from this many times its own variation."""
MODEL_TORQUE = "model_torque"
"""With this effect a model needs less of an inertia times a noisy acceleration."""
ANGLES = ("theta_in_rad", "theta_out_rad")
SPIKE = 20.0
"""A sample whose deviation from its neighbours' mean is so many times the 90 % quantile is no motion (guess: impacts in
a worn gear stay below ten)."""
QUIET_QUANTILE = 0.1
"""A torque's noise is this quantile of the powers in the quiet band, for a torque may well hold tones there."""
LEAST_WHOLE = 4000
"""A noise spectrum needs so many samples without a hole: fewer let the motion leak into the quiet band."""
LONGEST_BRIDGE_S = 0.15
"""Longest gap over which an arm's motion is bridged in a drive balance."""
BESIDE_GAP_S = 0.01
"""On either side of a gap that bends the motion by more than noise, what is left out besides."""
BRIDGED_SD = 3.0
"""Noise of the angle, in standard deviations, that the error of a bridge may reach (guess)."""
REST_SD, LEAST_RESTING = 4.0, 60
"""Change of an angle over six samples, in its noise, that is rest, and how many of those tell a torque's noise: in
motion a gear is loud, and its noise is no sensor's."""
LEAST_STEPS = 0.01
"""Quantile of the changes of an angle that is its encoder's step, if it is coarse."""
UNEVEN = 0.005
"""Stamps count as uneven from this scatter of the sampling interval over itself."""
QUIET_BAND = (0.36, 0.48)
"""In this band over the sampling rate encoders hold nothing but noise."""
TORQUE_BAND = (0.12, 0.48)
"""The same for the torque of a drive, whose amplifier is often louder near half the sampling rate than where a balance
listens."""
SEED = 3
"""The noise of one unit is always the same."""


@dataclass(frozen=True, slots=True)
class NoiseOfSensors:
    """White noise per sample, sd [rad] at each encoder itself."""

    theta_in_rad: float
    theta_out_rad: float


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
    torque_noise: float
    """white noise per sample of a measured torque or current, sd; 0 where the torque is computed"""
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
    """(n,) samples in which nothing tells the friction of a drive balance"""
    unknown: tuple[UnknownDirections, ...] = ()
    """what nothing tells of friction at reversals: left out of target and columns"""
    remarks: tuple[str, ...] = ()
    """what was left out of the recording and why, a line each"""
    late_s: Mapping[str, float] = field(default_factory=dict)
    """by how much channels were moved"""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """channels that tell nothing beside others, and the line that says so"""
    by_motor: bool = False
    """whether the torque is the motor's, times the ratio"""
    acceleration_noise: float = 0.0
    """Mean square that sensor noise leaves in the acceleration of a drive balance."""
    drive_floor: float = 0.0
    """rms that sensor noise leaves in a drive balance: of the torque, and of a first look at inertia times
    acceleration. It is the same for every model, or a model that bends the inertia would look as good as its noise."""

    def project(self, columns: Array) -> Array:
        """(m, k) of columns (n, k) through the balance filter."""
        return without_unknown(self.fir.apply(self.fir.value, columns)[self.rows], self.unknown)

    @property
    def known(self) -> int:
        """Rows less what nothing tells of them at reversals."""
        return len(self.rows) - sum(int(row.basis.shape[1]) for row in self.unknown)

    @property
    def freedom(self) -> float:
        """Independent observations: twice the bandwidth times the time, whatever the sampling rate."""
        return 2 * self.fir.cutoff_hz * self.seconds


def prepare(
    time_s: Array,
    columns: Mapping[str, Array],
    model: Model,
    block_s: float = BLOCK_S,
    late_s: Mapping[str, float] | None = None,
    remarks: tuple[str, ...] = (),
) -> PreparedMotion:
    """A trial of one recording, each channel moved by its `late_s`. Raises `KinematicsError` when it is too short to
    hold blocks out."""
    drive, inertia = model.balance == "drive", model.output_inertia_kg_m2
    source = torque_source(columns, inertia)
    if not drive and not source:
        raise KinematicsError("joint.output_inertia_kg_m2: missing: needed where no torque is recorded")
    by_motor = not drive and source == MOTOR
    columns = with_motor_torque(columns, model.ratio) if by_motor else columns
    columns = {name: without_spikes(column) if name in ANGLES else column for name, column in columns.items()}
    sensors = _sensors(time_s, columns, drive)
    balance_hz, argument_hz = _cutoffs_hz(time_s, columns, sensors, drive)
    moved = columns | {name: _earlier(time_s, columns[name], late) for name, late in (late_s or {}).items()}
    motion, valid = motion_of(time_s, moved, model.ratio, inertia, argument_hz, drive=drive)
    zero_rad = 0.0 if drive else _zero(motion, valid)
    motion = replace(motion, twist_rad=motion.twist_rad - zero_rad)
    angles = None if drive or "torque_out_Nm" in columns else _angles(time_s, columns, valid)
    fir, torque_noise = filters(motion.rate_hz, balance_hz), _torque_noise(time_s, columns, sensors, drive)
    aided = model.effect(MODEL_TORQUE) is not None
    doubts = _one_encoder(time_s, columns, motion, sensors, argument_hz, aided) if drive else None
    unsure = np.zeros(len(valid), dtype=bool)
    if doubts is not None:
        valid, unsure = doubts.valid, doubts.unsure
        fir = _whitened(fir, torque_noise, doubts.inertia * doubts.noise, 1 if doubts.seen else 2)
    valid = _inside(valid & np.isfinite(motion.torque_Nm), fir.delay) & ~unsure
    step = max(1, math.floor(motion.rate_hz / (SAMPLES_PER_CUTOFF * balance_hz)))
    rows, block = _blocks(valid, motion.rate_hz, step, block_s)
    unknown = unknown_directions(unsure, rows, fir.value)
    prepared = PreparedMotion(
        motion,
        fir,
        step,
        rows,
        block,
        without_unknown(fir.apply(fir.value, motion.torque_Nm)[rows], unknown),
        sensors,
        torque_noise,
        _moments(fir),
        len(rows) * step / motion.rate_hz,
        np.empty(0) if drive else quiet_input(motion, sensors.theta_in_rad),
        zero_rad,
        angles,
        unsure,
        unknown,
        remarks=(*remarks, *(doubts.remarks if doubts is not None else ())),
        late_s=dict(late_s or {}),
        by_motor=by_motor,
    )
    return prepared if doubts is None else _with_floor(prepared, doubts)


def _earlier(time_s: Array, column: Array, late_s: float) -> Array:
    """A column as it was read so much later, by splines between its samples."""
    from scipy.interpolate import CubicSpline

    whole = np.isfinite(column) & (np.diff(time_s, prepend=-np.inf) > 0)
    moved = CubicSpline(time_s[whole], column[whole])(np.minimum(time_s + late_s, time_s[whole][-1]))
    return np.where(np.isfinite(column), moved, math.nan)


def _sensors(time_s: Array, columns: Mapping[str, Array], drive: bool) -> NoiseOfSensors:
    """Noise of the encoders; of a drive's only one at least its rounding."""
    sensors = NoiseOfSensors(*(sensor_noise(time_s, columns.get(name)) for name in ("theta_in_rad", "theta_out_rad")))
    if not drive:
        return sensors
    return replace(sensors, theta_out_rad=max(sensors.theta_out_rad, rounding(columns["theta_out_rad"])))


def _cutoffs_hz(
    time_s: Array, columns: Mapping[str, Array], sensors: NoiseOfSensors, drive: bool
) -> tuple[float, float]:
    """Of the balance, and of the effects' arguments."""
    rate = _rate(time_s)
    balance_share, argument_share = (DRIVE_SHARE, DRIVE_SHARE) if drive else (BALANCE_SHARE, ARGUMENT_SHARE)
    balance_hz, argument_hz = min(BALANCE_HZ, balance_share * rate), min(ARGUMENT_HZ, argument_share * rate)
    if not drive or "velocity_out_rad_s" in columns:
        return balance_hz, argument_hz
    usual = usual_speed(time_s, columns["theta_out_rad"])
    argument_hz = argument_cutoff_hz(rate, sensors.theta_out_rad, usual, argument_hz)
    return min(balance_hz, argument_hz), argument_hz


def _torque_noise(time_s: Array, columns: Mapping[str, Array], sensors: NoiseOfSensors, drive: bool) -> float:
    """Sd of the measured torque's noise; of a drive's the least of what its quiet band, changes and rests say."""
    torque = next((columns[name] for name in _torques(drive) if name in columns), None)
    noise = sensor_noise(time_s, torque, QUIET_QUANTILE, TORQUE_BAND if drive else QUIET_BAND)
    if not drive or torque is None:
        return noise
    moved = np.abs(columns["theta_out_rad"] - np.roll(columns["theta_out_rad"], 6))
    resting = moved <= REST_SD * sensors.theta_out_rad
    steady = [_noise_of_differences(time_s, torque), _noise_of_differences(time_s, torque, resting[6:])]
    return max(min([noise, *(other for other in steady if other)]), rounding(torque))


class _OneEncoder(NamedTuple):
    """What a drive with one encoder leaves in doubt."""

    valid: Mask
    unsure: Mask
    """samples whose friction has a sign that nobody knows"""
    inertia: float
    noise: float
    """of a sample of the angle, or of the velocity where that is measured"""
    seen: bool
    """whether the velocity is measured"""
    turned: FirSet
    remarks: tuple[str, ...]


def _one_encoder(
    time_s: Array,
    columns: Mapping[str, Array],
    motion: Motion,
    sensors: NoiseOfSensors,
    argument_hz: float,
    aided: bool,
) -> _OneEncoder:
    turned, seen = filters(motion.rate_hz, argument_hz), measured_velocity(motion)
    noise = sensor_noise(time_s, columns["velocity_out_rad_s"]) if seen else sensors.theta_out_rad
    unsure = _unsure(motion, noise * math.sqrt(float(np.sum((turned.value if seen else turned.first) ** 2))))
    gaps, long = _gaps(time_s, columns, motion, noise)
    valid, remarks = spread_invalid(~long, turned.delay), tuple[str, ...]()
    rough = rough_fit(motion, valid & ~unsure & ~gaps, aided)
    odd = odd_stretch(rough.left, motion.rate_hz)
    if odd is not None:
        valid[odd[0] : odd[1] + 1] = False
        rough = rough_fit(motion, valid & ~unsure & ~gaps, aided)
        place = motion.time_s[odd[0]], motion.time_s[odd[1]]
        remarks = (f"{place[0]:.5g} to {place[1]:.5g} s hold {odd[2]:.0%} of the squared error: judged without",)
    return _OneEncoder(valid, unsure | gaps, rough.inertia, noise, seen, turned, remarks)


def _with_floor(prepared: PreparedMotion, doubts: _OneEncoder) -> PreparedMotion:
    """With the noise that torque and acceleration leave of a drive's exact model. That of a filtered current is more
    where the balance listens than near half the sampling rate."""
    units = unit_noise(doubts.turned, prepared.motion, prepared.project)
    known = doubts.valid & np.isfinite(prepared.motion.torque_Nm)
    torque = max(prepared.torque_noise**2 * units[0], heard_noise(prepared.motion, known, prepared.fir))
    powers = torque, doubts.noise**2 * units[1]
    floor = math.sqrt(powers[0] + doubts.inertia**2 * powers[1])
    return replace(prepared, acceleration_noise=powers[1], drive_floor=floor)


def _whitened(fir: FirSet, torque_noise: float, bent: float, power: int) -> FirSet:
    """The filter under which the noise of the torque and that of inertia times acceleration, `bent` per sample of the
    angle or the velocity, are white together."""
    return whitening(fir, (torque_noise / bent) ** (1 / power) / (2 * math.pi), power) if bent else fir


def enough(trials: Sequence[PreparedMotion]) -> None:
    """Raises `KinematicsError` where all recordings together are too short to hold blocks out."""
    if sum(len(np.unique(trial.block)) for trial in trials) < LEAST_BLOCKS:
        need, seconds = LEAST_BLOCKS * BLOCK_S, sum(trial.seconds for trial in trials)
        raise KinematicsError(f"{seconds:.3g} s of motion without gaps: expected at least {need:.3g} s")
    known = sum(trial.known for trial in trials)
    if known < LEAST_KNOWN:
        raise KinematicsError(f"{known} samples tell the direction of motion: expected at least {LEAST_KNOWN}")


def _gaps(time_s: Array, columns: Mapping[str, Array], motion: Motion, noise: float) -> tuple[Mask, Mask]:
    """(n,) samples in gaps, where the torque is unknown, and those in gaps that are too long to be bridged.

    A straight bridge errs by an eighth of the acceleration times the gap squared: where that is more than the sensor's
    noise, the motion beside the gap is not known either.
    """
    even = uniform(time_s, {name: np.asarray(column, dtype=float) for name, column in columns.items()})
    lost = ~even.valid
    edges = np.flatnonzero(np.diff(np.concatenate(([False], lost, [False])).astype(int)))
    gaps, long = np.zeros(len(lost), dtype=bool), np.zeros(len(lost), dtype=bool)
    bent = math.sqrt(float(np.nanmean(motion.acceleration_out_rad_s2**2)))
    for start, stop in edges.reshape(-1, 2):
        span_s = (stop - start + 1) / motion.rate_hz
        seen = bent * span_s**2 / 8 <= BRIDGED_SD * noise or "velocity_out_rad_s" in columns
        beside = 0 if seen else round(BESIDE_GAP_S * motion.rate_hz)
        gaps[max(start - beside, 0) : stop + beside] = True
        long[start:stop] = span_s > LONGEST_BRIDGE_S
    return gaps, long


def _unsure(motion: Motion, noise: float) -> Mask:
    """Samples at standstill or near it, where friction takes any value up to its level: no law of the speed holds, or
    its sign is not seen."""
    speed = np.abs(motion.velocity_out_rad_s)
    least = max(STANDSTILL_SHARE * math.sqrt(float(np.mean(speed**2))), UNSURE_SD * noise)
    near = speed <= least
    crossed = np.flatnonzero(np.diff(np.sign(motion.velocity_out_rad_s)) != 0)
    near[crossed] = near[np.minimum(crossed + 1, len(near) - 1)] = True
    return near


def _angles(time_s: Array, columns: Mapping[str, Array], valid: Mask) -> Angles:
    even = uniform(time_s, {name: np.asarray(columns[name], dtype=float) for name in ANGLES})
    return Angles(even.columns["theta_in_rad"], even.columns["theta_out_rad"], valid)


def _zero(motion: Motion, valid: Mask) -> float:
    """`zero_difference`, sharper: the twist at no torque, on the straight line of twist over torque."""
    if not zero_difference(motion.twist_rad[valid]):
        return 0.0
    seen = valid & np.isfinite(motion.torque_Nm) & np.isfinite(motion.twist_rad)
    twist, torque = motion.twist_rad[seen], motion.torque_Nm[seen]
    aside = torque - torque.mean()
    power = float(aside @ aside)
    slope = float(aside @ twist) / power if power else 0.0
    return float(twist.mean() - slope * torque.mean())


def zero_difference(twist_rad: Array) -> float:
    """How far the encoders' zeros are apart, seen from the output: the middle of a twist that no load explains, else 0.

    Smaller differences are not told from a steady load: `constant_load` stands for either.
    """
    seen = twist_rad[np.isfinite(twist_rad)]
    if not len(seen):
        return 0.0
    middle = float(np.median(seen))
    return middle if abs(middle) > max(LARGEST_TWIST_RAD, ZERO_TIMES * float(seen.std())) else 0.0


def without_spikes(angle: Array) -> Array:
    """(n,) the angle with single wild samples replaced by NaN: transmission errors, that no joint could follow."""
    if len(angle) < 5:
        return angle
    middle = np.asarray(angle, dtype=float)
    off = np.zeros(len(middle))
    off[1:-1] = np.abs(middle[1:-1] - (middle[:-2] + middle[2:]) / 2)
    usual = float(np.nanquantile(off, 0.9))
    peak = off >= np.maximum(np.roll(off, 1), np.roll(off, -1))
    wild = peak & (off > SPIKE * usual) & (usual > 0)
    return np.where(wild, np.nan, middle) if wild.any() else middle


def _torques(drive: bool) -> tuple[str, ...]:
    return ("torque_in_Nm", "current_in_A") if drive else ("torque_out_Nm",)


def _rate(time_s: Array) -> float:
    steps = np.diff(time_s)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    if not len(steps):
        raise KinematicsError("time_s: does not grow: expected at least 3 distinct instants")
    return float(1 / np.median(steps))


def _inside(valid: Mask, reach: int) -> Mask:
    """True where the whole reach of a filter is valid."""
    running = np.concatenate(([0], np.cumsum(~valid)))
    lower, upper = np.arange(len(valid)) - reach, np.arange(len(valid)) + reach + 1
    whole = (lower >= 0) & (upper <= len(valid))
    clear: Mask = running[np.clip(upper, 0, len(valid))] == running[np.clip(lower, 0, len(valid))]
    return whole & clear


def _blocks(valid: Mask, rate_hz: float, step: int, block_s: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    rows = np.flatnonzero(valid)
    if not len(rows):
        return rows, rows
    rows = rows[rows % step == 0]
    place = (rows - rows[0]) / rate_hz
    block = (place // block_s).astype(np.intp)
    into = place - block * block_s
    kept = (into >= GUARD_S / 2) & (into <= block_s - GUARD_S / 2)
    rows, block = rows[kept], block[kept]
    full = np.bincount(block, minlength=1) >= 0.4 * (block_s - GUARD_S) * rate_hz / step
    kept = full[block]
    return rows[kept], np.unique(block[kept], return_inverse=True)[1].astype(np.intp)


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
    unit = np.where(np.isfinite(angle), np.random.default_rng(SEED).normal(size=len(angle)), math.nan)
    even = uniform(time_s, {"angle": np.asarray(angle, dtype=float), "unit": unit})
    held = {name: np.where(even.valid, column, math.nan) for name, column in even.columns.items()}
    seen, left = (_noise_of(even.time_s, held[name], quantile, band) for name in ("angle", "unit"))
    return seen / left if left else 0.0


def rounding(angle: Array) -> float:
    """sd of what an encoder's step rounds off, which no spectrum shows where the angle rests in one step for long."""
    steps = np.abs(np.diff(angle))
    steps = steps[np.isfinite(steps) & (steps > 0)]
    return float(np.quantile(steps, LEAST_STEPS)) / math.sqrt(12) if len(steps) else 0.0


def uneven(time_s: Array) -> bool:
    """Whether samples came at uneven instants, lost ones and gaps aside."""
    steps = np.diff(time_s)
    usual = float(np.median(steps))
    single = steps[(steps > 0.5 * usual) & (steps < 1.5 * usual)]
    return len(single) > 0 and float(single.std()) > UNEVEN * usual


def _noise_of(time_s: Array, angle: Array, quantile: float, among: tuple[float, float] = QUIET_BAND) -> float:
    """Powers of white noise are exponentially distributed: any quantile of them gives the mean."""
    whole = _longest_whole(time_s, angle)
    if len(whole) < min(LEAST_WHOLE, len(angle) // 2):
        return _noise_of_differences(time_s, angle)
    angle = whole
    window = np.blackman(len(angle))
    power = np.abs(np.fft.rfft((angle - angle.mean()) * window)) ** 2 / (window @ window)
    low, high = (int(share * len(angle)) for share in among)
    return math.sqrt(float(np.quantile(power[low:high], quantile)) / -math.log1p(-quantile))


def _longest_whole(time_s: Array, angle: Array) -> Array:
    """The longest run without missing values, spikes or gaps."""
    step_s = float(np.median(np.diff(time_s)))
    broken = ~np.isfinite(angle) | (np.diff(time_s, prepend=time_s[0] - step_s) > 1.5 * step_s)
    edges = np.concatenate(([0], np.flatnonzero(broken), [len(angle)]))
    longest = int(np.argmax(np.diff(edges)))
    run: Array = np.asarray(angle[edges[longest] + (longest > 0) : edges[longest + 1]], dtype=float)
    return run


def _noise_of_differences(time_s: Array, angle: Array, among: Mask | None = None) -> float:
    """sd of white noise from sixth differences, where no run is long enough for a spectrum: they take out all that
    moves more slowly than a twentieth of the sampling rate. Their sum of squared coefficients is 924."""
    step_s = float(np.median(np.diff(time_s)))
    even = np.ptp(np.lib.stride_tricks.sliding_window_view(time_s, 7)[:, [0, 6]], axis=1) < 6.5 * step_s
    if among is not None:
        even = even & among
    sixth = np.diff(angle, 6)[even]
    sixth = sixth[np.isfinite(sixth)]
    if among is not None and len(sixth) < LEAST_RESTING:
        return 0.0
    return float(np.median(np.abs(sixth))) / 0.6745 / math.sqrt(924) if len(sixth) else 0.0


def channel_noise(trial: PreparedMotion) -> float:
    """rms that the white noise of a measured torque leaves behind the balance filter."""
    return trial.torque_noise * math.sqrt(float(np.sum(trial.fir.value**2)))


def noise_floor(trial: PreparedMotion, inertia: float, stiffness: float, damping: float) -> float:
    """rms [N m] that encoder noise alone leaves in the torsion balance behind its filter.

    S(f) = |J s^2 + B s + K|^2 s_out^2 + |K + B s|^2 s_in^2, integrated over the pass band by its moments.
    """
    m0, m2, m4 = trial.moments
    spring = stiffness**2 * m0 + damping**2 * m2
    whole = spring - 2 * stiffness * inertia * m2 + inertia**2 * m4
    into, out = trial.sensors.theta_in_rad / abs(trial.motion.ratio), trial.sensors.theta_out_rad
    return math.sqrt(max(whole * out**2 + spring * into**2, 0.0))


def _moments(fir: FirSet) -> tuple[float, float, float]:
    """Mean of the filter's power gain times omega^0, omega^2 and omega^4 over all frequencies."""
    omega = 2 * math.pi * np.linspace(0.0, fir.rate_hz / 2, 800)
    wave = np.cos(np.outer(omega / fir.rate_hz, np.arange(-fir.delay, fir.delay + 1)))
    gain = (wave @ fir.value) ** 2
    return float(np.mean(gain)), float(np.mean(gain * omega**2)), float(np.mean(gain * omega**4))
