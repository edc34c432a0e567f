"""What conditioning costs: microseconds per block of 100 samples and four channels."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from bench_row import Row

from edge_daemon.condition.conditioner import Conditioner
from edge_daemon.config.settings import ChannelSettings, Drive
from edge_daemon.records import Readings

RATE_HZ = 1000.0
BATCH = 20
"""readings per push: the reader wakes every 20 ms"""
SECONDS = 10
REPEATS = 10
"""the least of them: the machine may be busy with something else"""
LIMIT_US = 150.0
"""per block: at ten blocks a second 0.15 % of a core"""


def drive() -> Drive:
    """Two encoders, a torque and a temperature, with every check switched on."""
    return Drive(
        name="bench",
        modbus_device_id=1,
        model="none.toml",
        channels=(
            ChannelSettings(
                channel="theta_in_rad",
                source="can",
                signal="in",
                counts_per_turn=131072,
                wrap_counts=2**32,
                max_rate=400.0,
                frozen_after_s=0.5,
            ),
            ChannelSettings(
                channel="theta_out_rad",
                source="can",
                signal="out",
                counts_per_turn=1 << 24,
                wrap_counts=1 << 24,
                max_rate=4.0,
                frozen_after_s=0.5,
            ),
            ChannelSettings(
                channel="torque_in_Nm", source="can", signal="torque", unit="mN m", maximum=5.0, minimum=-5.0
            ),
            ChannelSettings(channel="temperature_degC", source="i2c", signal="t", unit="degC", stale_after_s=5.0),
        ),
    )


def batches(skew_s: float) -> Iterator[list[Readings]]:
    """Twenty milliseconds at a time; `skew_s` between the encoders, 0 = latched together."""
    for first in range(0, int(SECONDS * RATE_HZ), BATCH):
        time_s = 1.7e9 + np.arange(first, first + BATCH) / RATE_HZ
        angle = 100.0 * np.sin(2.0 * (time_s - 1.7e9))
        batch = [
            Readings("can", "in", time_s, np.rint(angle * 131072 / 6.2832) % 2**32),
            Readings("can", "out", time_s + skew_s, np.rint(angle / 100 * 2**24 / 6.2832) % 2**24),
            Readings("can", "torque", time_s, np.rint(1000 * np.cos(angle))),
        ]
        if first % 1000 == 0:
            batch.append(Readings("i2c", "t", time_s[:1], np.array([40.0])))
        yield batch


def cost_us(skew_s: float) -> float:
    """Per block, `push` included."""
    conditioner = Conditioner(drive())
    feed = list(batches(skew_s))
    blocks = 0
    begun = time.perf_counter()
    for batch in feed:
        for readings in batch:
            conditioner.push(readings)
        blocks += len(conditioner.blocks(float(batch[0].time_s[-1])))
    return 1e6 * (time.perf_counter() - begun) / blocks


def rows() -> list[Row]:
    """The figures of this subject."""
    latched, free = (min(cost_us(skew_s) for _ in range(REPEATS)) for skew_s in (0.0, 2e-4))
    return [
        Row("block of 100 x 4, encoders latched together", latched, "us", LIMIT_US),
        Row("block of 100 x 4, two channels interpolated", free, "us", 2 * LIMIT_US),
    ]


if __name__ == "__main__":
    for row in rows():
        print(f"{row.name}: {row.value:.3g} {row.unit}")
