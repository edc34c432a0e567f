"""The maker's life law and its Weibull law."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.usage.bearing import bearing_law, bearing_use, warmth_factor
from edge_daemon.usage.gears import find_gear


def test_weibull_passes_through_l10_and_l50() -> None:
    gear = find_gear("CSG-20-100")
    law = bearing_law(gear)
    assert law.shape == pytest.approx(1.17, abs=0.005)
    assert law.scale_h == pytest.approx(1.368 * gear.l50_h, rel=1e-3)
    np.testing.assert_allclose(law.remaining(0.0, np.array([0.1, 0.5])), [gear.l10_h, gear.l50_h])


def test_use_is_cubic_in_torque_and_linear_in_speed() -> None:
    gear = find_gear("CSF-25-100")
    use = bearing_use(gear, np.array([67.0, 134.0, 67.0]), np.array([2000.0, 2000.0, 500.0]))
    np.testing.assert_allclose(use, [1.0, 8.0, 0.25])


def test_remaining_life_of_a_survivor_matches_simulation() -> None:
    law = bearing_law(find_gear("CSG-20-100"))
    rng = np.random.default_rng(3)
    lives = law.scale_h * rng.weibull(law.shape, 400_000)
    left = lives[lives > 30_000] - 30_000
    np.testing.assert_allclose(
        law.remaining(30_000, np.array([0.1, 0.5, 0.9])), np.quantile(left, [0.1, 0.5, 0.9]), rtol=0.02
    )


def test_warm_grease_ages_the_bearing() -> None:
    """Halved life for each 15 K above 70 degC; unknown counts as cool."""
    np.testing.assert_allclose(warmth_factor(np.array([40.0, 70.0, 85.0, 100.0, np.nan])), [1.0, 1.0, 2.0, 4.0, 1.0])
