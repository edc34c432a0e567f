"""A curve of stations in place of a law of stiffness."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.effects.expression import evaluate, parse
from edge_daemon.effects.model import ModelEffect
from edge_daemon.identify.fit import fit
from edge_daemon.rig.recording import simulate
from edge_daemon.stiffness.stations import stiffness_form
from tests.discover.laws import SECONDS, joint

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("name", "left"), [("stiffness_table", 0.02), ("stiffness_spline", 0.05)])
def test_a_stiffness_of_no_law_follows_the_curve_it_does_not_know(name: str, left: float) -> None:
    recording = simulate(("polynomial_stiffness",), seconds=SECONDS, seed=4)
    model, true = joint(recording), recording.truth["parameters"]
    assert isinstance(true, dict)
    before = fit([recording], model)
    text = stiffness_form([recording], model, name)
    after = fit([recording], model.with_effect(ModelEffect(name, {}, text)))
    assert after.solution.rmse < left * before.solution.rmse
    phi = 2e-4 * np.array([-1.0, 1.0])
    names = {**{row: held.value for row, held in after.model.effects[-1].parameters.items()}, "twist_rad": phi}
    torque = after.model.effects[0].parameters["stiffness"].value * phi + evaluate(
        parse(text, ["twist_rad"]).tree, names
    )
    k1, k2 = (true[f"polynomial_stiffness.{row}"] for row in ("k1_Nm_per_rad2", "k2_Nm_per_rad3"))
    wanted = (true["stiffness_Nm_per_rad"] + (k1 + k2 * phi) * phi) * phi
    assert torque == pytest.approx(wanted, rel=5e-3)
