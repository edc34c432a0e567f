"""Axes that are an expression of channels, of what the motion has been through or of what the gear carries, and the
kinds of factors they may stand in."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from edge_daemon.effects.expression import LOAD, MOTOR, parse
from edge_daemon.records import Array

NUMBER = re.compile(r"[0-9.]+(e[-+]?[0-9]+)?")
SINCE_REVERSAL, SINCE_TWIST_REVERSAL = "since(time_s, velocity_out_rad_s)", "since(time_s, twist_rate_rad_s)"
WAY_GONE = "way(theta_out_rad)"
TURNED = {
    SINCE_REVERSAL: "velocity_out_rad_s",
    SINCE_TWIST_REVERSAL: "twist_rate_rad_s",
    WAY_GONE: "velocity_out_rad_s",
}
"""What must have turned round for an axis to be more than the clock, or the place, under another name."""
LEAST_REVERSALS, STILL = 3, 0.1
"""Times that it must have: fewer are as many events of the clock; and its size over the rms below which it stands still
(guesses)."""
FADING = ("power_1", "exponential", "reciprocal")
"""Kinds that a law may hold of what comes up or fades."""
LEVEL = ("affine", "power_1", "exponential", "size", "above", "below")
"""Kinds that a law may hold of what a sensor beside the joint tells."""


DIFFERENCE = re.compile(r"\((\w+) - (\w+)\)")
"""An axis of what one sensor tells more than another of its unit: what parts of a joint differ by in temperature, or
what presses on one side more than on the other."""


def differences(sensors: Iterable[str]) -> list[str]:
    """Such axes of some sensors beside the joint, whose names end with their units."""
    rows = sorted(sensors, key=lambda name: (len(name), name))
    return [f"({b} - {a})" for a, b in itertools.combinations(rows, 2) if _unit(a) == _unit(b)]


def _unit(sensor: str) -> str:
    return sensor.rsplit("_", 1)[-1]


@dataclass(frozen=True, slots=True)
class Lagging:
    """An axis of what follows a channel with a time, or carries it without an inertia, which stands where the text has
    an @."""

    text: str
    words: str
    unit: str
    times_s: tuple[float, ...]
    """where it is looked for first"""
    kinds: tuple[str, ...]
    over: str = "time"
    """what stands at the @: a `time`, a `way`, or a share of the model's `inertia`"""

    def at(self, time_s: float) -> str:
        """The axis of one time, or of what stands there."""
        return self.text.replace("@", f"{time_s:.3g}")

    def time_of(self, axis: str) -> float | None:
        """The time of an axis; None where it is another one."""
        before, after = self.text.split("@")
        inner = axis.removeprefix(before).removesuffix(after)
        return float(inner) if axis == before + inner + after and NUMBER.fullmatch(inner) else None


LAGGING = (
    Lagging("(twist_rad - lag(time_s, twist_rad, @))", "the twist less what follows it with @ s", "rad",
            (0.05, 0.2, 0.8), ("power_1", "size")),
    Lagging("lag(time_s, velocity_out_rad_s**2, @)", "the square of speed as it was over the last @ s", "rad^2/s^2",
            (1.0, 4.0), FADING),
    Lagging("lag(time_s, abs(velocity_out_rad_s), @)", "the size of speed as it was over the last @ s", "rad/s",
            (1.0, 4.0), FADING),
    Lagging("lag(time_s, velocity_out_rad_s, @)", "what follows the output speed with @ s", "rad/s",
            (0.1, 0.4), ("power_1", "saturation")),
    Lagging(f"({LOAD} - @*acceleration_out_rad_s2)", "the torque that passes the gear beside a motor's inertia of @",
            "", (0.3,), ("power_1", "size", "beyond_size", "above", "below", "saturation", "dead_zone"),
            over="inertia"),
    Lagging("(theta_out_rad - lag(way(theta_out_rad), theta_out_rad, @))",
            "the output angle less what follows it over @ rad of its way", "rad",
            (0.02, 0.1, 0.5), ("power_1", "saturation"), over="way"),
)  # fmt: skip
"""A spring that relaxes, a gear that warms by its own motion, a drag that comes late; what the gear carries; friction
that comes up over a way (Dahl 1968, Aerospace Corp. TOR-158), as of a cable or a seal at the output."""
LAGS = {row.at(time_s): row for row in LAGGING for time_s in row.times_s if row.over != "inertia"}
LATER = ("lag", "delay")
LATE_S = (0.1, 0.3, 1.0, 3.0, 9.0)
"""Times by which a sensor beside the joint may be late, where the search begins."""
LATE_AXIS = re.compile(r"(lag|delay)\(time_s, (\w+), ([0-9.e+-]+)\)")


