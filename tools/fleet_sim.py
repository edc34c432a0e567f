"""Simulated gateways: they publish, number, remember and answer as a gateway does, and share no code with it.

    .venv/bin/python tools/fleet_sim.py --connect tcp/127.0.0.1:7447 --drives 1000 --processes 2 --seconds 60

Each drive ages on a clock of its own (`--hours-per-second`): a Weibull life, stiffness that falls and noise that rises
towards its end, a load that varies. `--plant SHARE` gives a share of the drives an effect that their models
lack. Commands on standard input: `offline N` (all gateways go away for N s and go on measuring), `restart` (a new run),
`quit`.
The last line on standard output is JSON: what each stream has published, by run.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

STREAMS: dict[str, tuple[tuple[str, str], ...]] = {
    "health": (("health_index", "1"),),
    "life": (("damage", "1"), ("rul_p10_h", "h"), ("rul_p50_h", "h"), ("rul_p90_h", "h"), ("operating_hours", "h"),
             ("turns_in", "1"), ("turns_out", "1"), ("load_cycles", "1")),
    "stiffness": (("stiffness", "N m/rad"), ("damping", "N m s/rad"), ("coulomb_friction", "N m"),
                  ("kinematic_error", "rad"), ("stiffness_change", "1"), ("hysteresis_area", "J")),
    "noise": (*((f"noise_a{b}", "1/Hz") for b in range(5)), ("noise_rms", "1")),
    "load": (("torque_rms", "N m"), ("torque_peak", "N m"), ("torque_cubic_mean", "N m"), ("speed_in", "rad/s"),
             ("temperature", "degC")),
    "ratio": (("ratio", "1"), ("ratcheting_events", "1"), ("encoder_skew", "s")),
    "model_error": (("model_nrmse", "1"), ("model_noise_floor", "1"), ("model_rmse", "N m")),
}  # fmt: skip
PAGE = 200
"""Messages in one answer about the past."""


def open_session(endpoint: str, mode: str = "client") -> zenoh.Session:
    """A client of a router, or a router itself."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5(f"{'listen' if mode == 'router' else 'connect'}/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


@dataclass
class SimDrive:
    """A gear that wears out, and what would be said of it."""

    name: str
    seed: int
    planted: bool = False
    life_h: float = 0.0
    age_h: float = 0.0
    torque_Nm: float = 0.0
    stiffness_Nm_per_rad: float = 0.0
    rng: random.Random = field(default_factory=random.Random)

    def __post_init__(self) -> None:
        self.rng = random.Random(self.seed)
        self.torque_Nm = 40.0 * math.exp(self.rng.gauss(0.0, 0.2))
        self.stiffness_Nm_per_rad = 26e3 * math.exp(self.rng.gauss(0.0, 0.03))
        self.life_h = self.rng.weibullvariate(20e3, 2.2) * (40.0 / self.torque_Nm) ** 3
        self.age_h = 0.8 * self.life_h * self.rng.random()

    def advance(self, hours: float) -> None:
        self.age_h += hours

    def numbers(self) -> dict[str, float]:
        """What a gateway would estimate now."""
        used, gauss = min(self.age_h / self.life_h, 1.2), self.rng.gauss
        worn, loud = 0.15 * used**3, 1.0 + 2.0 * used**4
        left_h = max(self.life_h - self.age_h, 0.0)
        floor = 0.012 * math.exp(gauss(0.0, 0.05))
        error = math.hypot(floor, 0.02 * self.torque_Nm / 40.0 * math.exp(gauss(0.0, 0.1)), 0.06 * self.planted)
        torque = self.torque_Nm * math.exp(gauss(0.0, 0.02))
        turns = self.age_h * 3600.0 * 20.0
        found = {
            "health_index": max(1.0 - used, 0.0), "damage": used, "rul_p10_h": 0.5 * left_h, "rul_p50_h": left_h,
            "rul_p90_h": 1.8 * left_h, "operating_hours": self.age_h, "turns_in": turns, "turns_out": turns / 100.0,
            "load_cycles": turns / 80.0, "stiffness": self.stiffness_Nm_per_rad * (1.0 - worn) + gauss(0.0, 30.0),
            "damping": 8.0 + gauss(0.0, 0.2), "coulomb_friction": 2.0 + gauss(0.0, 0.05) + 0.8 * self.planted,
            "kinematic_error": 3e-4 + gauss(0.0, 5e-6), "stiffness_change": -worn + gauss(0.0, 1e-3),
            "hysteresis_area": 0.05 + gauss(0.0, 1e-3), "noise_rms": 0.3 * loud + gauss(0.0, 0.01),
            "torque_rms": torque, "torque_peak": 2.4 * torque, "torque_cubic_mean": 1.2 * self.torque_Nm,
            "speed_in": 120.0 + gauss(0.0, 2.0), "temperature": 38.0 + gauss(0.0, 0.5),
            "ratio": 100.0 + gauss(0.0, 1e-6), "ratcheting_events": 0.0, "encoder_skew": gauss(0.0, 1e-6),
            "model_nrmse": error, "model_noise_floor": floor, "model_rmse": error * torque,
        }  # fmt: skip
        return found | {f"noise_a{b}": 1e-4 * loud * math.exp(gauss(0.0, 0.1)) for b in range(5)}


