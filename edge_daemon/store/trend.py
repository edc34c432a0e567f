"""A long span of the store as a few hundred points per quantity: seconds to years at the same price.

Recent points come from snapshots, found by one seek each, however many lie between; older ones from hourly means.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import msgspec
import numpy as np

from edge_daemon.records import Array, Estimate
from edge_daemon.store.hours import HOUR_S, Mean
from edge_daemon.store.reader import StoreReader
from edge_daemon.store.rows import DAMAGE

MOST_POINTS = 1000
GAP_STEPS = 5.0
"""A line is broken after so many usual steps without data."""
GAP_HOURS = 2.5
"""A line of hourly means is broken after so many hours without one."""
GUESSED = "rul_"
"""Quantities of this name are worth showing before they are valid: the maker's expectation."""
PEAKS = ("torque_peak",)
"""Of these the largest of an hour counts, not the mean."""


@dataclass(frozen=True, slots=True)
class Trend:
    """Columns over common times; NaN where a quantity was not known, and at an instant within every gap."""

    time_s: Array
    """(n,)"""
    value: dict[str, Array]
    """(n,) each"""
    sd: dict[str, Array]
    """(n,) each"""


class _Point(NamedTuple):
    time_s: float
    hourly: bool
    rows: dict[str, tuple[float, float]]
    """name -> value and sd"""


def trend(reader: StoreReader, drive: str, names: Sequence[str], since_s: float, until_s: float, points: int) -> Trend:
    """At most about `points` instants of the span [since_s, until_s). Raises `StoreError`, `ValueError`."""
    if not (since_s < until_s and math.isfinite(since_s) and math.isfinite(until_s)):
        raise ValueError(f"since_s, until_s: {since_s:g} to {until_s:g}: expected a span of time")
    if not 2 <= points <= MOST_POINTS:
        raise ValueError(f"points: {points}: expected 2 to {MOST_POINTS}")
    width_s = max((until_s - since_s) / points, 1.0)
    recent = _snapshots(reader, drive, names, since_s, until_s, width_s)
    begin_s = reader.first_snapshot_s(drive)
    older = _hours(reader, drive, names, since_s, min(until_s, begin_s), width_s)
    return _columns(names, [*older, *recent], width_s)


def _snapshots(
    reader: StoreReader, drive: str, names: Sequence[str], since_s: float, until_s: float, width_s: float
) -> list[_Point]:
    """The newest snapshot of each `width_s`."""
    found = []
    for time_s, estimates in reader.newest_of_each(drive, since_s, until_s, width_s):
        rows = {name: (row.value, row.sd) for name in names if (row := estimates.get(name)) and _shown(row)}
        found.append(_Point(time_s, False, rows))
    return found


def _shown(row: Estimate) -> bool:
    return row.usable or (row.name.startswith(GUESSED) and math.isfinite(row.value))


def _hours(
    reader: StoreReader, drive: str, names: Sequence[str], since_s: float, until_s: float, width_s: float
) -> list[_Point]:
    """Means over `width_s` of the hours that end before `until_s`, each by how often it was estimated."""
    wanted = msgspec.defstruct("Wanted", [(name, Mean | None, None) for name in names])
    sums: dict[int, list[tuple[int, object]]] = {}
    for hour, data in reader.packed_hours(drive, since_s, until_s):
        if (hour + 1) * HOUR_S <= until_s:
            place = int((hour * HOUR_S - since_s) / max(width_s, HOUR_S))
            try:
                sums.setdefault(place, []).append((hour, msgspec.msgpack.decode(data, type=wanted)))
            except DAMAGE:
                reader.damaged_rows += 1
    found = []
    for rows in sums.values():
        middle_s = (sum(hour for hour, _ in rows) / len(rows) + 0.5) * HOUR_S
        found.append(_Point(middle_s, True, {n: mean for n in names if (mean := _mean([r for _, r in rows], n))}))
    return found


def _mean(rows: Sequence[object], name: str) -> tuple[float, float] | None:
    known: list[Mean] = [mean for row in rows if (mean := getattr(row, name)) is not None and mean.count]
    if not known:
        return None
    count, total, total_sd = 0, 0.0, 0.0
    for mean in known:
        count += mean.count
        total += mean.mean * mean.count
        total_sd += mean.sd * mean.count
    value = max(mean.highest for mean in known) if name in PEAKS else total / count
    return value, total_sd / count


def _columns(names: Sequence[str], points: Sequence[_Point], width_s: float) -> Trend:
    points = _with_gaps(points, width_s)
    nothing = (math.nan, math.nan)
    both = {
        name: np.array([point.rows.get(name, nothing) for point in points], dtype=float).reshape(-1, 2)
        for name in names
    }
    time_s = np.array([point.time_s for point in points], dtype=float)
    return Trend(time_s, {n: row[:, 0] for n, row in both.items()}, {n: row[:, 1] for n, row in both.items()})


def _with_gaps(points: Sequence[_Point], width_s: float) -> list[_Point]:
    """With an empty instant where nothing was stored for long, so that no line bridges it."""
    found = list(points[:1])
    for last, point in pairwise(points):
        longest_s = max(GAP_STEPS * width_s, GAP_HOURS * HOUR_S if last.hourly else 0.0)
        if point.time_s - last.time_s > longest_s:
            found.append(_Point(last.time_s + width_s, False, {}))
        found.append(point)
    return found
