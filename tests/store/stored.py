"""Blocks and states to be stored, and how to tell that they came back."""

from __future__ import annotations

import math
import sqlite3
from pathlib import Path

import numpy as np

from edge_daemon.config.settings import StoreSettings as Settings
from edge_daemon.records import NE107, Array, Block, Estimate, Flaw, Snapshot, Status
from edge_daemon.store.ring import Store

EPOCH_S = 1_763_700_000.0
SMALL = Settings(max_mib=8)


def block(number: int, drive: str = "axis", values: dict[str, Array] | None = None) -> Block:
    """A tenth of a second: an encoder, and noise that cannot be compressed."""
    rng = np.random.default_rng(number)
    made = values or {
        "theta_out_rad": np.cumsum(rng.integers(-9, 9, 100)) * (2 * math.pi / 2**20),
        "torque_out_Nm": rng.normal(0, 1, 100),
    }
    flaws = {name: np.where(np.isnan(row), int(Flaw.MISSING), 0).astype(np.uint8) for name, row in made.items()}
    return Block(drive, number, EPOCH_S + number / 10, 1000.0, made, flaws)


def snapshot(second: float, drive: str = "axis", value: float = 1.0, state: NE107 = NE107.OK) -> Snapshot:
    time_s = EPOCH_S + second
    estimates = {
        name: Estimate(name, value, 0.1, "1", status, time_s)
        for name, status in (("stiffness", Status.VALID), ("damping", Status.WARMING_UP))
    }
    return Snapshot(drive, int(second), time_s, state, (), estimates)


def filled(store: Store, first: int, last: int) -> None:
    """Blocks of the seconds [first, last), committed second by second."""
    for second in range(first, last):
        for number in range(10 * second, 10 * second + 10):
            store.add_block(block(number))
        store.add_snapshot(snapshot(second))
        store.save_state("newest", str(second).encode())
        store.commit()


def same(stored: Block, given: Block) -> bool:
    """To the last bit, flaws included."""
    return (
        (stored.drive, stored.sequence, stored.start_s, stored.rate_hz)
        == (given.drive, given.sequence, given.start_s, given.rate_hz)
        and all(np.array_equal(stored.values[name], given.values[name], equal_nan=True) for name in given.values)
        and all(np.array_equal(stored.flaws[name], given.flaws[name]) for name in given.values)
    )


def sound(path: Path) -> bool:
    with sqlite3.connect(path) as database:
        return bool(database.execute("PRAGMA integrity_check").fetchone() == ("ok",))
