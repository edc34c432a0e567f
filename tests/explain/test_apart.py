"""A payload that was changed between two recordings: the model explains each, but not both as one joint."""

from __future__ import annotations

import math
from dataclasses import replace

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.apart import told_apart
from tests.explain.simulated_drives import RATIO, Arm, Sensing, record

ARM = Arm(weight_Nm=9.0, inertia_kg_m2=1.5)
LOADED = replace(ARM, weight_Nm=24.0, inertia_kg_m2=2.7)
NAMES = ("inertia", "viscous_friction", "coulomb_friction", "gravity_load")
MODEL = Model("drive", RATIO, math.nan, tuple(ModelEffect(name) for name in NAMES))


def test_a_payload_that_was_changed_is_told_by_its_numbers() -> None:
    (line,) = told_apart([record(ARM, 1), record(LOADED, 2)], MODEL)
    inertia, weight = (1.5 / RATIO, 2.7 / RATIO), (9.0 / RATIO, 24.0 / RATIO)
    assert "inertia inertia" in line and "gravity_load sine" in line
    for name, (less, more) in (("inertia inertia", inertia), ("gravity_load sine", weight)):
        found = line.split(name)[1].split()
        assert abs(float(found[0]) - less) < 0.02 * less and abs(float(found[4]) - more) < 0.02 * more
    assert "friction" not in line


def test_one_joint_and_what_the_model_does_not_explain_are_not_told_apart() -> None:
    rippled = replace(ARM, waves=(("in", 2.0, 2.0, 0.3),))
    assert told_apart([record(ARM, 1), record(ARM, 2, sensing=Sensing(pace=0.8))], MODEL) == ()
    assert told_apart([record(ARM, 1)], MODEL) == ()
    assert told_apart([record(ARM, 1), record(rippled, 2)], MODEL) == ()
