"""A model's offsets as tables: CSV for people, a C header for drives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge_daemon.compensate.feedforward import PARTS, Feedforward, Trajectory
from edge_daemon.compensate.shaper import Resonance, impulses, resonance
from edge_daemon.effects.model import ModelError
from edge_daemon.records import Array
from edge_daemon.text import number

ANGLES = 720
"""Rows over a motor turn: half a degree, at which the highest usual order (14) errs by 0.2 % between rows."""
TORQUES = 101
"""Rows over the torque, both signs."""


def kinematic_table(ready: Feedforward, limit_rad: float) -> tuple[Array, Array]:
    """Motor angle over a turn and the motor offset [rad], 0 where it is off; of waves of the motor's turn only."""
    angle = 2.0 * math.pi * np.arange(ANGLES) / ANGLES
    if "kinematic" in ready.off:
        return angle, np.zeros(ANGLES)
    offset = -ready.model.ratio * ready.error(angle, np.zeros(ANGLES))
    return angle, np.clip(offset, -limit_rad, limit_rad)


def twist_table(ready: Feedforward, most_Nm: float, limit_rad: float) -> tuple[Array, Array]:
    """Torque at the output [N m] and the motor offset [rad] at rest, 0 where it is off."""
    torque = np.linspace(-most_Nm, most_Nm, TORQUES)
    if "twist" in ready.off:
        return torque, np.zeros(TORQUES)
    still = np.zeros(TORQUES)
    phi = np.array(
        [ready.twist(Trajectory(1.0, still[:1], still[:1], still[:1], torque[k : k + 1]))[1][0] for k in range(TORQUES)]
    )
    return torque, np.clip(ready.model.ratio * phi, -limit_rad, limit_rad)


def tables(ready: Feedforward, most_Nm: float, limit_rad: float, confirmed: bool) -> Tables:
    """All of a model's offsets; `confirmed` where a recording was asked."""
    try:
        found = resonance(ready.model)
    except ModelError:
        found = None
    kinematic, twist = kinematic_table(ready, limit_rad), twist_table(ready, most_Nm, limit_rad)
    return Tables(ready, kinematic, twist, found, limit_rad, confirmed)


@dataclass(frozen=True, slots=True)
class Tables:
    """Offsets over the motor's turn and over the torque, and the resonance that a shaper calms."""

    ready: Feedforward
    kinematic: tuple[Array, Array]
    twist: tuple[Array, Array]
    found: Resonance | None
    limit_rad: float
    confirmed: bool

    def as_csv(self) -> str:
        """Both tables under one header; `table` says which a row belongs to."""
        lines = ["table,theta_in_rad,torque_out_Nm,offset_in_rad"]
        lines += [f"kinematic,{angle:.9g},,{offset:.9g}" for angle, offset in zip(*self.kinematic, strict=True)]
        lines += [f"twist,,{torque:.9g},{offset:.9g}" for torque, offset in zip(*self.twist, strict=True)]
        return "\n".join(lines) + "\n"

    def as_header(self, name: str) -> str:
        """A C header: tables as constants, and a function that looks them up. C99, no library but math.h."""
        rows = [
            f"/* motor offsets of {name.replace('*/', '')}; written by edge-daemon compensate */",
            *(f"/* {part} is off: {why.replace('*/', '')} */" for part, why in self.ready.off.items()),
            "#ifndef EDGE_DAEMON_OFFSETS_H",
            "#define EDGE_DAEMON_OFFSETS_H",
            "#include <math.h>",
            f"#define ED_RATIO {self.ready.model.ratio:.9g}",
            f"#define ED_ANGLES {ANGLES}",
            f"#define ED_TORQUES {TORQUES}",
            f"#define ED_TORQUE_MAX_NM {self.twist[0][-1]:.9g}",
            *_shaper_lines(self.found),
            _array("ed_kinematic_rad", self.kinematic[1]),
            _array("ed_twist_rad", self.twist[1]),
            LOOK_UP,
            "#endif",
        ]
        return "\n".join(rows) + "\n"

    def to_json(self) -> dict[str, Any]:
        """What is used, how large it is, and the shaper."""
        shaper = None
        if self.found is not None:
            times, shares = impulses(self.found)
            shaper = {"frequency_hz": self.found.frequency_hz, "damping": self.found.damping}
            shaper |= {"times_s": times.tolist(), "shares": shares.tolist()}
        off = self.ready.off
        parts = {
            part: {"on": part not in off, "why": off.get(part), "largest_rad": float(np.abs(rows[1]).max())}
            for part, rows in zip(PARTS, (self.kinematic, self.twist), strict=True)
        }
        return {"parts": parts, "confirmed": self.confirmed, "limit_rad": self.limit_rad, "shaper": shaper}

    def in_words(self) -> str:
        """For a terminal."""
        lines = []
        for part, row in self.to_json()["parts"].items():
            lines.append(
                f"{part}: "
                + (f"up to {number(row['largest_rad'])} rad at the motor" if row["on"] else f"off: {row['why']}")
            )
        if self.found is not None:
            lines.append(f"shaper: {number(self.found.frequency_hz)} Hz, damping {number(self.found.damping, 2)}")
        if not self.confirmed:
            lines.append("not confirmed: --recording REC switches off what a recording of this drive does not bear out")
        return "\n".join(lines)


def _shaper_lines(found: Resonance | None) -> list[str]:
    if found is None:
        return []
    times, shares = impulses(found)
    rows = [
        f"#define ED_SHAPER_{k}_S {t:.9g}\n#define ED_SHAPER_{k}_SHARE {s:.9g}"
        for k, (t, s) in enumerate(zip(times, shares, strict=True))
    ]
    return [f"/* ZVD shaper of {found.frequency_hz:.4g} Hz, damping {found.damping:.3g} */", *rows]


def _array(name: str, values: Array) -> str:
    numbers = ", ".join(
        f"{value:.7g}f" if "." in f"{value:.7g}" or "e" in f"{value:.7g}" else f"{value:.7g}.0f" for value in values
    )
    return f"static const float {name}[{len(values)}] = {{{numbers}}};"


LOOK_UP = """/* motor offset [rad] at a motor angle [rad] and an output torque [N m] */
static inline float ed_offset_rad(float theta_in_rad, float torque_Nm)
{
    const float turn = 6.28318530718f;
    float a = theta_in_rad / turn;
    a = (a - floorf(a)) * ED_ANGLES;
    int i = (int)a;
    float s = a - (float)i;
    i %= ED_ANGLES;
    float k = ed_kinematic_rad[i] * (1.0f - s) + ed_kinematic_rad[(i + 1) % ED_ANGLES] * s;
    float b = (torque_Nm / (float)ED_TORQUE_MAX_NM + 1.0f) * 0.5f * (ED_TORQUES - 1);
    b = b < 0.0f ? 0.0f : (b > ED_TORQUES - 1.001f ? ED_TORQUES - 1.001f : b);
    int j = (int)b;
    float t = b - (float)j;
    return k + ed_twist_rad[j] * (1.0f - t) + ed_twist_rad[j + 1] * t;
}"""
"""Linear between rows; round the turn for the angle, held at the ends for the torque."""
