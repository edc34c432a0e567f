"""What goes to the fleet: documents per topic, numbered, as JSON with a schema name and version."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from edge_daemon.quantities import QUANTITIES, TOPICS, of_topic
from edge_daemon.records import NE107, Estimate, Event, Snapshot

PREFIX = "strainwave/v1"
SCHEMA_VERSION = 1
GATEWAY = "_gateway"
"""This stands where the drive's name stands, for events of the gateway itself; no drive can have this name."""
STATE_TOPIC = "health"
CREDIT_S = 60.0
"""A drive may be this far ahead of its share of bytes: who has just come to look sees it move once a second, for the
half minute that the credit lasts, and every hour's average is kept all the same (guess)."""
ENVELOPE_BYTES = 100
"""Key and frame take so many bytes on the way beside the payload (measured on loopback: 80 to 95)."""

Document = Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """One document on its way, numbered when it was made, so that a reader sees what was lost."""

    drive: str
    topic: str
    sequence: int
    run: int
    time_s: float
    """when what it says was true; NaN becomes null"""
    document: Document

    def payload(self, *, historical: bool) -> bytes:
        """JSON in UTF-8; numbers that are not finite become null."""
        return msgspec.json.encode(
            {
                "schema": f"strainwave/{self.topic}",
                "version": SCHEMA_VERSION,
                "drive": self.drive,
                "run": self.run,
                "sequence": self.sequence,
                "time_s": self.time_s,
                "historical": historical,
                **self.document,
            }
        )


class Composer:
    """Turns records into messages and numbers them per drive and topic.

    `run` distinguishes the numbering of one start of the daemon from the next. `monotonic` paces: a topic is due
    `every_s` after it was last made, and not before what the drive sent has been paid off at `most_bytes_per_s`; or at
    once when the drive's state changes.
    """

    def __init__(
        self,
        run: int,
        every_s: float,
        monotonic: Callable[[], float] = time.monotonic,
        most_bytes_per_s: float = float("inf"),
    ) -> None:
        self._run = run
        self._every_s = every_s
        self._most_bytes_per_s = most_bytes_per_s
        self._paid_s: dict[str, float] = {}
        self._monotonic = monotonic
        self._sequence: Counter[tuple[str, str]] = Counter()
        self._made_s: dict[str, float] = {}
        self._state: dict[str, tuple[NE107, tuple[str, ...]]] = {}

    def of_snapshot(self, snapshot: Snapshot) -> list[Message]:
        """One message per topic if they are due, the state alone if only that changed, else none."""
        now_s = self._monotonic()
        state = (snapshot.state, snapshot.reasons)
        changed = self._state.get(snapshot.drive) != state
        self._state[snapshot.drive] = state
        due = now_s - self._made_s.get(snapshot.drive, float("-inf")) >= self._every_s
        due = due and now_s >= self._paid_s.get(snapshot.drive, float("-inf"))
        if due:
            self._made_s[snapshot.drive] = now_s
        made = [
            self._message(snapshot.drive, topic, snapshot.time_s, document)
            for topic, document in _documents(snapshot)
            if due or (changed and topic == STATE_TOPIC)
        ]
        self.charge(made)
        return made

    def charge(self, messages: Sequence[Message]) -> None:
        """What these take is paid off before their drives' next regular messages."""
        for message in messages if self._every_s > 0 else ():
            since_s = max(self._paid_s.get(message.drive, float("-inf")), self._monotonic() - CREDIT_S)
            size = len(message.payload(historical=False)) + ENVELOPE_BYTES
            self._paid_s[message.drive] = since_s + size / self._most_bytes_per_s

    def of_event(self, event: Event) -> Message:
        """The message of one event."""
        document = {"severity": event.severity.name.lower(), "source": event.source, "message": event.message}
        made = self._message(event.drive or GATEWAY, "event", event.time_s, document)
        self.charge([made])
        return made

    def of_meta(self, drive: str, time_s: float, document: Document) -> Message:
        """The message that introduces a drive."""
        made = self._message(drive, "meta", time_s, document)
        self.charge([made])
        return made

    def _message(self, drive: str, topic: str, time_s: float, document: Document) -> Message:
        sequence = self._sequence[drive, topic]
        self._sequence[drive, topic] += 1
        return Message(drive, topic, sequence, self._run, time_s, document)


def _documents(snapshot: Snapshot) -> Iterator[tuple[str, Document]]:
    for topic in TOPICS:
        rows = of_topic(topic)
        if not rows:
            continue
        found = {row.name: _estimate(snapshot.estimates.get(row.name), row.unit) for row in rows}
        document: dict[str, Any] = {"estimates": found, **snapshot.details.get(topic, {})}
        if topic == STATE_TOPIC:
            document |= {
                "state": snapshot.state.name.lower(),
                "ne107": int(snapshot.state),
                "reasons": list(snapshot.reasons),
            }
        yield topic, document


def _estimate(row: Estimate | None, unit: str) -> Document:
    """Value and sd are null unless usable: a reader cannot take a number for good that is not."""
    if row is None:
        return {"value": None, "sd": None, "unit": unit, "status": "unknown", "time_s": None}
    value, sd = (row.value, row.sd) if row.usable else (None, None)
    return {"value": value, "sd": sd, "unit": row.unit, "status": row.status.value, "time_s": row.time_s}


def birth(*, gear: str | None, model: Document, versions: Mapping[str, str]) -> dict[str, Any]:
    """The document that introduces a drive: what it is, and what each number it sends means."""
    return {
        "gear": gear,
        "model": model,
        "versions": dict(versions),
        "topics": list(TOPICS),
        "quantities": [
            {"name": row.name, "unit": row.unit, "topic": row.topic, "meaning": row.meaning}
            for row in QUANTITIES.values()
        ],
    }


def reply(key_drive: str, found: list[dict[str, Any]] | Document) -> bytes:
    """The answer to a `history` query: rows, or another document's parts such as `messages` and `runs`."""
    return msgspec.json.encode(
        {
            "schema": "strainwave/history",
            "version": SCHEMA_VERSION,
            "drive": key_drive,
            "historical": True,
            **(found if isinstance(found, Mapping) else {"rows": found}),
        }
    )
