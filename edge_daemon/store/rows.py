"""What waits to be written: blocks packed into chunks, snapshots thinned to one a second, events, learned state.

Bounded: while nothing can be written the oldest goes first, and is counted.
"""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import msgspec

from edge_daemon.records import Block, Estimate, Event, Snapshot, Status

SNAPSHOT_EVERY_S = 0.95
"""One snapshot a second is kept, with room for jitter, and every one that changes the state."""
MOST_SNAPSHOTS = 3600
MOST_EVENTS = 10_000
MOST_MESSAGES = 20_000
"""So many published messages wait to be written: as many as an hour of snapshots makes of three drives."""
CHUNK_BLOCKS = 100
"""One row holds at most so many blocks, ten seconds of the usual ones: so much a row that is damaged costs."""
SNAPSHOT_LEVEL = 6
"""Level of zlib: a snapshot has a kilobyte and comes once a second."""
STATUSES = tuple(Status)
DAMAGE = (msgspec.DecodeError, zlib.error, struct.error, ValueError, IndexError)
"""What the codecs raise on bytes that are not as they were written."""
_ESTIMATE = struct.Struct("<dddB")


@dataclass(frozen=True, slots=True)
class ChunkRow:
    """Packed blocks of one drive."""

    drive: str
    start_s: float
    end_s: float
    blocks: int
    data: bytes


@dataclass(frozen=True, slots=True)
class SentRow:
    """One published message, to be found by its number."""

    drive: str
    run: int
    topic: str
    sequence: int
    payload: bytes
    """the JSON as it is repeated"""


@dataclass(slots=True)
class Waiting:
    """Rows not yet on disk, oldest first."""

    most_bytes: int
    chunks: deque[ChunkRow] = field(default_factory=deque)
    chunk_bytes: int = 0
    snapshots: deque[Snapshot] = field(default_factory=deque)
    events: deque[Event] = field(default_factory=deque)
    messages: deque[SentRow] = field(default_factory=deque)
    states: dict[str, bytes] = field(default_factory=dict)
    dropped_blocks: int = 0
    dropped_snapshots: int = 0
    dropped_events: int = 0
    dropped_messages: int = 0

    def __bool__(self) -> bool:
        return bool(self.chunks or self.snapshots or self.events or self.messages or self.states)

    def add_chunks(self, rows: Iterable[ChunkRow]) -> None:
        """Append, dropping the oldest above the bound."""
        for row in rows:
            self.chunks.append(row)
            self.chunk_bytes += len(row.data)
        while self.chunk_bytes > self.most_bytes:
            lost = self.chunks.popleft()
            self.chunk_bytes -= len(lost.data)
            self.dropped_blocks += lost.blocks

    def add_snapshots(self, rows: Iterable[Snapshot]) -> None:
        """Append, dropping the oldest above the bound."""
        self.snapshots.extend(rows)
        while len(self.snapshots) > MOST_SNAPSHOTS:
            self.snapshots.popleft()
            self.dropped_snapshots += 1

    def add_events(self, rows: Iterable[Event]) -> None:
        """Append, dropping the oldest above the bound."""
        self.events.extend(rows)
        while len(self.events) > MOST_EVENTS:
            self.events.popleft()
            self.dropped_events += 1

    def add_messages(self, rows: Iterable[SentRow]) -> None:
        """Append, dropping the oldest above the bound."""
        self.messages.extend(rows)
        while len(self.messages) > MOST_MESSAGES:
            self.messages.popleft()
            self.dropped_messages += 1


def names_of(snapshot: Snapshot) -> bytes:
    """The names and units of a snapshot's estimates, in the order of `pack_estimates`."""
    return msgspec.json.encode([[row.name, row.unit] for row in snapshot.estimates.values()])


def pack_estimates(snapshot: Snapshot) -> bytes:
    """Value, sd, time and status of each estimate, exactly; like bytes beside each other, so that they compress."""
    plain = b"".join(
        _ESTIMATE.pack(row.value, row.sd, row.time_s, STATUSES.index(row.status)) for row in snapshot.estimates.values()
    )
    size = _ESTIMATE.size
    packed = zlib.compress(b"".join(plain[i::size] for i in range(size)), SNAPSHOT_LEVEL)
    return packed if len(packed) < len(plain) else plain


def unpack_estimates(names: bytes, data: bytes) -> dict[str, Estimate]:
    """Raises what is in `DAMAGE`. What is as long as its estimates is not compressed, as no store of before is."""
    known: Sequence[tuple[str, str]] = msgspec.json.decode(names, type=list[tuple[str, str]])
    if len(data) != _ESTIMATE.size * len(known):
        like = zlib.decompress(data)
        data = b"".join(like[i :: len(known)] for i in range(len(known)))
    return {
        name: Estimate(name, value, sd, unit, STATUSES[status], time_s)
        for (name, unit), (value, sd, time_s, status) in zip(known, _ESTIMATE.iter_unpack(data), strict=True)
    }


def in_runs(blocks: Iterable[Block]) -> Iterable[list[Block]]:
    """Blocks by drive, each run short enough, seamless and alike enough for one chunk."""
    runs: dict[str, list[Block]] = {}
    for block in blocks:
        run = runs.get(block.drive)
        if run and not (len(run) < CHUNK_BLOCKS and block.continues(run[-1])):
            yield run
            run = None
        if run is None:
            run = runs[block.drive] = []
        run.append(block)
    yield from runs.values()
