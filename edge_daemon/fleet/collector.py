"""Hears the whole fleet and writes what each message says once, whatever is repeated, killed or run twice.

Zenoh keeps what arrives in a queue. One thread takes messages from there, knows by their numbers what is new, and
gathers rows by partition; another writes. What does not fit is not taken: its number stays missing, and is asked for.
"""

from __future__ import annotations

import gc
import logging
import math
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from edge_daemon.errors import BadInput
from edge_daemon.fleet.batch import Batch
from edge_daemon.fleet.dataset import MOST_SMALL, Dataset, Partition, date_of
from edge_daemon.fleet.heard import Unheard, heard, rows_beside
from edge_daemon.fleet.link import CLOSE_S, PREFIX, FleetLink
from edge_daemon.fleet.recovery import Recovery
from edge_daemon.fleet.shares import Shares, share_of
from edge_daemon.fleet.spans import Spans, StreamNumbers, joined

log = logging.getLogger(__name__)

QUEUE = 50_000
"""So many messages wait to be looked at, 30 MB: a burst of 1 000 drives. Beyond it the router holds its senders up, who
keep what they cannot send."""
MOST_ROWS = 2_000_000
"""So many rows wait to be written at most, 300 MB: what comes while the disk does not take them is asked for later."""
LARGE_ROWS = 250_000
"""A partition with so many rows is written at once: 0.2 s of work."""
SOONEST_S, LATEST_S = 2.0, 15.0
"""A message is in the dataset after so long: soon where somebody has just begun and looks, later for larger files."""
SLOWER = 0.02
"""Files are written the more rarely the longer this runs, by this share of its time so far."""
QUIET_S = 600.0
"""A day's files into which nothing came for so long are merged, however few they are."""
MERGE_WITHIN_S = 5.0
"""Small files are merged for no longer when the collector stops."""
AGAIN_S = 5.0
"""After the disk has refused, it is tried again so much later."""
MOST_STREAMS = 1_000_000
"""Somebody who makes up keys fills no memory beyond so many: a hundred thousand drives."""
STANDBY_S, STANDBY_BYTES = 30.0, 32 * 2**20
"""So much of the drives that another collector writes is kept, in case that one dies with what it has not written."""
AT_ONCE = 2000
"""So many messages are taken from the inbox at a time: 20 ms of work, between which others may look at the numbers."""
TURN_S = 0.05
"""The worker looks at the inbox so often while nothing comes."""
GARBAGE_AFTER = 500_000
"""Python looks for circular garbage after so many new objects: at its usual 700 that takes a third of the time."""
SHARES_EVERY_S = 1.0
"""Who else writes to the folder is looked at so often."""


@dataclass(frozen=True, slots=True)
class Route:
    """What a key says."""

    words: tuple[str, str, str, str]
    """site, gateway, drive, topic"""
    stream: str
    drive: str
    share: int


def route_of(key: str) -> Route | None:
    """None for a key that is no message's."""
    words = key.removeprefix(f"{PREFIX}/").split("/")
    if len(words) != 4 or not key.startswith(PREFIX) or words[3] == "history":
        return None
    drive = "/".join(words[:3])
    return Route((words[0], words[1], words[2], words[3]), "/".join(words), drive, share_of(drive))


