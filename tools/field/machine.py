"""One emulated machine: started from its snapshot, told what to do by its agent, pulled out of the wall."""

from __future__ import annotations

import ctypes
import itertools
import json
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

READY = "ready"
"""The snapshot in which the daemon measures."""
CONSOLE_S = 600.0
"""No boot takes longer."""

PR_SET_PDEATHSIG = 1
"""Option of prctl(2)."""


class GuestError(Exception):
    """The guest did not do what it was told."""


class NoMachine(Exception):
    """The emulator itself does not run."""


@dataclass(slots=True)
class Answer:
    """What a command in the guest ended with."""

    code: int
    said: str
    time_s: float
    """the guest's clock"""


@dataclass(slots=True)
class Line:
    """JSON lines over a Unix socket."""

    path: Path
    _socket: socket.socket = field(default_factory=lambda: socket.socket(socket.AF_UNIX))
    _rest: bytes = b""

    def open(self, within_s: float = 20.0) -> None:
        """Connects as soon as somebody listens."""
        until_s = time.monotonic() + within_s
        while True:
            try:
                self._socket.connect(str(self.path))
                return
            except OSError as error:
                if time.monotonic() > until_s:
                    raise GuestError(f"{self.path.name}: nobody listens") from error
                time.sleep(0.05)

    def write(self, what: dict[str, Any]) -> None:
        self._socket.sendall(json.dumps(what).encode() + b"\n")

    def read(self, timeout_s: float) -> dict[str, Any]:
        """The next line. Raises TimeoutError, or `GuestError` at the end."""
        self._socket.settimeout(timeout_s)
        while b"\n" not in self._rest:
            data = self._socket.recv(65_536)
            if not data:
                raise GuestError(f"{self.path.name}: hung up")
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return dict(json.loads(line))

    def close(self) -> None:
        self._socket.close()


