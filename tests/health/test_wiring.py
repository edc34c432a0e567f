"""Settings that the measurements contradict: told by name, and only where they are sure."""

from __future__ import annotations

import pytest

from edge_daemon.health.wiring import doubts
from edge_daemon.records import Estimate, Status


def told(**values: tuple[float, float]) -> dict[str, Estimate]:
    return {name: Estimate(name, value, sd, "1", Status.VALID, 0.0) for name, (value, sd) in values.items()}


@pytest.mark.parametrize(
    ("seen", "model", "hint"),
    [
        (200.0, 100.0, "that of theta_in_rad is 2 times too small"),
        (50.0, 100.0, "that of theta_in_rad is 0.5 times"),
        (-100.0, 100.0, "reverse = true"),
        (-100.0, 101.0, "set ratio = -100 in"),  # the same gear with the other spline held
        (100.0, 101.0, "set ratio = 100 in the model"),
        (0.01, 100.0, "exchange the two"),
    ],
)
def test_another_ratio_than_the_models_is_a_wrong_setting(seen: float, model: float, hint: str) -> None:
    (finding,) = doubts(told(ratio=(seen, 1e-3)), model)
    assert finding.high
    assert hint in finding.text.rpartition(": ")[2]  # what the page shows under "What to do"


@pytest.mark.parametrize(
    ("seen", "sd"), [(100.02, 1e-4), (-100.0, 40.0), (101.0, 0.2)], ids=["an eccentric encoder", "unknown", "unsure"]
)
def test_a_ratio_that_may_be_the_models_is_none(seen: float, sd: float) -> None:
    assert not any(finding.high for finding in doubts(told(ratio=(seen, sd)), 100.0))


def test_a_slope_over_a_dither_is_no_ratio() -> None:
    """Over 3 mrad, a sixth of a wave, a kinematic error makes 2.91 of 100."""
    small = {"ratio": Estimate("ratio", 2.91, 0.49, "1", Status.NOT_EXCITED, 0.0)}
    assert not any(finding.high for finding in doubts(small, 100.0))


@pytest.mark.parametrize(
    ("error", "floor", "high"),
    [(1.0, 1e-3, True), (0.8, 1e-3, False), (1.0, 0.9, False), (4.7, 1e-3, True)],
    ids=str,
)
def test_a_model_that_explains_nothing_is_wired_wrong_unless_it_is_noise(
    error: float, floor: float, high: bool
) -> None:
    found = doubts(told(model_nrmse=(error, 0.05), model_noise_floor=(floor, 1e-3)), 100.0)
    assert any(finding.high for finding in found) is high


def test_an_error_of_more_than_all_is_told_soon_and_not_as_a_wrong_setting() -> None:
    (found,) = doubts(told(model_nrmse=(64.0, 1.0), model_noise_floor=(1e-3, 1e-3)), 100.0)
    assert found.high and found.delay_s <= 2.0 and "counts_per_turn" not in found.text


def test_one_wrong_setting_is_one_alarm() -> None:
    values = told(ratio=(200.0, 1e-3), model_nrmse=(1.0, 0.01), model_noise_floor=(1e-3, 1e-4))
    assert [finding.key for finding in doubts(values, 100.0) if finding.high] == ["ratio"]
