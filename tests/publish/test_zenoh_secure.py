"""Who may connect, who may speak in a gateway's name, and that a forger is noticed. Certificates are made here."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from edge_daemon.config.settings import Gateway, Zenoh, ZenohTls
from edge_daemon.publish.zenoh_link import ZenohLink
from edge_daemon.records import NE107, Snapshot

WITHIN_S = 15.0
ROOT = "strainwave/v1/hall-2/gw-1"
KEY = f"{ROOT}/left/health"
pytestmark = [
    pytest.mark.timeout(60),
    pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl"),
]


@pytest.fixture(scope="module")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority with a gateway and a person, a person of another authority, and passwords."""
    folder = tmp_path_factory.mktemp("pki")

    def made(name: str, *more: str) -> None:
        command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
        command += ["-keyout", f"{name}.key", "-out", f"{name}.pem", "-days", "2", "-subj", f"/CN={name}", *more]
        subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=20)

    leaf = ("-addext", "basicConstraints=critical,CA:false")
    for authority in ("ca", "other"):
        made(authority)
    made("gateway", "-CA", "ca.pem", "-CAkey", "ca.key", *leaf, "-addext", "subjectAltName=IP:127.0.0.1")
    made("ida", "-CA", "ca.pem", "-CAkey", "ca.key", *leaf)
    made("cell-7", "-CA", "ca.pem", "-CAkey", "ca.key", *leaf)
    made("eve", "-CA", "other.pem", "-CAkey", "other.key", *leaf)
    (folder / "users").write_text("ida:a-good-password\n")
    (folder / "password").write_text("a-good-password\n")
    return folder


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def visitor(endpoint: str, mode: str = "client", rules: str = "", **more: Any) -> Iterator[zenoh.Session | None]:
    """A session that is closed again; None where it was not let in."""
    side = "connect" if mode == "client" else "listen"
    values = {"mode": mode, f"{side}/endpoints": [endpoint], "scouting/multicast/enabled": False, **more}
    if mode == "client":
        values |= {"connect/timeout_ms": 1000, "connect/exit_on_failure": True, "listen/endpoints": []}
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    if rules:
        config.insert_json5("access_control", rules)
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        yield None
        return
    try:
        yield session
    finally:
        session.close()  # type: ignore[no-untyped-call]


@contextmanager
def linked(pki: Path, **settings: Any) -> Iterator[ZenohLink]:
    link = ZenohLink(Zenoh(every_s=0.0, **settings), Gateway(site="hall-2", name="gw-1"), ("left",), base=pki)
    link.start()
    try:
        until(lambda: link.health().state == "ok")
        yield link
    finally:
        link.stop(5.0)


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + WITHIN_S
    while not condition():
        assert time.monotonic() < end_s, "it did not happen"
        time.sleep(0.02)


def put_until_heard(session: zenoh.Session, key: str, heard: list[str]) -> None:
    def said() -> bool:
        session.put(key, key)
        return key in heard

    until(said)


def hears(session: zenoh.Session, link: ZenohLink) -> bool:
    """Whether what the gateway publishes reaches a session."""
    heard: list[str] = []
    with session.declare_subscriber(KEY, lambda sample: heard.append(str(sample.key_expr))):
        end_s = time.monotonic() + WITHIN_S
        number = 0
        while not heard and time.monotonic() < end_s:
            number += 1
            link.publish(Snapshot("left", number, time.time(), NE107.OK, (), {}))
            time.sleep(0.05)
    return bool(heard)


def tls(pki: Path, person: str | None = None) -> dict[str, Any]:
    own = {"transport/link/tls/root_ca_certificate": str(pki / "ca.pem"), "transport/link/tls/enable_mtls": True}
    if person:
        own["transport/link/tls/connect_certificate"] = str(pki / f"{person}.pem")
        own["transport/link/tls/connect_private_key"] = str(pki / f"{person}.key")
    return own


