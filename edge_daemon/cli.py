"""The commands. Exit 0 on success, 2 on bad input with one line on standard error."""

from __future__ import annotations

import argparse
import errno
import importlib
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from edge_daemon import __version__
from edge_daemon.commands.questions import WORDS
from edge_daemon.errors import BadInput, in_one_line

JSON_HELP = "write the result as JSON; - is standard output, and nothing else goes there"


class Parser(argparse.ArgumentParser):
    """A mistake on the command line is one line, like every other; --help has the rest."""

    def error(self, message: str) -> NoReturn:
        """See argparse."""
        self.exit(2, f"edge-daemon: {in_one_line(message)} ({self.prog} --help)\n")


def command() -> NoReturn:
    """`main` as a program, left at once where Zenoh was used: threads of its own that ask for Python while that goes
    away would abort the process, with all its work done. What a library warns of is for its developers: they ask for it
    with `python -W`."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    code = main()
    if "zenoh" in sys.modules:
        import logging

        logging.shutdown()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    arguments = parser().parse_args(argv)
    for library in ("OPENBLAS", "OMP"):  # matrices of a few columns: a second thread only costs (5 times, measured)
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    try:
        code = int(arguments.run(arguments) or 0)
        print(end="", flush=True)
        return code
    except BadInput as error:
        print(f"edge-daemon: {_line_of(error, arguments)}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader (head, less) has gone: no reason for a traceback
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if refused := _refused_name(error, arguments):
            print(f"edge-daemon: {in_one_line(refused)}", file=sys.stderr)
            return 2
        if error.errno != errno.ENOSPC:
            raise
        print("edge-daemon: no space left for what is to be written", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 2
    except KeyboardInterrupt:
        return 130


def _refused_name(error: OSError, arguments: argparse.Namespace) -> str:
    """What the system has against a name that was typed (too long, a loop of links, not ours to read); empty where it
    was another's."""
    if error.errno == errno.ENOSPC or error.filename is None:
        return ""
    values = [one for value in vars(arguments).values() for one in (value if isinstance(value, list) else [value])]
    typed = any(isinstance(one, (str, Path)) and str(one) == str(error.filename) for one in values)
    return f"{error.filename}: {error.strerror}" if typed else ""


def _formulas(files: Sequence[Path]) -> dict[str, str]:
    """What is kept beside recordings of how their columns are made; nothing where that is what is wrong."""
    from edge_daemon.recordings.column_map import kept

    try:
        return {name: text for path in files for name, text in kept(path).formulas.items()}
    except BadInput:
        return {}


def _line_of(error: BadInput, arguments: argparse.Namespace) -> str:
    """The line of a refusal; what is wrong with recordings is said with their names: the physics knows no files."""
    from edge_daemon.effects.model import ModelError
    from edge_daemon.recordings.column_map import as_mapped

    line, files = str(error), getattr(arguments, "recording", None)
    if isinstance(error, ModelError) and line.startswith(("joint.", "effect:")):
        return f"{getattr(arguments, 'model', 'model')}: {line}"
    if not isinstance(files, list) or not files or isinstance(error, ModelError) or line.startswith("--"):
        return line
    line = as_mapped(line, _formulas(files))
    known = [str(path) for path in (*files, getattr(arguments, "model", None)) if path]
    return line if any(name in line for name in known) else f"{', '.join(map(str, files))}: {line}"


def parser() -> argparse.ArgumentParser:
    """All commands with their arguments. What a command needs is imported when it runs."""
    top = Parser(prog="edge-daemon", description="Knows the state of a strain wave gear while it works.")
    top.add_argument("--version", action="version", version=__version__)
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    _daemon_commands(commands)
    _motion_commands(commands)
    _model_commands(commands)
    _practice_commands(commands)
    _life_commands(commands)
    _design_commands(commands)
    _fleet_commands(commands)
    _compensate_command(commands)
    return top


