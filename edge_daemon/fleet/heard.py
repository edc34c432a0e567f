"""A message as rows: one a number, `name, value, sd, status, unit`. docs/fleet.md says what becomes of each topic."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import msgspec

from edge_daemon.records import NE107

MOST_ROWS = 1000
"""One message gives no more rows: the longest that a gateway sends has about a hundred."""
MOST_BYTES = 256_000
"""A longer message is refused: a gateway's longest, its introduction, has six thousand bytes."""
LAST_NUMBER = 2**63 - 1
"""A run and a sequence number are whole numbers that the dataset's columns can hold."""
WORDED = ("meta", "event")
"""These topics say things in words: a word stands in `status`, without a value."""
LEFT_OUT = {"quantities", "topics", "schema", "version", "drive", "run", "sequence", "time_s", "historical"}
"""These keys are the envelope, or a list of what every gateway of this version knows."""

Row = tuple[str, float | None, float | None, str | None, str | None]
"""Name, value, sd, status, unit."""


class HeardEstimate(msgspec.Struct, gc=False):
    """One estimate of a message."""

    value: float | None = None
    sd: float | None = None
    status: str | None = None
    unit: str | None = None


class Heard(msgspec.Struct, gc=False):
    """One message as it was published."""

    run: int
    sequence: int
    time_s: float | None = None
    historical: bool = False
    estimates: dict[str, HeardEstimate] = {}
    ne107: int | None = None
    state: str | None = None


class Unheard(ValueError):
    """A payload that is no message of ours."""


_fast = msgspec.json.Decoder(Heard)
_number = int | float


def heard(payload: bytes) -> Heard:
    """The message of a payload. Raises `Unheard`."""
    if len(payload) > MOST_BYTES:
        raise Unheard(f"{len(payload)} bytes")
    try:
        try:
            message = _fast.decode(payload)
        except ValueError:  # of another shape, or no UTF-8
            message = _lenient(payload)
    except RecursionError as error:
        raise Unheard("nested too deep") from error
    if not (0 <= message.run <= LAST_NUMBER and 0 <= message.sequence <= LAST_NUMBER):
        raise Unheard("run or sequence out of range")
    if len(message.estimates) > MOST_ROWS:
        raise Unheard(f"{len(message.estimates)} estimates")
    return message


def _lenient(payload: bytes) -> Heard:
    """The same of a message in which a part is not as expected: what can be read of it."""
    try:
        document = msgspec.json.decode(payload)
        told = document.get("estimates")
        estimates = {str(name): _told(row) for name, row in told.items()} if isinstance(told, dict) else {}
        number = document.get("ne107")
        return Heard(
            msgspec.convert(document["run"], int),
            msgspec.convert(document["sequence"], int),
            _finite(document.get("time_s")),
            document.get("historical") is True,
            estimates,
            number if isinstance(number, int) else None,
            _word(document.get("state")),
        )
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise Unheard(str(error)) from error


def _told(row: Any) -> HeardEstimate:
    if isinstance(row, dict):
        return HeardEstimate(
            _finite(row.get("value")), _finite(row.get("sd")), _word(row.get("status")), _word(row.get("unit"))
        )
    return HeardEstimate(_finite(row))


def _finite(value: Any) -> float | None:
    good = isinstance(value, _number) and not isinstance(value, bool) and abs(value) < 1e300 and math.isfinite(value)
    return float(value) if good else None


def _word(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def rows_beside(topic: str, message: Heard, payload: bytes) -> list[Row]:
    """What a message says beside its estimates; one without any gets a row of its topic's name, so that it stands."""
    if topic in WORDED or not (message.estimates or message.ne107 is not None):
        try:
            found = list(itertools.islice(_leaves(topic, payload), MOST_ROWS))
        except (ValueError, RecursionError) as error:
            raise Unheard(str(error)) from error
        return found if found or message.estimates else [(topic, None, None, None, None)]
    return [] if message.ne107 is None else [("ne107", _finite(message.ne107), None, message.state, None)]


def _leaves(topic: str, payload: bytes) -> Iterator[Row]:
    """Each number and word of the document, by its path; a word of a list of words counts 1."""
    document = msgspec.json.decode(payload)
    for name, value in document.items():
        if name == "severity" and topic == "event":
            yield name, _severity(value), None, _word(value), None
        elif name not in LEFT_OUT and name != "estimates":
            yield from _below(str(name), value)


def _below(path: str, value: Any) -> Iterator[Row]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _below(f"{path}.{name}", inner)
    elif isinstance(value, list):
        for at, inner in enumerate(value):
            yield from (
                [(f"{path}.{inner}", 1.0, None, None, None)]
                if isinstance(inner, str)
                else _below(f"{path}.{at}", inner)
            )
    elif isinstance(value, str):
        yield path, None, None, value, None
    elif _finite(value) is not None:
        yield path, _finite(value), None, None, None


def _severity(word: Any) -> float | None:
    name = str(word).upper()
    return float(NE107[name]) if name in NE107.__members__ else None
