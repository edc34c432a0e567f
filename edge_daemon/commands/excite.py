"""`excite`: a test motion on a drive, by a person who stays with it. Checks first, moves guarded, says how it ended."""

from __future__ import annotations

import argparse
import contextlib
import logging
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can
import canopen
import numpy as np

from edge_daemon.acquire.drivers import open_source
from edge_daemon.acquire.source import Source
from edge_daemon.clock import Clock
from edge_daemon.config.reading import load
from edge_daemon.config.settings import CanSource, Drive, Excite, Settings
from edge_daemon.errors import BadInput
from edge_daemon.excite.arming import Armed, arm
from edge_daemon.excite.drive_link import SDO_TIMEOUT_S, CanopenDrive, LinkLost
from edge_daemon.excite.limits import PLANNED_SHARE, check_profile, most_of
from edge_daemon.excite.operator import Operator, operator
from edge_daemon.excite.profiles import PlannedMotion, planned_motion
from edge_daemon.excite.runner import Runner
from edge_daemon.excite.sequence import Outcome
from edge_daemon.recordings.recording import write_recording
from edge_daemon.records import Readings
from edge_daemon.service import drive_temperature
from edge_daemon.service.motion_recording import TEMPERATURE, MotionLog, StampedSync
from edge_daemon.text import number, progress, table

PSEUDO_TERMINAL = "/dev/pts/"
"""A pseudo terminal is no microcontroller that starts anew when its port is opened."""
NOTIFIER_CYCLE_S = 0.1
"""The bus's thread may take this long to notice that it is over."""
NMT_START = 1
"""CiA 301: command of the network management, start remote node"""
ENDED_EARLY = 1
"""Exit code: the motion ended before the profile did."""


@dataclass(slots=True)
class Pace:
    """Time as the guarded loop sees it. A simulated drive brings its own."""

    clock: Clock = field(default_factory=Clock)
    now: Callable[[], float] = time.monotonic
    wait: Callable[[float], None] = lambda seconds: time.sleep(max(0.0, seconds))
    heard: can.Listener | None = None
    """told of each frame, after everybody else"""
    answer_s: float = SDO_TIMEOUT_S
    """the drive may take this long to answer a question, by the wall clock"""


@dataclass(frozen=True, slots=True)
class ExciteTask:
    """One motion that may begin."""

    armed: Armed
    drive: Drive
    planned_motion: PlannedMotion
    settings: Settings
    base: Path
    """folder of the configuration"""

    @property
    def bus(self) -> CanSource:
        """That the drive is commanded on."""
        return next(row for row in self.settings.can if row.name == self.armed.excite.source)


def excite(arguments: argparse.Namespace) -> int:
    """0 where the whole profile ran, 1 where it ended early. Raises `BadInput` before anything moves."""
    if arguments.model:
        raise BadInput("--model: expected only with --demo: the configuration names the model of a drive")
    return command(arguments, arguments.config, Pace())


def command(arguments: argparse.Namespace, file: Path, pace: Pace) -> int:
    """Check, arm, move, record. `file` is the configuration."""
    if arguments.out and not arguments.dry_run:
        _check_writable(arguments.out)
    settings = load(file)
    drive, it = excited_drive(settings, file, arguments.drive)
    motion = planned_motion(_profile(drive, it, arguments.profile), it.cycle_s)
    check_on_paper(motion, it)
    anywhere = it.limits.minimum_rad is None and it.limits.maximum_rad is None
    if arguments.dry_run:
        where = "" if anywhere else "; minimum_rad and maximum_rad are checked once the drive says where it stands"
        print(f"the profile keeps the limits{where}; nothing was moved")
        return 0
    task = ExciteTask(arm(drive, arguments.arm), drive, motion, settings, file.parent)
    outcome = make(task, arguments.hold, arguments.out, pace)
    return 0 if outcome.completed else ENDED_EARLY


def make(task: ExciteTask, hold: bool, out: Path | None, pace: Pace) -> Outcome:
    """Moves with the operator at the terminal, says how it ended, and writes the recording: a signal that comes while
    it is written does not lose it. Raises `BadInput`."""
    with operator(task.armed.excite, hold=hold) as hand:
        outcome, log = move(task, hand, pace)
        print(outcome_words(outcome), flush=True)
        if out:
            write_motion(out, log, outcome)
    return outcome


