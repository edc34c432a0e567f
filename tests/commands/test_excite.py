"""`excite` and `measure` as a person types them: refusals, the dead man's switch, and three methods that agree."""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
import tomlkit
from msgspec import structs

from edge_daemon.cli import main
from edge_daemon.clock import Clock
from edge_daemon.commands import excite
from edge_daemon.config.reading import load
from edge_daemon.demo import moved_drive
from edge_daemon.errors import BadInput
from edge_daemon.excite.arming import arm
from edge_daemon.excite.drive_link import SDO_TIMEOUT_S
from edge_daemon.excite.operator import operator
from edge_daemon.excite.profiles import planned_motion
from edge_daemon.excite.sequence import Outcome
from edge_daemon.recordings.recording import read_recording, write_recording
from edge_daemon.service.motion_recording import MotionLog
from edge_daemon.servo.drive import JOINT, Servo, truth

CONFIG = Path(__file__).parents[2] / "config"
BENCH = CONFIG / "excite_demo.toml"
PATIENCE_S = 200.0
pytestmark = pytest.mark.timeout(300)


@contextmanager
def held_terminal() -> Iterator[int]:
    """A terminal that stays open: what to read from."""
    read_end, write_end = os.pipe()
    try:
        yield read_end
    finally:
        os.close(read_end)
        os.close(write_end)


