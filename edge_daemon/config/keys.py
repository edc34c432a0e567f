"""Every key of the configuration file: what it takes, its default and its meaning. One list for people and for errors.

Types, limits and defaults come from `settings`; the meanings are the texts that stand under the fields there.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
from msgspec import inspect as types

from edge_daemon.config import settings
from edge_daemon.config.settings import Section, Settings
from edge_daemon.errors import BadInput
from edge_daemon.text import table

LIMITS = (("ge", "at least"), ("gt", "above"), ("le", "at most"), ("lt", "below"))
REQUIRED = "(required)"


@dataclass(frozen=True, slots=True)
class KeyHelp:
    """One line of a section; `section` is its path in the file without indices, `drive.channels`."""

    section: str
    head: str
    """the section as TOML writes it, `[[drive.channels]]`"""
    name: str
    takes: str
    default: str
    meaning: str

    @property
    def path(self) -> str:
        """`drive.channels.scale`."""
        return f"{self.section}.{self.name}" if self.section else self.name


@cache
def keys() -> tuple[KeyHelp, ...]:
    """All of them, each section's own before those of the sections within it."""
    found = types.type_info(Settings)
    assert isinstance(found, types.StructType)
    return tuple(_of(found, "", ""))


def expected(path: str) -> str:
    """What the key at `drive[0].channels[1].scale` takes, in words; empty for no known key."""
    plain = re.sub(r"\[[^\]]*\]", "", path)
    return next((key.takes for key in keys() if key.path == plain), "")


def listing(section: str | None = None) -> str:
    """What `keys` prints: a table per section, or that of one and of what lies within it. Raises `BadInput`."""
    wanted = (section or "").strip("[]")
    there = {key.section: key.head for key in keys() if f"{key.section}.".startswith(f"{wanted}." if wanted else "")}
    if not there:
        raise BadInput(f"{section!r} is no section: expected one of {', '.join({k.section: 0 for k in keys()})[2:]}")
    parts = []
    for head in there.values():
        rows = [(key.name, key.takes, key.default, key.meaning) for key in keys() if key.head == head]
        parts.append(f"{head or 'sections of the file'}\n{table(('key', 'takes', 'default', 'meaning'), rows)}")
    return "\n\n".join(parts)


def _of(found: types.StructType, section: str, head: str) -> Iterator[KeyHelp]:
    meanings = _meanings(found.cls)
    inner: list[tuple[str, str, types.StructType]] = []
    for field in found.fields:
        kind, many = _unwrapped(field.type)
        if isinstance(kind, types.StructType):
            name = f"{section}.{field.name}" if section else field.name
            written = f"[[{name}]]" if many else f"[{name}]"
            inner.append((name, written, kind))
            meaning = meanings.get(field.name) or _first_line(kind.cls)
            yield KeyHelp(
                section, head, field.name, f"a table {written}" if not many else f"tables {written}", "", meaning
            )
            continue
        yield KeyHelp(section, head, field.name, _words(field.type), _default(field), meanings.get(field.name, ""))
    for name, written, kind in inner:
        yield from _of(kind, name, written)


def _unwrapped(kind: types.Type) -> tuple[types.Type, bool]:
    """The type in a list or beside None, and whether it is in a list."""
    if isinstance(kind, types.VarTupleType):
        return _unwrapped(kind.item_type)[0], True
    if isinstance(kind, types.UnionType):
        parts = [part for part in kind.types if not isinstance(part, types.NoneType)]
        if len(parts) == 1:
            return _unwrapped(parts[0])
    return kind, False


def _words(kind: types.Type) -> str:
    """A type as a person would say it."""
    if isinstance(kind, types.VarTupleType):
        return f"a list, each {_words(kind.item_type)}"
    if isinstance(kind, types.UnionType):
        return " or ".join(_words(part) for part in kind.types if not isinstance(part, types.NoneType))
    if isinstance(kind, types.LiteralType):
        return f"one of {', '.join(map(str, kind.values))}"
    if isinstance(kind, types.BoolType):
        return "true or false"
    if isinstance(kind, types.StrType):
        return "a name of letters, digits and ._- (at most 64)" if kind.pattern else "a text"
    if isinstance(kind, types.IntType | types.FloatType):
        return _number(kind)
    return "a value"


def _number(kind: types.IntType | types.FloatType) -> str:
    what = "a whole number" if isinstance(kind, types.IntType) else "a number"
    if kind.ge is not None and kind.le is not None:
        return f"{what}, {kind.ge:.10g} to {kind.le:.10g}"
    limits = [f"{word} {getattr(kind, name):.10g}" for name, word in LIMITS if getattr(kind, name) is not None]
    return " ".join([what, *limits])


def _default(field: types.Field) -> str:
    if field.required:
        return REQUIRED
    if field.default is None or field.default is msgspec.NODEFAULT:
        return ""
    value: Any = list(field.default) if isinstance(field.default, tuple) else field.default
    return json.dumps(value)


def _first_line(cls: type) -> str:
    return (inspect.getdoc(cls) or "").partition("\n")[0].removesuffix(".") if cls.__doc__ else ""


def _meanings(cls: type) -> dict[str, str]:
    """Field -> the text under it."""
    return _texts().get(cls.__name__, {})


@cache
def _texts() -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    for node in ast.parse(inspect.getsource(settings)).body:
        if not isinstance(node, ast.ClassDef):
            continue
        rows = found.setdefault(node.name, {})
        name = ""
        for line in node.body:
            if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
                name = line.target.id
            elif isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and name:
                rows.setdefault(name, " ".join(str(line.value.value).split()))
    return found


def names() -> frozenset[str]:
    """Every name that a key may have, wherever."""
    return frozenset(name for section in Section.__subclasses__() for name in section.__struct_fields__)
