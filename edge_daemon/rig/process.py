"""The rig as a process of its own: drives that run at wall-clock pace and talk on real interfaces.

`python -m edge_daemon.rig` prints one JSON line when everything answers, then obeys JSON lines on standard input and
answers each with one, until standard input ends or SIGTERM comes. Commands:

    {"drive": 1, "fault": "latch_shift", "size": 3e-4}      {"drive": 1, "repair": "latch_shift"}      (see `faults`)
    {"drive": 1, "wear": 0.5, "wear_per_s": 0.001}
    {"can": "down"|"up"}          {"can": "raw", "hex": "0d0a"}
    {"drive": 1, "i2c": "none"|"absent"|"short"|"garbage"|"previous"}
    {"drive": 1, "modbus": "none"|"exception"|"silent"|"garbage"}
    {"status": true}              {"quit": true}
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from edge_daemon.errors import BadInput
from edge_daemon.rig import bmp280, can_face, i2c_face
from edge_daemon.rig.faults import follow, known_fault, planned
from edge_daemon.rig.live import LiveDrive, Samples, live_drive
from edge_daemon.rig.modbus_face import MODBUS_FAULTS, ModbusFace

TICK_S = 0.01
MOST_BACKLOG_S = 0.5
"""A rig that falls behind further leaves time out, and says so in its status."""
LATCH_START_US = (1 << 32) - 20_000_000
"""The devices' clock rolls over 20 s after the start, so that every longer run has seen it."""


@dataclass(frozen=True, slots=True)
class RigOptions:
    """What to simulate and where to speak."""

    drives: int = 1
    seed: int = 1
    effects: tuple[str, ...] | None = None
    """None: the demo's; `2:NAME` is of drive 2 alone, and `2:none` says that it has no others"""
    parameters: dict[str, float] = field(default_factory=dict)
    wear: float = 0.0
    wear_per_s: float = 0.0
    can: str = "slcan"
    modbus_port: int = 0
    bits_in: int = 17
    bits_out: int = 24
    log: Path | None = None
    faults: tuple[str, ...] = ()
    """what goes wrong with the first drive, as `faults.planned` reads it"""
    folder: Path | None = None
    """None: a temporary one"""


class Rig:
    """Everything of one rig process but its loop; `tick` moves it on."""

    def __init__(self, options: RigOptions, folder: Path) -> None:
        if not 1 <= options.drives <= can_face.MOST_DRIVES:
            raise BadInput(f"drives: {options.drives}: expected 1 to {can_face.MOST_DRIVES}")
        self.options = options
        self.folder = folder
        self.drives: dict[int, LiveDrive] = {
            number: live_drive(
                options.seed + number - 1,
                _of_drive(options.effects, number),
                bits_in=options.bits_in,
                bits_out=options.bits_out,
                wear=options.wear,
                wear_per_s=options.wear_per_s,
                parameters=options.parameters,
            )
            for number in range(1, options.drives + 1)
        }
        self.plan = [planned(text) for text in options.faults]
        self.port = can_face.open_port(options.can, folder)
        self.modbus = ModbusFace(self.drives)
        self.buses = {number: _i2c_bus(drive) for number, drive in self.drives.items()}
        self.skipped_s = 0.0
        self._log: IO[str] | None = None
        self._servers: list[asyncio.Server] = []

    async def open(self) -> dict[str, Any]:
        """Starts to listen; what the ready line says."""
        port = await self.modbus.start(self.options.modbus_port)
        for number, bus in self.buses.items():
            self._servers.append(await i2c_face.serve(bus, self._i2c_path(number)))
        if self.options.log:
            self._log = self.options.log.open("w")
            self._log.write("drive,latch_us,time_s,counts_in,counts_out\n")
        return {
            "ready": True,
            "can": self._can_place(),
            "dbc": str(can_face.DBC_FILE),
            "modbus_port": port,
            "drives": [
                {"number": number, "i2c": f"{i2c_face.SCHEME}{self._i2c_path(number)}", "truth": drive.truth}
                for number, drive in self.drives.items()
            ],
        }

    def tick(self, until_s: float) -> None:
        """Moves every drive on to rig time `until_s`, and sends what they latched."""
        self.port.poll()
        follow(self.plan, self.drives[1])
        for number, drive in self.drives.items():
            behind_s = until_s - drive.time_s
            if behind_s > MOST_BACKLOG_S:
                drive.skip(behind_s - MOST_BACKLOG_S)
                self.skipped_s += behind_s - MOST_BACKLOG_S
            first = round(drive.time_s * 1000)
            samples = drive.advance(until_s)
            if self.port.listening:
                self._send(number, samples, first)

    def _send(self, number: int, samples: Samples, first: int) -> None:
        outgoing = list(can_face.frames(number, samples, LATCH_START_US, first))
        if self.port.full:
            self.port.dropped += len(outgoing)
            return
        if self._log:
            self._write_log(self._log, number, samples)
        self.port.send(outgoing)

    def obey(self, order: dict[str, Any]) -> dict[str, Any]:
        """Carries out one command; the answer. Raises `BadInput`, KeyError or ValueError for one it does not know."""
        if "status" in order:
            return self.status()
        if "can" in order:
            return self._obey_can(order)
        drive = self.drives[int(order["drive"])]
        number = int(order["drive"])
        if "fault" in order:
            fault = known_fault(str(order["fault"]))
            fault.begin(drive, fault.checked(float(order.get("size", fault.usual))))
        if "repair" in order:
            known_fault(str(order["repair"])).repair(drive)
        if "i2c" in order:
            self.buses[number].fault = _one_of(order["i2c"], i2c_face.I2C_FAULTS)
        if "modbus" in order:
            self.modbus.sensors[number].fault = _one_of(order["modbus"], MODBUS_FAULTS)
        drive.wear = float(order.get("wear", drive.wear))
        drive.wear_per_s = float(order.get("wear_per_s", drive.wear_per_s))
        return {"ok": True}

    def _obey_can(self, order: dict[str, Any]) -> dict[str, Any]:
        what = _one_of(order["can"], ("down", "up", "raw"))
        if what == "down":
            self.port.take_down()
        elif what == "up":
            self.port.bring_up()
        elif isinstance(self.port, can_face.SlcanPort):
            self.port.send_raw(bytes.fromhex(order["hex"]))
        else:
            raise BadInput("can: raw: expected a rig on slcan")
        return {"ok": True, "can": self._can_place()}

    def status(self) -> dict[str, Any]:
        """How far the rig is and what it sent."""
        return {
            "ok": True,
            "time_s": max(drive.time_s for drive in self.drives.values()),
            "sent": self.port.sent,
            "dropped": self.port.dropped,
            "skipped_s": self.skipped_s,
            "wear": [drive.wear for drive in self.drives.values()],
            "temperature_degC": [drive.housing.temperature_degC for drive in self.drives.values()],
        }

    async def close(self) -> None:
        """Ends what `open` began."""
        for server in self._servers:
            server.close()
        await self.modbus.stop()
        self.port.close()
        if self._log:
            self._log.close()

    def _write_log(self, log: IO[str], number: int, samples: Samples) -> None:
        counts = (
            [value if kept else "" for value, kept in zip(values.tolist(), mask.tolist(), strict=True)]
            for values, mask in ((samples.counts_in, samples.kept_in), (samples.counts_out, samples.kept_out))
        )
        log.writelines(
            f"{number},{can_face.latch_us(time_s, LATCH_START_US)},{time_s:.3f},{counts_in},{counts_out}\n"
            for time_s, counts_in, counts_out in zip(samples.time_s.tolist(), *counts, strict=True)
        )

    def _i2c_path(self, number: int) -> Path:
        return self.folder / f"i2c{number}"

    def _can_place(self) -> dict[str, str]:
        if isinstance(self.port, can_face.SlcanPort):
            return {"interface": "slcan", "channel": str(self.port.path)}
        interface, _, channel = self.options.can.partition(":")
        return {"interface": interface, "channel": channel}


