"""What a dataset tells of each drive: sums over its files that are the same in whatever order they were made."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from edge_daemon.errors import BadInput
from edge_daemon.fleet.engine import mapped
from edge_daemon.records import Array

NUMBERS = (
    *("model_nrmse", "model_noise_floor", "model_rmse", "damping", "coulomb_friction", "kinematic_error"),
    *("hysteresis_area", "stribeck_speed", "hysteresis_width", "half_gap", "encoder_skew", "torque_rms"),
    *(
        "torque_cubic_mean",
        "speed_in",
        "temperature",
        "operating_hours",
        "damage",
        "health_index",
        "ne107",
        "stiffness",
    ),
)
"""Of these each drive's mean and newest value are wanted."""
WORDS = ("gear",)
READ = pa.schema(
    [(name, pa.float64() if name in ("time_s", "value") else pa.string())
     for name in ("gateway", "drive", "time_s", "name", "value", "status")]
)  # fmt: skip
"""These columns of a file are looked at, whatever tool has written it again."""
TORQUE_STEP = 0.02
"""Torques are counted in bins so wide in their logarithm: to the twelfth power it is wrong by 1 % of that."""
TRIES = 5
"""A dataset that is being collected merges its files now and then: it is looked at again so often."""
USABLE = ("valid", "not_excited")
"""Estimates of this status count; `ne107` has another."""


@dataclass(slots=True)
class FleetMean:
    """Mean over all messages, and the newest."""

    count: int = 0
    total: float = 0.0
    newest_s: float = -math.inf
    newest: float = math.nan

    def add(self, count: int, total: float, newest_s: float, newest: float) -> None:
        self.count += count
        self.total += total
        if newest_s >= self.newest_s:
            self.newest_s, self.newest = newest_s, newest

    @property
    def value(self) -> float:
        """NaN where there is none."""
        return self.total / self.count if self.count else math.nan


@dataclass(slots=True)
class DrivePast:
    """One drive, site/gateway/drive."""

    drive: str
    first_s: float = math.inf
    last_s: float = -math.inf
    means: dict[str, FleetMean] = field(default_factory=dict)
    torque: dict[int, int] = field(default_factory=dict)
    """bin of log torque [N m] in `TORQUE_STEP` -> messages"""
    words: dict[str, tuple[float, str]] = field(default_factory=dict)
    """newest time and word"""

    def mean(self, name: str) -> float:
        """NaN where it is not known."""
        return self.means[name].value if name in self.means else math.nan

    def newest(self, name: str) -> float:
        """NaN where it is not known."""
        return self.means[name].newest if name in self.means else math.nan

    def word(self, name: str) -> str:
        """Empty where it is not known."""
        return self.words.get(name, (0.0, ""))[1]

    def torques_Nm(self) -> tuple[Array, Array]:
        """Torque of each bin and the share of messages in it; the mean of the whole life where there is no other."""
        if self.torque:
            bins = sorted(self.torque)
            counts = np.array([self.torque[one] for one in bins], dtype=float)
            return np.exp(np.array(bins, dtype=float) * TORQUE_STEP), counts / counts.sum()
        return np.array([self.mean("torque_cubic_mean")]), np.ones(1)

    def join(self, other: DrivePast) -> None:
        """Take in what another file says of the same drive."""
        self.first_s, self.last_s = min(self.first_s, other.first_s), max(self.last_s, other.last_s)
        for name, row in other.means.items():
            self.means.setdefault(name, FleetMean()).add(row.count, row.total, row.newest_s, row.newest)
        for one, count in other.torque.items():
            self.torque[one] = self.torque.get(one, 0) + count
        for name, told in other.words.items():
            self.words[name] = max(self.words.get(name, (-math.inf, "")), told)


def pasts(folder: Path, scheduler: str | None = None) -> list[DrivePast]:
    """All drives of a dataset, in order of their names. Raises `BadInput` for a folder that is none."""
    for tries_left in reversed(range(TRIES)):
        files = sorted(folder.absolute().glob("site=*/date=*/*.parquet"))
        if not files:
            raise BadInput(f"{folder}: no files: expected what `fleet collect` writes: site=SITE/date=DATE/*.parquet")
        try:
            parts = mapped(past_of_file, files, scheduler)
            break
        except FileNotFoundError:  # merged while we read
            if not tries_left:
                raise
    found: dict[str, DrivePast] = {}
    for past in itertools.chain.from_iterable(parts):
        found.setdefault(past.drive, DrivePast(past.drive)).join(past)
    return [found[drive] for drive in sorted(found)]


