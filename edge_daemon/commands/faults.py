"""`faults`: which fault the drifts of a history, and the lines of recordings, point to."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from edge_daemon.commands.life import history_of
from edge_daemon.errors import BadInput
from edge_daemon.faults.conditions import KNOWN, LINES
from edge_daemon.faults.orders import Bearing, line_levels, orders_of
from edge_daemon.faults.posterior import FaultPosterior, posterior
from edge_daemon.health.trends import watched
from edge_daemon.prognose.history import usable
from edge_daemon.recordings.recording import read_recording
from edge_daemon.records import Array
from edge_daemon.text import table, written_as_json
from edge_daemon.usage.gears import Gear, find_gear

SIGNALS = ("sound", "vibration", "torque_in_Nm", "torque_out_Nm", "current_in_A")
"""Lines are looked for in the first of these columns that both recordings have: what hears a blow best comes first."""


def faults(arguments: argparse.Namespace) -> None:
    """The posterior over the faults of a gear. Raises `BadInput` where nothing can be told."""
    if (arguments.recording is None) != (arguments.reference is None):
        raise BadInput("--recording and --reference: expected both, the gear now and when it was well")
    gear, bearing = find_gear(arguments.gear), _bearing(arguments.bearing)
    time_h, columns, _ = history_of(arguments.history)
    if time_h.size < 2:
        raise BadInput(f"{arguments.history}: {time_h.size} rows: expected a history from commissioning to now")
    try:
        kept_h, kept = usable(time_h, columns, gear)
    except BadInput as error:
        raise BadInput(f"{arguments.history}: {error}") from error
    drifts = watched(kept_h, kept, gear).scaled()
    if arguments.recording is not None:
        drifts |= _lines(arguments.recording, arguments.reference, gear, bearing)
    if not drifts:
        wanted = ", ".join(row for row in KNOWN if not row.startswith("order_"))
        raise BadInput(f"{arguments.history}: no condition is known long enough: expected columns such as {wanted}")
    told = posterior(drifts)
    if written_as_json(_document(gear, float(kept_h[-1]), told, drifts), arguments.json):
        return
    print(f"{gear.name} after {kept_h[-1]:.0f} h: {told.in_words()}")
    order = sorted(told.kinds, key=lambda kind: -told.kinds[kind])
    print(table(("fault", "probability"), [(kind, f"{told.kinds[kind]:.1%}") for kind in order]))
    print(f"what is measured leaves open: {', '.join(told.possible)}")
    rows = [(KNOWN[name].meaning, f"{drift:+.1f}", f"{sd:.1f}") for name, (drift, sd) in drifts.items()]
    print("drifts since commissioning, in units of what matters of each:")
    print(table(("condition", "drift", "sd"), rows))


def _document(
    gear: Gear, time_h: float, told: FaultPosterior, drifts: Mapping[str, tuple[float, float]]
) -> dict[str, Any]:
    return {
        "gear": gear.name,
        "time_h": time_h,
        "named": told.named or None,
        "finest": told.finest or None,
        "possible": list(told.possible),
        "kinds": dict(told.kinds),
        "faults": dict(told.rows),
        "drifts": [{"condition": name, "drift": drift, "sd": sd} for name, (drift, sd) in drifts.items()],
        "advice": told.in_words(),
    }


def _bearing(text: str | None) -> Bearing | None:
    """`23,0.1`: balls, and ball over pitch diameter."""
    if text is None:
        return None
    balls, _, size = text.partition(",")
    try:
        bearing = Bearing(int(balls), float(size))
    except ValueError:
        raise BadInput(f"--bearing {text!r}: expected balls and ball over pitch diameter, such as 23,0.1") from None
    if not (3 <= bearing.balls <= 200 and 0.0 < bearing.ball_over_pitch < 0.5):
        raise BadInput(f"--bearing {text!r}: expected 3 to 200 balls and a ratio of diameters between 0 and 0.5")
    return bearing


def _lines(now: Path, before: Path, gear: Gear, bearing: Bearing | None) -> dict[str, tuple[float, float]]:
    """How each line grew from the recording of the gear when it was well, in units of what matters."""
    recordings = [read_recording(path) for path in (before, now)]
    signal = next((name for name in SIGNALS if all(name in one.columns for one in recordings)), "")
    if not signal:
        raise BadInput(f"{now}, {before}: expected one of the columns {', '.join(SIGNALS)} in both")
    levels = []
    for path, one in zip((before, now), recordings, strict=True):
        angle = _angle(path, one.columns, gear)
        good = np.isfinite(angle) & np.isfinite(one.columns[signal])
        levels.append(line_levels(angle[good], one.columns[signal][good], orders_of(bearing, gear.ratio)))
        if not levels[-1]:
            raise BadInput(f"{path}: too short: expected some 100 turns of the motor in one direction")
    well, ill = levels
    matters = {row.name: row.matters for row in LINES}
    return {
        name: ((ill[name][0] - well[name][0]) / matters[name], math.hypot(ill[name][1], well[name][1]) / matters[name])
        for name in well
        if name in ill
    }


def _angle(path: Path, columns: Mapping[str, Array], gear: Gear) -> Array:
    for name, factor in (("theta_in_rad", 1.0), ("theta_out_rad", gear.ratio)):
        if name in columns:
            return columns[name] * factor
    raise BadInput(f"{path}: no column theta_in_rad: expected it, or theta_out_rad, beside the sound or torque")
