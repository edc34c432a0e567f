"""The compiled integrator against solutions that are known, and against itself in pieces."""

import numpy as np
import pytest
from scipy.linalg import expm

from edge_daemon.integrator import twist
from edge_daemon.integrator.laws import BOUC_WEN, BRISTLE, RUB, SIGN, SPRING

INERTIA, STIFFNESS, STEP_S = 0.05, 1e5, 2.5e-4
CRITICAL = 2 * np.sqrt(STIFFNESS * INERTIA)


def moved(push, gear, motion, numbers=None, times=1):
    """The next steps under torques (n,)."""
    still = np.zeros(len(push))
    forcing = twist.Forcing(push, still, still, 0.0, STEP_S, times)
    return twist.simulate(gear, forcing, numbers or twist.nothing(gear.elements), motion)


def gear_of(damping, *elements, stiffness=STIFFNESS):
    return twist.TorsionGear(INERTIA, stiffness, damping, np.array(elements, dtype=float).reshape(-1, 5))


def exactly(push, stiffness, damping, twist, rate):
    """(n,) twist at the end of each step, by one matrix exponential."""
    system = np.array([[0, 1, 0], [-stiffness / INERTIA, -damping / INERTIA, 1 / INERTIA], [0, 0, 0]])
    step, state, found = expm(system * STEP_S), np.array([twist, rate]), []
    for torque in push:
        state = step[:2] @ [*state, torque]
        found.append(state[0])
    return np.array(found)


@pytest.mark.parametrize("damping", [0.0, 20.0, CRITICAL, CRITICAL * (1 + 1e-9), 5 * CRITICAL, 1e4])
def test_spring_and_damper_move_exactly(damping):
    push = np.sin(np.arange(400) / 9.0)
    found = moved(push, gear_of(damping), twist.at_rest(1e-5, 2e-3, 0, 0)).ends
    exact = exactly(push, STIFFNESS, damping, 1e-5, 2e-3)
    assert np.abs(found - exact).max() < 1e-9 * np.abs(exact).max()


@pytest.mark.parametrize("damping", [1.0, 20.0, CRITICAL, CRITICAL * (1 + 1e-6), 3 * CRITICAL])
def test_slopes_to_stiffness_and_damping_are_those_of_the_exact_motion(damping):
    push = np.sin(np.arange(200) / 9.0)
    numbers = twist.Numbers(np.eye(2), np.zeros((2, 0, 4)), np.zeros((2, 201)), np.zeros((2, 1)))
    found = moved(push, gear_of(damping), twist.at_rest(1e-5, 2e-3, 0, 2), numbers).end_changes
    for row, (by_k, by_b) in zip(found, ((STIFFNESS * 1e-4, 0.0), (0.0, damping * 1e-4)), strict=True):
        sides = [exactly(push, STIFFNESS + s * by_k, damping + s * by_b, 1e-5, 2e-3) for s in (1, -1)]
        slope = (sides[0] - sides[1]) / (2 * (by_k + by_b))
        assert np.abs(row - slope).max() < 1e-5 * np.abs(slope).max()


def test_a_motion_in_pieces_is_the_motion_in_one():
    push = 3 * np.sin(np.arange(600) / 40.0)
    gear = gear_of(20.0, (SIGN, 0.5, 1e-3, 0, 1), (BOUC_WEN, 0.4, 2e-5, 0.6, 1))
    numbers = twist.Numbers(np.eye(3, 2), np.zeros((3, 2, 4)), np.zeros((3, 601)), np.zeros((3, 1)))
    numbers.elements[2, 1, 0] = 1.0
    whole = moved(push, gear, twist.at_rest(0.0, 0.0, 2, 3), numbers, 4)
    motion = twist.at_rest(0.0, 0.0, 2, 3)
    parts = [
        moved(push[at : at + 200], gear, motion, numbers._replace(pushes=numbers.pushes[:, :201]), 4)
        for at in (0, 200, 400)
    ]
    for name in ("twist", "rate", "torque", "ends"):
        assert np.concatenate([getattr(part, name) for part in parts]) == pytest.approx(getattr(whole, name), rel=1e-12)
    joined = np.concatenate([part.end_changes for part in parts], axis=1)
    assert joined == pytest.approx(whole.end_changes, rel=1e-12)


def test_a_spring_that_is_a_law_is_as_stiff_as_a_spring():
    """A law acts with the mean of a step, not with that of the step's two ends: one is bent."""
    push = np.sin(np.arange(2000) * 0.02) + np.sin(np.arange(2000) * 0.05)
    whole = moved(push, gear_of(40.0), twist.at_rest(0.0, 0.0, 0, 0)).ends
    law = (SPRING, 0.5 * STIFFNESS, 0.0, 0.0, 0.0)
    parted = moved(push, gear_of(40.0, law, stiffness=0.5 * STIFFNESS), twist.at_rest(0.0, 0.0, 1, 0)).ends
    assert np.std((parted - whole)[500:]) < 3e-5 * np.std(whole)


def test_numbers_that_no_gear_has_give_numbers():
    push = np.sin(np.arange(50) / 9.0)
    for stiffness, damping in ((0.0, 1.0), (-1e4, 1.0), (STIFFNESS, -20.0), (STIFFNESS, 1e9)):
        found = moved(push, gear_of(damping, stiffness=stiffness), twist.at_rest(0.0, 0.0, 0, 0))
        assert np.isfinite(found.twist).all()


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("number", range(4))
def test_slopes_to_the_numbers_of_bristles_are_those_of_two_motions(which, number):
    push = 3 * np.sin(np.arange(400) / 40.0)
    elements = np.array([(BRISTLE, 0.5, 2e-5, 1.4, 2e-3), (RUB, 3.0, 2e-5, 1.4, 2e-3)])
    numbers = twist.Numbers(np.zeros((1, 2)), np.zeros((1, 2, 4)), np.zeros((1, 401)), np.zeros((1, 1)))
    numbers.elements[0, which, number] = 1.0
    found = moved(push, gear_of(20.0, *elements), twist.at_rest(0.0, 0.0, 2, 1), numbers).end_changes[0]
    sides, step = [], 1e-3 * elements[which, 1 + number]
    for sign in (1, -1):
        other = elements.copy()
        other[which, 1 + number] += sign * step
        sides.append(moved(push, gear_of(20.0, *other), twist.at_rest(0.0, 0.0, 2, 0)).ends)
    slope = (sides[0] - sides[1]) / (2 * step)
    apart = np.quantile(np.abs(found - slope), 0.9)
    assert apart < 5e-3 * np.abs(slope).max(), "but for a few where a step is split that was not"
