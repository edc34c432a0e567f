"""The versions of a model file for the page: the one in force, those before it, and those that a person gave a name.

What was before a change is what `undo` keeps. A named version is a copy of the model's text in a file beside it, so
that neither an undo nor a further change takes it away.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from edge_daemon.effects.expression import ARGUMENTS, MOTION_NAMES, ExpressionError, parse
from edge_daemon.effects.model import Model, ModelError
from edge_daemon.effects.model_file import parse_model, read_model, replace_text
from edge_daemon.effects.model_undo import former, put_back, undo
from edge_daemon.errors import BadInput
from edge_daemon.text import closest

NOW = "now"
"""The key of the version in force; that of a former one is `before-N`, that of a named one `named-NAME`."""
MOST_NAMED = 20
"""So many versions may have a name (guess: more than fit a screen are not compared)."""
MOST_LETTERS = 40
"""A name fits one line of a table on a phone."""

MEANT = 0.75
"""A parameter whose name is this like a channel's was probably meant to be it (guess)."""


def versions(path: Path) -> list[dict[str, Any]]:
    """`key`, `name`, `change` that came after it, `effects` and `nrmse` of each, the one in force last."""
    if not path.exists():
        return []
    rows = [(f"before-{i}", "", row["before"], row["change"]) for i, row in enumerate(former(path))]
    rows += [(f"named-{name}", name, text, "") for name, text in _named(path).items()]
    rows.append((NOW, "", path.read_text(encoding="utf-8-sig"), ""))
    return [row for key, name, text, change in rows if (row := _told(key, name, text, change))]


def _told(key: str, name: str, text: str, change: str) -> dict[str, Any] | None:
    try:
        model = parse_model(text)
    except ModelError:
        return None
    error = model.lineage[-1].nrmse if model.lineage else None
    return {"key": key, "name": name, "change": change, "nrmse": error, "effects": [row.name for row in model.effects]}


def version(path: Path, key: str) -> Model:
    """The model of a key. Raises `BadInput`."""
    return read_model(path) if key == NOW else parse_model(_text(path, key))


def change_version(path: Path, body: Mapping[str, Any]) -> str:
    """Keep the model in force under a `name`, forget a named one, or put the one of a `key` back in force; `do` says
    which. What is said about it. Raises `BadInput`."""
    match body.get("do"), body.get("name"), body.get("key"):
        case "keep", str(name), _:
            return _keep(path, name.strip())
        case "forget", str(name), _:
            rest = {other: text for other, text in _named(path).items() if other != name}
            _write(path, rest)
            return name
        case "restore", _, str(key):
            put_back(path, _text(path, key), f"put back {key.removeprefix('named-')}")
            return key
        case "undo", _, _:
            return undo(path)
    raise BadInput("do: expected undo, keep with a name, forget with a name, or restore with a key")


def _keep(path: Path, name: str) -> str:
    if not (0 < len(name) <= MOST_LETTERS and name.isprintable()):
        raise BadInput(f"name: expected 1 to {MOST_LETTERS} letters that can be printed")
    rows = _named(path)
    if len(rows) >= MOST_NAMED and name not in rows:
        raise BadInput(f"{MOST_NAMED} versions have a name: forget one first")
    text = path.read_text(encoding="utf-8-sig")
    parse_model(text)
    _write(path, {**rows, name: text})
    return name


def _text(path: Path, key: str) -> str:
    kind, _, which = key.partition("-")
    if kind == "named" and which in (rows := _named(path)):
        return rows[which]
    if kind == "before" and which.isdecimal() and int(which) < len(found := former(path)):
        return found[int(which)]["before"]
    raise BadInput(f"version {key[:40]!r}: is not there any more: look again")


def _beside(path: Path) -> Path:
    path = path.resolve()
    return path.with_name(f"{path.name}.named")


def _named(path: Path) -> dict[str, str]:
    file = _beside(path)
    if not file.exists():
        return {}
    try:
        rows = tomlkit.parse(file.read_text(encoding="utf-8")).unwrap()
    except (OSError, UnicodeDecodeError, RecursionError, TOMLKitError) as error:
        raise BadInput(f"{file.name}: does not hold named versions of a model: delete it") from error
    return {str(name): text for name, text in rows.items() if isinstance(text, str)}


def _write(path: Path, rows: Mapping[str, str]) -> None:
    if rows:
        replace_text(_beside(path), tomlkit.dumps(dict(rows)))
    else:
        _beside(path).unlink(missing_ok=True)


def checked_formula(text: str) -> dict[str, Any]:
    """What the model file's own parser says of a formula: `error` and `at`, the letter it stands at; else the
    `amplitudes` and `shapes` that it would be fitted with, and `meant`, the channel that one of them is nearly called.
    `names`: what a formula may be made of."""
    names = {"channels": list(MOTION_NAMES), "functions": list(ARGUMENTS)}
    try:
        found = parse(text)
    except ExpressionError as error:
        return {"error": str(error), "at": error.at, "names": names}
    likely = {name: closest(name, names["channels"], MEANT) for name in found.parameters}
    meant = {name: channel for name, channel in likely.items() if channel}
    return {"error": "", "amplitudes": found.amplitudes, "shapes": found.shapes, "meant": meant, "names": names}
