"""Streaming rainflow against the `rainflow` library's batch result, to the last half cycle."""

from __future__ import annotations

import io
import itertools

import numpy as np
import pytest
import rainflow
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_daemon.usage.cycles import CycleCounter


def batch(series: list[float]) -> list[tuple[float, float]]:
    """The library's counts without its ranges of zero."""
    return [(height, count) for height, count in rainflow.count_cycles(series) if height > 0]


def streamed(series: list[float], cuts: list[int], restart: bool) -> list[tuple[float, float]]:
    counter = CycleCounter(1.0)
    edges = [0, *sorted(cut % (len(series) + 1) for cut in cuts), len(series)]
    for begin, end in itertools.pairwise(edges):
        counter.update(np.array(series[begin:end], dtype=float))
        if restart:
            after = CycleCounter(1.0)
            assert after.restore(counter.state())
            counter = after
    ranges, counts = counter.cycles()
    return list(zip(ranges.tolist(), counts.tolist(), strict=True))


@pytest.mark.slow
@settings(max_examples=400, deadline=None)
@given(
    # the library takes a series of two points for a constant, hence three
    series=st.lists(st.integers(-9, 9), min_size=3, max_size=80),
    cuts=st.lists(st.integers(0, 80), max_size=6),
    restart=st.booleans(),
)
def test_equals_batch_wherever_it_is_cut(series: list[int], cuts: list[int], restart: bool) -> None:
    assert streamed([float(x) for x in series], cuts, restart) == batch([float(x) for x in series])


def test_example_of_the_standard() -> None:
    """ASTM E1049-85, figure 6: half cycles of 3, 4, 6, 8, 8, 9 and one full cycle of 4."""
    counter = CycleCounter(1.0)
    counter.update(np.array([-2.0, 1, -3, 5, -1, 3, -4, 4, -2]))
    ranges, counts = counter.cycles()
    assert dict(zip(ranges, counts, strict=True)) == {3: 0.5, 4: 1.5, 6: 0.5, 8: 1.0, 9: 0.5}


def test_a_day_of_noise_keeps_memory_bounded() -> None:
    rng = np.random.default_rng(7)
    counter = CycleCounter(0.05)
    for _ in range(200):
        counter.update(40 * np.sin(np.arange(1000) / 80) + rng.normal(size=1000))
    assert counter.samples == 200_000
    assert len(counter.state()) < 20_000


def test_a_damped_swing_cannot_grow_the_residue_without_end() -> None:
    swing = 50 * 0.9999 ** np.arange(100_000) * (-1.0) ** np.arange(100_000)
    counter = CycleCounter(0.1)
    counter.update(swing)
    stack = np.load(io.BytesIO(counter.state()))["stack"]
    assert len(stack) <= 2 * 50 / 0.1 + 2


def test_bad_samples_are_left_out_and_counted() -> None:
    counter = CycleCounter(1.0)
    counter.update(np.array([0.0, np.nan, 5.0, np.inf, 0.0, 5.0]))
    assert counter.ignored == 2
    assert sum(counter.cycles()[1]) == 1.5


def test_broken_or_foreign_state_changes_nothing() -> None:
    counter = CycleCounter(1.0)
    counter.update(np.array([0.0, 5.0, 0.0]))
    before = counter.cycles()
    other = CycleCounter(0.5)
    assert not counter.restore(b"not a state")
    assert not counter.restore(counter.state()[:-20])
    assert not counter.restore(other.state())
    np.testing.assert_array_equal(counter.cycles(), before)


def test_resolution_must_be_positive() -> None:
    with pytest.raises(ValueError, match="resolution_Nm"):
        CycleCounter(0.0)
