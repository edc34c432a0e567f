"""The daemon under all that may be asked of it at once: four drives at 1 kHz (8000 frames a second, what a bus of
1 Mbit/s carries), twenty Modbus clients, and a Zenoh router whose packets are lost, that falls silent and then dies.

Packets are lost in a network of its own, which needs root, `unshare` and `nft`; elsewhere this is left out.
`LOAD_STRETCH_S=150` makes it ten minutes.
"""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from bench_daemon import memory_mib, started
from bench_row import Row

from edge_daemon.demo.gateway import prepare
from edge_daemon.publish.registers import BY_NAME
from edge_daemon.rig.child import RigProcess

DRIVES, CLIENTS = 4, 20
STRETCH_S = float(os.environ.get("LOAD_STRETCH_S", "15"))
LOOK_EVERY_S = 0.02
SETTLED_S = 20.0
"""What is loaded late is loaded, and blocks come."""
READY_WITHIN_S = 120.0
"""A computer that is busy besides needs longer than one that is measured (guess)."""
CALM_LIMIT = 1.5
"""Age of the data under load over the age without, at its 99th percentile: half as much again is still one block."""
GROWTH_LIMIT_MIB = 20.0
FRAMES_PER_S = DRIVES * 2 * 1000
READ = 125
LOST = {"and a fifth of the router's packets lost": "numgen random mod 5 == 0 drop", "and all of them lost": "drop"}
TABLE = """
table inet load {
  chain lost {
    type filter hook input priority 0;
    tcp dport %(port)d %(fate)s
    tcp sport %(port)d %(fate)s
  }
}
"""
ROUTER = """
import json, sys, zenoh
config = zenoh.Config()
for key, value in (("mode", "router"), ("scouting/multicast/enabled", False), ("listen/endpoints", [sys.argv[1]])):
    config.insert_json5(key, json.dumps(value))
session = zenoh.open(config)
print("ready", flush=True)
sys.stdin.read()
session.close()
"""


def rows() -> list[Row]:
    """Age of the data, lost readings and memory: without the load, and in each stretch of it."""
    if os.getuid() or not shutil.which("nft"):
        return measured(lossy=False)
    words = ["unshare", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "sh", sys.executable, __file__]
    path = os.pathsep.join(filter(None, (str(Path(__file__).parent.parent), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True, env={**os.environ, "PYTHONPATH": path})
    return [Row(**row) for row in json.loads(done.stdout)]


def measured(lossy: bool) -> list[Row]:
    """The same in the network that there is, whose packets may be lost if it is `lossy`."""
    with tempfile.TemporaryDirectory() as folder, _router() as (router, place), _daemon(Path(folder), place) as daemon:
        time.sleep(SETTLED_S)
        calm_ms, before = daemon.ages_ms(), daemon.stood()
        memory = memory_mib(daemon.pid)
        over = threading.Event()
        clients = [threading.Thread(target=daemon.read_on, args=(over,)) for _ in range(CLIENTS)]
        for client in clients:
            client.start()
        stretches = {f"{CLIENTS} Modbus clients": daemon.ages_ms()}
        for name, fate in LOST.items() if lossy else ():
            with _losing(int(place.rpartition(":")[2]), fate):
                stretches[name] = daemon.ages_ms()
        router.send_signal(19)  # SIGSTOP: the connection stays, nothing is read from it
        stretches["and the router silent"] = daemon.ages_ms()
        router.kill()
        stretches["and the router dead"] = daemon.ages_ms()
        over.set()
        for client in clients:
            client.join()
        frames, seconds = (now - then for now, then in zip(daemon.stood(), before, strict=True))
        growth = memory_mib(daemon.pid) - memory
    beside = f"without: {calm_ms:.0f} ms"
    return [
        *(
            Row(f"p99 age of data, {name}", p99 / calm_ms, "1", CALM_LIMIT, peer=beside)
            for name, p99 in stretches.items()
        ),
        Row("frames taken of those of the bus", frames / (FRAMES_PER_S * seconds), "1", 0.99, at_least=True),
        Row("memory grown meanwhile", growth, "MiB", GROWTH_LIMIT_MIB),
    ]


@contextmanager
def _losing(port: int, fate: str) -> Iterator[None]:
    """Packets from and to this port are lost."""
    subprocess.run(["nft", "-f", "-"], input=TABLE % {"port": port, "fate": fate}, text=True, check=True)
    try:
        yield
    finally:
        subprocess.run(["nft", "delete", "table", "inet", "load"], check=True)


@contextmanager
def _router() -> Iterator[tuple[subprocess.Popen[str], str]]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    command = [sys.executable, "-c", ROUTER, place]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout and process.stdout.readline() == "ready\n"
        yield process, place
    finally:
        process.kill()
        process.wait()


class _Daemon:
    """A running daemon, as a PLC and a browser see it."""

    def __init__(self, file: Path, pid: int) -> None:
        self.pid = pid
        document: Any = tomlkit.parse(file.read_text())
        self._port = int(document["modbus_server"]["port"])
        self._page = f"http://127.0.0.1:{int(document['dashboard']['port'])}/metrics"

    def ages_ms(self) -> float:
        """99th percentile of the age of the first drive's data over a stretch [ms]."""
        ages, end_s = [], time.monotonic() + STRETCH_S
        place = BY_NAME["data_age_ms"].address
        with socket.create_connection(("127.0.0.1", self._port), 10.0) as line:
            while time.monotonic() < end_s:
                ages.append(struct.unpack_from(">I", _read(line, place, 2))[0])
                time.sleep(LOOK_EVERY_S)
        return float(np.percentile(ages, 99))

    def read_on(self, over: threading.Event) -> None:
        """A client that asks for the whole map again and again."""
        with socket.create_connection(("127.0.0.1", self._port), 10.0) as line:
            while not over.is_set():
                _read(line, 0, READ)
                over.wait(LOOK_EVERY_S)

    def stood(self) -> tuple[float, float]:
        """Frames of the bus so far, and how long the process lives [s]."""
        with urllib.request.urlopen(self._page, timeout=10) as answer:
            rows = [row.rsplit(" ", 1) for row in answer.read().decode().splitlines() if row[:1] != "#"]
        names = ('strainwave_source_events_total{kind="frames"', "strainwave_up_seconds")
        frames, seconds = (sum(float(value) for name, value in rows if name.startswith(begin)) for begin in names)
        return frames, seconds


def _read(line: socket.socket, address: int, count: int) -> bytes:
    """Input registers of drive 1."""
    line.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, address, count))
    wanted, got = 9 + 2 * count, b""
    while len(got) < wanted:
        part = line.recv(wanted - len(got))
        if not part:
            raise ConnectionError("hung up")
        got += part
    return got[9:]


@contextmanager
def _daemon(folder: Path, router: str) -> Iterator[_Daemon]:
    with RigProcess(["--drives", str(DRIVES)]) as rig:
        file = prepare(folder, rig.ready, DRIVES, free_ports=True)
        document: Any = tomlkit.parse(file.read_text())
        document["zenoh"]["connect"] = [router]
        file.write_text(tomlkit.dumps(document))
        with started(file, READY_WITHIN_S) as (pid, _):
            yield _Daemon(file, pid)


if __name__ == "__main__":
    print(json.dumps([dataclasses.asdict(row) for row in measured(lossy=True)]))