def test_only_who_brings_a_certificate_of_our_authority_gets_in(pki: Path) -> None:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    own = ZenohTls(ca="ca.pem", certificate="gateway.pem", key="gateway.key")
    with linked(pki, listen=(endpoint,), tls=own) as link:
        with visitor(endpoint, **tls(pki, "ida")) as ida:
            assert ida is not None and hears(ida, link)
        for stranger in ("eve", None):
            with visitor(endpoint, **tls(pki, stranger)) as session:
                assert session is None, stranger
        with visitor(endpoint.replace("tls/", "tcp/")) as plain:
            assert plain is None


def test_a_gateway_gets_in_at_a_router_by_certificate_and_by_password(pki: Path) -> None:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    router = tls(pki) | {
        "transport/link/tls/listen_certificate": str(pki / "gateway.pem"),
        "transport/link/tls/listen_private_key": str(pki / "gateway.key"),
        "transport/auth/usrpwd/dictionary_file": str(pki / "users"),
    }
    own = ZenohTls(ca="ca.pem", certificate="ida.pem", key="ida.key")
    known = {"user": "ida", "password_file": "password"}
    with visitor(endpoint, "router", **router) as session:
        assert session is not None
        with linked(pki, mode="client", connect=(endpoint,), tls=own, **known) as link:
            assert hears(session, link)


def test_the_routers_rules_in_the_manual_let_only_the_gateway_speak_for_itself(pki: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text()
    block = text[text.index("    access_control: {") :].split("\n\n")[0]
    rules = block.partition(": ")[2].replace("hall-3/cell-7", "hall-2/gw-1")
    endpoint = f"tls/127.0.0.1:{free_port()}"
    router = tls(pki) | {
        "transport/link/tls/listen_certificate": str(pki / "gateway.pem"),
        "transport/link/tls/listen_private_key": str(pki / "gateway.key"),
    }
    own = ZenohTls(ca="ca.pem", certificate="cell-7.pem", key="cell-7.key")
    with (
        visitor(endpoint, "router", rules, **router) as session,
        linked(pki, mode="client", connect=(endpoint,), tls=own) as link,
        visitor(endpoint, **tls(pki, "ida")) as ida,
        visitor(endpoint, **tls(pki, "ida")) as listener,
    ):
        assert session is not None and ida is not None and listener is not None
        assert hears(listener, link)
        heard: list[str] = []
        with listener.declare_subscriber(KEY, lambda sample: heard.append(sample.payload.to_string())):
            for _ in range(20):
                ida.put(KEY, "forged")
            assert hears(listener, link)
        assert "forged" not in heard and not link.health().figures.get("foreign")


def test_only_who_knows_a_password_gets_in(pki: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with linked(pki, listen=(endpoint,), users_file="users") as link:
        right = {"transport/auth/usrpwd/user": "ida", "transport/auth/usrpwd/password": "a-good-password"}
        with visitor(endpoint, **right) as ida:
            assert ida is not None and hears(ida, link)
        for wrong in ({}, right | {"transport/auth/usrpwd/password": "a-guess"}):
            with visitor(endpoint, **wrong) as session:
                assert session is None


def test_nobody_who_is_connected_speaks_in_the_gateways_name(pki: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with linked(pki, listen=(endpoint,), mode="router") as link, visitor(endpoint) as ida, visitor(endpoint) as eve:
        assert ida is not None and eve is not None and hears(ida, link)
        heard: list[str] = []
        with ida.declare_subscriber("**", lambda sample: heard.append(sample.payload.to_string())):
            put_until_heard(eve, "elsewhere/first", heard)  # what is put before the way is open is lost
            eve.put(KEY, "forged")
            put_until_heard(eve, "elsewhere/last", heard)
        assert "forged" not in heard


def test_a_forger_at_the_router_is_noticed_and_told(pki: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with visitor(endpoint, "router") as router, visitor(endpoint) as eve:
        assert router is not None and eve is not None
        with linked(pki, mode="client", connect=(endpoint,)) as link:
            assert hears(router, link) and link.health().state == "ok", "what is our own is not foreign"

            def forged() -> bool:
                eve.put(KEY, "forged")
                return link.health().state == "degraded"

            until(forged)
            assert f"somebody else publishes as this gateway: {KEY}" in link.health().reason
            assert link.health().figures["foreign"] >= 1
