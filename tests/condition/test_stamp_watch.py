"""Stamps of an encoder that is read a thousand times a second, as clocks, buses and gateways spoil them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from edge_daemon.condition.stamp_watch import GIVES_IN_S, StampWatch
from edge_daemon.records import Array

PERIOD_S, BATCH = 1e-3, 100
SEED = 20261123


def batches(time_s: Array) -> Iterator[Array]:
    yield from (time_s[i : i + BATCH] for i in range(0, len(time_s), BATCH))


def told_s(time_s: Array, from_s: float) -> float:
    """When jumps are told first, after `from_s`; NaN for never."""
    watch = StampWatch()
    for part in batches(time_s):
        watch.see(part, PERIOD_S)
        if watch.jump_s:
            return float(part[-1]) - from_s
    return float("nan")


def even(seconds: float) -> Array:
    return PERIOD_S * np.arange(round(seconds / PERIOD_S))


@pytest.mark.parametrize("size_s", [1e-3, -1e-3, 2e-4, -4e-4, 0.02])
def test_stamps_that_jump_now_and_then_are_told_in_time(size_s: float) -> None:
    rng, time_s = np.random.default_rng(SEED), even(30.0)
    time_s += 5e-6 * rng.normal(size=len(time_s))
    for i in range(150, 300):
        if rng.random() < 0.2:
            time_s[i * BATCH : (i + 1) * BATCH] += size_s
    assert 0.0 < told_s(time_s, 15.0) < 3.0
    watch = StampWatch()
    for part in batches(time_s):
        watch.see(part, PERIOD_S)
    assert watch.jump_s == pytest.approx(abs(size_s) if abs(size_s) <= PERIOD_S else 0.02 + PERIOD_S, rel=0.1)


def test_what_is_no_jump_is_not_told() -> None:
    rng, time_s = np.random.default_rng(SEED), even(30.0)
    lost = time_s[rng.random(len(time_s)) < 0.5]
    late = np.where(time_s > 20.0, time_s + 0.3e-3, time_s)  # set once
    bus = np.sort(time_s + 1e-4 * rng.standard_t(3, size=len(time_s)))
    slow = time_s * (1 + 1e-4)
    for course in (time_s, lost, late, bus, slow, np.where(time_s > 20.0, time_s + 3600.0, time_s)):
        assert np.isnan(told_s(course, 0.0))


def test_a_bus_that_delays_a_frame_now_and_then_is_usual_or_becomes_so() -> None:
    rng = np.random.default_rng(SEED)
    time_s = even(3 * GIVES_IN_S)
    late = rng.random(len(time_s)) < 2e-3
    always, later = (time_s + np.where(late & (time_s > begin_s), 3e-3, 0.0) for begin_s in (0.0, 30.0))
    assert np.isnan(told_s(always, 0.0))
    watch, told = StampWatch(), []
    for part in batches(later):
        watch.see(part, PERIOD_S)
        told.append(watch.jump_s > 0)
    assert 0 < sum(told) * BATCH * PERIOD_S < 1.2 * GIVES_IN_S and not told[-1]


def test_where_it_stops_it_is_over_within_seconds() -> None:
    time_s = even(30.0)
    for i in range(100, 150, 3):
        time_s[i * BATCH : (i + 1) * BATCH] += 1e-3
    watch, until_s = StampWatch(), 0.0
    for part in batches(time_s):
        watch.see(part, PERIOD_S)
        until_s = float(part[-1]) if watch.jump_s else until_s
    assert 15.0 < until_s < 20.0
