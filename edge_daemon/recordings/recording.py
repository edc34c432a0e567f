"""Recordings, CSV or Parquet: arrays over time, repaired where that is honest, and what had to be repaired.

Importing this module costs nothing beyond numpy; pyarrow comes in with the first file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_daemon.recordings.column_map import ColumnMap, kept
from edge_daemon.recordings.column_meaning import TIME, proposed
from edge_daemon.recordings.csv_file import CsvTable, RecordingError, read_csv, refuse_endless
from edge_daemon.recordings.turns import joined
from edge_daemon.records import Array

ANGLES = ("theta_in_rad", "theta_out_rad")
ZIP_MAGIC = b"PK\x03\x04"
"""Workbooks (.xlsx, .ods) are zip archives and begin so."""
PARQUET_MAGIC = b"PAR1"
GAP_INTERVALS = 1.5
"""An interval this many times the median, and outside the scatter, is a gap: half-way to one lost sample."""
GAP_SPREADS = 6.0
"""The scatter of an irregular sampling reaches this many robust standard deviations before it is a gap (guess: six are
rare)."""
MAD_TO_SD = 1.4826
"""The median deviation of a normal distribution times this is its standard deviation."""
COARSE_SHARE = 0.1
"""From this share of rows on that repeat a time it is the clock's fault (guess)."""
INTERLEAVED_PER_STEP_BACK = 50
"""Fewer rows out of order for each step back in time are late arrivals, more are two recordings (guess)."""


@dataclass(frozen=True, slots=True)
class Notes:
    """What was found and repaired while reading."""

    rows: int
    """in the file, header and broken rows not counted"""
    broken_rows: int
    """with too few or too many cells, or the header again: left out"""
    text: tuple[str, ...]
    """columns without numbers: left out"""
    untimed_rows: int
    """without a time: left out"""
    duplicates: int
    """rows at the time of an earlier row: merged into it, the first value of each column wins"""
    reordered: int
    """rows that stood before an earlier time: sorted"""
    turns: Mapping[str, int]
    """jumps of one turn that were taken out, by column; only angles that came as single-turn ones"""
    nan: Mapping[str, int]
    """rows without a value, by column; only columns that have such rows"""
    gaps: int
    """intervals that are clearly longer than the median"""
    longest_gap_s: float
    """0 without a gap"""
    interval_s: float
    """median sampling interval"""
    irregularity: float
    """standard deviation of the intervals that are no gaps, relative to their median"""

    def lines(self) -> Iterator[str]:
        """Each repair and flaw worth telling, as a sentence."""
        if self.broken_rows:
            yield f"{self.broken_rows} rows with a wrong number of cells were left out"
        if self.text:
            yield f"{', '.join(self.text[:5])} holds text: left out"
        if self.untimed_rows:
            yield f"{self.untimed_rows} rows without a time were left out"
        if self.duplicates:
            yield f"{self.duplicates} rows repeated a time and were merged{self._coarse}"
        if self.reordered:
            yield f"{self.reordered} rows were out of order and were sorted"
        for column, count in self.turns.items():
            yield f"{column} is a single-turn angle: its {count} jumps of one turn were taken out"
        for column, count in self.nan.items():
            yield f"{column} has no value in {count} of {self.rows} rows"
        if self.gaps:
            yield f"{self.gaps} gaps, the longest of {self.longest_gap_s:.3g} s"
        if self.irregularity > 0.01:
            yield f"sampling is irregular: intervals scatter by {100 * self.irregularity:.0f} %"

    @property
    def _coarse(self) -> str:
        """What to do where the clock is coarser than the sampling."""
        if self.duplicates < COARSE_SHARE * self.rows:
            return ""
        return ": its clock is coarser than its sampling: if rows are evenly spaced, --map time_s=row/RATE_HZ"


@dataclass(frozen=True, slots=True)
class Recording:
    """Columns over strictly increasing time."""

    time_s: Array
    """(n,) n >= 2 unless fewer were allowed, strictly increasing; in the unit of the file's own time"""
    columns: Mapping[str, Array]
    """name -> (n,); NaN where the file has no finite value; without the time"""
    notes: Notes


