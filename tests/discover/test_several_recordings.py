"""A law of what only differs between recordings: each was made at one temperature."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.discover.discover import discover
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.screening import Library, Screening
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.problem import problem_of, terms_of

RATE_HZ, INERTIA, DRAG, FRICTION, HALVES_OVER_K, KNEE = 500.0, 0.8, 3.0, 4.0, 10.0, 0.25


def recorded(temperature_degC: float, seed: int) -> SimpleNamespace:
    """A joint whose grease rubs half as much for every ten kelvin, by its angle and its torque."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(16.0 * RATE_HZ)) / RATE_HZ
    rows = [(size, 2 * math.pi * hz, rng.uniform(0, 6)) for hz, size in ((0.19, 0.9), (0.61, 0.3), (1.7, 0.05))]
    angle, speed, acceleration = (
        sum(size * w**k * np.sin(w * time_s + phase + k * math.pi / 2) for size, w, phase in rows) for k in range(3)
    )
    grease = FRICTION * 2.0 ** (-(temperature_degC - 25.0) / HALVES_OVER_K) * speed / (np.abs(speed) + KNEE)
    torque = INERTIA * acceleration + DRAG * speed + grease + rng.normal(0, 0.02, len(time_s))
    columns = {"theta_out_rad": angle + rng.normal(0, 2e-6, len(time_s)), "torque_in_Nm": torque / 100.0}
    columns["temperature_degC"] = temperature_degC + rng.normal(0, 0.05, len(time_s))
    return SimpleNamespace(time_s=time_s, columns=columns)


@pytest.mark.slow
def test_friction_that_fades_with_warmth_is_told_of_recordings_at_one_temperature_each() -> None:
    """The temperature was no axis of any of them: another law of it was told at 0.99, and left nine noise floors."""
    model = Model("drive", 100.0, math.nan, (ModelEffect("inertia"), ModelEffect("viscous_friction")))
    found = discover([recorded(degC, i) for i, degC in enumerate((10.0, 23.0, 38.0))], model)
    best = found.proposals[0]
    assert "exp(-0.0" in best.expression and "temperature_degC" in best.expression
    assert best.nrmse_after < 1.5 * found.error.noise_floor_nrmse
    assert found.verdict == "unexplained"


def test_a_hum_is_heard_in_recordings_a_day_apart_as_in_one() -> None:
    """One spectrum over all the time between them held millions of places, and took 20 s; over days it never ended."""
    model = Model("drive", 100.0, math.nan, (ModelEffect("inertia"), ModelEffect("viscous_friction")))
    rows = [recorded(25.0, i) for i in range(3)]
    for row, began_s in zip(rows, (0.0, 3600.0, 86400.0), strict=True):
        row.columns["torque_in_Nm"] += 0.02 * np.sin(2 * math.pi * 7.0 * row.time_s + began_s)
        row.time_s = row.time_s + began_s
    problem = problem_of(rows, model)
    leftover = Leftover(problem, fit_terms(problem, terms_of(model, problem)), model)
    library = Library(leftover)
    assert library.placed("time_s").size < 2 * 6 * 60 * 16.0 * 1.1  # as many as of one
    hums = [row for row in Screening(library, leftover.left).promises() if row.product.factors[0].axis == "time_s"]
    best = next(row for row in hums if row.product.waves and len(row.product.factors) == 1)
    assert best.product.factors[0].numbers[0] == pytest.approx(2 * math.pi * 7.0, rel=2e-3)