def _of_drive(effects: tuple[str, ...] | None, number: int) -> tuple[str, ...] | None:
    """What drive `number` has: its own where any are named for it, else what all have."""
    if effects is None:
        return None
    own = [name.partition(":")[2] for name in effects if name.startswith(f"{number}:")]
    names = own or [name for name in effects if ":" not in name]
    return tuple(name for name in names if name != "none") if names else None


def _i2c_bus(drive: LiveDrive) -> i2c_face.RegisterBus:
    return i2c_face.RegisterBus(
        {
            bmp280.ADDRESS: bmp280.Bmp280(drive.housing.measured),
            i2c_face.BURST_ADDRESS: i2c_face.BurstSensor(drive.sound, lambda: drive.time_s),
        }
    )


def _one_of(value: object, known: Sequence[str]) -> str:
    if value not in known:
        raise BadInput(f"{value!r}: expected one of {', '.join(known)}")
    return str(value)


async def run(options: RigOptions, commands: IO[str] = sys.stdin, answers: IO[str] = sys.stdout) -> None:
    """Runs the rig until `commands` ends, a quit command, or SIGTERM / SIGINT."""
    loop = asyncio.get_running_loop()
    done = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, done.set)
    with tempfile.TemporaryDirectory(prefix="edge-rig-") as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        rig = Rig(options, folder)
        try:
            _say(answers, await rig.open())
            with contextlib.suppress(PermissionError):  # a plain file or /dev/null: no commands, and no end of them
                loop.add_reader(commands.fileno(), _Commands(rig, commands.fileno(), answers, done).read)
            await _keep_pace(rig, done)
        finally:
            with contextlib.suppress(PermissionError, ValueError):
                loop.remove_reader(commands.fileno())
            await rig.close()


async def _keep_pace(rig: Rig, done: asyncio.Event) -> None:
    start_s = time.monotonic()
    next_s = start_s
    while not done.is_set():
        rig.tick(time.monotonic() - start_s)
        next_s = max(next_s + TICK_S, time.monotonic())
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(done.wait(), max(0.001, next_s - time.monotonic()))


@dataclass(slots=True)
class _Commands:
    """Lines of JSON as they come in."""

    rig: Rig
    descriptor: int
    answers: IO[str]
    done: asyncio.Event
    _rest: bytes = b""

    def read(self) -> None:
        """Called when there is something to read; the end of input ends the rig."""
        data = os.read(self.descriptor, 65_536)
        if not data:
            self.done.set()
            asyncio.get_running_loop().remove_reader(self.descriptor)
            return
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if line.strip():
                self._answer(line)

    def _answer(self, line: bytes) -> None:
        try:
            order = json.loads(line)
            if "quit" in order:
                self.done.set()
                return
            _say(self.answers, self.rig.obey(order))
        except (BadInput, KeyError, TypeError, ValueError) as error:
            _say(self.answers, {"ok": False, "error": f"{type(error).__name__}: {error}"})


def _say(answers: IO[str], what: dict[str, Any]) -> None:
    answers.write(json.dumps(what) + "\n")
    answers.flush()
