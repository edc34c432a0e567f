"""The fit against truths it does not know: bias, honesty of the standard deviations, what is not identified."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.model import FittedParameter, Model, ModelEffect, ModelError
from edge_daemon.identify.fit import fit
from edge_daemon.rig.recording import simulate

BASE = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))


def exact(seed: int, stiffness: float, damping: float, noise_out_rad: float, seconds: float = 12.0) -> SimpleNamespace:
    """A recording by inverse dynamics: output prescribed, twist from the balance in closed form, white noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 1000)) / 1000.0
    out, twist = np.zeros(len(t)), np.zeros(len(t))
    for tone in (0.7, 3.1, 7.3, 13.7):
        w, p = 2 * np.pi * tone, rng.uniform(0, 6)
        size = 0.5 / w
        response = 0.1 * -(w**2) / (stiffness + 1j * w * damping)
        out += size * np.sin(w * t + p)
        twist += size * np.abs(response) * np.sin(w * t + p + np.angle(response))
    columns = {
        "theta_in_rad": 100 * (out + twist) + rng.normal(0, 1e-5, len(t)),
        "theta_out_rad": out + rng.normal(0, noise_out_rad, len(t)),
    }
    return SimpleNamespace(time_s=t, columns=columns)


def test_noise_in_the_twist_does_not_bias_a_stiff_gear() -> None:
    """18 bits at K = 1e5: naive least squares is 5 % low here."""
    noise = 2 * np.pi / 2**18 / np.sqrt(12)
    model = Model("torsion", 100.0, 0.1, BASE)
    found = [
        fit([exact(seed, 1e5, 10.0, noise)], model).model.value("linear_stiffness", "stiffness") for seed in range(6)
    ]
    spread = np.std(found, ddof=1) / np.sqrt(len(found))
    assert abs(np.mean(found) - 1e5) < 4 * spread + 100
    assert abs(np.mean(found) - 1e5) < 1000


def test_standard_deviations_are_honest() -> None:
    """Errors over their stated sd scatter by about one."""
    noise = 2 * np.pi / 2**20 / np.sqrt(12)
    model = Model("torsion", 100.0, 0.1, BASE)
    scores = []
    for seed in range(16):
        fitted = fit([exact(seed, 3e4, 5.0, noise)], model).model
        for effect, name, truth in (("linear_stiffness", "stiffness", 3e4), ("viscous_damping", "damping", 5.0)):
            row = fitted.effect(effect).parameters[name]  # type: ignore[union-attr]
            scores.append((row.value - truth) / row.sd)
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.7


def test_cubic_stiffness_of_the_article_is_not_identified_and_says_what_would() -> None:
    """k1 = -1e3, k2 = 5 change the torque by 2e-6 and 2e-12 of itself."""
    model = Model("torsion", 100.0, 0.1, (*BASE, ModelEffect("polynomial_stiffness")))
    fitted = fit([exact(1, 3e4, 5.0, 2 * np.pi / 2**20 / np.sqrt(12))], model)
    for name in ("k1", "k2"):
        row = fitted.model.effect("polynomial_stiffness").parameters[name]  # type: ignore[union-attr]
        assert not row.identified and row.sd > 1e3
        assert "torque" in fitted.advice["polynomial_stiffness", name]
        bound = re.search(
            r"zero would do as well; it is below ([-+.e\d]+),", fitted.advice["polynomial_stiffness", name]
        )
        assert bound and abs({"k1": -1e3, "k2": 5.0}[name]) < float(bound[1])
    assert fitted.model.effect("linear_stiffness").parameters["stiffness"].identified  # type: ignore[union-attr]


def test_outliers_do_not_spoil_the_fit() -> None:
    made = exact(2, 3e4, 5.0, 1e-7)
    spoiled = made.columns["theta_out_rad"].copy()
    spoiled[np.random.default_rng(0).choice(len(spoiled), 6, replace=False)] += 0.01
    made.columns["theta_out_rad"] = spoiled
    fitted = fit([made], Model("torsion", 100.0, 0.1, BASE))
    assert fitted.model.value("linear_stiffness", "stiffness") == pytest.approx(3e4, rel=2e-3)


@pytest.mark.slow
def test_friction_in_the_loop_reaches_the_floor() -> None:
    made = simulate(("coulomb_friction",), 15.0, seed=4)
    truth = made.truth["parameters"]
    inertia = truth["inertia_kg_m2"]  # type: ignore[index]
    fitted = fit([made], Model("torsion", 100.0, inertia, (*BASE, ModelEffect("coulomb_friction"))))
    assert fitted.nrmse < 3 * fitted.floor / fitted.problem.rms
    level = truth["coulomb_friction.level_Nm"]  # type: ignore[index]
    assert fitted.model.value("coulomb_friction", "friction") == pytest.approx(level, rel=0.02)


