"""Commands over many gateways: collect, status, learn and compare."""

from __future__ import annotations

import argparse
import logging
import math
import signal
import sys
import threading
import time

from edge_daemon.errors import BadInput
from edge_daemon.text import written_as_json


def collect(arguments: argparse.Namespace) -> None:
    """Write what all gateways publish into a folder, until SIGTERM, SIGINT or `--seconds`."""
    from edge_daemon.fleet.collector import Collector

    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s", stream=sys.stderr)
    if arguments.seconds is not None and not 0.0 < arguments.seconds < math.inf:
        raise BadInput(f"--seconds {arguments.seconds:g}: expected more than 0")
    collector = Collector(arguments.connect, arguments.out, arguments.zenoh)
    for which in (signal.SIGTERM, signal.SIGINT):
        signal.signal(which, lambda *_: collector.stop())
    if arguments.seconds is not None:
        timer = threading.Timer(arguments.seconds, collector.stop)
        timer.daemon = True
        timer.start()
    collector.run()
    found = collector.figures()
    if not written_as_json(found, arguments.json):
        print(", ".join(f"{count} {name}" for name, count in found.items()))


def status(arguments: argparse.Namespace) -> None:
    """All drives, worst first, and who is silent."""
    from edge_daemon.fleet.dataset import known_drives
    from edge_daemon.fleet.status import fleet_status
    from edge_daemon.fleet.telling import status_lines

    known = known_drives(arguments.known) if arguments.known else ()
    rows = fleet_status(arguments.connect, known, arguments.zenoh)
    silent = ["/".join((row["site"], row["gateway"], row["drive"])) for row in rows if row["silent"]]
    if not written_as_json({"drives": rows, "silent": silent}, arguments.json):
        print(*status_lines(rows, silent), sep="\n")


def learn(arguments: argparse.Namespace) -> None:
    """The Weibull law and the damage exponent of a gear, and its prior, from a dataset."""
    from edge_daemon.fleet.lives import learned_json, lives_of, weibull_law
    from edge_daemon.fleet.past import of_one_gear, pasts
    from edge_daemon.fleet.prior import fleet_prior
    from edge_daemon.fleet.telling import learned_lines
    from edge_daemon.prognose.gears import find_gear

    named = find_gear(arguments.gear).name if arguments.gear else ""
    name, drives = of_one_gear(pasts(arguments.folder, arguments.scheduler), named)
    gear = find_gear(name)
    lives, out = lives_of(drives)
    law = weibull_law(lives, gear.rated_torque_Nm)
    found = learned_json(lives, law, gear, out)
    if arguments.out:
        try:
            arguments.out.write_bytes(fleet_prior(gear, law, lives, int(time.time())).to_bytes())
        except OSError as error:
            raise BadInput(f"{arguments.out}: cannot write: {error.strerror}") from error
    if not written_as_json(found, arguments.json):
        print(*learned_lines(found), sep="\n")


def compare(arguments: argparse.Namespace) -> None:
    """Drives that differ from their peers under the same load, and which of them differ alike."""
    from edge_daemon.fleet.past import only, pasts
    from edge_daemon.fleet.peers import FEWEST, compared
    from edge_daemon.fleet.telling import compared_lines

    drives = pasts(arguments.folder, arguments.scheduler)
    drives = only(drives, arguments.gear) if arguments.gear else drives
    if len(drives) < FEWEST:
        raise BadInput(f"{arguments.folder}: {len(drives)} drives: expected at least {FEWEST} to compare")
    peers = compared(drives)
    if not written_as_json(peers.to_json(), arguments.json):
        print(*compared_lines(peers), sep="\n")
