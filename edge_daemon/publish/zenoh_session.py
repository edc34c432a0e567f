"""The wall to Zenoh: only this module imports it, and only one thread calls it."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import zenoh

from edge_daemon.config.settings import Zenoh

log = logging.getLogger(__name__)

_TRY_ONCE = 0
"""A client's `open` fails at once without a router, so that the link can say so and try again."""
_TRY_FOR_EVER = -1
"""A peer's or router's `open` succeeds without its neighbours and looks for them in the background."""
_ASK_S = 2.0
"""An answer about a token is waited for this long; a router knows at once."""
_WAIT = zenoh.CongestionControl.BLOCK
"""A full queue holds up only the thread that sends; dropping there would not be counted."""


class SessionError(Exception):
    """Zenoh could not do what it was asked; one line."""


def configuration(settings: Zenoh, base: Path = Path(), own: str = "") -> zenoh.Config:
    """Zenoh's own configuration. `base`: folder of the files that it names; `own`: under this key nobody else may
    publish through this session. Raises `SessionError` if it refuses an endpoint or a file cannot be read."""
    config = zenoh.Config()
    values = {
        "mode": settings.mode,
        "listen/endpoints": list(settings.listen) if settings.mode != "client" else [],
        "connect/endpoints": list(settings.connect),
        "connect/exit_on_failure": False,
        "connect/timeout_ms": _TRY_ONCE if settings.mode == "client" else _TRY_FOR_EVER,
        "scouting/multicast/enabled": settings.scouting,
        "scouting/gossip/enabled": settings.scouting,
        "timestamping/enabled": True,
        **_identity(settings, base),
        **(_only_ours(own) if own else {}),
    }
    for key, value in values.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise SessionError(f"{key} = {value!r}: {_short(error)}") from error
    return config


def _identity(settings: Zenoh, base: Path) -> dict[str, Any]:
    """Certificates, and name and password."""
    values: dict[str, Any] = {}
    if settings.tls is not None:
        tls = settings.tls
        values["transport/link/tls/root_ca_certificate"] = str(base / tls.ca)
        values["transport/link/tls/enable_mtls"] = tls.clients
        for side in ("listen", "connect") if tls.certificate and tls.key else ():
            values[f"transport/link/tls/{side}_certificate"] = str(base / str(tls.certificate))
            values[f"transport/link/tls/{side}_private_key"] = str(base / str(tls.key))
    if settings.user is not None and settings.password_file is not None:
        try:
            password = (base / settings.password_file).read_text().strip()
        except (OSError, UnicodeDecodeError) as error:
            raise SessionError(f"password_file: {base / settings.password_file}: cannot read") from error
        values |= {"transport/auth/usrpwd/user": settings.user, "transport/auth/usrpwd/password": password}
    if settings.users_file is not None:
        values["transport/auth/usrpwd/dictionary_file"] = str(base / settings.users_file)
    return values


def _only_ours(own: str) -> dict[str, Any]:
    """Whoever is connected here may ask and listen, but says nothing in this gateway's name."""
    rule = {
        "id": "ours",
        "permission": "deny",
        "flows": ["ingress"],
        "messages": ["put", "delete", "reply", "declare_queryable", "liveliness_token"],
        "key_exprs": [f"{own}/**"],
    }
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "allow",
            "rules": [rule],
            "subjects": [{"id": "everybody"}],
            "policies": [{"rules": ["ours"], "subjects": ["everybody"]}],
        }
    }


