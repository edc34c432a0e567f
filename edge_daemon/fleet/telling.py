"""What was found of a fleet, for a person: lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from edge_daemon.fleet.peers import Peers
from edge_daemon.text import number, table


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
