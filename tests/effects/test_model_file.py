"""The model file: read, refuse, rewrite with comments and order kept."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from edge_daemon.effects.effect import Wave
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect, ModelError, Teeth, Version
from edge_daemon.effects.model_file import parse_model, read_model, render
from edge_daemon.effects.model_undo import rewrite
from edge_daemon.effects.order_names import name_of
from edge_daemon.effects.resolve import resolve

TEXT = """# the elbow of robot 7
[joint]
balance = "torsion"            # or "drive"
ratio = 100
output_inertia_kg_m2 = 0.05    # from CAD

[[effect]]
name = "linear_stiffness"      # K

# damping, see report
[[effect]]
name = "viscous_damping"
"""


def test_reads_what_is_written() -> None:
    model = parse_model(TEXT)
    assert (model.balance, model.ratio, model.output_inertia_kg_m2) == ("torsion", 100.0, 0.05)
    assert [row.name for row in model.effects] == ["linear_stiffness", "viscous_damping"]


def test_rewriting_the_same_changes_nothing() -> None:
    assert render(TEXT, parse_model(TEXT)) == TEXT


def test_round_trip_keeps_comments_and_order(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text(TEXT)
    model = read_model(path)
    fitted = ModelEffect("linear_stiffness", {"stiffness": FittedParameter(3e4, 12.5, "N m/rad", True)})
    own = ModelEffect("wobble", {"w": FittedParameter(7.0)}, "a * sin(w * time_s)", "N m")
    model = model.with_effect(fitted).with_effect(ModelEffect("coulomb_friction")).with_effect(own)
    model = Model(
        model.balance,
        model.ratio,
        model.output_inertia_kg_m2,
        model.effects,
        (Version("fit", "a.csv", 0.2), Version("add coulomb_friction", "a.csv", 0.01)),
    )
    rewrite(path, model, "fit")
    again, text = read_model(path), path.read_text()
    assert again == Model(**{**{f: getattr(model, f) for f in model.__slots__}, "effects": again.effects})
    assert [e.name for e in again.effects] == ["linear_stiffness", "viscous_damping", "coulomb_friction", "wobble"]
    assert again.effects[0] == fitted
    assert math.isnan(again.value("wobble", "a")) and again.value("wobble", "w") == 7.0
    for comment in ("# the elbow of robot 7", "# from CAD", "# K", "# damping, see report"):
        assert comment in text
    assert text.index("linear_stiffness") < text.index("viscous_damping") < text.index("coulomb_friction")
    rewrite(path, again, "fit")
    assert path.read_text() == text


def test_effect_taken_out_leaves_the_file() -> None:
    model = parse_model(TEXT)
    text = render(TEXT, model.without("viscous_damping"))
    assert "viscous_damping" not in text and "# from CAD" in text


def test_new_file_is_a_model(tmp_path: Path) -> None:
    path = tmp_path / "new.toml"
    model = Model("drive", -101.0, math.nan, (ModelEffect("inertia"),))
    rewrite(path, model, "fit")
    again = read_model(path)
    assert again.balance == "drive" and again.ratio == -101.0 and math.isnan(again.output_inertia_kg_m2)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("ratio = 100", "ration = 100", "joint.ration: unknown key: did you mean 'ratio'"),
        ("ratio = 100", "ratio = 0", "joint.ratio: 0"),
        ("ratio = 100", 'ratio = "100"', "joint.ratio: '100': expected a number"),
        ("= 0.05", "= -1", "joint.output_inertia_kg_m2: -1"),
        ('"torsion"', '"twist"', "joint.balance: 'twist'"),
        ('"viscous_damping"', '"viscous_dampin"', r"effect\[1\].name: .*did you mean 'viscous_damping'"),
        ('"viscous_damping"', '"linear_stiffness"', "appears twice"),
        ("[[effect]]", "[[efect]]", "efect: unknown key: did you mean 'effect'"),
        ("[joint]", "[joint", "not valid TOML"),
        ('"viscous_damping"', '"own"\nexpression = "open(1)"', r"effect\[1\].expression: .*not allowed"),
        ('"viscous_damping"', '"viscous_damping"\n[effect.parameters.dampin]\nvalue = 1.0', "did you mean 'damping'"),
        ('"viscous_damping"', '"viscous_damping"\n[effect.parameters.damping]\nvalu = 1.0', "did you mean 'value'"),
        (
            '"viscous_damping"',
            '"viscous_damping"\norders = [2]',
            r"effect\[1\].orders: viscous_damping repeats with no",
        ),
        ('"viscous_damping"', '"kinematic_error"\norders = [2, 2.0]', r"effect\[1\].orders: order 2 appears twice"),
        ('"viscous_damping"', '"kinematic_error"\norders = [-2]', r"effect\[1\].orders: -2: expected an order"),
        ('"viscous_damping"', '"kinematic_error"\norders = []', r"effect\[1\].orders: \[\]: expected a list"),
        ('"viscous_damping"', '"kinematic_error"\norders = {motor = [2]}', "'motor': expected one of input, output"),
        ("ratio = 100", "ratio = 100\nteeth_flexspline = 200", "joint.teeth_circular: missing"),
        (
            "ratio = 100",
            "ratio = 100\nteeth_flexspline = 202\nteeth_circular = 200",
            "joint.teeth_circular: 200: expected",
        ),
        (
            "ratio = 100",
            "ratio = 100\nteeth_flexspline = 160\nteeth_circular = 162",
            "joint.ratio: 100: 160/162 teeth make",
        ),
    ],
)
def test_a_typo_is_refused_in_one_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = tmp_path / "model.toml"
    path.write_text(TEXT.replace(old, new, 1) if old != "[[effect]]" else TEXT.replace(old, new))
    with pytest.raises(ModelError, match=says) as caught:
        read_model(path)
    assert "\n" not in str(caught.value) and "model.toml" in str(caught.value)


def test_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot read"):
        read_model(tmp_path / "absent.toml")


def test_a_link_is_followed_and_stays_a_link(tmp_path: Path) -> None:
    target, link = tmp_path / "real.toml", tmp_path / "link.toml"
    model = Model("torsion", 100.0, 0.05, (ModelEffect("linear_stiffness"),))
    rewrite(target, model, "fit")
    link.symlink_to(target)
    rewrite(link, Model("torsion", 120.0, 0.05, model.effects), "fit")
    assert link.is_symlink() and read_model(target).ratio == 120.0


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "m.toml.new").mkdir()
    with pytest.raises(ModelError, match=r"m\.toml: cannot write: .*: expected a folder that may be written"):
        rewrite(tmp_path / "m.toml", Model("torsion", 100.0, 0.05, (ModelEffect("linear_stiffness"),)), "fit")


def test_the_mark_that_some_editors_put_first_is_skipped_and_not_written_again(tmp_path: Path) -> None:
    path = tmp_path / "bom.toml"
    path.write_text('\ufeff[joint]\nratio = 100\n[[effect]]\nname = "linear_stiffness"\n', encoding="utf-8")
    model = read_model(path)
    assert model.ratio == 100.0
    rewrite(path, model, "fit")
    assert not path.read_bytes().startswith(b"\xef\xbb\xbf") and read_model(path) == model


ORDERED = """
[joint]
balance = "torsion"
teeth_flexspline = 200
teeth_circular = 202

