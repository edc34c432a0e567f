"""What the store costs: bytes per drive and hour, time of a commit, bytes written per byte kept."""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path

import numpy as np
from bench_row import Row

from edge_daemon.config.settings import StoreSettings as Settings
from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import NE107, Block, Estimate, Snapshot, Status
from edge_daemon.store.ring import Store, file_bytes

SECONDS = 600
RATE_HZ = 1000.0
INTERVALS_S = (1, 10, 30)
MOST_PER_KEPT, MOST_MB_PER_DAY = 2.5, 600.0
CARD_TB = 3.2
"""A card of 32 GB bears a thousand writes of its size, and makes ten of each small one that is synced (guess: cheap and
industrial cards are a factor of three to either side)."""


def second(number: int, rng: np.random.Generator) -> list[Block]:
    """Two encoders with half a count of noise, a torque in steps of a per mille, a held temperature."""
    time_s = number + np.arange(1000) / RATE_HZ
    angle = np.sin(2 * math.pi * 0.3 * time_s)
    values = {
        "theta_in_rad": np.rint(100 * angle * 2**17 / (2 * math.pi) + rng.normal(0, 0.5, 1000)) * (2 * math.pi / 2**17),
        "theta_out_rad": np.rint(angle * 2**20 / (2 * math.pi) + rng.normal(0, 0.5, 1000)) * (2 * math.pi / 2**20),
        "torque_in_Nm": np.rint(500 * np.cos(2 * math.pi * 0.3 * time_s) + rng.normal(0, 3, 1000)) * 0.00064,
        "temperature_degC": np.full(1000, 40.0 + 0.01 * (number // 10)),
    }
    clean = np.zeros(100, dtype=np.uint8)
    return [
        Block(
            "bench",
            10 * number + i,
            1.7e9 + number + i / 10,
            RATE_HZ,
            {name: row[100 * i : 100 * i + 100] for name, row in values.items()},
            dict.fromkeys(values, clean),
        )
        for i in range(10)
    ]


def snapshot(number: int, rng: np.random.Generator) -> Snapshot:
    """Every quantity there is, each wandering a little within its deviation."""
    time_s = 1.7e9 + number
    estimates = {
        row.name: Estimate(
            row.name, 1.0 + 1e-3 * rng.normal(), 0.01 + 1e-5 * rng.normal(), row.unit, Status.VALID, time_s
        )
        for row in QUANTITIES.values()
    }
    return Snapshot("bench", number, time_s, NE107.OK, (), estimates)


def written_bytes() -> int:
    """Bytes this process has caused to be written to disks."""
    lines = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return int(lines["write_bytes"])


def run(interval_s: int) -> tuple[float, float, list[float]]:
    """Bytes written and kept, and how long each commit took [s], where one is made every so often."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        path = Path(folder) / "bench.sqlite"
        store = Store(Settings(max_mib=64), path)
        took: list[float] = []
        before = written_bytes()
        for number in range(SECONDS):
            for block in second(number, rng):
                store.add_block(block)
            store.add_snapshot(snapshot(number, rng))
            if number % 10 == 0:
                store.save_state("bench/estimates", rng.bytes(4000))
            if (number + 1) % interval_s == 0:
                begun = time.perf_counter()
                store.commit()
                took.append(time.perf_counter() - begun)
        store.close()
        return float(written_bytes() - before), float(file_bytes(path)), took


def rows() -> list[Row]:
    """The figures of this subject."""
    out, per_hour, per_day = [], 3600 / SECONDS / 2**20, 86_400 / SECONDS / 1e6
    for interval_s in INTERVALS_S:
        written, kept, took = run(interval_s)
        usual = interval_s == Settings().commit_every_s
        name, years = f"store, a commit every {interval_s} s", CARD_TB * 1e6 / (written * per_day) / 365.25
        out += [
            Row(f"{name}: written", written * per_day, "MB per day", MOST_MB_PER_DAY if usual else math.nan),
            Row(f"{name}: written per byte kept", written / kept, "1", MOST_PER_KEPT if usual else math.nan),
            Row(f"{name}: a card of 32 GB lasts", years, "years"),
            Row(f"{name}: a commit, median", 1e3 * float(np.median(took)), "ms"),
            Row(f"{name}: a commit, worst", 1e3 * max(took), "ms"),
        ]
    raw = SECONDS * RATE_HZ * 4 * 9
    return [
        *out,
        Row("store, 4 channels at 1 kHz with estimates", kept * per_hour, "MiB per drive and hour"),
        Row("store, the same as plain arrays", raw * per_hour, "MiB per drive and hour"),
        Row("store, a default ring of 512 MiB holds", 480 / (kept * per_hour), "h of one drive"),
    ]


if __name__ == "__main__":
    for row in rows():
        print(f"{row.name}: {row.value:.3g} {row.unit}")
