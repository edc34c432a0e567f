"""A change of model is no wear, and no repair either."""

from __future__ import annotations

import math

import pytest

from edge_daemon.records import Estimate, Status
from edge_daemon.track.baseline import Baseline

AFTER_S = 10.0


def seen(value: float, status: Status = Status.VALID) -> Estimate:
    return Estimate("stiffness", value, 1e-3 * value, "N m/rad", status, 0.0)


def followed(baseline: Baseline, value: float, seconds: float = 2 * AFTER_S) -> Estimate:
    for _ in range(round(seconds)):
        change = baseline.follow(seen(value), 1.0)
    return change


def test_another_model_sees_less_stiffness_and_nothing_is_lost() -> None:
    """A damper that took up friction made the gear look 3 % stiffer than the right model finds it."""
    baseline = Baseline(AFTER_S)
    assert followed(baseline, 1.03e5).value == pytest.approx(0.0, abs=1e-12)
    baseline.rereference("one", "other")
    assert baseline.follow(seen(1.03e5, Status.WARMING_UP), 1.0).status is Status.WARMING_UP
    for _ in range(3 * round(AFTER_S)):
        change = baseline.follow(seen(1e5), 1.0)
        assert change.value == pytest.approx(0.0, abs=1e-12) and change.sd > 0
    assert baseline.referred(seen(1e5)).value == pytest.approx(1.03e5)
    worn = followed(baseline, 0.95e5)
    assert worn.value == pytest.approx(-0.05) and worn.status is Status.VALID


def test_what_was_lost_before_stays_lost_and_loses_no_doubt() -> None:
    baseline = Baseline(AFTER_S)
    followed(baseline, 1e5)
    before = followed(baseline, 0.96e5)
    baseline.rereference("one", "other")
    assert baseline.referred(seen(0.5e5)).status is Status.INVALID  # nobody knows yet what this model makes of the gear
    after = followed(baseline, 0.9e5)
    assert after.value == pytest.approx(before.value) and after.sd >= before.sd
    assert baseline.referred(seen(0.9e5)).value == pytest.approx(0.96e5, rel=1e-3)


def test_a_reference_from_stored_motion_stands_for_change_and_what_is_kept_over_years_goes_on() -> None:
    """The model before took 4 % of wear for 1 %: the change is put right, and no row kept over years jumps."""
    baseline = Baseline(AFTER_S)
    followed(baseline, 1.03e5)
    followed(baseline, 1.02e5)
    baseline.rereference("one", "other")
    assert baseline.wanted_s == 0.0
    baseline.relearn(seen(1e5))
    assert math.isnan(baseline.wanted_s)
    worn = followed(baseline, 0.96e5)
    assert worn.value == pytest.approx(-0.04) and worn.sd > 0
    assert baseline.referred(seen(0.96e5)).value == pytest.approx(1.02e5, rel=1e-9)


def test_a_model_exchanged_before_commissioning_is_commissioned_like_the_first() -> None:
    baseline = Baseline(AFTER_S)
    followed(baseline, 1e5, AFTER_S / 2)
    baseline.rereference("one", "other")
    assert not math.isfinite(baseline.follow(seen(2e5), 1.0).value)
    assert followed(baseline, 2e5).value == pytest.approx(0.0) and baseline.scale == 1.0


def test_what_a_model_and_the_gear_may_both_have_done_is_doubt_and_said() -> None:
    """Worn by 3 % while the model was exchanged: without stored motion nobody knows whose the difference is."""
    baseline = Baseline(AFTER_S)
    followed(baseline, 1e5)
    baseline.rereference("one", "other")
    first = baseline.follow(seen(0.97e5), 1.0)
    assert first.status is Status.VALID and baseline.apart == pytest.approx(-0.03)
    change = followed(baseline, 0.97e5)
    assert all(abs(row.value + 0.03) < 1.5 * row.sd for row in (first, change))


def test_a_model_that_is_unsure_of_the_stiffness_is_unsure_of_its_change() -> None:
    """What it lacks made up for three per cent of wear, so that both models saw the same."""
    baseline = Baseline(AFTER_S)
    followed(baseline, 1e5)
    baseline.rereference("one", "other")
    change = baseline.follow(Estimate("stiffness", 1e5, 3e3, "N m/rad", Status.VALID, 0.0), 1.0)
    assert change.value == 0.0 and change.sd >= 0.03


def test_what_is_not_valid_moves_no_wear() -> None:
    """An output scale that drifted left a stiffness that was valid no more, and a health of 0.80."""
    baseline = Baseline(AFTER_S)
    followed(baseline, 1e5)
    doubted = baseline.follow(seen(0.95e5, Status.NOT_EXCITED), 1.0)
    assert doubted.value == pytest.approx(0.0, abs=1e-12) and 0.05 < doubted.sd < 0.06
    assert followed(baseline, 0.95e5).value == pytest.approx(-0.05)
    assert baseline.follow(seen(1e5, Status.INVALID), 1.0).value == pytest.approx(-0.05)


def test_a_model_that_was_in_force_before_has_its_reference_at_once() -> None:
    """Worn by 3 % while another model was tried for a moment: the loss is seen, and no reference hides it."""
    baseline = Baseline(AFTER_S)
    followed(baseline, 1e5)
    baseline.rereference("one", "other")
    baseline.rereference("other", "one")
    again = Baseline(AFTER_S)
    again.load(baseline.dump())
    for one in (baseline, again):
        change = one.follow(seen(0.97e5), 1.0)
        assert change.status is Status.VALID and change.value == pytest.approx(-0.03) and change.sd < 0.005
        assert one.apart == pytest.approx(-0.03) and one.scale == 1.0 and math.isnan(one.wanted_s)
        one.apart = 0.0
        one.follow(seen(0.97e5), 1.0)
        assert one.apart == 0.0, "told once"


def test_it_outlives_a_restart_and_reads_what_older_versions_left() -> None:
    baseline, again = Baseline(AFTER_S), Baseline(AFTER_S)
    followed(baseline, 1e5)
    baseline.rereference("one", "other")
    followed(baseline, 1.1e5)
    again.load(baseline.dump())
    assert again == baseline
    again.load({"valid_s": 20.0, "value": 1e5, "sd": 100.0})
    assert again.follow(seen(0.9e5), 1.0).value == pytest.approx(-0.1) and again.scale == 1.0
