"""What the search must not lose on its way: explanations that begin far from where they end."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from edge_daemon.effects.catalogue import CATALOGUE, find
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect, begun_well, with_added
from edge_daemon.explain.diagnose import WAITING, diagnose, may_be_late, searched
from edge_daemon.identify.fit import fit, fit_terms, floor_of
from edge_daemon.identify.problem import problem_of, ready_once, terms_of
from edge_daemon.identify.solution import Term
from edge_daemon.rig.motion import MotorMotion, custom, sweep, tone
from edge_daemon.rig.recording import Simulated, simulate
from edge_daemon.search.hypotheses import DiagnosisProblem, Hypothesis, without_level
from edge_daemon.search.pairs import Pairs
from edge_daemon.search.simulated_ranking import SimulatedRanking

pytestmark = pytest.mark.slow

DELAY_S = 8e-4
"""at 3 rad/s some 2.4e-3 rad: twenty times the twist"""
SIZES = {
    "inertia_kg_m2": 0.1,
    "stiffness_Nm_per_rad": 3e4,
    "damping_Nms_per_rad": 6.0,
    "encoder_skew.delay_s": DELAY_S,
}


def base_model(made: Simulated) -> Model:
    base = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
    return Model("torsion", 100.0, made.truth["parameters"]["inertia_kg_m2"], base)  # type: ignore[index]


def recording(*others: str) -> Simulated:
    return simulate(("encoder_skew", *others), 9.0, seed=8, parameters=SIZES)


def test_no_part_of_a_pair_is_replaced_by_its_other_part() -> None:
    """Two forms of one hysteresis came to be a pair: the same form twice, which ended the diagnosis with an error."""
    known = {name: effect for (balance, name), effect in CATALOGUE.items() if balance == "torsion"}
    problem: Any = SimpleNamespace(regression=None, known=known, candidates=list(known.values()))
    pair: Any = SimpleNamespace(added=("maxwell_slip_hysteresis", "bouc_wen_hysteresis"), level=10.0)
    alone: Any = SimpleNamespace(added=("maxwell_slip_hysteresis", "encoder_skew"), level=10.0)
    offered = {row.name for row in Pairs(problem, ranking=problem).instead(alone, pair.added[0])}
    assert pair.added[1] in offered
    assert {row.name for row in Pairs(problem, ranking=problem).instead(pair, pair.added[0])} == offered - {
        pair.added[1]
    }


def test_a_skew_of_twenty_twists_goes_to_the_noise() -> None:
    """A delay is more than the first term of its Taylor series, which leaves fifty noise floors here."""
    made = recording()
    found = diagnose([made], base_model(made))
    assert found.verdict == "missing" and found.candidates[0].effect == "encoder_skew"
    assert found.candidates[0].parameters["encoder_skew.delay"] == pytest.approx(DELAY_S, rel=1e-3)
    after = add_effect(base_model(made), "encoder_skew", [made]).after
    assert after.nrmse < 1.2 * after.noise_floor_nrmse


@pytest.mark.parametrize("other", ["coulomb_friction", "kinematic_error"])
def test_a_skew_of_twenty_twists_does_not_hide_another_effect(other: str) -> None:
    made = recording(other)
    first = diagnose([made], base_model(made)).candidates[0]
    assert set(first.effect.split("+")) == {"encoder_skew", other}
    assert first.parameters["encoder_skew.delay"] == pytest.approx(DELAY_S, rel=5e-3)


@pytest.mark.parametrize(("widths", "explains"), [((9.0, 0.5, 0.3), True), ((9.0, 8.0, 7.0), False)])
def test_one_element_that_never_slips_does_not_refute_the_others(widths: tuple[float, ...], explains: bool) -> None:
    made = simulate((), 9.0, seed=8)
    model = base_model(made)
    bench = problem_of([made], model)
    base = fit_terms(bench, terms_of(model, bench))
    problem = DiagnosisProblem(
        bench, base, (), lambda solution: floor_of(bench, model, solution), lambda what, share: None
    )
    names = [f"width_{i + 1}" for i in range(6)]
    shapes = {name: problem.twist_rad * (widths * 2)[i] for i, name in enumerate(names)}
    terms = [*base.terms, Term(find("maxwell_slip_hysteresis", "torsion"), shapes)]
    assert problem.sprung(terms, base.amplitude("linear_stiffness", "stiffness")) == explains


@pytest.mark.parametrize(("friction", "none"), [(0.0, True), (0.1, False)])
def test_bristles_that_hold_nothing_are_no_friction(friction: float, none: bool) -> None:
    """A pulse at each reversal takes what the measured speed does not carry of another friction's sign."""
    bristles = Term(find("lugre_friction", "drive"), {})
    solution: Any = SimpleNamespace(amplitudes={"lugre_friction": np.array([friction, 2.0])})
    assert without_level(bristles, solution) is none


