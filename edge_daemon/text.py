"""Numbers, tables and records as text, as files and as JSON: what one would put in a report."""

from __future__ import annotations

import ast
import difflib
import itertools
import json
import math
import os
import sys
import textwrap
import time
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from edge_daemon.errors import BadInput
from edge_daemon.records import NE107, Array

WIDTH = 100
"""Terminals and papers show lines of this length whole."""
EXPONENT_FROM = 1e7
"""A number is written out up to this size, as in a data sheet."""
LEAST_WIDTH = 16
"""A column that is wrapped keeps at least this width, so that words fit."""
COLOURS = {"good": "32", "warn": "33", "bad": "31", "strong": "1", "quiet": "2"}
"""Numbers of ECMA-48, select graphic rendition."""


def painted(text: str, mood: str, stream: TextIO | None = None) -> str:
    """The text in a colour where it goes to a terminal that has one, and nobody set NO_COLOR (no-color.org)."""
    out = stream or sys.stdout
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or not out.isatty()
    return text if plain or not text else f"\033[{COLOURS[mood]}m{text}\033[0m"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], width: int = WIDTH) -> str:
    """Aligned columns, those that hold only numbers to the right; the longest texts are wrapped to fit `width`."""
    body = [list(row) for row in rows]
    columns = list(zip(*[list(head), *body], strict=True))
    right = [all(_is_number(cell) for cell in column[1:]) for column in columns]
    widths = _narrowed([max(len(cell) for cell in column) for column in columns], right, width)
    body = [list(line) for row in body for line in _wrapped(row, widths)]

    def line(cells: Sequence[str]) -> str:
        placed = [
            cell.rjust(width) if to_right else cell.ljust(width)
            for cell, width, to_right in zip(cells, widths, right, strict=True)
        ]
        return "  ".join(placed).rstrip()

    return "\n".join([line(list(head)), line(["-" * width for width in widths]), *map(line, body)])


def indented(text: str, width: int = WIDTH) -> str:
    """A sentence under a heading, on as many lines as a terminal needs."""
    return textwrap.fill(text, width, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)


def _narrowed(widths: list[int], right: list[bool], most: int) -> list[int]:
    """The widest text gives way until the line fits; numbers are never broken."""
    widths = list(widths)
    texts = [i for i, number in enumerate(right) if not number]
    while sum(widths) + 2 * (len(widths) - 1) > most and any(widths[i] > LEAST_WIDTH for i in texts):
        widths[max(texts, key=lambda i: widths[i])] -= 1
    return widths


def _wrapped(row: Sequence[str], widths: Sequence[int]) -> Iterator[tuple[str, ...]]:
    """The lines of one row."""
    if all(len(cell) <= width for cell, width in zip(row, widths, strict=True)):
        yield tuple(row)
        return
    pairs = zip(row, widths, strict=True)
    cells = [textwrap.wrap(cell, width, break_on_hyphens=False) or [""] for cell, width in pairs]
    yield from itertools.zip_longest(*cells, fillvalue="")


def syntax_tree(formula: str) -> ast.expr:
    """The tree of a formula. Raises SyntaxError, also for what Python's parser only warns of and what is too deep."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", SyntaxWarning)
            return ast.parse(formula, mode="eval").body
    except (ValueError, RecursionError, MemoryError) as error:
        raise SyntaxError("too deep, or no text") from error


def _is_number(cell: str) -> bool:
    try:
        float(cell.rstrip(" %"))
    except ValueError:
        return cell in ("", "-")
    return True


def number(value: float, digits: int = 4) -> str:
    """`value` to so many significant digits, with an exponent only where it is huge or tiny; a dash for none."""
    if not math.isfinite(value):
        return "-"
    rounded = f"{value:.{digits}g}"
    return f"{float(rounded):.15g}" if abs(float(rounded)) < EXPONENT_FROM else rounded


def with_sd(value: float, sd: float) -> str:
    """`100230 ± 120`: the value no finer than its standard deviation deserves."""
    if not math.isfinite(value):
        return "-"
    if not math.isfinite(sd) or sd <= 0:
        return number(value)
    size = math.floor(math.log10(max(abs(value), sd)))
    places = min(12, size - math.floor(math.log10(sd)) + 2)
    return f"{number(value, places)} ± {number(sd, 2)}"


def near(word: str, known: Iterable[str], most: int = 1, cutoff: float = 0.6) -> list[str]:
    """The known words most like one that is not, best first; `cutoff` 1 takes only the word itself, 0 any."""
    return difflib.get_close_matches(word, list(known), n=most, cutoff=cutoff)


def closest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The known word most like one that is not; empty where none is."""
    return next(iter(near(word, known, cutoff=cutoff)), "")


