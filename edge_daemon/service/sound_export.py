"""The sound that a store keeps, as tables: spectra with the levels of orders, and the bursts of alarms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.recordings.recording import write_recording
from edge_daemon.sound.kept_sound import CURRENT, bursts, heard, order_level
from edge_daemon.store.reader import StoreReader


def export_sound(reader: StoreReader, out: Path, drive: str, begin_s: float, orders: Sequence[float]) -> str:
    """What was written: a row per hour and speed with the levels of `orders`, and bursts beside. Raises `BadInput`."""
    blobs = reader.states(f"{drive}/{CURRENT}")
    spectra = [one for one in heard(blobs) if one.time_s >= begin_s]
    kept = [(why, burst) for why, burst in bursts(blobs) if burst.time_s >= begin_s]
    if not spectra and not kept:
        raise BadInput(f"{out}: no sound of {drive} is kept: expected [drive.sound] in its configuration, and to run")
    grid = np.unique(np.concatenate([np.empty(0), *(one.frequency_hz for one in spectra)]))
    levels = np.full((len(spectra), grid.size), np.nan)
    for row, one in zip(levels, spectra, strict=True):
        row[np.searchsorted(grid, one.frequency_hz)] = one.psd
    columns = {
        "speed_in_rad_s": np.array([one.speed_rad_s for one in spectra]),
        "averages": np.array([one.averages for one in spectra]),
        **{f"order_{order:g}_dB": order_level(spectra, order) for order in orders},
        **{f"psd_{hz:.4g}Hz": level for hz, level in zip(grid.tolist(), levels.T, strict=True)},
    }
    write_recording(out, np.array([one.time_s for one in spectra]), columns)
    told = [f"{out}: {len(spectra)} spectra of {drive}, each of an hour at one speed"]
    for i, (why, burst) in enumerate(kept, 1):
        file = out.with_name(f"{out.stem}.burst{i}{out.suffix}")
        write_recording(file, burst.time_s + np.arange(len(burst.value)) / burst.rate_hz, {"sound": burst.value})
        told.append(f"{file}: heard when {why}")
    return "\n".join(told)
