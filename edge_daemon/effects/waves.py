"""Waves: what repeats with an angle of the gear, by the number of its periods per turn.

Three angles turn in a gear: the input (wave generator), the output, and the input against the output, by which the
strain wave passes the teeth of the flexspline.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from edge_daemon.effects.effect import Parameter, Wave
from edge_daemon.effects.model import ModelError
from edge_daemon.records import Array, Motion

Angle = Literal["input", "output", "difference"]
ANGLES: Mapping[str, str] = {
    "input": "motor angle",
    "output": "output angle",
    "difference": "motor angle less the output angle",
}
"""The angles that a wave may follow, by the word of the model file, and what each is."""
HIGHEST_ORDER = 1e5
"""Largest order per turn that a model file may name (guess: finer than any encoder's subdivision of a gear)."""


class TurningAngle(NamedTuple):
    """One angle as it turns, (n,) each."""

    angle_rad: Array
    rate_rad_s: Array


def turning_angle(motion: Motion, angle: str) -> TurningAngle:
    """One of `ANGLES` as it turns; its rate is NaN where the twist was not measured and the input is asked for."""
    if angle == "output":
        return TurningAngle(motion.theta_out_rad, motion.velocity_out_rad_s)
    rate = motion.ratio * (motion.velocity_out_rad_s + motion.twist_rate_rad_s)
    if angle == "input":
        return TurningAngle(motion.theta_in_rad, rate)
    return TurningAngle(motion.theta_in_rad - motion.theta_out_rad, rate - motion.velocity_out_rad_s)


def waves(motion: Motion, rows: Sequence[Wave]) -> Array:
    """(n, 2 * len(rows)): sine and cosine of each wave, in turn."""
    parts = [row.order * turning_angle(motion, row.angle).angle_rad for row in rows]
    return np.stack([wave(part) for part in parts for wave in (np.sin, np.cos)], axis=1)


def wave_rates(motion: Motion, rows: Sequence[Wave]) -> Array:
    """(n, 2 * len(rows)): time derivative of `waves`."""
    columns = []
    for row in rows:
        turning = turning_angle(motion, row.angle)
        pace = row.order * turning.rate_rad_s
        columns += [pace * np.cos(row.order * turning.angle_rad), -pace * np.sin(row.order * turning.angle_rad)]
    return np.stack(columns, axis=1)


class WaveSlopes(NamedTuple):
    """What `waves` do as the output turns, (n, 2 * len(rows)) each, every angle turning as the output does."""

    slopes: Array
    """derivative by the output angle"""
    lifts: Array
    """second time derivative"""


def wave_slopes(motion: Motion, rows: Sequence[Wave]) -> WaveSlopes:
    """Of each wave, sine and cosine in turn."""
    every = waves(motion, rows)
    turns = np.repeat([_per_turn(motion, row) for row in rows], 2)
    other = every.reshape(len(every), -1, 2)[:, :, ::-1].reshape(every.shape)
    slopes = other * (turns * np.tile((1.0, -1.0), len(rows)))
    bent = every * turns**2
    lifts = motion.acceleration_out_rad_s2[:, None] * slopes - motion.velocity_out_rad_s[:, None] ** 2 * bent
    return WaveSlopes(slopes, lifts)


def _per_turn(motion: Motion, row: Wave) -> float:
    """Periods of a wave per turn of the output, less than 0 where its angle turns against that."""
    return row.order * {"input": motion.ratio, "output": 1.0, "difference": motion.ratio - 1.0}[row.angle]


def label(row: Wave, home: str) -> str:
    """What a parameter's name says of a wave: `7`, `0_47`, `202_output` beside a `home` angle of the input."""
    order = f"{row.order:.6g}".replace(".", "_")
    return order if row.angle == home else f"{order}_{row.angle}"


FORMS = {"": "", "_signed": " that changes sign with the load", "_directed": " that changes sign with the motion"}
"""Endings of the amplitudes of one wave, and what they say of it."""


def wave_parameters(unit: str, rows: Sequence[Wave], home: str, forms: Sequence[str] = ("",)) -> tuple[Parameter, ...]:
    """Amplitudes `sine_m`, `cosine_m` of each wave, in each of some `FORMS`."""
    return tuple(
        Parameter(
            f"{word}_{label(row, home)}{form}",
            unit,
            f"{word} part{FORMS[form]}, order {row.order:.6g} of the {ANGLES[row.angle]}",
        )
        for form in forms
        for row in rows
        for word in ("sine", "cosine")
    )


def of_input(*orders: float) -> tuple[Wave, ...]:
    """Waves of the input angle."""
    return tuple(Wave("input", order) for order in orders)


def in_words(rows: Sequence[Wave]) -> str:
    """`1, 2, 4 per turn of the input; 202 of the output`."""
    parts = [
        f"{', '.join(f'{row.order:.6g}' for row in rows if row.angle == angle)} of the {angle}"
        for angle in ANGLES
        if any(row.angle == angle for row in rows)
    ]
    return f"m = {'; '.join(parts)}"


def by_angle(rows: Iterable[Wave]) -> dict[str, list[float]]:
    """The orders of each angle, rising, whole ones as such: how a model file writes them."""
    rows = sorted(rows, key=lambda row: row.order)
    out = {angle: [_plain(row.order) for row in rows if row.angle == angle] for angle in ANGLES}
    return {angle: orders for angle, orders in out.items() if orders}


def _plain(order: float) -> float:
    return int(order) if order == int(order) else order


def read_waves(value: object, home: str) -> tuple[Wave, ...]:
    """The waves of a model file's `orders`: a list, of the effect's own angle, or a table of lists by angle.

    Raises `ModelError` that says what is wrong, without the place.
    """
    table = value if isinstance(value, Mapping) else {home: value}
    rows: list[Wave] = []
    for angle, orders in table.items():
        if angle not in ANGLES:
            raise ModelError(f"{angle!r}: expected one of {', '.join(ANGLES)}")
        if not isinstance(orders, list) or not orders:
            raise ModelError(f"{orders!r}: expected a list of orders per turn, e.g. [2, 7.5]")
        rows += [Wave(angle, _order(order)) for order in orders]
    names = [label(row, home) for row in rows]
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise ModelError(f"order {twice} appears twice: expected each once")
    return tuple(rows)


def _order(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= HIGHEST_ORDER:
        raise ModelError(f"{value!r}: expected an order per turn above 0 and at most {HIGHEST_ORDER:g}")
    return float(f"{value:.6g}")
