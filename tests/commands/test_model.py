"""Adding, removing and undoing as a person does it: what does not help changes nothing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from edge_daemon.cli import main
from edge_daemon.effects.model_file import read_model


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
