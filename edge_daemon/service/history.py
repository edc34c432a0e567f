"""What is kept on disk: the ring of blocks and estimates, the learned state of each drive, answers about the past."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from edge_daemon.config.settings import StoreSettings as Settings
from edge_daemon.publish.messages import Message
from edge_daemon.quantities import QUANTITIES, TOPICS, is_known
from edge_daemon.records import Block, Estimate, Event, LinkHealth, Snapshot
from edge_daemon.store.reader import StoreReader
from edge_daemon.store.ring import Store, StoreError
from edge_daemon.store.rows import SentRow
from edge_daemon.store.trend import trend
from edge_daemon.text import shorts

ASKED = ("names", "since_s", "until_s", "limit")
"""A question about the past may contain these."""
ASKED_BY_NUMBER = (*ASKED, "runs", "run", "topic", "first", "last")
"""A question about published messages may contain these; it is answered whatever span of time it names, as gateways
need it that know nothing else."""
MOST_MESSAGES = 200
"""One answer repeats no more messages: 200 kB, which the link sends between two looks at what is new."""
MOST_ROWS = 10_000
"""One answer about the past has no more rows; a longer span comes at a coarser grain."""
LAST_NUMBER = 2**63 - 1
"""The store's whole numbers end here."""
DIGITS = 7
"""A trend is told to so many digits: a ratio's sixth still moves on the screen."""


class History:
    """The daemon's one hand on the store. `add_*` and `save` only buffer; `commit` may block: run it in a thread."""

    def __init__(self, settings: Settings, base: Path) -> None:
        self.file = base / settings.file
        self._keep_blocks = settings.keep_blocks
        self.store = Store(settings, self.file)
        self._problem = ""

    def take_notes(self) -> tuple[str, ...]:
        """What had to be repaired or left out since the last call."""
        notes, self.store.notes = tuple(self.store.notes), []
        return notes

    def add_block(self, block: Block) -> None:
        """Buffer a block, if blocks are kept."""
        if self._keep_blocks:
            self.store.add_block(block)

    def add_snapshot(self, snapshot: Snapshot) -> None:
        """Buffer the state of a drive."""
        self.store.add_snapshot(snapshot)

    def add_event(self, event: Event) -> None:
        """Buffer an event."""
        self.store.add_event(event)

    def add_messages(self, messages: Iterable[Message]) -> None:
        """Buffer what was published, as it is to be repeated."""
        rows = (SentRow(m.drive, m.run, m.topic, m.sequence, m.payload(historical=True)) for m in messages)
        self.store.add_messages(rows)

    def save(self, drive: str, parts: Mapping[str, bytes]) -> None:
        """Buffer checkpoints; written with the next commit."""
        for part, blob in parts.items():
            self.store.save_state(f"{drive}/{part}", blob)

    def load(self, drive: str, parts: Iterable[str]) -> dict[str, bytes]:
        """The checkpoints that there are."""
        found = {part: self.store.load_state(f"{drive}/{part}") for part in parts}
        return {part: blob for part, blob in found.items() if blob is not None}

    def commit(self) -> str:
        """Write what is buffered; the standing problem, empty if none. What cannot be written stays buffered."""
        try:
            self.store.commit()
            self._problem = ""
        except StoreError as error:
            self._problem = str(error)
        return self._problem

    def close(self) -> None:
        """Write what is left and close; a full disk costs what is still buffered."""
        self.commit()
        self.store.close()

    def health(self) -> LinkHealth:
        """How the store is doing, with its size and losses."""
        return LinkHealth("store", "degraded" if self._problem else "ok", self._problem, self.store.counters())

    def answer(self, drive: str, parameters: Mapping[str, str]) -> list[dict[str, Any]] | dict[str, Any]:
        """What the fleet asked for: `sent` where it asks by number, else `history`. Raises ValueError as they do."""
        by_number = any(name in parameters for name in ("runs", "run"))
        return self.sent(drive, parameters) if by_number else self.history(drive, parameters)

    def sent(self, drive: str, parameters: Mapping[str, str]) -> dict[str, Any]:
        """What was published of a drive: `runs` lists the numbers that are there; `run` and `topic` with `first`,
        `last` (both ends) and `limit` give the messages themselves, oldest first, marked historical. Raises ValueError.
        """
        _refuse_unknown(parameters, ASKED_BY_NUMBER)
        with StoreReader(self.file) as reader:
            if "run" not in parameters:
                names = ("run", "topic", "first", "last")
                return {"rows": [], "runs": [dict(zip(names, row, strict=True)) for row in reader.sent_spans(drive)]}
            if parameters.get("topic") not in TOPICS:
                raise ValueError(f"topic: {parameters.get('topic')!r}: expected one of {', '.join(TOPICS)}")
            most = min(_whole(parameters, "limit", MOST_MESSAGES), MOST_MESSAGES)
            span = (_whole(parameters, "first", 0), _whole(parameters, "last", LAST_NUMBER))
            found = reader.sent(drive, _whole(parameters, "run", 0), parameters["topic"], span, most)
        return {"rows": [], "messages": [msgspec.Raw(payload) for payload in found]}

    def history(self, drive: str, parameters: Mapping[str, str]) -> list[dict[str, Any]]:
        """Rows of past estimates for the fleet. Raises ValueError for parameters that make no sense.

        `names`, `since_s`, `until_s` (seconds since the epoch; below 0 before the newest data) and `limit`; what begins
        with an underscore is Zenoh's own.
        """
        _refuse_unknown(parameters, ASKED)
        names = _known(parameters)
        since_s, until_s = _number(parameters, "since_s", 0.0), _number(parameters, "until_s", float("inf"))
        limit = _number(parameters, "limit", MOST_ROWS)
        if not limit >= 1:
            raise ValueError(f"limit: {parameters['limit']!r}: expected at least 1")
        with StoreReader(self.file) as reader:
            since_s, until_s = (at + reader.newest_s() if at < 0 else at for at in (since_s, until_s))
            if since_s > until_s:
                raise ValueError(f"until_s: {parameters['until_s']!r}: expected after since_s")
            most = int(min(limit, MOST_ROWS))
            rows = reader.estimates(drive, names, since_s, until_s, most)[-most:]
        return [_past(row) for row in rows]

    def trend(self, drive: str, parameters: Mapping[str, str]) -> dict[str, Any]:
        """Some quantities over a span as columns of a few hundred points. Raises ValueError for bad parameters."""
        names = _known(parameters)
        since_s, until_s = _number(parameters, "since_s", math.nan), _number(parameters, "until_s", math.nan)
        points = _number(parameters, "points", 300.0)
        with StoreReader(self.file) as reader:
            found = trend(reader, drive, names, since_s, until_s, int(points) if math.isfinite(points) else 0)
        columns = {"value": found.value, "sd": found.sd}
        seen = {part: {name: shorts(row, DIGITS) for name, row in rows.items()} for part, rows in columns.items()}
        return {"time_s": [round(t, 1) for t in found.time_s.tolist()], **seen}

    def newest_s(self) -> float:
        """Time of the newest stored data; NaN in an empty store."""
        with StoreReader(self.file) as reader:
            return reader.newest_s()

    def events(self, limit: int) -> list[Event]:
        """The newest stored events, oldest first."""
        with StoreReader(self.file) as reader:
            return reader.events(limit=limit)