class Session:
    """One open session: put, answer, and see whether anybody is at the other end.

    `on_query` runs in Zenoh's thread: it must neither block nor call Zenoh.
    """

    def __init__(self, settings: Zenoh, base: Path = Path(), own: str = "") -> None:
        self._ports = {_port(endpoint) for endpoint in settings.connect}
        try:
            self._session = zenoh.open(configuration(settings, base, own))
        except zenoh.ZError as error:
            raise SessionError(_short(error)) from error
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._kept: list[Any] = []

    def is_alive(self, key: str) -> bool:
        """Does a liveliness token of this very name stand already? Blocks for at most `_ASK_S`."""
        try:
            return any(answer.ok for answer in self._session.liveliness().get(key, timeout=_ASK_S))
        except zenoh.ZError as error:
            raise SessionError(_short(error)) from error

    def announce(
        self, keys: Iterable[str], on_query: Callable[[str, Any], None], own: str, on_foreign: Callable[[str], None]
    ) -> None:
        """A liveliness token under each key, and a queryable for what lies below it: `on_query(key, query)`;
        `on_foreign(key)` for whatever others publish below `own`."""

        def foreign(sample: zenoh.Sample) -> None:
            on_foreign(str(sample.key_expr))

        try:
            remote = zenoh.Locality.REMOTE
            self._kept.append(self._session.declare_subscriber(f"{own}/**", foreign, allowed_origin=remote))
            for key in keys:
                self._kept.append(self._session.liveliness().declare_token(key))
                self._kept.append(self._session.declare_queryable(f"{key}/*", partial(on_query, key)))
        except zenoh.ZError as error:
            raise SessionError(_short(error)) from error

    def listen(self, key: str, on_payload: Callable[[bytes], None]) -> None:
        """Hear what is published under a key expression; `on_payload` as `on_query`."""

        def heard(sample: zenoh.Sample) -> None:
            on_payload(sample.payload.to_bytes())

        try:
            self._kept.append(self._session.declare_subscriber(key, heard))
        except zenoh.ZError as error:
            raise SessionError(_short(error)) from error

    def ask(self, key: str, on_payload: Callable[[bytes], None]) -> None:
        """Ask for what stands under a key expression; answers come to `on_payload`, later, as `on_query`."""

        def answered(answer: zenoh.Reply) -> None:
            if answer.ok is not None:
                on_payload(answer.ok.payload.to_bytes())

        try:
            self._session.get(key, answered, timeout=_ASK_S)
        except zenoh.ZError as error:
            raise SessionError(_short(error)) from error

    def put(self, key: str, payload: bytes) -> None:
        """Send. May block; succeeds silently when nobody is there: look at `reachable`."""
        try:
            self._publisher(key).put(payload, encoding=zenoh.Encoding.APPLICATION_JSON)
        except zenoh.ZError as error:
            raise SessionError(_short(error)) from error

    def heard(self, key: str) -> bool:
        """Does anybody, here or beyond the routers, subscribe to this key now?"""
        try:
            status: Any = self._publisher(key).matching_status
            return bool(getattr(status, "matching", status))  # 1.10 returns a record where its stub says bool
        except zenoh.ZError as error:
            raise SessionError(_short(error)) from error

    def reachable(self) -> bool:
        """False when endpoints to connect to are configured and none of them is connected."""
        if not self._ports:
            return True
        return any(_port(str(link.dst)) in self._ports for link in self._session.info.links())

    def neighbours(self) -> int:
        """Routers and peers connected now."""
        return len(self._session.info.routers_zid()) + len(self._session.info.peers_zid())

    def close(self) -> None:
        """May take ten seconds."""
        self._session.close()  # type: ignore[no-untyped-call]

    def _publisher(self, key: str) -> zenoh.Publisher:
        """A plain one: the advanced publisher is marked unstable and cannot tell whether anybody listens."""
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._session.declare_publisher(
                key, congestion_control=_WAIT, allowed_destination=zenoh.Locality.REMOTE
            )
        return publisher


def selection(query: Any) -> tuple[str, dict[str, str]]:
    """Key expression and parameters of a query."""
    text = str(query.parameters)
    pairs = (part.partition("=") for part in text.split(";") if part)
    return str(query.key_expr), {name: value for name, _, value in pairs}


def intersects(left: str, right: str) -> bool:
    """Do two key expressions have a key in common?"""
    return bool(zenoh.KeyExpr(left).intersects(zenoh.KeyExpr(right)))


def answer(query: Any, key: str, payload: bytes) -> None:
    """One answer to a query; one that came too late is only logged."""
    try:
        query.reply(key, payload, encoding=zenoh.Encoding.APPLICATION_JSON)
    except zenoh.ZError as error:
        log.debug("answer to %s: %s", key, error)


def refuse(query: Any, reason: str) -> None:
    """Tell the asker why there is no answer."""
    try:
        query.reply_err(reason.encode(), encoding=zenoh.Encoding.TEXT_PLAIN)
    except zenoh.ZError as error:
        log.debug("refusal: %s", error)


def _port(locator: str) -> str:
    return locator.partition("#")[0].partition("?")[0].rpartition(":")[2]


def _short(error: Exception) -> str:
    """Zenoh's message without the places in its source, its two commonest in plain words."""
    text = re.sub(r" at /\S+", "", str(error)).strip()
    bound = re.match(r"Can ?not create a new \w+ listener bound to (\S+): \[.*: (.*) \(os error", text)
    if bound:
        return f"cannot listen on {bound[1]}: {bound[2]}"
    if text.startswith("Unable to connect"):
        ends = re.findall(r"Single\((.*?)\)", text)
        return f"nobody answers at {', '.join(ends)}"
    return text
