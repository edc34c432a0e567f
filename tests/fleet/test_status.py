"""All drives, worst first, and who is silent: asked of gateways that speak, are gone, or only pretend to be there."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edge_daemon.cli import main
from edge_daemon.fleet.status import DriveStatus, take
from tests.fleet.test_dataset import DAY, Dataset, batch
from tests.publish.test_zenoh_link import ROOT, free_port, linked, peer, snapshot, until
from tools.fleet_sim import SimDrive, SimGateway, open_session

pytestmark = pytest.mark.timeout(60)


@pytest.fixture
def endpoint() -> Iterator[str]:
    port = free_port()
    with peer("router", port) as router:
        router.ready()
        yield f"tcp/127.0.0.1:{port}"


def asked(capsys: pytest.CaptureFixture[str], endpoint: str, *more: str) -> dict[str, Any]:
    assert main(["fleet", "status", "--connect", endpoint, "--json", "-", *more]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_the_worst_stands_first_and_the_silent_are_named(
    endpoint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One gateway that answers, one drive with a token and nothing to say, one that only the dataset remembers."""
    Dataset(tmp_path, 0).append(("hall 2", DAY), batch(0, 0))
    session = open_session(endpoint)
    token = session.liveliness().declare_token("strainwave/v1/hall-3/cell-1/axis-9")
    with linked(mode="client", connect=(endpoint,)) as link:
        until(lambda: link.health().state == "ok")
        link.publish(snapshot("left", 1, 0.5))
        found = asked(capsys, endpoint, "--known", str(tmp_path))
    rows = {f"{row['site']}/{row['gateway']}/{row['drive']}": row for row in found["drives"]}
    left = ROOT.removeprefix("strainwave/v1/") + "/left"
    assert set(found["silent"]) == set(rows) - ({left} if not rows[left]["silent"] else set())
    assert (rows[left]["state"], rows[left]["ne107"], rows[left]["reasons"]) == (
        "maintenance_required", 1, ["stiffness fell"],
    )  # fmt: skip
    assert "nothing new for" in rows[left]["silent_because"], "its data are of 1970"
    assert rows["hall-3/cell-1/axis-9"]["silent_because"] == "its token stands, but it says nothing"
    assert rows["hall 2/cell-7/axis-1"]["silent_because"] == "it is not there"
    assert [row["ne107"] for row in found["drives"]] == [1, None, None, None]
    token.undeclare()
    session.close()


def test_a_gateway_that_answers_no_question_is_heard_all_the_same(
    endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import threading

    sim = SimGateway("hall-1", "cell-1", [SimDrive(f"axis-{i}", i) for i in range(3)], "none")
    session, stop = open_session(endpoint), threading.Event()
    sim.connect(session)
    sim.drives[1].age_h = 2.0 * sim.drives[1].life_h

    def speak() -> None:
        while not stop.wait(0.2):
            sim.publish(time.time())

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        found = asked(capsys, endpoint)
    finally:
        stop.set()
        thread.join()
        session.close()
    assert found["drives"][0]["drive"] == "axis-1" and found["drives"][0]["state"] == "failure"
    assert found["silent"] == [] and len(found["drives"]) == 3
    assert all(row["rul_p50_h"] is not None and row["age_s"] < 60.0 for row in found["drives"])


def test_nobody_at_the_endpoint_is_said(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge_daemon.fleet.status.CONNECT_S", 0.5)
    assert main(["fleet", "status", "--connect", f"tcp/127.0.0.1:{free_port()}"]) == 2
    assert "nobody answers: expected a router or a gateway" in capsys.readouterr().err


def test_what_is_no_text_is_passed_over() -> None:
    """A payload that breaks off within a letter says nothing of its drive."""
    row = DriveStatus("hall/gw/axis")
    for payload in (b'{"state": "\xe2x"}', b"\xff", b"[" * 100_000):
        take(row, "health", payload)
    assert row.documents == {}
