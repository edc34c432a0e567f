"""Verdict, probability and number agree; what is promised is what `add` delivers."""

from __future__ import annotations

import math
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from edge_daemon.effects.catalogue import find
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.results import Diagnosis, none_of
from edge_daemon.motion.residual_statistics import independent
from edge_daemon.rig.recording import Simulated, simulate
from edge_daemon.search.belief import (
    SHOWN,
    beliefs,
    believable_level,
    none_log_weight,
    outside_log_weight,
    step_log_weight,
)
from edge_daemon.search.thresholds import EXPLAINED_FLOORS, GUESS, MEASURED, SEEN, TABLE

pytestmark = pytest.mark.slow

CASES: dict[str, tuple[tuple[str, ...], float, int, int, str]] = {
    "friction": (("coulomb_friction",), 12.0, 3, 20, "rich"),
    "two": (("kinematic_error", "coulomb_friction"), 9.0, 4, 22, "rich"),
    "gap": (("backlash",), 9.0, 6, 20, "rich"),
    "outside": (("outside_twist_times_angle",), 12.0, 3, 24, "rich"),
    "hanging": (("gravity_load",), 9.0, 5, 22, "rich"),
    "healthy": ((), 20.0, 408984900, 18, "slow"),
    "one tone": (("polynomial_stiffness",), 12.0, 4, 20, "poor"),
}


def base_model(made: Simulated) -> Model:
    inertia = made.truth["parameters"]["inertia_kg_m2"]  # type: ignore[index]
    return Model("torsion", 100.0, inertia, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))


@cache
def recording(name: str) -> Simulated:
    effects, seconds, seed, bits, motion = CASES[name]
    return simulate(effects, seconds, seed=seed, bits_out=bits, motion=motion)


@cache
def diagnosis(name: str) -> Diagnosis:
    return diagnose([recording(name)], base_model(recording(name)))


@pytest.mark.parametrize("name", CASES)
def test_verdict_probability_and_number_agree(name: str) -> None:
    found = diagnosis(name)
    floors = found.error.nrmse / found.error.noise_floor_nrmse
    if found.verdict == "adequate":
        assert floors < EXPLAINED_FLOORS and found.error.nrmse < 1
    if found.verdict == "missing":
        first = found.candidates[0]
        group = [row for row in found.candidates if row is first or row.effect in first.confused_with]
        assert floors > 1 and sum(row.probability for row in group) >= none_of(found.candidates)
    if found.verdict == "unexplained":
        assert all(row.probability < none_of(found.candidates) for row in found.candidates)
        assert found.next_experiment is not None or not found.candidates
    assert sum(row.probability for row in found.candidates) <= 1


@pytest.mark.parametrize(
    ("name", "effect", "belief"),
    [
        ("friction", "coulomb_friction", 0.95),
        ("two", "kinematic_error+coulomb_friction", 0.95),
        ("gap", "backlash", 0.9),
    ],
)
def test_what_leaves_nothing_but_noise_is_believed(name: str, effect: str, belief: float) -> None:
    first = diagnosis(name).candidates[0]
    assert first.effect == effect and first.probability > belief


def test_one_tone_leaves_a_doubt_whatever_it_leaves_of_the_error() -> None:
    first = diagnosis("one tone").candidates[0]
    assert first.effect == "polynomial_stiffness" and 0.5 < first.probability < 0.9


def test_two_causes_that_nothing_tells_apart_share_the_belief() -> None:
    """Of fourteen such ties on simulated gears the usual one was right in five."""
    first, second = diagnosis("hanging").candidates[:2]
    assert (first.effect, second.effect) == ("gravity_load", "encoder_eccentricity")
    assert second.effect in first.confused_with and second.probability > 0.4 * first.probability


@pytest.mark.parametrize(("level", "most"), [(1.2, 1.0), (3.6, 0.9), (7.0, 0.3)])
def test_a_law_that_leaves_floors_above_the_noise_is_no_certainty(level: float, most: float) -> None:
    best, base = SimpleNamespace(level=level, error=level), SimpleNamespace(error=40.0)
    belief = beliefs(np.zeros(1), [none_log_weight(best, base, poor=False, count=2000.0)])[0]  # type: ignore[arg-type]
    assert most - 0.25 < belief < most


