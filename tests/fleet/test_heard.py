"""What becomes of a message: a row a number, and nothing of what is no message."""

from __future__ import annotations

import json
from typing import Any

import pytest

from edge_daemon.fleet.heard import MOST_BYTES, Unheard, heard, rows_beside
from edge_daemon.publish.messages import Composer, birth
from edge_daemon.records import NE107, Estimate, Event, Snapshot, Status

HEAD: dict[str, Any] = {"run": 1, "sequence": 2, "time_s": 3.0, "historical": False}


def payload(**more: Any) -> bytes:
    return json.dumps(HEAD | more).encode()


def test_every_message_of_a_gateway_is_understood() -> None:
    row = Estimate("stiffness", 2e4, 10.0, "N m/rad", Status.VALID, 5.0)
    composer = Composer(7, 0.0)
    state = Snapshot("left", 1, 5.0, NE107.MAINTENANCE_REQUIRED, ("soft",), {"stiffness": row})
    messages = {m.topic: m for m in composer.of_snapshot(state)}
    messages["event"] = composer.of_event(Event("left", 5.0, NE107.FAILURE, "motor", "lost"))
    messages["meta"] = composer.of_meta("left", 5.0, birth(gear="CSG-20-100", model={"ratio": 100.0}, versions={}))
    found = {}
    for topic, message in messages.items():
        raw = message.payload(historical=True)
        told = heard(raw)
        assert (told.run, told.sequence, told.historical) == (7, 0, True)
        names = {name: (r.value, r.sd, r.status, r.unit) for name, r in told.estimates.items()}
        found[topic] = names | {name: rest for name, *rest in map(list, rows_beside(topic, told, raw))}
        assert found[topic]
    assert found["stiffness"]["stiffness"] == (2e4, 10.0, "valid", "N m/rad")
    assert found["stiffness"]["damping"] == (None, None, "unknown", "N m s/rad")
    assert found["health"]["ne107"] == [1.0, None, "maintenance_required", None]
    assert found["event"]["severity"] == [4.0, None, "failure", None] and found["event"]["message"][2] == "lost"
    assert found["meta"]["gear"][2] == "CSG-20-100" and found["meta"]["model.ratio"][0] == 100.0


@pytest.mark.parametrize(
    "raw",
    [
        b"", b"{", b"[]", b"7", b"\xff\xfe", b"{}", payload(run=-1), payload(sequence=2**63), payload(run="x"),
        payload(sequence=None), payload(sequence=1.5), b" " * (MOST_BYTES + 1), b"[" * 100_000,
        payload(estimates={str(i): {} for i in range(2000)}), payload().replace(b"sequence", b"sequ\xe2nce"),
        payload(estimates={"load": {}}).replace(b"load", b"lo\xe2d"),
    ],
)  # fmt: skip
def test_what_is_no_message_is_refused(raw: bytes) -> None:
    with pytest.raises(Unheard):
        heard(raw)


def test_what_is_nested_too_deep_is_refused_wherever_it_stands() -> None:
    for topic in ("meta", "life"):
        with pytest.raises(Unheard):
            raw = payload()[:-1] + b', "model": ' + b"[" * 50_000 + b"]" * 50_000 + b"}"
            rows_beside(topic, heard(raw), raw)


def test_a_part_that_is_not_as_expected_costs_no_more_than_itself() -> None:
    odd = {"a": {"value": "high"}, "b": 5, "c": None, "d": {"value": 1.0, "sd": [], "unit": "m"}}
    told = heard(payload(estimates=odd, ne107="bad"))
    assert {name: row.value for name, row in told.estimates.items()} == {"a": None, "b": 5.0, "c": None, "d": 1.0}
    assert told.estimates["d"].unit == "m" and told.ne107 is None


def test_a_message_without_numbers_still_stands() -> None:
    raw = payload(estimates={})
    assert rows_beside("health", heard(raw), raw) == [("health", None, None, None, None)]


def test_a_state_that_no_float_holds_is_unknown_and_no_fault() -> None:
    raw = payload(ne107=10**400, state="ok")
    assert rows_beside("health", heard(raw), raw)[-1] == ("ne107", None, None, "ok", None)
