"""A file's own columns under the names and units that recordings have: `time_s=time_ms*1e-3`, kept beside the file.

A formula holds column names as the file has them, numbers, `pi`, `deg` (radians in a degree), `row` (its number, from
0), + - * / ** and brackets. Nothing else is evaluated.
"""

from __future__ import annotations

import ast
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from edge_daemon.channels import CHANNELS
from edge_daemon.errors import BadInput
from edge_daemon.records import Array
from edge_daemon.text import syntax_tree

SUFFIX = ".columns.toml"
"""Ending of the file beside a recording that keeps how its columns are to be read."""
SKIPPED = "_"
"""Name of a column that nobody wants."""
ROW = "row"
"""Number of a row, from 0, where no column is called so: a clock of rows that are evenly spaced."""
NUMBERS = {"pi": math.pi, "deg": math.pi / 180}
OPERATORS = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
}
LONGEST_FORMULA = 200
"""Characters of a formula: a unit, a sign and an offset need fifty."""


@dataclass(frozen=True, slots=True)
class ColumnMap:
    """How a file's columns are to be read."""

    names: tuple[str, ...] = ()
    """of a file without header, in order; `_` for a column that nobody wants"""
    formulas: Mapping[str, str] = field(default_factory=dict)
    """name of the recording -> formula over the file's columns"""

    def __bool__(self) -> bool:
        return bool(self.names or self.formulas)

    def applied(self, table: Mapping[str, Array]) -> dict[str, Array]:
        """The columns under their new names. What a formula used is the same quantity under another name, which would
        explain it best: it is left out, but for a channel. Raises `BadInput` that names the formula."""
        made = {name: _value(name, formula, table) for name, formula in self.formulas.items()}
        used = {name for name in table if name not in CHANNELS and any(uses(f, name) for f in self.formulas.values())}
        rest = {name: column for name, column in table.items() if name not in {*made, *used, SKIPPED}}
        return rest | made


def column_map(names: str | None, formulas: Sequence[str]) -> ColumnMap:
    """From the command line: names with commas between, and `name=formula` each. Raises `BadInput`."""
    pairs = {}
    for text in formulas:
        name, equals, formula = text.partition("=")
        if not equals or not name.strip().isidentifier() or not formula.strip():
            raise BadInput(f"--map {text}: expected NAME=FORMULA such as time_s=time_ms*1e-3")
        pairs[name.strip()] = formula.strip()
    columns = tuple(name.strip() or SKIPPED for name in names.split(",")) if names else ()
    twice = sorted({name for name in columns if name != SKIPPED and columns.count(name) > 1})
    if twice:
        raise BadInput(f"--columns: {twice[0]!r} appears twice: expected different names, or {SKIPPED} for none")
    return ColumnMap(columns, pairs)


def kept(path: Path) -> ColumnMap:
    """What is kept beside a recording; nothing where there is none. Raises `BadInput`."""
    place = beside(path)
    try:
        text = tomllib.loads(place.read_text())
    except FileNotFoundError:
        return ColumnMap()
    except (OSError, ValueError, RecursionError) as error:
        raise BadInput(f"{place}: {str(error).splitlines()[0]}: expected names = [...] and a table [map]") from error
    names, formulas = text.get("names", []), text.get("map", {})
    good = isinstance(names, list) and isinstance(formulas, dict)
    if not good or not all(isinstance(word, str) for word in (*names, *formulas.values())):
        raise BadInput(f"{place}: expected names = [...] and a table [map] of formulas, all of them text")
    return ColumnMap(tuple(names), formulas)


def keep(path: Path, given: ColumnMap) -> Path:
    """Writes it beside the recording and gives the place. Raises OSError."""
    quoted = [_quoted(name) for name in given.names]
    lines = [f"names = [{', '.join(quoted)}]"] if quoted else []
    lines += ["[map]", *(f"{_quoted(name)} = {_quoted(formula)}" for name, formula in given.formulas.items())]
    place = beside(path)
    place.write_text("\n".join(lines) + "\n")
    return place


def as_mapped(line: str, formulas: Mapping[str, str]) -> str:
    """A line whose hints `--map NAME=FORMULA` speak of the file's own columns, where others are made of them."""

    def hint(found: re.Match[str]) -> str:
        formula = found[2]
        for name, own in formulas.items():
            formula = re.sub(_as_word(name), lambda _, own=own: own if own.isidentifier() else f"({own})", formula)
        return found[0] if formula == found[2] else f"--map '{found[1]}={formula}'"

    return re.sub(r"--map (\w+)=(\S+)", hint, line)


def beside(path: Path) -> Path:
    """Where a recording's columns are kept."""
    return path.with_name(path.name + SUFFIX)


def _quoted(text: str) -> str:
    """A TOML string; control characters have no place in a name."""
    plain = re.sub(r"[\x00-\x1f\x7f]", " ", text)
    return '"' + plain.replace("\\", "\\\\").replace('"', '\\"') + '"'


def uses(formula: str, column: str) -> bool:
    """Whether a formula holds the name of a column."""
    return formula == column or re.search(_as_word(column), formula) is not None


def _as_word(column: str) -> str:
    return rf"(?<![\w.]){re.escape(column)}(?![\w.])"


def _value(name: str, formula: str, table: Mapping[str, Array]) -> Array:
    if formula in table:
        return table[formula]
    if len(formula) > LONGEST_FORMULA:
        raise BadInput(f"--map {name}: {len(formula)} characters: expected at most {LONGEST_FORMULA}")
    length = len(next(iter(table.values())))
    known: dict[str, Array | float] = {**NUMBERS, ROW: np.arange(length, dtype=float)}
    text = formula
    for i, column in enumerate(sorted(table, key=len, reverse=True)):
        known[f"column_{i}_"] = table[column]
        text = re.sub(_as_word(column), f"column_{i}_", text)
    try:
        value = _evaluated(syntax_tree(text), known)
    except (SyntaxError, RecursionError, OverflowError) as error:
        raise BadInput(f"--map {name}={formula}: no formula: expected columns, numbers and + - * / **") from error
    except KeyError as error:
        there = ", ".join(list(table)[:8])
        raise BadInput(f"--map {name}={formula}: no column {error.args[0]!r}: expected some of {there}") from error
    return np.broadcast_to(np.asarray(value, dtype=float), (length,)).copy()


def _evaluated(node: ast.expr, known: Mapping[str, Array | float]) -> Array | float:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return float(node.value)
    if isinstance(node, ast.Name):
        return known[node.id]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _evaluated(node.operand, known)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            result: Array = OPERATORS[type(node.op)](_evaluated(node.left, known), _evaluated(node.right, known))
        return result
    raise SyntaxError(ast.dump(node)[:40])
