"""The requests by which the page starts work and changes something. All pass the guard; results are asked for."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

from aiohttp import web

from edge_daemon.errors import BadInput
from edge_daemon.show.guard import UPLOAD, Guard, certified
from edge_daemon.show.jobs import Jobs
from edge_daemon.show.page_api import PageApi
from edge_daemon.show.uploads import MOST_BYTES
from edge_daemon.text import finite

log = logging.getLogger(__name__)

PIECE_BYTES = 2**16
MOST_NAME = 40
NOBODY = "someone at the page"

Body = Mapping[str, Any]
Answer = Callable[[Body], Awaitable[Mapping[str, Any]]]


class JobRoutes:
    """Compare, try, add, undo and acknowledge."""

    def __init__(self, page_api: PageApi, guard: Guard) -> None:
        self._page_api = page_api
        self._guard = guard
        self._jobs = Jobs(page_api.folder, page_api.store)

    def routes(self) -> list[web.RouteDef]:
        """Under `/api/`."""
        return [
            web.get("/api/job", self._job),
            web.get("/api/result", self._result),
            web.get("/api/bench", self._choices),
            web.get("/api/columns", self._columns),
            web.post("/api/columns", _posted(self._name_columns)),
            web.post("/api/look", _posted(self._look)),
            web.post("/api/try", _posted(self._try)),
            web.post("/api/add", _posted(self._add)),
            web.post("/api/version", _posted(self._version)),
            web.post("/api/between", _posted(self._between)),
            web.get("/api/formula", self._formula),
            web.post("/api/acknowledge", self._acknowledge),
            web.post("/api/report", _posted(self._report)),
            web.get("/api/report", self._made),
            web.post(UPLOAD, self._upload),
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
        """Recordings in the gateway's folder, and the versions of the drive's model."""
        drive = request.query.get("drive", "")
        model, shared = self._page_api.model_file(drive), list(self._page_api.sharing(drive))
        newest_s = await asyncio.to_thread(self._page_api.newest_s)
        versions = await asyncio.to_thread(self._page_api.versions, model) if model else ()
        return web.json_response(
            {
                "recordings": self._jobs.recordings(),
                "versions": finite(list(versions)),
                "newest_s": finite(newest_s),
                "upload": MOST_BYTES,
                "shared": shared,
            }
        )

    async def _look(self, body: Body) -> Mapping[str, Any]:
        drive, model = self._drive(body)
        seconds, recording, until_s = body.get("seconds", 30.0), body.get("recording"), body.get("until_s")
        if not isinstance(seconds, int | float) or not isinstance(recording, str | None):
            raise BadInput("seconds: expected a number, recording: expected a name")
        if until_s is not None and not (isinstance(until_s, int | float) and math.isfinite(until_s)):
            raise BadInput("until_s: expected a time in seconds since 1970")
        if recording is None:
            await asyncio.to_thread(self._page_api.flush)
        return self._jobs.look(drive, model, float(seconds), recording, until_s).status()

    async def _report(self, body: Body) -> Mapping[str, Any]:
        return self._jobs.report(*self._drive(body)).status()

    async def _made(self, _: web.Request) -> web.Response:
        """The report that was made last, as a file to keep."""
        job = self._jobs.job
        if job is None or job.made is None or job.running or job.error:
            raise web.HTTPNotFound(text="there is no report\n")
        page = await asyncio.to_thread(job.made.read_bytes)
        keep = {"Content-Disposition": f'attachment; filename="{job.drive}-report.html"'}
        return web.Response(body=page, content_type="text/html", charset="utf-8", headers=keep)

    async def _upload(self, request: web.Request) -> web.Response:
        self._guard.require_changes()
        name = request.query.get("name", "")
        try:
            if (request.content_length or 0) > MOST_BYTES:
                raise BadInput(f"larger than {MOST_BYTES // 2**20} MiB: upload a shorter recording, or Parquet")
            if name in self._jobs.recordings() and name not in self._jobs.uploads.files():
                raise BadInput(f"name {name!r}: the gateway has a recording of this name: choose another")
            size = await self._jobs.uploads.take(name, request.content.iter_chunked(PIECE_BYTES))
        except BadInput as error:
            raise web.HTTPBadRequest(text=f"{error}\n", headers={"Connection": "close"}) from error
        log.info("%s: %d bytes uploaded on the page", name, size)
        return web.json_response({"recording": name, "bytes": size})

    async def _columns(self, request: web.Request) -> web.Response:
        """First rows of an uploaded recording, and what its columns may be."""
        file = self._jobs.uploads.files().get(request.query.get("name", ""))
        if file is None:
            raise web.HTTPNotFound(text="there is no such upload\n")
        try:
            return web.json_response(await asyncio.to_thread(self._page_api.columns, file))
        except BadInput as error:
            raise web.HTTPBadRequest(text=f"{error}\n") from error

    async def _name_columns(self, body: Body) -> Mapping[str, Any]:
        self._guard.require_changes()
        file, rows = self._jobs.uploads.files().get(str(body.get("name"))), body.get("columns")
        if file is None or not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise BadInput("name, columns: expected an upload and a list of objects")
        await asyncio.to_thread(self._page_api.keep_columns, file, rows)
        return {"kept": file.name}

    async def _try(self, body: Body) -> Mapping[str, Any]:
        return self._extend(body, write=False)

    async def _add(self, body: Body) -> Mapping[str, Any]:
        self._guard.require_changes()
        return self._extend(body, write=True)

    def _extend(self, body: Body, *, write: bool) -> Mapping[str, Any]:
        drive, model = self._drive(body)
        effect, expression, without = body.get("effect"), body.get("expression"), body.get("without") is True
        if not isinstance(effect, str) or not isinstance(expression, str | None):
            raise BadInput("effect: expected a name, expression: expected a text")
        if write:
            what = "taking out" if without else "adding"
            log.info("%s: %s %s, model %s, asked for on the page", drive, what, effect[:60], model.name)
        return self._jobs.extend(drive, model, effect, expression, write=write, without=without).status()

    async def _version(self, body: Body) -> Mapping[str, Any]:
        self._guard.require_changes()
        drive, model = self._drive(body)
        if self._jobs.job and self._jobs.job.running:
            raise BadInput("something is being worked out: wait for it")
        said = await asyncio.to_thread(self._page_api.change_version, model, body)
        log.info("%s: %s %s of its model, asked for on the page", drive, body.get("do"), said)
        return {"said": said}

    async def _between(self, body: Body) -> Mapping[str, Any]:
        drive, model = self._drive(body)
        keys, known = body.get("versions"), [row["key"] for row in self._page_api.versions(model)]
        if not (isinstance(keys, list) and len(keys) == 2 and all(key in known for key in keys)):
            raise BadInput(f"versions: expected two of {', '.join(known)}")
        return self._jobs.between(drive, model, keys).status()

    async def _formula(self, request: web.Request) -> web.Response:
        """What the parser of model files says of a formula as far as it is written."""
        return web.json_response(finite(self._page_api.formula(request.query.get("text", ""))))

    async def _acknowledge(self, request: web.Request) -> web.Response:
        """The name on a client certificate stands above a typed one."""
        by = certified(request)

        async def answer(body: Body) -> Mapping[str, Any]:
            self._guard.require_changes()
            drive, _ = self._drive(body)
            alarm, who = body.get("alarm"), body.get("who", "")
            if not isinstance(alarm, str | None) or not isinstance(who, str):
                raise BadInput("alarm, who: expected texts")
            if len(who) > MOST_NAME or not who.isprintable():
                raise BadInput(f"who: expected at most {MOST_NAME} printable characters")
            return {"acknowledged": self._page_api.acknowledge(drive, alarm, by or who.strip() or NOBODY)}

        return await _posted(answer)(request)

    def _drive(self, body: Body) -> tuple[str, Path]:
        drive = body.get("drive")
        model = self._page_api.model_file(drive) if isinstance(drive, str) else None
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
