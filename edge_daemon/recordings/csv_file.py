"""CSV as loggers, robots and test benches write it: what stands before the numbers, and columns that hold none."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edge_daemon.channels import CHANNELS
from edge_daemon.errors import BadInput
from edge_daemon.recordings.column_map import SKIPPED, ColumnMap, uses
from edge_daemon.records import Array
from edge_daemon.units import UNITS

NO_VALUE = ["", "nan", "NaN", "NAN", "na", "NA", "n/a", "N/A", "null", "NULL", "None", "none", "nil", "-", "--", "---",
            "?", "#N/A", "#NV", "#VALUE!", "#DIV/0!", "1.#QNAN", "-1.#IND", "1.#INF", "-1.#INF"]  # fmt: skip
"""Loggers write one of these where they have no value."""
UNWANTED = "_unwanted_"
"""Beginning of the name under which a column is read that nobody wants."""
MOST_COLUMNS = 1000
"""No recorder writes as many, and a header of 200 000 names took minutes."""
MOST_NUMBERS = 64 * 2**20
"""A recording holds at most so many numbers, which take half a gigabyte and three times that while they are put in
order: five columns at 1 kHz for three hours and a half."""
MOST_CSV_BYTES = 2**30
"""A CSV file may be sixteen bytes long for each of them."""
HEAD_BYTES, HEAD_LINES, NAMES_BYTES = 2**18, 80, 4096
"""What stands before the numbers is looked for so far, and in what letters names are written."""
MOST_TEXT = 20
"""So many columns may turn out to hold text below numbers (guess)."""
NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")
STAMP = re.compile(r"(\d{4}-\d\d-\d\d[T ])?\d\d:\d\d:\d\d([.,]\d{1,9})?(Z|[+-]\d\d:?\d\d)?")
"""A date and time as ISO 8601 has it, or the time of a day."""
IN_BRACKETS = re.compile(r"\[.*\]|\(.*\)")
NO_TEXT = re.compile(r"[\x00-\x08\x0e-\x1f]")


class RecordingError(BadInput):
    """One line: the file, where in it, what is wrong, what was expected."""


class CsvTable(NamedTuple):
    """What a CSV file holds."""

    columns: dict[str, Array]
    broken_rows: int
    """with too few or too many cells"""
    text: tuple[str, ...]
    """columns without numbers, which are left out"""


class CsvHead(NamedTuple):
    """What a CSV file begins with."""

    names: list[str]
    """of its columns; empty where it has no header"""
    rows: list[list[str]]
    """the first, cell by cell"""
    delimiter: str
    columns: int


@dataclass(frozen=True, slots=True)
class _Top:
    """Where the table of a file begins."""

    lines: list[str]
    """of the file, as far as it is looked through"""
    at: int
    """of the header, or of the first row where there is none"""
    delimiter: str
    cells: list[str]
    """of that line"""
    numbers: bool
    """they are a row: there is no header"""

    def rows(self, count: int) -> tuple[int, list[list[str]]]:
        """How many lines stand above the rows, a row of units among them, and the first of the rows."""
        above = self.at if self.numbers else self.at + 1
        rows = [_cells(line, self.delimiter) for line in self.lines[above : above + count + 1]]
        width = len(self.cells)
        below = not self.numbers and len(rows) > 1 and not _is_words(rows[1], width)
        if below and (_is_words(rows[0], width) or _are_units(rows[0])):
            above, rows = above + 1, rows[1:]
        return above, rows[:count]


@dataclass(frozen=True, slots=True)
class _Header:
    names: list[str]
    delimiter: str
    decimal_comma: bool
    lines: int
    """up to and with the header, and a row of units below it"""
    first_row: list[str]


def read_csv(path: Path, time: str, given: ColumnMap) -> CsvTable:
    """The columns of a file; dates and times are seconds since the first of them. Raises `RecordingError`."""
    if path.stat().st_size > MOST_CSV_BYTES:
        raise RecordingError(
            f"{path}: expected at most {MOST_CSV_BYTES // 2**20} MiB: cut it in pieces, or use Parquet"
        )
    data = _separated(_decoded(path.read_bytes()))
    header = _header(path, data, time, given.names)
    data, again = _without_repeated(data, header)
    refuse_endless(path, data.count(b"\n"), len(header.names))
    asked = {name for name in header.names if any(uses(formula, name) for formula in given.formulas.values())}
    needed = {time, *CHANNELS, *asked}
    table, broken = _parsed(path, data, header, needed)
    columns, text = {}, []
    for name in header.names:
        if name.startswith(UNWANTED):
            continue
        numbers = _numbers(table[name])
        if numbers is not None:
            columns[name] = numbers
        elif name in needed:
            shown = next((str(cell) for cell in table[name].to_pylist() if cell), "")
            raise RecordingError(f"{path}: column {name}: {shown[:40]!r} is no number: expected numbers")
        else:
            text.append(name)
    return CsvTable(columns, broken + again, tuple(text))


def read_head(path: Path, rows: int) -> CsvHead:
    """The names and so many of the first rows, as `read_csv` would have them. Raises `RecordingError`."""
    try:
        with path.open("rb") as file:
            data = _separated(_decoded(file.read(HEAD_BYTES)))
    except OSError as error:
        raise RecordingError(f"{path.name}: cannot read: {error.strerror}") from error
    top = _top(Path(path.name), data)
    return CsvHead(_commented(top) if top.numbers else top.cells, top.rows(rows)[1], top.delimiter, len(top.cells))


def refuse_endless(path: Path, rows: int, columns: int) -> None:
    """What a file says of its size is looked at before any of it is read: a small one may unpack to anything."""
    if columns > MOST_COLUMNS:
        raise RecordingError(f"{path}: {columns} columns: expected at most {MOST_COLUMNS}")
    if rows * columns > MOST_NUMBERS:
        raise RecordingError(
            f"{path}: {rows} rows of {columns} columns: expected at most {MOST_NUMBERS // columns} rows: cut it up"
        )


def _decoded(data: bytes) -> bytes:
    """The same in UTF-8, with lines that end as everywhere."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        data = data.decode("utf-16", errors="replace").encode()
    elif not data.isascii():  # Arrow stumbles over rows that are no text at all
        text = data.decode("utf-8-sig", errors="replace")
        if "\ufffd" in text[:NAMES_BYTES]:  # the degree sign of Windows
            old = data.decode("cp1252", errors="replace")
            text = text if NO_TEXT.search(old[:NAMES_BYTES]) else old
        data = text.encode()
    return data if b"\n" in data else data.replace(b"\r", b"\n")  # as old Macintoshes and some instruments end lines


