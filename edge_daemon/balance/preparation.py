"""A recording made ready for regression: motion, and both sides of the balance through one filter.

The arguments of the effects are filtered lightly (twice the torsional resonance and more), the columns that come of
them and the torque then share the balance filter. What passes is decimated to a rate at which samples still count.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.drive_floor import with_floor
from edge_daemon.balance.motion_noise import MotionNoise, measured_speed, with_measured_speed
from edge_daemon.balance.one_encoder import doubts_of, motion_cutoff_hz, seen_at_output, turning, while_powered
from edge_daemon.balance.prepared import BLOCK_S, Angles, PreparedMotion
from edge_daemon.balance.quiet_input import quiet_filter, quiet_input
from edge_daemon.balance.reversals import unknown_directions, without_unknown
from edge_daemon.balance.sensor_noise import noise_of_sensors, without_glitches, without_spikes
from edge_daemon.balance.torsion_floor import moments
from edge_daemon.balance.twist_zero import twist_zero
from edge_daemon.effects.model import Model
from edge_daemon.effects.torque_source import MOTOR, MOTOR_SIDE, leaping, torque_source, with_motor_torque
from edge_daemon.motion.corrected import senses
from edge_daemon.motion.kinematics import (
    KinematicsError,
    UniformColumns,
    filters,
    interval_left_s,
    motion_of,
    sampled,
    uniform,
)
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
GUARD_S = 0.1
"""So much is left out between blocks, so that the filter carries nothing from one to the next."""
ANGLES = ("theta_in_rad", "theta_out_rad")
SELDOM = 1.5
"""Its usual interval over that of the rows from which on a channel is told in few of them (guess)."""
MEASURED_TORQUES = ("torque_out_Nm", "torque_in_Nm", "current_in_A")
"""Channels of which single wild samples are no motion, and no torque."""


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
    drive = model.balance == "drive"
    time_s, columns, by_motor, told = _as_read(time_s, columns, model)
    motors = by_motor or model.effect(MOTOR_SIDE.name) is not None
    sensors = noise_of_sensors(time_s, columns, model.ratio, drive, motors)
    earlier = {name: _earlier(time_s, columns[name], late) for name, late in (late_s or {}).items()}
    even = uniform(time_s, columns | earlier)
    speed_noise = math.inf if measured_speed(even) is None else sensors.velocity
    noise = MotionNoise(_rate(time_s), sensors.shaken * sensors.theta_out_rad, speed_noise)
    balance_hz, argument_hz = _cutoffs_hz(time_s, columns, noise, drive)
    motion, valid, zero_rad = _moved(even, model, noise, argument_hz)
    fir, unsure, doubts = filters(motion.rate_hz, balance_hz), np.zeros(len(valid), dtype=bool), None
    reckoned = not drive and "torque_out_Nm" not in columns
    angles = Angles(even.columns[ANGLES[0]], even.columns[ANGLES[1]], valid) if reckoned else None
    if drive:
        read = even.columns[ANGLES[1]]
        doubts = doubts_of(even.valid, motion, sensors, noise, fir, argument_hz, read, all_of_it)
        valid, unsure, fir = doubts.valid, doubts.unsure, doubts.fir
    elif by_motor or leaping(model):
        unsure = turning(motion, noise.speed_sd(filters(motion.rate_hz, argument_hz)))
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
        moments(fir),
        len(rows) * step / motion.rate_hz,
        np.empty(0) if drive else quiet_input(motion, sensors.shaken * sensors.theta_in_rad),
        zero_rad,
        angles,
        unsure,
        unknown,
        remarks=(*remarks, *told, *(doubts.remarks if doubts is not None else ())),
        late_s=dict(late_s or {}),
        block_s=block_s,
        by_motor=by_motor,
        odd=doubts is not None and bool(doubts.remarks),
    )
    if doubts is None:
        return _felt_quietly(prepared)
    return with_floor(prepared, doubts, noise) if len(rows) else prepared


def _as_read(
    time_s: Array, columns: Mapping[str, Array], model: Model
) -> tuple[Array, dict[str, Array], bool, tuple[str, ...]]:
    """Stamps and columns of what is read of a recording, whether its torque is the motor's, and what is said of the
    rest. Raises `KinematicsError` where a torsion balance has no torque."""
    drive, inertia = model.balance == "drive", model.output_inertia_kg_m2
    time_s, columns, lost = as_mostly_sampled(time_s, columns)
    columns, off = while_powered(time_s, seen_at_output(columns, model.ratio)) if drive else (columns, ())
    source = torque_source(columns, inertia)
    if not drive and not source:
        raise KinematicsError("joint.output_inertia_kg_m2: missing: needed where no torque is recorded")
    by_motor = not drive and source == MOTOR
    columns, wild = _without_wild(with_motor_torque(columns, model.ratio) if by_motor else columns)
    return time_s, columns, by_motor, (*lost, *off, *wild)


def _moved(even: UniformColumns, model: Model, noise: MotionNoise, argument_hz: float) -> tuple[Motion, Mask, float]:
    """The motion at even instants, the samples that no gap reaches, and the difference of the encoders' zeros that is
    taken out of the twist."""
    drive = model.balance == "drive"
    motion, valid = motion_of(even, model.ratio, model.output_inertia_kg_m2, argument_hz, drive=drive)
    if drive:
        return with_measured_speed(motion, even, filters(motion.rate_hz, argument_hz), noise), valid, 0.0
    zero_rad = twist_zero(motion, valid)
    return replace(motion, twist_rad=motion.twist_rad - zero_rad), valid, zero_rad


def _without_wild(columns: Mapping[str, Array]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """The columns without single samples that are none, and the lines that say so of a torque."""
    mended = {name: without_spikes(column) for name, column in columns.items() if name in ANGLES}
    mended |= {name: without_glitches(column) for name, column in columns.items() if name in MEASURED_TORQUES}
    lost = {name: np.count_nonzero(np.isfinite(columns[name]) & np.isnan(mended[name])) for name in mended}
    told = ((name, count) for name, count in lost.items() if count and name in MEASURED_TORQUES)
    lines = (f"{name}: single samples far off both neighbours are left out: {count}" for name, count in told)
    return {**columns, **mended}, tuple(lines)


def _felt_quietly(prepared: PreparedMotion) -> PreparedMotion:
    """With what friction feels of twist and measured torque."""
    motion, sensors = prepared.motion, prepared.sensors
    noise = math.hypot(sensors.theta_in_rad / motion.ratio, sensors.theta_out_rad)
    twist = quiet_filter(motion.twist_rad, noise, motion.rate_hz)
    torque = quiet_filter(motion.torque_Nm, sensors.torque, motion.rate_hz) if senses(motion) else None
    return replace(prepared, quiet_twist=twist, quiet_torque=torque)


def as_mostly_sampled(
    time_s: Array, columns: Mapping[str, Array]
) -> tuple[Array, Mapping[str, Array], tuple[str, ...]]:
    """A recording whose logger lost most frames at the interval of what is left, one of which an angle or a torque is
    told in few of its rows at the interval of that, and the line that says so; others as they are."""
    if left_s := interval_left_s(time_s):
        told = f"most of the time lies between samples {left_s:.3g} s apart: frames were lost"
        return *sampled(time_s, columns, left_s), (f"{told}, and it is read at that rate",)
    name, own_s = _least_often(time_s, columns)
    if own_s < SELDOM * float(np.median(np.diff(time_s))):
        return time_s, columns, ()
    return *sampled(time_s, columns, own_s), (f"{name} comes every {own_s:.3g} s: all is read at that rate",)


def _least_often(time_s: Array, columns: Mapping[str, Array]) -> tuple[str, float]:
    """The angle or torque that is told least often, and its usual interval; 0 where there is none."""
    known = ((name, np.isfinite(columns[name])) for name in (*ANGLES, *MEASURED_TORQUES) if name in columns)
    own_s = {name: float(np.median(np.diff(time_s[rows]))) for name, rows in known if np.count_nonzero(rows) > 2}
    return max(own_s.items(), key=lambda row: row[1], default=("", 0.0))


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
