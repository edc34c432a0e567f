"""Who may sit at the page, and for how long without asking: half-sent requests must not keep the others out.

aiohttp neither counts its connections nor minds a request that never ends. Each connection is a seat here: there are
so many of them, below the descriptors of the process, and one that asks nothing for long is given to who comes.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any

from aiohttp import web

SEATS = 96
"""Connections at once: some pages take six each, and the buses need descriptors of the usual 1024 too."""
ASKS_WITHIN_S = 10.0
"""A request must be whole this long after its connection was made, or after the answer before."""
TLS_WITHIN_S = 5.0
"""A handshake over TLS must be done within this."""
BODY_WITHIN_S = 20.0
"""A body must have arrived, and been answered, within this."""
UPLOAD_WITHIN_S = 300.0
"""An upload must have arrived within this: 64 MiB at 2 Mbit/s."""


class Seats:
    """The connections of one page."""

    def __init__(self, runner: web.AppRunner) -> None:
        self._runner = runner
        self._taken: dict[Seat, None] = {}
        self.turned_away = 0

    def __call__(self) -> Seat:
        """A connection's protocol, for `loop.create_server`."""
        assert self._runner.server is not None
        return Seat(self, self._runner.server, loop=asyncio.get_running_loop(), access_log=None)

    def take(self, seat: Seat) -> bool:
        """Whether there is room; if need be, of the address that has most the one that has been idle longest goes."""
        if len(self._taken) >= SEATS:
            held = Counter(other.address for other in self._taken)
            idle = [other for other in self._taken if not other.asking]
            self.turned_away += 1
            if not idle:
                return False
            max(idle, key=lambda other: held[other.address]).leave()
        self._taken[seat] = None
        return True

    def left(self, seat: Seat) -> None:
        """A connection is gone."""
        self._taken.pop(seat, None)


class Seat(web.RequestHandler):
    """One connection."""

    def __init__(self, seats: Seats, server: Any, **options: Any) -> None:
        super().__init__(server, **options)
        self._seats = seats
        self._deadline: asyncio.TimerHandle | None = None
        self.address = ""
        self.asking = False
        """whether a whole request is being answered"""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        self.address = str((transport.get_extra_info("peername") or ("",))[0])
        super().connection_made(transport)
        if self._seats.take(self):
            self.done()
        else:
            self.leave()

    def connection_lost(self, exc: BaseException | None) -> None:
        """See `asyncio.Protocol`."""
        self._seats.left(self)
        if self._deadline is not None:
            self._deadline.cancel()
        super().connection_lost(exc)

    def leave(self) -> None:
        """Close now, whatever is under way."""
        self._seats.left(self)
        if self.transport is not None:
            self.transport.abort()

    def begun(self) -> None:
        """A request is whole."""
        self.asking = True
        if self._deadline is not None:
            self._deadline.cancel()

    def done(self) -> None:
        """It was answered; the next one must come in time."""
        self.asking = False
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = asyncio.get_running_loop().call_later(ASKS_WITHIN_S, self.leave)


@web.middleware
async def seated(request: web.Request, handler: Any) -> web.StreamResponse:
    """Tells the seat of its request, and ends one whose body does not come."""
    seat = request.protocol
    if not isinstance(seat, Seat):  # a page that a test serves in its own way
        return await handler(request)  # type: ignore[no-any-return]
    seat.begun()
    limit_s = UPLOAD_WITHIN_S if request.path == "/api/upload" else BODY_WITHIN_S
    try:
        async with asyncio.timeout(limit_s if request.method == "POST" else None):
            return await handler(request)  # type: ignore[no-any-return]
    except TimeoutError:
        raise web.HTTPRequestTimeout(text=f"the request took longer than {limit_s:g} s\n") from None
    finally:
        seat.done()
