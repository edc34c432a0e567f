"""The requests by which the page starts work and changes something. All pass the guard; results are asked for."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

from aiohttp import web

from edge_daemon.errors import BadInput
from edge_daemon.show.guard import Guard
from edge_daemon.show.jobs import Jobs, kept
from edge_daemon.show.page import finite
from edge_daemon.show.sight import Sight

log = logging.getLogger(__name__)

Body = Mapping[str, Any]
Answer = Callable[[Body], Awaitable[Mapping[str, Any]]]


class Bench:
    """Compare, try, add, undo and acknowledge."""

    def __init__(self, sight: Sight, guard: Guard) -> None:
        self._sight = sight
        self._guard = guard
        self._jobs = Jobs(sight.folder, sight.store)

    def routes(self) -> list[web.RouteDef]:
        """Under `/api/`."""
        return [
            web.get("/api/job", self._job),
            web.get("/api/result", self._result),
            web.get("/api/bench", self._choices),
            web.post("/api/look", _posted(self._look)),
            web.post("/api/try", _posted(self._try)),
            web.post("/api/add", _posted(self._add)),
            web.post("/api/undo", _posted(self._undo)),
            web.post("/api/acknowledge", _posted(self._acknowledge)),
        ]

    async def stop(self) -> None:
        """End what runs."""
        await self._jobs.stop()

    async def _job(self, _: web.Request) -> web.Response:
        job = self._jobs.job
        return web.json_response({"job": job.status() if job else None})

    async def _result(self, _: web.Request) -> web.Response:
        job = self._jobs.job
        if job is None or job.result is None:
            raise web.HTTPNotFound(text="there is no result\n")
        answer = web.json_response({"job": job.status(), "result": finite(job.result)})
        answer.enable_compression()
        return answer

    async def _choices(self, request: web.Request) -> web.Response:
        """Recordings in the gateway's folder, and how many changes of the drive's model can be undone."""
        model = self._sight.model_file(request.query.get("drive", ""))
        return web.json_response({"recordings": self._jobs.recordings(), "undo": len(kept(model)) if model else 0})

    async def _look(self, body: Body) -> Mapping[str, Any]:
        drive, model = self._drive(body)
        seconds, recording = body.get("seconds", 30.0), body.get("recording")
        if not isinstance(seconds, int | float) or not isinstance(recording, str | None):
            raise BadInput("seconds: expected a number, recording: expected a name")
        return self._jobs.look(drive, model, float(seconds), recording).status()

    async def _try(self, body: Body) -> Mapping[str, Any]:
        return self._extend(body, write=False)

    async def _add(self, body: Body) -> Mapping[str, Any]:
        self._guard.require_changes()
        return self._extend(body, write=True)

    def _extend(self, body: Body, *, write: bool) -> Mapping[str, Any]:
        drive, model = self._drive(body)
        effect, expression = body.get("effect"), body.get("expression")
        if not isinstance(effect, str) or not isinstance(expression, str | None):
            raise BadInput("effect: expected a name, expression: expected a text")
        if write:
            log.info("%s: adding %s to %s, asked for on the page", drive, effect[:60], model.name)
        return self._jobs.extend(drive, model, effect, expression, write).status()

    async def _undo(self, body: Body) -> Mapping[str, Any]:
        self._guard.require_changes()
        drive, model = self._drive(body)
        if self._jobs.job and self._jobs.job.running:
            raise BadInput("something is being worked out: wait for it")
        name = await self._jobs.undo(model)
        log.info("%s: %s put back, asked for on the page", drive, name)
        return {"undone": name}

    async def _acknowledge(self, body: Body) -> Mapping[str, Any]:
        self._guard.require_changes()
        drive, _ = self._drive(body)
        return {"acknowledged": self._sight.acknowledge(drive)}

    def _drive(self, body: Body) -> tuple[str, Path]:
        drive = body.get("drive")
        model = self._sight.model_file(drive) if isinstance(drive, str) else None
        if model is None:
            raise BadInput("drive: expected the name of a drive")
        return str(drive), model


def _posted(answer: Answer) -> Callable[[web.Request], Awaitable[web.Response]]:
    """A handler of a JSON object; bad input becomes one line."""

    async def handle(request: web.Request) -> web.Response:
        try:
            body = await request.json()
        except ValueError as error:
            raise web.HTTPBadRequest(text="expected JSON\n") from error
        if not isinstance(body, dict):
            raise web.HTTPBadRequest(text="expected a JSON object\n")
        try:
            return web.json_response(await answer(body))
        except BadInput as error:
            raise web.HTTPBadRequest(text=f"{error}\n") from error

    return handle
