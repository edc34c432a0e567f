"""A user's expression: what enters how, the value, and everything hostile refused."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from edge_daemon.effects.effect import Balance
from edge_daemon.effects.expression import evaluate, parse, user_effect
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect, ModelError
from edge_daemon.identify.fit import fit
from edge_daemon.rig.recording import simulate
from tests.effects.test_catalogue import motion


@pytest.mark.parametrize(
    ("text", "amplitudes", "shapes"),
    [
        ("a * sin(w * theta_out_rad) + b * cos(w * theta_out_rad)", ("a", "b"), ("w",)),
        ("F * tanh(twist_rate_rad_s / vs)", ("F",), ("vs",)),
        ("(a + b * temperature_degC) * twist_rad", ("a", "b"), ()),
        ("-c * abs(velocity_out_rad_s) ** n", ("c",), ("n",)),
        ("a * b * twist_rad", ("a",), ("b",)),
        ("k * twist_rad / (1 + s * abs(twist_rad))", ("k",), ("s",)),
        ("m * 2 * pi * time_s", ("m",), ()),
    ],
)
def test_parameters_are_sorted_by_structure(text: str, amplitudes: tuple[str, ...], shapes: tuple[str, ...]) -> None:
    parsed = parse(text)
    assert (parsed.amplitudes, parsed.shapes) == (amplitudes, shapes)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "().__class__.__bases__[0]",
        "twist_rad.__class__",
        "open('/etc/passwd')",
        "eval('1')",
        "[a for a in (1, 2)]",
        "lambda: a",
        "a if a else a",
        "a * 'x' * 10**9",
        "a and a",
        "a < 1",
        "a[0]",
        "f'{a}'",
        "(a := 1)",
        "a * sin(*time_s)",
        "a * sin(x=1)",
        "a * sin",
        "a * sin(1, 2)",
        "a * True",
        "a * None",
        "a * 1j",
        "a * 1e999",
        "a * __builtins__",
        "(" * 400 + "a" + ")" * 400,
        "-" * 60 + "a",
        "a*" * 240 + "a",
        "a + " * 110 + "a",
        "",
        "a *",
        "import os",
        "a; a",
        "a @ a",
        "a // 2",
        "a % 2",
        "a << 9",
        "await a",
        "yield a",
        "a\x00",
        "sin(w * time_s)",
        "a * twist_rad + 1",
    ],
)
def test_refused_with_one_line(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        parse(text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


def test_endless_power_is_only_a_large_float() -> None:
    effect = user_effect(ModelEffect("big", expression="a * 9.0 ** 9 ** 9"), "torsion")
    columns, _ = effect.columns(motion(), {}, None)
    assert np.isinf(columns).all()


def test_columns_are_the_expression_per_unit() -> None:
    row = ModelEffect("own", {"w": FittedParameter(3.0)}, "a * sin(w * theta_out_rad) + b * load_kg", "N m")
    effect = user_effect(row, "torsion", columns=("load_kg",))
    assert [p.name for p in effect.amplitudes] == ["a", "b"] and effect.start == {"w": 3.0}
    block = motion()
    block.extra["load_kg"] = np.full(len(block), 2.5)  # type: ignore[index]
    columns, _ = effect.columns(block, {"w": 3.0}, None)
    np.testing.assert_allclose(columns[:, 0], np.sin(3 * block.theta_out_rad))
    np.testing.assert_allclose(columns[:, 1], 2.5)


def test_missing_column_is_named() -> None:
    effect = user_effect(ModelEffect("own", expression="a * load_kg"), "torsion", columns=("load_kg",))
    with pytest.raises(ModelError, match="load_kg"):
        effect.columns(motion(), {}, None)


def test_what_passes_the_gear_is_told_by_the_model_of_one_encoder_alone() -> None:
    law = ModelEffect("own", expression="a * abs(transmitted_Nm)")
    with pytest.raises(ModelError, match="transmitted_Nm: a model tells it with one encoder"):
        user_effect(law, "torsion")
    effect = user_effect(law, "drive")
    assert effect.loaded and effect.needs == ()
    assert not effect.columns(replace(motion(), transmitted_Nm=None), {}, None)[0].any()
    told = replace(motion(), transmitted_Nm=-motion().theta_out_rad)
    np.testing.assert_allclose(effect.columns(told, {}, None)[0][:, 0], np.abs(motion().theta_out_rad))


@pytest.mark.parametrize(
    "law",
    [
        "a * since(time_s, velocity_out_rad_s)",
        "a * exp(-way(theta_out_rad))",
        "a * lag(time_s, twist_rad**2, 0.1)",
        "a * delay(time_s, twist_rad**2, 0.1037)",
    ],
)
def test_what_a_formula_remembers_goes_on_from_block_to_block(law: str) -> None:
    effect, whole = user_effect(ModelEffect("own", expression=law), "torsion"), motion()
    expected, _ = effect.columns(whole, {}, None)
    state, parts = None, []
    for rows in (slice(0, 130), slice(130, 131), slice(131, None)):
        cut = {row.name: getattr(whole, row.name)[rows] for row in fields(whole) if row.type == "Array"}
        columns, state = effect.columns(replace(whole, **cut), {}, state)
        parts.append(columns)
    np.testing.assert_allclose(np.concatenate(parts), expected, atol=1e-12)


@pytest.mark.parametrize(
    "past", ["since(time_s, velocity_out_rad_s)", "way(theta_out_rad)", "lag(time_s, twist_rad, 0.1)"]
)
def test_a_formula_may_hold_what_it_remembers_twice(past: str) -> None:
    laws = (f"a * {past}", f"a * {past} * {past} + b * ({past})**2")
    once, twice = (user_effect(ModelEffect("own", expression=law), "torsion") for law in laws)
    whole = motion()
    single = once.columns(whole, {}, None)[0][:, 0]
    np.testing.assert_allclose(twice.columns(whole, {}, None)[0], np.stack([single**2] * 2, axis=1), atol=1e-15)


def test_what_lags_behind_a_sine_is_what_its_transfer_function_says() -> None:
    t, w, after = np.arange(20_000) / 1000.0, 2 * np.pi * 0.7, 0.8
    told = evaluate(parse("a * lag(t, x, T)", ("t", "x")).tree, {"t": t, "x": np.sin(w * t), "T": after, "a": 1.0})
    exact = (np.exp(1j * w * t) / (1 + 1j * w * after)).imag
    assert told[10_000:] == pytest.approx(exact[10_000:], abs=2e-3)


def test_what_is_delayed_is_what_it_was() -> None:
    t, late = np.arange(20_000) / 1000.0, 0.8123
    told = evaluate(parse("a * delay(t, x, T)", ("t", "x")).tree, {"t": t, "x": np.sin(4 * t), "T": late, "a": 1.0})
    assert told == pytest.approx(np.sin(4 * np.maximum(t - late, 0.0)), abs=1e-5)


def test_a_delay_of_many_samples_takes_few_of_them_along() -> None:
    memory: dict[str, tuple[float, ...]] = {}
    tree = parse("a * delay(t, x, 90)", ("t", "x")).tree
    for start in range(0, 200_000, 20_000):
        t = np.arange(start, start + 20_000) / 1000.0
        told = evaluate(tree, {"t": t, "x": np.sin(0.1 * t), "a": 1.0}, memory)
        assert told == pytest.approx(np.sin(0.1 * np.maximum(t - 90.0, 0.0)), abs=1e-4)
    assert all(len(kept) < 10_000 for kept in memory.values())


def test_time_since_a_reversal_and_way_gone() -> None:
    time_s = 0.1 * np.arange(8)
    speed = np.array([1.0, 1.0, -1.0, 0.0, -1.0, 2.0, np.nan, 2.0])
    values = {"t": time_s, "v": speed, "a": 1.0}
    since = evaluate(parse("a * since(t, v)", ("t", "v")).tree, values)
    np.testing.assert_allclose(since, [0.0, 0.1, 0.0, 0.1, 0.2, 0.0, 0.1, 0.2], atol=1e-12)
    angle = np.array([0.0, 1.0, 3.0, 2.0, 2.0, np.nan, 5.0, 5.5])
    way = evaluate(parse("a * way(x)", ("x",)).tree, {"x": angle, "a": 1.0})
    np.testing.assert_allclose(way, [0.0, 1.0, 3.0, 4.0, 4.0, 4.0, 4.0, 4.5])
    assert evaluate(parse("a * way(3)").tree, {"a": 1.0}) == pytest.approx(0.0)


WAVE = "a*sin(theta_out_rad) + b*cos(theta_out_rad)"


def test_what_an_encoder_reads_too_much_is_stiffness_times_the_angle() -> None:
    """The catalogue's error of the output's encoder is the same by another way."""
    made = simulate(seconds=6.0, seed=2)
    base = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
    model = Model("torsion", 100.0, made.truth["parameters"]["inertia_kg_m2"], base)  # type: ignore[index]
    own = fit([made], model.with_effect(ModelEffect("tilted", {}, f"error_of_output({WAVE})")))
    listed = fit([made], model.with_effect(ModelEffect("encoder_eccentricity")))
    assert own.nrmse == pytest.approx(listed.nrmse, rel=0.01)
    assert own.solution.amplitudes["tilted"] == pytest.approx(
        listed.solution.amplitudes["encoder_eccentricity"], abs=2e-7
    )


@pytest.mark.parametrize(
    ("text", "balance", "says"),
    [
        (f"error_of_output({WAVE})", "drive", "one encoder does not tell its own error"),
        ("error_of_output(a*tanh(twist_rad/w))", "torsion", "w: expected a number"),
        ("a*error_of_output(theta_out_rad)", "torsion", "not allowed"),
        ("error_of_output(a*theta_out_rad, b)", "torsion", "not allowed"),
    ],
)
def test_an_error_of_the_output_is_all_of_a_formula_with_two_encoders(text: str, balance: Balance, says: str) -> None:
    with pytest.raises(ModelError, match=says):
        user_effect(ModelEffect("tilted", {}, text), balance)
