"""The daemon as a process: time to READY, memory, processor time for one simulated drive."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench_row import Row

from edge_daemon.demo.gateway import prepare
from edge_daemon.rig.child import RigProcess

READY_LIMIT_S = 5.0
MEMORY_LIMIT_MIB = 160.0
PROCESSOR_LIMIT_CORES = 0.04
MEASURE_S = 20.0

RUN = """
import asyncio, sys
from pathlib import Path
from edge_daemon.service.daemon import Daemon
from edge_daemon.rig.i2c_face import open_bus
asyncio.run(Daemon(Path(sys.argv[1]), i2c_bus=open_bus).run())
"""


@contextmanager
def started(file: Path, within_s: float = 60.0) -> Iterator[tuple[int, float]]:
    """A daemon in a process of its own, from its READY on: the process, and how long it took [s]."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        address = str(file.parent / "notify")
        manager.bind(address)
        manager.settimeout(within_s)
        began, environment = time.perf_counter(), os.environ | {"NOTIFY_SOCKET": address}
        daemon = subprocess.Popen([sys.executable, "-c", RUN, str(file)], env=environment, stderr=subprocess.DEVNULL)
        try:
            while b"READY=1" not in manager.recv(4096):
                pass
            yield daemon.pid, time.perf_counter() - began
        finally:
            daemon.terminate()
            daemon.wait(30)


def rows() -> list[Row]:
    """READY after start, resident memory after twenty seconds, share of one core."""
    with tempfile.TemporaryDirectory() as folder, RigProcess() as rig:
        file = prepare(Path(folder), rig.ready, 1, free_ports=True)
        with started(file) as (pid, ready_s):
            first = _cpu_s(pid)
            time.sleep(MEASURE_S)
            share = (_cpu_s(pid) - first) / MEASURE_S
            memory = memory_mib(pid)
    return [
        Row("READY after start", ready_s, "s", READY_LIMIT_S),
        Row(f"resident memory after {MEASURE_S:.0f} s, one drive", memory, "MiB", MEMORY_LIMIT_MIB),
        Row("processor, one drive", share, "cores", PROCESSOR_LIMIT_CORES),
    ]


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mib(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