def past_of_file(path: Path) -> list[DrivePast]:
    """What one file says of each drive in it. Raises `FileNotFoundError` where it was merged away meanwhile."""
    site = unquote(path.parent.parent.name.removeprefix("site="))
    try:
        table = pq.ParquetFile(path).read(columns=READ.names).select(READ.names).cast(READ)
        table.validate(full=True)
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, KeyError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read: {error}") from error
    found: dict[str, DrivePast] = {}
    _add_numbers(table, site, found)
    _add_words(table, site, found)
    return [found[drive] for drive in sorted(found)]


def _add_numbers(table: pa.Table, site: str, found: dict[str, DrivePast]) -> None:
    name, status = table["name"], table["status"]
    usable = pc.or_(pc.is_in(status, value_set=pa.array(USABLE)), pc.equal(name, "ne107"))
    wanted = pc.and_(pc.is_in(name, value_set=pa.array(NUMBERS)), pc.and_(usable, pc.is_finite(table["value"])))
    rows = table.filter(pc.fill_null(wanted, False)).select(["gateway", "drive", "name", "time_s", "value"])
    if not rows.num_rows:
        return
    rows = rows.sort_by([(key, "ascending") for key in ("gateway", "drive", "name", "time_s", "value")])
    keys = [rows[key].combine_chunks().dictionary_encode() for key in ("gateway", "drive", "name")]
    codes = np.stack([np.asarray(key.indices) for key in keys])
    starts = np.flatnonzero(np.concatenate(([True], np.any(np.diff(codes, axis=1) != 0, axis=0))))
    words = [key.dictionary.to_pylist() for key in keys]
    time_s, value = (np.asarray(rows[key].to_numpy(), dtype=float) for key in ("time_s", "value"))
    for start, end in zip(starts, [*starts[1:], rows.num_rows], strict=True):
        gateway, drive, what = (word[code] for word, code in zip(words, codes[:, start], strict=True))
        part = slice(int(start), int(end))
        _add_group(_past(found, f"{site}/{gateway}/{drive}"), what, time_s[part], value[part])


def _add_group(past: DrivePast, name: str, time_s: Array, value: Array) -> None:
    known = time_s[np.isfinite(time_s)]
    last_s = float(known[-1]) if known.size else -math.inf
    if known.size:
        past.first_s, past.last_s = min(past.first_s, float(known[0])), max(past.last_s, last_s)
    at = int(np.flatnonzero(np.isfinite(time_s))[-1]) if known.size else len(value) - 1
    past.means.setdefault(name, FleetMean()).add(len(value), math.fsum(value), last_s, float(value[at]))
    if name == "torque_rms":
        bins = np.round(np.log(np.maximum(value, 1e-3)) / TORQUE_STEP).astype(int)
        for one, count in zip(*np.unique(bins, return_counts=True), strict=True):
            past.torque[int(one)] = past.torque.get(int(one), 0) + int(count)


def _add_words(table: pa.Table, site: str, found: dict[str, DrivePast]) -> None:
    rows = table.filter(pc.fill_null(pc.is_in(table["name"], value_set=pa.array(WORDS)), False))
    columns = (rows[key].to_pylist() for key in ("gateway", "drive", "name", "time_s", "status"))
    for gateway, drive, name, time_s, word in zip(*columns, strict=True):
        if word:
            past = _past(found, f"{site}/{gateway}/{drive}")
            past.words[name] = max(past.words.get(name, (-math.inf, "")), (time_s or 0.0, word))


def _past(found: dict[str, DrivePast], drive: str) -> DrivePast:
    return found.setdefault(drive, DrivePast(drive))


def only(drives: Iterable[DrivePast], gear: str) -> list[DrivePast]:
    """Those with this gear, or whose gear is not known."""
    return [past for past in drives if past.word("gear") in ("", gear)]


def of_one_gear(drives: Sequence[DrivePast], named: str) -> tuple[str, list[DrivePast]]:
    """The gear that was named, or the only one that the drives say they have, and its drives. Raises `BadInput`."""
    told = sorted({past.word("gear") for past in drives} - {""})
    if not named and len(told) != 1:
        raise BadInput(f"--gear: missing: expected one of {', '.join(told) or 'the catalogue'}")
    return named or told[0], only(drives, named or told[0])