def _daemon_commands(commands: argparse._SubParsersAction[Parser]) -> None:
    run = commands.add_parser("run", help="the daemon")
    run.add_argument("--config", type=Path, required=True, metavar="FILE")
    run.add_argument("--verbose", action="store_true")
    run.set_defaults(run=_run)

    demo = commands.add_parser("demo", help="the daemon against a simulated drive on loopback")
    demo.add_argument("--seconds", type=float, help="stop after this long and print a summary")
    demo.add_argument("--story", action="store_true", help="three drives and what is done with them (without options)")
    demo.add_argument("--drives", type=int, choices=range(1, 9), metavar="1-8")
    demo.add_argument("--effect", action="append", metavar="NAME", help="what the simulated gear has; repeatable")
    demo.add_argument(
        "--fault", action="append", metavar="NAME[@S[-S]][:SIZE]", help="what goes wrong with it, and when; repeatable"
    )
    demo.add_argument("--faults", action="store_true", help="list what can go wrong, and stop")
    demo.add_argument("--any-port", action="store_true", help="free ports instead of 8080, 5020 and 7447")
    demo.add_argument("--log", type=Path, metavar="F.csv", help="write every encoder value that the drive sent")
    demo.add_argument("--folder", type=Path, help="keep the store and configuration here (default: a temporary folder)")
    demo.set_defaults(run=_later("gateway", "demo", "demo"))

    check = commands.add_parser("check", help="validate a configuration")
    check.add_argument("file", type=Path, metavar="FILE")
    _probing(check)
    check.set_defaults(run=_check)

    init = commands.add_parser("init", help="a configuration for one drive: asks, or takes flags")
    init.add_argument("--out", type=Path, default=Path("gateway.toml"), metavar="FILE", help="(gateway.toml)")
    init.add_argument("--force", action="store_true", help="write over what is there")
    for flag, (form, asks) in WORDS.items():
        init.add_argument(f"--{flag}", metavar=form, help=asks)
    _probing(init)
    init.set_defaults(run=_later("init", "init"))

    keys = commands.add_parser("keys", help="every key of a configuration, with its default and meaning")
    keys.add_argument("section", nargs="?", metavar="SECTION", help="only this one, such as drive.channels")
    keys.set_defaults(run=_keys)

    completion = commands.add_parser("completion", help="a script that lets bash or zsh complete commands and options")
    completion.add_argument("--man", action="store_true", help="the manual page instead, for man")
    completion.set_defaults(run=_later("completion", "completion"), known=commands.choices)

    registers = commands.add_parser("registers", help="the Modbus map for a PLC")
    registers.add_argument("--format", default="md", choices=("md", "csv", "json", "telegraf", "homeassistant"))
    registers.set_defaults(run=_registers)

    export = commands.add_parser("export", help="the ring buffer's content as a recording")
    export.add_argument("--store", type=Path, required=True, metavar="FILE")
    export.add_argument("--out", type=Path, required=True, metavar="F.csv|F.parquet")
    export.add_argument(
        "--since", metavar="T", help="seconds since the epoch, an ISO time (UTC), or an age such as 10m, 2h, 3d"
    )
    export.add_argument("--drive", help="which drive, where the store holds several")
    export.add_argument("--sound", action="store_true", help="what was heard instead: spectra, and a burst an alarm")
    export.add_argument("--order", type=float, action="append", default=[], help="with --sound: how loud it was")
    export.set_defaults(run=_export)

    salvage = commands.add_parser("salvage", help="copies what can be read of a damaged store into a new one")
    salvage.add_argument("store", type=Path, metavar="STORE")
    salvage.add_argument("--out", type=Path, metavar="NEW", help="default: STORE.salvaged")
    salvage.set_defaults(run=_salvage)


def _motion_commands(commands: argparse._SubParsersAction[Parser]) -> None:
    excite = commands.add_parser("excite", help="move a drive through a test profile, guarded, and record it")
    where = excite.add_mutually_exclusive_group(required=True)
    where.add_argument("--config", type=Path, metavar="FILE")
    where.add_argument("--demo", action="store_true", help="a simulated drive in a process of its own")
    excite.add_argument("--drive", metavar="NAME", help="which one, where the configuration has several")
    excite.add_argument("--profile", required=True, metavar="PROFILE", help="its name in [drive.excite]")
    excite.add_argument("--arm", metavar="NAME", help="the drive's name once more: this moves a machine")
    excite.add_argument("--out", type=Path, metavar="REC", help="record the motion, with the column profile_phase")
    excite.add_argument("--model", type=Path, metavar="M", help="with --demo: also write the gear's model")
    excite.add_argument("--dry-run", action="store_true", help="check the profile against the limits, move nothing")
    excite.add_argument("--hold", action="store_true", help="move only while Enter is held down")
    excite.set_defaults(run=_excite)

    experiment = commands.add_parser("experiment", help="find the missing effect by motions that the machine plans")
    where = experiment.add_mutually_exclusive_group(required=True)
    where.add_argument("--config", type=Path, metavar="FILE")
    where.add_argument("--demo", action="store_true", help="a simulated drive with an effect that is told at the end")
    experiment.add_argument("--drive", metavar="NAME", help="which one, where the configuration has several")
    experiment.add_argument("--recording", type=Path, nargs="+", default=[], metavar="REC", help="known already")
    experiment.add_argument("--most", type=int, default=3, metavar="N", help="motions at the most (3)")
    experiment.add_argument("--seconds", type=float, help="length of each motion (30)")
    experiment.add_argument("--out", type=Path, metavar="FOLDER", help="keep the recordings here")
    experiment.add_argument("--effect", metavar="NAME", help="with --demo: what the gear has")
    experiment.add_argument("--hold", action="store_true", help="move only while Enter is held down")
    experiment.add_argument("--json", metavar="F", help=JSON_HELP)
    experiment.set_defaults(run=_experiment)


