"""The torques at the gear, as the numbers that were last found tell them."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.effects.catalogue import find
from edge_daemon.effects.expression import user_effect
from edge_daemon.effects.model import ModelEffect
from edge_daemon.motion.gear_load import GearLoad
from edge_daemon.records import Motion

INERTIA, DRAG, SATURATING = 0.5, 2.0, 0.01


def test_a_law_of_the_motor_follows_what_that_makes_and_not_what_was_read() -> None:
    time_s = np.arange(2000) / 500.0
    speed, acceleration = np.sin(2 * time_s), 2 * np.cos(2 * time_s)
    made = INERTIA * acceleration + DRAG * speed
    none = np.zeros(len(time_s))
    read = made + SATURATING * made**3
    motion = Motion(500.0, 100.0, time_s, none, none, none, none, speed, acceleration, read, none + 25.0)
    law = user_effect(ModelEffect("iron", expression="a*motor_Nm**3"), "drive")
    rows = [find("inertia", "drive"), find("viscous_friction", "drive"), law]
    gear = GearLoad([(row, {}, slice(i, i + 1)) for i, row in enumerate(rows)], 3)
    gear.take_up(1, np.array([INERTIA, DRAG, SATURATING]))
    seen = gear.on(motion)
    assert seen.motor_Nm is not None and seen.transmitted_Nm == pytest.approx(INERTIA * acceleration)
    assert np.abs(read - made).max() > 0.08
    assert np.abs(seen.motor_Nm - made).max() < 0.2 * np.abs(read - made).max()
