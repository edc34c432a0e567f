"""A recording made ready for regression: motion, and both sides of the balance through one filter.

The arguments of the effects are filtered lightly (twice the torsional resonance and more), the columns that come of
them and the torque then share the balance filter. What passes is decimated to a rate at which samples still count.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.drive_columns import drive_columns, waves_beside
from edge_daemon.balance.motion_noise import TRANSFORM, MotionNoise, measured_speed, with_measured_speed
from edge_daemon.balance.one_encoder import Doubts, doubts_of, motion_cutoff_hz, seen_at_output, turning, while_powered
from edge_daemon.balance.quiet_input import QuietFilter, quiet_filter, quiet_input
from edge_daemon.balance.reversals import UnknownDirections, unknown_directions, without_unknown
from edge_daemon.balance.sensor_noise import NoiseOfSensors, noise_of_sensors, without_glitches, without_spikes
from edge_daemon.balance.torque_noise import torque_noise as heard_noise
from edge_daemon.balance.twist_zero import twist_zero
from edge_daemon.effects.algebra import derivative
from edge_daemon.effects.model import Model
from edge_daemon.effects.torque_source import MOTOR, MOTOR_SIDE, leaping, torque_source, with_motor_torque
from edge_daemon.motion.corrected import senses
from edge_daemon.motion.kinematics import (
    FirSet,
    KinematicsError,
    filters,
    interval_left_s,
    motion_of,
    sampled,
    uniform,
)
from edge_daemon.motion.left_over import LeftOver
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
SHORTER_BLOCKS_S = (0.5, 0.25)
"""Where recordings are too short for such blocks they are shorter, down to two guards and a half."""
GUARD_S = 0.1
"""So much is left out between blocks, so that the filter carries nothing from one to the next."""
SEED = 5
"""Of the noise that is passed through the balance to see what it leaves."""
LEAST_BLOCKS = 6
LEAST_KNOWN = 20
"""So many samples beside reversals are needed: of fewer any effect leaves nothing (guess)."""
LOOK_DOUBT = 1.1
"""Noise over what a first look leaves at the most, whose many columns take up some of it (guess)."""
ANGLES = ("theta_in_rad", "theta_out_rad")
MEASURED_TORQUES = ("torque_out_Nm", "torque_in_Nm", "current_in_A")
"""Channels of which single wild samples are no motion, and no torque."""


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


def prepare(
    time_s: Array,
    columns: Mapping[str, Array],
    model: Model,
    block_s: float = BLOCK_S,
    late_s: Mapping[str, float] | None = None,
    remarks: tuple[str, ...] = (),
    all_of_it: bool = False,
) -> PreparedMotion:
    """A trial of one recording, each channel moved by its `late_s`; `all_of_it`: with what `odd` is left out otherwise.
    Raises `KinematicsError` when it is too short to hold blocks out."""
    drive, inertia = model.balance == "drive", model.output_inertia_kg_m2
    time_s, columns, lost = _as_mostly_sampled(time_s, columns)
    columns, off = while_powered(time_s, seen_at_output(columns, model.ratio)) if drive else (columns, ())
    source = torque_source(columns, inertia)
    if not drive and not source:
        raise KinematicsError("joint.output_inertia_kg_m2: missing: needed where no torque is recorded")
    by_motor = not drive and source == MOTOR
    columns = with_motor_torque(columns, model.ratio) if by_motor else columns
    columns, wild = _without_wild(columns)
    motors = by_motor or model.effect(MOTOR_SIDE.name) is not None
    sensors = noise_of_sensors(time_s, columns, model.ratio, drive, motors)
    moved = columns | {name: _earlier(time_s, columns[name], late) for name, late in (late_s or {}).items()}
    even = uniform(time_s, moved)
    speed_noise = math.inf if measured_speed(even) is None else sensors.velocity
    noise = MotionNoise(_rate(time_s), sensors.shaken * sensors.theta_out_rad, speed_noise)
    balance_hz, argument_hz = _cutoffs_hz(time_s, columns, noise, drive)
    motion, valid = motion_of(even, model.ratio, inertia, argument_hz, drive=drive)
    motion = with_measured_speed(motion, even, filters(motion.rate_hz, argument_hz), noise) if drive else motion
    zero_rad = 0.0 if drive else twist_zero(motion, valid)
    motion = replace(motion, twist_rad=motion.twist_rad - zero_rad)
    angles = (
        None if drive or "torque_out_Nm" in columns else Angles(even.columns[ANGLES[0]], even.columns[ANGLES[1]], valid)
    )
    fir = filters(motion.rate_hz, balance_hz)
    angle_rad = even.columns[ANGLES[1]]
    read = even.valid, motion, sensors, noise, fir, argument_hz, angle_rad
    doubts = doubts_of(*read, all_of_it) if drive else None
    unsure = np.zeros(len(valid), dtype=bool)
    if by_motor or leaping(model):
        unsure = turning(motion, noise.speed_sd(filters(motion.rate_hz, argument_hz)))
    if doubts is not None:
        valid, unsure, fir = doubts.valid, doubts.unsure, doubts.fir
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
        _moments(fir),
        len(rows) * step / motion.rate_hz,
        np.empty(0) if drive else quiet_input(motion, sensors.shaken * sensors.theta_in_rad),
        zero_rad,
        angles,
        unsure,
        unknown,
        remarks=(*remarks, *lost, *off, *wild, *(doubts.remarks if doubts is not None else ())),
        late_s=dict(late_s or {}),
        block_s=block_s,
        by_motor=by_motor,
        odd=doubts is not None and bool(doubts.remarks),
    )
    if not drive:
        prepared = _felt_quietly(prepared)
    return prepared if doubts is None or not len(rows) else _with_floor(prepared, doubts, noise)


def _without_wild(columns: Mapping[str, Array]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """The columns without single samples that are none, and the lines that say so of a torque."""
    mended = {name: without_spikes(column) for name, column in columns.items() if name in ANGLES}
    mended |= {name: without_glitches(column) for name, column in columns.items() if name in MEASURED_TORQUES}
    lost = {name: np.count_nonzero(np.isfinite(columns[name]) & np.isnan(mended[name])) for name in mended}
    told = ((name, count) for name, count in lost.items() if count and name in MEASURED_TORQUES)
    lines = (f"{name}: single samples far off both neighbours are left out: {count}" for name, count in told)
    return {**columns, **mended}, tuple(lines)


def from_zero(prepared: PreparedMotion, zero_rad: float) -> PreparedMotion:
    """A trial whose twist counts from another difference of the encoders' zeros."""
    twist = prepared.motion.twist_rad + (prepared.zero_rad - zero_rad)
    return replace(prepared, motion=replace(prepared.motion, twist_rad=twist), zero_rad=zero_rad)


