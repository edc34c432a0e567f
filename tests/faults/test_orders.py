"""Lines at a bearing's orders, heard in blows whose places follow from rolling without slip and nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_daemon.faults.orders import Bearing, line_levels, orders_of

BALLS, BALL_MM, PITCH_MM, RATIO = 23, 4.0, 40.0, 100.0
BEARING = Bearing(BALLS, BALL_MM / PITCH_MM)
RATE_HZ = 8000.0


def blows(place: str, strength: float, seed: int = 1, seconds: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """Angle of the wave generator and sound: a ring at each instant at which a ball passes a pit, over noise.

    The inner ring turns once, the outer ring turns backward 1 / ratio; a ball's centre moves at the mean of the two
    surfaces' speeds.
    """
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    turn = 11.0 * time_s + 0.15 * np.sin(2 * math.pi * 0.1 * time_s)
    inner_mm, outer_mm = PITCH_MM - BALL_MM, PITCH_MM + BALL_MM
    cage = (inner_mm * 1.0 - outer_mm / RATIO) / (inner_mm + outer_mm)
    against = {"outer": cage + 1.0 / RATIO, "inner": 1.0 - cage}[place] * BALLS
    passed = np.floor(against * turn + rng.uniform())
    struck = np.diff(passed, prepend=passed[0]) > 0
    ring = np.exp(-np.arange(80) / 12.0) * np.sin(2 * math.pi * 2600.0 * np.arange(80) / RATE_HZ)
    sound = strength * np.convolve(struck, ring)[: time_s.size] + rng.normal(size=time_s.size)
    return turn * 2 * math.pi, sound


@pytest.mark.parametrize("place", ["outer", "inner"])
def test_a_pit_is_heard_at_its_own_ring_and_at_no_other(place: str) -> None:
    orders = orders_of(BEARING, RATIO)
    sick, well = (line_levels(*blows(place, strength, 5), orders) for strength in (1.5, 0.0))
    rise = {name: (sick[name][0] - well[name][0]) / math.hypot(sick[name][1], well[name][1]) for name in sick}
    assert max(rise, key=lambda name: rise[name]) == f"order_{place}"
    assert rise[f"order_{place}"] > 5.0
    assert max(gain for name, gain in rise.items() if name != f"order_{place}") < 4.0


def test_too_short_a_motion_tells_nothing() -> None:
    theta, sound = blows("outer", 1.0, seconds=2.0)
    assert line_levels(theta, sound, orders_of(BEARING, RATIO)) == {}


def test_the_scatter_of_lines_over_nothing_is_as_stated() -> None:
    levels = [line_levels(*blows("outer", 0.0, seed), orders_of(BEARING, RATIO)) for seed in range(12)]
    for name in ("order_outer", "order_inner", "order_teeth"):
        if name in levels[0]:
            values = np.array([one[name][0] for one in levels])
            stated = np.array([one[name][1] for one in levels])
            assert np.std(values) < 2.5 * stated.mean()


def test_without_geometry_only_the_gears_own_orders_are_known() -> None:
    assert set(orders_of(None, RATIO)) == {"order_turn", "order_lobes", "order_teeth"}