def _model_commands(commands: argparse._SubParsersAction[Parser]) -> None:
    effects = commands.add_parser("effects", help="the catalogue of physical effects")
    effects.add_argument("--json", action="store_true")
    effects.set_defaults(run=_later("practice", "effects"))

    for name, text in (
        ("fit", "fit the model's parameters in place, with their standard deviations"),
        ("compare", "how wrong the model is, and where"),
        ("diagnose", "which physical effect is missing"),
        ("discover", "laws outside the catalogue: formulas for what its effects leave"),
    ):
        command = commands.add_parser(name, help=text)
        command.add_argument("recording", type=Path, nargs="+", metavar="REC")
        command.add_argument("--model", type=Path, required=True, metavar="M")
        _columns(command)
        command.add_argument("--json", metavar="F", help=JSON_HELP)
        if name != "fit":
            command.add_argument("--report", type=Path, metavar="F.html", help="a page that works offline")
        command.set_defaults(run=_later("model", name))

    add = commands.add_parser("add", help="add an effect to the model, refit, and see the error fall")
    add.add_argument("effect", metavar="EFFECT")
    add.add_argument("--model", type=Path, required=True, metavar="M")
    add.add_argument("--recording", type=Path, nargs="+", metavar="REC")
    _columns(add)
    add.add_argument("--expression", help="the formula of an effect of your own, over channel names")
    add.add_argument("--table", metavar="AXIS", help="a table over a channel instead: the curve where no formula fits")
    add.add_argument("--force", action="store_true", help="write the model also where the effect does not help")
    add.add_argument("--json", metavar="F", help=JSON_HELP)
    add.add_argument("--report", type=Path, metavar="F.html", help="a page that works offline")
    add.set_defaults(run=_later("model", "add"))

    remove = commands.add_parser("remove", help="take an effect out of the model again, and refit")
    remove.add_argument("effect", metavar="EFFECT")
    remove.add_argument("--model", type=Path, required=True, metavar="M")
    remove.add_argument("--recording", type=Path, nargs="+", metavar="REC")
    remove.add_argument("--json", metavar="F", help=JSON_HELP)
    remove.set_defaults(run=_later("model", "remove"))

    undo = commands.add_parser("undo", help="the model as it was before the last fit, add or remove")
    undo.add_argument("--model", type=Path, required=True, metavar="M")
    undo.add_argument("--force", action="store_true", help="also where the file was edited by hand since")
    undo.add_argument("--json", metavar="F", help=JSON_HELP)
    undo.set_defaults(run=_later("model", "undo"))


def _probing(command: Parser) -> None:
    command.add_argument("--probe", action="store_true", help="open every bus, read every device, show what they give")
    command.add_argument("--seconds", type=float, default=3.0, help="with --probe: listen and read for so long (3)")


def _columns(command: Parser) -> None:
    """How a file's own columns are to be read; kept beside it, so that it is said once."""
    command.add_argument("--columns", metavar="A,B,...", help="names of the columns of a file without header; _: none")
    command.add_argument(
        "--map",
        action="append",
        default=[],
        metavar="NAME=FORMULA",
        help="repeatable: time_s=time_ms*1e-3",
        dest="mapped",
    )