def _felt_quietly(prepared: PreparedMotion) -> PreparedMotion:
    """With what friction feels of twist and measured torque."""
    motion, sensors = prepared.motion, prepared.sensors
    noise = math.hypot(sensors.theta_in_rad / motion.ratio, sensors.theta_out_rad)
    twist = quiet_filter(motion.twist_rad, noise, motion.rate_hz)
    torque = quiet_filter(motion.torque_Nm, sensors.torque, motion.rate_hz) if senses(motion) else None
    return replace(prepared, quiet_twist=twist, quiet_torque=torque)


def _as_mostly_sampled(
    time_s: Array, columns: Mapping[str, Array]
) -> tuple[Array, Mapping[str, Array], tuple[str, ...]]:
    """A recording whose logger lost most frames at the interval of what is left, and the line that says so; others as
    they are."""
    left_s = interval_left_s(time_s)
    if not left_s:
        return time_s, columns, ()
    told = f"most of the time lies between samples {left_s:.3g} s apart: frames were lost, and it is read at that rate"
    return *sampled(time_s, columns, left_s), (told,)


def _earlier(time_s: Array, column: Array, late_s: float) -> Array:
    """A column as it was read so much later, by splines between its samples."""
    from scipy.interpolate import CubicSpline

    whole = np.isfinite(column) & (np.diff(time_s, prepend=-np.inf) > 0)
    moved = CubicSpline(time_s[whole], column[whole])(np.minimum(time_s + late_s, time_s[whole][-1]))
    return np.where(np.isfinite(column), moved, math.nan)


def _cutoffs_hz(time_s: Array, columns: Mapping[str, Array], noise: MotionNoise, drive: bool) -> tuple[float, float]:
    """Of the balance, and of the effects' arguments."""
    rate = noise.rate_hz
    balance_share, argument_share = (DRIVE_SHARE, DRIVE_SHARE) if drive else (BALANCE_SHARE, ARGUMENT_SHARE)
    balance_hz, argument_hz = min(BALANCE_HZ, balance_share * rate), min(ARGUMENT_HZ, argument_share * rate)
    if not drive:
        return balance_hz, argument_hz
    argument_hz = motion_cutoff_hz(time_s, columns["theta_out_rad"], noise, argument_hz)
    return min(balance_hz, argument_hz), argument_hz


def _with_floor(prepared: PreparedMotion, doubts: Doubts, noise: MotionNoise) -> PreparedMotion:
    """With the noise that torque and acceleration leave of a drive's exact model. That of a filtered current is more
    where the balance listens than near half the sampling rate."""
    unit = np.random.default_rng(SEED).normal(size=len(prepared.motion))
    drawn = np.stack((unit, noise.drawn_acceleration(doubts.turned, unit)), axis=1)
    torque, acceleration = (float(power) for power in np.mean(prepared.project(drawn) ** 2, axis=0))
    known = doubts.valid & np.isfinite(prepared.motion.torque_Nm)
    accelerated = doubts.inertia**2 * acceleration
    heard = heard_noise(prepared.motion, known, prepared.fir, accelerated)
    own = prepared.sensors.torque**2 * torque
    heard = min(heard, LOOK_DOUBT**2 * _left_by_look(prepared) - accelerated) if heard > own else own
    floor = math.sqrt(max(own, heard) + accelerated)
    frequency = np.asarray(np.fft.rfftfreq(TRANSFORM, 1 / prepared.motion.rate_hz), dtype=float)
    gains = [np.abs(np.fft.rfft(fir.value, TRANSFORM)) ** 2 for fir in (doubts.turned, prepared.fir)]
    by_frequency = noise.acceleration_power(frequency) * gains[0] * gains[1]
    shares = by_frequency / (float(by_frequency.sum()) or 1.0)
    return replace(prepared, acceleration_noise=acceleration, heard_hz=frequency, heard=shares, drive_floor=floor)


