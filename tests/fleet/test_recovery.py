"""What is asked of a gateway, and what is made of its answers, without a network."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

from edge_daemon.fleet.recovery import PAGE, Recovery
from edge_daemon.fleet.spans import Spans

DRIVE = "hall-1/cell-1/axis-1"
Answer = tuple[str, bytes | None, str]


class Gateway:
    """Answers as it is told to; what is repeated is counted as there."""

    def __init__(self, answers: Callable[[dict[str, str]], dict[str, Any] | str | bytes | None], there: Spans) -> None:
        self.answers, self.there = answers, there
        self.asked: list[dict[str, str]] = []
        self.done = threading.Event()

    def get(self, selector: str, within_s: float) -> Iterator[Answer]:
        question = dict(part.split("=", 1) for part in selector.partition("?")[2].split(";") if part)
        self.asked.append(question)
        found = self.answers(question) if question else None
        if isinstance(found, str):
            yield "", None, found
        elif found is not None:
            yield selector, found if isinstance(found, bytes) else json.dumps(found).encode(), ""

    def feed(self, key: str, payload: bytes) -> None:
        message = json.loads(payload)
        assert key == f"strainwave/v1/{DRIVE}/load" and message["historical"]
        self.there.add(message["sequence"], 0.0)

    def recover(self, turns: int = 1) -> Recovery:
        """So many turns, each to its end."""
        recovery = Recovery(self, lambda drive: {"load": {5: self.there}}, self.feed)  # type: ignore[arg-type]
        gate = threading.Event()
        for _ in range(turns):
            recovery.look(DRIVE, 0.0)
            recovery.turn(lambda drive: True)
            for _ in range(500):
                if not recovery.busy:
                    break
                gate.wait(0.01)
        recovery.close()
        return recovery


def stored(question: dict[str, str], first: int = 0, last: int = 999) -> dict[str, Any]:
    """A ring that holds these numbers."""
    if "run" not in question:
        return {"runs": [{"run": 5, "topic": "load", "first": first, "last": last}]}
    span = range(int(question["first"]), min(int(question["last"]), last) + 1)
    return {"messages": [{"run": 5, "sequence": n, "estimates": {}} for n in span][: int(question["limit"])]}


def spans(*numbers: int) -> Spans:
    found = Spans()
    for number in numbers:
        found.add(number, float(number))
    return found


def test_what_is_missing_is_asked_for_page_by_page_and_nothing_else() -> None:
    gateway = Gateway(stored, spans(*range(100), *range(900, 1000)))
    recovery = gateway.recover()
    assert len(gateway.there) == 1000 and recovery.repeated == 800 and recovery.lost() == 0
    assert len(gateway.asked) == 1 + 800 // PAGE


def test_what_the_ring_no_longer_has_is_lost_and_asked_for_once() -> None:
    gateway = Gateway(lambda question: stored(question, 50, 60), spans(0, 55))
    recovery = gateway.recover(2)
    assert recovery.lost() == 49 and len(gateway.there) == 12
    assert sum("run" in question for question in gateway.asked) == 2


def test_a_store_that_cannot_be_read_now_has_lost_nothing() -> None:
    refusals = iter(["too many history queries at once: ask again later", "the store cannot be read now"])

    def answers(question: dict[str, str]) -> dict[str, Any] | str:
        return next(refusals, None) or stored(question, 0, 9)

    gateway = Gateway(answers, spans(0, 9))
    recovery = gateway.recover(3)
    assert len(gateway.there) == 10 and recovery.lost() == 0


def test_answers_that_make_no_sense_end_and_cost_nothing() -> None:
    odd: list[Any] = [
        {"runs": [{"run": 5, "topic": "load", "first": 0, "last": 9}, 7, {"run": "x"}]},
        {"messages": [{"sequence": -n} for n in range(300)] + [8, None]},
    ]
    gateway = Gateway(lambda question: odd["run" in question], spans(0, 9))
    gateway.feed = lambda key, payload: None  # type: ignore[method-assign]
    assert gateway.recover().lost() == 8
    assert Gateway(lambda question: None, spans(0, 9)).recover().lost() == 0
    assert Gateway(lambda question: b'{"runs": "\xe2x"}', spans(0, 9)).recover().lost() == 0
