"""Recordings that cannot be what they claim: refused, or doubted by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from edge_daemon.balance.one_encoder import measures_load, seen_at_output, usual_speed
from edge_daemon.balance.preparation import as_mostly_sampled
from edge_daemon.balance.twist_zero import locked, zero_difference
from edge_daemon.channels import MOTOR_TORQUES
from edge_daemon.effects.expression import parse
from edge_daemon.effects.model import Model
from edge_daemon.effects.torque_source import INERTIA, MOTOR, torque_source
from edge_daemon.explain.results import ExplainError
from edge_daemon.records import Array, Recorded

DEGREES = 180 / math.pi
RATIO_TOLERANCE = 0.15
"""A ratio this far off is another unit or mounting, not wear."""
FASTEST_MOTOR_RAD_S = 1500.0
"""14 000 rpm: beyond it a motor angle is more likely in degrees (3000 to 8500 rpm is what wave generators stand)"""
LARGEST_SHARE_MISSING = 0.3
WORTH_SAYING = 5e-4
"""Rows without a number are mentioned from this share on: what rounds to 0.1 %."""
LEAST_ROWS = 50
STILL_RAD = 1e-5
SLOWEST_S = 0.2
"""Interval up to which nothing is asked: as milliseconds it would be 5 kHz, faster than loggers are, while those of a
telescope or a plant take ten rows a second."""
CLOCKS = (("milliseconds", 1e-3, 200.0), ("microseconds", 1e-6, 2e5), ("nanoseconds", 1e-9, math.inf))
"""Units of time, what makes seconds of them, and the interval up to which each is meant."""
USUAL_S = 0.1
"""Time over which a speed is compared with its angle: a step of a coarse encoder is a small part of it."""
LEAST_MOVED, BOTH_WAYS = 0.05, 0.1
"""Motion over its largest from which its direction counts, and share of either direction that tells a sign."""
AGAINST = 0.4
"""Correlation of a torque against the direction of motion from which its sign is wrong (guess)."""
AGAINST_TWIST = 0.9
"""Correlation of a sensor's torque against the twist from which a sign is wrong (guess: an error of the output's angle
that is larger than the twist may make a half)."""
LIKE = 0.5
"""Correlation of a speed with the derivative of its angle below which they do not belong together (guess)."""
ODD_SPEED = 1.5
"""Factor between a speed and the derivative of its angle that no filter of a drive makes (guess)."""
SPEEDS = {
    -1.0: "one of the two has the wrong sign: --map velocity_out_rad_s=-velocity_out_rad_s",
    DEGREES: "it looks like degrees per second: --map velocity_out_rad_s=velocity_out_rad_s*deg",
    1 / DEGREES: "the angle looks like degrees: --map theta_out_rad=theta_out_rad*deg",
    1 / (2 * math.pi): "the speed looks like turns per second: --map velocity_out_rad_s=velocity_out_rad_s*2*pi",
    60 / (2 * math.pi): "the speed looks like turns per minute: --map velocity_out_rad_s=velocity_out_rad_s*pi/30",
}
"""Slopes of a speed over the derivative of its angle, and what they mean."""


def examine(recordings: Sequence[Recorded], model: Model) -> tuple[str, ...]:
    """Warnings, one line each. Raises `ExplainError` for what cannot be used at all."""
    if not recordings:
        raise ExplainError("no recording: expected at least one")
    lines = [line for recording in recordings for line in _one(recording, model)]
    return tuple(dict.fromkeys((*lines, *_by_clock(model, recordings[0]))))


def _by_clock(model: Model, recording: Recorded) -> list[str]:
    """A law of the clock fits what was recorded and no other motion, unless time itself is what wears or warms."""
    told = "the clock of a recording: it may be this motion's, or another joint's, and no law of the gear"
    formulas = ((row.name, row.expression) for row in model.effects if row.expression)
    return [f"{name}: time_s: {told}" for name, text in formulas if parse(text, recording.columns).by_clock]


class _Read(NamedTuple):
    """A recording with the angle of the output, its channels told together."""

    time_s: Array
    columns: Mapping[str, Array]


def _one(recording: Recorded, model: Model) -> list[str]:
    rows, warnings = len(recording.time_s), list[str]()
    if model.balance == "drive":
        measured = recording.columns
        recording = _Read(recording.time_s, seen_at_output(measured, model.ratio))
        if "theta_out_rad" not in measured:
            warnings.append("no theta_out_rad: the output's angle is theta_in_rad over the ratio")
        if measures_load(measured):
            warnings.append("torque_out_Nm: measured behind the gear: it stands for torque_model_Nm")
    else:
        warnings += _unused(recording.columns, model)
    if rows < LEAST_ROWS:
        raise ExplainError(f"{rows} rows: expected at least {LEAST_ROWS}, some ten seconds of motion")
    _time(recording, model.ratio)
    for name in ("theta_out_rad", *_of_motor(model)):
        _often_told(recording.columns, name)
    recording = _Read(*as_mostly_sampled(recording.time_s, recording.columns)[:2])
    still = model.balance == "torsion" and _locked(recording.columns, model.ratio)
    for name in ("theta_in_rad",) if still else ("theta_out_rad", *_of_motor(model)):
        _usable(np.asarray(recording.columns[name], dtype=float), name)
    if model.balance == "drive" and not set(MOTOR_TORQUES) & set(recording.columns):
        raise ExplainError("current_in_A: missing: a drive balance needs it, or torque_in_Nm")
    for name in ("torque_out_Nm",) if model.balance == "torsion" else MOTOR_TORQUES:
        _alive(recording.columns, name)
    warnings += _constants(recording.columns)
    _velocity(recording)
    if model.balance == "drive":
        _against(recording)
    elif "torque_out_Nm" in recording.columns:
        _against_twist(recording.columns, model.ratio)
    if still:
        warnings.append("the output is locked, but for twist: nothing is told that depends on its angle")
    elif model.balance == "torsion":
        _ratio(recording.columns, model.ratio)
        warnings += _zeros(recording.columns, model.ratio)
    return warnings + _speed(recording, model)


def _unused(columns: Mapping[str, Array], model: Model) -> list[str]:
    """A line where the motor's torque is recorded and that of the inertia is taken, which on an arm is not all."""
    motor = next((name for name in MOTOR_TORQUES if name in columns), None)
    if motor is None or torque_source(columns, model.output_inertia_kg_m2) != INERTIA:
        return []
    mapped = "" if motor == MOTOR else f" and --map {MOTOR}={motor}*CONSTANT"
    told = "the torque is joint.output_inertia_kg_m2 times acceleration; of an arm, which carries more"
    return [f"{motor} is not used: {told}, leave that out of the model{mapped}"]