def _separated(data: bytes) -> bytes:
    """The same with commas where cells are set apart by spaces alone, as in many a robot's log: by one each, between
    which a cell may be empty, or by any number."""
    lines = [line for line in data[:4096].splitlines() if line.strip() and not line.startswith(b"#")]
    if len(lines) < 2 or any(mark in line for line in lines for mark in b",;\t"):
        return data
    names, first = (len(line.split()) for line in lines[:2])
    if names > 1 and {line.count(b" ") for line in (*lines[:2], *lines[2:-1])} == {names - 1}:
        return data.replace(b" ", b",")
    if names == 1 or names != first:
        return data
    return re.sub(rb" +", b",", re.sub(rb"(?m)^ +| +$", b"", data))


def _top(path: Path, data: bytes) -> _Top:
    lines = data[:HEAD_BYTES].decode(errors="replace").removesuffix("\n").split("\n")[:HEAD_LINES]
    at = next((i for i, line in enumerate(lines) if line.strip() and not line.strip().startswith("#")), None)
    if at is None:
        raise RecordingError(f"{path}: empty: expected a header line and rows of numbers")
    if "\0" in lines[at] or "\ufffd" in lines[at]:
        raise RecordingError(f"{path}: not a text file: expected CSV in UTF-8, or Parquet")
    at = _below_preamble(lines, at)
    delimiter = _delimiter(lines[at])
    refuse_endless(path, 0, _line(data, at).count(delimiter.encode()) + 1)
    cells = _cells(lines[at], delimiter)
    numbers = _is_row(cells, _cells(lines[at + 1], delimiter) if at + 1 < len(lines) else cells)
    return _Top(lines, at, delimiter, cells, numbers)


