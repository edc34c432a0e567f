"""A heavier load is no softer gear, and a softer gear is no lighter load."""

from __future__ import annotations

import pytest

from edge_daemon.health.load_change import LoadChange
from edge_daemon.records import Estimate, Status

BEFORE = {"stiffness": (1e5, 50.0), "damping": (12.0, 0.1), "coulomb_friction": (1.0, 0.002)}
LESS = 0.91


def told(watch: LoadChange, values: dict[str, tuple[float, float]], status: Status = Status.VALID) -> set[str]:
    """Names of the estimates that are invalid after these."""
    rows = {name: Estimate(name, value, sd, "", status, 0.0) for name, (value, sd) in values.items()}
    rows["stiffness_change"] = Estimate("stiffness_change", values["stiffness"][0] / 1e5 - 1, 1e-3, "1", status, 0.0)
    return {row.name for row in watch.judge(rows) if row.status is Status.INVALID}


def changed(**factors: float) -> dict[str, tuple[float, float]]:
    """Each times its factor, and less well known than before."""
    return {name: (factors.get(name, 1.0) * value, 5 * sd) for name, (value, sd) in BEFORE.items()}


def relearned(values: dict[str, tuple[float, float]]) -> tuple[LoadChange, set[str]]:
    watch = LoadChange()
    assert told(watch, BEFORE) == set()
    assert told(watch, values, Status.INVALID) == set()
    return watch, told(watch, values)


def test_what_changes_every_torque_alike_is_the_load() -> None:
    watch, invalid = relearned(changed(**dict.fromkeys(BEFORE, LESS)))
    assert invalid == {*BEFORE, "stiffness_change"}
    assert watch.share == pytest.approx(1 - LESS)
    assert watch.finding().high and "inertia (+9.9%)" in watch.finding().text
    assert told(watch, BEFORE) == set() and not watch.finding().high


@pytest.mark.parametrize(
    "factors", [{"stiffness": LESS}, {"stiffness": LESS, "coulomb_friction": 1.3}, {"coulomb_friction": LESS}, {}]
)
def test_what_changes_alone_is_the_gear(factors: dict[str, float]) -> None:
    watch, invalid = relearned(changed(**factors))
    assert invalid == set() and watch.share == 0.0


def test_what_the_first_blocks_do_not_tell_is_not_valid_before_later_ones_do() -> None:
    """The damping is not quite settled yet, so that neither spring nor load explains it."""
    first = changed(stiffness=LESS, coulomb_friction=LESS, damping=LESS + 0.15)
    watch, invalid = relearned(first)
    assert invalid == {*BEFORE, "stiffness_change"} and watch.share == 0.0
    assert told(watch, changed(**dict.fromkeys(BEFORE, LESS))) == {*BEFORE, "stiffness_change"}
    assert watch.share == pytest.approx(1 - LESS)


def test_what_nothing_contradicted_is_followed() -> None:
    """A gear that warms up for hours loses friction and damping, and nobody has changed its load."""
    watch = LoadChange()
    for step in range(20):
        assert told(watch, changed(**dict.fromkeys(BEFORE, 1.0 - 0.01 * step))) == set()
    assert watch.share == 0.0


def test_a_stiffness_that_is_hardly_known_again_settles_nothing() -> None:
    """Its first deviation hid ten per cent, which stood as the gear's own from then on."""
    heavier = changed(stiffness=0.9, damping=0.9, coulomb_friction=0.9)
    watch, invalid = relearned({**heavier, "stiffness": (0.9e5, 2.5e3)})
    assert "stiffness" in invalid
    assert "stiffness" in told(watch, heavier) and abs(watch.share - 0.1) < 1e-6
