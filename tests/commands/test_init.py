"""From nothing to a configuration that is valid, probed and running, against simulated buses."""

from __future__ import annotations

import asyncio
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from edge_daemon.cli import main
from edge_daemon.commands.init import answered
from edge_daemon.config.reading import load
from edge_daemon.rig.child import RigProcess
from edge_daemon.rig.i2c_face import open_bus
from edge_daemon.service.configuration import examined
from edge_daemon.service.daemon import Daemon
from edge_daemon.service.probe import probe
from edge_daemon.servo.cia402_face import Cia402Face, serve

WITHIN_S = 20.0
NODE = 3
COUNTS = 65536
OFFLINE = (
    '\n[zenoh]\nenabled = false\n\n[modbus_server]\nport = 0\n\n[dashboard]\nport = 0\n\n[store]\nfile = "s.sqlite"\n'
)


def made(out: Path, *words: str) -> str:
    """The text that `init` wrote with these flags."""
    assert main(["init", "--out", str(out), "--inertia", "0.19", *words]) == 0
    return out.read_text()


@contextmanager
def servo_on(channel: str) -> Iterator[Cia402Face]:
    """A drive that sends nothing until it is mapped and started."""
    face, stop = Cia402Face(NODE, COUNTS, rated_torque_Nm=0.64), threading.Event()
    face.motor.position_rad = 1.5
    with can.Bus(channel, interface="virtual") as bus:
        thread = threading.Thread(target=serve, args=(bus, face, stop, time.monotonic))
        thread.start()
        try:
            yield face
        finally:
            stop.set()
            thread.join(WITHIN_S)


async def until_measured(file: Path) -> None:
    """The daemon on this configuration, until its drive has fresh data; fails where that never comes."""
    daemon = Daemon(file, i2c_bus=lambda name: open_bus(str(name)))
    running = asyncio.create_task(daemon.run())
    try:
        async with asyncio.timeout(WITHIN_S):
            while not any(row.estimates for row in daemon.state().snapshots.values()):
                assert not running.done()
                await asyncio.sleep(0.05)
    finally:
        daemon.stop()
        await running


def test_from_nothing_to_a_running_daemon_on_serial_can_i2c_and_modbus(tmp_path: Path) -> None:
    folder, out = tmp_path / "simulated", tmp_path / "gateway.toml"
    with RigProcess(["--folder", str(folder)]) as rig:
        sensor = f"127.0.0.1:{rig.ready['modbus_port']}@1"
        more = ("--i2c", "1:bmp280", "--modbus", sensor, "--read", "temperature_ambient_degC:2:i16:0.01")
        text = made(out, "--bus", "simulated", *more)
        out.write_text(text.replace("bus = 1 ", f'bus = "{rig.ready["drives"][0]["i2c"]}"') + OFFLINE)
        found, amiss = probe(out, 0.5, i2c_bus=lambda name: open_bus(str(name)))
        rows = {line.split()[0]: line.split() for line in found.splitlines() if line.startswith(tuple("tp"))}
        assert amiss == ""
        assert 10.0 < float(rows["temperature_degC"][1]) < 60.0
        assert 9e4 < float(rows["pressure_Pa"][1]) < 2e5
        assert float(rows["theta_in_rad"][1]) == pytest.approx(100 * float(rows["theta_out_rad"][1]), abs=0.5)
        assert "0x181" in found and "EncoderIn1" in found
        asyncio.run(until_measured(out))