class Collector:
    """One collector on one folder. `run` until `stop`."""

    def __init__(self, endpoints: Sequence[str], folder: Path, file: Path | None = None) -> None:
        """Raises `BadInput` for an endpoint or a folder that is of no use."""
        self._shares = Shares(folder)
        self._dataset = Dataset(folder, self._shares.seat)
        self._inbox: deque[tuple[str, bytes]] = deque()
        self._standby: deque[tuple[float, int, str, bytes]] = deque()
        self._standby_bytes = 0
        self._counting = threading.Lock()
        self._routes: dict[str, Route | None] = {}
        self._topics: dict[str, set[str]] = {}
        self._leaving: set[int] = set()
        self._written_rows = 0
        self._began_s = time.monotonic()
        self._appended_s: dict[Partition, float] = {}
        self._numbers: StreamNumbers = {}
        self._batches: dict[Partition, Batch] = {}
        self._writing: deque[tuple[Partition, Batch]] = deque()
        self._wake = threading.Condition()
        self._ended = threading.Event()
        self._refused = ""
        self._stopping = threading.Event()
        self.counts: Counter[str] = Counter(repeats=0, refused=0, dropped=0, files=0)
        self._messages = self._rows = 0
        self._link = FleetLink(endpoints, None, self._token, file, QUEUE)
        self._recovery = Recovery(self._link, self._numbers_of, self._hear)
        self._writer = threading.Thread(target=self._write_all, name="writer", daemon=True)

    def stop(self) -> None:
        """Ask `run` to end; what was heard is written first."""
        self._stopping.set()

    def run(self) -> None:
        """Collect until `stop` was called."""
        self._writer.start()
        gc.set_threshold(GARBAGE_AFTER)  # columns of plain numbers are not worth being searched for circles
        shares_s = float("-inf")
        while not self._stopping.is_set():
            now_s = time.monotonic()
            if now_s - shares_s >= SHARES_EVERY_S:
                self._share_out()
                shares_s = now_s
            busy = self._take_in()
            self._hand_over()
            self._recovery.turn(lambda drive: share_of(drive) in self._shares.held)
            if not busy:
                self._stopping.wait(TURN_S)
        self._close()

    @property
    def waiting_rows(self) -> int:
        """Rows heard and not yet written."""
        return self._rows - self._written_rows

    def figures(self) -> dict[str, int]:
        """What was done so far; `lost` messages no gateway has any more."""
        return {"messages": self._messages, "rows": self._rows, **self.counts, "lost": self._recovery.lost()}

    # --- in Zenoh's and the recovery's threads ------------------------------------------------------------------------

    def _hear(self, key: str, payload: bytes) -> None:
        """A message that was repeated, or kept in standby."""
        if len(self._inbox) > QUEUE:
            self.counts["dropped"] += 1
        else:
            self._inbox.append((key, payload))

    def _token(self, key: str, there: bool) -> None:
        drive = key.removeprefix(f"{PREFIX}/")
        if there:
            self._recovery.look(drive)
        else:
            self._recovery.gone(drive)

    def _numbers_of(self, drive: str) -> Mapping[str, Mapping[int, Spans]]:
        """A copy of what is there of a drive, by topic and run."""
        with self._counting:
            streams = {topic: self._numbers.get(f"{drive}/{topic}", {}) for topic in self._topics.get(drive, ())}
            return {topic: {run: Spans(spans) for run, spans in runs.items()} for topic, runs in streams.items()}

    # --- the worker ---------------------------------------------------------------------------------------------------

    def _take_in(self) -> bool:
        """Move what has arrived into batches; whether there was anything."""
        arrived = self._link.heard(AT_ONCE)
        while self._inbox and len(arrived) < 2 * AT_ONCE:
            arrived.append(self._inbox.popleft())
        held, room = self._shares.held - self._leaving, self.waiting_rows < MOST_ROWS
        with self._counting:
            for key, payload in arrived:
                route = self._route(key)
                if route is None:
                    self.counts["refused"] += 1
                elif route.share not in held:
                    self._keep_standby(route.share, key, payload)
                elif room:
                    self._accept(route, payload)
                else:
                    self.counts["dropped"] += 1
        return bool(arrived)

    def _route(self, key: str) -> Route | None:
        if key in self._routes:
            return self._routes[key]
        route = route_of(key)
        if len(self._routes) < MOST_STREAMS:
            self._routes[key] = route
            return route
        return None

    def _accept(self, route: Route, payload: bytes) -> None:
        try:
            message = heard(payload)
            beside = rows_beside(route.words[3], message, payload)
        except Unheard as error:
            self.counts["refused"] += 1
            log.debug("%s: no message: %s", route.stream, error)
            return
        runs = self._numbers.get(route.stream)
        if runs is None:
            runs = self._begin(route)
        spans = runs.get(message.run)
        if spans is None:
            spans = runs[message.run] = Spans()
        new = spans.add(message.sequence, math.nan if message.time_s is None else message.time_s)
        if not new:
            self.counts["repeats"] += 1
            return
        if new > 1 and (message.sequence > 0 or len(runs) > 1):
            self._recovery.look(route.drive)  # a number was left out, or it has begun anew
        partition = (route.words[0], date_of(message.time_s))
        batch = self._batches.get(partition)
        if batch is None:
            batch = self._batches[partition] = Batch(time.monotonic())
        batch.add(route.stream, message, beside)
        self._messages += 1
        self._rows += len(message.estimates) + len(beside)

    def _begin(self, route: Route) -> dict[int, Spans]:
        """A stream that was not heard before."""
        self._topics.setdefault(route.drive, set()).add(route.words[3])
        return self._numbers.setdefault(route.stream, {})

    def _keep_standby(self, share: int, key: str, payload: bytes) -> None:
        now_s = time.monotonic()
        self._standby.append((now_s, share, key, payload))
        self._standby_bytes += len(payload)
        while self._standby and (self._standby_bytes > STANDBY_BYTES or self._standby[0][0] < now_s - STANDBY_S):
            self._standby_bytes -= len(self._standby.popleft()[3])

    # --- who writes what ----------------------------------------------------------------------------------------------

    def _share_out(self) -> None:
        """Give back what is others', take what is free and ours, and learn what is in the folder of it."""
        wanted = self._shares.wanted()
        self._give_back(self._shares.held - wanted)
        stays = self._leaving & wanted
        self._leaving -= stays
        taken = stays | {share for share in wanted - self._shares.held if self._shares.take(share)}
        if not taken:
            return
        with self._counting:
            self._learn(self._dataset.news())
        for path in self._dataset.set_aside:
            log.warning("%s: damaged: put aside; what was in it is asked for again", path)
        self._dataset.set_aside.clear()
        again = [row for row in self._standby if row[1] in taken]
        self._standby = deque(row for row in self._standby if row[1] not in taken)
        self._standby_bytes = sum(len(row[3]) for row in self._standby)
        for _, _, key, payload in again:
            self._hear(key, payload)
        with self._counting:
            drives = [drive for drive in self._topics if share_of(drive) in taken]
        for drive in drives:
            self._recovery.look(drive)

    def _give_back(self, surplus: set[int]) -> None:
        """Take in nothing more of these shares; they are others' once all is written."""
        if surplus - self._leaving:
            self._leaving |= surplus
            self._hand_over(everything=True)
        with self._wake:
            done = not self._writing
        if done:
            for share in self._leaving & surplus:
                self._shares.give_back(share)
                self._leaving.discard(share)

    def _learn(self, found: StreamNumbers) -> None:
        joined(self._numbers, found)
        for stream in found:
            drive, _, topic = stream.rpartition("/")
            self._topics.setdefault(drive, set()).add(topic)

    def _written(self) -> bool:
        """Have all that was heard written; whether the disk took it."""
        self._hand_over(everything=True)
        with self._wake:
            self._wake.wait_for(lambda: not self._writing or bool(self._refused), LATEST_S)
            return not self._writing

    # --- to disk ------------------------------------------------------------------------------------------------------

    def _hand_over(self, everything: bool = False) -> None:
        """Pass the batches that are due to the writer."""
        now_s = time.monotonic()
        for partition in list(self._batches):
            batch = self._batches[partition]
            wait_s = min(max(SLOWER * (now_s - self._began_s), SOONEST_S), LATEST_S)
            if everything or batch.rows >= LARGE_ROWS or now_s - batch.began_s >= wait_s:
                del self._batches[partition]
                with self._wake:
                    self._writing.append((partition, batch))
                    self._wake.notify_all()

    def _write_all(self) -> None:
        """The writer's thread: until there is nothing left and `run` has ended."""
        while True:
            with self._wake:
                self._wake.wait_for(lambda: bool(self._writing) or self._ended.is_set(), LATEST_S)
                done, first = self._ended.is_set(), self._writing[0] if self._writing else None
            if first is None:
                self._merge(2 if done else MOST_SMALL)
                if done:
                    return
                continue
            partition, batch = first
            try:
                self._dataset.append(partition, batch)
            except OSError as error:
                self._refuse(str(error))
                if self._ended.wait(AGAIN_S):
                    return
                continue
            except Exception:  # what can never be written must not hold up the rest
                log.exception("%s/%s: %d rows cannot be written", *partition, batch.rows)
                self.counts["dropped"] += batch.rows
            with self._wake:
                self._writing.popleft()
                self._written_rows += batch.rows
                self.counts["files"] += 1
                self._refused = ""
                self._wake.notify_all()
            self._appended_s[partition] = time.monotonic()
            self._merge(MOST_SMALL)

    def _merge(self, most: int) -> None:
        """Put small files together where they are too many, or where nothing comes any more."""
        until_s = time.monotonic() + MERGE_WITHIN_S
        quiet_s = time.monotonic() - QUIET_S
        quiet = {partition for partition, at_s in self._appended_s.items() if at_s < quiet_s}
        for partition in {*self._dataset.crowded(most), *(quiet & set(self._dataset.crowded(2)))}:
            try:
                if time.monotonic() < until_s:
                    self._dataset.merge(partition)
            except (OSError, pa.ArrowException) as error:
                log.warning("%s/%s: small files could not be merged: %s", *partition, error)
            self._appended_s.pop(partition, None)

    def _refuse(self, reason: str) -> None:
        if reason != self._refused:
            log.warning("nothing can be written now: %s", reason)
        with self._wake:
            self._refused = reason
            self._wake.notify_all()

    def _close(self) -> None:
        """Take in what has arrived, write it, and let go of the folder."""
        self._recovery.close()
        self._link.close(0.0)
        for _ in range(2 * QUEUE // AT_ONCE):  # what waits, not what keeps coming
            if not self._take_in():
                break
            self._hand_over()
        done = self._written()
        self._ended.set()
        with self._wake:
            self._wake.notify_all()
        self._writer.join(MERGE_WITHIN_S + CLOSE_S)
        self._dataset.close()
        self._shares.close()
        self._link.close()
        if not done:
            log.warning("%d rows could not be written: %s", self.waiting_rows, self._refused)


def collected(endpoints: Sequence[str], folder: Path, file: Path | None, seconds: float | None) -> dict[str, int]:
    """Collect until SIGTERM, SIGINT or for so long; what was done. Raises `BadInput`."""
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s", stream=sys.stderr)
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise BadInput(f"--seconds {seconds:g}: expected more than 0")
    collector = Collector(endpoints, folder, file)
    for which in (signal.SIGTERM, signal.SIGINT):
        signal.signal(which, lambda *_: collector.stop())
    if seconds is not None:
        timer = threading.Timer(seconds, collector.stop)
        timer.daemon = True
        timer.start()
    collector.run()
    return collector.figures()