def check_on_paper(motion: PlannedMotion, it: Excite) -> None:
    """Shows what a motion needs and raises `LimitError` where it may not: before anybody asks the drive where it
    stands."""
    print(planned(motion, it), flush=True)
    check_profile(motion, 0.0, _without_position(it), _assumed_degC(it))


def excited_drive(settings: Settings, file: Path, name: str | None) -> tuple[Drive, Excite]:
    names = [drive.name for drive in settings.drive]
    if name is None and len(names) == 1:
        name = names[0]
    found = next((drive for drive in settings.drive if drive.name == name), None)
    if found is None:
        raise BadInput(f"{file}: drive {name!r}: expected --drive with one of {', '.join(names)}")
    if found.excite is None:
        raise BadInput(f"{file}: drive {name!r}: excite: missing: expected a [drive.excite] section")
    return found, found.excite


def _profile(drive: Drive, it: Excite, name: str) -> Any:
    found = next((row for row in it.profile if row.name == name), None)
    if found is None:
        known = ", ".join(row.name for row in it.profile) or "(none configured)"
        raise BadInput(f"drive {drive.name!r}: excite.profile {name!r}: expected one of {known}")
    return found


def _without_position(it: Excite) -> Any:
    from msgspec import structs

    return structs.replace(it.limits, minimum_rad=None, maximum_rad=None)


def _assumed_degC(it: Excite) -> float:
    """For the check on paper; the real one follows with the real temperature."""
    return math.nan if it.limits.temperature_degC is None else it.limits.temperature_degC


def planned(motion: PlannedMotion, it: Excite) -> str:
    """What the profile needs beside what it may use, as a table."""
    units = ("rad", "rad/s", "rad/s^2", "N m")
    rows = [
        (
            name.split("_")[0],
            number(needed),
            number(PLANNED_SHARE * limit),
            number(limit),
            unit,
            "yes" if fits else "NO",
        )
        for (name, needed, limit), unit in zip(most_of(motion, it.limits), units, strict=True)
        for fits in [needed <= PLANNED_SHARE * limit]
    ]
    head = f"{motion.time_s[-1]:.1f} s in {len(motion)} cycles of {it.cycle_s * 1e3:g} ms, motor side"
    return f"{head}\n{table(('limit', 'profile needs', 'may plan', 'limit', 'unit', 'kept'), rows)}"


def outcome_words(outcome: Outcome) -> str:
    """How it ended, in one line."""
    stands = "the drive stands" if outcome.stopped else "STANDSTILL WAS NOT CONFIRMED: look at the machine"
    return f"completed; {stands}" if outcome.completed else f"ended early: {outcome.reason or 'no reason'}; {stands}"


# the motion


def move(task: ExciteTask, hand: Operator, pace: Pace) -> tuple[Outcome, MotionLog]:
    """Runs the course on the drive's bus and returns how it ended, and what was heard. Raises `BadInput`."""
    it = task.armed.excite
    log = MotionLog(task.bus, task.base, task.drive, pace.clock)
    for name in ("can", "canopen"):  # what goes wrong on the bus is told once, by the outcome
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with _network(task.bus) as network, drive_temperature.running(_own_thermometer(task), log, pace.clock):
        listeners: list[Any] = network.listeners
        listeners += [log, *([pace.heard] if pace.heard else [])]
        network.sync = StampedSync(network, log.synchronised)
        network.connect()
        drive_temperature.await_temperature(it, log, hand)
        link = CanopenDrive(network, it, pace.now, pace.answer_s)
        motion = Runner(
            armed=task.armed,
            link=link,
            dead_man=hand.dead_man,
            clock=pace.clock,
            now=pace.now,
            wait=pace.wait,
            temperature_degC=log.temperature_degC,
            doubts=lambda: hand.reason or link.doubts() or log.doubts(),
        )
        motion.mark = _marking(log, task.planned_motion, motion)
        print(f"moving {task.drive.name}: Enter, Ctrl-C or closing the terminal stops it", file=sys.stderr, flush=True)
        try:
            outcome = motion.run(task.planned_motion)
        except LinkLost as error:
            raise BadInput(f"drive {task.drive.name!r}: not moved: {error}") from error
        _back_to_work(task, network)
    print(f"{motion.cycles} cycles, the latest {motion.latest_s * 1e3:.1f} ms late", file=sys.stderr)
    return outcome, log


