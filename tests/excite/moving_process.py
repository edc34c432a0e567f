"""Moves the drive on a serial-line CAN adapter until it is killed: `moving_process.py TTY`."""

from __future__ import annotations

import sys
import time

import can
import canopen

from edge_daemon.clock import Clock
from edge_daemon.excite.arming import DeadMan
from edge_daemon.excite.drive_link import CanopenDrive
from edge_daemon.excite.profiles import planned_motion
from edge_daemon.excite.runner import Runner
from tests.excite.drive_bench import armed, excite, loose, sine

settings = excite(loose(), mode=sys.argv[2], cycle_s=0.02, late_s=0.3, heartbeat_s=0.5)
with can.Bus(interface="slcan", channel=sys.argv[1], bitrate=1_000_000, sleep_after_open=0) as bus:
    network = canopen.Network(bus)
    network.connect()
    dead_man = DeadMan(5.0, time.monotonic)
    runner = Runner(
        armed(settings),
        CanopenDrive(network, settings, time.monotonic),
        dead_man,
        Clock(),
        time.monotonic,
        lambda seconds: time.sleep(max(0.0, seconds)),
        doubts=lambda: dead_man.give() or "",  # type: ignore[func-returns-value]
    )
    print(runner.run(planned_motion(sine(seconds=20.0), settings.cycle_s)), flush=True)
