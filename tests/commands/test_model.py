"""Adding, removing and undoing as a person does it: what does not help changes nothing."""

from __future__ import annotations

import json
import math
import shutil
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import pytest

from edge_daemon.cli import main
from edge_daemon.commands.model import next_steps
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.effects.model_file import read_model
from edge_daemon.explain.results import Candidate, Diagnosis, Error, Proposal

DRIVE = Model("drive", 100.0, math.nan, (ModelEffect("inertia"),))
RECKONED = Model("drive", 100.0, math.nan, (ModelEffect("inertia"), ModelEffect("model_torque")))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("healthy")
    recording, model = folder / "rec.csv", folder / "model.toml"
    assert main(["simulate", "--out", str(recording), "--model", str(model), "--seconds", "9", "--seed", "5"]) == 0
    assert main(["fit", str(recording), "--model", str(model)]) == 0
    return recording, model


@pytest.fixture
def model(healthy: tuple[Path, Path], tmp_path: Path) -> Path:
    return Path(shutil.copy(healthy[1], tmp_path / "own.toml"))


def run(*words: object) -> int:
    return main([*map(str, words)])


def test_an_effect_that_does_not_help_is_not_written(
    healthy: tuple[Path, Path], model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = model.read_text()
    assert run("add", "constant_load", "--model", model, "--recording", healthy[0]) == 1
    said = capsys.readouterr().out
    assert model.read_text() == before
    assert "left as it was" in said and "--force" in said and ": written" not in said
    assert run("add", "constant_load", "--model", model, "--recording", healthy[0], "--force", "--json", "-") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["helps"] is False and document["written"] is True
    assert read_model(model).effect("constant_load") is not None


def test_remove_and_undo_are_each_others_way_back(
    healthy: tuple[Path, Path], model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = model.read_text()
    assert run("remove", "viscous_damping", "--model", model, "--recording", healthy[0]) == 0
    said = capsys.readouterr().out
    assert "more" in said and "remove viscous_damping" in said
    assert [row.name for row in read_model(model).effects] == ["linear_stiffness"]
    assert [row.change for row in read_model(model).lineage][-1] == "remove viscous_damping"
    assert run("undo", "--model", model) == 0
    assert model.read_text() == before and "'remove viscous_damping'" in capsys.readouterr().out
    assert run("remove", "viscous_damping", "--model", model, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["effects"] == ["linear_stiffness"]
    assert run("undo", "--model", model, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["undone"] == "removed viscous_damping"
    assert run("undo", "--model", model) == 2 and "nothing to undo" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("effect", "line"), [("viscous_dampin", "did you mean"), ("linear_stiffness+viscous_damping", "nothing would be")]
)
def test_what_cannot_be_removed_is_said_in_one_line(
    model: Path, effect: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("remove", effect, "--model", model) == 2
    said = capsys.readouterr().err
    assert line in said and len(said.splitlines()) == 1


def test_a_number_that_is_lost_by_an_addition_is_in_the_table(
    healthy: tuple[Path, Path], model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second damper beside the first: only their sum is known, so that the damping is determined no longer."""
    formula = ("--expression", "b * twist_rate_rad_s")
    words = ("add", "second_damper", *formula, "--model", model, "--recording", healthy[0])
    assert run(*words) == 1
    line = next(row for row in capsys.readouterr().out.splitlines() if row.startswith("viscous_damping"))
    assert "no longer identified" in line
    assert run(*words, "--json", "-") == 1
    moved = json.loads(capsys.readouterr().out)["moved"]
    row = next(row for row in moved if row["effect"] == "viscous_damping")
    assert row["identified_before"] and not row["identified"]


def test_a_stiffness_table_is_added_by_its_name(
    healthy: tuple[Path, Path], model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("add", "stiffness_table", "--model", model) == 2
    assert "expected --recording" in capsys.readouterr().err
    assert run("add", "stiffness_table", "--model", model, "--recording", healthy[0]) == 1  # a plain spring needs none
    assert "stiffness_table" in capsys.readouterr().out


def test_an_error_that_follows_no_channel_is_said_in_words(
    healthy: tuple[Path, Path], model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("compare", healthy[0], "--model", model, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["where"] == []
    assert run("compare", healthy[0], "--model", model) == 0
    said = capsys.readouterr().out
    assert "follows no channel" in said and "share of it" not in said


@pytest.mark.parametrize(("formula", "first"), [(0.25, "gravity_load"), (0.55, "NAME"), (None, "gravity_load")])
def test_the_more_probable_of_cause_and_formula_is_advised_first(formula: float | None, first: str) -> None:
    """A cause at 0.40 was passed over for a formula at 0.25."""
    cause = Candidate("gravity_load", 0.6, 0.2, 0.4, (), {})
    law = () if formula is None else (Proposal("a*theta_out_rad", "a torque", 0.1, formula, {}),)
    verdict = "missing" if formula is None else "unexplained"
    found = Diagnosis(verdict, Error(0.6, 0.02, 1.0, "N m"), (cause, *((cause,) if formula is None else ())), None)
    said = next_steps(replace(found, proposals=law), Namespace(model="m.toml", recording=["r.csv"]), DRIVE)
    assert said[0].startswith(f"next: edge-daemon add {first} ") and said[0].endswith("--recording r.csv")


def test_where_nothing_is_found_it_is_asked_whether_other_joints_moved() -> None:
    """A formula of one's own was advised, where the coupling of other joints was all that was missing."""
    found = Diagnosis("unexplained", Error(0.9, 0.02, 1.0, "N m"), (), None)
    said = [next_steps(found, Namespace(model="m.toml", recording=["r.csv"]), row) for row in (DRIVE, RECKONED)]
    assert "did other joints move?" in said[0][0] and "formula of your own" in said[1][0]
    assert not next_steps(replace(found, verdict="adequate"), Namespace(model="m.toml", recording=["r.csv"]), DRIVE)
