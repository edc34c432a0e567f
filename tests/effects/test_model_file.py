"""The model file: read, refuse, rewrite with comments and order kept."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from edge_daemon.effects.model import FittedParameter, Model, ModelEffect, ModelError, Version
from edge_daemon.effects.model_file import parse_model, read_model, render
from edge_daemon.effects.model_undo import rewrite

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
