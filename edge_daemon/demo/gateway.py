"""`demo`: the daemon on a simulated drive, through the drivers of real hardware, on loopback only."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import math
import re
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import AoT

from edge_daemon.config.reading import load
from edge_daemon.demo import story
from edge_daemon.errors import BadInput
from edge_daemon.records import Estimate, GatewayState
from edge_daemon.rig.child import RigFailed, RigProcess
from edge_daemon.rig.faults import listed, planned
from edge_daemon.rig.i2c_face import open_bus
from edge_daemon.rig.simulated import UnknownEffect
from edge_daemon.rig.truths import TRUTHS
from edge_daemon.service.daemon import Daemon
from edge_daemon.text import number, table, with_sd

log = logging.getLogger(__name__)

STORY_DRIVES = 3
LOOK_S = 0.5
"""The state is looked at so often: the last look before the end is what the summary tells."""
LACKING = 3.0
"""The page advises to compare as well from this error over sensor noise on."""


def demo(arguments: argparse.Namespace) -> int:
    """Runs until interrupted, or for `arguments.seconds` and then prints a summary; or lists the faults it can have.

    Raises `BadInput`.
    """
    if arguments.seconds is not None and not 0 < arguments.seconds < math.inf:
        raise BadInput(f"--seconds {arguments.seconds}: expected above 0")
    if arguments.faults:
        print(table(("fault", "usual size", "what goes wrong"), listed()))
        return 0
    _check_effects(arguments.effect or ())
    for text in arguments.fault or ():
        planned(text)
    told = arguments.story or not (arguments.seconds or arguments.drives or arguments.effect or arguments.fault)
    arguments.drives = STORY_DRIVES if told else arguments.drives or 1
    if told:
        arguments.effect = list(story.EFFECTS)
    with _folder(arguments.folder) as folder, _rig(arguments) as rig:
        target: dict[str, Any] = {"filename": folder / "daemon.log"} if told else {"stream": sys.stderr}
        logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s", **target)
        file = prepare(folder, rig.ready, arguments.drives, free_ports=arguments.any_port, apart=told)
        teller = partial(story.tell, rig=rig, folder=folder) if told else None
        asyncio.run(until_stopped(file, arguments.seconds, rig.ready["drives"], teller))
    return 0


def _check_effects(names: Iterable[str]) -> None:
    for name in names:
        if re.sub(r"^\d:", "", name) not in (*TRUTHS, "none"):
            raise UnknownEffect(name, TRUTHS)


@contextlib.contextmanager
def _folder(wanted: Path | None) -> Iterator[Path]:
    if wanted is not None:
        try:
            wanted.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(f"--folder {wanted}: cannot make: {error.strerror}") from error
        yield wanted
        return
    with tempfile.TemporaryDirectory(prefix="edge-daemon-demo-") as folder:
        yield Path(folder)


@contextlib.contextmanager
def _rig(arguments: argparse.Namespace) -> Iterator[RigProcess]:
    words = ["--drives", str(arguments.drives)]
    for name in arguments.effect or ():
        words += ["--effect", name]
    for text in arguments.fault or ():
        words += ["--fault", text]
    if arguments.log:
        words += ["--log", str(arguments.log)]
    try:
        if arguments.log:
            arguments.log.touch()
        with RigProcess(words) as rig:
            yield rig
    except RigFailed as error:
        raise BadInput(f"the simulated drive: {error}") from error
    except OSError as error:
        raise BadInput(f"--log {arguments.log}: cannot write: {error.strerror}") from error


async def until_stopped(
    file: Path,
    seconds: float | None,
    truths: list[Mapping[str, Any]],
    teller: Callable[[Daemon], Coroutine[Any, Any, None]] | None = None,
) -> None:
    """The daemon, and a story beside it; without a story a summary at the end."""
    daemon = Daemon(file, i2c_bus=lambda name: open_bus(str(name)))
    print(where_to_look(daemon), flush=True)
    running = asyncio.create_task(daemon.run())
    await asyncio.sleep(0)  # it has set its own signal handlers then
    # a terminal that was closed: for the daemon that would be a wish to read its configuration again
    asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, daemon.stop)
    telling = asyncio.create_task(teller(daemon)) if teller else None
    last, until_s = daemon.state(), time.monotonic() + (math.inf if seconds is None else seconds)
    while not running.done() and time.monotonic() < until_s:
        last = daemon.state()
        await asyncio.wait([running], timeout=min(LOOK_S, until_s - time.monotonic()))
    if telling:
        telling.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await telling
    daemon.stop()
    await running
    if not teller:
        print(f"\n{summary(last, truths)}")


def where_to_look(daemon: Daemon) -> str:
    """The addresses, as lines a person can follow."""
    settings = daemon.settings
    root = f"strainwave/v1/{settings.gateway.site}/{settings.gateway.name}"
    page, registers = settings.dashboard, settings.modbus_server
    return (
        f"page       {page.scheme}://{page.host}:{page.port}/   (metrics: /metrics)\n"
        f"registers  Modbus TCP {registers.host}:{registers.port}, device ids from 1   (map: edge-daemon registers)\n"
        f"fleet      Zenoh {settings.zenoh.listen[0]}, keys {root}/**\n"
        f"store      {daemon.store_file}\n"
        "stop with Ctrl-C"
    )


# the configuration


def prepare(
    folder: Path, ready: Mapping[str, Any], drives: int, *, free_ports: bool = False, apart: bool = False
) -> Path:
    """Writes the demonstration's configuration and model into `folder`; the configuration's path.

    `ready` is what the simulated drives said when they were ready; `free_ports` takes any ports instead of the usual;
    `apart` gives each drive a model file of its own, and an early baseline.
    """
    source = config_folder()
    shutil.copy(source / "axis.model.toml", folder / "axis.model.toml")
    document = tomlkit.parse((source / "demo.toml").read_text())
    can = _rows(document, "can")[0]
    can.update(ready["can"])
    can["dbc"] = ready["dbc"]
    stamp_names = [f"Encoder{side}{n}" for n in range(1, drives + 1) for side in ("In", "Out")]
    can["stamps"] = [{"message": name, "signal": "Latch"} for name in stamp_names]
    for section in ("i2c", "modbus", "drive"):
        rows = _rows(document, section)
        text = tomlkit.dumps({section: [rows[0].unwrap()]})
        for n in range(2, drives + 1):
            rows.append(_rows(tomlkit.parse(_renumbered(text, n)), section)[0])
    for n, drive in enumerate(ready["drives"], start=1):
        _rows(document, "i2c")[n - 1]["bus"] = drive["i2c"]
        _rows(document, "modbus")[n - 1].update({"port": ready["modbus_port"], "device_id": n})
        _rows(document, "drive")[n - 1]["modbus_device_id"] = n
    for row in _rows(document, "drive") if apart else ():
        row["model"] = f"{row['name']}.model.toml"
        row["estimation"]["baseline_after_s"] = story.BASELINE_AFTER_S
        shutil.copy(source / "axis.model.toml", folder / row["model"])
    usual = load(source / "demo.toml")
    fleet = int(usual.zenoh.listen[0].rpartition(":")[2])
    ports = ports_near((usual.modbus_server.port, usual.dashboard.port, fleet), free_ports)
    document["modbus_server"] = {"port": ports[0]}
    document["dashboard"]["port"] = ports[1]
    document["zenoh"] = {"listen": [f"tcp/127.0.0.1:{ports[2]}"]}
    file = folder / "demo.toml"
    file.write_text(tomlkit.dumps(document))
    load(file)
    return file


def ports_near(usual: Sequence[int], any_port: bool) -> list[int]:
    """The usual ports, each for itself; a free one in place of one that is taken (said in the log), or any."""
    with contextlib.ExitStack() as held:  # all at once, or the same one would be free twice
        return [_port_near(0 if any_port else port, held.enter_context(socket.socket())) for port in usual]


def _port_near(usual: int, probe: socket.socket) -> int:
    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(usual != 0))
    try:
        probe.bind(("127.0.0.1", usual))
    except OSError:
        probe.bind(("127.0.0.1", 0))
        log.warning("port %d is taken on this machine: %d is used in its place", usual, probe.getsockname()[1])
    return int(probe.getsockname()[1])


def config_folder() -> Path:
    """Where the shipped configurations are: in a checkout, or where the wheel put them."""
    for folder in (Path(__file__).parents[2] / "config", Path(sys.prefix) / "share" / "edge-daemon" / "config"):
        if (folder / "demo.toml").exists():
            return folder
    raise BadInput("config/demo.toml: not found beside the package: expected a checkout or an installed wheel")


def _rows(document: tomlkit.TOMLDocument, section: str) -> AoT:
    rows = document[section]
    assert isinstance(rows, AoT)
    return rows


def _renumbered(text: str, n: int) -> str:
    """The first drive's section as that of drive `n`."""
    for name in ("EncoderIn", "EncoderOut", "Drive", "housing", "air", "axis-"):
        text = text.replace(f"{name}1", f"{name}{n}")
    return text


