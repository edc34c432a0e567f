"""The texts that a model file had before it was changed, kept beside it, so that a change can be taken back.

They are data in TOML and nothing of them is run; a text that comes back is read as any model file is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from edge_daemon.effects.model import Model, ModelError
from edge_daemon.effects.model_file import parse_model, render, replace_text

MOST_TEXTS = 20
"""Changes that can be taken back (guess: nobody remembers what the model was before more)."""


def undo_file(path: Path) -> Path:
    """Where the former texts of a model file are."""
    path = path.resolve()
    return path.with_name(path.name + ".undo")


def rewrite(path: Path, model: Model, change: str) -> None:
    """Brings a model file up to `model` in a way that `undo` can take back; what is already there keeps its place and
    its comments. A file that does not exist is created. Raises `ModelError` where the place cannot be written."""
    before = path.read_text(encoding="utf-8-sig") if path.exists() else ""
    _changed(path, before, render(before, model), change)


def put_back(path: Path, text: str, change: str) -> None:
    """Gives the model file an earlier text of its own, which `undo` can take back. Raises `ModelError`."""
    parse_model(text)
    _changed(path, path.read_text(encoding="utf-8-sig"), text, change)


def _changed(path: Path, before: str, after: str, change: str) -> None:
    rows = former(path)
    replace_text(path, after)
    if before and after != before:
        _write(path, [*rows, {"change": change, "before": before, "after": after}][-MOST_TEXTS:])


def undo(path: Path, force: bool = False) -> str:
    """Gives the model file the text that it had before its last change, and says which that was. Raises `ModelError`,
    also where the file was edited since, which `force` overrules."""
    rows = former(path)
    if not rows:
        raise ModelError(f"{path}: nothing to undo: no change was made to it by a command")
    last = rows[-1]
    try:
        said = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ModelError(f"{path}: cannot read: {error.strerror}") from error
    if said != last["after"] and not force:
        raise ModelError(f"{path}: was edited after {last['change']!r}: undo would lose that: --force does it anyway")
    try:
        parse_model(last["before"])
    except ModelError as error:
        raise ModelError(f"{undo_file(path)}: before {last['change']!r}: {error}") from error
    replace_text(path, last["before"])
    _write(path, rows[:-1])
    return last["change"]


def former(path: Path) -> list[dict[str, str]]:
    """The changes, oldest first: `change`, and the text `before` and `after` it. Raises `ModelError` where the file
    that keeps them is none."""
    kept = undo_file(path)
    if not kept.exists():
        return []
    try:
        rows: Any = tomlkit.parse(kept.read_text(encoding="utf-8")).unwrap().get("change", [])
        return [{name: str(row[name]) for name in ("change", "before", "after")} for row in rows]
    except (OSError, UnicodeDecodeError, RecursionError, TOMLKitError, KeyError, TypeError) as error:
        raise ModelError(f"{kept}: does not hold former texts of a model: delete it") from error


def _write(path: Path, rows: list[dict[str, str]]) -> None:
    kept = undo_file(path)
    if rows:
        replace_text(kept, tomlkit.dumps({"change": rows}))
    else:
        kept.unlink(missing_ok=True)