def late_channel(word: str, channel: str) -> Lagging:
    """What a sensor beside the joint tells, as it was: where it sits, all comes later than in the teeth, or earlier."""
    words = f"what follows {channel} with @ s" if word == "lag" else f"{channel} as it was @ s before"
    return Lagging(f"{word}(time_s, {channel}, @)", words, "", LATE_S, LEVEL)


def row_of(axis: str) -> Lagging | None:
    """The row of an axis, whatever its time; None where it follows nothing."""
    known = next((row for row in LAGGING if row.time_of(axis) is not None), None)
    late = LATE_AXIS.fullmatch(axis) if known is None else None
    return late_channel(late[1], late[2]) if late else known


def channel_of(axis: str) -> str:
    """The channel that an axis tells as it was; other axes as they are."""
    late = LATE_AXIS.fullmatch(axis)
    return axis if late is None or family(axis) in {row.text for row in LAGGING} else late[2]


def family(axis: str) -> str:
    """The axis, whatever the time with which it follows what was."""
    row = row_of(axis)
    return axis if row is None else row.text


def allowed(axis: str) -> tuple[str, ...] | None:
    """Kinds that a law may hold of an axis; None where that does not remember anything."""
    row = row_of(axis)
    if DIFFERENCE.fullmatch(axis):
        return LEVEL
    return ALLOWED.get(axis) if row is None else row.kinds


def words_of(axis: str) -> tuple[str, str] | None:
    """Name and unit in a sentence of an axis that is an expression; None of any other."""
    row, apart = row_of(axis), DIFFERENCE.fullmatch(axis)
    if apart is not None:
        return f"{apart[1]} less {apart[2]}", _unit(apart[1])
    return None if row is None else (row.words.replace("@", f"{row.time_of(axis) or 0.0:.3g}"), row.unit)


def turned_enough(axis: str, axes: Mapping[str, Array]) -> bool:
    """Whether what an axis counts from happened often enough, by the courses (n,) of the channels."""
    if axis not in TURNED:
        return True
    course = axes.get(TURNED[axis], np.zeros(1))
    ways = np.sign(course[np.abs(course) > STILL * np.sqrt(np.mean(course**2))])
    return int(np.count_nonzero(np.diff(ways))) >= LEAST_REVERSALS


PAST_AXES = (SINCE_REVERSAL, SINCE_TWIST_REVERSAL, WAY_GONE, *LAGS)
"""What the motion has been through, as an expression says it: an axis like any other."""
ALLOWED = {axis: FADING for axis in PAST_AXES if axis not in LAGS} | {
    MOTOR: ("power_1", "power_2", "power_3", "size", "odd_power", "saturation", "dead_zone", "beyond_size", "resonance")
}
"""Kinds that a law may hold of what is counted, and of the motor's torque."""


def late_axes(word: str, channel: str) -> list[str]:
    """What a channel told before, by `word`."""
    row = late_channel(word, channel)
    return [row.at(time_s) for time_s in row.times_s]


def load_axes(inertia: float) -> list[str]:
    """What passes the gear, without the motor's own part of the model's inertia."""
    return [row.at(share * inertia) for row in LAGGING if row.over == "inertia" for share in row.times_s]


@lru_cache(maxsize=256)
def reads(axis: str) -> frozenset[str]:
    """The channels of an axis that is an expression."""
    return frozenset(parse(f"a*{axis}").channels)