class SimGateway:
    """Publishes its drives, keeps every payload, and answers `history` by number, by time only, or not at all."""

    def __init__(
        self, site: str, name: str, drives: list[SimDrive], answers: str = "number", hours_per_s: float = 0.0
    ) -> None:
        self.root = f"strainwave/v1/{site}/{name}"
        self.drives = drives
        self.answers = answers
        self.hours_per_s = hours_per_s
        self.session: zenoh.Session | None = None
        self.kept: dict[tuple[str, str, int], dict[int, tuple[float, bytes]]] = {}
        self.lock = threading.Lock()
        self._declared: list[Any] = []
        self.restart()

    def restart(self) -> None:
        """A new run: the numbering begins anew; what was kept stays."""
        self.run = max(int(time.time() * 1e3), getattr(self, "run", 0) + 1)
        self.next: dict[tuple[str, str], int] = {}
        self.introduced = False

    def connect(self, session: zenoh.Session) -> None:
        self.session = session
        for drive in self.drives:
            key = f"{self.root}/{drive.name}"
            self._declared.append(session.liveliness().declare_token(key))
            if self.answers != "none":
                handler = zenoh.handlers.FifoChannel(64)
                queryable = session.declare_queryable(f"{key}/history", handler)
                self._declared.append(queryable)
                threading.Thread(target=self._answer, args=(queryable, drive.name), daemon=True).start()

    def disconnect(self) -> None:
        for row in self._declared:
            row.undeclare()
        self._declared.clear()
        self.session = None

    def publish(self, now_s: float) -> int:
        """One round of every drive; kept whether anybody is there or not. How many messages."""
        count = 0
        for drive in self.drives:
            drive.advance(self.hours_per_s)
            numbers = drive.numbers()
            if not self.introduced:
                self._say(
                    drive.name, "meta", now_s, {"gear": "CSG-20-100", "model": {"ratio": 100.0, "balance": "torsion"}}
                )
            for topic, rows in STREAMS.items():
                document: dict[str, Any] = {
                    "estimates": {
                        name: {"value": numbers[name], "sd": 0.01 * abs(numbers[name]), "unit": unit, "status": "valid",
                               "time_s": now_s}
                        for name, unit in rows
                    }
                }  # fmt: skip
                if topic == "health":
                    failed = drive.age_h >= drive.life_h
                    document |= {"state": "failure" if failed else "ok", "ne107": 4 if failed else 0, "reasons": []}
                self._say(drive.name, topic, now_s, document)
                count += 1
        self.introduced = True
        return count

    def _say(self, drive: str, topic: str, now_s: float, document: dict[str, Any]) -> None:
        number = self.next.get((drive, topic), 0)
        self.next[drive, topic] = number + 1
        head = {"schema": f"strainwave/{topic}", "version": 1, "drive": drive, "run": self.run, "sequence": number,
                "time_s": now_s}  # fmt: skip
        live = json.dumps({**head, "historical": False, **document}).encode()
        with self.lock:
            again = live.replace(b'"historical": false', b'"historical": true')
            self.kept.setdefault((drive, topic, self.run), {})[number] = (now_s, again)
        if self.session is not None:
            self.session.put(f"{self.root}/{drive}/{topic}", live, congestion_control=zenoh.CongestionControl.BLOCK)

    def _answer(self, queryable: Any, drive: str) -> None:
        for query in queryable:
            with query:
                pairs = dict(part.split("=", 1) for part in str(query.parameters).split(";") if "=" in part)
                by_number = bool(pairs.keys() & {"runs", "run"})
                if by_number and self.answers != "number":
                    query.reply_err(b"runs: unknown parameter")
                    continue
                with self.lock:
                    parts = self._by_number(drive, pairs) if by_number else {"rows": self._by_time(drive, pairs)}
                head = {"schema": "strainwave/history", "version": 1, "drive": drive, "historical": True, "rows": []}
                query.reply(f"{self.root}/{drive}/history", json.dumps(head | parts).encode())

    def _by_number(self, drive: str, asked: dict[str, str]) -> dict[str, Any]:
        if "run" not in asked:
            return {
                "runs": [
                    {"run": run, "topic": topic, "first": min(rows), "last": max(rows)}
                    for (name, topic, run), rows in self.kept.items()
                    if name == drive
                ]
            }
        rows = self.kept.get((drive, asked["topic"], int(asked["run"])), {})
        span = range(int(asked.get("first", 0)), min(int(asked.get("last", 2**62)), max(rows, default=-1)) + 1)
        chosen = [rows[number][1] for number in span if number in rows][: int(asked.get("limit", PAGE))]
        return {"messages": [json.loads(row) for row in chosen]}

    def _by_time(self, drive: str, asked: dict[str, str]) -> list[dict[str, Any]]:
        """As a gateway of before: rows of estimates between two times, without their numbers."""
        since_s, until_s = float(asked.get("since_s", 0)), float(asked.get("until_s", math.inf))
        names = (
            asked["names"].split(",") if "names" in asked else [name for rows in STREAMS.values() for name, _ in rows]
        )
        seen: dict[tuple[float, str], dict[str, Any]] = {}
        for (name, _, _), rows in self.kept.items():
            for at_s, payload in rows.values() if name == drive else ():
                if since_s <= at_s < until_s:
                    for told, row in json.loads(payload).get("estimates", {}).items():
                        seen[at_s, told] = {"name": told, **{k: row[k] for k in ("time_s", "value", "sd", "status")}}
        times = sorted({at_s for at_s, _ in seen})
        return [seen[at_s, name] for at_s in times for name in names if (at_s, name) in seen]

    def published(self) -> dict[str, dict[str, int]]:
        """Key of each stream -> run -> how many, numbered from 0."""
        found: dict[str, dict[str, int]] = {}
        for (drive, topic, run), rows in self.kept.items():
            found.setdefault(f"{self.root.removeprefix('strainwave/v1/')}/{drive}/{topic}", {})[str(run)] = len(rows)
        return found


