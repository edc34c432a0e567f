"""The model file: TOML that a person reads and edits; comments and order survive a rewrite."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from edge_daemon.effects import expression
from edge_daemon.effects.catalogue import find
from edge_daemon.effects.effect import Balance, Effect, Wave
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect, ModelError, Teeth, Version
from edge_daemon.effects.order_names import agree, ratio_of
from edge_daemon.effects.plugin import plugins
from edge_daemon.effects.waves import by_angle, read_waves
from edge_daemon.text import meant

_TOP = ("joint", "effect", "lineage")
LEAST_RATIO, MOST_RATIO = 1e-3, 1e5
"""No train of gears has a ratio outside of these, and the square of a ratio must remain a number."""
MOST_INERTIA_kg_m2 = 1e9
"""A drive of the largest telescopes turns less."""
_JOINT = ("balance", "ratio", "teeth_flexspline", "teeth_circular", "output_inertia_kg_m2")
_EFFECT = ("name", "orders", "parameters", "expression", "unit")
_PARAMETER = ("value", "sd", "unit", "identified")
_VERSION = ("change", "recording", "nrmse")
RETIRED_PARAMETERS = {"drive": ("smoothing",)}
"""By balance: numbers that files of earlier versions hold. They are not read, and go when the file is written again."""


def read_model(path: Path) -> Model:
    """The model in a TOML file. Raises `ModelError` with one line: file, key path, what is wrong, what was expected."""
    try:
        return parse_model(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ModelError(f"{path}: cannot read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: not a text file: expected TOML in UTF-8") from error
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error


def parse_model(text: str) -> Model:
    """The model in a TOML text. Raises `ModelError`."""
    try:
        document: dict[str, Any] = tomlkit.parse(text).unwrap()
    except (TOMLKitError, RecursionError) as error:
        raise ModelError(f"not valid TOML: {error}") from error
    _only(document, _TOP, "")
    joint = _table(document.get("joint"), "joint")
    _only(joint, _JOINT, "joint.")
    balance = joint.get("balance", "torsion")
    if balance not in ("torsion", "drive"):
        raise ModelError(f'joint.balance: {balance!r}: expected "torsion" or "drive"')
    effects = [_effect(row, f"effect[{i}]", balance) for i, row in enumerate(_tables(document, "effect"))]
    _distinct([row.name for row in effects])
    teeth = _teeth(joint)
    return Model(
        balance,
        _ratio(joint, teeth),
        _inertia(joint),
        tuple(effects),
        tuple(_versions(_tables(document, "lineage"))),
        teeth,
    )


def _ratio(joint: Mapping[str, Any], teeth: Teeth | None) -> float:
    if teeth is not None and "ratio" not in joint:
        return ratio_of(teeth)
    ratio = _number(joint, "joint.ratio")
    if not LEAST_RATIO <= abs(ratio) <= MOST_RATIO:
        raise ModelError(f"joint.ratio: {ratio:g}: expected the transmission ratio, e.g. 100 or -100")
    if teeth is not None:
        agree(teeth, ratio)
    return ratio


def _teeth(joint: Mapping[str, Any]) -> Teeth | None:
    names = ("teeth_flexspline", "teeth_circular")
    if not any(name in joint for name in names):
        return None
    flexspline, circular = (_number(joint, f"joint.{name}") for name in names)
    if not (0 < flexspline < circular and flexspline.is_integer() and circular.is_integer()):
        raise ModelError(
            f"joint.teeth_circular: {circular:g}: expected a whole number above joint.teeth_flexspline, {flexspline:g}"
        )
    return Teeth(int(flexspline), int(circular))


def _inertia(joint: Mapping[str, Any]) -> float:
    if "output_inertia_kg_m2" not in joint:
        return math.nan
    value = _number(joint, "joint.output_inertia_kg_m2")
    if not 0 < value <= MOST_INERTIA_kg_m2:
        raise ModelError(f"joint.output_inertia_kg_m2: {value:g}: expected above 0, at most {MOST_INERTIA_kg_m2:g}")
    return value


def _effect(row: Mapping[str, Any], path: str, balance: Balance) -> ModelEffect:
    _only(row, _EFFECT, f"{path}.")
    name = row.get("name")
    if not isinstance(name, str) or not name:
        raise ModelError(f"{path}.name: missing: expected the name of an effect")
    text, unit = row.get("expression"), row.get("unit")
    known = tuple(_table(row.get("parameters", {}), f"{path}.parameters"))
    waves: tuple[Wave, ...] = ()
    if text is None and name not in plugins():
        try:
            effect = find(name, balance)
        except ModelError as error:
            raise ModelError(f"{path}.name: {error}") from error
        waves = _waves(row, f"{path}.orders", effect)
        effect = effect.over(waves) if waves and effect.over else effect
        allowed: Sequence[str] = [p.name for p in (*effect.amplitudes, *effect.shapes)]
    elif text is not None:
        try:
            allowed = expression.parse(str(text)).parameters
        except ModelError as error:
            raise ModelError(f"{path}.expression: {error}") from error
    else:
        allowed = known
    parameters = {
        key: _parameter(value, f"{path}.parameters.{key}")
        for key, value in row.get("parameters", {}).items()
        if key in allowed or key not in RETIRED_PARAMETERS.get(balance, ())
    }
    _only(parameters, tuple(allowed), f"{path}.parameters.")
    return ModelEffect(
        name, parameters, None if text is None else str(text), None if unit is None else str(unit), waves
    )


def _waves(row: Mapping[str, Any], path: str, effect: Effect) -> tuple[Wave, ...]:
    """What an effect repeats with, where its line says so."""
    if "orders" not in row:
        return ()
    if effect.over is None:
        raise ModelError(f"{path}: {effect.name} repeats with no angle: expected none")
    try:
        return read_waves(row["orders"], effect.waves[0].angle)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error


def _parameter(row: object, path: str) -> FittedParameter:
    if isinstance(row, int | float) and not isinstance(row, bool):
        return FittedParameter(float(row))
    table = _table(row, path)
    _only(table, _PARAMETER, f"{path}.")
    identified = table.get("identified", False)
    if not isinstance(identified, bool):
        raise ModelError(f"{path}.identified: {identified!r}: expected true or false")
    sd = _number(table, f"{path}.sd") if "sd" in table else math.nan
    return FittedParameter(_number(table, f"{path}.value"), sd, str(table.get("unit", "1")), identified)


def _versions(rows: Iterable[Mapping[str, Any]]) -> Iterable[Version]:
    for i, row in enumerate(rows):
        path = f"lineage[{i}]"
        _only(row, _VERSION, f"{path}.")
        yield Version(str(row.get("change", "")), str(row.get("recording", "")), _number(row, f"{path}.nrmse"))


def _only(table: Mapping[str, Any], known: tuple[str, ...], path: str) -> None:
    for key in table:
        if key not in known:
            raise ModelError(f"{path}{key}: unknown key: {meant(key, known)}")


def _table(value: object, path: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ModelError(f"{path}: {'missing' if value is None else repr(value)}: expected a table")
    return value


def _tables(document: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    rows = document.get(key, [])
    if not isinstance(rows, list):
        raise ModelError(f"{key}: a single table: expected [[{key}]]")
    return [_table(row, f"{key}[{i}]") for i, row in enumerate(rows)]


def _number(table: Mapping[str, Any], path: str) -> float:
    value = table.get(path.rpartition(".")[2])
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ModelError(f"{path}: {'missing' if value is None else repr(value)}: expected a number")
    number = math.inf if abs(value) > sys.float_info.max else float(value)
    if not math.isfinite(number) and not path.endswith(".sd"):
        raise ModelError(f"{path}: {number}: expected a finite number")
    return number


def _distinct(names: list[str]) -> None:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise ModelError(f"effect[{i}].name: {name!r} appears twice: expected each effect once")


def replace_text(path: Path, text: str) -> None:
    """Gives a file another text; of a link, the file it leads to. It is atomic: a reader sees the old or the new text.
    Raises `ModelError`."""
    path = path.resolve()
    written = path.with_name(path.name + ".new")
    try:
        written.write_text(text, encoding="utf-8")
        written.replace(path)
    except OSError as error:
        raise ModelError(f"{path}: cannot write: {error.strerror}: expected a folder that may be written") from error


def render(text: str, model: Model) -> str:
    """`text`, a model file or empty, edited so that it says `model`."""
    document = tomlkit.parse(text)
    joint = document.setdefault("joint", tomlkit.table())
    _set(joint, "balance", model.balance)
    if model.teeth is None or model.ratio != ratio_of(model.teeth) or "ratio" in joint:
        _set(joint, "ratio", model.ratio)
    for part, count in _counts(model.teeth):
        _set(joint, f"teeth_{part}", count)
    if math.isfinite(model.output_inertia_kg_m2):
        _set(joint, "output_inertia_kg_m2", model.output_inertia_kg_m2)
    _render_effects(document, model)
    _render_lineage(document, model)
    return tomlkit.dumps(document)


def _counts(teeth: Teeth | None) -> list[tuple[str, int]]:
    return [] if teeth is None else [("flexspline", teeth.flexspline), ("circular", teeth.circular)]


def _set(table: Any, key: str, value: object) -> None:
    """Writes a value only if it differs, so that 100 stays 100 and its comment stays beside it."""
    if key not in table or table[key] != value:
        table[key] = value


def _render_effects(document: Any, model: Model) -> None:
    rows = document.setdefault("effect", tomlkit.aot())
    wanted = {row.name: row for row in model.effects}
    for i in reversed(range(len(rows))):
        if rows[i]["name"] not in wanted:
            del rows[i]
    present = {row["name"]: row for row in rows}
    for name, effect in wanted.items():
        table = present.get(name)
        if table is None:
            table = tomlkit.table()
            table["name"] = name
            rows.append(table)
        for key, value in (("expression", effect.expression), ("unit", effect.unit)):
            if value is not None:
                _set(table, key, value)
        if effect.waves:
            _render_orders(table, effect, find(name, model.balance).waves[0].angle)
        _render_parameters(table, effect)


def _render_orders(table: Any, effect: ModelEffect, home: str) -> None:
    """The orders by angle."""
    if "orders" not in table or set(read_waves(table["orders"], home)) != set(effect.waves):
        orders = tomlkit.inline_table()
        orders.update(by_angle(effect.waves))
        table["orders"] = orders


def _render_parameters(table: Any, effect: ModelEffect) -> None:
    """The parameters; those of orders that are gone, and of earlier versions, go."""
    for name in [name for name in table.get("parameters", {}) if name not in effect.parameters]:
        del table["parameters"][name]
    if not effect.parameters:
        return
    if "parameters" not in table:
        table["parameters"] = tomlkit.table(is_super_table=True)
    for name, fitted in effect.parameters.items():
        if name not in table["parameters"] or not isinstance(table["parameters"][name], Mapping):
            table["parameters"][name] = tomlkit.table()
        row = table["parameters"][name]
        _set(row, "value", float(fitted.value))
        if math.isfinite(fitted.sd):
            _set(row, "sd", float(fitted.sd))
        elif "sd" in row:
            del row["sd"]
        _set(row, "unit", fitted.unit)
        _set(row, "identified", bool(fitted.identified))


def _render_lineage(document: Any, model: Model) -> None:
    kept = len(document.get("lineage", []))
    if len(model.lineage) < kept:
        del document["lineage"]
        kept = 0
    if len(model.lineage) == kept:
        return
    rows = document.setdefault("lineage", tomlkit.aot())
    for version in model.lineage[kept:]:
        table = tomlkit.table()
        table.update({"change": version.change, "recording": version.recording, "nrmse": float(version.nrmse)})
        rows.append(table)
