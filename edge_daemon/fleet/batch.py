"""What was heard of one day, in columns: a message's numbers are laid there as it comes, and the message is let go."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from edge_daemon.fleet.heard import Heard, Row
from edge_daemon.fleet.spans import Spans, StreamNumbers

WORDS = {
    name: pa.dictionary(pa.int32(), pa.string()) for name in ("gateway", "drive", "topic", "name", "status", "unit")
}
COLUMNS = pa.schema(
    [
        *((name, WORDS[name]) for name in ("gateway", "drive")),
        ("run", pa.int64()),
        ("topic", WORDS["topic"]),
        ("sequence", pa.int64()),
        ("time_s", pa.float64()),
        ("historical", pa.bool_()),
        ("name", WORDS["name"]),
        ("value", pa.float64()),
        ("sd", pa.float64()),
        ("status", WORDS["status"]),
        ("unit", WORDS["unit"]),
    ]
)
"""The columns in order; words are dictionaries in memory and plain strings to whoever reads the file."""
RowWords = tuple[tuple[str, ...], tuple[str | None, ...], tuple[str | None, ...]]
"""Names, statuses and units of a message's rows. Nearly all messages of a topic have the same, so a batch has few."""


class Batch:
    """Messages of one partition that wait to be written."""

    __slots__ = (
        *("_historical", "_run", "_sd", "_sequence", "_shape", "_shapes", "_stream", "_streams"),
        *("_time_s", "_value", "began_s"),
    )

    def __init__(self, began_s: float) -> None:
        self.began_s = began_s
        self._streams: dict[str, int] = {}
        """key of each stream (site/gateway/drive/topic) -> its place in the order of appearance"""
        self._shapes: dict[RowWords, int] = {}
        self._stream, self._shape, self._run, self._sequence = (array("q") for _ in range(4))
        self._time_s, self._historical = array("d"), array("b")
        self._value, self._sd = array("d"), array("d")
        """one a row; NaN where there is none, which no message can say"""

    @property
    def rows(self) -> int:
        """So many rows wait."""
        return len(self._value)

    def add(self, key: str, message: Heard, beside: list[Row]) -> None:
        """Take a message in. `key`: site/gateway/drive/topic."""
        told, streams, shapes, none = message.estimates.values(), self._streams, self._shapes, math.nan
        self._value.extend([none if row.value is None else row.value for row in told])
        self._sd.extend([none if row.sd is None else row.sd for row in told])
        shape = tuple(message.estimates), tuple([row.status for row in told]), tuple([row.unit for row in told])
        if beside:
            names, values, sds, statuses, units = zip(*beside, strict=True)
            self._value.extend(none if value is None else value for value in values)
            self._sd.extend(none if sd is None else sd for sd in sds)
            shape = shape[0] + names, shape[1] + statuses, shape[2] + units
        self._stream.append(streams.setdefault(key, len(streams)))
        self._shape.append(shapes.setdefault(shape, len(shapes)))
        self._run.append(message.run)
        self._sequence.append(message.sequence)
        self._time_s.append(none if message.time_s is None else message.time_s)
        self._historical.append(message.historical)

    def numbers(self) -> StreamNumbers:
        """Which messages are in it."""
        columns = self._stream, self._run, self._sequence, self._time_s
        stream, run, sequence, time_s = (np.array(column) for column in columns)
        order = np.lexsort((sequence, run, stream))
        stream, run, sequence, time_s = stream[order], run[order], sequence[order], time_s[order]
        joint = (np.diff(stream) == 0) & (np.diff(run) == 0) & (np.diff(sequence) == 1)
        first = np.flatnonzero(np.concatenate(([True], ~joint)))
        last = np.concatenate((first[1:], [len(order)])) - 1
        keys = list(self._streams)
        found: StreamNumbers = {}
        for a, b in zip(first.tolist(), last.tolist(), strict=True):
            spans = found.setdefault(keys[stream[a]], {}).setdefault(int(run[a]), Spans())
            spans.join(int(sequence[a]), int(sequence[b]), float(time_s[a]), float(time_s[b]))
        return found

    def table(self) -> pa.Table:
        """All rows in the dataset's columns, sorted so that like stands beside like: it takes half the space."""
        shape, sizes = np.array(self._shape), np.array([len(names) for names, _, _ in self._shapes])
        count = sizes[shape]
        message = np.repeat(np.arange(len(shape)), count)
        begins = np.cumsum(sizes) - sizes  # of each shape's rows in a list of them all
        within = np.arange(len(message)) - np.repeat(np.cumsum(count) - count, count)
        named, stated, measured = (
            _coded(words, begins[shape][message] + within) for words in zip(*self._shapes, strict=True)
        )
        stream, run, sequence = (np.array(column)[message] for column in (self._stream, self._run, self._sequence))
        order = np.lexsort((sequence, run, named[0], stream))
        of_message = message[order]
        words = list(zip(*(key.split("/") for key in self._streams), strict=True))
        parts = {name: _words(stream[order], words[at]) for at, name in ((1, "gateway"), (2, "drive"), (3, "topic"))}
        parts |= {"name": _words(named[0][order], named[1]), "status": _words(stated[0][order], stated[1])}
        parts["unit"] = _words(measured[0][order], measured[1])
        parts |= {"run": pa.array(run[order]), "sequence": pa.array(sequence[order])}
        parts["historical"] = pa.array(np.array(self._historical, dtype=bool)[of_message])
        numbers = (np.array(self._time_s)[of_message], np.array(self._value)[order], np.array(self._sd)[order])
        for name, column in zip(("time_s", "value", "sd"), numbers, strict=True):
            parts[name] = pa.array(column, mask=np.isnan(column))
        return pa.Table.from_pydict(parts).select(COLUMNS.names).cast(COLUMNS)


def _coded(
    shapes: Sequence[tuple[str | None, ...]], place: NDArray[np.int64]
) -> tuple[NDArray[np.int32], Sequence[str]]:
    """The word at each place of all shapes' words, as its number in a list of words, -1 for none; and that list."""
    known: dict[str, int] = {}
    codes = [-1 if word is None else known.setdefault(word, len(known)) for words in shapes for word in words]
    return np.array(codes, dtype=np.int32)[place], list(known)


def _words(code: NDArray[np.int32], words: Sequence[str]) -> pa.DictionaryArray:
    """A column of words by their number in a list."""
    return pa.DictionaryArray.from_arrays(pa.array(code, mask=code < 0), pa.array(words, pa.string()))