def changed(folder: Path, change: Any) -> Path:
    """The bench's configuration with a change."""
    document: Any = tomlkit.parse(BENCH.read_text())
    change(document["drive"][0]["excite"], document)
    (folder / "axis.model.toml").write_text((CONFIG / "axis.model.toml").read_text())
    file = folder / "bench.toml"
    file.write_text(tomlkit.dumps(document))
    return file


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The one line with which a command is refused."""
    assert main(words) == 2
    line = capsys.readouterr().err
    assert line.startswith("edge-daemon: ") and line.count("\n") == 1, line
    return line


# ---- before anything moves


def test_dry_run_checks_and_moves_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["excite", "--config", str(BENCH), "--profile", "shake", "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"speed +85 +90 +100 +rad/s +yes", said) and "nothing was moved" in said


def test_a_profile_beyond_a_limit_is_shown_and_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = changed(tmp_path, lambda excite, _: excite["limits"].update(speed_rad_s=90.0))
    assert main(["excite", "--config", str(file), "--profile", "shake", "--arm", "axis-1"]) == 2
    said = capsys.readouterr()
    assert re.search(r"speed +85 +81 +90 +rad/s +NO", said.out)
    assert "limits.speed_rad_s: the profile needs 85: expected at most 81" in said.err


def test_configuration_and_typed_name_are_both_needed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["excite", "--config", str(BENCH), "--drive", "axis-1", "--profile", "shake"]
    assert "expected its name typed after --arm" in refused(capsys, *words)
    assert "got 'axis-2'" in refused(capsys, *words, "--arm", "axis-2")
    file = changed(tmp_path, lambda excite, _: excite.update(allowed=False))
    words[2] = str(file)
    assert "expected `allowed = true`" in refused(capsys, *words, "--arm", "axis-1")


def test_names_that_do_not_exist_are_answered_with_those_that_do(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["excite", "--config", str(BENCH), "--profile"]
    assert "expected one of staircase, shake, slow" in refused(capsys, *words, "wobble")
    assert "expected --drive with one of axis-1" in refused(capsys, *words, "shake", "--drive", "axis-9")
    gateway = str(CONFIG / "gateway.toml")
    assert "expected a [drive.excite] section" in refused(
        capsys, "excite", "--config", gateway, "--drive", "axis-1", "--profile", "shake"
    )


def test_a_recording_that_cannot_be_kept_is_known_before_the_motion(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["excite", "--config", str(BENCH), "--profile", "shake", "--arm", "axis-1", "--out"]
    assert "no such folder" in refused(capsys, *words, "/nonexistent/x.csv")
    assert "expected a name that ends in" in refused(capsys, *words, "x.wav")


def test_a_bus_that_cannot_be_opened_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def gone(_excite: Any, document: Any) -> None:
        document["can"][0]["channel"] = str(tmp_path / "no-such-tty")

    words = ("excite", "--config", str(changed(tmp_path, gone)), "--profile", "shake", "--arm", "axis-1")
    with held_terminal() as given, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdin", os.fdopen(os.dup(given)))
        assert "cannot open slcan" in refused(capsys, *words)


def test_the_example_for_gateways_is_valid_once_its_comment_signs_are_gone(tmp_path: Path) -> None:
    text = (CONFIG / "gateway.toml").read_text()
    start, end = text.index("# [drive.excite]"), text.index('[[drive]]\nname = "axis-2"')
    example = re.sub(r"^# ?", "", text[start:end], flags=re.MULTILINE)
    file = tmp_path / "gateway.toml"
    file.write_text(text[:start] + example + text[end:])
    excite = load(file).drive[0].excite
    assert excite is not None and excite.allowed and planned_motion(excite.profile[0], 0.004).parts[2] == "steady"


def test_a_reader_of_the_drives_process_data_must_expect_what_the_motion_maps(tmp_path: Path) -> None:
    def other(_excite: Any, document: Any) -> None:
        document["can"][0]["pdo"][2]["objects"] = ["statusword", "torque_actual"]

    with pytest.raises(BadInput, match=r"pdo\[2\].objects: a test motion maps"):
        load(changed(tmp_path, other))


# ---- the person


def soon(condition: Any) -> bool:
    """Whether it became true in time."""
    tick = threading.Event()
    return any(condition() or tick.wait(0.002) for _ in range(10_000))


def test_enter_stops_the_motion_and_the_end_of_input_lets_go() -> None:
    it = load(BENCH).drive[0].excite
    assert it is not None
    read_end, write_end = os.pipe()
    with operator(it, hold=False, descriptor=read_end) as hand:
        assert not hand.reason and not hand.dead_man.gone
        os.write(write_end, b"\n")
        assert soon(lambda: hand.reason == "stopped by Enter")
        os.close(write_end)
        assert soon(lambda: hand.dead_man.gone == "the operator let go")
    os.close(read_end)


def test_with_hold_only_enter_is_a_sign_of_life() -> None:
    it = load(BENCH).drive[0].excite
    assert it is not None
    brief = structs.replace(it, dead_man_s=0.05)
    read_end, write_end = os.pipe()
    with operator(brief, hold=True, descriptor=read_end) as hand:
        assert soon(lambda: hand.dead_man.gone.startswith("no sign of life"))
        assert soon(lambda: os.write(write_end, b"\n") and not hand.dead_man.gone)
        assert not hand.reason
    os.close(write_end)
    os.close(read_end)


def test_the_outcome_is_told_in_words() -> None:
    assert excite.outcome_words(Outcome(True, True, "")) == "completed; the drive stands"
    assert "look at the machine" in excite.outcome_words(Outcome(False, False, "bus: gone"))


def test_a_motion_that_was_stopped_leaves_an_earlier_recording_alone(tmp_path: Path) -> None:
    asked = tmp_path / "shake.csv"
    assert excite.kept_as(asked, Outcome(True, True, "")) == asked
    stopped = Outcome(False, True, "stopped by Enter")
    assert excite.kept_as(asked, stopped) == tmp_path / "shake.stopped.csv"
    assert excite.kept_as(tmp_path / "a.parquet", stopped).name == "a.stopped.parquet"


# ---- what is heard


def test_an_encoder_that_falls_silent_is_a_doubt() -> None:
    settings = load(BENCH)
    now = [100.0]
    log = MotionLog(settings.can[0], CONFIG, settings.drive[0], Clock(lambda: now[0], lambda: now[0]))
    assert log.doubts() == ""  # no SYNC yet: nothing to answer
    servo = Servo(0.005)
    for cycle in range(400):
        now[0] += 0.005
        log.synchronised()
        for identifier, data in servo.take(0x80, b""):
            if cycle < 200 or identifier != 0x182:
                log.on_message_received(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        if cycle == 199:
            assert log.doubts() == ""
    assert log.doubts().startswith("theta_out_rad is silent")


# ---- the whole way, on the simulated drive


def run(folder: Path, *words: str, stdin: int = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    """One command as a process; standard input as given."""
    command = [sys.executable, "-m", "edge_daemon", *words]
    return subprocess.run(
        command, cwd=folder, stdin=stdin, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )


@pytest.mark.slow
def test_without_a_terminal_nothing_moves_far(tmp_path: Path) -> None:
    done = run(tmp_path, "excite", "--demo", "--profile", "slow", "--out", "slow.csv", stdin=subprocess.DEVNULL)
    assert done.returncode == 1 and "ended early: the operator let go; the drive stands" in done.stdout, done
    assert np.ptp(read_recording(tmp_path / "slow.stopped.csv").columns["theta_in_rad"]) < 1.0
    assert not (tmp_path / "slow.csv").exists()
    assert "slow.csv: not written: what was recorded is only the beginning" in done.stdout


@contextmanager
def in_motion(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """`excite --demo`, as soon as it says that it moves."""
    command = [sys.executable, "-m", "edge_daemon", "excite", "--demo", "--profile", "staircase", "--out", "s.csv"]
    process = subprocess.Popen(
        command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stderr and process.stdin
        assert "moving axis-1" in process.stderr.readline()
        yield process
    finally:
        process.kill()
        process.wait(PATIENCE_S)


def check_it_stops(process: subprocess.Popen[str]) -> None:
    """On a signal; its input stays open, so that nothing else stops it."""
    process.terminate()
    process.wait(PATIENCE_S)
    said = "".join(pipe.read() for pipe in (process.stdout, process.stderr) if pipe)
    assert process.returncode == 1 and "stopped by SIGTERM; the drive stands" in said, said


@pytest.mark.slow
def test_a_signal_stops_the_motion_and_keeps_what_was_recorded(tmp_path: Path) -> None:
    with in_motion(tmp_path) as process:
        check_it_stops(process)


@pytest.mark.slow
def test_a_simulated_drive_that_a_busy_machine_keeps_waiting_is_waited_for(tmp_path: Path) -> None:
    """Held before it is configured, longer than a real drive may think about an answer."""
    with in_motion(tmp_path) as process:
        drive = int(Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text())
        os.kill(drive, signal.SIGSTOP)
        try:
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(3 * SDO_TIMEOUT_S)
        finally:
            os.kill(drive, signal.SIGCONT)
        check_it_stops(process)


def test_a_second_signal_does_not_lose_what_is_being_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = []

    def write(path: Path, *_: Any) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        written.append(path)

    stopped = Outcome(False, True, "stopped by SIGTERM")
    monkeypatch.setattr(excite, "move", lambda *_: (stopped, None))
    monkeypatch.setattr(excite, "write_motion", write)
    settings = load(BENCH)
    task = excite.ExciteTask(arm(settings.drive[0], "axis-1"), settings.drive[0], None, settings, tmp_path)  # type: ignore[arg-type]
    with held_terminal() as given, os.fdopen(os.dup(given)) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        assert excite.make(task, False, tmp_path / "s.csv", excite.Pace()) is stopped
    assert written == [tmp_path / "s.csv"]


@pytest.mark.slow
def test_three_methods_agree_with_the_simulated_gear(tmp_path: Path) -> None:
    def moved(profile: str) -> subprocess.CompletedProcess[str]:
        words = ("excite", "--demo", "--profile", profile, "--out", f"{profile}.csv", "--model", f"{profile}.toml")
        return run(tmp_path, *words, stdin=given)

    with held_terminal() as given, ThreadPoolExecutor() as both:
        for done in both.map(moved, ("staircase", "shake")):
            assert done.returncode == 0 and "completed; the drive stands" in done.stdout, done
    phase = read_recording(tmp_path / "shake.csv").columns["profile_phase"]
    assert set(phase) == {0.0, 1.0, 2.0, 3.0}
    words = ("measure", "all", "staircase.csv", "shake.csv", "--model", "shake.toml", "--json", "-")
    found = json.loads(run(tmp_path, *words).stdout)
    best = {row["method"]: row for row in found["measurements"] if row["best"]}
    assert best.keys() == {"static", "frequency-response", "dynamic"} and found["agree"], found
    assert best["static"]["recording"] == "staircase.csv" and best["frequency-response"]["recording"] == "shake.csv"
    for row in best.values():
        assert abs(row["value"] - JOINT.stiffness_Nm_per_rad) < 4 * row["sd"] < 0.01 * row["value"], row


# ---- measure


def shaken(path: Path, model: Path, *, with_phase: bool = False) -> None:
    """Ten seconds of a plain gear without noise, and its model."""
    time_s = np.arange(10_000) / 1000
    angle, acceleration = np.zeros(len(time_s)), np.zeros(len(time_s))
    for f in (1.5, 4.0, 9.0):
        angle += 4 / f * np.sin(2 * np.pi * f * time_s)
        acceleration -= 4 / f * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time_s) / 100
    torque = JOINT.inertia_kg_m2 * acceleration
    columns = {
        "theta_in_rad": angle + 100 * torque / JOINT.stiffness_Nm_per_rad,
        "theta_out_rad": angle / 100,
        "torque_out_Nm": torque,
    }
    if with_phase:
        columns["profile_phase"] = np.where(time_s < 9, 2.0, 0.0)
    write_recording(path, time_s, columns)
    moved_drive.write_first_model(model, truth())


def test_one_method_alone_gives_its_value_and_no_verdict_on_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shaken(tmp_path / "r.csv", tmp_path / "m.toml", with_phase=True)
    words = ["measure", "frequency-response", str(tmp_path / "r.csv"), "--model", str(tmp_path / "m.toml")]
    assert main([*words, "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["agree"] is None and found["pairs"] == []
    assert abs(found["measurements"][0]["value"] / JOINT.stiffness_Nm_per_rad - 1) < 1e-3
    assert "expected one of [0, 2]" in refused(capsys, *words, "--phase", "7")


def test_measure_refuses_what_it_cannot_use(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shaken(tmp_path / "r.csv", tmp_path / "m.toml")
    words = ["measure", "static", str(tmp_path / "r.csv"), "--model", str(tmp_path / "m.toml")]
    assert "expected at least 12" in refused(capsys, *words)
    assert "--inertia-sd -1.0: expected 0 or more" in refused(capsys, *words, "--inertia-sd", "-1")
    assert "no column profile_phase" in refused(capsys, *words, "--phase", "1")
    (tmp_path / "m.toml").write_text('[joint]\nbalance = "drive"\nratio = 100.0\n[[effect]]\nname = "inertia"\n')
    assert "expected 'torsion'" in refused(capsys, *words)
    write_recording(tmp_path / "r.csv", np.arange(5.0), {"theta_in_rad": np.zeros(5)})
    moved_drive.write_first_model(tmp_path / "m.toml", truth())
    assert "no column theta_out_rad" in refused(capsys, *words)


def test_the_simulated_pace_waits_for_the_answer_and_lets_the_cycle_pass() -> None:
    pace = moved_drive.SimulatedPace()
    pace.on_message_received(can.Message(arbitration_id=moved_drive.LAST_FRAME))
    pace.wait(0.005)
    assert pace.now() == 0.005


def test_the_command_line_offers_a_configuration_or_the_demonstration_not_both() -> None:
    with pytest.raises(SystemExit):
        main(["excite", "--demo", "--config", "x.toml", "--profile", "shake"])
    with pytest.raises(BadInput, match="only with --demo"):
        excite.excite(argparse.Namespace(demo=False, model=Path("m.toml")))


def test_nothing_is_moved_for_a_recording_that_cannot_be_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "shake.csv"
    out.mkdir()
    assert main(["excite", "--demo", "--profile", "shake", "--out", str(out)]) == 2
    said = capsys.readouterr()
    assert said.err == f"edge-daemon: --out {out}: cannot write: Is a directory: nothing was moved\n"
    assert said.out == ""