def _practice_commands(commands: argparse._SubParsersAction[Parser]) -> None:
    simulate = commands.add_parser("simulate", help="a recording from the simulated drive")
    simulate.add_argument("--effect", action="append", default=[], metavar="NAME", help="repeatable")
    simulate.add_argument("--hidden", type=int, metavar="SEED", help="an effect that is not named; see reveal")
    simulate.add_argument("--out", type=Path, required=True, metavar="REC")
    simulate.add_argument("--model", type=Path, metavar="M", help="also write the model one would begin with")
    simulate.add_argument("--seconds", type=float, default=30.0)
    simulate.add_argument("--seed", type=int, default=0)
    simulate.add_argument("--bits", type=int, default=24, help="of the output encoder, per turn")
    simulate.add_argument("--motion", default="rich", choices=("rich", "poor"))
    simulate.add_argument("--balance", default="torsion", choices=("torsion", "drive"))
    simulate.set_defaults(run=_later("practice", "simulate"))

    reveal = commands.add_parser("reveal", help="names the effect of a recording made with simulate --hidden")
    reveal.add_argument("recording", type=Path, metavar="REC")
    reveal.set_defaults(run=_later("practice", "reveal"))

    noise = commands.add_parser("noise", help="the noise model fitted to a sound")
    noise.add_argument(
        "sound", type=Path, metavar="SOUND", help="WAV, FLAC, CSV of time_s,sound or of frequency_hz,psd,averages"
    )
    noise.add_argument("--json", metavar="F", help=JSON_HELP)
    noise.set_defaults(run=_later("practice", "noise"))

    measure = commands.add_parser("measure", help="the stiffness in three ways, with limits and uncertainty")
    measure.add_argument("method", choices=("static", "frequency-response", "dynamic", "all"))
    measure.add_argument("recording", type=Path, nargs="+", metavar="REC")
    measure.add_argument("--model", type=Path, required=True, metavar="M", help="for ratio and output inertia")
    measure.add_argument("--inertia-sd", type=float, default=0.0, metavar="SD", help="how well it is known [kg m^2]")
    measure.add_argument(
        "--phase", type=int, action="append", default=[], metavar="N", help="part of a test motion; repeatable"
    )
    measure.add_argument("--json", metavar="F", help=JSON_HELP)
    measure.set_defaults(run=_later("measure", "measure"))

    curve = commands.add_parser("map", help="the stiffness over the twist, beside the maker's curve")
    curve.add_argument("recording", type=Path, nargs="+", metavar="REC")
    curve.add_argument("--model", type=Path, required=True, metavar="M", help="its other effects are fitted along")
    curve.add_argument("--gear", metavar="SIZE", help="such as CSG-20-100, or a TOML file")
    curve.add_argument("--json", metavar="F", help=JSON_HELP)
    curve.set_defaults(run=_later("stiffness_map", "command"))


def _life_commands(commands: argparse._SubParsersAction[Parser]) -> None:
    life = commands.add_parser("life", help="damage and remaining life from a history file")
    life.add_argument("history", type=Path, metavar="HISTORY")
    life.add_argument("--gear", required=True, metavar="SIZE", help="such as CSG-20-100, or a TOML file")
    life.add_argument("--json", metavar="F", help=JSON_HELP)
    life.add_argument("--load-factor", type=float, default=1.0, metavar="X", help="plan: 1.2 is 20 %% more torque")
    life.add_argument("--prior", type=Path, metavar="FILE", help="what `learn` has written")
    life.set_defaults(run=_later("life", "life"))

    faults = commands.add_parser("faults", help="which fault the drifts of a history point to")
    faults.add_argument("history", type=Path, metavar="HISTORY")
    faults.add_argument("--gear", required=True, metavar="SIZE", help="such as CSG-20-100, or a TOML file")
    faults.add_argument("--recording", type=Path, metavar="REC", help="with sound or torque, now")
    faults.add_argument("--reference", type=Path, metavar="REC", help="the same when the gear was well")
    faults.add_argument("--bearing", metavar="BALLS,SIZE", help="balls, and ball over pitch diameter: 23,0.1")
    faults.add_argument("--json", metavar="F", help=JSON_HELP)
    faults.set_defaults(run=_later("faults", "faults"))

    learn = commands.add_parser("learn", help="what gears that ran to failure teach, for life --prior")
    learn.add_argument("histories", type=Path, nargs="+", metavar="HISTORY", help="each to the hour of its failure")
    learn.add_argument("--gear", required=True, metavar="SIZE", help="such as CSG-20-100, or a TOML file")
    learn.add_argument("--out", type=Path, required=True, metavar="PRIOR")
    learn.add_argument("--json", metavar="F", help=JSON_HELP)
    learn.set_defaults(run=_later("life", "learn"))


