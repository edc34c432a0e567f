"""What the store kept, read here from the guest's data disk: gaps, and values that no gear can have."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edge_daemon.records import Array, Event
from edge_daemon.store.reader import StoreReader

RATIO = 100.0
MOST_TWIST_RAD = 0.03
"""Half a turn of the motor, seen from the output. The gear itself twists by some 1e-4 rad, but frames of an emulated
card are late by tens of milliseconds, in which the motor turns by a radian or two."""
LEAST_GAP_S = 0.5
"""Shorter ones are frames that the emulated card lost."""
DRIVE = "axis-1"


class Damaged(Exception):
    """The disk or the store did not come back as it was promised."""


@dataclass(slots=True)
class Kept:
    """Of one store."""

    time_s: Array
    """(n,) stamps of the samples that are good"""
    wrong: int
    """samples that cannot be true"""
    damaged_rows: int
    events: list[Event]

    def lost_s(self, begin_s: float, end_s: float) -> float:
        """How much of the span is not there, in gaps longer than `LEAST_GAP_S`."""
        inside = self.time_s[(self.time_s >= begin_s) & (self.time_s < end_s)]
        gaps = np.diff(np.concatenate(([begin_s], np.sort(inside), [end_s])))
        return float(gaps[gaps > LEAST_GAP_S].sum())

    def damage(self) -> str:
        """Empty where nothing is wrong with it."""
        found = {f"{self.wrong} wrong values": self.wrong, f"{self.damaged_rows} damaged rows": self.damaged_rows}
        return ", ".join(name for name, count in found.items() if count)

    @property
    def newest_s(self) -> float:
        """Of the last sample."""
        return float(self.time_s[-1]) if len(self.time_s) else -math.inf


def copy(disk: Path, folder: Path) -> None:
    """The guest's data disk as it is now, whether or not the guest still runs."""
    _call("qemu-img", "convert", "--force-share", "-O", "raw", disk, folder / "data.raw")


def taken(folder: Path) -> Path:
    """The store's file from the copied disk, whose file system is repaired as at a boot. Raises `Damaged`."""
    raw, out = folder / "data.raw", folder / "taken"
    checked = _call("e2fsck", "-fy", raw, good=(0, 1))
    out.mkdir(exist_ok=True)
    for name in ("store.sqlite", "store.sqlite-wal"):
        (out / name).unlink(missing_ok=True)
        _call("debugfs", "-R", f"dump /edge-daemon/{name} {out / name}", raw)
    raw.unlink()
    store = out / "store.sqlite"
    if not store.exists() or not store.stat().st_size:
        raise Damaged(f"no store: {checked[-300:]}")
    return store


def read(store: Path) -> Kept:
    """Everything of a store. Raises `StoreError` for one that cannot be opened."""
    with StoreReader(store) as reader:
        if reader.database.execute("PRAGMA integrity_check").fetchone() != ("ok",):
            raise Damaged("integrity_check")
        blocks = list(reader.blocks(DRIVE))
        events = reader.events()
        damaged = reader.damaged_rows
    times, wrong = [np.zeros(0)], 0
    for block in blocks:
        angle_in, angle_out = (block.values[name] for name in ("theta_in_rad", "theta_out_rad"))
        good = np.isfinite(angle_in) & np.isfinite(angle_out)
        for name in ("theta_in_rad", "theta_out_rad"):
            good &= block.flaws[name] == 0
        times.append((block.start_s + np.arange(len(angle_in)) / block.rate_hz)[good])
        twist = angle_in[good] / RATIO - angle_out[good]
        wrong += int(np.count_nonzero(np.abs(twist - np.median(twist)) > MOST_TWIST_RAD)) if good.any() else 0
    return Kept(np.concatenate(times), wrong, damaged, events)


def _call(*command: str | Path, good: Iterable[int] = (0,)) -> str:
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode not in good:
        raise Damaged(f"{words[0]}: {done.returncode}: {done.stderr[-300:]}{done.stdout[-300:]}")
    return done.stdout
