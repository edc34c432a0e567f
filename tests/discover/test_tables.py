"""A curve where no closed form is one."""

from __future__ import annotations

import re
import sys
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))

from outside_laws import torsion

from edge_daemon.discover.curve import bent
from edge_daemon.discover.extremes import stretch
from edge_daemon.discover.factors import KINDS, Factor, Product, Span
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.proposals import proposals
from edge_daemon.discover.refining import settled
from edge_daemon.discover.table import best_table, in_words, table_over
from edge_daemon.effects.expression import evaluate, parse
from edge_daemon.effects.model import ModelEffect, ModelError
from edge_daemon.identify.fit import fit, floor_of
from edge_daemon.rig.recording import Simulated, simulate
from tests.discover.laws import ignored, joint, left_by

pytestmark = pytest.mark.slow


def test_a_curve_of_places_that_were_not_seen_is_a_guess() -> None:
    seen = {axis: Span.of(np.linspace(-0.2, 0.3, 101)) for axis in ("theta_out_rad", "velocity_out_rad_s")}
    friction = Factor(KINDS["saturation"], "velocity_out_rad_s", (0.01,))

    def guessed(kind: str, *numbers: float) -> bool:
        return Product((friction, Factor(KINDS[kind], "theta_out_rad", numbers))).guessed(seen)

    assert guessed("sine", 3.0) and not guessed("sine", 9.0)
    assert guessed("exponential", 3.0) and guessed("power_1") and not guessed("beyond", 0.1, 0.005)
    assert not Product((Factor(KINDS["power_2"], "theta_out_rad"),)).guessed(seen)


def test_a_curve_of_a_wrong_shape_goes_astray_on_extremes(magnet: Leftover) -> None:
    leftover, floor = magnet, floor_of(magnet.problem, magnet.model, magnet.base)

    def error(*factors: tuple[str, tuple[float, ...]]) -> float:
        product = Product(tuple(Factor(KINDS[kind], "velocity_out_rad_s", numbers) for kind, numbers in factors))
        formula = settled(leftover, [product])
        assert formula is not None
        return stretch(leftover, formula, floor).error

    assert error(("power_1", ()), ("resonance", (0.3,))) < 1.15 < error(("saturation", (0.1,)))


def test_only_a_wrong_shape_leaves_something_to_another(magnet: Leftover) -> None:
    """Whatever else is left: a torque that swings with the time, as large as what the wrong shape leaves."""

    def left_to_others(dirt: float, *factors: tuple[str, tuple[float, ...]]) -> float:
        leftover = copy(magnet)
        swing = magnet.without_known(np.sin(7.0 * magnet.rows["time_s"])[:, None])[:, 0]
        leftover.left = magnet.left + dirt * float(np.std(magnet.left)) * swing
        product = Product(tuple(Factor(KINDS[kind], "velocity_out_rad_s", numbers) for kind, numbers in factors))
        formula = settled(leftover, [product])
        assert formula is not None
        return bent(leftover, formula)

    for dirt in (0.2, 0.5):
        assert left_to_others(dirt, ("power_1", ()), ("resonance", (0.3,))) < 0.05
    assert left_to_others(0.2, ("saturation", (0.1,))) > 0.2


def test_a_load_that_only_extremes_reach_is_not_held_out_of_them() -> None:
    law = torsion(
        "soft", "a stiffness that heat and load take, the load up to a limit", lambda s, j: j.stiffness_Nm_per_rad,
        {"size": (0.1, 0.2)},
        lambda i, p, j: -p["size"] * i.phi * min(abs(i.phi) / p["twist"], 4.0) * i.warmer_K / 10.0, warms=True,
    )  # fmt: skip
    recording = simulate(seed=3, bits_out=24, laws=(law,))
    known: dict[str, float] = recording.truth["parameters"]  # type: ignore[assignment]
    limits = [
        float(limit)
        for row in proposals([recording], joint(recording), ignored)
        for limit in re.findall(r"minimum\(abs\(twist_rad\)/([-+.e\d]+), 1\)", row.expression)
    ]
    assert limits and limits[0] == pytest.approx(4.0 * known["soft.twist"], rel=0.02)


def test_a_table_takes_the_error_where_it_stands_for_the_law(limited: Simulated) -> None:
    recording, model = limited, joint(limited)
    text = table_over([recording], model, "velocity_out_rad_s")
    before = fit([recording], model)
    after = fit([recording], model.with_effect(ModelEffect("curve", {}, text)))
    assert after.solution.rmse < 0.3 * before.solution.rmse
    with pytest.raises(ModelError, match="expected one of"):
        table_over([recording], model, "pressure_Pa")


def test_a_table_holds_its_last_value_beyond_what_was_seen_and_says_so() -> None:
    recording = simulate(seconds=9.0, seed=8)
    text = table_over([recording], joint(recording), "velocity_out_rad_s")
    numbers = {name: float(i) for i, name in enumerate(parse(text).amplitudes, start=1)}
    told = evaluate(parse(text).tree, {"velocity_out_rad_s": np.array([-99.0, 99.0]), **numbers})
    assert told.tolist() == [1.0, float(len(numbers))]
    assert in_words("velocity_out_rad_s").endswith("which is a guess")
    assert "guess" not in in_words("theta_in_rad")


def test_a_column_with_an_endless_name_is_no_obstacle(limited: Simulated) -> None:
    columns = limited.columns | {"flow_" + "x" * 90: np.sin(limited.time_s)}
    best = best_table(left_by(replace(limited, columns=columns), joint(limited)))
    assert best is not None and best[0] == "velocity_out_rad_s" and best[2] > 0.8


def test_a_curve_that_holds_in_one_half_of_the_time_only_is_no_table(limited: Simulated) -> None:
    leftover = left_by(limited, joint(limited))
    half = np.arange(len(leftover.thin.left)) < len(leftover.thin.left) // 2
    leftover.thin.left = np.where(half, leftover.thin.left, 0.0)
    best = best_table(leftover)
    assert best is None or best[0] != "velocity_out_rad_s"


def test_a_tent_is_straight_between_its_places() -> None:
    law = parse("a*tent(x, 0, 1, 3)", ("x",))
    x = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 4.0])
    assert evaluate(law.tree, {"x": x, "a": 1.0}) == pytest.approx([0, 0, 0.5, 1, 0.5, 0, 0])
    first = parse("a*tent(x, 0, 0, 1)", ("x",))
    assert evaluate(first.tree, {"x": x, "a": 1.0}) == pytest.approx([1, 1, 0.5, 0, 0, 0, 0])
