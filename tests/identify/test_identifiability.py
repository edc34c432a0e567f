"""What of an unknown torque shows in a residual, on the simulated drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.effects.catalogue import find
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.identifiability import identifiability
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import Solution, Term
from edge_daemon.rig.recording import simulate


@pytest.fixture(scope="module")
def plain() -> tuple[RegressionProblem, Solution]:
    made = simulate((), 9.0, seed=4)
    inertia = made.truth["parameters"]["inertia_kg_m2"]  # type: ignore[index]
    model = Model("torsion", 100.0, inertia, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
    bench = problem_of([made], model)
    return bench, fit_terms(bench, terms_of(model, bench))


def with_friction(plain: tuple[RegressionProblem, Solution], smoothing: float, friction_Nm: float) -> Solution:
    bench, base = plain
    terms = [*base.terms, Term(find("coulomb_friction", "torsion"), {"smoothing": smoothing})]
    solution = bench.solve(terms)
    return replace(solution, amplitudes={**base.amplitudes, "coulomb_friction": np.array([friction_Nm])})


def test_all_of_an_unknown_torque_shows_beside_a_linear_model(plain: tuple[RegressionProblem, Solution]) -> None:
    assert identifiability(*plain) == pytest.approx(1.0, abs=0.02)


def test_a_sign_as_wide_as_the_motion_takes_it_up(plain: tuple[RegressionProblem, Solution]) -> None:
    bench = plain[0]
    rate = float(np.std(bench.trials[0].motion.twist_rate_rad_s))
    narrow, wide = (with_friction(plain, share * rate, 0.2 * bench.rms) for share in (0.02, 1.5))
    assert identifiability(bench, narrow) > 0.5
    assert (
        identifiability(
            bench,
            replace(wide, amplitudes={**wide.amplitudes, "coulomb_friction": 8 * wide.amplitudes["coulomb_friction"]}),
        )
        < 0.3
    )


def test_a_model_that_runs_away_explains_nothing(
    plain: tuple[RegressionProblem, Solution], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its torques overflow: that is told by the number, without a warning of a library."""
    monkeypatch.setattr("edge_daemon.identify.identifiability._modelled", lambda bench, _: 1e200 * bench.target)
    assert identifiability(*plain) == 0.0