def _time(recording: Recorded, ratio: float) -> None:
    """Stamps in another unit make any motion slow, and any fit long; in that unit the motor would not be too fast."""
    steps = np.diff(recording.time_s)
    step = float(np.median(steps)) if len(steps) else 0.0
    if step <= SLOWEST_S:
        return
    unit, factor = next((row for row in CLOCKS if step < row[2]), CLOCKS[-1])[:2]
    told = [(name, by) for name, by in (("theta_in_rad", 1.0), ("theta_out_rad", ratio)) if name in recording.columns]
    motor_rad_s = [by * usual_speed(recording.time_s, np.asarray(recording.columns[name]), step) for name, by in told]
    if max(motor_rad_s, default=0.0) / factor < FASTEST_MOTOR_RAD_S:
        raise ExplainError(
            f"time_s: {step:.3g} from one row to the next: looks like {unit}: --map time_s=time_s*{factor:g}"
        )


def _against(recording: Recorded) -> None:
    """Friction takes power: a torque that gives some at either direction has the wrong sign."""
    name = "torque_in_Nm" if "torque_in_Nm" in recording.columns else "current_in_A"
    angle, torque = np.asarray(recording.columns["theta_out_rad"]), np.asarray(recording.columns[name])
    stride = max(1, round(USUAL_S / float(np.median(np.diff(recording.time_s)))))
    middle = slice(stride // 2, len(angle) - stride + stride // 2)
    moved = angle[stride:] - angle[:-stride]
    model = recording.columns.get("torque_model_Nm", np.zeros(len(angle)))
    x = np.stack([np.sin(angle), np.cos(angle), np.ones(len(angle)), model, torque], axis=1)[middle]
    moving = np.isfinite(x).all(axis=1) & (np.abs(moved) > LEAST_MOVED * np.nanmax(np.abs(moved)))
    sign, x = np.sign(moved[moving]), x[moving]
    if min((sign > 0).mean(), (sign < 0).mean()) < BOTH_WAYS if len(sign) else True:
        return
    plain = x[:, -1] - x[:, :-1] @ np.linalg.lstsq(x[:, :-1], x[:, -1], rcond=None)[0]
    direct = sign - x[:, :-1] @ np.linalg.lstsq(x[:, :-1], sign, rcond=None)[0]
    likeness = float(plain @ direct) / math.sqrt(float(plain @ plain) * float(direct @ direct) or 1.0)
    if likeness < -AGAINST:
        raise ExplainError(f"{name}: drives against the motion throughout: it has the wrong sign: --map {name}=-{name}")


def _against_twist(columns: Mapping[str, Array], ratio: float) -> None:
    """A spring's torque grows with its twist."""
    rows = [np.asarray(columns[name], dtype=float) for name in ("theta_in_rad", "theta_out_rad", "torque_out_Nm")]
    seen = np.all(np.isfinite(rows), axis=0)
    motor, out, torque = (row[seen] for row in rows)
    likeness = correlation(motor / ratio - out, torque)
    if likeness < -AGAINST_TWIST:
        raise ExplainError(
            f"torque_out_Nm falls as the twist grows (correlation {likeness:.2f}): one of the two has the wrong sign: "
            "--map torque_out_Nm=-torque_out_Nm"
        )


def correlation(one: Array, other: Array) -> float:
    """Correlation of two signals (n,); 0 where one never changes, or there is none."""
    if not len(one):
        return 0.0
    x, y = one - one.mean(), other - other.mean()
    power = float(x @ x) * float(y @ y)
    return float(x @ y) / math.sqrt(power) if power > 0 else 0.0


def _velocity(recording: Recorded) -> None:
    """A speed that was recorded beside the angle must be its derivative."""
    angle, velocity = (recording.columns.get(name) for name in ("theta_out_rad", "velocity_out_rad_s"))
    if angle is None or velocity is None:
        return
    stride = max(1, round(USUAL_S / float(np.median(np.diff(recording.time_s)))))
    span = recording.time_s[stride:] - recording.time_s[:-stride]
    moved = (angle[stride:] - angle[:-stride]) / span
    total = np.concatenate(([0.0], np.cumsum(np.nan_to_num((velocity[1:] + velocity[:-1]) / 2)
                                             * np.diff(recording.time_s))))  # fmt: skip
    mean = (total[stride:] - total[:-stride]) / span
    known = np.isfinite(moved) & np.isfinite(mean) & (span < 3 * USUAL_S)
    x, y = moved[known], mean[known]
    power = float(x @ x)
    if not power or not float(y @ y):
        return
    likeness = float(x @ y) / math.sqrt(power * float(y @ y))
    slope = float(x @ y) / power
    if abs(likeness) < LIKE:
        raise ExplainError(
            "velocity_out_rad_s is not the derivative of theta_out_rad: expected columns of one joint, not exchanged"
        )
    for value, text in SPEEDS.items():
        if abs(slope / value - 1) < RATIO_TOLERANCE:
            raise ExplainError(f"velocity_out_rad_s is {slope:.3g} times the derivative of theta_out_rad: {text}")
    if not 1 / ODD_SPEED < slope < ODD_SPEED:
        raise ExplainError(
            f"velocity_out_rad_s is {slope:.3g} times the derivative of theta_out_rad: another unit, or exchanged"
        )


def _of_motor(model: Model) -> tuple[str, ...]:
    return ("theta_in_rad",) if model.balance == "torsion" else ()


def _locked(columns: Mapping[str, Array], ratio: float) -> bool:
    if not {"theta_in_rad", "theta_out_rad"} <= set(columns):
        return False
    motor, out = (np.asarray(columns[name], dtype=float) for name in ("theta_in_rad", "theta_out_rad"))
    return locked(motor / ratio - out, out)


def _often_told(columns: Mapping[str, Array], name: str) -> None:
    if name not in columns:
        raise ExplainError(f"{name}: missing: expected this column")
    column = np.asarray(columns[name], dtype=float)
    rows = np.flatnonzero(np.isfinite(column))
    usual = float(np.median(np.diff(rows))) if len(rows) > 1 else 1.0  # channels may come in turn, a row each
    missing = 1 - len(rows) * usual / len(column)
    if missing > LARGEST_SHARE_MISSING:
        raise ExplainError(f"{name}: {missing:.0%} of the rows hold no number: expected at most 30 %")


def _usable(column: Array, name: str) -> None:
    if np.nanmax(column) - np.nanmin(column) < STILL_RAD:
        raise ExplainError(f"{name}: constant: expected motion")


def _alive(columns: Mapping[str, Array], name: str) -> None:
    """A torque that never changes explains nothing."""
    column = np.asarray(columns.get(name, (0.0, 1.0)), dtype=float)
    seen = column[np.isfinite(column)]
    if len(seen) and seen.min() == seen.max():
        raise ExplainError(f"{name}: constant {seen[0]:g}: expected the torque of the motion, or no such column")


def _constants(columns: Mapping[str, Array]) -> list[str]:
    lines = []
    for name, column in columns.items():
        finite = column[np.isfinite(column)]
        if len(finite) == 0:
            lines.append(f"{name}: holds no number: not used")
        elif len(finite) < (1 - WORTH_SAYING) * len(column):
            lines.append(f"{name}: {1 - len(finite) / len(column):.1%} of the rows hold no number: bridged")
    return lines


def _zeros(columns: Mapping[str, Array], ratio: float) -> list[str]:
    apart = zero_difference(np.asarray(columns["theta_in_rad"]) / ratio - np.asarray(columns["theta_out_rad"]))
    if not apart:
        return []
    return [f"the encoders' zeros are {apart:.4g} rad apart at the output: taken out; a steady load cannot be seen"]


def _ratio(columns: Mapping[str, Array], ratio: float) -> None:
    motor, out = np.asarray(columns["theta_in_rad"]), np.asarray(columns["theta_out_rad"])
    both = np.isfinite(motor) & np.isfinite(out)
    x, y = out[both] - out[both].mean(), motor[both] - motor[both].mean()
    slope = float(x @ y / (x @ x))
    seen = slope / ratio
    if abs(seen - 1) < RATIO_TOLERANCE:
        return
    guesses = {
        DEGREES: "theta_in_rad looks like degrees",
        1 / DEGREES: "theta_out_rad looks like degrees",
        -1.0: "one angle, or the ratio, has the wrong sign",
        1 / ratio**2: "the two angles look exchanged",
        1 / ratio: "theta_in_rad looks referred to the output already",
        1 / (2 * math.pi): "theta_in_rad looks like turns",
        2 * math.pi: "theta_out_rad looks like turns",
    }
    near = [text for value, text in guesses.items() if abs(seen / value - 1) < RATIO_TOLERANCE]
    doubt = near[0] if near else "expected angles of one joint in rad, multi-turn"
    raise ExplainError(f"theta_in_rad moves {slope:.4g} times theta_out_rad, the model says {ratio:g}: {doubt}")


def _speed(recording: Recorded, model: Model) -> list[str]:
    out = np.asarray(recording.columns["theta_out_rad"])
    step = np.nanmedian(np.diff(recording.time_s))
    if not step > 0:
        return []
    stride = max(1, round(0.02 / step))
    speed = np.abs(out[stride:] - out[:-stride]) / (stride * step) * abs(model.ratio)
    fastest = float(np.nanquantile(speed, 0.99)) if len(speed) else 0.0
    if fastest > FASTEST_MOTOR_RAD_S and model.balance == "drive":
        raise ExplainError(
            f"theta_out_rad: the motor would turn at {fastest * 30 / math.pi:.0f} rpm: it looks like degrees: "
            "--map theta_out_rad=theta_out_rad*deg"
        )
    if fastest > FASTEST_MOTOR_RAD_S:
        return [f"the motor would turn at {fastest * 30 / math.pi:.0f} rpm: the angles look like degrees"]
    return []
