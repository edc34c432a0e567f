"""The way to the fleet: one thread owns the Zenoh session, behind a bounded queue that drops the oldest first.

Zenoh's calls block and have no asyncio interface, and a put succeeds silently when the router is gone. So callers
only ever touch the queue; the thread opens, sends, watches the neighbours and opens again. What was made while the
network was away, or was sent just before that was noticed, is kept and sent once somebody listens again, marked
historical.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from edge_daemon.config.settings import Gateway, Zenoh
from edge_daemon.publish import zenoh_session
from edge_daemon.publish.messages import GATEWAY, PREFIX, Composer, Document, Message, reply
from edge_daemon.publish.zenoh_session import Session, SessionError
from edge_daemon.records import Event, LinkHealth, Snapshot

log = logging.getLogger(__name__)

HistoryQuery = Callable[[str, Mapping[str, str]], list[dict[str, Any]] | Document]
"""(drive, query parameters) -> rows, or the parts of the answer; ValueError says what is wrong with the parameters"""
Keep = Callable[[Sequence[Message]], None]
"""Takes what was numbered, to be found again by its number when the network was away for long."""

POLL_S = 0.25
"""The thread looks so often whether the other end is still there."""
BEAT_S = 10.0
"""Introduction and last event of each drive are repeated so often, for subscribers that came late."""
ASK_EVERY_S = 600.0
"""What is wanted of others is asked for so often, besides what they publish: who offers it may have been away."""
FIRST_WAIT_S = 0.5
LONGEST_WAIT_S = 10.0
UNCONFIRMED_S = 11.0
"""A dead peer is noticed after its lease of 10 s at the latest: what was sent since may be lost and is sent again."""
BLOCKED_S = 2.0
"""A send that takes longer is reported."""
CONNECTING = "connecting"
FOREIGN_S = 60.0
"""What somebody else published under our keys is told for so long (guess: until a person has looked)."""
_QUESTIONS = 8
"""So many history queries may wait; more are left unanswered and counted."""

_Question = tuple[Any, str, dict[str, str]]


class ZenohLink:
    """Publishes snapshots, events and introductions; answers queries for the latest message and for history.

    All methods may be called from any thread and return at once, but for `stop`.
    """

    def __init__(
        self,
        settings: Zenoh,
        gateway: Gateway,
        drives: Sequence[str],
        history: HistoryQuery | None = None,
        *,
        base: Path = Path(),
        open_session: Callable[[Zenoh], Session] | None = None,
        monotonic: Callable[[], float] = time.monotonic,
        keep: Keep = lambda messages: None,
        wanted: tuple[str, Callable[[bytes], None]] | None = None,
    ) -> None:
        """`wanted`: a key expression, and who hears in Zenoh's thread what others publish or answer there."""
        self._settings = settings
        self._wanted = wanted
        self._asked_s = float("-inf")
        self._keep = keep
        self._root = f"{PREFIX}/{gateway.site}/{gateway.name}"
        self._drives = tuple(drives)
        self._history = history
        # nobody is connected to a client: its router guards its keys
        guarded = "" if settings.mode == "client" else self._root
        self._open_session = open_session or partial(Session, base=base, own=guarded)
        self._monotonic = monotonic
        self._composer = Composer(int(time.time() * 1e3), settings.every_s, monotonic, settings.most_bytes_per_s)
        self._wake = threading.Condition()
        self._waiting: deque[Message] = deque()
        self._kept: deque[Message] = deque()
        self._unconfirmed: deque[tuple[float, Message]] = deque()
        self._repeated: dict[tuple[str, str], Message] = {}
        self._latest: dict[tuple[str, str], Message] = {}
        self._incoming: deque[tuple[str, Any]] = deque()
        self._answers: deque[tuple[Any, str, bytes | str]] = deque()
        self._questions: queue.Queue[_Question | None] = queue.Queue(_QUESTIONS)
        self._threads: list[threading.Thread] = []
        self._stopping = False
        self._stop_by_s = float("inf")
        self._reachable = False
        self._reason = "not started"
        self._doubt = ""
        self._foreign_s = float("-inf")
        self._foreign_key = ""
        self._sending_since_s: float | None = None
        self._neighbours = 0
        self.counts: Counter[str] = Counter(published=0, dropped=0, replayed=0, sessions=0)

    # --- called by the daemon -------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to connect; never fails, `health` says how it goes. A link that is not enabled stays off."""
        if not self._settings.enabled or self._threads:
            return
        self._reason = CONNECTING
        for name, run in (("zenoh", self._run), ("zenoh-history", self._read_history)):
            thread = threading.Thread(target=run, name=name, daemon=True)
            self._threads.append(thread)
            thread.start()

    def publish(self, snapshot: Snapshot) -> None:
        """Queue a drive's state, as often as the settings allow."""
        self._enqueue(self._composer.of_snapshot(snapshot))

    def event(self, event: Event) -> None:
        """Queue an event."""
        self._enqueue([self._composer.of_event(event)], repeat=True)

    def meta(self, drive: str, document: Document) -> None:
        """Introduce a drive: now, and again whenever a connection comes about."""
        self._enqueue([self._composer.of_meta(drive, time.time(), document)], repeat=True)

    def stop(self, within_s: float) -> bool:
        """Send what is queued, close, and return whether that was done within `within_s`."""
        with self._wake:
            self._stopping = True
            self._stop_by_s = self._monotonic() + within_s / 2
            self._wake.notify_all()
        try:
            self._questions.put_nowait(None)
        except queue.Full:
            log.debug("history queries are left unanswered")
        for thread in self._threads[:1]:
            thread.join(within_s)
        return not any(thread.is_alive() for thread in self._threads[:1])

    def health(self) -> LinkHealth:
        """State, reason and counters; `dropped` messages never left the gateway."""
        with self._wake:
            since_s = self._sending_since_s
            figures = {**self.counts, "queued": len(self._waiting) + len(self._kept), "neighbours": self._neighbours}
            reachable, reason = self._reachable, self._reason
        if not self._settings.enabled:
            return LinkHealth("zenoh", "off", "", figures)
        if not reachable:
            return LinkHealth("zenoh", "starting" if reason == CONNECTING else "down", reason, figures)
        if since_s is not None and (blocked_s := self._monotonic() - since_s) > BLOCKED_S:
            return LinkHealth("zenoh", "degraded", f"sending has been blocked for {blocked_s:.0f} s", figures)
        if self._monotonic() - self._foreign_s < FOREIGN_S:
            foreign = (
                f"somebody else publishes as this gateway: {self._foreign_key}: what the fleet hears may be forged"
            )
            return LinkHealth("zenoh", "degraded", foreign, figures)
        if self._doubt:
            return LinkHealth("zenoh", "degraded", self._doubt, figures)
        return LinkHealth("zenoh", "ok", "", figures)

    def _enqueue(self, messages: Sequence[Message], *, repeat: bool = False) -> None:
        if not self._settings.enabled or not messages:
            return
        self._keep(messages)
        with self._wake:
            for message in messages:
                self._latest[message.drive, message.topic] = message
                if repeat:
                    self._repeated[message.drive, message.topic] = message
                (self._waiting if self._reachable else self._kept).append(message)
            self._drop_oldest()
            self._wake.notify_all()

    def _drop_oldest(self) -> None:
        while len(self._waiting) + len(self._kept) > self._settings.queue:
            (self._kept or self._waiting).popleft()
            self.counts["dropped"] += 1

    # --- the thread that owns the session -------------------------------------------------------------------------

    def _run(self) -> None:
        wait_s = FIRST_WAIT_S
        while not self._stopping:
            try:
                session = self._open_session(self._settings)
            except SessionError as error:
                self._down(str(error))
            else:
                opened_s = self._monotonic()
                self._serve(session)
                if self._monotonic() - opened_s > LONGEST_WAIT_S:
                    wait_s = FIRST_WAIT_S
            with self._wake:
                self._wake.wait_for(lambda: self._stopping, 0.0 if self._stopping else wait_s)
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    def _serve(self, session: Session) -> None:
        """Until stopped, or until the session fails."""
        self.counts["sessions"] += 1
        try:
            self._look_for_namesake(session)
            keys = [f"{self._root}/{drive}" for drive in (*self._drives, GATEWAY)]
            session.announce(keys, self._on_query, self._root, self._on_foreign)
            if self._wanted:
                session.listen(*self._wanted)
            self._asked_s = float("-inf")
            beat_s = float("-inf")
            while not self._stopping:
                self._look(session)
                now_s = self._monotonic()
                if self._reachable and now_s - beat_s >= BEAT_S:
                    self._beat()
                    beat_s = now_s
                if not self._reachable:
                    beat_s = self._asked_s = float("-inf")
                elif self._wanted and now_s - self._asked_s >= ASK_EVERY_S:
                    session.ask(*self._wanted)
                    self._asked_s = now_s
                self._send_kept(session)
                self._send_waiting(session)
                self._answer_all()
                self._sleep()
            self._send_waiting(session)
        except SessionError as error:
            self._down(str(error))
        try:
            session.close()
        except Exception as error:  # a wedged session must not keep the next from opening
            log.debug("close: %s", error)

    def _look_for_namesake(self, session: Session) -> None:
        """Two gateways of one name write over each other's keys. A session opened again may meet its own old token."""
        if self.counts["sessions"] > 1 or not session.is_alive(f"{self._root}/{GATEWAY}"):
            return
        self._doubt = (
            f"another gateway called itself {self._root} when this one began: give each its own [gateway] site and name"
        )
        log.warning("zenoh: %s", self._doubt)

    def _sleep(self) -> None:
        with self._wake:
            self._wake.wait_for(self._has_work, POLL_S)

    def _has_work(self) -> bool:
        return bool(self._stopping or self._answers or self._incoming or self._waiting)

    def _look(self, session: Session) -> None:
        """Notice the other end coming and going."""
        reachable = session.reachable()
        with self._wake:
            self._neighbours = session.neighbours()
            self._forget_confirmed()
            if reachable and not self._reachable:
                if self._reason != CONNECTING:
                    log.info("zenoh: connected")
                self._reachable, self._reason = True, ""
            elif not reachable:
                self._lost("no connection to " + ", ".join(self._settings.connect))

    def _down(self, reason: str) -> None:
        log.log(logging.WARNING if reason != self._reason else logging.DEBUG, "zenoh: %s", reason)
        with self._wake:
            self._neighbours = 0
            self._lost(reason)

    def _lost(self, reason: str) -> None:
        """What was sent since the last sure sign of life may be lost with it, and is kept as well."""
        if self._reachable:
            log.warning("zenoh: %s", reason)
        self._reachable, self._reason = False, reason
        self._kept.extend(message for _, message in self._unconfirmed)
        self._kept.extend(self._waiting)
        self._unconfirmed.clear()
        self._waiting.clear()
        self._drop_oldest()

    def _forget_confirmed(self) -> None:
        horizon_s = self._monotonic() - UNCONFIRMED_S
        while self._unconfirmed and self._unconfirmed[0][0] < horizon_s:
            self._unconfirmed.popleft()

    def _beat(self) -> None:
        """Introductions are as good as new; the last event is history."""
        with self._wake:
            for (_, topic), message in self._repeated.items():
                queue_of_it = self._kept if topic == "event" else self._waiting
                if message not in queue_of_it and message not in self._waiting:
                    queue_of_it.append(message)
                    self._composer.charge([message])
            self._drop_oldest()

    def _send_kept(self, session: Session) -> None:
        """What was kept, oldest first, as far as somebody listens to it now; the rest stays."""
        with self._wake:
            kept = list(self._kept) if self._reachable else []
        heard: dict[str, bool] = {}
        for message in kept:
            key = self._key(message)
            if key not in heard:
                heard[key] = session.heard(key)
            if not heard[key]:
                continue
            if not session.reachable() or self._monotonic() > self._stop_by_s:
                return
            with self._wake:
                if message not in self._kept:
                    continue  # pushed out meanwhile
                self._kept.remove(message)
            self._send(session, message, historical=True)

    def _send_waiting(self, session: Session) -> None:
        """What is new, oldest first, while the other end is there."""
        while session.reachable() and self._monotonic() <= self._stop_by_s:
            with self._wake:
                if not self._waiting:
                    return
                message = self._waiting.popleft()
            self._send(session, message, historical=False)

    def _send(self, session: Session, message: Message, *, historical: bool) -> None:
        with self._wake:
            self._sending_since_s = self._monotonic()
            self._unconfirmed.append((self._sending_since_s, message))
        try:
            session.put(self._key(message), message.payload(historical=historical))
        finally:
            self._sending_since_s = None
        self.counts["published"] += 1
        self.counts["replayed"] += historical

    def _key(self, message: Message) -> str:
        return f"{self._root}/{message.drive}/{message.topic}"

    def _on_foreign(self, key: str) -> None:
        """In Zenoh's thread: only note it down. It is told when it begins."""
        began = self._monotonic() - self._foreign_s > FOREIGN_S
        self.counts["foreign"] += 1
        self._foreign_s = self._monotonic()
        if began:
            self._foreign_key = key
            log.warning("zenoh: somebody else publishes as this gateway: %s", key)

    # --- queries ----------------------------------------------------------------------------------------------------

    def _on_query(self, key: str, query: Any) -> None:
        """In Zenoh's thread: only note it down."""
        with self._wake:
            if len(self._incoming) >= _QUESTIONS:
                self.counts["queries_refused"] += 1
                return
            self._incoming.append((key, query))
            self._wake.notify_all()

    def _answer_all(self) -> None:
        with self._wake:
            incoming, self._incoming = self._incoming, deque()
            answers, self._answers = self._answers, deque()
        for mine, query in incoming:
            self.counts["queries"] += 1
            self._answer(mine.removeprefix(f"{self._root}/"), query)
        for query, key, payload in answers:
            if isinstance(payload, bytes):
                zenoh_session.answer(query, key, payload)
            else:
                zenoh_session.refuse(query, payload)

    def _answer(self, mine: str, query: Any) -> None:
        """The latest message of each topic of drive `mine` asked for; history is looked up by the other thread.

        A query over several drives comes once for each of them.
        """
        key, parameters = zenoh_session.selection(query)
        with self._wake:
            latest = [(topic, message) for (drive, topic), message in self._latest.items() if drive == mine]
        for topic, message in latest:
            if zenoh_session.intersects(key, full := f"{self._root}/{mine}/{topic}"):
                zenoh_session.answer(query, full, message.payload(historical=True))
        by_name = mine == GATEWAY and key.endswith(f"/{GATEWAY}/history")  # it has a past, but no estimates
        if key.endswith("/history") and self._history and (mine in self._drives or by_name):
            self._ask(query, mine, parameters)

    def _ask(self, query: Any, drive: str, parameters: dict[str, str]) -> None:
        try:
            self._questions.put_nowait((query, drive, parameters))
        except queue.Full:
            self.counts["queries_refused"] += 1
            zenoh_session.refuse(query, "too many history queries at once: ask again later")

    def _read_history(self) -> None:
        """The thread that may take its time over the store; it never calls Zenoh."""
        while (question := self._questions.get()) is not None:
            drive = question[1]
            found = self._look_up(drive, question[2])
            with self._wake:
                self._answers.append((question[0], f"{self._root}/{drive}/history", found))
                self._wake.notify_all()
            del question  # the asker waits until the last reference to the query is gone

    def _look_up(self, drive: str, parameters: dict[str, str]) -> bytes | str:
        """The answer, or why there is none."""
        try:
            return reply(drive, self._history(drive, parameters) if self._history else [])
        except ValueError as error:
            return str(error)
        except Exception:
            log.exception("history of %s", drive)
            return "the store cannot be read now"
