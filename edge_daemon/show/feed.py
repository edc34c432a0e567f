"""What an open page receives every second, as server-sent events.

Frames are made when a page asks, at most once a second for all pages that look at the same drive. There is no queue: a
page that reads slowly gets its next frame when it has taken the last one, and one that has stopped reading is dropped.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from aiohttp import web

from edge_daemon.records import Estimate, Event, GatewayState, Snapshot
from edge_daemon.show.page import STATE_WORDS, snapshot_json, starting_yet
from edge_daemon.text import fields_of, finite

EVERY_S = 1.0
STALLED_S = 5.0
"""A page that takes nothing for this long is dropped; it connects again by itself when it comes back."""
MOST_PAGES = 16
"""So many pages may be open at once; more are asked to come back later."""
EVENTS_SENT = 30
SHOWN = ("health_index", "rul_p10_h", "rul_p50_h", "stiffness", "model_nrmse", "model_noise_floor", "damage")
"""The overview shows these quantities."""

DriveView = Callable[[str], Mapping[str, Any] | None]


class Feed:
    """Serves `/api/live`."""

    def __init__(self, state: Callable[[], GatewayState], drive_view: DriveView, stale_after_s: float) -> None:
        self._state = state
        self._drive_view = drive_view
        self._stale_after_s = stale_after_s
        self._made: dict[str, tuple[float, bytes]] = {}
        self._stopped = asyncio.Event()
        self.pages = 0

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """Frames until the page leaves or stalls."""
        if self.pages >= MOST_PAGES:
            raise web.HTTPServiceUnavailable(
                text=f"{MOST_PAGES} pages are open already\n", headers={"Retry-After": "10"}
            )
        drive = request.query.get("drive", "")
        answer = web.StreamResponse(headers={"Content-Type": "text/event-stream; charset=utf-8"})
        self.pages += 1
        try:
            await answer.prepare(request)
            await answer.write(b"retry: 1000\n\n")
            while not self._stopped.is_set():
                await asyncio.wait_for(answer.write(self.frame(drive)), STALLED_S)
                await _until(self._stopped, EVERY_S)
        except (TimeoutError, ConnectionError):
            if request.transport is not None:
                request.transport.abort()
        finally:
            self.pages -= 1
        return answer

    def stop(self) -> None:
        """End all streams."""
        self._stopped.set()

    def frame(self, drive: str) -> bytes:
        """The newest events of the stream: `state` for all, `drive` for the one looked at."""
        now = time.monotonic()
        made = self._made.get(drive)
        if made is None or now - made[0] > 0.9 * EVERY_S:
            self._made = {name: row for name, row in self._made.items() if now - row[0] < 2 * EVERY_S}
            made = self._made[drive] = (now, self._make(drive))
        return made[1]

    def _make(self, drive: str) -> bytes:
        state = self._state()
        parts = [("state", overview(state, self._stale_after_s))]
        snapshot = state.snapshots.get(drive)
        if snapshot is not None:
            parts.append(("drive", self._closer(snapshot, state)))
        return b"".join(f"event: {name}\ndata: {text_of(document)}\n\n".encode() for name, document in parts)

    def _closer(self, snapshot: Snapshot, state: GatewayState) -> dict[str, Any]:
        found = snapshot_json(snapshot, state.now_s)
        found["stale"] = not state.now_s - snapshot.time_s <= self._stale_after_s
        found["starting"] = starting_yet(snapshot, state, self._stale_after_s)
        return {"name": snapshot.drive, **found, "picture": self._drive_view(snapshot.drive)}


async def _until(event: asyncio.Event, seconds: float) -> None:
    try:
        await asyncio.wait_for(event.wait(), seconds)
    except TimeoutError:
        return


def overview(state: GatewayState, stale_after_s: float) -> dict[str, Any]:
    """All drives in short, the worst first, and the newest events."""
    rows = [_in_short(snapshot, state, stale_after_s) for snapshot in state.snapshots.values()]
    rows.sort(key=_worst)
    down = [f"{row.source}: {row.reason or row.state}" for row in state.sources if row.state in ("down", "degraded")]
    down += [f"{row.link}: {row.reason or row.state}" for row in state.links if row.state in ("down", "degraded")]
    return {
        "site": state.site,
        "gateway": state.gateway,
        "version": state.version,
        "now_s": state.now_s,
        "up_s": state.now_s - state.started_s,
        "drives": rows,
        "troubles": down,
        "events": [event_json(event) for event in reversed(state.events[-EVENTS_SENT:])],
    }


def _worst(row: Mapping[str, Any]) -> tuple[int, float]:
    """Worst first; health to a hundredth, so that its noise does not shuffle the rows."""
    return -row["rank"], round(row["health_index"], 2) if row["health_index"] is not None else 2.0


def event_json(event: Event) -> dict[str, Any]:
    """One event for the page."""
    row: dict[str, Any] = finite(fields_of(event))
    row["rank"] = int(event.severity)
    return row


def _in_short(snapshot: Snapshot, state: GatewayState, stale_after_s: float) -> dict[str, Any]:
    age_s = state.now_s - snapshot.time_s
    stale, starting = not age_s <= stale_after_s, starting_yet(snapshot, state, stale_after_s)
    return {
        "name": snapshot.drive,
        "rank": int(snapshot.state) if starting or not stale else 5,
        "state": "starting" if starting else "no data" if stale else STATE_WORDS[snapshot.state],
        "reasons": list(snapshot.reasons),
        "age_s": round(age_s, 2) if math.isfinite(age_s) else None,
        **{name: None if stale else _value(snapshot.estimates.get(name)) for name in SHOWN},
    }


def _value(estimate: Estimate | None) -> float | None:
    return float(f"{estimate.value:.5g}") if estimate is not None and estimate.usable else None


def text_of(document: Mapping[str, Any]) -> str:
    """A document in the fewest letters of JSON."""
    return json.dumps(document, allow_nan=False, separators=(",", ":"))
