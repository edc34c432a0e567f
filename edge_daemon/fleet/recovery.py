"""Asks gateways for what is missing, a little at a time.

A gateway of this version lists the numbers that its ring holds (`history?runs=1`) and repeats those asked for. One that
only answers by time, as before, is asked for the span between the neighbours of a hole: its rows are told apart by
their order, and get the missing numbers where they are as many.
"""

from __future__ import annotations

import itertools
import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import msgspec

from edge_daemon.fleet.link import PREFIX, FleetLink
from edge_daemon.fleet.spans import NumberSpan, Spans
from edge_daemon.quantities import QUANTITIES, of_topic

log = logging.getLogger(__name__)

AT_ONCE = 8
"""So many gateways are asked at a time."""
PAGE = 200
"""One answer repeats so many messages at most."""
BYTES_PER_S = 1_500_000.0
"""A gateway repeats no more than this, an eighth of 100 Mbit/s: an hour of one drive takes five seconds."""
ANSWER_S = 5.0
"""A gateway that says nothing for so long is asked again later."""
SETTLE_S = 2.0
"""What is missing may still be on its way: a gateway that comes back repeats by itself what it kept."""
AGAIN_S, LONGEST_S = 5.0, 300.0
"""A gateway is asked again after so long while something is missing, ever more rarely where that brings nothing."""
WHAT_IS_THERE = "names=stiffness;since_s=-1;limit=1;runs=1"
"""A gateway that does not know `runs` refuses this, or answers with a single row."""
BUSY = ("again later", "cannot be read")
"""A gateway that has too many questions, or whose store cannot be read now, says so in these words."""
SNAPSHOTS = 500
"""A question by time spans so many messages, so that the answer is not thinned."""
SPARE = 1.5
"""Without a neighbour before it, a hole may be so much longer than the messages after it tell (guess)."""

NumbersOf = Callable[[str], Mapping[str, Mapping[int, Spans]]]
"""Drive key -> topic -> run -> what is there."""


@dataclass(slots=True)
class Asked:
    """What is known of one drive's gateway."""

    due_s: float
    wait_s: float = AGAIN_S
    by_number: bool | None = None
    """None until it has answered"""
    lost: dict[tuple[str, int], Spans] = field(default_factory=dict)
    """numbers that the gateway no longer has"""
    busy: bool = False
    alive: bool = True