def gateways(first: int, count: int, per: int, options: argparse.Namespace) -> list[SimGateway]:
    effect_share = options.plant
    found = []
    for number in range(first, first + count):
        drives = [
            SimDrive(f"axis-{i + 1}", seed := number * per + i, random.Random(seed * 7919 + 13).random() < effect_share)
            for i in range(per)
        ]
        found.append(SimGateway(f"hall-{number % options.sites}", f"cell-{number}", drives, options.history,
                                options.hours_per_second * options.every))  # fmt: skip
    return found


def flood(options: argparse.Namespace) -> None:
    """As many messages as the network takes, numbered but not kept."""
    (gateway,) = gateways(options.first, 1, options.drives, options)
    gateway.publish(time.time())  # nobody hears this: it makes an example of each message
    session = open_session(options.connect)
    examples = []
    for (drive, topic, _), rows in gateway.kept.items():
        if topic != "meta":
            publisher = session.declare_publisher(
                f"{gateway.root}/{drive}/{topic}", congestion_control=zenoh.CongestionControl.BLOCK
            )
            before, after = rows[0][1].split(b'"sequence": 0', 1)
            examples.append((publisher, before + b'"sequence": ', after))
    print("ready", flush=True)
    number, end_s = 0, time.monotonic() + options.seconds
    while time.monotonic() < end_s:
        number += 1
        for publisher, before, after in examples:
            publisher.put(before + str(number).encode() + after)
    print(json.dumps({"messages": number * len(examples)}), flush=True)
    os._exit(0)


