"""Real sizes of strain wave gears: what the maker promises, or nothing.

`gears.toml` beside this file is the catalogue; a user's own gear is a TOML file with the fields of `Gear`.
"""

from __future__ import annotations

import functools
import re
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from edge_daemon.errors import BadInput
from edge_daemon.text import read_toml

PositiveNumber = Annotated[float, Meta(gt=0)]


class GearError(BadInput):
    """One line: which gear or file, which field, what is wrong, what was expected."""


class Gear(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known of one size. Torques at the output [N m]; None is unknown, never a guess."""

    name: str
    ratio: PositiveNumber
    rated_torque_Nm: PositiveNumber
    """at `rated_speed_rpm` of the wave generator"""
    rated_speed_rpm: PositiveNumber = 2000.0
    repeated_peak_Nm: PositiveNumber | None = None
    """limit for the peaks of normal start and stop"""
    average_limit_Nm: PositiveNumber | None = None
    momentary_peak_Nm: PositiveNumber | None = None
    """limit for rare shocks: at most 1e4 wave generator half turns in a life (maker's catalogue p. 12)"""
    ratcheting_Nm: PositiveNumber | None = None
    buckling_Nm: PositiveNumber | None = None
    l10_h: PositiveNumber
    """wave generator bearing: 90 % of gears exceed this life at rated torque and speed"""
    l50_h: PositiveNumber
    corner_1_Nm: PositiveNumber | None = None
    corner_2_Nm: PositiveNumber | None = None
    stiffness_1_Nm_per_rad: PositiveNumber | None = None
    """below `corner_1_Nm`; `stiffness_2` up to `corner_2_Nm`, `stiffness_3` above"""
    stiffness_2_Nm_per_rad: PositiveNumber | None = None
    stiffness_3_Nm_per_rad: PositiveNumber | None = None
    no_load_torque_Nm: PositiveNumber | None = None
    """at the wave generator, 2000 rpm, 20 degC"""
    back_driving_Nm: PositiveNumber | None = None
    source: str = "user's file"

    @property
    def limits(self) -> tuple[tuple[str, float], ...]:
        """(name, torque [N m]) of the known limits, lowest first."""
        rows = (
            ("repeated peak", self.repeated_peak_Nm),
            ("momentary peak", self.momentary_peak_Nm),
            ("ratcheting", self.ratcheting_Nm),
            ("buckling", self.buckling_Nm),
        )
        return tuple(sorted(((name, limit) for name, limit in rows if limit is not None), key=lambda row: row[1]))


def find_gear(name: str) -> Gear:
    """The gear of a catalogue name (`CSG-20-100`) or of a TOML file. Raises `GearError` with one line."""
    if name.endswith(".toml"):
        return _from_file(Path(name))
    gears = catalogue()
    gear = gears.get(name.strip().upper())
    if gear is None:
        size = re.match(r"[A-Z]+-\d+", name.strip().upper())
        near = [known for known in gears if size and known.startswith(size.group())] or list(gears)
        raise GearError(f"gear {name!r} is not in the catalogue: expected a TOML file or one of {', '.join(near)}")
    return gear


@functools.cache
def catalogue() -> Mapping[str, Gear]:
    """All sizes of the shipped catalogue, by name."""
    table = tomllib.loads(resources.files(__package__).joinpath("gears.toml").read_text())
    rows = [(series, row) for series, rows in table["ratings"].items() for row in rows]
    gears = (_from_row(table, series, row) for series, row in rows)
    return {gear.name: gear for gear in gears}


def _from_row(table: Mapping[str, Any], series: str, row: Sequence[float]) -> Gear:
    size, ratio, rated, repeated, average, momentary, ratcheting = row
    corners = _of_size(table["stiffness"]["ratio_50" if ratio == 50 else "ratio_80_and_more"], size, 5)
    friction = _of_size(table["friction"]["ratio_100"] if ratio == 100 else [], size, 2)
    return Gear(
        name=f"{series}-{size:.0f}-{ratio:.0f}",
        ratio=float(ratio),
        rated_torque_Nm=float(rated),
        repeated_peak_Nm=repeated or None,
        average_limit_Nm=average or None,
        momentary_peak_Nm=momentary or None,
        ratcheting_Nm=ratcheting or None,
        buckling_Nm=_of_size(table["buckling"][series], size, 1)[0],
        corner_1_Nm=corners[0],
        corner_2_Nm=corners[1],
        stiffness_1_Nm_per_rad=corners[2],
        stiffness_2_Nm_per_rad=corners[3],
        stiffness_3_Nm_per_rad=corners[4],
        no_load_torque_Nm=friction[0],
        back_driving_Nm=friction[1],
        source="maker's catalogue CSF/CSG",
        **table["series"][series],
    )


def _of_size(rows: Sequence[Sequence[float]], size: float, width: int) -> list[float | None]:
    """The figures of the row that starts with `size`, 0 meaning unknown; all None without such a row."""
    for row in rows:
        if row[0] == size:
            return [figure or None for figure in row[1:]]
    return [None] * width


def _from_file(path: Path) -> Gear:
    document = read_toml(path, GearError)
    try:
        gear = msgspec.convert(document, Gear)
    except msgspec.ValidationError as error:
        raise GearError(f"{path}: {_one_line(str(error))}") from error
    if gear.l50_h <= gear.l10_h:
        raise GearError(f"{path}: l50_h: {gear.l50_h:g} is not above l10_h ({gear.l10_h:g})")
    if gear.momentary_peak_Nm and gear.repeated_peak_Nm and gear.momentary_peak_Nm <= gear.repeated_peak_Nm:
        raise GearError(f"{path}: momentary_peak_Nm: {gear.momentary_peak_Nm:g} is not above repeated_peak_Nm")
    return gear


def _one_line(message: str) -> str:
    """msgspec's `what - at `$.field`` as `field: what`."""
    found = re.fullmatch(r"(.*) - at `\$\.?(.*)`", message, re.DOTALL)
    return f"{found.group(2)}: {found.group(1)}" if found and found.group(2) else message
