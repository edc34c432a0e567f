"""`excite --demo`: the command for real drives on a simulated one, through the same adapter, bus and wire format."""

from __future__ import annotations

import argparse
import contextlib
import random
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import can
import tomlkit

from edge_daemon.clock import Clock
from edge_daemon.commands import experiment
from edge_daemon.commands.excite import Pace, command
from edge_daemon.commands.practice import first_model
from edge_daemon.config.reading import load
from edge_daemon.demo.gateway import config_folder
from edge_daemon.errors import BadInput
from edge_daemon.rig.child import RigFailed, RigProcess
from edge_daemon.servo.drive import can_hide
from edge_daemon.text import number, write_text

CONFIGURATION = "excite_demo.toml"
LAST_FRAME = 0x184
"""The torque flange answers a SYNC last."""
ANSWER_WITHIN_S = 5.0
"""A cycle without an answer goes on after this, by the wall clock."""


class SimulatedPace(can.Listener):
    """Time that passes by cycles: the next one comes when the simulated drive has answered the last.

    A busy machine makes the demonstration slower and changes nothing in it.
    """

    def __init__(self) -> None:
        self._passed_s = 0.0
        self._began_s = time.time()
        self._answered = threading.Event()

    def on_message_received(self, msg: can.Message) -> None:
        """One frame; the name is python-can's."""
        if msg.arbitration_id == LAST_FRAME:
            self._answered.set()

    def now(self) -> float:
        """Seconds of the drive's time."""
        return self._passed_s

    def wait(self, seconds: float) -> None:
        """Until the drive has answered; then so many seconds have passed."""
        self._answered.wait(ANSWER_WITHIN_S)
        self._answered.clear()
        self._passed_s += max(0.0, seconds)

    def pace(self) -> Pace:
        """For the guarded loop."""
        clock = Clock(lambda: self._began_s + self._passed_s, self.now)
        return Pace(clock, self.now, self.wait, self, ANSWER_WITHIN_S)


def demonstrate(arguments: argparse.Namespace) -> int:
    """As `commands.excite` does it on a real drive; prints what is true of the simulated gear."""
    arguments.arm = arguments.arm or "axis-1"  # nothing that could hurt anybody moves here
    cycle_s = _cycle_s()
    with tempfile.TemporaryDirectory(prefix="edge-daemon-excite-") as folder, _servo(cycle_s) as rig:
        code = command(arguments, prepare(Path(folder), rig.ready["can"]), SimulatedPace().pace())
        truth = rig.ready["truth"]
    if not arguments.dry_run:
        print(f"the simulated gear: stiffness {number(truth['stiffness_Nm_per_rad'])} N m/rad")
    if arguments.model:
        write_first_model(arguments.model, truth)
        print(
            f"{arguments.model}: its ratio and inertia; next: edge-daemon measure all REC... --model {arguments.model}"
        )
    return code


def inquire(arguments: argparse.Namespace) -> int:
    """`experiment --demo`: a gear with an effect that is named at the end."""
    known = can_hide()
    effect = arguments.effect or random.choice(known)  # noqa: S311  (a riddle, no secret)
    if effect not in known:
        raise BadInput(f"--effect {effect}: the simulated drive has: {', '.join(known)}")
    cycle_s = _cycle_s()
    with tempfile.TemporaryDirectory(prefix="edge-daemon-excite-") as folder, _servo(cycle_s, effect) as rig:
        file = prepare(Path(folder), rig.ready["can"])
        write_first_model(file.parent / "axis.model.toml", rig.ready["truth"])
        code = experiment.command(arguments, file, lambda name: name, SimulatedPace().pace())
    print(f"the simulated gear had: {effect}", file=sys.stderr if arguments.json == "-" else sys.stdout)
    return code


@contextlib.contextmanager
def _servo(cycle_s: float, effect: str = "") -> Any:
    hidden = ["--effect", effect] if effect else []
    try:
        with RigProcess(["--cycle", str(cycle_s), *hidden], module="edge_daemon.servo.drive") as rig:
            yield rig
    except RigFailed as error:
        raise BadInput(f"the simulated drive: {error}") from error


def _cycle_s() -> float:
    excite = load(config_folder() / CONFIGURATION).drive[0].excite
    assert excite is not None
    return excite.cycle_s


def prepare(folder: Path, place: Mapping[str, str]) -> Path:
    """The shipped configuration with the simulated drive's address, in `folder`; its path."""
    source = config_folder()
    shutil.copy(source / "axis.model.toml", folder / "axis.model.toml")
    document: Any = tomlkit.parse((source / CONFIGURATION).read_text())
    document["can"][0].update(place)
    file = folder / CONFIGURATION
    file.write_text(tomlkit.dumps(document))
    return file


def write_first_model(path: Path, truth: Mapping[str, float]) -> None:
    """The model one would begin with. Raises `BadInput`."""
    known = ("linear_stiffness", "viscous_damping", "kinematic_error")
    write_text(path, first_model("torsion", truth["ratio"], truth["inertia_kg_m2"], known))