def test_a_law_that_takes_nearly_all_of_a_large_error_is_not_doubted_for_its_floors() -> None:
    """Friction that is simulated follows the gear's to a hundredth, which is floors where the encoders are fine."""

    def belief(share: float) -> float:
        best, base = SimpleNamespace(level=4.6, error=share), SimpleNamespace(error=1.0)
        return float(beliefs(np.zeros(1), [none_log_weight(best, base, poor=False, count=2000.0)])[0])  # type: ignore[arg-type]

    assert belief(0.014) > 0.8 > belief(0.05) > belief(0.1)


@pytest.mark.parametrize(("before", "least"), [(12.0, 0.1), (50.0, 0.35), (400.0, 0.45), (5000.0, 0.45)])
def test_nothing_beyond_the_believable_level_is_named(before: float, least: float) -> None:
    base = SimpleNamespace(level=before, error=before)
    level = 1.001 * believable_level(base)  # type: ignore[arg-type]
    best = SimpleNamespace(level=level, error=level)
    names = beliefs(np.zeros(SHOWN), [none_log_weight(best, base, poor=False, count=2000.0)])  # type: ignore[arg-type]
    assert least < names.sum() < 0.5


@pytest.mark.parametrize(("count", "most"), [(10.0, 0.9), (1000.0, 0.3)])
def test_what_is_left_counts_as_far_as_its_samples_tell(count: float, most: float) -> None:
    """Three noise floors of a slow drift are a handful of samples; of a law that is wrong throughout they are many."""
    best, base = SimpleNamespace(level=3.0, error=0.5), SimpleNamespace(error=1.0)
    belief = beliefs(np.zeros(1), [none_log_weight(best, base, poor=False, count=count)])[0]  # type: ignore[arg-type]
    few = beliefs(np.zeros(1), [none_log_weight(best, base, poor=False, count=1.0)])[0]  # type: ignore[arg-type]
    assert belief < few and most - 0.5 < belief < most


@pytest.mark.parametrize(
    ("share", "samples", "floors", "belief"),
    [
        (0.1, 2000, 50.0, (0.97, 1.0)),
        (0.8, 400, 50.0, (0.9, 0.97)),
        (0.8, 10, 50.0, (0.5, 0.75)),
        (0.95, 500, 50.0, (0.5, 0.75)),
        (0.985, 500, 50.0, (0.0, 0.35)),
        (0.95, 2000, 1.05, (0.9, 0.99)),
    ],
)
def test_a_step_of_a_story_is_believed_by_what_it_takes_and_by_its_samples(
    share: float, samples: int, floors: float, belief: tuple[float, float]
) -> None:
    """On real joints ripple that is there took a twentieth of the error, what is not there a fiftieth; near the noise
    a twentieth is half of what is above it."""
    left = np.random.default_rng(4).normal(size=samples)
    trial = SimpleNamespace(motion=SimpleNamespace(rate_hz=100.0), step=1)
    problem = SimpleNamespace(
        trials=[trial], block=np.zeros(samples, dtype=int), held_out_residual=lambda solution: left
    )
    drag = find("viscous_friction", "drive")
    solution = SimpleNamespace(terms=(SimpleNamespace(effect=drag),))
    best: Any = SimpleNamespace(error=share, level=share * floors, solution=solution, added=(drag.name,))
    base: Any = SimpleNamespace(error=1.0, level=floors, solution=solution, added=())
    odds = step_log_weight(best, base, problem)  # type: ignore[arg-type]
    assert belief[0] < beliefs(np.zeros(1), [odds])[0] < belief[1]


