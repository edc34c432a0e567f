"""Commands about a gear's life, from files: life and learn. No daemon, no bus."""

from __future__ import annotations

import argparse
import math
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.fleet.prior import prior_at
from edge_daemon.prognose.experience import MEMBERS
from edge_daemon.prognose.forecast import MAKERS, NAMES, Prior
from edge_daemon.prognose.history import LifeReport, life_of_history, usable
from edge_daemon.prognose.learn import FailedGear, learn_law, learn_life, prior_from_bytes, prior_to_bytes
from edge_daemon.recordings.csv_file import RecordingError
from edge_daemon.recordings.recording import Notes, read_recording
from edge_daemon.records import Array
from edge_daemon.text import closest, indented, number, table, written_as_json
from edge_daemon.usage.gears import Gear, find_gear

TIME = "time_h"
USED = (
    *("speed_in_rpm", "torque_cubic_mean_Nm", "torque_peak_Nm", "temperature_degC", "stiffness_Nm_per_rad"),
    *(f"noise_a{b}" for b in range(5)),
)
"""These columns of a history stand beside its time."""
CLOSE = 0.75
"""A name this like another is taken for a slip of the pen (guess)."""
LEAST_FACTOR, MOST_FACTOR = 0.0, 5.0
"""Beyond five times the past load it is another machine."""


def life(arguments: argparse.Namespace) -> None:
    """Damage and remaining life from a history file."""
    if not LEAST_FACTOR <= arguments.load_factor <= MOST_FACTOR:
        raise BadInput(f"--load-factor {arguments.load_factor:g}: expected {LEAST_FACTOR:g} to {MOST_FACTOR:g}")
    gear = find_gear(arguments.gear)
    time_h, columns, repairs = history_of(arguments.history)
    prior = _prior(arguments.prior, gear, time_h, columns) if arguments.prior else MAKERS
    try:
        report = life_of_history(time_h, columns, gear, arguments.load_factor, prior, repairs)
    except BadInput as error:
        raise BadInput(f"{arguments.history}: {error}") from error
    if written_as_json(report.to_json(), arguments.json):
        return
    _tell(gear, report)


def _tell(gear: Gear, report: LifeReport) -> None:
    print(f"{gear.name} after {number(report.time_h)} h: {report.state.name.lower().replace('_', ' ')}")
    print(f"fatigue life used: {report.damage:.1%}")
    p10, p50, p90 = map(_hours, (report.p10_h, report.p50_h, report.p90_h))
    print(f"remaining life: {p50} h (median); 9 of 10 such gears exceed {p10} h, 1 of 10 exceeds {p90} h")
    rows = [(f"{within:.0f}", f"{probability:.1%}") for within, probability in report.failure_probability]
    print(table(("within h", "failure probability"), rows))
    for reason in report.reasons:
        print(indented(reason))


def _hours(hours: float) -> str:
    """To three digits: a life is not known to the hour."""
    return f"{float(f'{hours:.3g}'):.0f}"


def learn(arguments: argparse.Namespace) -> None:
    """What histories of failed gears teach, as a prior for `life` and in words."""
    gear = find_gear(arguments.gear)
    lives = []
    for path in arguments.histories:
        time_h, columns, _ = history_of(path)
        if not time_h.size:
            raise BadInput(f"{path}: no rows: expected a history that ends with the gear's failure")
        try:
            lives.append(FailedGear(*usable(time_h, columns, gear)))
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
    prior = learn_life(gear, lives, [path.name for path in arguments.histories])
    try:
        arguments.out.write_bytes(prior_to_bytes(prior))
    except OSError as error:
        raise BadInput(f"{arguments.out}: cannot write: {error.strerror}") from error
    law, alike = learn_law(gear, lives), prior.kinds[0].alone
    spans = {name: (law.quantile(name, 0.5), *law.interval(name)) for name in ("m", "gamma", "log_C", "scatter")}
    document = {
        "gear": gear.name,
        "gears": len(lives),
        "prior": [dict(zip(("name", "mean", "sd"), row, strict=True)) for row in _learned(prior)],
        "alike": alike,
        "members": _weights(prior),
        "damage_law": {name: dict(zip(("median", "from", "to"), span, strict=True)) for name, span in spans.items()},
    }
    if written_as_json(document, arguments.json):
        return
    print(f"{arguments.out}: learned from {len(lives)} gears of {gear.name}; the spread is that between gears")
    rows = [(name, number(mean), number(sd, 2)) for name, mean, sd in _learned(prior)]
    print(table(("parameter", "mean", "sd"), rows))
    weights = ", ".join(f"{name} {weight:.0%}" for name, weight in _weights(prior).items())
    print(f"members of the forecast, by how well they forecast gears that were left out: {weights}")
    print(f"chance that one wear shows in stiffness and noise alike: {alike:.0%}")
    print("damage law dD/dN = C (torque / ultimate torque / (1 - gamma dK))^m, 90 % intervals:")
    print(table(("parameter", "median", "from", "to"), [(n, *map(number, span)) for n, span in spans.items()]))


def _weights(prior: Prior) -> dict[str, float]:
    """How much each member of the forecast counts."""
    past = prior.experience
    return {} if past is None else dict(zip(MEMBERS, past.weights, strict=True))


def _learned(prior: Prior) -> Iterator[tuple[str, float, float]]:
    """Each parameter of a learned prior with its mean and sd."""
    (kind,) = prior.kinds
    yield "log_fatigue", kind.fatigue[0], kind.fatigue[1]
    for condition, belief in (("stiffness", kind.stiffness), ("noise", kind.noise)):
        for name, mean, variance in zip(NAMES, belief.mean, np.diagonal(belief.cover), strict=True):
            yield f"{condition} {name}", float(mean), math.sqrt(variance)


def _prior(path: Path, gear: Gear, time_h: Array, columns: dict[str, Array]) -> Prior:
    """What `learn` or `fleet learn` has written; the latter is worked out at the load of this history."""
    try:
        blob = path.read_bytes()
        return prior_at(blob, gear, time_h, columns) or prior_from_bytes(blob)
    except OSError as error:
        raise BadInput(f"{path}: cannot read: {error.strerror}") from error
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error


def history_of(path: Path) -> tuple[Array, dict[str, Array], list[str]]:
    """Hours, columns and what reading had to repair. A file with a header and no rows is a gear without a past."""
    try:
        read = read_recording(path, time=TIME, least=1)
    except RecordingError as error:
        if "no rows below the header" in str(error):
            return np.empty(0), {}, []
        raise
    return read.time_s, dict(read.columns), [*_repairs(read.notes), *_slips(read.columns)]


def _slips(columns: Collection[str]) -> Iterator[str]:
    """Columns that nothing is read from, though one much like them would be."""
    missing = [name for name in USED if name not in columns]
    for name in columns:
        close = closest(name, missing, CLOSE) if name not in USED else ""
        if close:
            yield f"column {name!r} is not used: did you mean {close!r}?"


def _repairs(notes: Notes) -> Iterator[str]:
    """What a reader of the answer must know of the file's flaws. Missing values are told where they are assumed."""
    if notes.reordered:
        yield f"check the logger's clock: time ran backward before {notes.reordered} rows, which were sorted"
    if notes.duplicates:
        yield f"{notes.duplicates} rows repeated a time and were merged"
    if notes.untimed_rows:
        yield f"{notes.untimed_rows} rows without a time were left out"
    if notes.broken_rows:
        yield f"{notes.broken_rows} rows with a wrong number of cells were left out"