def test_a_pair_names_the_form_of_hysteresis() -> None:
    """Slipping springs have more numbers and do better wherever the loop is not simulated."""
    made = simulate(("constant_load", "bouc_wen_hysteresis"), 9.0, seed=22, bits_out=20)
    first = diagnose([made], base_model(made)).candidates[0]
    assert set(first.effect.split("+")) == {"constant_load", "bouc_wen_hysteresis"}


def test_what_is_usual_comes_first_of_what_no_motion_tells_apart() -> None:
    made = simulate(("encoder_eccentricity",), 9.0, seed=5, bits_out=20)
    first = diagnose([made], base_model(made)).candidates[0]
    assert first.effect == "gravity_load" and first.confused_with == ("encoder_eccentricity",)
    assert 0.35 < first.probability < 0.65, "a weight is told first as the usual one, but no data say so"


def test_an_error_of_the_angles_may_have_hidden_most_of_the_stiffness() -> None:
    """The noise floor rises with the stiffness; what explains all must not look as if it left some."""
    sizes = {"inertia_kg_m2": 0.03, "stiffness_Nm_per_rad": 4.5e4, "kinematic_error.order2_rad": 1e-4}
    made = simulate(("kinematic_error",), 9.0, seed=8, parameters=sizes)
    model = base_model(made)
    bench = problem_of([made], model)
    base = fit_terms(bench, terms_of(model, bench))
    problem = DiagnosisProblem(
        bench, base, (), lambda solution: floor_of(bench, model, solution), lambda what, share: None
    )
    error = find("kinematic_error", "torsion")
    found = problem.hypothesis((error.name,), fit_terms(bench, [*base.terms, Term(error, error.start)]))
    assert found.floor > 2 * problem.base.floor
    assert found.level == pytest.approx(1.0, abs=0.15)


def test_adding_begins_where_a_point_of_the_grid_came_to_rest() -> None:
    """On a sweep of one amplitude, which reaches the spring's second corner in its last third only."""
    motion = MotorMotion("growing", (sweep(0.3, 16.0, 20.0, 250.0), tone(0.5, 50.0, 0.3)))
    corners = {"corner1_rad": 3e-4, "corner2_rad": 9e-4, "k2_over_k1": 1.55, "k3_over_k1": 1.8}
    sizes = {"inertia_kg_m2": 0.06, "stiffness_Nm_per_rad": 1.6e4}
    sizes |= {f"piecewise_stiffness.{name}": value for name, value in corners.items()}
    made = simulate(("piecewise_stiffness",), 20.0, seed=8, motion=motion, parameters=sizes)
    model = base_model(made)
    begun = begun_well(with_added(model, "piecewise_stiffness"), fit([made], model))
    assert begun.value("piecewise_stiffness", "corner_1") == pytest.approx(3e-4, rel=0.05)


def test_of_two_that_are_added_the_order_does_not_matter() -> None:
    """A spring of two slopes beside friction that is not there yet takes the place of all stiffness."""
    made = simulate(("piecewise_stiffness", "coulomb_friction"), 9.0, seed=4)
    model = base_model(made)
    begun = begun_well(with_added(model, "piecewise_stiffness+coulomb_friction"), fit([made], model))
    truth = made.truth["parameters"]["piecewise_stiffness.corner1_rad"]  # type: ignore[index]
    assert begun.value("piecewise_stiffness", "corner_1") == pytest.approx(truth, rel=0.05)


@pytest.mark.parametrize("seed", [3, 4])
def test_friction_of_the_teeth_leaves_the_spring_as_it_is(seed: int) -> None:
    """The drive lets the friction follow from all that passes its teeth; after it is added nothing is left to find."""
    made = simulate(("load_dependent_friction",), 12.0, seed=seed)
    drawn = made.truth["parameters"]
    assert isinstance(drawn, dict)
    added = add_effect(base_model(made), "load_dependent_friction", [made]).model
    truth = {
        ("linear_stiffness", "stiffness"): drawn["stiffness_Nm_per_rad"],
        ("viscous_damping", "damping"): drawn["damping_Nms_per_rad"],
        ("load_dependent_friction", "coefficient"): drawn["load_dependent_friction.mu"],
    }
    for (effect, name), value in truth.items():
        row = added.effect(effect).parameters[name]  # type: ignore[union-attr]
        assert row.identified and abs(row.value - value) < 4.0 * row.sd
    assert diagnose([made], added).verdict == "adequate"