def read_recording(path: Path, time: str = TIME, least: int = 2, columns: ColumnMap | None = None) -> Recording:
    """The recording in a CSV file (with header) or a Parquet file, told apart by content.

    `time` names the column of time; with `time_h`, all that is said here of seconds holds for hours. Fewer rows than
    `least` are refused. `columns` says how the file's own columns are to be read; without it, what is kept beside the
    file does.

    CSV cells may be separated by comma, semicolon (then with decimal comma), tab or spaces; lines that begin with `#`
    before the header are skipped. Rows are sorted by time, repeated times merged, missing and infinite values become
    NaN, all counted in `notes`. Raises `RecordingError` for what cannot be repaired.
    """
    try:
        with path.open("rb") as file:
            begin = file.read(len(PARQUET_MAGIC))
        is_parquet = begin == PARQUET_MAGIC
        if begin == ZIP_MAGIC:
            raise RecordingError(f"{path}: a workbook (.xlsx) or another archive: expected CSV or Parquet")
        given = kept(path) if columns is None else columns
        read = CsvTable(_read_parquet(path), 0, ()) if is_parquet else read_csv(path, time, given)
    except OSError as error:
        raise RecordingError(f"{path}: cannot read: {error.strerror or _one_line(error)}") from error
    table = given.applied(read.columns) if read.columns and given.formulas else read.columns
    if time not in table:
        raise RecordingError(
            f"{path}: no column {time}: expected it beside {', '.join(list(table)[:8])}{_timed(table, time)}"
        )
    return _tidy(path, time, read._replace(columns=table), least)


def _timed(names: Iterable[str], time: str) -> str:
    """Which column was probably meant for the time."""
    if time == TIME:
        proposal = proposed(names, {TIME})
        return f": did you mean {proposal}?" if proposal else ""
    like = next((name for name in names if re.fullmatch(r"(t|time|timestamp|zeit)\b.*|time_.*", name, re.I)), None)
    return f": if {like!r} is the time, it wants to be in hours and called {time}" if like else ""


def write_recording(path: Path, time_s: Array, columns: Mapping[str, Array]) -> None:
    """Writes `time_s` and `columns`, each (n,), as Parquet if the name ends in .parquet, as CSV otherwise.

    Numbers keep every digit: reading back gives the same floats. Raises `RecordingError`.
    """
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    lengths = {name: len(column) for name, column in columns.items() if len(column) != len(time_s)}
    if lengths:
        raise RecordingError(f"{path}: columns {lengths} differ in length from {TIME}: expected {len(time_s)} rows")
    table = pa.table({TIME: pa.array(time_s), **{name: pa.array(column) for name, column in columns.items()}})
    try:
        if path.suffix == ".parquet":
            pyarrow.parquet.write_table(table, path)
        else:
            pyarrow.csv.write_csv(table, path, pyarrow.csv.WriteOptions(quoting_style="none"))
    except (OSError, pa.ArrowException) as error:
        raise RecordingError(f"{path}: cannot write: {_one_line(error)}") from error


def _read_parquet(path: Path) -> dict[str, Array]:
    import pyarrow as pa
    import pyarrow.parquet

    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            names = _wanted(path, file.schema_arrow)
            refuse_endless(path, file.metadata.num_rows, len(file.schema_arrow))
            table = file.read(names, use_threads=False)
    except pa.ArrowMemoryError:
        raise
    except (pa.ArrowException, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: not a readable Parquet file: {_one_line(error)}") from error
    return {name: table[name].cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False) for name in names}


def _wanted(path: Path, schema: Any) -> list[str]:
    """Columns of a Parquet file; they must hold numbers, which is known before any of them is read."""
    import pyarrow as pa

    rows = [row for row in schema if not row.name.startswith("__index")]
    for row in rows:
        if not (pa.types.is_floating(row.type) or pa.types.is_integer(row.type) or pa.types.is_boolean(row.type)):
            raise RecordingError(f"{path}: column {row.name}: holds {row.type}: expected numbers")
    return [row.name for row in rows]


