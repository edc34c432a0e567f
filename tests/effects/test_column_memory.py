"""What is kept of columns is what they would be if they were made anew."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects import column_memory
from edge_daemon.effects.catalogue import of_balance
from edge_daemon.effects.column_memory import ColumnMemory
from edge_daemon.effects.effect import Effect
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit
from edge_daemon.records import Array
from edge_daemon.rig.recording import simulate


def test_columns_are_kept_as_long_as_they_are_of_the_very_same() -> None:
    memory, made = ColumnMemory(), []

    def make() -> Array:
        made.append(1)
        return np.full((4, 1), float(len(made)))

    one, other = SimpleNamespace(), SimpleNamespace()
    first = memory.get("a", (one,), make)
    assert memory.get("a", (one,), make) is first and memory.get("b", (one,), make)[0, 0] == 2.0
    assert memory.get("a", (other,), make)[0, 0] == 3.0
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 0.0


def test_the_oldest_go_where_there_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(column_memory, "KEPT_BYTES", 3 * 80)
    memory, one = ColumnMemory(), SimpleNamespace()
    kept = [memory.get(i, (one,), lambda: np.zeros((10, 1))) for i in range(4)]
    assert memory.get(3, (one,), lambda: np.ones((10, 1))) is kept[3]
    assert memory.get(0, (one,), lambda: np.ones((10, 1))) is not kept[0]


RECORDED = [effect for effect in of_balance("drive") if effect.name != "model_torque"]


@pytest.fixture(scope="module")
def loaded() -> SimpleNamespace:
    made = simulate(("gravity_load", "load_dependent_friction"), 20.0, seed=3, balance="drive", bits_out=0)
    names = ("inertia", "gravity_load", "load_dependent_friction", "viscous_friction", "coulomb_friction")
    fitted = fit([made], Model("drive", 100.0, float("nan"), tuple(ModelEffect(name) for name in names)))
    return SimpleNamespace(problem=fitted.problem, solution=fitted.solution)


@pytest.mark.slow
@pytest.mark.parametrize("effect", RECORDED, ids=lambda effect: effect.name)
def test_kept_columns_follow_whatever_their_effect_hears(effect: Effect, loaded: SimpleNamespace) -> None:
    """An effect of the load must not be given the columns of another model's."""
    problem, shapes = loaded.problem, {row.name: row.start for row in effect.shapes}
    for scale in (1.0, 2.0):
        amplitudes = {name: scale * row for name, row in loaded.solution.amplitudes.items()}
        problem.learn(replace(loaded.solution, amplitudes=amplitudes))
        kept, anew = problem.kept_columns(effect, shapes), problem.columns(effect, shapes)
        assert np.array_equal(kept, anew, equal_nan=True)


def test_a_scale_of_orders_follows_what_its_waves_are_carried_by(loaded: SimpleNamespace) -> None:
    problem = loaded.problem
    problem.learn(loaded.solution)
    one = problem.order_scale(("load",))
    assert problem.order_scale(("load",)) is one and problem.order_scale(("",)) is problem.order_scale(("",))
    problem.learn(
        replace(loaded.solution, amplitudes={name: 2.0 * row for name, row in loaded.solution.amplitudes.items()})
    )
    assert np.abs(problem.order_scale(("load",)).carriers - one.carriers).max() > 0.1 * np.abs(one.carriers).max()