def _design_commands(commands: argparse._SubParsersAction[Parser]) -> None:
    design = commands.add_parser("design", help="the flexspline as drawn: stresses, life, what to change")
    steps = design.add_subparsers(metavar="STEP", required=True)
    evaluate = steps.add_parser("evaluate", help="stresses, stiffness, life and limits of a design")
    best = steps.add_parser("optimise", help="the least F = w1 sigma_max + w2 delta_max + w3 V, and the front")
    compare = steps.add_parser("compare", help="two designs side by side, under the same loads")
    compare.add_argument("first", type=Path, metavar="A")
    compare.add_argument("second", type=Path, metavar="B")
    for step, name in ((evaluate, "evaluate"), (best, "optimise"), (compare, "compare")):
        if name != "compare":
            step.add_argument("file", type=Path, metavar="FILE")
            step.add_argument("--gear", type=Path, metavar="GEAR.toml", help="write it as a gear for life --gear")
        step.add_argument("--json", metavar="F", help=JSON_HELP)
        step.add_argument("--report", type=Path, metavar="F.html", help="a page with pictures that works offline")
        step.set_defaults(run=_later("design", f"design_{name}"))
    best.add_argument("--weights", metavar="W1,W2,W3", help="per MPa, per mm and per mm3, instead of the file's")
    best.add_argument("--out", type=Path, metavar="BEST.toml", help="write the best design")


def _fleet_commands(commands: argparse._SubParsersAction[Parser]) -> None:
    fleet = commands.add_parser("fleet", help="many gateways: collect what they publish, watch and learn from it")
    parts = fleet.add_subparsers(metavar="PART", required=True)

    collect = parts.add_parser("collect", help="writes what all gateways publish to a folder of Parquet files")
    _connected(collect)
    collect.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    collect.add_argument("--seconds", type=float, metavar="N", help="stop after this long")
    collect.add_argument("--json", metavar="F", help=JSON_HELP)
    collect.set_defaults(run=_later("fleet", "collect"))

    status = parts.add_parser("status", help="all drives, worst first, and who is silent")
    _connected(status)
    status.add_argument("--known", type=Path, metavar="FOLDER", help="drives of this dataset are silent if not there")
    status.add_argument("--json", metavar="F", help=JSON_HELP)
    status.set_defaults(run=_later("fleet", "status"))

    learn = parts.add_parser("learn", help="Weibull law and damage exponent from all lives, those that go on included")
    learn.add_argument("folder", type=Path, metavar="FOLDER", help="what `fleet collect` has written")
    learn.add_argument("--gear", metavar="SIZE", help="such as CSG-20-100; default: what the drives say they have")
    learn.add_argument(
        "--out", type=Path, metavar="PRIOR", help="for life --prior, `prior` of a drive, and fleet share"
    )
    learn.set_defaults(run=_later("fleet", "learn"))

    share = parts.add_parser("share", help="offers what was learned to the gateways, signed, until it is stopped")
    share.add_argument("prior", type=Path, metavar="PRIOR", help="what `fleet learn --out` has written")
    _connected(share)
    share.add_argument("--key", type=Path, required=True, metavar="F", help="the gateways' [zenoh] prior_key_file")
    share.add_argument("--seconds", type=float, metavar="N", help="stop after this long")
    share.add_argument("--json", metavar="F", help=JSON_HELP)
    share.set_defaults(run=_later("fleet", "share"))

    compare = parts.add_parser("compare", help="drives that differ from their peers under the same load")
    compare.add_argument("folder", type=Path, metavar="FOLDER", help="what `fleet collect` has written")
    compare.add_argument("--gear", metavar="SIZE", help="only drives with this one")
    compare.set_defaults(run=_later("fleet", "compare"))

    refit = parts.add_parser("refit", help="fits the models of many units anew to their recordings")
    refit.add_argument("folder", type=Path, metavar="FOLDER", help="a folder for each unit: its model and recordings")
    refit.add_argument("--effect", metavar="NAME", help="kept in each model where its held-out error falls with it")
    refit.add_argument("--write", action="store_true", help="change the model files; `undo` takes it back")
    refit.set_defaults(run=_later("fleet_refit", "refit"))
    for command in (learn, compare, refit):
        command.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster; default: this computer")
        command.add_argument("--json", metavar="F", help=JSON_HELP)