def test_what_does_not_answer_is_named_and_the_exit_is_two(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "gateway.toml"
    made(out, "--bus", "simulated", "--modbus", "/dev/no-such-port@17", "--read", "temperature_degC:0:i16:0.1")
    monkeypatch.setattr("edge_daemon.service.probe.MOST_WAIT_S", 0.0)
    assert main(["check", str(out), "--probe", "--seconds", "0.1"]) == 2
    said = capsys.readouterr()
    assert "modbus: /dev/no-such-port: no such serial device: plugged in?" in said.out
    assert "can0: no such serial device" in said.out
    assert "nothing came for axis-1 theta_in_rad, axis-1 theta_out_rad" in said.err


def canopen(folder: Path, channel: str) -> Path:
    out = folder / "gateway.toml"
    words = ("--bus", "canopen", "--can", f"virtual:{channel}", "--motor-encoder", "-", "--output-encoder", "-")
    text = made(out, *words, "--servo", f"{NODE}:0.64:{COUNTS}")
    out.write_text(text.replace("start_nodes = false", "map_pdos = true") + OFFLINE)
    return out


def test_a_drive_on_canopen_is_mapped_started_and_read(tmp_path: Path) -> None:
    channel = uuid.uuid4().hex
    out = canopen(tmp_path, channel)
    with servo_on(channel) as face:
        found, amiss = probe(out, 0.5)
        assert amiss == "" and face.operational and face.state == "switch on disabled"
        row = next(line for line in found.splitlines() if line.startswith("theta_in_rad"))
        assert float(row.split()[1]) == pytest.approx(1.5, abs=2 * 6.29 / COUNTS)


def test_a_node_that_is_not_there_stops_its_bus_with_one_line(tmp_path: Path) -> None:
    out = canopen(tmp_path, uuid.uuid4().hex)
    found, amiss = probe(out, 0.1)
    assert f"can: node {NODE}: 0x1800:1: no answer: powered, on this bus, and of this number?" in found
    assert "theta_in_rad" in amiss


def test_what_a_bus_carries_is_told_and_proposed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge_daemon.service.probe.MOST_WAIT_S", 0.0)
    channel = uuid.uuid4().hex
    out = canopen(tmp_path, channel)
    with servo_on(channel):
        probe(out, 0.2)  # maps and starts it
        out.write_text(
            out.read_text().replace(f"0x{0x180 + NODE:03x}", f"0x{0x280 + NODE:03x}").replace("map_pdos", "start_nodes")
        )
        found, _ = probe(out, 0.2)
    line = (
        f"node {NODE}: no profile known here; 0x{0x180 + NODE:03X} carries statusword, position_actual, torque_actual"
    )
    assert line in found


async def test_unconfigured_process_data_become_a_line_to_paste(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edge_daemon.service.probe.MOST_WAIT_S", 0.0)
    channel = uuid.uuid4().hex
    out = canopen(tmp_path, channel)
    with servo_on(channel):
        await asyncio.to_thread(probe, out, 0.2)
        out.write_text(
            out.read_text()
            .replace(f"node = {NODE}, cob_id = 0x{0x180 + NODE:03x}", "node = 9, cob_id = 0x189")
            .replace(f'"{NODE}:', '"9:')
            .replace("map_pdos = true", "start_nodes = false")
        )
        with can.Bus(channel, interface="virtual") as master:
            task = master.send_periodic(can.Message(arbitration_id=0x80, is_extended_id=False), 0.01)
            found, amiss = await asyncio.to_thread(probe, out, 0.3)
            task.stop()
    objects = '["statusword", "position_actual", "torque_actual"]'
    assert f"pdo could have: {{ node = {NODE}, cob_id = 0x{0x180 + NODE:03X}, objects = {objects} }}" in found
    assert "theta_in_rad" in amiss


def test_answers_are_asked_again_until_they_make_sense(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    typed = iter(["axis 1", "axis-2", "-", "-50", "nan", "0", "0.2", "canbus", "canopen", "can0", "slcan:/dev/ttyACM0",
                  "250000", "1", "1:17", "2:24", "3:0.64", "1:bmp280:0x77", "-"])  # fmt: skip
    answers = answered({}, tmp_path, lambda _: next(typed))
    assert answers["ratio"] == -50.0 and answers["bitrate"] == 250000 and answers["i2c"] == (1, "bmp280", 0x77)
    assert len(capsys.readouterr().err.splitlines()) == 6


@pytest.mark.parametrize(
    "words",
    [
        ("--bus", "canopen", "--motor-encoder", "1:17", "--output-encoder", "2:24", "--servo", "3:0.64"),
        ("--bus", "canopen", "--motor-encoder", "-", "--output-encoder", "2:24", "--servo", "3:0.64:65536"),
        ("--bus", "dbc", "--dbc", "drive.dbc"),
        ("--bus", "simulated", "--i2c", "1:tmp117:0x49"),
        ("--bus", "simulated", "--modbus", "/dev/serial/by-id/usb-1@17", "--read", "temperature_degC:0:i16:0.1"),
    ],
)
def test_what_is_written_is_valid_and_every_key_is_explained_once(tmp_path: Path, words: tuple[str, ...]) -> None:
    (tmp_path / "drive.dbc").write_text((Path(__file__).parents[1] / "acquire" / "drive.dbc").read_text())
    text = made(tmp_path / "gateway.toml", *words)
    assert {row.channel for row in load(tmp_path / "gateway.toml").drive[0].channels} >= {
        "theta_in_rad",
        "theta_out_rad",
    }
    examined(tmp_path / "gateway.toml")
    comments = [line.partition("# ")[2] for line in text.splitlines() if "# " in line]
    assert len(comments) > 10 and len(set(comments)) == len(comments)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ((), "--bus: missing: expected KIND"),
        (("--bus", "profinet"), "--bus profinet: expected one of canopen, dbc"),
        (("--bus", "canopen", "--motor-encoder", "1"), "--motor-encoder 1: expected its node"),
        (("--bus", "simulated", "--gear", "CSG-20-101"), "--gear CSG-20-101: gear 'CSG-20-101' is not in"),
        (("--bus", "simulated", "--i2c", "1:bmp280:48"), "--i2c 1:bmp280:48: address 0x48: expected 0x76 or 0x77"),
        (("--bus", "simulated", "--dbc", "a.dbc"), "--dbc: has no meaning with the other answers"),
        (("--bus", "dbc", "--dbc", "a.dbc"), "--dbc a.dbc: dbc: "),
    ],
)
def test_a_flag_that_makes_no_sense_is_one_line(
    tmp_path: Path, words: tuple[str, ...], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "gateway.toml"
    assert main(["init", "--out", str(out), "--inertia", "0.19", *words]) == 2
    assert f"edge-daemon: {line}" in capsys.readouterr().err
    assert not out.exists()


def test_nothing_is_overwritten_unasked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "gateway.toml"
    before = made(out, "--bus", "simulated")
    assert main(["init", "--out", str(out), "--inertia", "1", "--bus", "simulated"]) == 2
    assert out.read_text() == before
    assert "is there already" in capsys.readouterr().err
