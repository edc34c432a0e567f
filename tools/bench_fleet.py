"""A fleet on loopback: rates beside a bare subscriber, what is lost when things are killed, and what the data teach."""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
from bench_life import crps
from bench_row import Row
from fleet_lives import LifeTruth, drawn_life, mixed_fleet, worn_fleet

from edge_daemon.cli import main
from edge_daemon.fleet.prior import prior_from
from edge_daemon.prognose.forecast import MAKERS, forecast
from edge_daemon.usage.evidence import evidence_of
from edge_daemon.usage.gears import find_gear
from edge_daemon.usage.ledger import rows_of

TOOLS = Path(__file__).parent
SECONDS = 12.0
"""A rate is measured over so long, after as long a start."""
EVERY_S = 3.5
"""A drive of which every quantity is known says everything so often at 2 kB/s."""
TRIALS = 5
MILLION = 1e6
BARE = """
import json, sys, time, zenoh
config = zenoh.Config()
for key, value in (("mode", "client"), ("connect/endpoints", [sys.argv[1]]), ("scouting/multicast/enabled", False)):
    config.insert_json5(key, json.dumps(value))
session, heard = zenoh.open(config), [0]
def hear(sample):
    str(sample.key_expr), sample.payload.to_bytes()
    heard[0] += 1
subscriber = session.declare_subscriber("strainwave/v1/*/*/*/*", hear)
time.sleep(float(sys.argv[2]) / 2)
began, first = time.monotonic(), heard[0]
time.sleep(float(sys.argv[2]))
print((heard[0] - first) / (time.monotonic() - began), flush=True)
import os; os._exit(0)
"""
"""a subscriber that only takes each message from Zenoh"""
ROUTER = """
import sys
sys.path.insert(0, sys.argv[2])
import fleet_sim
session = fleet_sim.open_session(sys.argv[1], "router")
sys.stdin.read()
"""


@contextmanager
def processes() -> Iterator[list[subprocess.Popen[str]]]:
    """Whatever is appended ends with the block."""
    running: list[subprocess.Popen[str]] = []
    try:
        yield running
    finally:
        for process in running:
            process.kill()
            process.wait()


def started(running: list[subprocess.Popen[str]], *words: object) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, *map(str, words)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                               stderr=subprocess.DEVNULL, text=True)  # fmt: skip
    running.append(process)
    return process


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def router(running: list[subprocess.Popen[str]], endpoint: str) -> subprocess.Popen[str]:
    process = started(running, "-c", ROUTER, endpoint, TOOLS)
    time.sleep(1.0)
    return process


def collector(
    running: list[subprocess.Popen[str]], endpoint: str, folder: Path, *more: object
) -> subprocess.Popen[str]:
    return started(running, "-m", "edge_daemon", "fleet", "collect", "--connect", endpoint, "--out", folder, *more)


def simulated(running: list[subprocess.Popen[str]], endpoint: str, *more: object) -> subprocess.Popen[str]:
    process = started(running, TOOLS / "fleet_sim.py", "--connect", endpoint, *more)
    assert process.stdout and process.stdout.readline().strip() == "ready"
    return process


def cpu_s(process: subprocess.Popen[str]) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def missing_and_twice(folder: Path, published: dict[str, dict[str, int]]) -> tuple[int, int]:
    """Messages that are not in the dataset, and rows that are in it more than once."""
    table = f"read_parquet('{folder}/site=*/date=*/*.parquet', hive_partitioning = true)"
    key = "(site, gateway, drive, run, topic, sequence, name)"
    ((twice,),) = duckdb.sql(f"SELECT count(*) - count(DISTINCT {key}) FROM {table}").fetchall()
    query = (
        f"SELECT concat_ws('/', site, gateway, drive, topic), run, count(DISTINCT sequence) FROM {table} GROUP BY ALL"
    )
    held = {(stream, str(run)): count for stream, run, count in duckdb.sql(query).fetchall()}
    lost = sum(count - held.get((key, run), 0) for key, runs in published.items() for run, count in runs.items())
    return lost, twice


def saturation() -> list[Row]:
    """What one collector takes in of a flood, beside a subscriber that does nothing with it."""
    with processes() as running:
        endpoint = free_endpoint()
        router(running, endpoint)
        reader = started(running, "-c", BARE, endpoint, SECONDS)
        simulated(running, endpoint, "--drives", 40, "--seconds", 3 * SECONDS, "--flood")
        assert reader.stdout
        bare = float(reader.stdout.read())
    short, long = (flooded(seconds) for seconds in (SECONDS, 2.0 * SECONDS))
    ours = (long - short) / SECONDS
    return [
        Row("messages/s at saturation", ours, "1/s", peer=f"bare subscriber {bare:.0f}"),
        Row("rate beside a bare subscriber", ours / bare, "1", 0.5, at_least=True),
    ]


