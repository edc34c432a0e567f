"""A change of a model file that is taken back: the very text, comments included."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from edge_daemon.effects.model import ModelEffect, ModelError
from edge_daemon.effects.model_file import read_model
from edge_daemon.effects.model_undo import MOST_TEXTS, rewrite, undo, undo_file

TEXT = '# the elbow\n[joint]\nratio = 100   # from CAD\n\n[[effect]]\nname = "linear_stiffness"\n'


def changed(path: Path, *ratios: float) -> None:
    for ratio in ratios:
        rewrite(path, replace(read_model(path), ratio=ratio), f"ratio {ratio:g}")


def test_undo_gives_back_one_text_after_the_other(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(TEXT)
    rewrite(path, read_model(path).with_effect(ModelEffect("viscous_damping")), "add viscous_damping")
    between = path.read_text()
    changed(path, 120.0)
    assert undo(path) == "ratio 120" and path.read_text() == between
    assert undo(path) == "add viscous_damping" and path.read_text() == TEXT
    assert not undo_file(path).exists()
    with pytest.raises(ModelError, match=r"m\.toml: nothing to undo"):
        undo(path)


def test_what_was_edited_since_is_not_lost(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(TEXT)
    changed(path, 120.0)
    path.write_text(path.read_text() + "# measured on Tuesday\n")
    with pytest.raises(ModelError, match="edited after 'ratio 120'"):
        undo(path)
    assert undo(path, force=True) == "ratio 120" and path.read_text() == TEXT


def test_only_the_last_changes_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(TEXT)
    changed(path, *(100.0 + i for i in range(1, MOST_TEXTS + 4)))
    for _ in range(MOST_TEXTS):
        undo(path)
    assert read_model(path).ratio == 103.0 and not undo_file(path).exists()


@pytest.mark.parametrize("kept", ["no TOML [", "[[change]]\nchange = 'fit'\n", "change = 3\n"])
def test_a_file_that_holds_no_texts_is_named(tmp_path: Path, kept: str) -> None:
    path = tmp_path / "m.toml"
    path.write_text(TEXT)
    undo_file(path).write_text(kept)
    with pytest.raises(ModelError, match=r"m\.toml\.undo: does not hold former texts"):
        undo(path)


def test_a_text_that_is_no_model_does_not_come_back(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(TEXT)
    undo_file(path).write_text(f"[[change]]\nchange = 'fit'\nbefore = 'nonsense'\nafter = '''{TEXT}'''\n")
    with pytest.raises(ModelError, match="before 'fit'"):
        undo(path, force=True)
    assert path.read_text() == TEXT