class Recovery:
    """`look` may be called from any thread. `feed(key, payload)` gets each message that was repeated."""

    def __init__(self, link: FleetLink, numbers: NumbersOf, feed: Callable[[str, bytes], None]) -> None:
        self._link, self._numbers, self._feed = link, numbers, feed
        self._drives: dict[str, Asked] = {}
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="recovery")
        self._busy: set[str] = set()
        self.repeated = 0

    def look(self, drive: str, within_s: float = SETTLE_S) -> None:
        """Something may be missing of this drive: ask its gateway soon."""
        due_s = time.monotonic() + within_s
        with self._lock:
            known = self._drives.get(drive)
            if known is None:
                self._drives[drive] = Asked(due_s)
            else:
                known.due_s, known.wait_s, known.alive = min(known.due_s, due_s), AGAIN_S, True
                known.by_number = known.by_number or None  # it may be of a later version by now

    def gone(self, drive: str) -> None:
        """Its token was taken away: nobody answers until it is back."""
        with self._lock:
            if drive in self._drives:
                self._drives[drive].alive = False

    def turn(self, mine: Callable[[str], bool]) -> None:
        """Begin what is due, one drive of each gateway at a time; `mine` tells this collector's own."""
        now_s = time.monotonic()
        with self._lock:
            for drive, asked in self._drives.items():
                gateway = drive.rpartition("/")[0]
                if len(self._busy) >= AT_ONCE:
                    return
                if asked.due_s > now_s or not asked.alive or gateway in self._busy or not mine(drive):
                    continue
                self._busy.add(gateway)
                asked.due_s = math.inf
                self._pool.submit(self._ask, drive, asked)

    @property
    def busy(self) -> bool:
        """Whether somebody is being asked now."""
        return bool(self._busy)

    def lost(self) -> int:
        """Messages that no gateway has any more."""
        with self._lock:
            return sum(len(spans) for asked in self._drives.values() for spans in asked.lost.values())

    def close(self) -> None:
        """Ask nothing more."""
        self._stop.set()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _ask(self, drive: str, asked: Asked) -> None:
        try:
            done = self._asked(drive, asked)
        except Exception:
            log.exception("%s: history", drive)
            done = False
        with self._lock:
            self._busy.discard(drive.rpartition("/")[0])
            if done:
                asked.wait_s = AGAIN_S
            else:
                asked.due_s = min(asked.due_s, time.monotonic() + asked.wait_s)
                asked.wait_s = min(2.0 * asked.wait_s, LONGEST_S)

    def _asked(self, drive: str, asked: Asked) -> bool:
        """Whether nothing is missing that could still come."""
        if asked.by_number is not False:
            found = self._document(drive, WHAT_IS_THERE)
            if found is None:
                return False
            if _is_busy(found):
                return False
            asked.by_number = isinstance(found.get("runs"), list)
            if asked.by_number:
                return self._by_number(drive, asked, found["runs"])
        return self._by_time(drive, asked)

    def _document(self, drive: str, question: str) -> dict[str, Any] | None:
        """The answer to a question about the past; why it was `refused`, or None where nobody answered."""
        found: dict[str, Any] | None = None
        size = 0
        for _, payload, refusal in self._link.get(f"{PREFIX}/{drive}/history?{question}", ANSWER_S):
            try:
                answer = msgspec.json.decode(payload) if payload is not None else {"refused": refusal}
            except (ValueError, RecursionError):
                answer = {"refused": "no JSON"}
            size += len(payload or b"")
            found = (answer if isinstance(answer, dict) else {}) or found or {}
        self._stop.wait(size / BYTES_PER_S)
        return found

    # --- by number --------------------------------------------------------------------------------------------------

    def _by_number(self, drive: str, asked: Asked, runs: list[Any]) -> bool:
        listed = [row for row in runs if isinstance(row, dict) and _is_run(row)]
        done = True
        for row in listed:
            topic, run = row["topic"], row["run"]
            self._give_up(drive, asked, (topic, run), 0, row["first"] - 1)
            for first, last in self._missing(drive, asked, topic, run, row["first"], row["last"]):
                if not self._repeat(drive, asked, (topic, run), first, last):
                    done = False
        held = {(row["topic"], row["run"]): row["last"] for row in listed}
        return done and not any(
            last > held.get((topic, run), -1) for topic, run, (_, last, _, _) in self._holes(drive, asked)
        )

    def _missing(self, drive: str, asked: Asked, topic: str, run: int, first: int, last: int) -> list[tuple[int, int]]:
        there = self._numbers(drive).get(topic, {}).get(run, Spans())
        lost = asked.lost.get((topic, run), Spans())
        return [part for stretch in there.missing(first, last) for part in lost.missing(*stretch)]

    def _repeat(self, drive: str, asked: Asked, stream: tuple[str, int], first: int, last: int) -> bool:
        """Have [first, last] repeated; what is not there any more is lost. Whether the gateway answered throughout."""
        topic, run = stream
        while first <= last and not self._stop.is_set():
            found = self._document(drive, f"run={run};topic={topic};first={first};last={last};limit={PAGE}")
            if found is None or not isinstance(found.get("messages"), list):
                return False  # a store that cannot be read now has lost nothing yet
            numbers = sorted(n for n in self._fed(drive, topic, found["messages"]) if first <= n <= last)
            upto = numbers[-1] if numbers else last
            if not numbers or len(numbers) < PAGE:
                upto = last
            self._give_up(drive, asked, stream, first, upto, Spans((n, n, math.nan, math.nan) for n in numbers))
            first = upto + 1
        return first > last

    def _give_up(
        self, drive: str, asked: Asked, stream: tuple[str, int], first: int, last: int, got: Spans | None = None
    ) -> None:
        """What is missing of [first, last] is lost, for the gateway has only `got` of it."""
        topic, run = stream
        there = self._numbers(drive).get(topic, {}).get(run, Spans())
        for begin, end in there.missing(first, last):
            for part in (got or Spans()).missing(begin, end):
                with self._lock:
                    asked.lost.setdefault(stream, Spans()).join(*part, math.nan, math.nan)

    def _fed(self, drive: str, topic: str, messages: Any) -> Iterator[int]:
        for message in messages if isinstance(messages, list) else []:
            number = message.get("sequence") if isinstance(message, dict) else None
            if isinstance(number, int):
                self.repeated += 1
                self._feed(f"{PREFIX}/{drive}/{topic}", msgspec.json.encode({**message, "historical": True}))
                yield number

    # --- by time ----------------------------------------------------------------------------------------------------

    def _holes(self, drive: str, asked: Asked) -> Iterator[tuple[str, int, NumberSpan]]:
        """Topic, run and hole, between what is there and not lost."""
        for topic, runs in self._numbers(drive).items():
            for run, spans in runs.items():
                lost = asked.lost.get((topic, run), Spans())
                for first, last, before_s, after_s in spans.holes():
                    if lost.missing(first, last):
                        yield topic, run, (first, last, before_s, after_s)

    def _by_time(self, drive: str, asked: Asked) -> bool:
        for key, payload, _ in self._link.get(f"{PREFIX}/{drive}/*", ANSWER_S):
            if payload is not None and not key.endswith("/history"):
                self._feed(key, payload)  # the latest of each topic: what was missed last
        holes = [(topic, run, hole) for topic, run, hole in self._holes(drive, asked) if of_topic(topic)]
        for topic, run, (first, last, before_s, after_s) in holes:
            if math.isnan(after_s):
                continue
            if math.isnan(before_s):
                before_s = after_s - (last - first + 2) * SPARE * self._step_s(drive, topic, run)
                if not before_s < after_s:
                    continue  # one message alone does not tell how often they come
            self._recall(drive, (topic, run), (first, last, before_s, after_s))
        return not holes

    def _step_s(self, drive: str, topic: str, run: int) -> float:
        """Time between two messages, from the first ones that are there; NaN where there is only one."""
        for first, last, first_s, last_s in self._numbers(drive).get(topic, {}).get(run, Spans()):
            return (last_s - first_s) / (last - first) if last > first else math.nan
        return math.nan

    def _recall(self, drive: str, stream: tuple[str, int], hole: NumberSpan) -> None:
        """Have the rows between the neighbours of a hole repeated, and give them its numbers."""
        topic, run = stream
        first, last, before_s, after_s = hole
        names = [row.name for row in of_topic(topic)]
        parts = max(math.ceil((last - first + 1) / SNAPSHOTS), 1)
        edges = [before_s + (after_s - before_s) * i / parts for i in range(parts + 1)]
        edges[0] = math.nextafter(before_s, math.inf)
        rows: list[dict[str, Any]] = []
        for since_s, until_s in itertools.pairwise(edges):
            if self._stop.is_set():
                return
            limit = 10 * SNAPSHOTS * len(names)
            question = f"names={','.join(names)};since_s={since_s!r};until_s={until_s!r};limit={limit}"
            found = self._document(drive, question)
            if found is None:
                return
            told = found.get("rows")
            rows += [row for row in told if isinstance(row, dict) and "name" in row] if isinstance(told, list) else []
        for number, group in numbered(rows, (topic, run), hole):
            self.repeated += 1
            self._feed(f"{PREFIX}/{drive}/{topic}", _message(run, number, group))