[[effect]]
name = "kinematic_error"
orders = [7.5, 2]  # of the motor

[effect.parameters.sine_7_5]
value = 1e-5
"""


def test_a_number_of_an_earlier_version_is_passed_over_and_goes_when_the_file_is_written() -> None:
    head = '[joint]\nbalance = "drive"\nratio = 100.0\n\n[[effect]]\nname = "coulomb_friction"\n'
    kept = "[effect.parameters.friction]\nvalue = 2.0\n"
    text = f"{head}{kept}[effect.parameters.smoothing]\nvalue = 0.01\n"
    model = parse_model(text)
    assert set(model.effects[0].parameters) == {"friction"}
    assert "smoothing" not in render(text, model) and "friction" in render(text, model)
    with pytest.raises(ModelError, match="smoothness"):
        parse_model(f"{head}[effect.parameters.smoothness]\nvalue = 0.01\n")


def test_orders_of_an_effect_name_its_parameters(tmp_path: Path) -> None:
    path = tmp_path / "ordered.toml"
    path.write_text(ORDERED)
    model = read_model(path)
    (effect,) = model.effects
    assert effect.waves == (("input", 7.5), ("input", 2.0)) and effect.value("sine_7_5") == 1e-5
    rewrite(path, model, "fit")
    assert path.read_text().startswith(ORDERED.partition("[effect.parameters")[0]) and read_model(path) == model
    further = replace(effect, waves=(*effect.waves, Wave("output", 202)), parameters={})
    rewrite(path, model.with_effect(further), "fit")
    again = read_model(path).effect("kinematic_error")
    assert again is not None and set(again.waves) == set(further.waves) and not again.parameters
    assert "orders = {input = [2, 7.5], output = [202]}" in path.read_text()
    names = [row.name for row in resolve(again, "torsion").amplitudes]
    assert names == ["sine_2", "cosine_2", "sine_7_5", "cosine_7_5", "sine_202_output", "cosine_202_output"]


def test_the_ratio_follows_from_the_teeth(tmp_path: Path) -> None:
    path = tmp_path / "ordered.toml"
    path.write_text(ORDERED)
    assert read_model(path).ratio == -100.0 and read_model(path).teeth == Teeth(200, 202)
    path.write_text(ORDERED.replace("[joint]", "[joint]\nratio = 101"))
    assert read_model(path).ratio == 101.0


@pytest.mark.parametrize(
    ("wave", "ratio", "teeth", "says"),
    [
        (Wave("output", 202), 100.0, None, "fits a circular spline tooth pass (202 teeth)"),
        (Wave("output", 202), -100.0, Teeth(200, 202), "circular spline tooth pass"),
        (Wave("output", 200), 101.0, Teeth(200, 202), "flexspline tooth pass"),
        (Wave("input", 2), 101.0, None, "wave generator, twice per turn: its two lobes"),
        (Wave("input", 8), 101.0, None, "fits a motor of 8 poles"),
        (Wave("input", 0.47), 100.0, None, ""),
    ],
)
def test_an_order_is_named_by_what_turns_so_often(wave: Wave, ratio: float, teeth: Teeth | None, says: str) -> None:
    assert name_of(wave, ratio, teeth) == says


@pytest.mark.parametrize("ratio", ["1e308", "1e-308", "-1e-308", "1e200", "0.0"])
def test_a_ratio_or_inertia_whose_square_is_no_number_is_one_line(ratio: str) -> None:
    for key in ("ratio", "output_inertia_kg_m2"):
        lines = {"ratio": "100.0", "output_inertia_kg_m2": "0.1"} | {key: ratio}
        text = "[joint]\nbalance = 'torsion'\n" + "".join(f"{name} = {value}\n" for name, value in lines.items())
        small = key == "output_inertia_kg_m2" and 0 < float(ratio) < 1
        if not small:
            with pytest.raises(ModelError, match=f"joint.{key}: .*: expected"):
                parse_model(text)
