"""Recordings that cannot be what they claim: refused, or doubted by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from edge_daemon.effects.model import Model
from edge_daemon.explain.results import ExplainError
from edge_daemon.identify.balance import zero_difference
from edge_daemon.identify.fit import Recorded
from edge_daemon.records import Array

DEGREES = 180 / math.pi
RATIO_TOLERANCE = 0.15
"""a ratio this far off is another unit or mounting, not wear"""
FASTEST_MOTOR_RAD_S = 1500.0
"""14 000 rpm: beyond it a motor angle is more likely in degrees (3000 to 8500 rpm is what wave generators stand)"""
LARGEST_SHARE_MISSING = 0.3
WORTH_SAYING = 5e-4
"""share of rows without a number from which on it is mentioned: what rounds to 0.1 %"""
LEAST_ROWS = 50
STILL_RAD = 1e-5


def examine(recordings: Sequence[Recorded], model: Model) -> tuple[str, ...]:
    """Warnings, one line each. Raises `ExplainError` for what cannot be used at all."""
    if not recordings:
        raise ExplainError("no recording: expected at least one")
    return tuple(line for recording in recordings for line in _one(recording, model))


def _one(recording: Recorded, model: Model) -> list[str]:
    rows = len(recording.time_s)
    if rows < LEAST_ROWS:
        raise ExplainError(f"{rows} rows: expected at least {LEAST_ROWS}, some ten seconds of motion")
    needed = ["theta_out_rad"] + (["theta_in_rad"] if model.balance == "torsion" else [])
    for name in needed:
        _usable(recording.columns, name)
    if model.balance == "drive" and not {"torque_in_Nm", "current_in_A"} & set(recording.columns):
        raise ExplainError("current_in_A: missing: a drive balance needs it, or torque_in_Nm")
    for name in ("torque_out_Nm",) if model.balance == "torsion" else ("torque_in_Nm", "current_in_A"):
        _alive(recording.columns, name)
    warnings = _constants(recording.columns)
    if model.balance == "torsion":
        _ratio(recording.columns, model.ratio)
        warnings += _zeros(recording.columns, model.ratio)
    return warnings + _speed(recording, model)


def _usable(columns: Mapping[str, Array], name: str) -> None:
    if name not in columns:
        raise ExplainError(f"{name}: missing: expected this column")
    column = np.asarray(columns[name], dtype=float)
    missing = 1 - float(np.isfinite(column).mean())
    if missing > LARGEST_SHARE_MISSING:
        raise ExplainError(f"{name}: {missing:.0%} of the rows hold no number: expected at most 30 %")
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
    if fastest > FASTEST_MOTOR_RAD_S:
        return [f"the motor would turn at {fastest * 30 / math.pi:.0f} rpm: the angles look like degrees"]
    return []
