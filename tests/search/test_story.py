"""Several laws at once: what none of them shows alone, and what the rest does as well without."""

from __future__ import annotations

import math

import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from tests.explain.simulated_drives import RATIO, Arm, Sensing, record

BARE = Model("drive", RATIO, math.nan, (ModelEffect("inertia"),))
PLAIN = ("coulomb_friction", "gravity_load", "wave_generator_ripple")
WAVE = (("in", 2.0, 0.5, 0.4),)


@pytest.mark.parametrize(
    ("arm", "names"),
    [
        (Arm(weight_Nm=12.0, warmth_Nms_per_K=-0.25, viscous_Nms=8.0, waves=WAVE),
         {"temperature_friction", "viscous_friction"}),
        (Arm(weight_Nm=25.0, mesh=0.07, root_Nm=6.0, viscous_Nms=0.0, waves=WAVE),
         {"load_dependent_friction", "sublinear_friction"}),
    ],
)  # fmt: skip
def test_laws_that_hide_each_other_are_named_together(arm: Arm, names: set[str]) -> None:
    """Step by step a drag without its temperature was no step at all, and forms of friction stood in for each other."""
    found = diagnose([record(arm, 11, sensing=Sensing(rate_hz=250.0))], BARE)
    assert found.verdict == "missing" and set(found.candidates[0].effect.split("+")) == {*PLAIN, *names}
    assert found.candidates[0].nrmse_after < 1.5 * found.error.noise_floor_nrmse < 0.05 * found.error.nrmse


def test_slow_friction_is_told_below_the_quick_noise_of_an_acceleration() -> None:
    """The encoder's steps make nine tenths of the error, and hardly any of it is as slow as a drag: by its bare error a
    drag with the root of speed was no better than a plain one."""
    arm = Arm(weight_Nm=12.0, viscous_Nms=0.0, root_Nm=3.0)
    known = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", "coulomb_friction", "gravity_load"))))
    found = diagnose([record(arm, 12, sensing=Sensing(rate_hz=250.0, bits=15, noise=0.01))], known)
    assert found.verdict == "missing" and found.candidates[0].effect == "sublinear_friction"