def _one_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _tidy(path: Path, time: str, read: CsvTable, least: int) -> Recording:
    """Sorted, merged, counted."""
    table = read.columns
    rows = len(table[time])
    if rows == 0:
        raise RecordingError(f"{path}: no rows below the header: expected at least two")
    timed = np.isfinite(table[time])
    time_s = table[time][timed]
    columns = {name: _finite(column[timed]) for name, column in table.items() if name != time}
    reordered = int(np.count_nonzero(time_s < np.maximum.accumulate(time_s))) if len(time_s) else 0
    if reordered:
        order = np.argsort(time_s, kind="stable")
        _check_repairable(path, time, time_s, columns, order)
        time_s, columns = time_s[order], {name: column[order] for name, column in columns.items()}
    first = np.concatenate(([True], np.diff(time_s) > 0)) if len(time_s) else np.zeros(0, dtype=bool)
    duplicates = len(time_s) - int(np.count_nonzero(first))
    if duplicates:
        time_s, columns = time_s[first], {name: _merged(column, first) for name, column in columns.items()}
    if len(time_s) < least:
        raise RecordingError(f"{path}: only {len(time_s)} row with a time of its own: expected at least two")
    turns = {}
    for name in [name for name in columns if name in ANGLES]:
        columns[name], turns[name] = joined(columns[name])
    nan = {name: int(np.count_nonzero(np.isnan(column))) for name, column in columns.items()}
    notes = Notes(
        rows=rows,
        broken_rows=read.broken_rows,
        text=read.text,
        untimed_rows=rows - int(np.count_nonzero(timed)),
        duplicates=duplicates,
        reordered=reordered,
        turns={name: count for name, count in turns.items() if count},
        nan={name: count for name, count in nan.items() if count},
        **_sampling(time_s),
    )
    return Recording(time_s, columns, notes)


def _finite(column: Array) -> Array:
    """The column with infinities as NaN."""
    endless = np.isinf(column)
    return np.where(endless, np.nan, column) if endless.any() else column


def _merged(column: Array, first: NDArray[np.bool_]) -> Array:
    """One value for each run of equal times: the first that is not NaN. `first` marks where runs begin."""
    start = np.flatnonzero(first)
    position = np.where(np.isnan(column), len(column), np.arange(len(column)))
    best = np.minimum.reduceat(position, start)
    return column[np.where(best < len(column), best, start)]


def _check_repairable(
    path: Path, time: str, time_s: Array, columns: Mapping[str, Array], order: NDArray[np.intp]
) -> None:
    """Late rows can be sorted in, repeated ones merged; two recordings that overlap in time would be mixed."""
    back = np.diff(time_s) < 0
    run = np.concatenate(([0], np.cumsum(back)))
    order = order[~_repeats(time_s, columns, order)]
    mixed = int(np.count_nonzero(np.diff(run[order])))
    if mixed > INTERLEAVED_PER_STEP_BACK * (run[-1] + 1):
        row = int(np.argmax(back)) + 1
        raise RecordingError(
            f"{path}: {time} runs back from {time_s[row - 1]:.6g} to {time_s[row]:.6g} at row {row + 1} "
            "and goes on from there: expected one recording with increasing time"
        )


def _repeats(time_s: Array, columns: Mapping[str, Array], order: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(n,) in the sorted order: rows that say what the row before them says at the same time, or nothing."""
    same: NDArray[np.bool_] = np.diff(time_s[order], prepend=-np.inf) == 0
    for column in columns.values():
        value = column[order]
        same[1:] &= (value[1:] == value[:-1]) | np.isnan(value[1:]) | np.isnan(value[:-1])
    return same


def _sampling(time_s: Array) -> dict[str, Any]:
    """Interval, irregularity and gaps of strictly increasing times; all 0 for a single one."""
    if len(time_s) < 2:
        return {"gaps": 0, "longest_gap_s": 0.0, "interval_s": 0.0, "irregularity": 0.0}
    step_s = np.diff(time_s)
    median_s = float(np.median(step_s))
    spread_s = MAD_TO_SD * float(np.median(np.abs(step_s - median_s)))
    gap = step_s > GAP_INTERVALS * median_s + GAP_SPREADS * spread_s
    return {
        "gaps": int(np.count_nonzero(gap)),
        "longest_gap_s": float(step_s[gap].max(initial=0.0)),
        "interval_s": median_s,
        "irregularity": float(np.std(step_s[~gap])) / median_s,
    }
