"""Power cuts: the emulator is killed at a random moment; what the guest had not synced is lost."""

from __future__ import annotations

import json
import random
import time
from dataclasses import dataclass

from edge_daemon.store.reader import StoreError
from field import record
from field.cases import Bench
from field.machine import Machine, running

COMMIT_S = 4.0
"""[store] commit_every_s of the guest's configuration."""
EVENT_S = 2.0
"""Events are written within so many seconds of being told; their own time may be that of samples long past."""
SLACK_S = 3.0
"""A commit itself takes this long on an emulated disk of a busy computer (guess)."""
LONGEST_S = 10.0
"""A cut comes within so many seconds of the snapshot, and of the reload that makes an event."""
HELD = "tests/store/test_power_loss.py"


def name(number: int) -> str:
    """Of the table's line."""
    return f"{number} power cuts at random moments, commits every {COMMIT_S:.0f} s"


@dataclass(slots=True)
class Cut:
    """What one cut cost."""

    problem: str
    """empty: the store opened and everything promised was in it"""
    lost_s: float
    """of samples that the daemon had worked off"""
    grave: bool = False
    """whatever the computer was busy with"""


def cuts(machine: Machine, number: int, seed: int) -> list[Cut]:
    """So many cuts, each from the snapshot on."""
    rng = random.Random(seed)
    return [_cut(machine, rng) for _ in range(number)]


def _cut(machine: Machine, rng: random.Random) -> Cut:
    with running(machine):
        Bench(machine).well()
        machine.do("systemctl reload edge-daemon.service")
        before = json.loads(machine.page("/api/state").said)
        time.sleep(rng.uniform(0.0, LONGEST_S))
        state = json.loads(machine.page("/api/state").said)
        time.sleep(rng.uniform(0.0, 0.2))
    record.copy(machine.folder / "data.qcow2", machine.folder)
    try:
        kept = record.read(record.taken(machine.folder))
    except (record.Damaged, StoreError, OSError) as error:
        return Cut(f"does not open: {error}", float("nan"), grave=True)
    lost_s = max(0.0, state["drives"][record.DRIVE]["time_s"] - kept.newest_s)
    written = state["time_s"] - before["time_s"] > EVENT_S + SLACK_S
    told = {(row["time_s"], row["message"]) for row in before["events"] if written}
    missing = told - {(event.time_s, event.message) for event in kept.events}
    faults = {
        kept.damage(): kept.damage(),
        f"{lost_s:.1f} s lost": lost_s > COMMIT_S + SLACK_S,
        f"events lost: {sorted(missing)[:2]}": missing,
    }
    return Cut(", ".join(name for name, bad in faults.items() if bad), lost_s, bool(kept.damage()))
