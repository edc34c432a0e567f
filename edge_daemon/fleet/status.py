"""How every drive is now, worst first, and who is silent."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from edge_daemon.errors import BadInput
from edge_daemon.fleet.collector import route_of
from edge_daemon.fleet.link import PREFIX, FleetLink
from edge_daemon.records import NE107

SILENT_S = 60.0
"""A drive that has said nothing for so long is silent: at 2 kB/s it says everything every four seconds."""
CONNECT_S = 5.0
"""A router that is there answers within this."""
ASK_S = 3.0
"""Gateways are waited for this long."""
WANTED = ("health", "life")
GATEWAY = "_gateway"


@dataclass(slots=True)
class DriveStatus:
    """What is known of one drive."""

    drive: str
    """site/gateway/drive"""
    present: bool = False
    """its token stands"""
    newest_s: float = math.nan
    """time of its newest message"""
    documents: dict[str, Mapping[str, Any]] = field(default_factory=dict)

    def silent(self, now_s: float) -> str:
        """Why it counts as silent; empty if it does not."""
        if not self.documents:
            return "its token stands, but it says nothing" if self.present else "it is not there"
        age_s = now_s - self.newest_s
        if not age_s <= SILENT_S:
            return f"nothing new for {age_s:.0f} s" if math.isfinite(age_s) else "its messages have no time"
        return "" if self.present else "its token is gone"

    def to_json(self, now_s: float) -> dict[str, Any]:
        """One row; what is not known is null."""
        site, gateway, drive = self.drive.split("/")
        health = self.documents.get("health", {})
        state, reasons = health.get("state"), health.get("reasons")
        silent = self.silent(now_s)
        return {
            "site": site,
            "gateway": gateway,
            "drive": drive,
            "state": state if isinstance(state, str) else "unknown",
            "ne107": _rank(health),
            "reasons": [str(reason) for reason in reasons] if isinstance(reasons, list) else [],
            "health_index": self._value("health", "health_index"),
            "damage": self._value("life", "damage"),
            "rul_p50_h": self._value("life", "rul_p50_h"),
            "age_s": round(now_s - self.newest_s, 3) if math.isfinite(self.newest_s) else None,
            "silent": bool(silent),
            "silent_because": silent or None,
        }

    def _value(self, topic: str, name: str) -> float | None:
        told = self.documents.get(topic, {}).get("estimates")
        row = told.get(name) if isinstance(told, Mapping) else None
        value = row.get("value") if isinstance(row, Mapping) else None
        return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _rank(health: Mapping[str, Any]) -> int | None:
    found = health.get("ne107")
    return found if isinstance(found, int) and 0 <= found <= max(NE107) else None


def worst_first(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """By state, the silent before the others of a state, then by health; what is not known counts as bad."""

    def badness(row: dict[str, Any]) -> tuple[float, bool, float, str]:
        rank = 0.5 if row["ne107"] is None else float(row["ne107"])
        health = -1.0 if row["health_index"] is None else row["health_index"]
        return -rank, not row["silent"], health, f"{row['site']}/{row['gateway']}/{row['drive']}"

    return sorted(rows, key=badness)


def fleet_status(
    endpoints: Sequence[str], known: Iterable[str] = (), file: Path | None = None, within_s: float = ASK_S
) -> dict[str, Any]:
    """`drives`, worst first, and the names of the `silent`. `known`: drives (site/gateway/drive) that are silent where
    nobody answers for them.

    Raises `BadInput` where no endpoint answers.
    """
    found: dict[str, DriveStatus] = {drive: DriveStatus(drive) for drive in known}
    lock = threading.Lock()

    def hear(key: str, payload: bytes) -> None:
        route = route_of(key)
        if route is None or route.words[2] == GATEWAY:
            return
        with lock:
            take(found.setdefault(route.drive, DriveStatus(route.drive)), route.words[3], payload)

    link = FleetLink(endpoints, hear, None, file)
    try:
        if not link.connected(CONNECT_S):
            raise BadInput(f"--connect {' '.join(endpoints)}: nobody answers: expected a router or a gateway")
        for key in link.tokens(within_s):
            drive = key.removeprefix(f"{PREFIX}/")
            if drive.count("/") == 2 and not drive.endswith(f"/{GATEWAY}"):
                with lock:
                    found.setdefault(drive, DriveStatus(drive)).present = True
        for topic in WANTED:
            for key, payload, _ in link.get(f"{PREFIX}/*/*/*/{topic}", within_s, everywhere=True):
                if payload is not None:
                    hear(key, payload)
        _wait_for_the_quiet(found, lock, within_s)
    finally:
        link.close()
    now_s = time.time()
    with lock:
        rows = worst_first(row.to_json(now_s) for row in found.values())
    return {"drives": rows, "silent": ["/".join((r["site"], r["gateway"], r["drive"])) for r in rows if r["silent"]]}


def _wait_for_the_quiet(found: dict[str, DriveStatus], lock: threading.Lock, within_s: float) -> None:
    """Some gateways do not answer questions for the newest: what they say anyway is listened to for a while."""
    end_s, gate = time.monotonic() + within_s, threading.Event()
    while time.monotonic() < end_s:
        with lock:
            if all(row.documents.keys() >= set(WANTED) or not row.present for row in found.values()) and found:
                return
        gate.wait(0.1)


def take(row: DriveStatus, topic: str, payload: bytes) -> None:
    """Note down what a payload says of a drive; one that is no document says nothing."""
    try:
        document = msgspec.json.decode(payload)
    except (ValueError, RecursionError):
        return
    if not isinstance(document, Mapping):
        return
    time_s = document.get("time_s")
    if isinstance(time_s, int | float) and not row.newest_s >= time_s:
        row.newest_s = float(time_s)
    before = row.documents.get(topic, {}).get("time_s")
    if topic in WANTED and not (
        isinstance(before, int | float) and isinstance(time_s, int | float) and before > time_s
    ):
        row.documents[topic] = document
