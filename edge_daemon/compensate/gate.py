"""Whether a model may be acted on: it must foretell a recording that it was not told.

A part that foretells with a gain g leaves |1 - g| of what it mends. It is used only where that is surely less than one
half, so that a wrong model leaves the output as it was.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from edge_daemon.compensate.feedforward import PARTS, Feedforward, Trajectory
from edge_daemon.effects.algebra import derivative
from edge_daemon.errors import BadInput
from edge_daemon.records import Array

WORST_GAIN_ERROR = 0.5
"""A gain that errs by less than one half at three deviations removes at least one half of the error."""
BLOCKS = 8
"""Stretches of a recording whose gains' scatter is their deviation, since samples in a row are not independent."""
LEAST_SAMPLES = 200
"""Of a recording: eight stretches of two dozen each."""
LEAST_SHARE = 0.02
"""Of the recording's own spread, which a part must explain to be told at all."""


def confirmed(ready: Feedforward, time_s: Array, columns: Mapping[str, Array]) -> Feedforward:
    """`gated` by a recording as it was read. Raises `BadInput` where it lacks an angle."""
    missing = [name for name in ("theta_in_rad", "theta_out_rad") if name not in columns]
    if missing:
        raise BadInput(f"{missing[0]} is missing: both angles confirm a model")
    rate_hz = 1.0 / float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1], 1.0 / rate_hz)
    rows = {}
    for name in ("theta_in_rad", "theta_out_rad", "torque_out_Nm"):
        good = np.isfinite(columns.get(name, np.full(len(time_s), np.nan)))
        if good.any():
            rows[name] = np.interp(even, time_s[good], columns[name][good])
        elif name != "torque_out_Nm":
            raise BadInput(f"{name}: holds no number")
    if len(even) < LEAST_SAMPLES:
        raise BadInput(f"{len(even)} samples confirm nothing: expected at least {LEAST_SAMPLES}")
    return gated(ready, rate_hz, rows["theta_in_rad"], rows["theta_out_rad"], rows.get("torque_out_Nm"))


def gated(ready: Feedforward, rate_hz: float, theta_in: Array, theta_out: Array, torque: Array | None) -> Feedforward:
    """Without the parts that do not foretell the twist of a recording, (n,) each [rad], [N m]."""
    ratio = ready.model.ratio
    measured = theta_in / ratio - theta_out
    speed = derivative(theta_out, rate_hz)
    path = Trajectory(rate_hz, theta_out, speed, derivative(speed, rate_hz), torque)
    told = {}
    if "twist" not in ready.off:
        told["twist"] = ready.twist(path)[1]
    if "kinematic" not in ready.off:
        told["kinematic"] = -ready.error(theta_in, theta_out)
    for part in PARTS:
        if part in told:
            why = _why_not(part, told, measured)
            ready = ready.without(part, why) if why else ready
    return ready


def _why_not(part: str, told: dict[str, Array], measured: Array) -> str:
    """Empty where the part foretells the recording."""
    names = list(told)
    gains = []
    for rows in np.array_split(np.arange(len(measured)), BLOCKS):
        columns = np.column_stack([*(told[name][rows] for name in names), np.ones(len(rows))])
        gains.append(np.linalg.lstsq(columns, measured[rows], rcond=None)[0][names.index(part)])
    gain, sd = float(np.median(gains)), float(np.std(gains) / np.sqrt(BLOCKS))
    if np.std(told[part]) < LEAST_SHARE * np.std(measured):
        return "the recording does not show it"
    if abs(1.0 - gain) + 3.0 * sd >= WORST_GAIN_ERROR:
        return f"the recording has {gain:.2f} +- {sd:.2f} of what the model says: expected 1"
    return ""