def meant(word: str, known: Iterable[str]) -> str:
    """`did you mean ...?` or the whole list, for a word that is not known."""
    rows = list(known)
    like = closest(word, rows)
    return f"did you mean {like!r}?" if like else f"expected one of {', '.join(rows)}"


def said(who: str, what: str) -> str:
    """`who: what`, for a log; nobody is named twice where `what` says already who."""
    if what.startswith(who) or f": {who}" in what:
        return what
    return f"{who}: {what.removeprefix(f'{who.split()[-1]}: ')}"


PATIENCE_S = 2.0
"""What is over sooner needs no time left."""


def progress(total_words: str) -> Callable[[str, float], None]:
    """A one-line progress report on standard error, if that is a terminal: `say(what, share)`."""
    begun_s = time.monotonic()

    def say(what: str, share: float) -> None:
        if sys.stderr.isatty():
            end = "\n" if share >= 1.0 else ""
            left = time_left(time.monotonic() - begun_s, share)
            print(f"\r\033[K{total_words}: {what} {share:4.0%}{left}", end=end, file=sys.stderr, flush=True)

    return say


def time_left(spent_s: float, share: float) -> str:
    """`, 12 s left` after a share of the work; empty at its begin and end, or where it is soon over."""
    if not 0.0 < share < 1.0 or spent_s < PATIENCE_S:
        return ""
    left_s = spent_s * (1.0 - share) / share
    return f", {left_s:.0f} s left" if left_s < 120 else f", {left_s / 60:.0f} min left"


def write_text(path: Path, text: str) -> None:
    """Raises `BadInput` where that cannot be."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{path}: cannot write: {error.strerror}") from error


# records and numbers as JSON can hold them


def read_toml(path: Path, refusal: type[BadInput] = BadInput) -> dict[str, Any]:
    """The document of a file. Raises `refusal` with one line, whatever the file holds."""
    try:
        document = tomllib.loads(path.read_text("utf-8-sig"))
    except OSError as error:
        raise refusal(f"{path}: cannot read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise refusal(f"{path}: not a text file: expected TOML in UTF-8") from error
    except (ValueError, RecursionError) as error:
        raise refusal(f"{path}: not valid TOML: {error}") from error
    endless = next(_too_long("", document), None)
    if endless:
        raise refusal(f"{path}: {endless}: a whole number of more than 64 bits: expected one that TOML has")
    return document


def _too_long(place: str, value: Any) -> Iterator[str]:
    """Where a document has whole numbers that are none of TOML's, which Python would not even print."""
    if isinstance(value, int) and value.bit_length() > 63:
        yield place
    rows = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in rows:
        yield from _too_long(f"{place}.{key}" if place else str(key), inner)


def fields_of(record: Any) -> dict[str, Any]:
    """A flat record's fields by name; `dataclasses.asdict` would copy deeply, at every turn."""
    return {name: getattr(record, name) for name in record.__slots__}


def finite(value: Any) -> Any:
    """The same with null for numbers that JSON does not know, and states by name."""
    if isinstance(value, NE107):
        return value.name.lower()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {name: finite(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    return value


def short(value: float, digits: int = 4) -> float | None:
    """Four digits are more than a screen shows; None where there is no number."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def shorts(values: Array, digits: int = 4) -> list[float | None]:
    """`short` of each."""
    return [short(value, digits) for value in values.tolist()]


def write_json(document: Mapping[str, Any], target: str) -> None:
    """As JSON into the file `target`, or to standard output for `-`; a number that is not finite becomes null."""
    text = json.dumps(finite(document), indent=2, allow_nan=False) + "\n"
    if target == "-":
        print(text, end="")
        return
    write_text(Path(target), text)


def written_as_json(document: Mapping[str, Any], target: str | None) -> bool:
    """Writes a command's result where `--json` asks for it; True where standard output is then its own."""
    if target:
        write_json(document, target)
    return target == "-"
