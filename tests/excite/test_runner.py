"""Interlocks on the simulated drive: each limit, a lost encoder, a lost bus, an absent operator: each ends at rest.

What counts is the rig's own motor, not what anybody reports.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from edge_daemon.config.settings import Drive, Excite
from edge_daemon.excite.arming import NotArmed, arm
from edge_daemon.excite.drive_link import DriveRefused, LinkLost
from edge_daemon.excite.limits import LimitError
from tests.excite.drive_bench import Bench, excite, limits, sine

STANDS_RAD_S = 0.1


def test_a_profile_runs_to_its_end_and_is_marked() -> None:
    bench = Bench(excite())
    course = bench.course()
    outcome = bench.runner().run(course)
    assert outcome.completed and outcome.stopped and outcome.reason == ""
    assert bench.fastest == pytest.approx(40.0, rel=0.05)
    assert bench.speed < STANDS_RAD_S and bench.face.state == "switch on disabled"
    assert bench.face.motor.position_rad == pytest.approx(0.0, abs=0.01)
    phases = np.concatenate([row.value for row in bench.marks])
    stamps = np.concatenate([row.time_s for row in bench.marks])
    assert {row.signal for row in bench.marks} == {"axis-1.profile_phase"}
    assert [int(p) for p in dict.fromkeys(phases)] == [0, 1, 2, 3]
    assert (np.diff(stamps) > 0).all()
    steady = stamps[phases == 2]
    assert np.ptp(steady) == pytest.approx(0.6, abs=0.01)


def test_velocity_mode_follows_the_same_course() -> None:
    bench = Bench(excite(mode="velocity"))
    outcome = bench.runner().run(bench.course())
    assert outcome.completed and bench.fastest == pytest.approx(40.0, rel=0.05)
    assert bench.speed < STANDS_RAD_S


@pytest.mark.parametrize("mode", ["position", "velocity"])
@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (lambda b: setattr(b.face.motor, "load_Nm", 1.2), "torque limit"),
        (lambda b: setattr(b.face.motor, "blocked", True), "limit reached|frozen"),
        (lambda b: setattr(b.face, "frozen", True), "encoder lost|following error"),
        (lambda b: setattr(b.face, "mute", True), "stale"),
        (lambda b: b.deliver(b.face.trip()), "fault"),
        (lambda b: setattr(b, "temperature", 95.0), "temperature 95.0"),
        (lambda b: setattr(b, "temperature", math.nan), "temperature is not known"),
        (lambda b: setattr(b, "operator", False), "no sign of life"),
        (lambda b: b.dead_man.release(), "let go"),
        (lambda b: setattr(b, "wall_ahead_s", -60.0), "clock jumped"),
        (lambda b: setattr(b, "wall_ahead_s", 60.0), "clock jumped"),
        (lambda b: setattr(b.face, "state", "ready to switch on"), "left operation"),
    ],
)
def test_each_doubt_ends_in_a_standing_motor(mode: Any, fault: Any, reason: str) -> None:
    settings = excite(limits(temperature_degC=80.0), mode=mode)
    bench = Bench(settings)
    bench.at(0.55, fault)
    outcome = bench.runner().run(bench.course(sine(seconds=3.0)))
    allowed_s = settings.dead_man_s + settings.heartbeat_s + settings.stop_within_s + bench.face.stop_time_s(100.0)
    assert bench.now_s - bench.began_s < 0.55 + allowed_s + 0.2
    assert not outcome.completed
    assert re.search(reason, outcome.reason), outcome.reason
    bench.face.motor.load_Nm = 0.0
    bench.wait(settings.heartbeat_s + bench.face.stop_time_s(100.0))
    assert bench.speed < STANDS_RAD_S
    assert bench.face.state in ("switch on disabled", "fault")
    assert 10 < bench.fastest < 110  # it did move before


def test_the_stop_is_as_quick_as_stated() -> None:
    bench = Bench(excite())
    bench.at(0.55, lambda b: setattr(b.face.motor, "blocked", False) or b.deliver(b.face.trip()))
    bench.runner().run(bench.course(sine(seconds=3.0)))
    assert bench.now_s - bench.began_s < 0.55 + bench.face.stop_time_s(40.0) + 10 * bench.settings.cycle_s


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"travel_rad": 2.0}, "travel"),
        ({"speed_rad_s": 45.0}, "speed"),
        ({"acceleration_rad_s2": 1170.0}, "acceleration"),
    ],
)
def test_a_drive_that_runs_away_is_held_to_each_limit(change: dict[str, float], reason: str) -> None:
    """The profile is within the limits; the motor does more than it was told (a wrong scale in the drive)."""
    bench = Bench(excite(limits(following_error_rad=50.0, **change), mode="velocity"))
    bench.face.following_window_rad = 50.0
    bench.face.gain = 1.3
    outcome = bench.runner().run(bench.course(sine(seconds=3.0)))
    assert reason in outcome.reason and "limit reached" in outcome.reason
    bench.wait(bench.face.stop_time_s(100.0))
    assert bench.speed < STANDS_RAD_S


def foreign_sync(bench: Bench) -> None:
    if round(1000 * (bench.now_s - bench.began_s)) % 4 == 0:
        bench.deliver(bench.face.frame(0x80, b"", bench.now_s))


def test_where_another_produces_sync_the_loop_does_not() -> None:
    bench = Bench(excite(sync=False))
    bench.each_ms = foreign_sync
    outcome = bench.runner().run(bench.course())
    assert outcome.completed and bench.fastest == pytest.approx(40.0, rel=0.05)


def test_when_the_others_sync_ends_the_drive_stops_by_itself() -> None:
    bench = Bench(excite(sync=False))
    bench.each_ms = foreign_sync
    bench.at(0.55, lambda b: setattr(b, "each_ms", None))
    outcome = bench.runner().run(bench.course(sine(seconds=3.0)))
    assert "stale" in outcome.reason and outcome.stopped  # as SDO tells
    assert bench.speed < STANDS_RAD_S and bench.face.state == "switch on disabled"


@pytest.mark.parametrize("silently", [False, True])
def test_a_lost_bus_ends_in_a_drive_that_stops_itself(silently: bool) -> None:
    bench = Bench(excite())
    bench.at(0.55, lambda b: setattr(b, "deaf" if silently else "cut", True))
    outcome = bench.runner().run(bench.course(sine(seconds=3.0)))
    assert not outcome.stopped and ("stops itself" in outcome.reason or "not confirmed" in outcome.reason)
    bench.wait(bench.settings.heartbeat_s + bench.face.stop_time_s(40.0))
    assert bench.speed < STANDS_RAD_S and bench.face.state == "switch on disabled"


@pytest.mark.parametrize("mode", ["position", "velocity"])
def test_a_process_that_falls_silent_leaves_a_stopped_drive(mode: Any) -> None:
    """As after SIGKILL: not one more frame."""
    bench = Bench(excite(mode=mode))

    class Killed(BaseException):
        pass

    def kill(b: Bench) -> None:
        b.deaf = True
        raise Killed

    bench.at(0.55, kill)
    with pytest.raises(Killed):
        bench.runner().run(bench.course(sine(seconds=3.0)))
    bench.plan.clear()
    bench.wait(bench.settings.heartbeat_s + bench.face.stop_time_s(40.0))
    assert bench.speed < STANDS_RAD_S


@pytest.mark.parametrize("error", [ValueError("bad"), KeyboardInterrupt()])
def test_an_exception_in_the_loop_stops_first_and_is_raised_after(error: BaseException) -> None:
    bench = Bench(excite())

    def fail() -> str:
        if bench.now_s > bench.began_s + 0.55:
            raise error
        return ""

    with pytest.raises(type(error)):
        bench.runner(doubts=fail).run(bench.course(sine(seconds=3.0)))
    assert bench.speed < STANDS_RAD_S and bench.face.state == "switch on disabled"
    assert bench.now_s - bench.began_s < 0.55 + bench.face.stop_time_s(40.0) + 0.1


def test_another_part_of_the_daemon_may_doubt() -> None:
    bench = Bench(excite())
    late = bench.began_s + 0.5
    outcome = bench.runner(doubts=lambda: "output encoder is stale" if bench.now_s > late else "").run(bench.course())
    assert outcome.reason == "output encoder is stale" and outcome.stopped and bench.speed < STANDS_RAD_S


@pytest.mark.parametrize("pause_s", [0.06, 0.3])
def test_a_late_cycle_ends_the_motion(pause_s: float) -> None:
    """0.3 s is beyond the heartbeat too: the drive has stopped by itself, and is asked so by SDO."""
    bench = Bench(excite())
    runner = bench.runner()
    plain = bench.wait
    paused = []

    def wait(seconds: float) -> None:
        if bench.now_s > bench.began_s + 0.5 and not paused:
            paused.append(1)
            plain(pause_s)
        plain(seconds)

    runner.wait = wait
    outcome = runner.run(bench.course())
    assert "late" in outcome.reason and outcome.stopped and bench.speed < STANDS_RAD_S


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"travel_rad": 1.0}, "travel_rad"),
        ({"minimum_rad": -0.1}, "minimum_rad"),
        ({"maximum_rad": 0.1}, "maximum_rad"),
        ({"speed_rad_s": 44.0}, "speed_rad_s"),
        ({"acceleration_rad_s2": 1000.0}, "acceleration_rad_s2"),
        ({"torque_Nm": 0.1}, "torque_Nm"),
        ({"temperature_degC": 25.0}, "temperature_degC"),
    ],
)
def test_each_limit_is_checked_before_anything_moves(change: dict[str, float], named: str) -> None:
    bench = Bench(excite(limits(**change)))
    with pytest.raises(LimitError, match=named):
        bench.runner().run(bench.course())
    assert bench.fastest == 0 and bench.face.state == "switch on disabled"


@pytest.mark.parametrize("index", [0x1016, 0x6007])
def test_a_drive_that_would_not_stop_by_itself_is_not_moved(index: int) -> None:
    bench = Bench(excite())
    bench.face.refuses = frozenset({index})
    with pytest.raises(DriveRefused, match="refuses"):
        bench.runner().run(bench.course())
    assert bench.face.state == "switch on disabled"


def test_a_drive_in_fault_is_not_moved_nor_reset() -> None:
    bench = Bench(excite())
    bench.face.trip()
    with pytest.raises(DriveRefused, match="fault"):
        bench.runner().run(bench.course())
    assert bench.face.state == "fault"


def test_a_drive_that_is_not_there() -> None:
    bench = Bench(excite())
    bench.cut = True
    with pytest.raises(LinkLost, match="Network is down"):
        bench.runner().run(bench.course())


@pytest.mark.parametrize(
    ("settings", "typed"),
    [(None, "axis-1"), (excite(allowed=False), "axis-1"), (excite(), None), (excite(), "axis-2"), (excite(), "")],
)
def test_arming_needs_configuration_and_the_typed_name(settings: Excite | None, typed: str | None) -> None:
    drive = Drive(name="axis-1", modbus_device_id=1, model="m", channels=(), excite=settings)
    with pytest.raises(NotArmed):
        arm(drive, typed)


def test_configuration_alone_allows_nothing() -> None:
    fields = {"source": "c", "node": 1, "counts_per_turn": 1.0, "rated_torque_Nm": 1.0, "limits": limits()}
    assert Excite(**fields).allowed is False  # type: ignore[arg-type]


def test_a_full_buffer_at_the_moment_of_the_stop_is_tried_again() -> None:
    """SocketCAN says ENOBUFS while its queue is full: for a few cycles, and then a quick stop goes out."""
    bench = Bench(excite(heartbeat_s=1.0))
    bench.at(0.55, lambda b: setattr(b, "cut", True))
    bench.at(0.56, lambda b: setattr(b, "cut", False))
    outcome = bench.runner().run(bench.course(sine(seconds=3.0)))
    assert not outcome.completed and "Network is down" in outcome.reason
    bench.wait(bench.face.stop_time_s(40.0) + 0.05)  # long before the heartbeat is missed
    assert bench.speed < STANDS_RAD_S and bench.face.state == "switch on disabled"


def test_what_fails_in_every_cycle_still_ends_in_a_quick_stop() -> None:
    """The loop fails, and fails again while it stops: the last commands need nothing of what failed."""
    bench = Bench(excite(heartbeat_s=1.0))
    runner = bench.runner()
    plain = runner.link.feedback

    def feedback() -> Any:
        if bench.now_s > bench.began_s + 0.55:
            raise ValueError("no feedback")
        return plain()

    runner.link.feedback = feedback  # type: ignore[method-assign]
    outcome = runner.run(bench.course(sine(seconds=3.0)))
    assert "failed" in outcome.reason and not outcome.completed
    bench.wait(bench.face.stop_time_s(40.0) + 0.05)
    assert bench.speed < STANDS_RAD_S and bench.face.state == "switch on disabled"


def test_marks_that_cannot_be_kept_end_the_motion_by_a_ramp() -> None:
    bench = Bench(excite())
    runner = bench.runner()

    def full(_readings: Any) -> None:
        raise OSError("No space left on device")

    runner.mark = full
    outcome = runner.run(bench.course(sine(seconds=3.0)))
    assert "No space left" in outcome.reason and outcome.stopped
    assert bench.speed < STANDS_RAD_S and bench.face.state == "switch on disabled"


def test_an_axis_that_sags_before_it_is_enabled_is_not_pulled_back() -> None:
    bench = Bench(excite())
    bench.at(0.002, lambda b: setattr(b.face.motor, "position_rad", 1.0))
    outcome = bench.runner().run(bench.course())
    assert "before it was enabled" in outcome.reason
    assert bench.fastest < 0.1


def test_an_axis_that_turns_is_not_taken_over() -> None:
    bench = Bench(excite())
    bench.face.motor.velocity_rad_s = 5.0
    with pytest.raises(DriveRefused, match="at rest"):
        bench.runner().run(bench.course())


def test_another_node_with_our_heartbeat_is_a_doubt() -> None:
    """The drive would hear it, and miss nothing, when this process is killed."""
    bench = Bench(excite())
    runner = bench.runner()
    runner.doubts = runner.link.doubts  # type: ignore[attr-defined]
    bench.at(0.55, lambda b: b.deliver([(0x700 + 126, bytes([5]))]))
    outcome = runner.run(bench.course(sine(seconds=3.0)))
    assert "another node sends the heartbeat of node 126" in outcome.reason and outcome.stopped
    assert bench.speed < STANDS_RAD_S


def test_a_drive_that_stands_in_operation_is_not_let_go() -> None:
    """Asked by SDO it stands, but it is enabled and deaf to process data: its watch over us must stay on."""
    bench = Bench(excite())
    runner = bench.runner()
    bench.face.state = "operation enabled"
    assert runner.link.standing() is False
    bench.face.state = "switch on disabled"
    assert runner.link.standing() is True