def serve(options: argparse.Namespace) -> None:
    """One process's gateways, paced, until the time is over."""
    fleet = gateways(options.first, options.gateways, options.per_gateway, options)
    session: zenoh.Session | None = open_session(options.connect)
    for gateway in fleet:
        gateway.connect(session)
    orders: list[list[str]] = []
    threading.Thread(target=lambda: [orders.append(line.split()) for line in sys.stdin], daemon=True).start()
    print("ready", flush=True)
    began_s, count, back_s = time.monotonic(), 0, math.inf
    end_s = began_s + options.seconds
    rounds, now_s = 0, time.time()
    while time.monotonic() < end_s:
        for order in [orders.pop(0) for _ in range(len(orders))]:
            if order[0] == "restart":
                for gateway in fleet:
                    gateway.restart()
            elif order[0] == "offline" and session is not None:
                for gateway in fleet:
                    gateway.disconnect()
                session.close()
                session, back_s = None, time.monotonic() + float(order[1])
            elif order[0] == "quit":
                end_s = 0.0
        if session is None and time.monotonic() >= back_s:
            session = open_session(options.connect)
            for gateway in fleet:
                gateway.connect(session)
        for gateway in fleet:
            count += gateway.publish(now_s)
        rounds += 1
        now_s += options.every * options.time_factor
        wait_s = began_s + rounds * options.every - time.monotonic()
        if wait_s > 0:
            time.sleep(wait_s)
    took_s = time.monotonic() - began_s
    numbers = {key: runs for gateway in fleet for key, runs in gateway.published().items()}
    planted = [f"{g.root.removeprefix('strainwave/v1/')}/{d.name}" for g in fleet for d in g.drives if d.planted]
    print(json.dumps({"messages": count, "seconds": took_s, "planted": planted, "numbers": numbers}), flush=True)
    time.sleep(options.linger)
    os._exit(0)


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    top.add_argument("--connect", default="tcp/127.0.0.1:7447")
    top.add_argument("--drives", type=int, default=100)
    top.add_argument("--per-gateway", type=int, default=10)
    top.add_argument("--processes", type=int, default=1)
    top.add_argument("--sites", type=int, default=3)
    top.add_argument("--seconds", type=float, default=30.0)
    top.add_argument("--every", type=float, default=3.5, help="seconds between two rounds of a drive")
    top.add_argument("--time-factor", type=float, default=1.0, help="data time over real time")
    top.add_argument("--hours-per-second", type=float, default=0.0)
    top.add_argument("--history", choices=("number", "time", "none"), default="number")
    top.add_argument("--plant", type=float, default=0.0, metavar="SHARE", help="of drives with a hidden effect")
    top.add_argument("--flood", action="store_true", help="one gateway, as fast as it can")
    top.add_argument("--linger", type=float, default=0.0, help="answer for so long after the last message")
    top.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    top.add_argument("--gateways", type=int, default=0, help=argparse.SUPPRESS)
    return top


def main() -> None:
    options = parser().parse_args()
    if options.flood:
        flood(options)
    if options.gateways:
        serve(options)
        return
    total = max(options.drives // options.per_gateway, 1)
    each = -(-total // options.processes)
    words = [sys.executable, str(Path(__file__).resolve()), *sys.argv[1:]]
    children = [
        subprocess.Popen([*words, "--first", str(first), "--gateways", str(min(each, total - first))],
                         stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for first in range(0, total, each)
    ]  # fmt: skip
    for child in children:
        assert child.stdout
        child.stdout.readline()
    print("ready", flush=True)

    def pass_on() -> None:
        for line in sys.stdin:
            for child in children:
                assert child.stdin
                child.stdin.write(line)
                child.stdin.flush()

    threading.Thread(target=pass_on, daemon=True).start()
    found: dict[str, Any] = {"messages": 0, "seconds": 0.0, "planted": [], "numbers": {}}
    for child in children:
        assert child.stdout
        part = json.loads(child.stdout.readline())
        found["messages"] += part["messages"]
        found["seconds"] = max(found["seconds"], part["seconds"])
        found["planted"] += part["planted"]
        found["numbers"] |= part["numbers"]
    print(json.dumps(found), flush=True)
    for child in children:
        child.wait()
    os._exit(0)


if __name__ == "__main__":
    main()