class Machine:
    """`folder` holds kernel, initrd and the two disks, and takes sockets and consoles."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._numbers = itertools.count(1)
        self._process: subprocess.Popen[bytes] | None = None
        self._control, self._agent = Line(folder / "control"), Line(folder / "agent")
        self._lock = threading.Lock()

    # power

    def start(self, snapshot: str | None = READY) -> None:
        """Boots, or goes on from a snapshot; returns when the agent answers. Raises `NoMachine`."""
        for name in ("control", "agent", "wire"):
            (self.folder / name).unlink(missing_ok=True)
        with (self.folder / "emulator.log").open("wb") as log:
            self._process = subprocess.Popen(
                self._command(snapshot), stdin=subprocess.DEVNULL, stdout=log, stderr=log, preexec_fn=_end_with_parent
            )
        self._control, self._agent = Line(self.folder / "control"), Line(self.folder / "agent")
        try:
            self._control.open()
            self._control.read(20.0)
            self.ask("qmp_capabilities")
            self._agent.open()
            self._wait_for_agent()
        except Exception as error:
            self.cut()
            raise NoMachine(f"{error}: {(self.folder / 'emulator.log').read_text()[-500:]}") from error

    def _command(self, snapshot: str | None) -> list[str]:
        disks = [f"file={self.folder / name}.qcow2,if=virtio,cache=writeback" for name in ("root", "data")]
        sockets = [f"socket,id={name},path={self.folder / name},server=on,wait=off" for name in ("agent", "wire")]
        return [
            *("qemu-system-x86_64", "-M", "q35", "-accel", "tcg,thread=multi,tb-size=512"),
            *("-cpu", "max", "-smp", "2", "-m", "1536", "-nic", "none", "-display", "none", "-nodefaults"),
            *("-kernel", str(self.folder / "vmlinuz"), "-initrd", str(self.folder / "initrd")),
            *("-append", "root=/dev/vda rw console=ttyS0 panic=5 mitigations=off quiet"),
            *(part for disk in disks for part in ("-drive", disk)),
            *(part for text in sockets for part in ("-chardev", text)),
            *("-chardev", f"socket,id=far,path={self.folder / 'wire'},reconnect=1"),
            *("-chardev", f"file,id=console,path={self.folder / 'console.log'},append=on"),
            *("-serial", "chardev:console", "-serial", "chardev:far"),
            *("-device", "virtio-serial", "-device", "virtserialport,chardev=agent,name=agent"),
            *(
                "-object",
                "can-bus,id=wire0",
                "-device",
                "kvaser_pci,canbus=wire0",
                "-device",
                "kvaser_pci,canbus=wire0",
            ),
            *("-device", "qemu-xhci,id=usb"),
            *("-qmp", f"unix:{self.folder / 'control'},server=on,wait=off"),
            *(("-loadvm", snapshot) if snapshot else ()),
        ]

    def _wait_for_agent(self) -> None:
        until_s = time.monotonic() + CONSOLE_S
        while True:
            try:
                self.run("true", timeout_s=5.0)
                return
            except TimeoutError:
                if time.monotonic() > until_s or (self._process and self._process.poll() is not None):
                    raise GuestError("the guest's agent does not answer") from None

    def cut(self) -> None:
        """The power is cut: what the guest has not synced is lost."""
        if self._process:
            self._process.kill()
            self._process.wait()
            self._process = None
        self._control.close()
        self._agent.close()

    def ask(self, command: str, **arguments: Any) -> Any:
        """The emulator's own control (QMP). Raises `GuestError` with its words."""
        with self._lock:
            self._control.write({"execute": command, "arguments": arguments})
            while True:
                answer = self._control.read(120.0)
                if "error" in answer:
                    raise GuestError(f"{command}: {answer['error']['desc']}")
                if "return" in answer:
                    return answer["return"]

    def save(self, snapshot: str = READY) -> None:
        """Memory and disks as they are, to go on from."""
        said = self.ask("human-monitor-command", **{"command-line": f"savevm {snapshot}"})
        if said:
            raise GuestError(f"savevm: {said.strip()}")

    def plug(self) -> None:
        """Puts the serial adapter in."""
        self.ask("device_add", driver="usb-serial", id="adapter", chardev="wire", bus="usb.0", serial="FIELD")

    def unplug(self) -> None:
        """Pulls the serial adapter."""
        self.ask("device_del", id="adapter")

    # in the guest

    def run(self, command: str, timeout_s: float = 60.0) -> Answer:
        """A shell command in the guest. Raises TimeoutError if no answer comes."""
        return self._asked(timeout_s, run=command)

    def page(self, path: str) -> Answer:
        """What the daemon's page answers, with its status; 0 where it does not."""
        return self._asked(30.0, get=path)

    def _asked(self, timeout_s: float, **what: str) -> Answer:
        number = next(self._numbers)
        self._agent.write({"id": number, "timeout_s": timeout_s, **what})
        until_s = time.monotonic() + 4 * timeout_s  # its seconds are longer than ours
        while True:
            answer = self._agent.read(max(0.1, until_s - time.monotonic()))
            if answer["id"] == number:
                return Answer(answer["code"], answer["said"], answer["time_s"])

    def do(self, command: str, timeout_s: float = 60.0) -> str:
        """What a command says that has to succeed."""
        answer = self.run(command, timeout_s)
        if answer.code:
            raise GuestError(f"{command}: {answer.code}: {answer.said.strip()[-500:]}")
        return answer.said.strip()

    def until(self, command: str, good: Callable[[str], bool], within_s: float, every_s: float = 0.5) -> str:
        """What a command says as soon as that is good. Raises `GuestError`."""
        end_s = time.monotonic() + within_s
        while not good(said := self.run(command).said.strip()):
            if time.monotonic() > end_s:
                raise GuestError(f"not within {within_s:.0f} s: {command}: {said[-500:]}")
            time.sleep(every_s)
        return said


@contextmanager
def running(machine: Machine) -> Iterator[Machine]:
    """Plugged in, and off at the end whatever happens."""
    machine.start()
    try:
        machine.plug()
        yield machine
    finally:
        machine.cut()


def _end_with_parent() -> None:
    """No emulator is left running, whatever ends this process."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
