"""What the daemon keeps on disk, asked by the fleet."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from edge_daemon.config.settings import StoreSettings
from edge_daemon.publish.messages import Message, reply
from edge_daemon.records import NE107, Estimate, Snapshot, Status
from edge_daemon.service.daemon import LEAST_COMMIT_S, commit_within_s
from edge_daemon.service.history import MOST_MESSAGES, History


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"limit": "nan"}, "limit: 'nan' is not a number"),
        ({"limit": "0"}, "limit: '0': expected at least 1"),
        ({"limit": "-5"}, "limit: '-5': expected at least 1"),
        ({"since_s": "yesterday"}, "since_s: 'yesterday' is not a number"),
        ({"from": "5"}, "from: unknown parameter: expected some of names, since_s, until_s, limit"),
        ({"since_s": "20", "until_s": "10"}, "until_s: '10': expected after since_s"),
        ({"names": "stifness"}, "names: 'stifness' is not estimated"),
    ],
)
def test_a_question_that_makes_no_sense_says_why(tmp_path: Path, parameters: dict[str, str], complaint: str) -> None:
    history = History(StoreSettings(file="s.sqlite"), tmp_path)
    assert history.history("axis-1", {"since_s": "-60", "_time": "[..]"}) == []
    with pytest.raises(ValueError, match=complaint):
        history.history("axis-1", parameters)
    assert history.history("axis-1", {"limit": "inf"}) == []
    history.close()


def test_a_time_below_nought_counts_back_from_the_newest_data(tmp_path: Path) -> None:
    history = History(StoreSettings(file="s.sqlite"), tmp_path)
    for time_s in (1000.0, 1100.0, 1190.0, 1200.0):
        row = Estimate("stiffness", time_s, 1.0, "N m/rad", Status.VALID, time_s)
        history.add_snapshot(Snapshot("axis-1", 1, time_s, NE107.OK, (), {"stiffness": row}))
    history.commit()
    asked = {"names": "stiffness", "since_s": "-100.5", "until_s": "-5"}
    assert [row["value"] for row in history.history("axis-1", asked)] == [1100.0, 1190.0]
    history.close()


def test_the_past_has_a_number_only_where_it_was_usable(tmp_path: Path) -> None:
    """As the messages had it at their time: who draws it need not know what a status means."""
    history = History(StoreSettings(file="s.sqlite"), tmp_path)
    for time_s, status in ((1000.0, Status.WARMING_UP), (1100.0, Status.VALID), (1200.0, Status.INVALID)):
        row = Estimate("stiffness", 2e4, 1.0, "N m/rad", status, time_s)
        history.add_snapshot(Snapshot("axis-1", 1, time_s, NE107.OK, (), {"stiffness": row}))
    history.commit()
    found = history.history("axis-1", {"names": "stiffness"})
    assert [(row["value"], row["sd"]) for row in found] == [(None, None), (2e4, 1.0), (None, None)]
    assert [row["status"] for row in found] == ["warming_up", "valid", "invalid"]
    history.close()


def test_a_limit_is_of_all_rows_and_keeps_the_newest(tmp_path: Path) -> None:
    history = History(StoreSettings(file="s.sqlite"), tmp_path)
    for time_s in (1000.0, 1100.0):
        rows = {
            name: Estimate(name, time_s, 1.0, "1", Status.VALID, time_s) for name in ("stiffness", "damping", "ratio")
        }
        history.add_snapshot(Snapshot("axis-1", 1, time_s, NE107.OK, (), rows))
    history.commit()
    found = history.history("axis-1", {"names": "stiffness,damping,ratio", "limit": "2"})
    assert [row["value"] for row in found] == [1100.0, 1100.0]
    history.close()


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"until_s": "5"}, "since_s: missing: expected a number"),
        ({"since_s": "5"}, "until_s: missing: expected a number"),
        ({"since_s": "5", "until_s": "nan"}, "until_s: 'nan' is not a number"),
    ],
)
def test_a_trend_without_its_span_is_refused(tmp_path: Path, parameters: dict[str, str], complaint: str) -> None:
    history = History(StoreSettings(file="s.sqlite"), tmp_path)
    with pytest.raises(ValueError, match=complaint):
        history.trend("axis-1", parameters)
    history.close()


@pytest.mark.parametrize("usual_s", [1.0, 5.0, 30.0])
def test_a_cut_costs_at_most_the_stated_seconds_and_half_of_a_young_run(usual_s: float) -> None:
    age_s = 0.0
    while age_s < 300.0:
        wait_s = commit_within_s(age_s, usual_s)
        assert LEAST_COMMIT_S <= wait_s <= usual_s and (wait_s <= LEAST_COMMIT_S or wait_s <= 0.5 * age_s)
        age_s += wait_s
    assert commit_within_s(age_s, usual_s) == usual_s


def message(number: int, run: int = 5, topic: str = "load") -> Message:
    return Message("axis-1", topic, number, run, 1000.0 + number, {"estimates": {"torque_rms": {"value": number / 7}}})


def test_what_was_published_is_repeated_by_its_number_and_marked(tmp_path: Path) -> None:
    """Across a restart, and as it was: no more than was asked for, and only of that run and topic."""
    for run in (5, 6):
        history = History(StoreSettings(file="s.sqlite"), tmp_path)
        history.add_messages([message(n, run) for n in range(300)])
        history.add_messages([message(0, run, "meta")])
        history.close()
    history = History(StoreSettings(file="s.sqlite"), tmp_path)
    listed = history.answer("axis-1", {"runs": "1", "since_s": "-1", "limit": "1"})
    assert isinstance(listed, dict)
    spans = {(row["run"], row["topic"]): (row["first"], row["last"]) for row in listed["runs"]}
    assert spans == {(r, t): (0, n) for r in (5, 6) for t, n in (("load", 299), ("meta", 0))}
    asked = {"run": "5", "topic": "load", "first": "7", "last": "9"}
    found = json.loads(reply("axis-1", history.answer("axis-1", asked)))
    assert [row["sequence"] for row in found["messages"]] == [7, 8, 9]
    assert found["messages"][0] == json.loads(message(7).payload(historical=True)) and found["historical"]
    most = json.loads(reply("axis-1", history.answer("axis-1", {"run": "6", "topic": "load"})))
    assert [row["sequence"] for row in most["messages"]] == list(range(MOST_MESSAGES))
    assert history.answer("axis-2", {"runs": "1"}) == {"rows": [], "runs": []}
    for wrong in (
        {"run": "x", "topic": "load"},
        {"run": "5", "topic": "lod"},
        {"run": "5", "topic": "load", "at": "1"},
    ):
        with pytest.raises(ValueError, match="expected"):
            history.answer("axis-1", wrong)
    history.close()
