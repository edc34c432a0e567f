"""Data time against a wall clock that is stepped, slewed and wrong."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.clock import STEP_S, Clock


class Clocks:
    """A wall and a monotonic clock under the test's control."""

    def __init__(self) -> None:
        self.wall_s = 1_763_700_000.0
        self.monotonic_s = 50.0
        self.clock = Clock(lambda: self.wall_s, lambda: self.monotonic_s)

    def passes(self, seconds: float, slew: float = 0.0) -> None:
        """Time goes on; the wall clock by a little more or less."""
        self.monotonic_s += seconds
        self.wall_s += seconds * (1 + slew)


def test_it_is_the_wall_clock_while_nothing_happens() -> None:
    clocks = Clocks()
    for _ in range(10):
        clocks.passes(12.5)
        assert clocks.clock.time_s() == pytest.approx(clocks.wall_s, abs=1e-6)
    assert clocks.clock.wall_offset_s == pytest.approx(0.0, abs=1e-6)


def test_a_step_ahead_is_followed_at_once_and_counted() -> None:
    clocks = Clocks()
    before_s = clocks.clock.time_s()
    clocks.wall_s += 3600.0
    assert clocks.clock.time_s() == pytest.approx(before_s + 3600.0, abs=1e-6)
    assert (clocks.clock.steps_forward, clocks.clock.steps_back) == (1, 0)


def test_a_step_back_is_ridden_out_on_the_monotonic_clock_and_counted_once() -> None:
    clocks = Clocks()
    before_s = clocks.clock.time_s()
    clocks.wall_s -= 3600.0
    for second in range(1, 100):
        clocks.passes(1.0)
        assert clocks.clock.time_s() == pytest.approx(before_s + second, abs=1e-6)
    assert (clocks.clock.steps_forward, clocks.clock.steps_back) == (0, 1)
    assert clocks.clock.wall_offset_s == pytest.approx(-3600.0, abs=1e-6)


def test_a_second_step_back_after_the_first_was_mended_is_counted_again() -> None:
    clocks = Clocks()
    clocks.wall_s -= 100.0
    clocks.clock.time_s()
    clocks.wall_s += 100.0
    clocks.clock.time_s()
    clocks.wall_s -= 100.0
    clocks.clock.time_s()
    assert (clocks.clock.steps_forward, clocks.clock.steps_back) == (0, 2)


def test_slewing_below_a_step_moves_nothing() -> None:
    clocks = Clocks()
    begun_s = clocks.clock.time_s()
    clocks.passes(STEP_S / 1e-3 * 0.9, slew=1e-3)
    assert clocks.clock.time_s() - begun_s == pytest.approx(STEP_S / 1e-3 * 0.9, abs=1e-6)
    assert clocks.clock.steps_forward == 0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_never_runs_back_whatever_the_wall_clock_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clocks = Clocks()
    last_s = clocks.clock.time_s()
    for _ in range(2000):
        clocks.passes(float(rng.exponential(0.1)))
        if rng.random() < 0.1:
            clocks.wall_s += float(rng.normal(0, 100))
        now_s = clocks.clock.time_s()
        assert now_s >= last_s
        last_s = now_s


def test_a_drivers_stamp_keeps_its_age_across_a_step_between() -> None:
    clocks = Clocks()
    clocks.wall_s -= 500.0
    now_s = clocks.clock.time_s()
    assert clocks.clock.from_wall_s(clocks.wall_s - 0.02) == pytest.approx(now_s - 0.02, abs=1e-6)
    assert clocks.clock.from_wall_s(clocks.wall_s + 7.0) <= now_s, "a stamp from the future was taken now"
