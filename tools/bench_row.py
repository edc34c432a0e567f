"""One row of a bench: a figure, its limit, and the peer it was measured beside in the same run."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """`limit` is the most (or, with `at_least`, the least) that is acceptable; NaN where there is none."""

    name: str
    value: float
    unit: str = "1"
    limit: float = math.nan
    at_least: bool = False
    peer: str = ""
    """what it was compared with in this run, and that one's figure"""

    @property
    def verdict(self) -> str:
        """`ok`, `MISSED`, or nothing where there is no limit."""
        if math.isnan(self.limit):
            return ""
        good = self.value >= self.limit if self.at_least else self.value <= self.limit
        return "ok" if good else "MISSED"


HEAD = ("figure", "value", "unit", "limit", "verdict", "beside")


def cells(row: Row) -> tuple[str, ...]:
    """The row as text, for a table under `HEAD`."""
    sign = ">=" if row.at_least else "<="
    limit = "" if math.isnan(row.limit) else f"{sign} {row.limit:g}"
    return (row.name, f"{row.value:.4g}", row.unit, limit, row.verdict, row.peer)
