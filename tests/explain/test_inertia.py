"""An inertia beside a torque sensor: Newton's law holds whatever the gear does, and explains nothing of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.catalogue import find
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit_terms, floor_of
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.identify.solution import Term
from edge_daemon.search.hypotheses import DiagnosisProblem

STIFFNESS, INERTIA = 2e4, 0.05
BASE = Model("torsion", 100.0, INERTIA, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))


def recording() -> SimpleNamespace:
    """A spring and a torque sensor, by inverse dynamics of four tones."""
    rng = np.random.default_rng(11)
    t = np.arange(10_000) / 1000.0
    out, torque = np.zeros(len(t)), np.zeros(len(t))
    for tone in (0.7, 3.1, 7.3, 13.7):
        w = 2 * np.pi * tone
        wave = 0.4 / w * np.sin(w * t + rng.uniform(0, 6))
        out += wave
        torque -= INERTIA * w**2 * wave
    columns = {
        "theta_in_rad": 100 * (out + torque / STIFFNESS) + rng.normal(0, 1e-5, len(t)),
        "theta_out_rad": out + rng.normal(0, 1e-7, len(t)),
        "torque_out_Nm": torque + rng.normal(0, 0.002, len(t)),
    }
    return SimpleNamespace(time_s=t, columns=columns)


@pytest.mark.parametrize(("share", "kept"), [(0.0, 1.0), (0.6, 0.4), (-0.6, 1.0)])
def test_what_newtons_law_takes_is_not_explained(share: float, kept: float) -> None:
    bench = problem_of([recording()], BASE)
    inertia = find("inertia_error", "torsion")
    solution = fit_terms(bench, [*terms_of(BASE, bench), Term(inertia, inertia.start)])
    taken = {**solution.amplitudes, "inertia_error": np.array([share * INERTIA])}
    base = fit_terms(bench, terms_of(BASE, bench))
    problem = DiagnosisProblem(bench, base, (), lambda s: floor_of(bench, BASE, s), lambda what, done: None)
    found = problem.hypothesis(("inertia_error",), replace(solution, amplitudes=taken))
    whole = min(floor_of(bench, BASE, found.solution), problem.most_floor)
    assert found.floor == pytest.approx(kept * whole, rel=0.02)
