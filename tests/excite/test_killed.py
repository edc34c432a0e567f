"""The runner as a process of its own on a serial-line CAN adapter, killed in full motion: the drive must stand."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import can
import canopen
import pytest

from edge_daemon.clock import Clock
from edge_daemon.excite.arming import DeadMan, follow
from edge_daemon.excite.drive_link import CanopenDrive
from edge_daemon.excite.profiles import planned_motion
from edge_daemon.excite.runner import Runner
from edge_daemon.servo.cia402_face import Cia402Face, serve
from tests.excite.drive_bench import COUNTS, NODE, armed, excite, loose, sine

ROOT = Path(__file__).parents[2]
PATIENCE_S = 30.0
TRIES = 6


@contextmanager
def serial_pair() -> Iterator[tuple[str, str]]:
    """Two terminals joined by a thread, as a serial-line adapter and its wire."""
    (left, left_slave), (right, right_slave) = os.openpty(), os.openpty()
    for end in (left_slave, right_slave):
        tty.setraw(end)
    for end in (left, right):
        os.set_blocking(end, False)  # what a killed process no longer reads is lost, as on a wire
    done = threading.Event()

    def pump() -> None:
        while not done.is_set():
            for end in select.select([left, right], [], [], 0.05)[0]:
                with suppress(OSError):
                    os.write(right if end == left else left, os.read(end, 4096))

    thread = threading.Thread(target=pump)
    thread.start()
    try:
        yield os.ttyname(left_slave), os.ttyname(right_slave)
    finally:
        done.set()
        thread.join()
        for end in (left, left_slave, right, right_slave):
            os.close(end)


@contextmanager
def served(bus: can.BusABC, face: Cia402Face) -> Iterator[None]:
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(bus, face, stop, time.monotonic))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@contextmanager
def listened(dead_man: DeadMan) -> Iterator[Callable[[], None]]:
    """A terminal that the dead man listens to. The call closes it, and so does an error, or its reader never ends."""
    read_end, write_end = os.pipe()
    held = [write_end]

    def close() -> None:
        if held:
            os.close(held.pop())

    with os.fdopen(read_end) as lines:
        reader = follow(lines, dead_man)
        try:
            yield close
        finally:
            close()
            reader.join(PATIENCE_S)


def until(condition: object, seconds: float) -> bool:
    """Whether `condition()` became true in time."""
    end_s = time.monotonic() + seconds
    tick = threading.Event()
    while time.monotonic() < end_s:
        if condition():  # type: ignore[operator]
            return True
        tick.wait(0.002)
    return False


def killed_in_motion(near: str, mode: str, face: Cia402Face) -> bool:
    """Whether the process was killed while its drive moved: on a busy machine it may stop for a late cycle before."""
    program = str(Path(__file__).with_name("moving_process.py"))
    process = subprocess.Popen(
        [sys.executable, program, near, mode], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    try:
        moves = until(lambda: abs(face.motor.velocity_rad_s) > 25.0 or process.poll() is not None, PATIENCE_S)
        assert moves, face.state
    finally:
        process.kill()  # SIGKILL, or nothing where it has ended by itself
        code = process.wait(PATIENCE_S)
    return code == -signal.SIGKILL


@pytest.mark.parametrize("mode", ["position", "velocity"])
def test_a_killed_process_leaves_a_standing_motor(mode: str) -> None:
    face = Cia402Face(NODE, COUNTS, 0.64, following_window_rad=50.0)
    with (
        serial_pair() as (near, far),
        can.Bus(interface="slcan", channel=far, bitrate=1_000_000, sleep_after_open=0) as bus,
        served(bus, face),
    ):
        assert any(killed_in_motion(near, mode, face) for _ in range(TRIES)), face.state
        # stated: the heartbeat time of 0.5 s and the quick stop ramp; the rest is this machine's scheduling
        assert until(lambda: face.state == "switch on disabled", 5.0)
        assert until(lambda: abs(face.motor.velocity_rad_s) < 0.1, 1.0)


def test_on_a_real_bus_in_real_time_the_operator_lets_go() -> None:
    settings = excite(loose(), cycle_s=0.01, late_s=0.5, heartbeat_s=1.0, dead_man_s=5.0)
    face = Cia402Face(NODE, COUNTS, 0.64, following_window_rad=50.0)
    dead_man = DeadMan(settings.dead_man_s, time.monotonic)
    with (
        can.Bus(interface="virtual", channel="excite-test") as far,
        can.Bus(interface="virtual", channel="excite-test") as near,
        served(far, face),
        listened(dead_man) as let_go,
    ):
        network = canopen.Network(near)
        network.connect()
        link = CanopenDrive(network, settings, time.monotonic)
        wait = threading.Event()

        def pause(seconds: float) -> None:
            if abs(face.motor.velocity_rad_s) > 25.0:
                let_go()
            wait.wait(max(0.0, seconds))

        runner = Runner(armed(settings), link, dead_man, Clock(), time.monotonic, pause)
        try:
            outcome = runner.run(planned_motion(sine(seconds=10.0), settings.cycle_s))
        finally:
            network.notifier.stop()  # type: ignore[union-attr]
        assert "let go" in outcome.reason and outcome.stopped
