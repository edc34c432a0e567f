"""Several laws at once: what none of them shows alone, and what the rest does as well without."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.effects.catalogue import find
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.records import Array
from edge_daemon.search.story import same_dry_friction
from tests.explain import simulated_drives
from tests.explain.simulated_drives import RATIO, STEP_S, Arm, Sensing, record

pytestmark = pytest.mark.slow

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


CHURNING = Arm(viscous_Nms=0.0, coulomb_Nm=1.5, root_Nm=6.0, root_exponent=1.7)
ROOT = Arm(weight_Nm=12.0, viscous_Nms=0.0, coulomb_Nm=0.0, root_Nm=6.0)
STRIBECK = Arm(weight_Nm=12.0, coulomb_Nm=4.0, stribeck_Nm=3.0)
BRISTLES = Arm(weight_Nm=25.0, coulomb_Nm=10.0, bristle_rad=(1e-4, 1e-4, 1e-4, 1e-4, 5e-3))


def first_named(arm: Arm, known: tuple[str, ...], noise: float = 1e-3) -> tuple[set[str], float, float]:
    """What comes first beside an inertia and some known effects, its probability, and its error in noise floors."""
    recording = record(arm, 3, 20.0, Sensing(rate_hz=250.0, noise=noise))
    found = diagnose([recording], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", *known)))))
    first = found.candidates[0]
    return set(first.effect.split("+")), first.probability, first.nrmse_after / found.error.noise_floor_nrmse


@pytest.mark.parametrize(
    ("arm", "known", "names"),
    [
        (CHURNING, (), {"coulomb_friction", "superlinear_friction"}),
        (Arm(weight_Nm=30.0, mesh=0.1, coulomb_Nm=3.0), ("viscous_friction", "gravity_load"),
         {"coulomb_friction", "load_dependent_friction"}),
        (Arm(weight_Nm=12.0, warmth_Nms_per_K=-0.15, viscous_Nms=8.0), ("coulomb_friction", "gravity_load"),
         {"temperature_friction", "viscous_friction"}),
    ],
)  # fmt: skip
def test_a_plain_law_and_a_finer_one_are_named_at_once(arm: Arm, known: tuple[str, ...], names: set[str]) -> None:
    """One of the two was named alone, and sure of itself, at 11 to 55 noise floors."""
    named, probability, floors = first_named(arm, known)
    assert named == names and probability > 0.9 and floors < 1.2


@pytest.mark.parametrize(
    ("arm", "known", "noise", "names"),
    [
        (ROOT, (), 0.1, {"gravity_load", "sublinear_friction"}),
        (STRIBECK, ("viscous_friction",), 0.02, {"gravity_load", "stribeck_friction"}),
    ],
)
def test_a_law_that_stood_in_for_another_is_exchanged(
    arm: Arm, known: tuple[str, ...], noise: float, names: set[str]
) -> None:
    """Beside the weight viscous friction stood in for a root of speed at two noise floors, and dry friction for the
    Stribeck effect."""
    named, probability, floors = first_named(arm, known, noise)
    assert named == names and probability > 0.9 and floors < 1.2


def test_bristles_are_not_named_beside_a_weight_where_their_plainer_form_does() -> None:
    """The form that waited for dry friction was not weighed in the place of the one that contains it."""
    assert first_named(replace(STRIBECK, weight_Nm=40.0), ("viscous_friction",))[0] == {
        "gravity_load",
        "stribeck_friction",
    }


def test_presliding_takes_the_place_of_dry_friction() -> None:
    """Dry friction was named a second time, as one more element of the joint's own."""
    assert first_named(BRISTLES, ("viscous_friction",))[0] == {"gravity_load", "maxwell_slip_hysteresis"}
    names = ("hysteresis", "maxwell_slip_hysteresis", "lugre_friction", "coulomb_friction")
    loop, *dry = (find(name, "drive") for name in names)
    assert all(same_dry_friction(*two) for row in dry for two in ((loop, row), (row, loop)))
    others = ("viscous_friction", "stribeck_friction", "load_dependent_friction", "constant_torque")
    assert not any(same_dry_friction(loop, find(name, "drive")) for name in others)


def test_far_above_the_noise_no_law_is_exchanged_for_one_that_only_mends_more() -> None:
    """Beside presliding of another kind than the catalogue's a drag took more of the rest than the weight that is
    there."""
    arm = Arm(weight_Nm=12.0, coulomb_Nm=10.0, bristle_rad=(1e-3, 0.1))
    assert first_named(arm, ("viscous_friction",))[0] == {"gravity_load", "maxwell_slip_hysteresis"}


def at_constant_speed(seconds: float, rng: np.random.Generator, pace: float = 1.0) -> tuple[Array, Array, Array]:
    """Angle, speed and acceleration to follow, each step."""
    t = np.arange(round(seconds / STEP_S)) * STEP_S
    return pace * t, np.full(len(t), pace), np.zeros(len(t))


def test_in_one_direction_dry_friction_is_named_before_a_constant_torque(monkeypatch: pytest.MonkeyPatch) -> None:
    """The two are one curve there; within a story the rarer was named at 0.99, and the other not at all."""
    monkeypatch.setattr(simulated_drives, "course", at_constant_speed)
    arm = Arm(waves=(("in", 2.0, 1.5, 0.4),))
    speeds = (0.15, 0.3, 0.5, 0.7, 0.9)
    files = [record(arm, i, 2.5, Sensing(pace=pace, noise=0.02)) for i, pace in enumerate(speeds)]
    first, second = diagnose(files, BARE).candidates[:2]
    both = {"viscous_friction", "wave_generator_ripple"}
    assert set(first.effect.split("+")) == {"coulomb_friction", *both} and first.probability <= 0.5
    assert set(second.effect.split("+")) == {"constant_torque", *both}