def _header(path: Path, data: bytes, time: str, given: Sequence[str]) -> _Header:
    top = _top(path, data)
    given = given or _commented(top)
    if top.numbers and not given:
        raise RecordingError(f"{path}: line {top.at + 1} holds numbers: name the columns with --columns {time},...")
    if given and len(given) != len(top.cells):
        raise RecordingError(f"{path}: line {top.at + 1} has {len(top.cells)} cells, {len(given)} columns are named:"
                             " expected as many")  # fmt: skip
    names = [f"{UNWANTED}{i}" if name in ("", SKIPPED) else name for i, name in enumerate(given or top.cells)]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise RecordingError(f"{path}: line {top.at + 1}: column {twice[0]!r} appears twice: expected different names")
    above, rows = top.rows(1)
    plain = "\n".join(top.lines[above:])
    comma = "," in plain if top.delimiter != "," else bool(re.search(r'"[-+]?\d+,\d+"', plain))
    return _Header(names, top.delimiter, comma, above, rows[0] if rows else [])


def _below_preamble(lines: Sequence[str], first: int) -> int:
    """The line of the header: the first, or where others have as many cells as the numbers, the one above those."""
    rows = [(i, _cells(line, _delimiter(line))) for i, line in enumerate(lines) if i >= first and line.strip()]
    for k in range(1, len(rows) - 1):
        cells = rows[k][1]
        if len(cells) < 2 or not _is_row(cells, rows[k + 1][1]):
            continue
        if len(cells) == len(rows[0][1]) == len(rows[1][1]):
            return first
        above = k
        if _is_words(rows[k - 1][1], len(cells)) or _are_units(rows[k - 1][1]):
            above -= 1
        if 0 < above < k and _are_units(rows[above][1]) and _is_words(rows[above - 1][1], len(cells)):
            above -= 1
        return rows[above][0] if above < k else first
    return first


def _are_units(cells: Sequence[str]) -> bool:
    """Whether half of a line's cells at least are units, and no numbers."""
    known = [bool(IN_BRACKETS.fullmatch(cell)) or (cell in UNITS and not NUMBER.fullmatch(cell)) for cell in cells]
    return 2 * sum(known) >= len(cells)


def _is_row(cells: Sequence[str], below: Sequence[str]) -> bool:
    """Whether half of a line's cells at least are numbers, and those below the same."""
    kinds = [bool(NUMBER.fullmatch(cell)) for cell in cells]
    same = len(below) != len(cells) or kinds == [bool(NUMBER.fullmatch(cell)) for cell in below]
    return 2 * sum(kinds) >= len(cells) and (same or all(kinds))


def _commented(top: _Top) -> list[str]:
    """The names in the last comment above numbers, as NumPy writes them; none where it has not as many."""
    if not top.numbers:
        return []
    text = next((line for line in reversed(top.lines[: top.at]) if line.strip()), "")
    names = _cells(text.strip().lstrip("#").strip(f"{top.delimiter} "), top.delimiter)
    return names if _is_words(names, len(top.cells)) else []


def _delimiter(line: str) -> str:
    return next((mark for mark in ";\t" if mark in line), ",")


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip().strip('"') for cell in line.strip().split(delimiter)]


def _is_words(cells: Sequence[str], count: int) -> bool:
    """Whether as many cells as a header has hold no number, date or time, and not nothing."""
    said = [cell for cell in cells if cell not in NO_VALUE]
    return len(cells) == count and bool(said) and not any(NUMBER.fullmatch(c) or STAMP.fullmatch(c) for c in said)


def _without_repeated(data: bytes, header: _Header) -> tuple[bytes, int]:
    """The same without further lines that are the header again, as logs have it that were joined; how many."""
    line = _line(data, header.lines - 1).strip() if header.lines else b""
    if not line or data.count(line) < 2 or NUMBER.match(line.decode(errors="replace")):
        return data, 0
    rows = data.splitlines(keepends=True)
    kept = [row for i, row in enumerate(rows) if i < header.lines or row.strip() != line]
    return b"".join(kept), len(rows) - len(kept)


