"""What publishing costs: registers served per second beside bare pymodbus, and time per snapshot on each way out."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable

from bench_row import Row
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from edge_daemon.config.settings import Gateway, ModbusServer, Zenoh
from edge_daemon.publish.metrics import Metrics
from edge_daemon.publish.modbus_server import RegisterServer
from edge_daemon.publish.registers import TOTAL
from edge_daemon.publish.zenoh_link import ZenohLink
from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import NE107, Estimate, GatewayState, Snapshot, Status
from edge_daemon.show.page import document

SECONDS = 2.0
NOW_S = 1.7e9
SNAPSHOTS = 500

CLIENT = """
import socket, sys, time
request = bytes.fromhex("00010000000601040000007c")
with socket.create_connection(("127.0.0.1", int(sys.argv[1]))) as link:
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    count, end = 0, time.perf_counter() + float(sys.argv[2])
    while time.perf_counter() < end:
        link.sendall(request)
        left = 9 + 248
        while left:
            left -= len(link.recv(left))
        count += 1
print(count / float(sys.argv[2]))
"""
"""a reader of half the block in a process of its own, one request after the other, as a PLC asks"""


def snapshot(number: int) -> Snapshot:
    """Every quantity there is."""
    rows = {name: Estimate(name, 1.0 + number, 0.1, row.unit, Status.VALID, NOW_S) for name, row in QUANTITIES.items()}
    return Snapshot("bench", number, NOW_S, NE107.OK, (), rows)


async def requests_per_s(port: int) -> float:
    """What one client gets."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", CLIENT, str(port), str(SECONDS), stdout=subprocess.PIPE
    )
    out, _ = await asyncio.wait_for(process.communicate(), 10 * SECONDS)
    return float(out)


async def ours() -> tuple[float, float]:
    """Requests per second while the block is renewed ten times a second, and the cost of renewing it [s]."""
    server = RegisterServer(ModbusServer(port=0), {"bench": 1})
    port = await server.start(NOW_S)

    async def renew() -> None:
        number = 0
        while True:
            await server.publish(snapshot(number := number + 1), NOW_S)
            await asyncio.sleep(0.1)

    task = asyncio.create_task(renew())
    rate = await requests_per_s(port)
    task.cancel()
    row = snapshot(1)
    cost_s = await timed(lambda: server.publish(row, NOW_S))
    await server.stop()
    return rate, cost_s


async def timed(call: Callable[[], Awaitable[object]]) -> float:
    """Mean time of one call."""
    began = time.perf_counter()
    for _ in range(SNAPSHOTS):
        await call()
    return (time.perf_counter() - began) / SNAPSHOTS


async def bare() -> float:
    """pymodbus alone, without guard and without renewal."""
    block = [SimData(address=0, count=TOTAL, values=0, datatype=DataType.REGISTERS)]
    server = ModbusTcpServer([SimDevice(id=1, simdata=block)], address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    rate = await requests_per_s(server.transport.sockets[0].getsockname()[1])
    await server.shutdown()
    return rate


def zenoh_costs() -> tuple[float, float]:
    """Per snapshot with all topics: what the caller waits, and until Zenoh has taken everything [s]."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    settings = Zenoh(listen=(f"tcp/127.0.0.1:{port}",), every_s=0.0, queue=100_000)
    link = ZenohLink(settings, Gateway(), ("bench",))
    link.start()
    end = time.perf_counter() + 10.0
    while link.health().state != "ok" and time.perf_counter() < end:
        time.sleep(0.01)
    began = time.perf_counter()
    for number in range(SNAPSHOTS):
        link.publish(snapshot(number))
    called = time.perf_counter()
    while link.health().figures["queued"] and time.perf_counter() < end:
        time.sleep(0.001)
    done = time.perf_counter()
    link.stop(3.0)
    return (called - began) / SNAPSHOTS, (done - began) / SNAPSHOTS


def rendering() -> tuple[float, float]:
    """Time of one scrape and of one refresh of the page, one drive [s]."""
    state = GatewayState("site", "gateway", "0", NOW_S - 9, NOW_S, {"bench": snapshot(1)}, (), (), (), ())
    metrics = Metrics()
    began = time.perf_counter()
    for _ in range(50):
        metrics.render(state)
    half = time.perf_counter()
    for _ in range(50):
        document(state, 5.0)
    return (half - began) / 50, (time.perf_counter() - half) / 50


def rows() -> list[Row]:
    """The figures; the limits leave most of a slow gateway to its real work (guesses)."""
    plain = asyncio.run(bare())
    rate, renewal_s = asyncio.run(ours())
    called_s, sent_s = zenoh_costs()
    scrape_s, page_s = rendering()
    return [
        Row("Modbus reads of 124 registers", rate, "1/s", 500.0, at_least=True, peer=f"bare pymodbus {plain:.0f}"),
        Row("guard: rate beside bare pymodbus", rate / plain, "1", 0.7, at_least=True),
        Row("renew one drive's registers", renewal_s * 1e3, "ms", 1.0),
        Row("Zenoh: publish() of all topics returns after", called_s * 1e3, "ms", 1.0),
        Row("Zenoh: all topics of a snapshot sent", sent_s * 1e3, "ms", 5.0),
        Row("metrics: one scrape, one drive", scrape_s * 1e3, "ms", 20.0),
        Row("page: one refresh, one drive", page_s * 1e3, "ms", 20.0),
    ]