def flooded(seconds: float) -> int:
    """So many messages a collector takes in of a flood that begins before it. What it does to begin and what still
    waits at its end is the same however long it runs: the difference of two runs is its rate."""
    with processes() as running, tempfile.TemporaryDirectory() as folder:
        endpoint = free_endpoint()
        router(running, endpoint)
        simulated(running, endpoint, "--drives", 40, "--seconds", seconds + 60.0, "--flood")
        reader = collector(running, endpoint, Path(folder) / "out", "--seconds", seconds, "--json", "-")
        assert reader.stdout
        return int(json.loads(reader.stdout.read())["messages"])


def steady(drives: int) -> dict[str, float]:
    """A fleet at default rates: losses, the collector's cost and what stays on disk."""
    with processes() as running, tempfile.TemporaryDirectory() as folder:
        endpoint, out = free_endpoint(), Path(folder) / "out"
        router(running, endpoint)
        reader = collector(running, endpoint, out)
        time.sleep(2.0)
        options = ("--drives", drives, "--processes", 2, "--every", EVERY_S, "--seconds", 2 * SECONDS, "--linger", 15)
        fleet = simulated(running, endpoint, *options)
        time.sleep(SECONDS)
        began, used = time.monotonic(), cpu_s(reader)
        time.sleep(0.8 * SECONDS)
        cost = (cpu_s(reader) - used) / (time.monotonic() - began)
        assert fleet.stdout
        told = json.loads(fleet.stdout.readline())
        time.sleep(5.0)
        reader.terminate()
        reader.wait(30.0)
        lost, twice = missing_and_twice(out, told["numbers"])
        size = sum(path.stat().st_size for path in out.glob("site=*/date=*/*.parquet"))
        rounds = told["messages"] / 7.0
        return {"lost": lost, "twice": twice, "cost": cost, "bytes": size / rounds * 86_400.0 / EVERY_S,
                "messages": told["messages"] / told["seconds"]}  # fmt: skip


def scale(bare: float) -> list[Row]:
    few, some, many = (steady(drives) for drives in (10, 100, 1000))
    each = many["cost"] / 1000.0
    routers = math.ceil(MILLION * 7.0 / EVERY_S / (0.5 * bare))
    storage = many["bytes"] * MILLION / 1e12
    paper = (
        f"{routers} routers at half of the bare rate, {math.ceil(MILLION * each / 0.7)} collectors at 70 % of a core"
    )
    return [
        Row("1 000 drives at default rates: messages lost", many["lost"], "1", 0.0, peer=f"{many['messages']:.0f}/s"),
        Row("1 000 drives: rows twice", many["twice"], "1", 0.0),
        Row("1 000 drives: of one core", many["cost"], "1", 0.7),
        Row("cost per drive, 1 000 beside 100", each / (some["cost"] / 100.0), "1", 1.2,
            peer=f"cores: 10: {few['cost']:.3f}, 100: {some['cost']:.3f}, 1 000: {many['cost']:.3f}"),
        Row("bytes per drive and day on disk", many["bytes"] / 1e6, "MB"),
        Row("on paper, 1 000 000 drives: a day on disk", storage, "TB", peer=paper),
    ]  # fmt: skip


def broken() -> list[Row]:
    """The router goes and comes back, the collector is killed again and again, gateways are cut off for an hour."""
    rows = []
    for what in ("router killed", "collector killed", "gateways offline for an hour"):
        with processes() as running, tempfile.TemporaryDirectory() as folder:
            endpoint, out = free_endpoint(), Path(folder) / "out"
            hub, reader = router(running, endpoint), collector(running, endpoint, out)
            time.sleep(2.0)
            hour = what.startswith("gateways")
            pace = ("--every", 0.02, "--time-factor", 180) if hour else ("--every", 0.5)
            fleet = simulated(running, endpoint, "--drives", 10, "--seconds", 30, "--linger", 120, *pace)
            assert fleet.stdin and fleet.stdout
            time.sleep(4.0)
            if what == "router killed":
                hub.kill()
                hub.wait()
                time.sleep(4.0)
                router(running, endpoint)
            elif hour:
                fleet.stdin.write("offline 20\n")
                fleet.stdin.flush()
            else:
                for _ in range(6):
                    reader.kill()
                    reader.wait()
                    reader = collector(running, endpoint, out)
                    time.sleep(3.3)
            published = json.loads(fleet.stdout.readline())["numbers"]
            lost, twice, end_s = 1, 0, time.monotonic() + 60.0
            while lost and time.monotonic() < end_s:
                time.sleep(2.0)
                with contextlib.suppress(duckdb.Error):
                    lost, twice = missing_and_twice(out, published)
            total = sum(sum(runs.values()) for runs in published.values())
            rows.append(Row(f"{what}: messages lost", lost, "1", 0.0, peer=f"of {total}"))
            rows.append(Row(f"{what}: rows twice", twice, "1", 0.0))
    return rows


