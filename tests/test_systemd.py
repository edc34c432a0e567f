"""The unit: nothing unknown in it, and little left to attack."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
from pathlib import Path

import pytest

from edge_daemon.service.notify import Notifier

UNIT = Path(__file__).parent.parent / "systemd" / "edge-daemon.service"
needs_systemd = pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd-analyze is not installed")


def analyze(*arguments: str) -> str:
    environment = os.environ | {"SYSTEMD_COLORS": "0", "SYSTEMD_PAGER": ""}
    done = subprocess.run(
        ["systemd-analyze", *arguments], capture_output=True, text=True, timeout=60, env=environment, check=False
    )
    return done.stdout + done.stderr


@needs_systemd
def test_systemd_finds_nothing_to_say_about_the_unit(tmp_path: Path) -> None:
    """`verify` exits 0 even on unknown keys, so any output at all is a failure."""
    copy = tmp_path / UNIT.name
    copy.write_text(re.sub(r"^ExecStart=\S+", "ExecStart=/bin/true", UNIT.read_text(), flags=re.MULTILINE))
    assert analyze("verify", str(copy)) == ""


@needs_systemd
def test_a_misspelt_key_would_be_found(tmp_path: Path) -> None:
    copy = tmp_path / UNIT.name
    copy.write_text(UNIT.read_text().replace("ProtectHome=", "ProtectHouse="))
    assert "ProtectHouse" in analyze("verify", str(copy))


@needs_systemd
def test_the_exposure_level_is_below_two() -> None:
    found = re.search(r"exposure level for .*: ([\d.]+)", analyze("security", "--offline=yes", str(UNIT)))
    assert found and float(found[1]) < 2.0


@pytest.mark.parametrize(("kind", "driver"), [("i2c", "i2c_dev"), ("ttyUSB", "usbserial"), ("ttyACM", "cdc_acm")])
def test_an_adapter_that_is_plugged_later_may_be_opened(kind: str, driver: str) -> None:
    """systemd lets in only the kinds of devices that the kernel knows when the service starts."""
    unit = UNIT.read_text()
    assert f"DeviceAllow=char-{kind} rw" in unit
    for key in ("Wants", "After"):
        assert re.search(rf"^{key}=.*\bmodprobe@{driver}\.service\b", unit, flags=re.MULTILINE), key


def test_a_reload_is_a_hangup_and_needs_no_further_program() -> None:
    found = re.search(r"^ExecReload=(.*)", UNIT.read_text(), flags=re.MULTILINE)
    assert found
    with subprocess.Popen(["/bin/sleep", "60"]) as daemon:
        subprocess.run(shlex.split(found[1]), env={"MAINPID": str(daemon.pid), "PATH": ""}, check=True, timeout=60)
        assert daemon.wait(60) == -signal.SIGHUP


def test_the_service_manager_is_told_in_its_own_words(tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        manager.settimeout(5)
        Notifier(address).send(READY=1, STATUS="measuring")
        assert manager.recv(1024) == b"READY=1\nSTATUS=measuring"


def test_a_service_manager_that_is_gone_ends_nothing(tmp_path: Path) -> None:
    Notifier(str(tmp_path / "nobody")).send(WATCHDOG=1)
    Notifier("").send(WATCHDOG=1)
