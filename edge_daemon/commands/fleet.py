"""Commands over many gateways: collect, status, learn and compare."""

from __future__ import annotations

import argparse

from edge_daemon.text import written_as_json


def collect(arguments: argparse.Namespace) -> None:
    """Write what all gateways publish into a folder, until SIGTERM, SIGINT or `--seconds`."""
    from edge_daemon.fleet.collector import collected

    found = collected(arguments.connect, arguments.out, arguments.zenoh, arguments.seconds)
    if not written_as_json(found, arguments.json):
        print(", ".join(f"{count} {name}" for name, count in found.items()))


def status(arguments: argparse.Namespace) -> None:
    """All drives, worst first, and who is silent."""
    from edge_daemon.fleet.dataset import known_drives
    from edge_daemon.fleet.status import fleet_status
    from edge_daemon.fleet.telling import status_lines

    known = known_drives(arguments.known) if arguments.known else ()
    found = fleet_status(arguments.connect, known, arguments.zenoh)
    if not written_as_json(found, arguments.json):
        print(*status_lines(**found), sep="\n")


def learn(arguments: argparse.Namespace) -> None:
    """The Weibull law and the damage exponent of a gear, and its prior, from a dataset."""
    from edge_daemon.fleet.prior import learned
    from edge_daemon.fleet.telling import learned_lines

    found = learned(arguments.folder, arguments.gear, arguments.scheduler, arguments.out)
    if not written_as_json(found, arguments.json):
        print(*learned_lines(found), sep="\n")


def compare(arguments: argparse.Namespace) -> None:
    """Drives that differ from their peers under the same load, and which of them differ alike."""
    from edge_daemon.fleet.peers import compared_dataset
    from edge_daemon.fleet.telling import compared_lines

    peers = compared_dataset(arguments.folder, arguments.gear, arguments.scheduler)
    if not written_as_json(peers.to_json(), arguments.json):
        print(*compared_lines(peers), sep="\n")
