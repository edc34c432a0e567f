"""The articles' damage law, anchored at what the maker promises."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.usage.damage import DamageLaw, damage_law
from edge_daemon.usage.gears import catalogue, find_gear


def test_the_law_is_the_articles_equation() -> None:
    law = DamageLaw(C=2e-5, m=7.0, gamma=1.5, ultimate_Nm=800.0)
    expected = 2e-5 * (120.0 / (800.0 * (1 - 1.5 * 0.08))) ** 7
    assert law.per_cycle(-120.0, 0.08) == pytest.approx(expected, rel=1e-12)
    assert law.per_hour(120.0, 1500.0, 0.08) == pytest.approx(2 * 60 * 1500 * expected, rel=1e-12)


def test_every_gear_keeps_the_makers_promises() -> None:
    for gear in catalogue().values():
        law = damage_law(gear)
        assert law.per_cycle(gear.momentary_peak_Nm) * 1e4 == pytest.approx(1.0)
        assert law.per_cycle(gear.repeated_peak_Nm) * 1e7 == pytest.approx(1.0)


def test_lost_stiffness_shortens_life() -> None:
    law = damage_law(find_gear("CSG-20-100"))
    rates = law.per_cycle(np.full(4, 60.0), np.array([0.0, 0.05, 0.2, 5.0]))
    assert np.all(np.diff(rates) > 0)
    assert np.isfinite(rates).all()
