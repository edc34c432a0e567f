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

SECONDS = 120
RATE_HZ = 1000.0


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


def snapshot(number: int) -> Snapshot:
    """Every quantity there is."""
    time_s = 1.7e9 + number
    estimates = {
        row.name: Estimate(row.name, 1.0 + number * 1e-6, 0.01, row.unit, Status.VALID, time_s)
        for row in QUANTITIES.values()
    }
    return Snapshot("bench", number, time_s, NE107.OK, (), estimates)


def written_bytes() -> int:
    """Bytes this process has caused to be written to disks."""
    lines = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return int(lines["write_bytes"])


def rows() -> list[Row]:
    """The figures of this subject."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        path = Path(folder) / "bench.sqlite"
        store = Store(Settings(max_mib=64), path)
        took: list[float] = []
        before = written_bytes()
        for number in range(SECONDS):
            for block in second(number, rng):
                store.add_block(block)
            store.add_snapshot(snapshot(number))
            store.save_state("bench/estimates", bytes(4000))
            begun = time.perf_counter()
            store.commit()
            took.append(time.perf_counter() - begun)
        written = written_bytes() - before
        store.close()
        kept = file_bytes(path)
    per_hour = 3600 / SECONDS / 2**20
    raw = SECONDS * RATE_HZ * 4 * 9
    return [
        Row("store, 4 channels at 1 kHz with estimates", kept * per_hour, "MiB per drive and hour"),
        Row("store, the same as plain arrays", raw * per_hour, "MiB per drive and hour"),
        Row("store, a default ring of 512 MiB holds", 480 / (kept * per_hour), "h of one drive"),
        Row("store, commit of one second, median", 1e3 * float(np.median(took)), "ms"),
        Row("store, commit of one second, worst", 1e3 * max(took), "ms"),
        Row("store, bytes written per byte kept", written / kept, "1"),
    ]


if __name__ == "__main__":
    for row in rows():
        print(f"{row.name}: {row.value:.3g} {row.unit}")
