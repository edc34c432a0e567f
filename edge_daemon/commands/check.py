"""`check` and `export`: what a person runs beside the daemon, without disturbing it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from edge_daemon.commands.configuration_notes import notes
from edge_daemon.commands.uncertainty_budget import Operation, UncertaintyBudget, budget, installation_of
from edge_daemon.config.settings import Drive, Settings
from edge_daemon.effects.model import Model
from edge_daemon.effects.torque_source import COSTS, torque_source
from edge_daemon.errors import BadInput
from edge_daemon.recordings.recording import write_recording
from edge_daemon.service.configuration import examined, model_and_gear
from edge_daemon.service.sound_export import export_sound
from edge_daemon.show.guard import Guard
from edge_daemon.store.export import recording_of
from edge_daemon.store.reader import StoreReader
from edge_daemon.store.salvage import salvaged
from edge_daemon.text import number, table
from edge_daemon.usage.gears import Gear

AGES_S = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86_400.0}
EXPECTED_MOTION_HZ = 5.0
"""The budget takes a brisk machine axis (guess; the page computes it from the measured motion)."""
RATED_SPEED_IN_RAD_S = 3000 * math.pi / 30
"""The budget takes the articles' largest motor speed."""


def report(file: Path) -> str:
    """What `check` prints. Raises `BadInput` for the first thing that is wrong."""
    settings = examined(file)
    Guard(settings.dashboard, file.parent)
    parts = [f"{file}: valid: {len(settings.drive)} drives, {len(settings.sources)} sources", _sources(settings)]
    for drive in settings.drive:
        model, gear = model_and_gear(drive, file.parent)
        parts.append(_drive(settings, drive, model, gear))
    parts += [f"note: {line}" for line in notes(settings, file)]
    return "\n\n".join(parts)


def _sources(settings: Settings) -> str:
    used = [row.source for drive in settings.drive for row in drive.channels]
    used += [drive.sound.source for drive in settings.drive if drive.sound]
    rows = [(s.name, type(s).__name__.removesuffix("Source"), str(used.count(s.name))) for s in settings.sources]
    return table(("source", "kind", "channels"), rows)


def _drive(settings: Settings, drive: Drive, model: Model, gear: Gear | None) -> str:
    effects = ", ".join(effect.name for effect in model.effects)
    head = f"drive {drive.name}: device id {drive.modbus_device_id}, model of {effects}"
    source = torque_source((row.channel for row in drive.channels), model.output_inertia_kg_m2)
    if model.balance == "torsion" and source:
        head += f"\ntorque from {source}: {COSTS[source]}"
    stiffness = model.value(
        "linear_stiffness", "stiffness", (gear.stiffness_1_Nm_per_rad or math.nan) if gear else math.nan
    )
    installation = installation_of(
        settings,
        drive,
        ratio=model.ratio,
        inertia_kg_m2=model.output_inertia_kg_m2,
        stiffness_Nm_per_rad=stiffness,
        corners_Nm=(gear.corner_1_Nm, gear.corner_2_Nm) if gear else (None, None),
    )
    if installation is None or not math.isfinite(stiffness * model.output_inertia_kg_m2):
        return f"{head}\nwhat it can see is not computed: that wants two encoders, a gear and the output inertia"
    speed = min(RATED_SPEED_IN_RAD_S / abs(model.ratio), 2 * math.pi * EXPECTED_MOTION_HZ)
    return f"{head}\n{_budget(budget(installation, Operation(EXPECTED_MOTION_HZ, speed)), speed)}"


def _budget(found: UncertaintyBudget, speed_rad_s: float) -> str:
    motion = f"what it can see, moving as a sine of {EXPECTED_MOTION_HZ:g} Hz up to {speed_rad_s:.3g} rad/s:"
    rows = [(row.name, number(row.value, 3), row.unit, row.meaning) for row in found.rows]
    refused = "".join(f"\n  not {effects}: {why}" for effects, why in found.refused)
    named = ", ".join(found.named) or "none"
    return "\n".join(
        [motion, table(("figure", "value", "unit", "meaning"), rows), f"can be named: {named}{refused}", found.advice]
    )


def export(store: Path, out: Path, since: str | None, drive: str | None, orders: Sequence[float] | None = None) -> str:
    """What `export` says, after writing the recording, or the sound with the levels of `orders` where they are given.

    Raises `BadInput`.
    """
    if not store.is_file():
        raise BadInput(f"{store}: cannot read: {'not a file' if store.exists() else 'no such file'}: expected a store")
    if out.suffix not in (".csv", ".parquet"):
        raise BadInput(f"--out {out}: ends in {out.suffix or 'nothing'}: expected .csv or .parquet")
    with StoreReader(store) as reader:
        name = _which_drive(store, reader.drives(), drive)
        newest_s = reader.newest_s()
        if orders is not None:
            return export_sound(reader, out, name, since_s(since, newest_s), orders)
        time_s, columns = recording_of(reader, name, since_s(since, newest_s))
    if not len(time_s):
        raise BadInput(f"{store}: no samples of {name} since {since}: the newest is of {_iso(newest_s)}")
    write_recording(out, time_s, columns)
    lost = f"\n{reader.damaged_rows} rows were changed on the disk and left out" if reader.damaged_rows else ""
    span = f"{_iso(time_s[0])} to {_iso(time_s[-1])}"
    return f"{out}: {len(time_s)} samples of {name}, {span}: {', '.join(columns)}{lost}"


def salvage(store: Path, out: Path | None) -> str:
    """What `salvage` says, after copying what can be read of a damaged store. Raises `BadInput`."""
    target = out or store.with_name(f"{store.name}.salvaged")
    done = salvaged(store, target)
    rows = [(name, str(kept), str(lost)) for name, (kept, lost) in done.items()]
    return (
        f"{table(('rows', 'kept', 'lost'), rows)}\n{target}: written; stop the daemon and put it in the store's place"
    )


def _which_drive(store: Path, drives: tuple[str, ...], wanted: str | None) -> str:
    if wanted is None and len(drives) == 1:
        return drives[0]
    if wanted not in drives:
        raise BadInput(
            f"{store}: drive {wanted!r}: expected --drive with one of {', '.join(drives) or '(none stored)'}"
        )
    return wanted


def since_s(text: str | None, newest_s: float) -> float:
    """Seconds since the epoch from seconds, an ISO time, or an age before the newest sample. Raises `BadInput`.

    A time without a zone is UTC, as everything that the page and this command print.
    """
    if text is None:
        return 0.0
    age = re.fullmatch(r"(\d+\.?\d*)([smhd])", text)
    if age:
        return newest_s - float(age[1]) * AGES_S[age[2]]
    try:
        return float(text)
    except ValueError:
        pass
    try:
        moment = datetime.fromisoformat(text)
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    except ValueError as error:
        raise BadInput(f"--since {text!r}: expected seconds since the epoch, an ISO time, or an age as 10m") from error


def _iso(time_s: float) -> str:
    return datetime.fromtimestamp(time_s, UTC).isoformat(timespec="milliseconds") if math.isfinite(time_s) else "never"
