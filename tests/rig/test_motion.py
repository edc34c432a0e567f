"""Motions: derivatives belong to their angle, and the motor stays below its limit."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.rig.motion import MAX_MOTOR_RAD_S, MOTIONS, MotorMotion, live


def every_motion() -> list[MotorMotion]:
    rng = np.random.default_rng(5)
    return [*(make(20.0, rng) for make in MOTIONS.values()), live(rng)]


@pytest.mark.parametrize("motion", every_motion(), ids=lambda motion: motion.name)
def test_speed_and_acceleration_are_the_derivatives_of_the_angle(motion: MotorMotion) -> None:
    step = 1e-4
    time_s = np.arange(0.0, 20.0, step)
    course = motion.course(time_s)
    for given, of in ((course.speed, course.angle), (course.acceleration, course.speed)):
        derived = (of[2:] - of[:-2]) / (2 * step)
        assert np.abs(derived - given[1:-1]).max() < 1e-4 * np.abs(given).max()


@pytest.mark.parametrize("motion", every_motion(), ids=lambda motion: motion.name)
def test_the_motor_never_exceeds_3000_rpm(motion: MotorMotion) -> None:
    fastest = np.abs(motion.course(np.arange(0.0, 20.0, 1e-4)).speed).max()
    assert 0.5 * MAX_MOTOR_RAD_S < fastest <= MAX_MOTOR_RAD_S
