"""The closed loop: which motion it asks for, what each tells in bits, and when it has nothing to ask.

That it ends with the right cause on the simulated drive: `tests/commands/test_experiment.py`, tools/bench_experiment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain import closed_loop
from edge_daemon.explain.closed_loop import ClosedLoop, doubt_bits, expected_bits
from edge_daemon.explain.plan import MotionLimits
from edge_daemon.explain.results import Candidate, Diagnosis, Error, Experiment
from edge_daemon.rig.recording import simulate

SECONDS = 8.1
MODEL = Model("torsion", 100.0, 0.1, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))


def told(*rows: tuple[str, float], plan: Experiment | None = None) -> Diagnosis:
    candidates = tuple(Candidate(name, 0.5, 0.1, p, (), {}) for name, p in rows)
    return Diagnosis("missing", Error(0.5, 0.1, 1.0, "N m"), candidates, plan)


def test_bits_are_those_of_the_beliefs() -> None:
    even = told(("a", 0.5), ("b", 0.5))
    assert doubt_bits(even) == pytest.approx(1.0) and doubt_bits(told(("a", 1.0))) == 0.0
    plan = Experiment(("a", "b"), "", (1.0,), (1.0,), 30.0, 5.0)
    assert expected_bits(even, plan) == pytest.approx(1.0)
    shared = told(("a", 0.25), ("b", 0.25), ("c", 0.5))
    assert expected_bits(shared, plan) == pytest.approx(0.5), "half of the belief is in neither"
    assert expected_bits(shared, replace(plan, separates=())) == pytest.approx(1.5), "all of them are judged"


def test_a_motion_is_made_once_and_only_where_it_tells(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = Experiment(("a", "b"), "", (1.0, 2.0, 5.0), (1.0, 1.0, 1.0), 30.0, 5.0)
    said = told(("a", 0.6), ("b", 0.4), plan=plan)

    def fake(_recordings: Sequence[object], _model: Model, limits: MotionLimits | None = None) -> Diagnosis:
        return said

    monkeypatch.setattr(closed_loop, "diagnose", fake)
    rich = simulate([], SECONDS, 1)
    loop = ClosedLoop(MODEL, [rich])
    assert len(list(loop.follow(lambda _plan: rich))) == 1, "the same motion again tells nothing new"
    first = ClosedLoop(MODEL, [simulate([], SECONDS, 1, motion="poor")], MotionLimits(tone_hz=10.0)).plan()
    assert first is not None and first.separates == () and len(first.tones_hz) > 2 and max(first.tones_hz) < 10.0
    for poor in (replace(plan, separation=1.05), replace(plan, needs_hands=True), replace(plan, separation=math.nan)):
        said = told(("a", 0.6), ("b", 0.4), plan=poor)
        assert ClosedLoop(MODEL, [rich]).plan() is None
