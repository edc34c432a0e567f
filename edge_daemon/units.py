"""Conversion to SI at the edge: one row per unit a configuration may name."""

from __future__ import annotations

import math
from dataclasses import dataclass

from edge_daemon.channels import CHANNELS
from edge_daemon.text import closest


@dataclass(frozen=True, slots=True)
class Unit:
    """si = value * factor + offset"""

    quantity: str
    """unit of the result"""
    factor: float
    offset: float = 0.0


UNITS: dict[str, Unit] = {
    "rad": Unit("rad", 1.0),
    "deg": Unit("rad", math.pi / 180),
    "arcmin": Unit("rad", math.pi / 10_800),
    "arcsec": Unit("rad", math.pi / 648_000),
    "turn": Unit("rad", 2 * math.pi),
    "rad/s": Unit("rad/s", 1.0),
    "deg/s": Unit("rad/s", math.pi / 180),
    "rpm": Unit("rad/s", math.pi / 30),
    "N m": Unit("N m", 1.0),
    "mN m": Unit("N m", 1e-3),
    "A": Unit("A", 1.0),
    "mA": Unit("A", 1e-3),
    "degC": Unit("degC", 1.0),
    "K": Unit("degC", 1.0, -273.15),
    "degF": Unit("degC", 5 / 9, -160 / 9),
    "Pa": Unit("Pa", 1.0),
    "hPa": Unit("Pa", 100.0),
    "kPa": Unit("Pa", 1000.0),
    "mbar": Unit("Pa", 100.0),
    "bar": Unit("Pa", 1e5),
    "N": Unit("N", 1.0),
    "kN": Unit("N", 1e3),
    "1": Unit("1", 1.0),
}

SPOKEN = {"c": "degC", "celsius": "degC", "nmm": "mN m", "1/min": "rpm", "u/min": "rpm"}
"""What people write for some of them, where no letters are alike."""


def unit_problem(unit: str, channel: str) -> str:
    """Why a unit cannot be converted to the channel's own; empty if it can."""
    if unit == "SI":
        return ""
    if unit not in UNITS:
        alike = {_plain(name): name for name in ("SI", *UNITS)} | SPOKEN
        close = alike.get(closest(_plain(unit), alike))
        known_units = f"expected SI or one of {', '.join(UNITS)}"
        return f"{unit!r} is unknown: {f'did you mean {close!r}?' if close else known_units}"
    known = CHANNELS.get(channel)
    quantity = UNITS[unit].quantity
    if known is not None and known.unit != quantity:
        fitting = [name for name, row in UNITS.items() if row.quantity == known.unit]
        return f"{unit!r} is no unit of {channel}: expected one of {', '.join(fitting)}"
    return ""


def _plain(unit: str) -> str:
    """A unit without what people write differently: `Nm`, `N·m` and `N m`, `°C` and `degC`."""
    return "".join(letter for letter in unit.lower().replace("°", "deg") if letter.isalnum() or letter == "/")