@pytest.mark.parametrize(("effect", "believed"), [("wave_generator_ripple", True), ("constant_torque", False)])
def test_a_ripple_beside_slow_errors_is_believed_by_what_it_takes_where_it_is(effect: str, believed: bool) -> None:
    """Of all of the error it takes two hundredths, of what is left above the slow drift nearly all."""
    rng, place = np.random.default_rng(8), np.arange(6000)
    slow = np.cumsum(rng.normal(size=6000)) * 0.05
    after = slow - slow.mean() + rng.normal(0.0, 0.02, 6000)
    before = after + 0.2 * after.std() * np.sin(2.4 * place)
    trial = SimpleNamespace(motion=SimpleNamespace(rate_hz=100.0), step=1, rows=place, block=place // 100)
    problem: Any = SimpleNamespace(
        trials=[trial],
        block=trial.block,
        even=lambda residual: residual,
        held_out_residual=lambda solution: solution.left,
    )
    terms = (SimpleNamespace(effect=find(effect, "drive")),)

    def hypothesis(left: np.ndarray, added: tuple[str, ...]) -> Any:
        solution = SimpleNamespace(left=left, terms=terms)
        return SimpleNamespace(
            error=float(np.std(left)), level=50.0 * float(np.std(left)), solution=solution, added=added
        )

    odds = step_log_weight(hypothesis(after, (effect,)), hypothesis(before, ()), problem)
    assert (beliefs(np.zeros(1), [odds])[0] > 0.9) == believed


@pytest.mark.parametrize("name", ["friction", "two", "gap"])
def test_adding_delivers_what_the_diagnosis_promised(name: str) -> None:
    made, found = recording(name), diagnosis(name)
    done = add_effect(base_model(made), found.candidates[0].effect, [made])
    assert done.before.nrmse == pytest.approx(found.error.nrmse, rel=1e-3)
    assert done.after.nrmse == pytest.approx(found.candidates[0].nrmse_after, rel=0.02)
    assert done.helps


def test_several_recordings_are_held_out_alike_by_diagnosis_and_addition() -> None:
    """Of two motions one is too poor to determine a model by itself: blocks are held out, in either."""
    same = {"inertia_kg_m2": 0.1, "stiffness_Nm_per_rad": 3e4, "damping_Nms_per_rad": 6.0, "constant_load.load_Nm": 1.5}
    pair = [simulate(("constant_load",), 9.0, seed=s, motion=m, parameters=same) for s, m in ((1, "poor"), (2, "rich"))]
    found = diagnose(pair, base_model(pair[0]))
    done = add_effect(base_model(pair[0]), "constant_load", pair)
    promised = next(row for row in found.candidates if row.effect == "constant_load")
    assert done.before.nrmse == pytest.approx(found.error.nrmse, rel=1e-3)
    assert done.after.nrmse <= 1.02 * promised.nrmse_after


@pytest.mark.parametrize(("memory", "share"), [(0.0, 1.0), (0.8, (1 - 0.64) / (1 + 0.64))])
def test_independent_samples_of_a_first_order_process(memory: float, share: float) -> None:
    """Bartlett: of the scatter of e[k] = a e[k-1] + w, n (1 - a^2) / (1 + a^2) are independent."""
    rng = np.random.default_rng(8)
    noise, out = rng.normal(size=20_000), np.zeros(20_000)
    for k in range(1, len(out)):
        out[k] = memory * out[k - 1] + noise[k]
    block = np.repeat(np.arange(50), 400)
    assert independent(out, block, 80) / len(out) == pytest.approx(share, rel=0.1)


@pytest.mark.parametrize(("level", "odds"), [(1.0, 0.67), (1.1, 6.0)])
def test_below_the_noise_nothing_outside_does_better(level: float, odds: float) -> None:
    """Creep has a little less stiffness than the skew that is there, and so hears less noise."""
    trial = SimpleNamespace(motion=SimpleNamespace(rate_hz=1000.0), step=3)
    left = np.random.default_rng(2).normal(size=3000)
    problem = SimpleNamespace(trials=[trial], block=np.zeros(3000, dtype=int), held_out_residual=lambda solution: left)
    fitted = SimpleNamespace()
    best = SimpleNamespace(level=level, error=level, floor=1.0, parameters=1, solution=fitted)
    creep = SimpleNamespace(level=0.99, error=0.95, floor=0.96, parameters=3, solution=fitted)
    found = math.exp(outside_log_weight(best, creep, problem))  # type: ignore[arg-type]
    assert found == pytest.approx(odds, rel=0.02) if level == 1.0 else found > odds


def test_beliefs_and_what_is_none_sum_to_one() -> None:
    shares = beliefs(np.log([1.0, 0.5]), [math.log(0.5)])
    assert shares == pytest.approx([0.5, 0.25])


def test_the_table_of_thresholds_says_what_each_guards() -> None:
    assert len({row.name for row in TABLE}) == len(TABLE)
    for row in TABLE:
        assert row.kind in (MEASURED, SEEN, GUESS) and row.unit and len(row.guards) > 20 and len(row.behind) >= 10
