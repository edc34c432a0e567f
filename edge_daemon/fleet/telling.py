"""What a person asks of a fleet, and what is answered: as lines of text, or as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from edge_daemon.text import number, table, written_as_json

if TYPE_CHECKING:
    from edge_daemon.fleet.peers import Peers


def status_lines(drives: Sequence[dict[str, Any]], silent: Sequence[str]) -> Iterator[str]:
    """Of `fleet_status`."""
    head = ("site", "gateway", "drive", "state", "health", "life left h", "age s", "why")
    yield table(head, map(_status_cells, drives)) if drives else "no drive is there"
    yield f"{len(drives)} drives, {len(silent)} silent{': ' if silent else ''}{', '.join(silent)}"


def _status_cells(row: dict[str, Any]) -> tuple[str, ...]:
    def cell(value: float | None) -> str:
        return "-" if value is None else number(value, 3)

    why = "; ".join(filter(None, [row["silent_because"], *row["reasons"]]))
    state = "silent" if row["silent"] else row["state"].replace("_", " ")
    figures = (cell(row["health_index"]), cell(row["rul_p50_h"]), cell(row["age_s"]))
    return (row["site"], row["gateway"], row["drive"], state, *figures, why)


def learned_lines(found: dict[str, Any]) -> Iterator[str]:
    """Of `learned_json`."""
    drives = f"{found['drives']} drives, {found['failed']} failed, {found['censored']} go on"
    yield f"{found['gear']}: {drives}; 90 % intervals:"
    names = ("weibull_shape", "damage_exponent", "characteristic_life_h")
    rows = [(name, *(number(found[name][part]) for part in ("median", "sd", "from", "to"))) for name in names]
    yield table(("parameter", "median", "sd", "from", "to"), rows)
    yield from (f"  left out: {line}" for line in found["left_out"])


def compared_lines(peers: Peers) -> Iterator[str]:
    """Of `compared`."""
    yield f"{peers.drives} drives: {len(peers.units)} differ from their peers under the same load"
    for group in peers.groups:
        yield f"{peers.said(group)}:"
        for drive in group:
            told = [
                f"{r.name} {number(r.value / r.expected, 3)} times a peer's ({r.z:+.1f} sd)" for r in peers.units[drive]
            ]
            yield f"  {drive}: {', '.join(told)}"


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

    known = known_drives(arguments.known) if arguments.known else ()
    found = fleet_status(arguments.connect, known, arguments.zenoh)
    if not written_as_json(found, arguments.json):
        print(*status_lines(**found), sep="\n")


def learn(arguments: argparse.Namespace) -> None:
    """The Weibull law and the damage exponent of a gear, and its prior, from a dataset."""
    from edge_daemon.fleet.learning import learned

    found = learned(arguments.folder, arguments.gear, arguments.scheduler, arguments.out)
    if not written_as_json(found, arguments.json):
        print(*learned_lines(found), sep="\n")


def share(arguments: argparse.Namespace) -> None:
    """Offer a prior to the gateways until SIGTERM, SIGINT or `--seconds`."""
    from edge_daemon.fleet.sharing import shared

    options = (arguments.connect, arguments.prior, arguments.key, arguments.zenoh, arguments.seconds)
    found = shared(*options)
    if not written_as_json(found, arguments.json):
        lives = f"prior {found['number']} of {found['gear']}, from {found['drives']} lives"
        print(f"{lives}: {found['asked']} gateways asked for it, beside those that heard it at once")


def compare(arguments: argparse.Namespace) -> None:
    """Drives that differ from their peers under the same load, and which of them differ alike."""
    from edge_daemon.fleet.peers import compared_dataset

    peers = compared_dataset(arguments.folder, arguments.gear, arguments.scheduler)
    if not written_as_json(peers.to_json(), arguments.json):
        print(*compared_lines(peers), sep="\n")
