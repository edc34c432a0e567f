"""Plain data: records and numbers as JSON can hold them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from edge_daemon.records import NE107, Array


def fields_of(record: Any) -> dict[str, Any]:
    """A flat record's fields by name; `dataclasses.asdict` would copy deeply, ten times a second."""
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