def _marking(log: MotionLog, motion: PlannedMotion, runner: Runner) -> Callable[[Readings], None]:
    """Passes the phase marks on, and shows where the motion is."""
    say = progress("motion")

    def mark(readings: Readings) -> None:
        log.take(readings)
        part = motion.parts[min(int(readings.value[-1]), len(motion.parts) - 1)]
        say(part, min(0.99, runner.cycles / len(motion)))

    return mark


@contextlib.contextmanager
def _network(bus: CanSource) -> Iterator[canopen.Network]:
    """CANopen on the drive's bus. Raises `BadInput` where it cannot be opened."""
    options: dict[str, Any] = {} if bus.bitrate is None else {"bitrate": bus.bitrate}
    if bus.interface == "slcan" and str(Path(bus.channel).resolve()).startswith(PSEUDO_TERMINAL):
        options["sleep_after_open"] = 0.0
    try:
        port = can.Bus(channel=bus.channel, interface=bus.interface, ignore_config=True, **options)
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise BadInput(f"can {bus.name!r}: cannot open {bus.interface}:{bus.channel}: {reason}") from error
    network = canopen.Network(port)
    network.NOTIFIER_CYCLE = NOTIFIER_CYCLE_S
    try:
        yield network
    finally:
        with contextlib.suppress(can.CanError, OSError, RuntimeError):
            network.disconnect()


def _own_thermometer(task: ExciteTask) -> Source | None:
    """The source of the temperature, where a limit depends on it and the drive's bus does not carry it."""
    row = next((row for row in task.drive.channels if row.channel == TEMPERATURE), None)
    if task.armed.excite.limits.temperature_degC is None or row is None or row.source == task.bus.name:
        return None
    return open_source(next(it for it in task.settings.sources if it.name == row.source), task.base)


def _back_to_work(task: ExciteTask, network: canopen.Network) -> None:
    """The drive's process data on again, where the daemon lives on it; it stays switched off."""
    if any(pdo.node == task.armed.excite.node for pdo in task.bus.pdo):
        with contextlib.suppress(can.CanError, OSError, RuntimeError):
            network.send_message(0, bytes([NMT_START, task.armed.excite.node]))


# the recording


def _check_writable(path: Path) -> None:
    """Before anything moves: a motion that cannot be kept is a motion for nothing."""
    if path.suffix not in (".csv", ".parquet"):
        raise BadInput(f"--out {path}: expected a name that ends in .csv or .parquet")
    if not path.resolve().parent.is_dir():
        raise BadInput(f"--out {path}: cannot write: no such folder")
    there = path.exists()
    try:
        with path.open("ab"):
            pass
        if not there:
            path.unlink()
    except OSError as error:
        raise BadInput(f"--out {path}: cannot write: {error.strerror}: nothing was moved") from error


def kept_as(path: Path, outcome: Outcome) -> Path:
    """The file asked for, or one beside it whose name says that the profile did not run to its end."""
    return path if outcome.completed else path.with_name(f"{path.stem}.stopped{path.suffix}")


def write_motion(path: Path, log: MotionLog, outcome: Outcome) -> None:
    """What was heard of the motion as a recording, under a name that says whether it came to its end."""
    time_s, columns = log.recording()
    if not len(time_s):
        print(f"{path}: not written: no channel of the drive was heard", file=sys.stderr)
        return
    kept = kept_as(path, outcome)
    write_recording(kept, time_s, columns)
    rate = 1 / float(np.median(np.diff(time_s))) if len(time_s) > 1 else math.nan
    print(f"{kept}: {len(time_s)} samples at {rate:.4g} Hz: {', '.join(columns)}")
    if kept != path:
        print(f"{path}: not written: what was recorded is only the beginning of the profile")
