"""The search in the loop: what it stops for, and that what it keeps between steps is still true."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.gauss_newton import PATIENCE, LoopProblem, out_of_reach
from edge_daemon.identify.inloop import slope_of, upsampled
from edge_daemon.identify.pilot_stretch import stretch_of
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.rig.recording import simulate

BASE = ("linear_stiffness", "viscous_damping")


@cache
def stretch() -> tuple[RegressionProblem, Model]:
    made = simulate(("coulomb_friction", "kinematic_error"), 10.0, seed=5, bits_out=24)
    parameters = made.truth["parameters"]
    model = Model("torsion", parameters["ratio"], parameters["inertia_kg_m2"], ())  # type: ignore[index]
    return stretch_of(problem_of([made], model)), model


def loop(*names: str) -> LoopProblem:
    """Of a structure, where least squares on the measured motion leads."""
    part, model = stretch()
    effects = tuple(ModelEffect(name) for name in (*BASE, *names))
    terms = terms_of(Model("torsion", model.ratio, model.output_inertia_kg_m2, effects), part)
    return LoopProblem(part, part.solve(terms), held=True)


def test_a_pause_in_the_middle_of_a_recording_is_not_the_stretch_that_is_searched() -> None:
    made = simulate(("coulomb_friction",), 20.0, seed=5)
    later = np.where(made.time_s < 8.0, made.time_s, made.time_s + 40.0)
    parameters = made.truth["parameters"]
    model = Model("torsion", parameters["ratio"], parameters["inertia_kg_m2"], ())  # type: ignore[index]
    part = stretch_of(problem_of([replace(made, time_s=later)], model)).trials[0]
    assert len(part.target) > 1000
    assert part.motion.time_s[part.rows[0]] > 48.0 or part.motion.time_s[part.rows[-1]] < 8.0


@pytest.mark.parametrize(
    ("errors", "rounds", "expected"),
    [
        ([1.0, 0.9, 0.82, 0.76], 5, True),  # 0.76 * 0.91^5 stays above
        ([1.0, 0.9, 0.82, 0.76], 40, False),
        ([1.0, 0.99, 0.97, 0.9], 5, False),  # falls still grow: out of a plateau
        ([1.0, 0.999, 0.9985], 1, False),  # too early to say
        ([1.0, 0.1, 0.02, 0.011], 5, False),
    ],
)
def test_a_search_is_given_up_when_its_falls_shrink_and_do_not_reach(
    errors: list[float], rounds: int, expected: bool
) -> None:
    assert PATIENCE == 3
    assert out_of_reach(errors, rounds, wanted=0.1) is expected


def test_a_wrong_law_is_given_up_early_and_the_right_one_is_not() -> None:
    wrong, right = loop("backlash"), loop("kinematic_error", "coulomb_friction")
    right.descend(15, 0.01)
    patient = loop("backlash")
    patient.descend(15, 1e-6)
    wrong.descend(15, 1e-6, hopeless=2 * right.rms)
    assert wrong.rms > 20 * right.rms
    assert not np.array_equal(wrong.point, patient.point)
    hurried = loop("kinematic_error", "coulomb_friction")
    hurried.descend(15, 0.01, hopeless=1.2 * right.rms)
    assert hurried.point == pytest.approx(right.point)


def test_what_is_kept_between_steps_still_says_how_the_torque_changes() -> None:
    """Every column of the derivative against differences of the modelled torque, after the point has moved on."""
    it = loop("encoder_skew", "kinematic_error", "coulomb_friction")
    it.point[[p.row.name == "delay" for p in it.places]] = 2e-4
    it.modelled(it.point)
    it.descend(3, 0.01)
    _, design = it.modelled(it.point)
    for j, place in enumerate(it.places):
        step = 1e-4 * max(abs(it.point[j]), 1e-5)
        ends = [it.modelled(it.point + side * step * np.eye(len(it.point))[j], derive=False)[0] for side in (1, -1)]
        difference = (ends[0] - ends[1]) / (2 * step)
        error = np.sqrt(np.mean((design[:, j] - difference) ** 2))
        assert error < 0.1 * np.sqrt(np.mean(difference**2)), place.row.name


@pytest.mark.parametrize("n", [4001, 4000])
def test_signals_of_any_length_are_interpolated_and_differentiated(n: int) -> None:
    t = np.arange(n) / 1000.0
    fine = np.arange(4 * n) / 4000.0
    inside = slice(4 * 200, -4 * 200)

    def wave(at: np.ndarray) -> np.ndarray:
        return 0.3 * at + np.sin(2 * np.pi * 7.3 * at) + 0.1 * np.cos(2 * np.pi * 61.7 * at)

    rate = 0.3 + 14.6 * np.pi * np.cos(14.6 * np.pi * t) - 12.34 * np.pi * np.sin(123.4 * np.pi * t)
    assert upsampled(wave(t), 4)[inside] == pytest.approx(wave(fine)[inside], abs=2e-3)
    assert slope_of(wave(t), 1000.0)[200:-200] == pytest.approx(rate[200:-200], abs=0.5)
