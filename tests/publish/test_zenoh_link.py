"""The way to the fleet, heard by an independent Zenoh program in another process."""

from __future__ import annotations

import json
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from edge_daemon.config.settings import Gateway, Zenoh
from edge_daemon.publish.messages import CREDIT_S, Composer, birth
from edge_daemon.publish.zenoh_link import ZenohLink
from edge_daemon.publish.zenoh_session import Session, SessionError
from edge_daemon.quantities import QUANTITIES, TOPICS
from edge_daemon.records import NE107, Estimate, Event, Snapshot, Status

WITHIN_S = 15.0
ROOT = "strainwave/v1/hall-2/gw-1"
pytestmark = pytest.mark.timeout(60)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Peer:
    """zenoh_peer.py in its own process; its lines, each wait bounded."""

    def __init__(self, *arguments: object) -> None:
        program = Path(__file__).with_name("zenoh_peer.py")
        self.process = subprocess.Popen(
            [sys.executable, str(program), *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            self.lines.put(line.strip())
        self.lines.put("")

    def ready(self) -> Peer:
        assert self.line() == "ready"
        return self

    def line(self) -> str:
        return self.lines.get(timeout=WITHIN_S)

    def messages(
        self, enough: Callable[[list[dict[str, Any]]], bool], meanwhile: Callable[[], object] = lambda: None
    ) -> list[dict[str, Any]]:
        """Documents until there are enough, or the time is over; `meanwhile` is called while none comes."""
        found: list[dict[str, Any]] = []
        end_s = time.monotonic() + WITHIN_S
        while not enough(found):
            try:
                found.append(json.loads(self.lines.get(timeout=0.1)))
            except queue.Empty:
                if time.monotonic() > end_s:
                    pytest.fail(f"only got {[(row.get('key'), row.get('sequence')) for row in found]}")
                meanwhile()
        return found

    def end(self) -> None:
        self.process.kill()
        self.process.wait(WITHIN_S)


@contextmanager
def peer(*arguments: object) -> Iterator[Peer]:
    program = Peer(*arguments)
    try:
        yield program
    finally:
        program.end()


@contextmanager
def linked(history: Any = None, drives: tuple[str, ...] = ("left", "right"), **settings: Any) -> Iterator[ZenohLink]:
    settings = {"listen": (), "every_s": 0.0} | settings
    link = ZenohLink(Zenoh(**settings), Gateway(site="hall-2", name="gw-1"), drives, history)
    link.start()
    try:
        yield link
    finally:
        link.stop(2.0)


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + WITHIN_S
    gate = threading.Event()
    while not condition():
        assert time.monotonic() < end_s, "waited too long"
        gate.wait(0.01)


def snapshot(drive: str, sequence: int = 1, value: float = 31_000.0) -> Snapshot:
    rows = {name: Estimate(name, value, 10.0, row.unit, Status.VALID, 5.0) for name, row in QUANTITIES.items()}
    return Snapshot(drive, sequence, 5.0, NE107.MAINTENANCE_REQUIRED, ("stiffness fell",), rows)


def test_a_subscriber_hears_every_topic_of_every_drive() -> None:
    port = free_port()
    with linked(mode="peer", listen=(f"tcp/127.0.0.1:{port}",)) as link:
        until(lambda: link.health().state == "ok")
        with peer("subscribe", port, f"{ROOT}/**") as subscriber:
            subscriber.ready()

            def say() -> None:
                for drive in ("left", "right"):
                    link.meta(drive, birth(gear="CSG-20-100", model={"balance": "torsion"}, versions={"daemon": "1"}))
                    link.event(Event(drive, 4.0, NE107.OK, "daemon", "started"))
                    link.publish(snapshot(drive))

            wanted = {f"{ROOT}/{drive}/{topic}" for drive in ("left", "right") for topic in TOPICS}
            found = subscriber.messages(lambda rows: {row["key"] for row in rows} >= wanted, meanwhile=say)
    newest = {row["key"]: row for row in found}
    stiffness = newest[f"{ROOT}/left/stiffness"]
    assert stiffness["estimates"]["stiffness"] == {
        "value": 31_000.0, "sd": 10.0, "unit": "N m/rad", "status": "valid", "time_s": 5.0,
    }  # fmt: skip
    assert (stiffness["schema"], stiffness["version"], stiffness["historical"]) == ("strainwave/stiffness", 1, False)
    assert stiffness["encoding"] == "application/json"
    health = newest[f"{ROOT}/right/health"]
    assert (health["state"], health["ne107"], health["reasons"]) == ("maintenance_required", 1, ["stiffness fell"])
    meta = newest[f"{ROOT}/right/meta"]
    assert meta["gear"] == "CSG-20-100" and {row["name"] for row in meta["quantities"]} == set(QUANTITIES)


def test_a_router_that_is_absent_at_start_gets_everything_later_marked_historical() -> None:
    port = free_port()
    with linked(mode="client", connect=(f"tcp/127.0.0.1:{port}",)) as link:
        until(lambda: link.health().state == "down")
        assert str(port) in link.health().reason
        for number in range(5):
            link.publish(snapshot("left", number))
        with peer("router", port) as router:
            router.ready()
            with peer("subscribe", port, f"{ROOT}/left/load") as subscriber:
                subscriber.ready()
                rows = subscriber.messages(lambda rows: len(rows) >= 5)
                until(lambda: link.health().figures["queued"] <= 5 * 6)  # all but what nobody listens to
                link.publish(snapshot("left", 5))
                rows += subscriber.messages(lambda rows: any(not row["historical"] for row in rows))
    fresh = [row["sequence"] for row in rows if not row["historical"]]
    assert {row["sequence"] for row in rows if row["historical"]} >= {0, 1, 2, 3, 4}
    assert fresh == [5]


@pytest.mark.parametrize("mode", ["client", "peer"])
def test_a_router_lost_and_back_misses_nothing(mode: str) -> None:
    port = free_port()
    with linked(mode=mode, connect=(f"tcp/127.0.0.1:{port}",)) as link:
        with peer("router", port) as router:
            router.ready()
            until(lambda: link.health().state == "ok")
            link.publish(snapshot("left", 0))
            until(lambda: link.health().figures["queued"] == 0)
        until(lambda: link.health().state == "down")
        for number in range(1, 4):
            link.publish(snapshot("left", number))
        with peer("router", port) as router:
            router.ready()
            with peer("subscribe", port, f"{ROOT}/left/ratio") as subscriber:
                subscriber.ready()
                rows = subscriber.messages(lambda rows: {row["sequence"] for row in rows} >= {0, 1, 2, 3})
            until(lambda: link.health().state == "ok")
    assert all(row["historical"] for row in rows)
    assert [row["sequence"] for row in rows] == sorted(row["sequence"] for row in rows)


def test_the_oldest_is_dropped_first_and_counted() -> None:
    with linked(mode="client", connect=("tcp/127.0.0.1:1",), queue=14, drives=("left",)) as link:
        for number in range(10):
            link.publish(snapshot("left", number))
        topics = sum(1 for topic in TOPICS if topic not in ("event", "meta"))
        assert link.health().figures["queued"] == 14
        assert link.health().figures["dropped"] == 10 * topics - 14


def test_liveliness_tells_that_a_drive_is_there_and_that_it_is_gone() -> None:
    port = free_port()
    with peer("router", port) as router:
        router.ready()
        with linked(mode="client", connect=(f"tcp/127.0.0.1:{port}",), drives=("left",)) as link:
            until(lambda: link.health().state == "ok")
            with peer("liveliness", port, f"{ROOT}/left") as watcher:
                seen = {watcher.line(), watcher.line()}
                assert seen == {"ready", f"PUT {ROOT}/left"}
                assert link.stop(3.0)
                assert watcher.line() == f"DELETE {ROOT}/left"


def test_a_gateway_that_takes_the_name_of_another_says_so() -> None:
    port = free_port()
    with peer("router", port) as router:
        router.ready()
        endpoint = (f"tcp/127.0.0.1:{port}",)
        with linked(mode="client", connect=endpoint) as first:
            until(lambda: first.health().state == "ok")
            with peer("liveliness", port, f"{ROOT}/_gateway") as watcher:
                assert {watcher.line(), watcher.line()} == {"ready", f"PUT {ROOT}/_gateway"}
            with linked(mode="client", connect=endpoint) as second:
                until(lambda: second.health().state == "degraded")
                assert f"called itself {ROOT}" in second.health().reason


def test_history_and_the_latest_message_are_answered_and_bad_questions_refused() -> None:
    port = free_port()
    asked: list[str] = []

    def history(drive: str, parameters: Mapping[str, str]) -> list[dict[str, Any]]:
        asked.append(drive)
        if parameters.get("since", "0") != "0":
            raise ValueError("since: 'yesterday': expected seconds")
        assert threading.current_thread().name == "zenoh-history"
        return [{"drive": drive, "time_s": 1.0, "stiffness": 2.0}]

    with linked(history, mode="peer", listen=(f"tcp/127.0.0.1:{port}",)) as link:
        until(lambda: link.health().state == "ok")
        link.publish(snapshot("left"))
        with peer("get", port, f"{ROOT}/left/history?since=0") as asker:
            (row,) = asker.messages(lambda rows: len(rows) == 1)
            assert row["rows"] == [{"drive": "left", "time_s": 1.0, "stiffness": 2.0}] and row["historical"]
        with peer("get", port, f"{ROOT}/*/history") as asker:
            rows = asker.messages(lambda rows: len(rows) == 2)
            assert {row["drive"] for row in rows} == {"left", "right"}
        assert sorted(asked) == ["left", "left", "right"], "the store is asked once for each drive"
        with peer("get", port, f"{ROOT}/left/history?since=yesterday") as asker:
            (row,) = asker.messages(lambda rows: len(rows) == 1)
            assert row["error"] == "since: 'yesterday': expected seconds"
        with peer("get", port, f"{ROOT}/left/stiffness") as asker:
            (row,) = asker.messages(lambda rows: len(rows) == 1)
            assert row["estimates"]["stiffness"]["value"] == 31_000.0 and row["historical"]


def test_an_endpoint_in_use_is_said_and_taken_when_it_is_free() -> None:
    with socket.socket() as occupier:
        occupier.bind(("127.0.0.1", 0))
        occupier.listen()
        port = occupier.getsockname()[1]
        link = ZenohLink(Zenoh(listen=(f"tcp/127.0.0.1:{port}",)), Gateway(), ("left",))
        link.start()
        until(lambda: link.health().state == "down")
        assert "in use" in link.health().reason
    until(lambda: link.health().state == "ok")
    assert link.stop(3.0)


class Wedged:
    """A session whose calls hang, as Zenoh's may."""

    def __init__(self, hang: str) -> None:
        self.hang = hang
        self.release = threading.Event()
        self.hanging = threading.Event()

    def __call__(self, _: Zenoh) -> Wedged:
        return self

    def _maybe(self, name: str) -> None:
        if name == self.hang:
            self.hanging.set()
            self.release.wait(30.0)

    def is_alive(self, _: str) -> bool:
        return False

    def announce(self, *_: object) -> None: ...

    def reachable(self) -> bool:
        return True

    def neighbours(self) -> int:
        return 1

    def heard(self, _: str) -> bool:
        return True

    def put(self, *_: object) -> None:
        self._maybe("put")

    def close(self) -> None:
        self._maybe("close")


@pytest.mark.parametrize("hang", ["put", "close"])
def test_a_hanging_call_neither_stops_the_caller_nor_outlives_the_deadline(hang: str) -> None:
    session = Wedged(hang)
    link = ZenohLink(Zenoh(every_s=0.0, queue=20), Gateway(), ("left",), open_session=session)  # type: ignore[arg-type]
    link.start()
    until(lambda: link.health().state == "ok")
    for number in range(100):
        link.publish(snapshot("left", number))
    began_s = time.monotonic()
    assert not link.stop(0.2)
    assert time.monotonic() - began_s < 2.0
    session.release.set()


def test_a_blocked_send_is_reported() -> None:
    now_s = [100.0]
    session = Wedged("put")
    link = ZenohLink(Zenoh(), Gateway(), ("left",), open_session=session, monotonic=lambda: now_s[0])  # type: ignore[arg-type]
    link.start()
    link.publish(snapshot("left"))
    assert session.hanging.wait(10.0)
    now_s[0] += 5.0
    assert (link.health().state, link.health().reason) == ("degraded", "sending has been blocked for 5 s")
    session.release.set()
    link.stop(2.0)


def test_a_session_that_fails_is_opened_again() -> None:
    opened: list[int] = []

    class Failing(Wedged):
        def put(self, *_: object) -> None:
            if len(opened) == 1:
                raise SessionError("session closed")

    def open_session(_: Zenoh) -> Any:
        opened.append(1)
        return Failing("")

    link = ZenohLink(Zenoh(every_s=0.0), Gateway(), ("left",), open_session=open_session)
    link.start()
    link.publish(snapshot("left"))
    until(lambda: link.health().figures["published"] >= 7 and len(opened) == 2)
    assert link.health().figures["dropped"] == 0
    assert link.stop(2.0)


def test_a_link_that_is_off_does_nothing_and_says_so() -> None:
    link = ZenohLink(Zenoh(enabled=False), Gateway(), ("left",))
    link.start()
    link.publish(snapshot("left"))
    assert link.health().state == "off" and link.health().figures["queued"] == 0
    assert link.stop(0.1)


def test_a_taken_port_and_a_router_that_is_not_there_are_told_in_plain_words() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(SessionError, match=f"^cannot listen on {endpoint}: Address already in use$"):
            Session(Zenoh(listen=(endpoint,)))
    with pytest.raises(SessionError, match=f"^nobody answers at {endpoint}$"):
        Session(Zenoh(mode="client", connect=(endpoint,)))


@pytest.mark.parametrize("every_s", [0.3, 1.0, 5.0])
def test_a_drive_sends_no_more_than_its_share_whatever_happens(every_s: float) -> None:
    """An hour in which the state flickers, with an event a minute and the introduction every ten seconds."""
    now_s = [0.0]
    composer = Composer(1, every_s, lambda: now_s[0], Zenoh().most_bytes_per_s)
    meta = composer.of_meta(
        "left", 0.0, birth(gear="CSG-20-100", model={"balance": "torsion"}, versions={"daemon": "1"})
    )
    sent, rounds, early = 0, 0, 0
    for second in range(3600):
        now_s[0] = float(second)
        reason = f"reason {second // 3}"
        state = Snapshot(
            "left", second, 1e9 + second / 7, NE107(second // 2 % 5), (reason,), snapshot("left").estimates
        )
        messages = composer.of_snapshot(state)
        rounds += len(messages) > 1
        early += len(messages) > 1 and second < 15
        if second % 60 == 0:
            messages.append(composer.of_event(Event("left", 4.0, NE107.OK, "daemon", reason)))
        if second % 10 == 0:
            composer.charge([meta])
            messages.append(meta)
        sent += sum(len(message.payload(historical=False)) for message in messages)
    assert sent < 2000.0 * (3600 + CREDIT_S) + 10_000
    assert early >= 15 / max(every_s, 1.0) - 1, "who has just come to look sees it move"
    assert rounds > 3600 / 10.0, "and yet it says all it knows every ten seconds"