# the summary


def known_truths(truth: Mapping[str, Any]) -> dict[str, float]:
    """What the simulated drive knows of the quantities that are estimated."""
    found = {
        "stiffness": truth["stiffness_Nm_per_rad"],
        "damping": truth["damping_Nms_per_rad"],
        "kinematic_error": truth["kinematic_error_pp_rad"],
        "coulomb_friction": truth["parameters"].get("coulomb_friction.level_Nm", 0.0),
        "ratio": truth["ratio"],
    }
    return found | {f"noise_a{b}": value for b, value in enumerate(truth["noise_coefficients"])}


def summary(state: GatewayState, truths: list[Mapping[str, Any]]) -> str:
    """Per drive: each estimate beside what the simulated drive knows to be true."""
    parts = []
    for snapshot, row in zip(state.snapshots.values(), truths, strict=True):
        known = known_truths(row["truth"])
        rows = [_line(estimate, known.get(estimate.name)) for estimate in snapshot.estimates.values()]
        has = ", ".join(row["truth"]["effects"]) or "no further effect"
        head = f"{snapshot.drive}: {snapshot.state.name.lower().replace('_', ' ')}; the simulated gear has: {has}"
        reasons = "".join(f"\n  {reason}" for reason in snapshot.reasons)
        shown = table(("estimate", "value", "unit", "status", "truth", "off by"), rows)
        parts.append(f"{head}{reasons}\n{shown}{_lacking(snapshot.estimates)}")
    links = ", ".join(f"{link.link} {link.state}" for link in state.links)
    return "\n\n".join([*parts, f"links: {links}"])


def _lacking(estimates: Mapping[str, Estimate]) -> str:
    """Why a number beside the truth may be far from it: what the model lacks, other numbers take over."""
    error, floor = estimates.get("model_nrmse"), estimates.get("model_noise_floor")
    if not (error and floor and error.usable and floor.usable) or error.value < LACKING * floor.value:
        return ""
    return (
        f"\nits model misses {error.value:.1%} of the torque, sensor noise alone would make {floor.value:.1%}: "
        "an effect is missing, and the other numbers take its place: Compare on the page names it"
    )


def _line(estimate: Estimate, truth: float | None) -> tuple[str, ...]:
    shown = with_sd(estimate.value, estimate.sd)
    off = ""
    if truth is not None and estimate.usable and estimate.sd > 0:
        off = f"{(estimate.value - truth) / estimate.sd:+.1f} sd"
    known = number(truth) if truth is not None else ""
    return (estimate.name, shown, estimate.unit, estimate.status.value, known, off)
