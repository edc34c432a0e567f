"""State, reasons, hysteresis, latching and acknowledgement."""

from __future__ import annotations

import math

import pytest

from edge_daemon.health.alarms import AlarmBook, Finding
from edge_daemon.health.judge import HealthJudge
from edge_daemon.records import NE107, Estimate, SourceHealth, Status
from edge_daemon.usage.gears import find_gear


def told(**values: float) -> dict[str, Estimate]:
    return {name: Estimate(name, value, 0.01, "1", Status.VALID, 0.0) for name, value in values.items()}


def source(state: str) -> SourceHealth:
    return SourceHealth("can0", state, "bus-off", 0.0, {})


def test_a_quiet_drive_is_ok() -> None:
    health = HealthJudge("axis").judge(0.0, told(damage=0.1, stiffness_change=-0.02), [source("ok")])
    assert (health.state, health.reasons, health.events) == (NE107.OK, (), ())
    assert health.index.value == pytest.approx(0.9)


def test_nothing_known_is_no_health() -> None:
    index = HealthJudge("axis").judge(0.0, {}).index
    assert index.status is Status.WARMING_UP
    assert math.isnan(index.value)


def test_a_source_that_fails_is_a_function_check_and_clears() -> None:
    judge = HealthJudge("axis")
    assert judge.judge(0.0, {}, [source("down")]).state is NE107.OK
    health = judge.judge(6.0, {}, [source("down")])
    assert health.state is NE107.FUNCTION_CHECK
    assert "bus-off" in health.reasons[0]
    assert [event.severity for event in health.events] == [NE107.FUNCTION_CHECK]
    judge.judge(7.0, {}, [source("ok")])
    assert judge.judge(13.0, {}, [source("ok")]).state is NE107.OK


def test_a_bus_without_frames_is_one_alarm_and_not_one_per_channel() -> None:
    channels = ("theta_in_rad", "theta_out_rad")
    judge = HealthJudge("axis", source_of=dict.fromkeys(channels, "can0") | {"pressure_Pa": "housing"})
    silent = {**dict.fromkeys(channels, 1.0), "pressure_Pa": 1.0}
    for now_s in (0.0, 6.0):
        health = judge.judge(now_s, {}, [source("degraded")], silent)
    assert health.state is NE107.FUNCTION_CHECK
    assert [reason.split(":")[0] for reason in health.reasons] == [
        "source can0 gives no usable theta_in_rad, theta_out_rad (bus-off)",
        "channel pressure_Pa",  # its source says that it is well: the channel has its own reason
    ]


def test_temperature_has_hysteresis() -> None:
    judge = HealthJudge("axis")
    temperatures = [81, 81, 78, 81, 78, 74, 74, 78]
    states = [judge.judge(100.0 * i, told(temperature=t)).state for i, t in enumerate(temperatures)]
    hot, cool = NE107.OUT_OF_SPECIFICATION, NE107.OK
    assert states == [cool, hot, hot, hot, hot, hot, cool, cool]


def test_an_overload_latches_until_acknowledged() -> None:
    judge = HealthJudge("axis", find_gear("CSG-20-100"))
    assert judge.judge(0.0, told(torque_peak=200.0)).state is NE107.OUT_OF_SPECIFICATION
    later = judge.judge(60.0, told(torque_peak=50.0))
    assert later.state is NE107.OUT_OF_SPECIFICATION
    assert "acknowledge" in later.reasons[0]
    assert len(judge.acknowledge(70.0)) == 1
    assert judge.judge(80.0, told(torque_peak=50.0)).state is NE107.OK


def test_ratcheting_is_counted_from_where_it_stood_and_survives_a_restart() -> None:
    judge = HealthJudge("axis")
    assert judge.judge(0.0, told(ratcheting_events=3)).state is NE107.OK
    assert judge.judge(1.0, told(ratcheting_events=4)).state is NE107.FAILURE
    reborn = HealthJudge("axis")
    assert reborn.restore(judge.state())
    assert reborn.judge(2.0, told(ratcheting_events=4)).state is NE107.FAILURE
    assert not HealthJudge("other").restore(judge.state())
    reborn.acknowledge(3.0)
    assert reborn.judge(4.0, told(ratcheting_events=4)).state is NE107.OK


def test_worst_reason_first() -> None:
    judge = HealthJudge("axis")
    for now in (0.0, 100.0):
        health = judge.judge(now, told(damage=0.9, temperature=90.0), flawed={"theta_in_rad": 0.9})
    assert health.state is NE107.FUNCTION_CHECK
    assert [text.split()[0] for text in health.reasons] == ["channel", "housing", "90%"]


def test_a_warming_up_number_raises_nothing() -> None:
    unsure = {"rul_p10_h": Estimate("rul_p10_h", 1.0, 1.0, "h", Status.WARMING_UP, 0.0)}
    judge = HealthJudge("axis")
    judge.judge(0.0, unsure)
    assert judge.judge(1000.0, unsure).state is NE107.OK


def finding(active: bool, delay_s: float = 10.0) -> Finding:
    return Finding("x", NE107.FAILURE, active, active, "broken", delay_s=delay_s)


def test_what_was_about_to_be_raised_begins_anew_after_a_restart() -> None:
    book, reborn = AlarmBook("axis"), AlarmBook("axis")
    book.update(0.0, [finding(True)])
    assert reborn.restore(book.state())
    assert reborn.update(3600.0, [finding(True)]) == []
    assert len(reborn.update(3610.0, [finding(True)])) == 1


def test_a_flickering_cause_raises_nothing() -> None:
    book = AlarmBook("axis")
    for i in range(100):
        assert book.update(4.0 * i, [finding(i % 2 == 0)]) == []


def test_an_acknowledged_alarm_that_returns_is_new() -> None:
    book = AlarmBook("axis")
    book.update(0.0, [finding(True, 0.0)])
    book.acknowledge(1.0, "x")
    book.update(2.0, [finding(False, 0.0)])
    events = book.update(3.0, [finding(True, 0.0)])
    assert [event.message for event in events] == ["broken"]
    assert not book.raised[0].acknowledged


def test_one_of_two_alarms_is_acknowledged_by_name() -> None:
    book = AlarmBook("axis")
    rows = [Finding(key, NE107.FAILURE, True, True, f"{key} broken") for key in ("x", "y")]
    book.update(0.0, rows)
    (event,) = book.acknowledge(1.0, "x", "Ida")
    assert (event.time_s, event.source, event.message) == (1.0, "x", "acknowledged by Ida: x broken")
    assert [(row.key, row.acknowledged) for row in book.raised] == [("x", True), ("y", False)]
    assert [event.source for event in book.acknowledge(2.0)] == ["y"]


def test_a_clock_that_steps_back_delays_but_does_not_stick() -> None:
    book = AlarmBook("axis")
    book.update(1000.0, [finding(True)])
    book.update(0.0, [finding(True)])
    assert not book.raised
    book.update(11.0, [finding(True)])
    assert book.raised