def _line(data: bytes, at: int) -> bytes:
    file = io.BytesIO(data)
    for _ in range(at):
        file.readline()
    return file.readline()


def _parsed(path: Path, data: bytes, header: _Header, needed: Collection[str]) -> tuple[Any, int]:
    """The table, columns of text among it, and how many rows had a wrong number of cells."""
    import pyarrow as pa
    import pyarrow.csv

    broken = 0

    def skip(_row: Any) -> str:
        nonlocal broken
        broken += 1
        return "skip"

    kinds = {name: pa.string() if _is_text(name, cell) else pa.float64() for name, cell in _first_cells(header)}
    for _ in range(MOST_TEXT):
        broken = 0
        try:
            table = pyarrow.csv.read_csv(
                pa.BufferReader(data),
                pyarrow.csv.ReadOptions(use_threads=False, skip_rows=header.lines, column_names=header.names),
                pyarrow.csv.ParseOptions(delimiter=header.delimiter, invalid_row_handler=skip),
                pyarrow.csv.ConvertOptions(
                    column_types=kinds, null_values=NO_VALUE, strings_can_be_null=True,
                    decimal_point="," if header.decimal_comma else ".",
                ),
            )  # fmt: skip
        except pa.ArrowInvalid as error:
            if "Empty CSV" in str(error):
                raise RecordingError(f"{path}: no rows below the header: expected at least two") from error
            name, cell = _what_is_no_number(str(error), header)
            if not name:
                raise RecordingError(f"{path}: not a readable CSV file: {str(error).splitlines()[0]}") from error
            if name in needed or kinds[name] == pa.string():
                message = f"column {name}: {cell[:40]!r} is no number: expected numbers"
                raise RecordingError(f"{path}: {message}") from error
            kinds[name] = pa.string()
            continue
        if broken and not table.num_rows:
            raise RecordingError(
                f"{path}: no row has the {len(header.names)} cells of the header: expected as many "
                "(between cells with decimal commas stands a semicolon)"
            )
        return table, broken
    raise RecordingError(f"{path}: {MOST_TEXT} columns of numbers turn to text: expected numbers")


def _first_cells(header: _Header) -> list[tuple[str, str]]:
    """Each column with the cell of the first row, as far as that goes."""
    row = header.first_row if len(header.first_row) == len(header.names) else []
    return list(zip(header.names, row or [""] * len(header.names), strict=True))


def _is_text(name: str, cell: str) -> bool:
    """Whether a column is read as text: what nobody wants, and what begins with no number."""
    return name.startswith(UNWANTED) or not (NUMBER.fullmatch(cell) or cell in NO_VALUE or _is_endless(cell))


def _is_endless(cell: str) -> bool:
    return cell.lower().lstrip("+-") in ("inf", "infinity")


def _numbers(column: Any) -> Array | None:
    """(n,) of a column; dates and times as seconds since the first; None of text."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if column.type != pa.string():
        return np.asarray(column.to_numpy())
    first = next((chunk.as_py() for chunk in column if chunk.is_valid), "")
    if not STAMP.fullmatch(first.strip()):
        return None
    plain = pc.replace_substring_regex(pc.utf8_trim_whitespace(column), r"(Z|[+-]\d\d:?\d\d)$", "")
    plain = pc.replace_substring(pc.replace_substring(plain, ",", "."), "T", " ")
    if len(first.split(":")[0]) < len("0000-00-00"):
        plain = pc.binary_join_element_wise(pa.scalar("1970-01-01"), plain, " ")
    try:
        stamps = plain.cast(pa.timestamp("ns")).cast(pa.int64())
    except pa.ArrowInvalid:
        return None
    missing = stamps.is_null().to_numpy()
    ns = stamps.fill_null(0).to_numpy()
    return np.where(missing, np.nan, (ns - ns[~missing][0]) * 1e-9)


def _what_is_no_number(message: str, header: _Header) -> tuple[str, str]:
    """The column and the cell that Arrow complains about; empty where it does about something else."""
    found = re.search(r"In CSV column #(\d+):.*invalid value '(.*)'", message, re.DOTALL)
    return (header.names[int(found[1])], found[2]) if found else ("", "")
