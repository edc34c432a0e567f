"""The simulated drive: how much faster than the clock recordings are made, and what a live drive costs."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

from bench_row import Row

from edge_daemon.rig.child import RigProcess
from edge_daemon.rig.recording import simulate
from edge_daemon.rig.truths import ROWS

SECONDS = 30.0
LIVE_S = 6.0
SLOWEST_S = 1.5
"""most that a recording of half a minute may take to make"""
CORE_SHARE = 15.0
"""most of a core, in per cent, that one live drive may cost"""


def rows() -> list[Row]:
    """Recordings per effect at their slowest, and live drives."""
    took = {name: _took_s(name) for name in ("", *(row.name for row in ROWS))}
    slowest = max(took, key=lambda name: took[name])
    return [
        Row("a recording of 30 s, plain gear", took[""], "s", SLOWEST_S, peer=f"{SECONDS / took['']:.0f} x real time"),
        Row("the same, slowest effect", took[slowest], "s", SLOWEST_S, peer=slowest),
        *(_live(drives) for drives in (1, 4)),
    ]


def _took_s(effect: str) -> float:
    start_s = time.perf_counter()
    simulate((effect,) if effect else (), SECONDS, seed=1)
    return time.perf_counter() - start_s


def _live(drives: int) -> Row:
    """Per cent of a core for each live drive while its frames are read."""
    with RigProcess(["--drives", str(drives)]) as rig:
        done = threading.Event()
        reader = threading.Thread(target=_drain, args=(rig.ready["can"]["channel"], done))
        reader.start()
        before_s, start_s = _cpu_s(rig.pid), time.perf_counter()
        time.sleep(LIVE_S)
        share = 100 * (_cpu_s(rig.pid) - before_s) / (time.perf_counter() - start_s) / drives
        status = rig.order(status=True)
        done.set()
        reader.join()
    note = f"{status['sent']} frames sent, {status['dropped']} dropped, {status['skipped_s']:.2f} s skipped"
    return Row(f"processor per live drive, {drives} at once", share, "%", CORE_SHARE, peer=note)


def _drain(channel: str, done: threading.Event) -> None:
    """Opens the adapter by its own commands and throws away what comes."""
    terminal = os.open(channel, os.O_RDWR | os.O_NOCTTY)
    os.write(terminal, b"C\rS8\rO\r")
    os.set_blocking(terminal, False)
    while not done.wait(0.005):
        try:
            os.read(terminal, 65_536)
        except BlockingIOError:
            continue
        except OSError:
            break
    os.close(terminal)


def _cpu_s(pid: int) -> float:
    """User and system time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
