"""Force and pressure against safe limits."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.health.alarms import AlarmBook
from edge_daemon.health.safe_limits import SafeLimits, SafeRange
from edge_daemon.records import NE107, Block


def block(force: np.ndarray, flawed: int = 0) -> Block:
    flaws = np.zeros(len(force), dtype=np.uint8)
    flaws[:flawed] = 1
    return Block("axis", 0, 0.0, 1000.0, {"force_axial_N": force}, {"force_axial_N": flaws})


def watched() -> SafeLimits:
    return SafeLimits({"force_axial_N": SafeRange("N", -500.0, 2000.0)})


@pytest.mark.parametrize(
    ("size", "key"), [(2100.0, "force_axial_N above limit"), (-501.0, "force_axial_N below limit")]
)
def test_a_passed_limit_is_out_of_specification_until_it_was_seen(size: float, key: str) -> None:
    limits, book = watched(), AlarmBook("axis")
    over = np.zeros(100)
    over[40:43] = size
    limits.follow(block(over))
    (event,) = book.update(1.0, limits.findings())
    assert (event.source, event.severity) == (key, NE107.OUT_OF_SPECIFICATION)
    assert f"{size:.4g} N" in event.message
    limits.follow(block(np.zeros(100)))
    assert not book.update(2.0, limits.findings())
    assert [alarm.key for alarm in book.raised] == [key]
    book.acknowledge(3.0)
    assert not book.raised


def test_single_readings_and_flawed_ones_are_no_overload() -> None:
    limits = watched()
    spike = np.zeros(100)
    spike[50:52] = 9000.0
    limits.follow(block(spike))
    broken = np.full(100, 9000.0)
    broken[60:] = 0.0
    limits.follow(block(broken, flawed=60))
    assert not any(finding.high for finding in limits.findings())


def test_just_inside_the_limit_the_alarm_stays() -> None:
    limits = watched()
    limits.follow(block(np.full(100, 1970.0)))
    above = next(iter(limits.findings()))
    assert not above.high and above.low