def said(*words: object) -> dict[str, Any]:
    """A command's JSON."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        assert main(["fleet", *map(str, words), "--json", "-"]) == 0
    found: dict[str, Any] = json.loads(told.getvalue())
    return found


def hidden() -> list[Row]:
    hits = named = planted = 0
    for seed in range(TRIALS):
        with tempfile.TemporaryDirectory() as folder:
            truth = set(mixed_fleet(Path(folder), 1000 + seed))
            units = {f"{u['site']}/{u['gateway']}/{u['drive']}" for u in said("compare", folder)["units"]}
            hits, named, planted = hits + len(units & truth), named + len(units), planted + len(truth)
    peer = f"{planted} planted in {TRIALS} fleets of 280"
    return [
        Row("effect in 5 % of a fleet: precision", hits / max(named, 1), "1", 0.9, at_least=True, peer=peer),
        Row("effect in 5 % of a fleet: recall", hits / planted, "1", 0.9, at_least=True),
    ]


def taught() -> list[Row]:
    """Two hundred histories, 60 % of them censored; then fresh gears by the same law at loads of their own."""
    inside, scores = [], np.zeros(2)
    gear, widths = find_gear("CSG-20-100"), []
    for seed in range(TRIALS):
        truth = LifeTruth(1.4 + 0.4 * seed, 4.0 + seed, 8000.0)
        with tempfile.TemporaryDirectory() as folder:
            worn_fleet(Path(folder), 2000 + seed, truth=truth)
            found = said("learn", folder, "--out", Path(folder) / "prior")
            prior = prior_from((Path(folder) / "prior").read_bytes())
        assert prior
        for name, value in (("weibull_shape", truth.shape), ("damage_exponent", truth.exponent)):
            inside.append(found[name]["from"] <= value <= found[name]["to"])
        widths.append(found["damage_exponent"]["to"] - found["damage_exponent"]["from"])
        rng = np.random.default_rng(seed)
        for _ in range(20):
            torque, rpm, life_h = drawn_life(rng, truth)
            hours = np.full(48, 0.5 * life_h / 48)
            columns = {"torque_cubic_mean_Nm": np.full(48, torque), "torque_peak_Nm": np.full(48, 1.5 * torque),
                       "speed_in_rpm": np.full(48, rpm)}  # fmt: skip
            ledger = rows_of(gear, np.cumsum(hours), hours, columns)
            for way, belief in enumerate((MAKERS, prior.at(ledger))):
                left = forecast(gear, evidence_of(ledger), belief).remaining_h
                scores[way] += min(crps(left, 0.5 * life_h) / life_h, 10.0) / (20 * TRIALS)
    return [
        Row("Weibull shape and exponent within their 90 % intervals", float(np.mean(inside)), "1", 0.7, at_least=True,
            peer=f"{len(inside)} intervals; of the exponent {np.mean(widths):.2f} wide"),
        Row("remaining life of fresh gears: CRPS", scores[1], "life", scores[0], peer=f"maker's {scores[0]:.3f}"),
    ]  # fmt: skip


def cluster() -> list[Row]:
    """The same analyses on one worker and on two."""
    from distributed import LocalCluster

    told, took = [], []
    with tempfile.TemporaryDirectory() as folder:
        mixed_fleet(Path(folder), 7, drives=400)
        part = next(Path(folder).glob("site=hall-0"))
        for copy in range(12):
            shutil.copytree(part, Path(folder) / f"site=copy-{copy}")
        for workers in (1, 2):
            with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as engine:
                said("compare", folder, "--scheduler", engine.scheduler_address)
                began = time.perf_counter()
                told.append(said("compare", folder, "--scheduler", engine.scheduler_address))
                took.append(time.perf_counter() - began)
    return [
        Row("1 and 2 workers tell the same", float(told[0] == told[1]), "1", 1.0, at_least=True),
        Row("speed-up by the second worker", took[0] / took[1], "1", peer=f"{took[0]:.1f} s and {took[1]:.1f} s"),
    ]


def rows() -> list[Row]:
    """About six minutes."""
    flood = saturation()
    bare = float(flood[0].peer.rpartition(" ")[2])
    parts: Sequence[list[Row]] = (flood, scale(bare), broken(), hidden(), taught(), cluster())
    return [row for part in parts for row in part]
