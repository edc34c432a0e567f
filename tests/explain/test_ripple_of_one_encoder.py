"""Orders of ripple, named with one encoder."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.effects.catalogue import find
from edge_daemon.effects.effect import Wave
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose, searched
from edge_daemon.identify.fit import fit
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.identify.solution import Term
from edge_daemon.search.free_orders import further, with_orders
from tests.explain.one_encoder import KNOWN, MESH, PLAIN, RIPPLE, RIPPLE_NAME, model, named_in_steps
from tests.explain.simulated_drives import PLAIN_SENSING, RATIO, Arm, Joint, Sensing, record

pytestmark = pytest.mark.slow


def test_orders_that_overlap_are_named_by_what_turns_so_often() -> None:
    """Half a turn of the output does not resolve 198 from 200 in it."""
    arm = replace(PLAIN, waves=(("between", 2.0, 0.5, 2.1), ("in", 2.0, 0.4, 0.4)))
    fitted = fit([record(arm, 4)], model())
    found = with_orders(find("wave_generator_ripple", "drive"), fitted.solution, fitted.problem)
    assert found is not None and set(found.waves) == {Wave("input", 2.0), Wave("difference", 2.0)}


def test_orders_of_a_pair_are_those_beside_its_other_part() -> None:
    """Below drag that the model lacks, a line was called by its neighbour, and the promised error was not reached."""
    arm = replace(PLAIN, viscous_Nms=15.0, waves=(("between", 2.0, 0.6, 1.0),))
    recording = record(arm, 6, sensing=Sensing(rate_hz=250.0, bits=19, noise=0.002))
    known = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", "coulomb_friction", "gravity_load"))))
    added = add_effect(known, "viscous_friction+wave_generator_ripple", [recording])
    row = added.model.effect("wave_generator_ripple")
    assert row is not None and row.waves == (Wave("difference", 2.0),)
    assert added.after.nrmse < 1.5 * added.after.noise_floor_nrmse


def test_further_orders_of_a_pair_are_those_beside_its_other_part() -> None:
    """What was named was refused: below the drag that came with it no further order stood out."""
    arm = replace(PLAIN, viscous_Nms=15.0, waves=(("in", 2.0, 0.6, 1.0), ("in", 5.0, 0.05, 0.4)))
    recording = record(arm, 6, sensing=Sensing(rate_hz=250.0, bits=19, noise=0.002))
    ripple = ModelEffect("wave_generator_ripple", waves=(Wave("input", 2.0),))
    rest = map(ModelEffect, ("inertia", "coulomb_friction", "gravity_load"))
    added = add_effect(
        Model("drive", RATIO, math.nan, (*rest, ripple)), "viscous_friction+wave_generator_ripple", [recording]
    )
    row = added.model.effect("wave_generator_ripple")
    assert row is not None and row.waves == (Wave("input", 2.0), Wave("input", 5.0))


@pytest.mark.parametrize(
    ("arm", "name"), [(PLAIN, ""), (RIPPLE, "wave_generator_ripple"), (MESH, "load_dependent_friction")]
)
def test_two_seconds_tell_what_they_can(arm: Arm, name: str) -> None:
    found = diagnose([record(arm, 7, 2.0)], model())
    assert [row.effect for row in found.candidates[:1]] == ([name] if name else [])
    assert found.verdict == ("missing" if name else "adequate")


def swelling(acts: str) -> Joint:
    """Ripple twice a turn of the motor, as it is and with what passes the gear of a weight."""
    read = record(replace(RIPPLE, weight_Nm=40.0), 2, 30.0)
    angle, rate_hz = read.columns["theta_out_rad"], PLAIN_SENSING.rate_hz
    even = np.convolve(angle, np.hanning(31) / np.hanning(31).sum(), mode="same")
    carried = 40.0 * np.sin(angle) + RIPPLE.inertia_kg_m2 * np.gradient(np.gradient(even)) * rate_hz**2
    carried[[*range(40), *range(-40, 0)]] = 0.0
    felt = {
        "by its size": np.abs(carried),
        "as it is": carried,
        "as it rubs": np.abs(carried) * np.sign(np.gradient(even)),
    }
    more = 0.03 * felt[acts] * np.sin(2 * RATIO * angle + 1.0) / RATIO
    return Joint(read.time_s, {**read.columns, "torque_in_Nm": read.columns["torque_in_Nm"] + more})


@pytest.mark.parametrize("acts", ["by its size", "as it is", "as it rubs"])
def test_ripple_that_grows_with_the_load_is_told_from_ripple_that_does_not(acts: str) -> None:
    """What a weight carries as it is, or as it rubs, was told as ripple at either side of its order, at 1.00."""
    assert named_in_steps(swelling(acts), *KNOWN) == {"wave_generator_ripple", "load_ripple"}


@pytest.mark.parametrize("seed", [1, 3])
def test_ripple_that_swells_over_the_output_is_no_ripple_of_the_load(seed: int) -> None:
    """Its side bands, an order of the output to either side, were offered as five orders that grow with the load."""
    own, beside = (3.0, 8.0), (-1 / RATIO, 0.0, 1 / RATIO)
    waves = tuple(("in", n + d, 0.4 if d else 1.0, 0.4 * n + 30 * d) for n in own for d in beside)
    problem = problem_of([record(replace(PLAIN, weight_Nm=25.0, waves=waves), seed)], model())
    ripple = find("wave_generator_ripple", "drive").over(tuple(Wave("input", n) for n in own))  # type: ignore[misc]
    solution = problem.fit([*terms_of(model(), problem), Term(ripple, {})])
    of_load, more = (with_orders(row, solution, problem) for row in (find("load_ripple", "drive"), further(ripple)))
    assert of_load is None or all(wave.angle == "input" and wave.order % 1 == 0 for wave in of_load.waves)
    assert more is not None and {wave.angle for wave in more.waves} == {"output"}


def test_a_motion_that_goes_one_way_tells_no_ripple_of_either_direction() -> None:
    """Each wave and the same with the sign of the motion shared one amplitude, and none was identified."""
    whole = record(RIPPLE, 4, 30.0)
    speed = np.gradient(whole.columns["theta_out_rad"], whole.time_s)
    forward = speed > 0.3 * speed.std()
    columns = {name: np.where(forward, column, math.nan) for name, column in whole.columns.items()}
    fitted = fit([Joint(whole.time_s, columns)], model(RIPPLE_NAME))
    sizes = dict(zip([row.name for row in find(RIPPLE_NAME, "drive").amplitudes],
                     fitted.solution.amplitudes[RIPPLE_NAME], strict=True))  # fmt: skip
    assert math.hypot(sizes["sine_2"], sizes["cosine_2"]) == pytest.approx(0.3 / RATIO, rel=0.1)
    assert not any(size for name, size in sizes.items() if name.endswith("_directed"))


def test_waves_that_cancel_each_other_are_no_ripple() -> None:
    """A motion that hardly ever goes back was explained by 84 A forward less 84 A with the sign of the motion."""
    search, _ = searched([record(RIPPLE, 4)], model())
    ripple = Term(find(RIPPLE_NAME, "drive"), {})
    solution = search.regression.solve([*search.base.solution.terms, ripple])
    assert search.carried(search.hypothesis((RIPPLE_NAME,), solution))
    large = solution.amplitudes[RIPPLE_NAME] + 100.0 * search.regression.rms
    astray = replace(solution, amplitudes={**solution.amplitudes, RIPPLE_NAME: large})
    assert not search.carried(search.hypothesis((RIPPLE_NAME,), astray))


def test_a_wave_of_few_periods_of_the_output_is_ripple_of_that() -> None:
    """Its broad line hides among its neighbours: the joint was called unexplained at 41 floors."""
    arm = replace(PLAIN, waves=(("out", 7.0, 0.6, 0.4),))
    recording = record(arm, 5)
    assert 2.0 < 7 * np.ptp(recording.columns["theta_out_rad"]) / (2 * math.pi) < 6.0
    found = diagnose([recording], model())
    assert found.candidates[0].effect == RIPPLE_NAME
    added = add_effect(model(), RIPPLE_NAME, [recording]).model.effect(RIPPLE_NAME)
    assert added is not None and [(wave.angle, wave.order) for wave in added.waves] == [("output", 7.0)]


@pytest.mark.parametrize("order", [1.417, 2.824])
def test_an_order_is_told_as_sharply_as_the_balance_hears_it(order: float) -> None:
    """A spectrum of waves that did not pass the balance's filter put 2.824 at 2.83, with five orders of the output to
    mend it, and 55 noise floors were left."""
    recording = record(replace(PLAIN, waves=(("in", order, 3.0, 0.4),)), 8, 12.0, Sensing(bits=24, noise=1e-4))
    done = add_effect(model(), RIPPLE_NAME, [recording])
    added = done.model.effect(RIPPLE_NAME)
    assert added is not None and [(wave.angle, wave.order) for wave in added.waves] == [("input", order)]
    assert done.after.nrmse < 1.5 * done.after.noise_floor_nrmse


@pytest.mark.parametrize(("orders", "pace"), [((9.4,), 1.0), ((7.4, 18.8), 1.0), ((3.7, 9.4), 0.3)])
def test_what_is_geared_to_the_output_repeats_with_no_whole_order_of_it(orders: tuple[float, ...], pace: float) -> None:
    """Over a third of its turn, or one: whole orders beside the true ones left up to 68 floors, and two rollers out of
    round were no ripple at all."""
    recording = record(Arm(waves=tuple(("out", order, 0.6, 0.4) for order in orders)), 5, sensing=Sensing(pace=pace))
    joint = Model(
        "drive", RATIO, math.nan, tuple(map(ModelEffect, ("inertia", "viscous_friction", "coulomb_friction")))
    )
    done = add_effect(joint, RIPPLE_NAME, [recording])
    added = done.model.effect(RIPPLE_NAME)
    assert added is not None and [(wave.angle, wave.order) for wave in added.waves] == [
        ("output", order) for order in orders
    ]
    assert done.after.nrmse < 1.4 * done.after.noise_floor_nrmse
