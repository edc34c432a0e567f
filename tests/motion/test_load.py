"""Slow channels: what a thermometer says is told, however coarse it is."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.motion.load import SlowMean
from edge_daemon.records import Block


def told(*readings: float) -> list[tuple[float, float]]:
    """Value and sd after each reading, held for a block of 0.1 s."""
    mean = SlowMean("temperature", "degC", "temperature_degC", 1.0)
    rows = []
    for i, reading in enumerate(readings):
        held = {"temperature_degC": np.full(100, reading)}
        row = mean.update(Block("joint", i, i / 10, 1000.0, held, {"temperature_degC": np.zeros(100, np.uint8)}))
        assert row.usable
        rows.append((row.value, row.sd))
    return rows


def test_a_reading_that_never_changes_is_told_from_the_first_on() -> None:
    assert told(25.0, 25.0, 25.0) == [(25.0, 1.0)] * 3


def test_the_deviation_is_that_from_reading_to_reading() -> None:
    rng = np.random.default_rng(4)
    value, sd = told(*(25.0 + 0.3 * rng.standard_normal(400)))[-1]
    assert sd == pytest.approx(0.3, rel=0.4) and abs(value - 25.0) < 1.0