def test_hysteresis_begins_where_it_is_itself_if_its_simpler_form_is_far_off() -> None:
    sizes = {"inertia_kg_m2": 0.113, "stiffness_Nm_per_rad": 20_930.0, "damping_Nms_per_rad": 7.37}
    law = {"level_Nm": 2.46, "knee_rad": 7.43e-5, "beta": 0.68}
    given = sizes | {f"bouc_wen_hysteresis.{name}": value for name, value in law.items()}
    many = custom((0.31, 1.27, 3.7, 7.9, 13.1, 21.3), (52.0,) * 6)
    made = [simulate(("bouc_wen_hysteresis",), 10.0, 7, motion=motion, parameters=given) for motion in ("poor", many)]
    best = searched(made, base_model(made[0]))[1][0]
    assert best.name == "bouc_wen_hysteresis" and best.level < 2.0


def test_a_simpler_form_follows_its_refinement_to_a_better_place() -> None:
    """Slipping springs that had come to rest in a bad place lost to the same springs of unequal grip, whose grip was
    equal: at 0.99."""
    made = simulate(("maxwell_slip_hysteresis",), 9.0, seed=8)
    model = base_model(made)
    bench = problem_of([made], model)
    base = fit_terms(bench, terms_of(model, bench))
    forms = {name: find(name, "torsion") for name in ("maxwell_slip_hysteresis", "asymmetric_hysteresis")}
    problem = DiagnosisProblem(
        bench, base, tuple(forms.values()), lambda solution: floor_of(bench, model, solution), lambda what, share: None
    )

    def begun(name: str, widths: tuple[float, ...], **more: float) -> Hypothesis:
        shapes = {f"width_{i + 1}": problem.twist_rad * width for i, width in enumerate(widths)} | more
        return problem.hypothesis((name,), bench.fit([*base.terms, Term(forms[name], shapes)], search=False))

    simple = begun("maxwell_slip_hysteresis", (3.0, 0.3, 0.3, 0.2, 0.2, 0.2))
    finer = begun("asymmetric_hysteresis", (1.5, 1.2, 0.9, 0.6, 0.4, 0.2), asymmetry=1.0)
    alone = {h.name: h.level for h in SimulatedRanking(problem, {}).run([simple])}
    found = {h.name: h.level for h in SimulatedRanking(problem, {}).run([simple], [finer])}
    assert alone["maxwell_slip_hysteresis"] > 5.0 and found["asymmetric_hysteresis"] < 1.6
    assert found["maxwell_slip_hysteresis"] < 1.05 * found["asymmetric_hysteresis"]


@pytest.mark.parametrize(
    ("levels", "late"),
    [
        ({(): 20.0, ("one",): 2.0, ("one", "two"): 1.1}, True),
        ({(): 20.0, ("one",): 6.6, ("one", "two"): 1.0}, False),
        ({(): 20.0, ("one",): 1.0}, False),
        ({(): 20.0, ("one",): 6.6, ("one", "two"): 2.0}, True),
    ],
)
def test_a_second_law_near_the_noise_may_be_a_torque_that_is_late(
    levels: dict[tuple[str, ...], float], late: bool
) -> None:
    """Slipping elements behind a torque that was 1 ms late left two noise floors, and one loop with a Stribeck effect
    was named at 1.00 for them."""
    nothing = SimpleNamespace(terms=())
    base, *found = (SimpleNamespace(added=added, error=level, solution=nothing) for added, level in levels.items())
    search: Any = SimpleNamespace(base=base, floor=lambda solution: 1.0)
    assert may_be_late(search, found) == late  # type: ignore[arg-type]


def test_a_search_that_wants_more_takes_what_another_has_fitted() -> None:
    made = simulate(("coulomb_friction", "viscous_friction"), 9.0, seed=4, balance="drive")
    model = Model("drive", 100.0, math.nan, (ModelEffect("inertia"),))
    ready = ready_once([made])
    first, _ = searched(ready, model)
    anew, alone = searched(ready, model, wanted=WAITING)
    again, taken = searched(ready, model, wanted=WAITING, earlier=first)
    assert again.regression is first.regression
    assert taken[0].added == alone[0].added and taken[0].rmse == pytest.approx(alone[0].rmse, rel=1e-3)
    left = {h.added for h in anew.tried} ^ {h.added for h in again.tried}
    assert left <= {("joint_elasticity",)}  # the earlier fit has shown already that nothing swings