def _refuse_unknown(parameters: Mapping[str, str], known: tuple[str, ...]) -> None:
    unknown = [name for name in parameters if name not in known and not name.startswith("_")]
    if unknown:
        raise ValueError(f"{unknown[0]}: unknown parameter: expected some of {', '.join(known)}")


def _whole(parameters: Mapping[str, str], name: str, otherwise: int) -> int:
    """A whole number from 0 on."""
    text = parameters.get(name, str(otherwise))
    if not text.isdecimal() or int(text) > LAST_NUMBER:
        raise ValueError(f"{name}: {text!r}: expected a whole number")
    return int(text)


def _past(row: Estimate) -> dict[str, Any]:
    """One row of the past: as in the messages of its time, a number only where it was usable."""
    value, sd = (row.value, row.sd) if row.usable else (None, None)
    return {"name": row.name, "time_s": row.time_s, "value": value, "sd": sd, "status": row.status.value}


def _known(parameters: Mapping[str, str]) -> list[str]:
    names = [name for name in parameters.get("names", "").split(",") if name] or list(QUANTITIES)
    unknown = [name for name in names if not is_known(name)]
    if unknown:
        raise ValueError(f"names: {unknown[0]!r} is not estimated: expected some of {', '.join(QUANTITIES)}")
    return names


def _number(parameters: Mapping[str, str], name: str, otherwise: float) -> float:
    if name not in parameters and math.isnan(otherwise):
        raise ValueError(f"{name}: missing: expected a number")
    try:
        value = float(parameters.get(name, otherwise))
    except ValueError as error:
        raise ValueError(f"{name}: {parameters[name]!r} is not a number") from error
    if math.isnan(value):
        raise ValueError(f"{name}: {parameters[name]!r} is not a number")
    return value
