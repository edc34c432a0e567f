"""Which blocks are held out together."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.identify.block_least_squares import folds_of_phase, repeats_after

RATE_HZ = 200.0
TIME_S = np.arange(round(36.0 * RATE_HZ)) / RATE_HZ


@pytest.mark.parametrize("period_s", [5.3, 10.0, 17.0])
def test_a_motion_of_harmonics_repeats_after_its_period(period_s: float) -> None:
    harmonics = sum(np.sin(2 * np.pi * k * TIME_S / period_s + k) / k for k in (1, 2, 3, 5))
    assert repeats_after(RATE_HZ, np.asarray(harmonics)) == pytest.approx(period_s, abs=0.05)


@pytest.mark.parametrize("angle", [
    0.4 * TIME_S,
    np.sin(2 * np.pi * 0.13 * TIME_S) + np.sin(2 * np.pi * 0.4711 * TIME_S),
    np.zeros(len(TIME_S)),
    np.zeros(1),
], ids=["one way", "two tones", "rest", "one sample"])  # fmt: skip
def test_what_never_comes_back_repeats_never(angle: np.ndarray) -> None:
    assert repeats_after(RATE_HZ, angle) == 0.0


def test_blocks_of_one_phase_are_held_out_together() -> None:
    start_s = 1.25 * np.arange(28)
    fold = folds_of_phase(start_s, 10.0, 1.25)
    assert (fold[8:] == fold[:-8]).all()
    assert len(np.unique(fold)) == 6


@pytest.mark.parametrize("period_s", [0.0, 1.0, 4.0])
def test_blocks_of_a_short_period_are_held_out_as_ever(period_s: float) -> None:
    assert list(folds_of_phase(1.25 * np.arange(8), period_s, 1.25)) == [0, 1, 2, 3, 4, 5, 0, 1]
