"""`python -m edge_daemon.rig`: the simulated drives in a process of their own (see `process`)."""

from __future__ import annotations

import argparse
import asyncio
import sys
from pathlib import Path

from edge_daemon.errors import BadInput
from edge_daemon.rig.process import RigOptions, run


def parsed(arguments: list[str] | None = None) -> RigOptions:
    """Options from the command line."""
    parser = argparse.ArgumentParser(prog="edge_daemon.rig", description="Simulated drives on real interfaces.")
    parser.add_argument("--drives", type=int, default=1, help="1 to 8")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--effect",
        action="append",
        help="repeatable; 2:NAME of drive 2; `none`: a plain gear; default: the demo's",
    )
    parser.add_argument("--set", action="append", default=[], metavar="EFFECT.NAME=VALUE", help="a parameter's value")
    parser.add_argument("--wear", type=float, default=0.0, help="0 new, 1 worn out")
    parser.add_argument("--wear-per-s", type=float, default=0.0)
    parser.add_argument("--can", default="slcan", help="slcan, or INTERFACE:CHANNEL of python-can")
    parser.add_argument("--modbus-port", type=int, default=0, help="0: any free one")
    parser.add_argument("--bits-in", type=int, default=17)
    parser.add_argument("--bits-out", type=int, default=24)
    parser.add_argument("--log", type=Path, help="CSV of every encoder value that was sent")
    parser.add_argument("--fault", action="append", default=[], metavar="NAME[@S[-S]][:SIZE]", help="of drive 1")
    parser.add_argument("--folder", type=Path, help="where the serial port can0 and the I2C sockets appear")
    given = parser.parse_args(arguments)
    effects = None if given.effect is None else tuple(given.effect)
    return RigOptions(
        given.drives,
        given.seed,
        effects,
        dict(_assignment(text) for text in given.set),
        given.wear,
        given.wear_per_s,
        given.can,
        given.modbus_port,
        given.bits_in,
        given.bits_out,
        given.log,
        tuple(given.fault),
        given.folder,
    )


def _assignment(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError as error:
        raise BadInput(f"--set {text}: expected EFFECT.NAME=NUMBER") from error


def main() -> int:
    """0, or 2 with one line for bad input."""
    try:
        asyncio.run(run(parsed()))
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
