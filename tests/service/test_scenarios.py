"""Something goes wrong with a commissioned drive: no number is called usable that is not true, and it comes back.

A few fast ones; `tools/bench.py scenarios` has all of them.
"""

from __future__ import annotations

import math

import pytest

from edge_daemon.rig.faults import planned
from tests.service.scenario import Look, Scene, scene

COMMISSIONED_S = 20.0
FOUND_WITHIN_S = 12.0
"""As soon as when this test was written: 11.4 s."""


@pytest.fixture(scope="module")
def commissioned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Look]:
    """A drive that is known, and what was last said of it."""
    it = scene(tmp_path_factory.mktemp("scenario"))
    *_, last = it.run(COMMISSIONED_S)
    return it, last


def looks(commissioned: tuple[Scene, Look], fault: str, until_s: float) -> list[Look]:
    it = commissioned[0].fork()
    it.plan = [planned(fault)]
    return list(it.run(until_s))


def test_late_stamps_of_one_encoder_make_no_number_of_the_gear_false(commissioned: tuple[Scene, Look]) -> None:
    """0.3 ms is a fifth of the twist: for the balance of torques another gear."""
    standing = commissioned[1].standing()
    seen = looks(commissioned, "latch_shift_in@20-28:0.3ms", 30.0)
    assert [look.time_s for look in seen if look.wrong(standing)] == []
    assert any(look.said for look in seen)


def test_wear_is_found_as_fast_as_ever(commissioned: tuple[Scene, Look]) -> None:
    seen = looks(commissioned, "wear@20:3%", COMMISSIONED_S + FOUND_WITHIN_S)
    stiffness = seen[-1].estimates["stiffness"]
    assert seen[-1].usable("stiffness")
    assert abs(stiffness.value - seen[-1].truth["stiffness"]) < 0.003 * stiffness.value
    assert math.isclose(seen[-1].truth["stiffness"], 97_000.0)


def test_after_a_gap_all_is_known_at_once(commissioned: tuple[Scene, Look]) -> None:
    seen = looks(commissioned, "silent@20-22", 24.0)
    standing = commissioned[1].standing()
    assert not any(look.wrong(standing) for look in seen)
    assert seen[-1].usable("stiffness")
