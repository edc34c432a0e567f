"""What the columns of a recording without names may be, told from their values: time, and the two angles of a gear.

A time rises by even steps; of two columns that are the angles at both ends of a gear one is the other times its ratio.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from edge_daemon.records import Array

PIECES, PIECE_BYTES = 48, 4096
"""So many places of a file are read, since many recordings begin at rest."""
LEAST_ROWS = 50
"""Fewer rows tell nothing (guess)."""
EVEN = 0.5
"""A step of a time differs from the median step by no more than this share of it, where a logger jitters (guess)."""
LEAST_RATIO, MOST_RATIO = 20.0, 400.0
"""Strain wave gears are made from 30 to 320; the rest is for a column that is not quite straight."""
MOST_LEFT = 0.02
"""Of the spread of an angle, that the other one times the ratio leaves: a twist is some thousandths of a turn."""
JOINT_TURN_RAD = 7.0
"""An output that turns further than this was logged in degrees: a robot's joint makes one turn at most (guess)."""
TIME_UNITS = ((0.2, "s"), (100.0, "ms"), (np.inf, "us"))
"""A step below so much is one of seconds, of milliseconds or else of microseconds: loggers take 10 to 5 000 rows a
second."""

Guess = dict[str, str | bool]


def guessed(path: Path, mark: str, columns: int) -> list[Guess]:
    """`channel`, `unit` and `reverse` for each column; empty where the values say nothing."""
    found: list[Guess] = [{"channel": "", "unit": "", "reverse": False} for _ in range(columns)]
    rows = _spread_rows(path, mark, columns)
    if len(rows) < LEAST_ROWS:
        return found
    at = next((i for i in range(columns) if _is_time(rows[:, i])), None)
    if at is None:
        return found
    found[at] |= {"channel": "time_s", "unit": _time_unit(rows[:, at])}
    pair = _angles(rows, [i for i in range(columns) if i != at])
    if pair:
        motor, output, slope = pair
        unit = "deg" if np.ptp(rows[:, output]) > JOINT_TURN_RAD else "rad"
        found[motor] |= {"channel": "theta_in_rad", "unit": unit, "reverse": slope < 0.0}
        found[output] |= {"channel": "theta_out_rad", "unit": unit}
    return found


def _spread_rows(path: Path, mark: str, columns: int) -> Array:
    """Whole rows from all over the file, (n, columns)."""
    size = path.stat().st_size
    rows: list[list[float]] = []
    with path.open("rb") as file:
        for piece in range(min(PIECES, max(size // PIECE_BYTES, 1))):
            file.seek(piece * (size // PIECES) if size > PIECES * PIECE_BYTES else piece * PIECE_BYTES)
            lines = file.read(PIECE_BYTES).decode("utf-8-sig", errors="replace").splitlines()
            rows += [row for line in lines[min(piece, 1) : -1] if len(row := _numbers(line, mark)) == columns]
    return np.array(rows).reshape(-1, columns)


def _numbers(line: str, mark: str) -> list[float]:
    cells = line.split(mark) if mark in line else line.split()
    try:
        return [float(cell.replace(",", ".") if mark != "," else cell) for cell in cells]
    except ValueError:
        return []


def _is_time(column: Array) -> bool:
    steps = np.diff(column)
    step = np.median(steps)
    return bool(step > 0.0 and (steps > 0.0).all() and np.mean(np.abs(steps - step) <= EVEN * step) > 0.9)


def _time_unit(column: Array) -> str:
    step = np.median(np.diff(column))
    return next(unit for most, unit in TIME_UNITS if step < most)


def _angles(rows: Array, among: list[int]) -> tuple[int, int, float] | None:
    """Column of the motor, of the output, and the ratio with its sign; None where no two go together."""
    best, found = MOST_LEFT, None
    centred = rows - rows.mean(axis=0)
    spread = centred.std(axis=0)
    for motor, output in itertools.permutations(among, 2):
        if not (spread[output] > 0.0 and LEAST_RATIO <= spread[motor] / spread[output] <= MOST_RATIO):
            continue
        slope = float(centred[:, motor] @ centred[:, output] / (centred[:, output] @ centred[:, output]))
        left = float((centred[:, motor] - slope * centred[:, output]).std() / spread[motor])
        if left < best:
            best, found = left, (motor, output, slope)
    return found
