"""The main job on real input: the demonstration as a process, judged by clients that share no code with it."""

from __future__ import annotations

import asyncio
import csv
import io
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.demo import gateway as demonstration
from edge_daemon.demo.gateway import ports_near, summary
from edge_daemon.quantities import TOPICS
from edge_daemon.records import NE107, Estimate, GatewayState, LinkHealth, Snapshot, Status

SECONDS = 24
STIFFNESS_NM_PER_RAD = 1e5
"""of the articles' simulated gear, which the demonstration's drive is"""
PEER = Path(__file__).parents[1] / "publish" / "zenoh_peer.py"
LISTENER = """
import json, sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
def hear(sample):
    print(json.dumps({"key": str(sample.key_expr), "body": json.loads(sample.payload.to_string())}), flush=True)
subscriber = session.declare_subscriber("strainwave/v1/**", hear)
print("ready", flush=True)
sys.stdin.read()
session.close()
"""


@dataclass
class Shown:
    """What one run of the demonstration showed to the world."""

    folder: Path
    heard: list[dict[str, object]] = field(default_factory=list)
    polls: list[dict[str, float]] = field(default_factory=list)
    code: int = -1
    output: str = ""


def register_map() -> dict[str, tuple[int, str]]:
    text = subprocess.run(
        [sys.executable, "-m", "edge_daemon", "registers", "--format", "csv"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    return {row["name"]: (int(row["address"]), row["type"]) for row in csv.DictReader(io.StringIO(text))}


def poll(port: int, address: int, kind: str) -> float:
    """One value by mbpoll, which counts addresses from 0 with -0; its text is parsed, its exit code means little."""
    form = {"f32": "3:float", "u16": "3", "u32": "3:int"}[kind]
    words = ["mbpoll", "-m", "tcp", "-p", str(port), "-a", "1", "-0", "-t", form, "-r", str(address), "-c", "1", "-1"]
    words += ["-B"] if kind != "u16" else []
    text = subprocess.run([*words, "127.0.0.1"], capture_output=True, text=True, timeout=20, check=False).stdout
    found = re.search(r"^\[\d+\]:\s+(\S+)", text, re.MULTILINE)
    assert found, text
    return float(found[1])


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    folder = tmp_path_factory.mktemp("demo")
    words = [
        "demo",
        "--seconds",
        str(SECONDS),
        "--any-port",
        "--folder",
        str(folder),
        "--log",
        str(folder / "sent.csv"),
    ]
    demo = subprocess.Popen(
        [sys.executable, "-m", "edge_daemon", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    seen = Shown(folder)
    assert demo.stdout
    lines: list[str] = []
    try:
        port, endpoint = 0, ""
        for line in demo.stdout:
            lines.append(line)
            if found := re.search(r"Modbus TCP 127\.0\.0\.1:(\d+)", line):
                port = int(found[1])
            if found := re.search(r"Zenoh (\S+),", line):
                endpoint = found[1]
            if "ready:" in line:
                break
        rest = threading.Thread(target=lambda: lines.extend(demo.stdout or ()))
        rest.start()
        with zenoh_listener(endpoint, seen):
            watch_registers(port, seen, time.monotonic() + SECONDS - 4)
            seen.code = demo.wait(60)
        rest.join(10)
    finally:
        demo.kill()
        demo.wait()
    seen.output = "".join(lines)
    yield seen


class zenoh_listener:
    """An independent subscriber in its own process, ended by closing its input."""

    def __init__(self, endpoint: str, seen: Shown) -> None:
        self.endpoint, self.seen = endpoint, seen

    def __enter__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", LISTENER, self.endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout
        assert self.process.stdout.readline() == "ready\n"
        self.thread = threading.Thread(target=self.read)
        self.thread.start()

    def read(self) -> None:
        assert self.process.stdout
        self.seen.heard += [json.loads(line) for line in self.process.stdout]

    def __exit__(self, *_: object) -> None:
        assert self.process.stdin
        self.process.stdin.close()
        try:
            self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.thread.join(10)


def watch_registers(port: int, seen: Shown, until: float) -> None:
    if not shutil.which("mbpoll"):
        return
    places = register_map()
    wanted = ("test_float", "heartbeat", "stiffness", "stiffness_sd")
    pause = threading.Event()
    while time.monotonic() < until:
        seen.polls.append({name: poll(port, *places[name]) for name in wanted})
        pause.wait(0.5)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--effect", "bakclash"), "did you mean 'backlash'"),
        (("--folder", "/dev/null/here"), "--folder /dev/null/here: cannot make: Not a directory"),
        (("--log", "/nowhere/sent.csv"), "--log /nowhere/sent.csv: cannot write: No such file or directory"),
        (("--seconds", "nan"), "--seconds nan: expected above 0"),
    ],
)
def test_what_it_cannot_do_is_refused_in_one_line(
    words: tuple[str, str], line: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", *words]) == 2
    said = capfd.readouterr().err
    assert line in said and len(said.splitlines()) == 1


def test_a_port_that_another_program_has_is_replaced_and_told(caplog: pytest.LogCaptureFixture) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        (instead,) = ports_near([taken], any_port=False)
        assert instead != taken
        assert f"port {taken} is taken" in caplog.text
    assert ports_near([taken], any_port=False) == [taken]


def test_of_many_free_ports_no_two_are_the_same() -> None:
    """One at a time, each given back before the next is asked for, the same comes twice in so many now and then."""
    assert len(set(ports_near([8080] * 400, any_port=True))) == 400


@pytest.mark.slow
def test_it_ends_by_itself_and_sums_up(shown: Shown) -> None:
    assert shown.code == 0, shown.output
    assert "stiffness" in shown.output and "truth" in shown.output
    assert "Traceback" not in shown.output


def test_a_subscriber_hears_every_topic(shown: Shown) -> None:
    heard = {str(message["key"]) for message in shown.heard}
    assert {f"strainwave/v1/demo/bench/axis-1/{topic}" for topic in TOPICS} <= heard


def test_messages_are_numbered_without_gaps(shown: Shown) -> None:
    bodies = [m["body"] for m in shown.heard if str(m["key"]).endswith("/stiffness")]
    numbers = [body["sequence"] for body in bodies if isinstance(body, dict)]
    assert len(numbers) > 10
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_a_plc_reads_the_constant_a_moving_heartbeat_and_the_true_stiffness(shown: Shown) -> None:
    if not shutil.which("mbpoll"):
        pytest.skip("mbpoll is not installed")
    assert {reading["test_float"] for reading in shown.polls} == {12345.0}
    assert len({reading["heartbeat"] for reading in shown.polls}) > 5
    last = shown.polls[-1]
    assert last["stiffness_sd"] < 0.05 * last["stiffness"]
    assert abs(last["stiffness"] - STIFFNESS_NM_PER_RAD) < 3 * last["stiffness_sd"]


def test_the_exported_recording_is_what_the_drive_sent_to_the_last_count(shown: Shown) -> None:
    out = shown.folder / "out.csv"
    words = ["export", "--store", str(shown.folder / "demo.sqlite"), "--out", str(out)]
    subprocess.run([sys.executable, "-m", "edge_daemon", *words], check=True, capture_output=True, timeout=60)
    with out.open() as file:
        rows = list(csv.DictReader(file))
    exported = np.array(
        [[float(row[name] or "nan") for name in ("time_s", "theta_in_rad", "theta_out_rad")] for row in rows]
    )
    whole = np.isfinite(exported).all(axis=1)
    assert whole.sum() > 1000 * (SECONDS - 6)
    sent = np.genfromtxt(shown.folder / "sent.csv", delimiter=",", names=True)
    counts = np.column_stack([sent["counts_in"], sent["counts_out"]])
    steps = np.array([2 * np.pi / 131_072, 2 * np.pi / 16_777_216])
    measured = np.round((exported[whole, 1:] - exported[whole][0, 1:]) / steps)
    gaps = np.flatnonzero((np.diff(exported[whole, 0]) > 1.5e-3) | (np.diff(np.flatnonzero(whole)) > 1)) + 1
    begin = 0
    for run in np.split(measured, gaps):  # a busy machine loses blocks; what it keeps is in order and exact
        begin = following(counts, run, begin) + len(run)


def following(counts: np.ndarray, run: np.ndarray, begin: int) -> int:
    """Where the run's steps stand among the counts that were sent, from `begin` on."""
    for i in range(begin, len(counts) - len(run) + 1):
        if np.array_equal(counts[i : i + len(run)] - counts[i], run - run[0]):
            return i
    raise AssertionError(f"a run of {len(run)} samples was never sent like that")


def state(*, link: str = "ok", error: float = 0.0) -> GatewayState:
    """A gateway with one drive whose model misses `error`, where noise alone would make 0.2 %."""
    rows = {"model_nrmse": error, "model_noise_floor": 0.002}
    found = {name: Estimate(name, value, 1e-4, "1", Status.VALID, 0.0) for name, value in rows.items()}
    snapshots = {"axis-1": Snapshot("axis-1", 1, 0.0, NE107.OK, (), found)}
    return GatewayState("demo", "bench", "0", 0.0, 1.0, snapshots, (), (), (), (LinkHealth("modbus", link, "", {}),))


def truths(*effects: str) -> list[dict[str, object]]:
    known = dict.fromkeys(("stiffness_Nm_per_rad", "damping_Nms_per_rad", "kinematic_error_pp_rad", "ratio"), 1.0)
    return [{"truth": {**known, "parameters": {}, "noise_coefficients": [], "effects": list(effects)}}]


class Patient:
    """A daemon that works until it is told to stop, and whose ways out are then closed."""

    def __init__(self, *_: object, **__: object) -> None:
        self._stop = asyncio.Event()

    async def run(self) -> None:
        asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, lambda: None)
        asyncio.get_running_loop().call_later(0.01, os.kill, os.getpid(), signal.SIGHUP)
        await self._stop.wait()

    def stop(self) -> None:
        self._stop.set()

    def state(self) -> GatewayState:
        return state(link="down" if self._stop.is_set() else "ok")


async def test_a_terminal_that_is_closed_ends_the_demonstration_and_its_last_state_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demonstration, "Daemon", Patient)
    monkeypatch.setattr(demonstration, "where_to_look", lambda _: "")
    async with asyncio.timeout(30):
        await demonstration.until_stopped(Path(), None, truths("coulomb_friction"))
    said = capsys.readouterr().out
    assert "links: modbus ok" in said and "the simulated gear has: coulomb_friction" in said


def test_the_summary_says_when_an_effect_is_missing() -> None:
    assert "an effect is missing" in summary(state(error=0.07), truths("coulomb_friction"))
    assert "an effect is missing" not in summary(state(error=0.003), truths())


def test_faults_are_listed_and_a_wrong_one_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--faults"]) == 0
    listed = capsys.readouterr().out
    assert re.search(r"latch_shift_in +0.0003 s +motor encoder: each position is older than its stamp", listed)
    assert main(["demo", "--fault", "latch_shif@60"]) == 2
    assert capsys.readouterr().err == "edge-daemon: fault 'latch_shif': unknown: did you mean 'latch_shift'?\n"
    assert main(["demo", "--fault", "dropped:150%"]) == 2
    assert capsys.readouterr().err == "edge-daemon: fault dropped: 1.5 1: expected 0 to 1\n"
