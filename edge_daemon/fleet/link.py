"""The wall to Zenoh on the fleet's side: listens, watches tokens and asks. One client session for each endpoint.

Each endpoint is connected to by itself, so that routers need not know each other and one may be away; what comes twice
is known by its number. A client's session finds its router again by itself once it was open.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import zenoh

from edge_daemon.errors import BadInput

log = logging.getLogger(__name__)

RETRY_S = 1.0
"""A router that is not there yet is looked for so often."""
CLOSE_S = 3.0
"""A router answers a client's goodbye within milliseconds, and one that is gone never."""
PREFIX = "strainwave/v1"
MESSAGES = f"{PREFIX}/*/*/*/*"
TOKENS = f"{PREFIX}/*/*/*"


def configuration(endpoint: str, file: Path | None) -> zenoh.Config:
    """A client of one endpoint; `file`: Zenoh's own configuration, for certificates. Raises `BadInput`."""
    try:
        config = zenoh.Config.from_file(str(file)) if file else zenoh.Config()
        values = {
            "mode": "client",
            "connect/endpoints": [endpoint],
            "listen/endpoints": [],
            "connect/exit_on_failure": True,
            "connect/timeout_ms": 0,
            "scouting/multicast/enabled": False,
        }
        for key, value in values.items():
            config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        short = str(error).partition(" at ")[0]
        raise BadInput(f"{file or endpoint}: {short}: expected such as tcp/127.0.0.1:7447") from error
    return config


def _taken(take: Callable[[], Any]) -> Any:
    """A sample; None where there is none, or the session was closed."""
    try:
        return take()
    except zenoh.ZError:
        return None


class FleetLink:
    """Hears what all gateways say. Callbacks run in Zenoh's threads: they must neither block nor call Zenoh."""

    def __init__(
        self,
        endpoints: Sequence[str],
        on_message: Callable[[str, bytes], None] | None = None,
        on_token: Callable[[str, bool], None] | None = None,
        file: Path | None = None,
        queue: int = 0,
        offers: Mapping[str, bytes] | None = None,
    ) -> None:
        """`queue`: so many messages wait for `heard`, in place of `on_message`; with more the router holds senders up.
        `offers`, by key, are published on every session and answered to whoever asks.
        Raises `BadInput` for an endpoint or a file that Zenoh refuses."""
        for endpoint in endpoints:
            configuration(endpoint, file)
        self._file = file
        self._on_message, self._on_token = on_message, on_token
        self._queue = queue
        self._offers = dict(offers or {})
        self.asked = 0
        """so often somebody asked for an offer"""
        self._queues: list[Any] = []
        self._sessions: dict[str, zenoh.Session] = {}
        self._kept: list[Any] = []
        self._stop = threading.Event()
        self._some = threading.Event()
        self._closing = threading.Thread(target=self._close_sessions, daemon=True)
        self._threads = [
            threading.Thread(target=self._open, args=(one,), name=f"zenoh {one}", daemon=True) for one in endpoints
        ]
        for thread in self._threads:
            thread.start()

    def connected(self, within_s: float) -> bool:
        """Whether a session opened within this time."""
        return self._some.wait(within_s)

    def heard(self, most: int) -> list[tuple[str, bytes]]:
        """Key and payload of at most so many messages that wait.

        Python is entered by the caller alone: a callback of Zenoh's would wait for Python 5 ms for each message.
        """
        found: list[tuple[str, bytes]] = []
        for waiting in list(self._queues):
            take = waiting.try_recv
            while len(found) < most and (sample := _taken(take)) is not None:
                found.append((str(sample.key_expr), sample.payload.to_bytes()))
        return found

    def get(self, selector: str, within_s: float, everywhere: bool = False) -> Iterator[tuple[str, bytes | None, str]]:
        """Key, payload and refusal of each answer, from the first session that has one, or from all. Blocks; not for
        callbacks."""
        for session in list(self._sessions.values()):
            found = False
            try:
                for answer in session.get(selector, target=zenoh.QueryTarget.ALL, timeout=within_s):
                    found = True
                    if answer.ok is not None:
                        yield str(answer.ok.key_expr), answer.ok.payload.to_bytes(), ""
                    elif answer.err is not None:
                        yield "", None, answer.err.payload.to_string()
            except zenoh.ZError as error:
                log.debug("%s: %s", selector, error)
            if found and not everywhere:
                return

    def put(self, key: str, payload: bytes) -> None:
        """Publish on every session."""
        for session in list(self._sessions.values()):
            session.put(key, payload, encoding=zenoh.Encoding.APPLICATION_JSON)

    def tokens(self, within_s: float) -> set[str]:
        """The keys of all drives and gateways that are there now."""
        found: set[str] = set()
        for session in list(self._sessions.values()):
            for answer in session.liveliness().get(TOKENS, timeout=within_s):
                if answer.ok is not None:
                    found.add(str(answer.ok.key_expr))
        return found

    def close(self, within_s: float = CLOSE_S) -> None:
        """Hear nothing more. A session that hangs when it closes keeps nobody for longer than this; called again, this
        waits on."""
        if not self._stop.is_set():
            self._stop.set()
            self._closing.start()
        self._closing.join(within_s)

    def _close_sessions(self) -> None:
        for session in self._sessions.values():
            session.close()  # type: ignore[no-untyped-call]

    def _open(self, endpoint: str) -> None:
        said = False
        while not self._stop.is_set():
            try:
                session = zenoh.open(configuration(endpoint, self._file))
                self._listen(session)
                self._sessions[endpoint] = session
                self._some.set()
                if said:
                    log.info("%s: connected", endpoint)
                return
            except zenoh.ZError as error:
                if not said:
                    log.warning("%s: nobody answers: tried again every %g s", endpoint, RETRY_S)
                    log.debug("%s", error)
                said = True
                self._stop.wait(RETRY_S)

    def _listen(self, session: zenoh.Session) -> None:
        if self._queue:
            self._queues.append(session.declare_subscriber(MESSAGES, zenoh.handlers.FifoChannel(self._queue)))
        if self._on_message:
            say = self._on_message

            def message(sample: zenoh.Sample) -> None:
                say(str(sample.key_expr), sample.payload.to_bytes())

            self._kept.append(session.declare_subscriber(MESSAGES, message))
        for key, payload in self._offers.items():
            self._kept.append(session.declare_queryable(key, partial(self._answer, key, payload)))
            session.put(key, payload, encoding=zenoh.Encoding.APPLICATION_JSON)
        if self._on_token:
            tell = self._on_token

            def token(sample: zenoh.Sample) -> None:
                tell(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

            self._kept.append(session.liveliness().declare_subscriber(TOKENS, token, history=True))

    def _answer(self, key: str, payload: bytes, query: Any) -> None:
        self.asked += 1
        try:
            query.reply(key, payload, encoding=zenoh.Encoding.APPLICATION_JSON)
        except zenoh.ZError as error:
            log.debug("answer to %s: %s", key, error)
