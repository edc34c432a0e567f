"""Effects in the loop: their laws say what their columns say, and the loop balances."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.effects.catalogue import CATALOGUE
from edge_daemon.effects.effect import Effect
from edge_daemon.estimate.inloop import Course, Spring, packed, ride
from edge_daemon.estimate.torsion import followed
from edge_daemon.records import Motion

LAWFUL = [effect for effect in CATALOGUE.values() if effect.in_loop is not None]
RATE_HZ = 4000.0


def motion() -> Motion:
    t = np.arange(4000) / RATE_HZ
    twist = 2e-4 * np.sin(2 * np.pi * 3 * t) + 1e-4 * np.sin(2 * np.pi * 11 * t + 1)
    rate = 2e-4 * 6 * np.pi * np.cos(2 * np.pi * 3 * t) + 1e-4 * 22 * np.pi * np.cos(2 * np.pi * 11 * t + 1)
    still = np.zeros(len(t))
    return Motion(RATE_HZ, 100.0, t, still, still, twist, rate, still, still, 5 * np.sin(7 * t), still + 30)


@pytest.mark.parametrize("effect", LAWFUL, ids=lambda effect: effect.name)
def test_a_law_is_the_same_torque_as_the_columns(effect: Effect) -> None:
    seen, amplitudes = motion(), np.linspace(0.5, 1.5, len(effect.amplitudes))
    columns, _ = effect.columns(seen, effect.start, None)
    assert effect.in_loop is not None
    law = effect.in_loop(effect.start, amplitudes.tolist())
    torque = followed(packed(law), seen.twist_rad, seen.twist_rate_rad_s, np.abs(seen.torque_Nm))
    expected = columns @ amplitudes
    assert torque == pytest.approx(expected, abs=1e-9 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("effect", LAWFUL, ids=lambda effect: effect.name)
def test_the_simulated_twist_balances_the_torque(effect: Effect) -> None:
    """J d2phi/dt2 = push - K phi - B dphi/dt - law, checked by differences of the rate that came out."""
    j, k, b = 0.1, 2e4, 6.0
    n = round(RATE_HZ)
    push = 3 * np.sin(2 * np.pi * 5 * np.arange(n) / RATE_HZ)
    on = Course(4, 1 / RATE_HZ, push, np.abs(push), np.zeros(n), 0.0)
    assert effect.in_loop is not None
    law = effect.in_loop(effect.start, [0.3] * len(effect.amplitudes))
    quiet = Spring(0.0, k, b)  # massless: no observer, no memory of the rate
    by = ride(on, quiet, law, None)
    left = push - k * by.twist_rad - b * by.rate_rad_s - by.torque_Nm
    assert np.abs(left).max() < 1e-3
    assert np.isfinite(ride(on, Spring(j, k, b), law, None).twist_rad).all()
