"""The page, its data and the metrics over HTTP: on loopback unless configured, nothing from elsewhere.

`/` is the live page, `/status` the same state as plain tables without any script library. What starts work or changes
something is in `job_routes`, and passes the `guard` first.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from aiohttp import web

from edge_daemon.config.settings import DashboardSettings as Settings
from edge_daemon.errors import BadInput, why_not_listening
from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import NE107, GatewayState
from edge_daemon.show import charts
from edge_daemon.show.feed import Feed, event_json
from edge_daemon.show.guard import HEADER, Guard, Handler
from edge_daemon.show.job_routes import JobRoutes
from edge_daemon.show.page import document, html
from edge_daemon.show.page_api import PageApi
from edge_daemon.show.seats import TLS_WITHIN_S, Seats, seated
from edge_daemon.text import finite

log = logging.getLogger(__name__)

STALE_AFTER_S = 5.0
"""Older data is not shown as if it were current (as long as the registers take it for good by default)."""
STOP_WITHIN_S = 1.0
"""An open request may hold up the shutdown this long."""
MOST_BODY = 4096
"""A request has no more bytes than a formula and a few names."""
EVENTS_LISTED = 500

FILES = {
    "/": ("app.html", "text/html"),
    "/app.css": ("app.css", "text/css"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
    **{
        f"/{name}.js": (f"{name}.js", "text/javascript")
        for name in (
            *("app", "texts", "dom", "plots", "gauges"),
            *("overview", "drive", "compare", "columns", "formula", "versions", "life", "sound", "events"),
        )
    },
}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

GetState = Callable[[], GatewayState]
MetricsText = Callable[[GatewayState], bytes]


class DashboardServer:
    """Serves the page and its data; other paths and methods are refused. `page_api` adds what is more than the state.

    Raises `BadInput` for a token file that is of no use.
    """

    def __init__(
        self, settings: Settings, state: GetState, metrics: MetricsText | None = None, page_api: PageApi | None = None
    ) -> None:
        self._settings = settings
        self._state = state
        self._metrics = metrics
        self._page_api = page_api
        self._guard = Guard(settings, page_api.folder if page_api else Path(), {*FILES, *charts.FILES})
        self._bench: JobRoutes | None = None
        self._feed: Feed | None = None
        self._runner: web.AppRunner | None = None
        self._listener: asyncio.Server | None = None

    async def start(self) -> int:
        """Listen; returns the port, which matters if 0 was asked for. Raises OSError if the address is taken."""
        runner = web.AppRunner(self._app(), access_log=None, shutdown_timeout=STOP_WITHIN_S)
        await runner.setup()
        tls = self._guard.tls
        try:
            self._listener = await asyncio.get_running_loop().create_server(
                Seats(runner),
                self._settings.host,
                self._settings.port,
                ssl=tls,
                ssl_handshake_timeout=TLS_WITHIN_S if tls else None,
                reuse_address=True,
            )
        except OSError as error:
            await runner.cleanup()
            address = f"{self._settings.host}:{self._settings.port}"
            raise OSError(f"cannot listen on {address}: {why_not_listening(error)}") from error
        self._runner = runner
        return int(self._listener.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Close the listener and all connections, and end work in child processes; again is fine."""
        runner, self._runner = self._runner, None
        if self._feed:
            self._feed.stop()
        if self._bench:
            await self._bench.stop()
        if self._listener is not None:
            self._listener.close()
            self._listener = None
        if runner:
            await runner.cleanup()

    @property
    def open_pages(self) -> int:
        """How many browsers are fed now."""
        return self._feed.pages if self._feed else 0

    def _app(self) -> web.Application:
        app = web.Application(client_max_size=MOST_BODY, middlewares=[seated, understood, self._guard.middleware])
        page_api = self._page_api
        self._feed = Feed(self._state, page_api.drive_view if page_api else lambda _: None, STALE_AFTER_S)
        get = app.router.add_get
        get("/status", self._status)
        get("/api/state", self._api_state)
        get("/api/session", self._session)
        get("/api/live", self._feed.serve)
        get("/health", self._health)
        get("/metrics", self._serve_metrics)
        app.router.add_post("/api/login", self._log_in)
        if page_api is not None:
            self._bench = JobRoutes(page_api, self._guard)
            get("/api/history", self._history)
            get("/api/trend", self._trend)
            get("/api/sound", self._sound)
            get("/api/events", self._events)
            get("/api/what-if", self._what_if)
            app.router.add_routes(self._bench.routes())
        for path in (*FILES, *charts.FILES):
            get(path, _file)
        app.on_response_prepare.append(_harden)
        return app

    async def _status(self, _: web.Request) -> web.Response:
        return web.Response(text=html(self._state(), STALE_AFTER_S), content_type="text/html")

    async def _api_state(self, _: web.Request) -> web.Response:
        return _json(document(self._state(), STALE_AFTER_S))

    async def _session(self, _: web.Request) -> web.Response:
        """What the page needs once: its secret, what it may do, and what the quantities mean."""
        quantities = {row.name: {"unit": row.unit, "meaning": row.meaning} for row in QUANTITIES.values()}
        return _json(
            {
                "header": HEADER,
                "secret": self._guard.secret,
                "allow_changes": self._guard.allow_changes,
                "quantities": quantities,
            }
        )

    async def _log_in(self, request: web.Request) -> web.Response:
        try:
            token = (await request.json())["token"]
        except (ValueError, KeyError, TypeError) as error:
            raise web.HTTPBadRequest(text='expected {"token": "..."}\n') from error
        return await self._guard.log_in(request, str(token))

    async def _history(self, request: web.Request) -> web.Response:
        assert self._page_api is not None
        drive = request.query.get("drive", "")
        if drive not in self._state().snapshots:
            raise web.HTTPNotFound(text="no such drive\n")
        return _json({"rows": finite(await _past(self._page_api.history, drive, request))})

    async def _trend(self, request: web.Request) -> web.Response:
        """Of a drive that has not begun again yet as well: what is stored of it is known before what is new."""
        assert self._page_api is not None
        return _json(await _past(self._page_api.trend, request.query.get("drive", ""), request))

    async def _sound(self, request: web.Request) -> web.Response:
        assert self._page_api is not None
        return _json(await _past(self._page_api.sound, request.query.get("drive", ""), request))

    async def _events(self, _: web.Request) -> web.Response:
        assert self._page_api is not None
        rows = await asyncio.to_thread(self._page_api.events, EVENTS_LISTED)
        return _json({"events": [event_json(event) for event in reversed(rows)]})

    async def _what_if(self, request: web.Request) -> web.Response:
        assert self._page_api is not None
        try:
            factor = float(request.query.get("factor", "1"))
            found = await asyncio.to_thread(self._page_api.what_if, request.query.get("drive", ""), factor)
        except (BadInput, ValueError) as error:
            raise web.HTTPBadRequest(text=f"{error}\n") from error
        return _json(finite(found))

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
    problems = [f"source {row.source}: {row.reason or row.state}" for row in state.sources if row.state != "ok"]
    problems += [f"{row.link}: {row.reason or row.state}" for row in state.links if row.state == "down"]
    if not state.snapshots:
        problems.append("no drive has been processed yet")
    for drive, snapshot in state.snapshots.items():
        if not state.now_s - snapshot.time_s <= STALE_AFTER_S:
            problems.append(f"drive {drive}: no data")
        elif snapshot.state is NE107.FAILURE:
            problems.append(f"drive {drive}: {'; '.join(snapshot.reasons) or 'failure'}")
    return problems


