"""The collector between a router and gateways that come, go and are cut off; nothing is lost and nothing is twice."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import duckdb
import pytest

from edge_daemon.cli import main
from edge_daemon.config.settings import Gateway, StoreSettings, Zenoh
from edge_daemon.fleet.collector import Collector
from edge_daemon.publish.zenoh_link import ZenohLink
from edge_daemon.records import NE107, Estimate, Event, Snapshot, Status
from edge_daemon.service.history import History
from tests.publish.test_zenoh_link import Peer, free_port, peer
from tools.fleet_sim import SimDrive, SimGateway, open_session

WITHIN_S = 40.0
pytestmark = pytest.mark.timeout(90)


@pytest.fixture
def endpoint() -> Iterator[str]:
    port = free_port()
    with peer("router", port) as router:
        router.ready()
        yield f"tcp/127.0.0.1:{port}"


@contextmanager
def collecting(endpoint: str, folder: Path) -> Iterator[Collector]:
    collector = Collector([endpoint], folder)
    thread = threading.Thread(target=collector.run)
    thread.start()
    try:
        yield collector
    finally:
        collector.stop()
        thread.join(20.0)
        assert not thread.is_alive()


def held(folder: Path) -> dict[str, dict[str, int]]:
    """Stream -> run -> how many messages; fails where a row stands twice."""
    if not list(folder.glob("site=*/date=*/*.parquet")):
        return {}
    table = f"read_parquet('{folder}/site=*/date=*/*.parquet', hive_partitioning = true)"
    known = "(site, gateway, drive, run, topic, sequence, name)"
    twice = duckdb.sql(f"SELECT count(*) - count(DISTINCT {known}) FROM {table}").fetchall()
    assert twice == [(0,)]
    stream = "concat_ws('/', site, gateway, drive, topic)"
    found: dict[str, dict[str, int]] = {}
    query = f"SELECT {stream}, run, count(DISTINCT sequence) FROM {table} GROUP BY ALL"
    for key, run, count in duckdb.sql(query).fetchall():
        found.setdefault(key, {})[str(run)] = count
    return found


def until(folder: Path, wanted: Callable[[], Any]) -> None:
    """Bounded; what is missing is shown."""
    end_s, gate = time.monotonic() + WITHIN_S, threading.Event()
    while held(folder) != wanted():
        if time.monotonic() > end_s:
            assert held(folder) == wanted()
        gate.wait(0.2)


def gateway(name: str, answers: str, drives: int = 2) -> SimGateway:
    return SimGateway("hall-1", name, [SimDrive(f"axis-{i}", i) for i in range(drives)], answers)


@pytest.mark.slow
def test_what_gateways_measured_offline_and_before_is_asked_for(endpoint: str, tmp_path: Path) -> None:
    """An hour without network, a restart in it, and the numbers from before anybody listened; of a gateway that knows
    its numbers, and of one that answers by time only."""
    sims, now_s = [gateway("cell-1", "number"), gateway("cell-2", "time")], time.time() - 7200.0
    sessions = [open_session(endpoint) for _ in sims]
    for sim in sims:
        for second in range(5):
            sim.publish(now_s + second)
    with collecting(endpoint, tmp_path):
        for sim, session in zip(sims, sessions, strict=True):
            sim.connect(session)
        gate, turns = threading.Event(), 0
        while len({stream.split("/")[1] for stream in held(tmp_path)}) < len(sims):  # until somebody hears both
            for sim in sims:
                sim.publish(now_s + 5.0 + turns)
            turns += 1
            gate.wait(0.2)
        until(tmp_path, lambda: _numbered(sims))
        for sim in sims:
            sim.disconnect()
            for second in range(7, 1207):
                sim.publish(now_s + 200.0 + 3 * second)
        sims[0].restart()  # of the run before nobody would hear any more, were it asked by time
        sims[0].publish(now_s + 3822.0)
        for sim, session in zip(sims, sessions, strict=True):
            sim.connect(session)
            sim.publish(now_s + 3825.0)
        until(tmp_path, lambda: _numbered(sims))
    for session in sessions:
        session.close()


def _numbered(sims: list[SimGateway]) -> dict[str, dict[str, int]]:
    """What can be had of gateways; of one that answers by time only what is estimated."""
    return {
        key: runs
        for sim in sims
        for key, runs in sim.published().items()
        if sim.answers == "number" or not key.endswith("/meta")
    }


def command(endpoint: str, folder: Path) -> subprocess.Popen[str]:
    words = ["-m", "edge_daemon", "fleet", "collect", "--connect", endpoint, "--out", str(folder)]
    return subprocess.Popen([sys.executable, *words], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


@pytest.mark.slow
def test_collectors_killed_and_side_by_side_write_each_row_once(tmp_path: Path) -> None:
    """Two on one folder and one on another; one is killed again and again, then the router goes and comes back."""
    port = free_port()
    endpoint, shared, own = f"tcp/127.0.0.1:{port}", tmp_path / "shared", tmp_path / "own"
    router = Peer("router", port).ready()
    session, sims = open_session(endpoint), [gateway(f"cell-{i}", "number", 4) for i in range(3)]
    for sim in sims:
        sim.connect(session)
    running = [command(endpoint, shared), command(endpoint, shared), command(endpoint, own)]
    gate = threading.Event()
    try:
        for turn in range(40):
            for sim in sims:
                sim.publish(time.time())
            if turn % 10 == 9:
                running[0].kill()
                running[0].communicate()
                running[0] = command(endpoint, shared)
            if turn == 25:
                router.end()
            if turn == 30:
                router = Peer("router", port).ready()
            gate.wait(0.2)
            held(shared)

        def wanted() -> dict[str, dict[str, int]]:
            return {key: runs for sim in sims for key, runs in sim.published().items()}

        until(shared, wanted)
        until(own, wanted)
        for process in running:
            process.terminate()
            assert process.wait(20.0) == 0
        assert held(shared) == held(own) == wanted()
    finally:
        for process in running:
            process.kill()
            process.communicate()
        session.close()
        router.end()


@pytest.mark.slow
def test_a_gateway_as_it_is_has_its_past_repeated_by_number(endpoint: str, tmp_path: Path) -> None:
    """The gateway's own link and store: an outage longer than its queue, and a restart while nobody listens."""
    history = History(StoreSettings(file="s.sqlite"), tmp_path)
    sent: dict[tuple[str, int, str], set[int]] = {}

    def keep(messages: Any) -> None:
        history.add_messages(messages)
        for row in messages:
            sent.setdefault((row.drive, row.run, row.topic), set()).add(row.sequence)

    def link() -> ZenohLink:
        settings = Zenoh(mode="client", connect=(endpoint,), every_s=0.0, queue=20)
        return ZenohLink(settings, Gateway(site="hall-2", name="gw-1"), ("left",), history.answer, keep=keep)

    first = link()  # never started, as if the cable were out: all but the newest twenty messages fall out of its queue
    for number in range(100):
        first.publish(snapshot(number))
    first.event(Event("", 5.0, NE107.OK, "daemon", "measuring"))
    history.commit()
    with collecting(endpoint, tmp_path / "out") as collector:
        second = link()
        second.start()
        for number in range(100, 110):
            second.publish(snapshot(number))
        history.commit()

        def wanted() -> dict[str, dict[str, int]]:
            found: dict[str, dict[str, int]] = {}
            for (drive, run, topic), numbers in sent.items():
                found.setdefault(f"hall-2/gw-1/{drive}/{topic}", {})[str(run)] = len(numbers)
            return found

        until(tmp_path / "out", wanted)
        assert second.stop(3.0)
        assert collector.figures()["lost"] == 0
    table = f"read_parquet('{tmp_path}/out/site=*/date=*/*.parquet')"
    value = f"SELECT value, historical FROM {table} WHERE name = 'stiffness' AND sequence = 42"
    assert duckdb.sql(value).fetchall() == [(42.0, True)]
    history.close()


def snapshot(number: int) -> Snapshot:
    row = Estimate("stiffness", float(number), 1.0, "N m/rad", Status.VALID, 1e9 + number)
    return Snapshot("left", number, 1e9 + number, NE107.OK, (), {"stiffness": row})


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--connect", "7447", "--out", "x"], "expected such as tcp/127.0.0.1:7447"),
        (["--connect", "tcp/127.0.0.1:1", "--out", "x", "--seconds", "-1"], "--seconds -1: expected more than 0"),
        (["--connect", "tcp/127.0.0.1:1", "--out", "/proc/x"], "/proc/x: cannot be written"),
        (["--connect", "tcp/127.0.0.1:1", "--out", "x", "--zenoh", "nothing.json5"], "nothing.json5"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_line(
    words: list[str],
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["fleet", "collect", *words]) == 2
    told = capsys.readouterr().err
    assert complaint in told and told.count("\n") == 1