def _connected(command: Parser) -> None:
    """Which routers to ask."""
    command.add_argument(
        "--connect", nargs="+", action="extend", required=True, metavar="ENDPOINT", help="such as tcp/127.0.0.1:7447"
    )
    command.add_argument("--zenoh", type=Path, metavar="FILE", help="Zenoh's own configuration: certificates, password")


def _compensate_command(commands: argparse._SubParsersAction[Parser]) -> None:
    offsets = commands.add_parser("compensate", help="what to command so that the output is where it should be")
    what = offsets.add_mutually_exclusive_group(required=True)
    what.add_argument("--model", type=Path, metavar="M", help="fitted")
    what.add_argument("--demo", action="store_true", help="a simulated drive moves with and without")
    offsets.add_argument(
        "--recording", type=Path, metavar="REC", help="of this drive: what it does not bear out is off"
    )
    offsets.add_argument("--csv", type=Path, metavar="F.csv", help="write the tables")
    offsets.add_argument("--header", type=Path, metavar="F.h", help="write them as a C header")
    offsets.add_argument("--limit", type=float, default=0.5, metavar="RAD", help="largest offset at the motor (0.5)")
    offsets.add_argument("--torque", type=float, default=100.0, metavar="NM", help="the table's largest torque (100)")
    offsets.add_argument("--trajectory", type=Path, metavar="T", help="planned motion: time_s, theta_out_rad")
    offsets.add_argument("--stream", type=Path, metavar="F.csv", help="write its offsets as CiA 402 has them")
    offsets.add_argument("--counts-per-turn", type=float, default=65536.0, metavar="N", help="of the drive (65536)")
    offsets.add_argument("--rated-torque", type=float, default=1.0, metavar="NM", help="of the motor (1)")
    offsets.add_argument("--json", metavar="F", help=JSON_HELP)
    offsets.set_defaults(run=_compensate)


def _later(module: str, name: str, room: str = "commands") -> Callable[[argparse.Namespace], int | None]:
    """Calls `edge_daemon.<room>.<module>.<name>`, imported when it is needed: its libraries are heavy."""

    def run(arguments: argparse.Namespace) -> int | None:
        code: int | None = getattr(importlib.import_module(f"edge_daemon.{room}.{module}"), name)(arguments)
        return code

    return run


def _run(arguments: argparse.Namespace) -> None:
    from edge_daemon.service.daemon import run

    run(arguments.config, verbose=arguments.verbose)


def _excite(arguments: argparse.Namespace) -> int:
    if arguments.demo:
        from edge_daemon.demo.moved_drive import demonstrate

        return demonstrate(arguments)
    from edge_daemon.commands.excite import excite

    return excite(arguments)


def _experiment(arguments: argparse.Namespace) -> int:
    if arguments.demo:
        from edge_daemon.demo.moved_drive import inquire

        return inquire(arguments)
    from edge_daemon.commands.experiment import experiment

    return experiment(arguments)


def _compensate(arguments: argparse.Namespace) -> None:
    if arguments.demo:
        from edge_daemon.demo.compensated_drive import demonstrate

        return demonstrate(arguments)
    from edge_daemon.commands.compensate import compensate

    return compensate(arguments)


def _check(arguments: argparse.Namespace) -> None:
    from edge_daemon.commands.check import report

    print(report(arguments.file))
    if arguments.probe:
        from edge_daemon.service.probe import tried

        print()
        tried(arguments.file, arguments.seconds)


def _keys(arguments: argparse.Namespace) -> None:
    from edge_daemon.config.keys import listing

    print(listing(arguments.section))


def _registers(arguments: argparse.Namespace) -> None:
    from edge_daemon.publish.registers import render

    print(render(arguments.format), end="")


def _export(arguments: argparse.Namespace) -> None:
    from edge_daemon.commands.check import export

    orders = arguments.order if arguments.sound else None
    if arguments.order and not arguments.sound:
        raise BadInput("--order: expected together with --sound")
    print(export(arguments.store, arguments.out, arguments.since, arguments.drive, orders))


def _salvage(arguments: argparse.Namespace) -> None:
    from edge_daemon.commands.check import salvage

    print(salvage(arguments.store, arguments.out))