def _left_by_look(prepared: PreparedMotion) -> float:
    """Mean square that a first look leaves beside reversals: no noise is more. What happens at reversals may sound like
    noise where there is one in each window; and ripple where a controller's model torque is of the commanded motion."""
    x = np.hstack((prepared.project(np.nan_to_num(drive_columns(prepared.motion))), _swung(prepared)))
    if "torque_model_Nm" in prepared.motion.extra:
        beside, cutoff_hz = LeftOver.of(prepared.target, x), prepared.fir.cutoff_hz
        x = np.hstack((waves_beside(prepared.motion, prepared.rows, cutoff_hz, beside, prepared.project), x))
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-300
    found = np.linalg.lstsq(x / size, prepared.target, rcond=1e-8)[0]
    left = float(np.sum((prepared.target - x / size @ found) ** 2)) / max(prepared.known - len(found), 1)
    return left / _kept_of_noise(prepared.fir, *(found / size)[-2:])


def _swung(prepared: PreparedMotion) -> Array:
    """(m, 4) what a load that swings on the gear brings in: first and second derivative of acceleration and torque."""
    fir, rate_hz = prepared.fir, prepared.motion.rate_hz
    columns = list[Array]()
    for signal in (prepared.motion.acceleration_out_rad_s2, prepared.motion.torque_Nm):
        once = derivative(fir.apply(fir.value, np.nan_to_num(signal)), rate_hz)
        columns += [once, derivative(once, rate_hz)]
    return np.stack(columns, axis=1)[prepared.rows]


def _kept_of_noise(fir: FirSet, once: float, twice: float) -> float:
    """Mean square of what derivatives of a torque leave of its noise, over that noise's own behind the filter."""
    frequency = np.fft.rfftfreq(TRANSFORM, 1 / fir.rate_hz)
    power, omega = np.abs(np.fft.rfft(fir.value, TRANSFORM)) ** 2, 2 * np.pi * frequency
    return float(power @ np.abs(1 - 1j * once * omega + twice * omega**2) ** 2 / power.sum())


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


def channel_noise(trial: PreparedMotion) -> float:
    """rms that the white noise of a measured torque leaves behind the balance filter."""
    return trial.sensors.torque * math.sqrt(float(np.sum(trial.fir.value**2)))


def noise_floor(trial: PreparedMotion, inertia: float, stiffness: float, damping: float, rotor: float = 0.0) -> float:
    """rms [N m] that encoder noise alone leaves in the torsion balance behind its filter, with an inertia at the output
    or a rotor at the motor.

    S(f) = |J s^2 + B s + K|^2 s_out^2 + |J_m s^2 + B s + K|^2 s_in^2, integrated over the pass band by its moments.
    """
    _, m2, m4 = trial.moments
    sizes = np.array([stiffness, damping, rotor])
    load = (inertia * trial.sensors.shaken) ** 2 * m4 - 2 * stiffness * inertia * m2
    load *= trial.sensors.theta_out_rad**2
    return math.sqrt(max(float(sizes @ noise_products(trial) @ sizes) + load, 0.0))


def noise_products(trial: PreparedMotion) -> Array:
    """(3, 3) mean products of the encoders' noise in twist, twist rate and the motor's acceleration as seen from the
    output. An acceleration hears what moves both angles, too."""
    m0, m2, m4 = trial.moments
    into = (trial.sensors.theta_in_rad / trial.motion.ratio) ** 2
    both = into + trial.sensors.theta_out_rad**2
    accelerated = m4 * into * trial.sensors.shaken**2
    return np.array([[m0 * both, 0.0, -m2 * into], [0.0, m2 * both, 0.0], [-m2 * into, 0.0, accelerated]])


def _moments(fir: FirSet) -> tuple[float, float, float]:
    """Mean of the filter's power gain times omega^0, omega^2 and omega^4 over all frequencies."""
    omega = 2 * math.pi * np.linspace(0.0, fir.rate_hz / 2, 800)
    wave = np.cos(np.outer(omega / fir.rate_hz, np.arange(-fir.delay, fir.delay + 1)))
    gain = (wave @ fir.value) ** 2
    return float(np.mean(gain)), float(np.mean(gain * omega**2)), float(np.mean(gain * omega**4))