def _is_busy(answer: Mapping[str, Any]) -> bool:
    """A gateway that refused because of the moment, not of the question."""
    return any(word in str(answer.get("refused", "")) for word in BUSY)


def _is_run(row: Mapping[str, Any]) -> bool:
    whole = all(isinstance(row.get(name), int) for name in ("run", "first", "last"))
    return whole and isinstance(row.get("topic"), str) and 0 <= row["first"] <= row["last"]


def numbered(
    rows: list[dict[str, Any]], stream: tuple[str, int], hole: NumberSpan
) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Sequence number and rows of each message that was missing, as far as the rows tell.

    Rows that carry their own `run` and `sequence` are believed. Others are told apart by a name that comes again, and
    numbered in order where they are as many as are missing; where not, each goes to the number whose time by the
    neighbours is nearest, and none is given twice.
    """
    topic, run = stream
    first, last, before_s, after_s = hole
    own: dict[int, list[dict[str, Any]]] = {}
    for row in rows:
        if isinstance(row.get("sequence"), int) and row.get("run") == run and row.get("topic", topic) == topic:
            own.setdefault(row["sequence"], []).append(row)
    if own:
        yield from ((number, group) for number, group in sorted(own.items()) if first <= number <= last)
        return
    groups = _grouped(rows)
    count = last - first + 1
    if first == 0:  # what is older is of the run before
        groups = groups[-count:]
    if len(groups) == count:
        yield from zip(range(first, last + 1), groups, strict=True)
        return
    step_s = (after_s - before_s) / (count + 1)
    taken: dict[int, tuple[float, list[dict[str, Any]]]] = {}
    for group in groups:
        place = (_time_of(group) - before_s) / step_s if step_s > 0 else math.nan
        if not math.isfinite(place):
            continue
        number, off = first + round(place) - 1, abs(place - round(place))
        if first <= number <= last and (number not in taken or off < taken[number][0]):
            taken[number] = (off, group)
    yield from ((number, group) for number, (_, group) in sorted(taken.items()))


def _grouped(rows: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    groups: list[list[dict[str, Any]]] = []
    names: set[str] = set()
    for row in rows:
        if not groups or row["name"] in names:
            groups.append([])
            names = set()
        names.add(row["name"])
        groups[-1].append(row)
    return groups


def _time_of(group: list[dict[str, Any]]) -> float:
    times = [row["time_s"] for row in group if isinstance(row.get("time_s"), int | float)]
    return float(max(times)) if times else math.nan


def _message(run: int, sequence: int, group: list[dict[str, Any]]) -> bytes:
    units = {row["name"]: QUANTITIES[row["name"]].unit for row in group if row["name"] in QUANTITIES}
    estimates = {
        row["name"]: {"value": row.get("value"), "sd": row.get("sd"), "status": row.get("status"),
                      "unit": row.get("unit", units.get(row["name"]))}
        for row in group
    }  # fmt: skip
    time_s = _time_of(group)
    head = {"run": run, "sequence": sequence, "time_s": time_s if math.isfinite(time_s) else None}
    return msgspec.json.encode({**head, "historical": True, "estimates": estimates})