@web.middleware
async def understood(request: web.Request, handler: Handler) -> web.StreamResponse:
    """What no handler can make sense of (a number of 400 digits, 3 000 brackets) is the request's fault, not ours."""
    try:
        return await handler(request)
    except (ValueError, ArithmeticError, RecursionError) as error:
        log.debug("%s: %r", request.path, error)
        raise web.HTTPBadRequest(text="the request cannot be understood\n") from error


async def _past(ask: Callable[[str, dict[str, str]], Any], drive: str, request: web.Request) -> Any:
    asked = {name: value for name, value in request.query.items() if name != "drive"}
    try:
        return await asyncio.to_thread(ask, drive, asked)
    except (BadInput, ValueError) as error:
        raise web.HTTPBadRequest(text=f"{error}\n") from error


def _json(found: Any) -> web.Response:
    answer = web.Response(text=json.dumps(found, allow_nan=False), content_type="application/json")
    answer.enable_compression()
    return answer


async def _file(request: web.Request) -> web.Response:
    """One of the page's own files or the chart library's: the path is a key of a table, never a path on the disk."""
    if request.path in charts.FILES:
        found = charts.read(request.path)
        if found is None:
            raise web.HTTPNotFound(text="the chart library is not installed: run tools/charts\n")
        body, kind = found
    else:
        name, kind = FILES[request.path]
        body = (Path(__file__).parent / name).read_bytes()
    answer = web.Response(body=body, content_type=kind, charset="utf-8")
    answer.enable_compression()
    return answer


async def _harden(_: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)
    response.headers.pop("Server", None)
