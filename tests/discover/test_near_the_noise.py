"""Laws that stand a few noise floors above the sensors' noise, where the catalogue has nothing to add."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_daemon.discover.discover import discover
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from tests.explain.simulated_drives import RATIO, Arm, Joint, Sensing, record

pytestmark = pytest.mark.slow

KNOWN = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", "viscous_friction", "coulomb_friction"))))
LOUD = Sensing(rate_hz=250.0, noise=0.08)


def greased(seed: int, more_Nms: float) -> Joint:
    """A drive whose drag falls by so much within 19 s as its new grease is pushed aside, read with much noise."""
    read = record(Arm(), seed, 60.0, LOUD)
    speed = np.gradient(np.convolve(read.columns["theta_out_rad"], np.ones(9) / 9, "same"), 1 / LOUD.rate_hz)
    speed[[*range(10), *range(-10, 0)]] = 0.0
    more = more_Nms * np.exp(-read.time_s / 19.0) * speed / RATIO
    columns = {"theta_out_rad": read.columns["theta_out_rad"], "torque_in_Nm": read.columns["torque_in_Nm"] + more}
    return Joint(read.time_s, columns)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_law_near_the_noise_that_no_effect_resembles_is_told_as_a_formula(seed: int) -> None:
    """The model was called adequate at 2.4 noise floors, and nothing was looked for."""
    read = greased(seed, 7.0)
    assert diagnose([read], KNOWN).verdict == "adequate"
    found = discover([read], KNOWN)
    assert found.verdict == "unexplained" and not found.candidates
    assert "velocity_out_rad_s" in found.proposals[0].expression
    assert found.proposals[0].nrmse_after < 1.2 * found.error.noise_floor_nrmse


@pytest.mark.parametrize("seed", [1, 2])
def test_a_healthy_drive_with_as_much_noise_gets_none(seed: int) -> None:
    found = discover([greased(seed, 0.0)], KNOWN)
    assert found.verdict == "adequate" and not found.proposals
