"""Versions of a model file as the page sees them: named, compared, put back; and formulas as they are written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from edge_daemon.cli import main
from edge_daemon.effects.model_file import read_model
from edge_daemon.effects.model_undo import rewrite, undo
from edge_daemon.errors import BadInput
from edge_daemon.service import model_job
from edge_daemon.service.model_versions import MOST_NAMED, change_version, checked_formula, version, versions

BEGUN = '# of joint 3\n[joint]\nbalance = "torsion"\nratio = 100.0\n[[effect]]\nname = "linear_stiffness"\n'


@pytest.fixture
def model(tmp_path: Path) -> Path:
    file = tmp_path / "m.toml"
    file.write_text(BEGUN)
    return file


def grown(model: Path, effect: str) -> None:
    other = model.with_name("other.toml")
    other.write_text(model.read_text() + f'[[effect]]\nname = "{effect}"\n')
    rewrite(model, read_model(other), f"add {effect}")


def names(model: Path) -> list[tuple[str, str, int]]:
    return [(row["key"], row["name"] or row["change"], len(row["effects"])) for row in versions(model)]


def test_a_named_version_outlives_changes_and_undo(model: Path) -> None:
    grown(model, "viscous_damping")
    assert change_version(model, {"do": "keep", "name": " with damping "}) == "with damping"
    grown(model, "coulomb_friction")
    change_version(model, {"do": "undo"})
    change_version(model, {"do": "undo"})
    assert model.read_text() == BEGUN
    assert names(model) == [("named-with damping", "with damping", 2), ("now", "", 1)]
    change_version(model, {"do": "restore", "key": "named-with damping"})
    assert [row.name for row in read_model(model).effects] == ["linear_stiffness", "viscous_damping"]
    assert undo(model) == "put back with damping" and model.read_text() == BEGUN
    change_version(model, {"do": "forget", "name": "with damping"})
    assert names(model) == [("now", "", 1)] and [file.name for file in model.parent.glob("m.toml*")] == ["m.toml"]


def test_what_was_before_any_change_is_put_back_and_that_can_be_undone(model: Path) -> None:
    grown(model, "viscous_damping")
    grown(model, "coulomb_friction")
    full = model.read_text()
    assert [row[:2] for row in names(model)][:2] == [
        ("before-0", "add viscous_damping"),
        ("before-1", "add coulomb_friction"),
    ]
    assert len(version(model, "before-1").effects) == 2
    change_version(model, {"do": "restore", "key": "before-0"})
    assert model.read_text() == BEGUN
    change_version(model, {"do": "undo"})
    assert model.read_text() == full


def test_two_versions_are_compared_on_one_recording(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = model.with_name("r.parquet")
    assert main(["simulate", "--effect", "coulomb_friction", "--seconds", "8", "--out", str(recording)]) == 0
    model.write_text(BEGUN.replace("ratio = 100.0", "ratio = 100.0\noutput_inertia_kg_m2 = 0.05"))
    grown(model, "coulomb_friction")
    capsys.readouterr()
    words = ["between", "before-0", "now", "--recording", str(recording), "--model", str(model)]
    assert model_job.main(words) == 0
    told = json.loads(capsys.readouterr().out)
    before, now = (row["nrmse"] for row in told["versions"])
    assert now < 0.5 * before, "the recording has the friction that one of them lacks"
    of = {row["effect"]: row["of"] for row in told["parameters"]}
    assert of["coulomb_friction"][0] is None and of["coulomb_friction"][1]["value"] > 0.0
    assert all(side["value"] > 0.0 for side in of["linear_stiffness"])


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ({"do": "restore", "key": "named-x"}, "not there any more"),
        ({"do": "restore", "key": "before-7"}, "not there any more"),
        ({"do": "restore", "key": "../m.toml"}, "not there any more"),
        ({"do": "keep", "name": " "}, "expected 1 to 40 letters"),
        ({"do": "keep", "name": "a\nb"}, "expected 1 to 40 letters"),
        ({"do": "keep", "name": "a" * 41}, "expected 1 to 40 letters"),
        ({"do": "undo"}, "nothing to undo"),
        ({"do": "keep"}, "do: expected"),
        ({}, "do: expected"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_changes_nothing(model: Path, body: dict[str, str], said: str) -> None:
    with pytest.raises(BadInput, match=said) as caught:
        change_version(model, body)
    assert "\n" not in str(caught.value)
    assert model.read_text() == BEGUN and [file.name for file in model.parent.iterdir()] == ["m.toml"]


def test_names_are_bounded_and_any_letters(model: Path) -> None:
    for i in range(MOST_NAMED):
        change_version(model, {"do": "keep", "name": f'før "{i}" ]='})
    with pytest.raises(BadInput, match="forget one first"):
        change_version(model, {"do": "keep", "name": "one more"})
    assert len(versions(model)) == MOST_NAMED + 1


def test_a_damaged_file_of_names_is_one_line(model: Path) -> None:
    model.with_name("m.toml.named").write_text("[")
    with pytest.raises(BadInput, match="delete it"):
        versions(model)


@pytest.mark.parametrize(
    ("text", "at", "said"),
    [
        ("a * ", 4, "ends too early"),
        ("a * sin(", 7, "never closed"),
        ("  a * 'x'", 6, "not allowed"),
        ("a * foo(time_s)", 4, "not allowed"),
        ("a * sin(time_s, 1)", 4, "sin takes 1 arguments"),
        ("a b", 2, "cannot go on with 'b'"),
        ("time_s", 0, "no parameter enters linearly"),
        ("", 0, "ends too early"),
    ],
)
def test_a_formula_that_is_not_one_says_where_and_what(text: str, at: int, said: str) -> None:
    found = checked_formula(text)
    assert said in found["error"] and found["at"] == at


def test_a_formula_says_what_would_be_fitted_and_what_was_probably_meant() -> None:
    found = checked_formula("a * tanh(velocity_out / w) * theta_in_rad")
    assert (found["error"], found["amplitudes"]) == ("", ("a",)) and set(found["shapes"]) == {"velocity_out", "w"}
    assert found["meant"] == {"velocity_out": "velocity_out_rad_s"}
    assert checked_formula("a * sin(theta_in_rad)")["meant"] == {}