@pytest.mark.slow
def test_the_held_out_residual_is_what_the_held_out_error_sums_up() -> None:
    made = simulate(("coulomb_friction",), 12.0, seed=7)
    inertia = made.truth["parameters"]["inertia_kg_m2"]  # type: ignore[index]
    fitted = fit([made], Model("torsion", 100.0, inertia, (*BASE, ModelEffect("coulomb_friction"))))
    residual = fitted.problem.held_out_residual(fitted.solution)
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(fitted.solution.rmse, rel=1e-3)


def test_a_users_expression_takes_an_outside_effect_to_the_floor() -> None:
    made = simulate(("outside_vibration",), 15.0, seed=5)
    truth = made.truth["parameters"]
    start = 2 * np.pi * truth["outside_vibration.frequency_hz"] * 1.0005  # type: ignore[index]
    own = ModelEffect("shaker", {"w": FittedParameter(start)}, "a * sin(w * time_s) + b * cos(w * time_s)", "N m")
    fitted = fit([made], Model("torsion", 100.0, truth["inertia_kg_m2"], (*BASE, own)))  # type: ignore[index]
    assert fitted.nrmse < 1.3 * fitted.floor / fitted.problem.rms
    assert fitted.model.value("shaker", "w") == pytest.approx(start / 1.0005, rel=1e-4)


@pytest.mark.parametrize(
    "formula", ["a * tanh(twist_rate_rad_s / v)", "a * exp(c * theta_out_rad) * tanh(twist_rate_rad_s / v)"]
)
def test_a_formula_that_states_no_values_is_looked_for_over_decades(formula: str) -> None:
    """Friction creeps below some 1e-3 rad/s: from 1 rad/s on nothing leads there."""
    made = simulate(("coulomb_friction",), 12.0, seed=4)
    truth = made.truth["parameters"]
    inertia, level = truth["inertia_kg_m2"], truth["coulomb_friction.level_Nm"]  # type: ignore[index]
    own = ModelEffect("mine", {}, formula, "N m")
    without, found = (fit([made], Model("torsion", 100.0, inertia, rows)) for rows in (BASE, (*BASE, own)))
    assert found.nrmse < without.nrmse / 5
    assert found.model.value("mine", "a") == pytest.approx(level, rel=0.05)
    assert found.model.value("mine", "v") < 0.01


def test_missing_column_is_named() -> None:
    model = Model("torsion", 100.0, 0.1, (*BASE, ModelEffect("temperature_stiffness")))
    with pytest.raises(ModelError, match="temperature_stiffness: needs temperature_degC"):
        fit([exact(1, 3e4, 5.0, 1e-7)], model)


@pytest.mark.parametrize("damage", ["lost", "gap", "spikes"])
def test_damage_changes_neither_the_stiffness_nor_the_noise_floor(damage: str) -> None:
    made = exact(3, 3e4, 5.0, 1e-7)
    model = Model("torsion", 100.0, 0.1, BASE)
    whole = fit([made], model)
    rng, out, keep = np.random.default_rng(1), made.columns["theta_out_rad"].copy(), np.ones(12_000, dtype=bool)
    match damage:
        case "lost":
            out[rng.random(len(out)) < 0.01] = np.nan
        case "gap":
            keep[5000:5700] = False
        case "spikes":
            out[rng.choice(len(out), 5, replace=False)] += 0.1
    columns = {"theta_in_rad": made.columns["theta_in_rad"][keep], "theta_out_rad": out[keep]}
    damaged = fit([SimpleNamespace(time_s=made.time_s[keep], columns=columns)], model)
    assert damaged.model.value("linear_stiffness", "stiffness") == pytest.approx(3e4, rel=1e-3)
    assert damaged.floor == pytest.approx(whole.floor, rel=0.1)
    assert damaged.nrmse < 1.3 * whole.nrmse


@pytest.mark.parametrize(
    "formula", ["a * log(-1)", "a * sqrt(theta_in_rad)", "a / 0", "a * exp(exp(exp(theta_in_rad)))"]
)
def test_a_formula_without_a_number_for_each_row_is_refused_by_name(formula: str) -> None:
    simulated = simulate([], seconds=9.0, seed=2)
    effects = (ModelEffect("linear_stiffness"), ModelEffect("mine", expression=formula))
    with pytest.raises(ModelError, match=r"^mine: .*no usable number"):
        fit([simulated], Model("torsion", 100.0, 0.05, effects))


def test_lost_rows_cost_little() -> None:
    simulated = simulate(["kinematic_error"], seconds=20.0, seed=4)
    known = simulated.truth["parameters"]
    names = ("linear_stiffness", "viscous_damping", "kinematic_error")
    model = Model("torsion", known["ratio"], known["inertia_kg_m2"], tuple(map(ModelEffect, names)))
    kept = np.random.default_rng(1).random(len(simulated.time_s)) >= 0.3
    columns = {name: column[kept] for name, column in simulated.columns.items()}
    found = fit([SimpleNamespace(time_s=simulated.time_s[kept], columns=columns)], model)
    stiffness = found.solution.amplitude("linear_stiffness", "stiffness")
    assert stiffness == pytest.approx(known["stiffness_Nm_per_rad"], rel=5e-4)
