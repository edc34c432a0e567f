"""What an order per turn is called: one table, by what in the gear turns so often."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from edge_daemon.effects.effect import Wave
from edge_daemon.effects.model import ModelError, Teeth

OrderOf = Callable[[Teeth], float]


class OrderName(NamedTuple):
    """One row: a wave of an angle, and what makes it."""

    name: str
    angle: str
    order: OrderOf
    """of the gear's teeth"""
    counted: bool = False
    """whether it takes the number of teeth to know it"""


NAMES = (
    OrderName("wave generator, once per turn: off centre", "input", lambda teeth: 1),
    OrderName("wave generator, twice per turn: its two lobes", "input", lambda teeth: 2),
    OrderName("wave generator, four times per turn: harmonic of its lobes", "input", lambda teeth: 4),
    OrderName(
        "wave generator against the output, twice per turn: its lobes in the flexspline", "difference", lambda teeth: 2
    ),
    OrderName("output, once per turn: off centre", "output", lambda teeth: 1),
    OrderName("output, twice per turn: out of round", "output", lambda teeth: 2),
    OrderName("circular spline tooth pass", "output", lambda teeth: teeth.circular, True),
    OrderName("flexspline tooth pass", "output", lambda teeth: teeth.flexspline, True),
    OrderName("circular spline tooth pass, twice a tooth", "output", lambda teeth: 2 * teeth.circular, True),
    OrderName("flexspline tooth pass, twice a tooth", "output", lambda teeth: 2 * teeth.flexspline, True),
)
"""Orders with a known cause, the usual before the rare."""
POLES = (6, 8, 10, 12, 14, 16, 20, 22, 24, 28)
"""Orders per motor turn that magnets make: the pole counts of the servo motors in joints (guess: makers' sheets)."""
NEAR = 1e-4
"""Relative difference up to which two orders are one."""


def name_of(wave: Wave, ratio: float, teeth: Teeth | None) -> str:
    """What makes a wave, in words; empty where nothing in the table turns so often.

    Where the teeth are not known, those that the ratio suggests say only what an order fits.
    """
    row = cause_of(wave, ratio, teeth)
    if row is not None:
        order = row.order(teeth or likely_teeth(ratio))
        return row.name if teeth is not None or not row.counted else f"fits a {row.name} ({order:.0f} teeth)"
    if wave.angle == "input" and wave.order in POLES:
        return f"fits a motor of {wave.order:.0f} poles"
    return ""


def cause_of(wave: Wave, ratio: float, teeth: Teeth | None) -> OrderName | None:
    """The row of the table that turns as often; teeth pass as often, on whatever angle it is said."""
    rows = (row for row in NAMES if row.angle == wave.angle or row.counted)
    own = per_output_turn(wave, ratio)
    return next((row for row in rows if abs(_per_turn(row, ratio, teeth) - own) <= NEAR * own), None)


def known_waves(ratio: float, teeth: Teeth | None = None) -> list[Wave]:
    """The waves of the table."""
    known = teeth or likely_teeth(ratio)
    return [Wave(row.angle, float(row.order(known))) for row in NAMES]


def _per_turn(row: OrderName, ratio: float, teeth: Teeth | None) -> float:
    return per_output_turn(Wave(row.angle, row.order(teeth or likely_teeth(ratio))), ratio)


def per_output_turn(wave: Wave, ratio: float) -> float:
    """Order of a wave per turn of the output, of a gear that does not twist."""
    turns: Mapping[str, float] = {"input": abs(ratio), "output": 1.0, "difference": abs(ratio - 1.0)}
    return wave.order * turns[wave.angle]


def likely_teeth(ratio: float) -> Teeth:
    """Teeth of a gear of two lobes and that ratio. Makers cut 50, 80, 100, 120 and 160, which are what the flexspline
    turning gives; 51, 81, 101 and so on are the same gears with the circular spline turning."""
    whole = max(round(abs(ratio)), 2)
    flexspline = 2 * whole if ratio < 0 or whole % 10 == 0 else 2 * whole - 2
    return Teeth(flexspline, flexspline + 2)


def ratio_of(teeth: Teeth) -> float:
    """Ratio with the flexspline turning, as gears are mounted as a rule."""
    return -teeth.flexspline / (teeth.circular - teeth.flexspline)


def agree(teeth: Teeth, ratio: float) -> None:
    """Raises `ModelError` where no mounting of these teeth has that ratio."""
    apart = teeth.circular - teeth.flexspline
    ratios = {teeth.circular / apart: "circular spline", teeth.flexspline / apart: "flexspline"}
    if not any(abs(abs(ratio) - size) <= NEAR * size for size in ratios):
        said = " or ".join(f"{size:.6g} with the {part} turning" for size, part in ratios.items())
        raise ModelError(
            f"joint.ratio: {ratio:g}: {teeth.flexspline}/{teeth.circular} teeth make {said}, of either sign"
        )
