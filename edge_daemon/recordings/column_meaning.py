"""Which channel and unit a column of somebody's recording probably is, told from its name, and what makes SI of it."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator

from edge_daemon.channels import CHANNELS
from edge_daemon.errors import BadInput
from edge_daemon.text import closest
from edge_daemon.units import UNITS

TIME = "time_s"
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
"""Units that a time may have, in seconds."""
LIKE = 0.6
"""A column whose name is this like a channel's is guessed to be it (guess)."""
HINTS = (
    (r"\b(t|time|timestamp|zeit)\b", TIME),
    (r"(motor|input|rotor|wg).*(pos|angle|theta|q)|theta_?in|q_?m\b", "theta_in_rad"),
    (r"(output|link|joint|load|out).*(pos|angle|theta|q)|theta_?out|q_?l\b", "theta_out_rad"),
    (r"current|iq\b|amp", "current_in_A"),
    (r"model.*(torque|tau)", "torque_model_Nm"),
    (r"torque|tau\b|moment", "torque_in_Nm"),
    (r"temp", "temperature_degC"),
)
"""Words that robots and drives use in their logs, and the channel that is meant."""
COUNTED = (" count", " counts", " inc", " increments", " raw", " tick", " ticks")
"""Endings of what no unit converts: an encoder's counts want its resolution."""


def meaning(name: str) -> tuple[str, str]:
    """Channel and unit of a column; empty for none."""
    channel = name if name in CHANNELS or name == TIME else ""
    words = _words(name)
    channel = channel or next((row for pattern, row in HINTS if re.search(pattern, words)), "")
    channel = channel or closest(name, CHANNELS, LIKE)
    return channel, next(_named_unit(words, channel), "") if channel else ""


def proposed(names: Iterable[str], wanted: Collection[str]) -> str:
    """What to type so that the first column that is probably one of the `wanted` channels is taken for it; empty for
    none."""
    for name in names:
        channel, unit = meaning(name)
        if channel in wanted and name not in CHANNELS and not _words(name).endswith(COUNTED):
            return f"--map '{channel}={formula_of(name, channel, unit)}'"
    return ""


def formula_of(name: str, channel: str, unit: str, *, reverse: bool = False) -> str:
    """What makes SI of a column, in the words of `column_map`. Raises `BadInput`."""
    if channel != TIME and channel not in CHANNELS:
        raise BadInput(f"channel {channel[:40]!r}: expected one of {', '.join((TIME, *CHANNELS))}")
    if unit not in units_of(channel):
        raise BadInput(f"{channel}: unit {unit[:20]!r}: expected one of {', '.join(units_of(channel))}")
    factor, offset = (TIMES[unit], 0.0) if channel == TIME else (UNITS[unit].factor, UNITS[unit].offset)
    times = "deg" if unit == "deg" else repr(factor)
    text = name if factor == 1.0 else f"{name}*{times}"
    text += f"+{offset!r}" if offset > 0 else f"-{-offset!r}" if offset < 0 else ""
    return f"-({text})" if reverse else text


def units_of(channel: str) -> tuple[str, ...]:
    """Its own first."""
    if channel == TIME:
        return tuple(TIMES)
    own = CHANNELS[channel].unit
    return (own, *(name for name, unit in UNITS.items() if unit.quantity == own and name != own))


def _words(name: str) -> str:
    return re.sub(r"[_\W]+", " ", name).lower().rstrip()


def _named_unit(words: str, channel: str) -> Iterator[str]:
    """The unit at the end of a column's name, else the channel's own."""
    last = words.split()[-1:]
    plain = {re.sub(r"\W", "", unit).lower(): unit for unit in units_of(channel)}
    yield from (plain[word] for word in last if word in plain)
    yield units_of(channel)[0]
