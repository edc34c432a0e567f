"""The status page and the metrics over HTTP: read-only, on loopback unless configured, nothing from elsewhere."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from pathlib import Path

from aiohttp import web

from edge_daemon.records import NE107, GatewayState
from edge_daemon.settings import Dashboard as Settings
from edge_daemon.show.page import document, html

log = logging.getLogger(__name__)

STALE_AFTER_S = 5.0
"""older data is not shown as if it were current (as long as the registers take it for good by default)"""
STOP_WITHIN_S = 1.0
"""an open request may hold up the shutdown this long"""

_FILES = {"/page.css": "text/css", "/page.js": "text/javascript"}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

State = Callable[[], GatewayState]
Metrics = Callable[[GatewayState], bytes]


class Dashboard:
    """Serves `/`, `/api/state`, `/health` and, if given, `/metrics`; any other path or method is refused."""

    def __init__(self, settings: Settings, state: State, metrics: Metrics | None = None) -> None:
        self._settings = settings
        self._state = state
        self._metrics = metrics
        self._runner: web.AppRunner | None = None

    async def start(self) -> int:
        """Listen; returns the port, which matters if 0 was asked for. Raises OSError if the address is taken."""
        runner = web.AppRunner(self._app(), access_log=None, shutdown_timeout=STOP_WITHIN_S)
        await runner.setup()
        try:
            await web.TCPSite(runner, self._settings.host, self._settings.port).start()
        except OSError as error:
            await runner.cleanup()
            address = f"{self._settings.host}:{self._settings.port}"
            raise OSError(f"dashboard: cannot listen on {address}: {error.strerror}") from error
        self._runner = runner
        return int(runner.addresses[0][1])

    async def stop(self) -> None:
        """Close the listener and all connections; again is fine."""
        runner, self._runner = self._runner, None
        if runner:
            await runner.cleanup()

    def _app(self) -> web.Application:
        app = web.Application(client_max_size=0)
        app.router.add_get("/", self._page)
        app.router.add_get("/api/state", self._api_state)
        app.router.add_get("/health", self._health)
        app.router.add_get("/metrics", self._serve_metrics)
        for path in _FILES:
            app.router.add_get(path, _file)
        app.on_response_prepare.append(_harden)
        return app

    async def _page(self, _: web.Request) -> web.Response:
        return web.Response(text=html(self._state(), STALE_AFTER_S), content_type="text/html")

    async def _api_state(self, _: web.Request) -> web.Response:
        text = json.dumps(document(self._state(), STALE_AFTER_S), allow_nan=False)
        return web.Response(text=text, content_type="application/json")

    async def _health(self, _: web.Request) -> web.Response:
        problems = health(self._state())
        body = {"ok": not problems, "problems": problems}
        return web.json_response(body, status=503 if problems else 200)

    async def _serve_metrics(self, _: web.Request) -> web.Response:
        if self._metrics is None:
            raise web.HTTPNotFound
        return web.Response(
            body=self._metrics(self._state()),
            headers={"Content-Type": "text/plain; version=0.0.4; charset=utf-8"},
        )


def health(state: GatewayState) -> list[str]:
    """What keeps the gateway from doing its job; empty if nothing. A worn gear is not the gateway's problem."""
    problems = [f"source {row.source}: {row.reason or row.state}" for row in state.sources if row.state == "down"]
    problems += [f"{row.link}: {row.reason or row.state}" for row in state.links if row.state == "down"]
    if not state.snapshots:
        problems.append("no drive has been processed yet")
    for drive, snapshot in state.snapshots.items():
        if not state.now_s - snapshot.time_s <= STALE_AFTER_S:
            problems.append(f"drive {drive}: no data")
        elif snapshot.state is NE107.FAILURE:
            problems.append(f"drive {drive}: {'; '.join(snapshot.reasons) or 'failure'}")
    return problems


async def _file(request: web.Request) -> web.Response:
    """One of the page's own files: the path is a key of a table, never a path on the disk."""
    text = (Path(__file__).parent / request.path.removeprefix("/")).read_text()
    return web.Response(text=text, content_type=_FILES[request.path])


async def _harden(_: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)
    response.headers.pop("Server", None)
