"""Who may read the page and who may change something through it.

On loopback everybody on this machine reads; the Host header is checked, so that a site in a browser cannot reach the
page by pointing its own name at 127.0.0.1. Bound wider, a reader must know the token or hold a client certificate. A
request that starts or changes something must carry a secret that only the page itself can read (against cross-site
requests).
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import logging
import secrets
import ssl
from collections import Counter
from collections.abc import Awaitable, Callable, Collection
from pathlib import Path

from aiohttp import web

from edge_daemon.config.settings import DashboardSettings as Settings
from edge_daemon.errors import BadInput

log = logging.getLogger(__name__)

COOKIE = "edge_daemon"
HEADER = "X-Edge-Daemon"
SHORTEST_TOKEN = 16
"""Nobody guesses a token of so many characters over a network."""
UPLOAD = "/api/upload"
"""This is the one request whose body is a file."""
OWN_SITE = frozenset({"same-origin", "none"})
"""A browser says one of these of what the page itself asks for."""
GUESSES_AT_ONCE = 3
"""So many wrong tokens of one address may wait for their answer; meanwhile no other of it is looked at."""
GUESS_COSTS_S = 1.0
"""A wrong token is answered after this, so that an address makes three guesses a second instead of thousands."""
LOOPBACK_HOSTS = frozenset({"localhost", "127.0.0.1", "[::1]"})

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Guard:
    """The middleware of one dashboard. Raises `BadInput` for a token file that is of no use."""

    def __init__(self, settings: Settings, base: Path, open_paths: Collection[str] = ()) -> None:
        """`open_paths` need no token: enough to ask for it, telling nothing about the gateway."""
        self._loopback = settings.on_loopback
        self._open = {"/api/login", *open_paths}
        self.allow_changes = settings.allow_changes
        self._token = _read(base / settings.token_file) if settings.token_file else ""
        self._certificates = settings.tls_client_ca is not None
        self.tls = _tls(settings, base)
        """None: served without"""
        self._guesses: Counter[str] = Counter()
        """wrong tokens whose answers wait, by address"""
        self.secret = secrets.token_urlsafe(24)
        """against cross-site requests; told to the page alone"""

    @property
    def cookie(self) -> str:
        """What a browser keeps instead of the token itself."""
        return hmac.new(self._token.encode(), b"edge-daemon page", hashlib.sha256).hexdigest()

    @web.middleware
    async def middleware(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse what may not pass, with one line that says why."""
        if self._loopback and _host(request) not in LOOPBACK_HOSTS:
            raise web.HTTPForbidden(text="this page answers to localhost only\n")
        if request.path.startswith("/api/") and request.headers.get("Sec-Fetch-Site", "none") not in OWN_SITE:
            raise web.HTTPForbidden(text="requests from other sites are refused\n")
        if self._token and request.path not in self._open and not await self._admitted(request):
            raise web.HTTPUnauthorized(text="a token is needed: Authorization: Bearer TOKEN, or open / and type it\n")
        if self._certificates and not self._token and not certified(request):
            raise web.HTTPForbidden(text="a client certificate is needed\n")
        if request.method == "POST" and request.path != "/api/login":
            self._check_origin(request)
        return await handler(request)

    def _check_origin(self, request: web.Request) -> None:
        if not _same(request.headers.get(HEADER, ""), self.secret):
            raise web.HTTPForbidden(text=f"header {HEADER}: missing or old: load the page again\n")
        expected = "application/octet-stream" if request.path == UPLOAD else "application/json"
        if request.content_type != expected:
            raise web.HTTPUnsupportedMediaType(text=f"expected {expected}\n")

    def _known(self, request: web.Request) -> bool:
        if self._certificates and certified(request):
            return True
        given = request.headers.get("Authorization", "").removeprefix("Bearer ")
        return _same(given, self._token) or _same(request.cookies.get(COOKIE, ""), self.cookie)

    async def _admitted(self, request: web.Request) -> bool:
        """Whether a request brings the token or a certificate; of one that brings a wrong token the answer waits."""
        if "Authorization" not in request.headers and COOKIE not in request.cookies:
            return self._known(request)
        return await self._weighed(request, lambda: self._known(request))

    async def _weighed(self, request: web.Request, check: Callable[[], bool]) -> bool:
        """A check that a guess does not pass sooner by being many: while some of an address wait, others are not even
        looked at."""
        address = str(request.remote)
        if self._guesses[address] >= GUESSES_AT_ONCE:
            raise web.HTTPTooManyRequests(text="too many wrong tokens: try again in a second\n")
        if check():
            return True
        self._guesses[address] += 1
        if self._guesses[address] == GUESSES_AT_ONCE:
            log.warning("page: wrong tokens from %s", address)
        try:
            await asyncio.sleep(GUESS_COSTS_S)
        finally:
            self._guesses[address] -= 1
            if not self._guesses[address]:
                del self._guesses[address]
        return False

    async def log_in(self, request: web.Request, token: str) -> web.Response:
        """The answer to a typed token: a cookie that scripts cannot read, or a refusal."""
        if not self._token or not await self._weighed(request, lambda: _same(token, self._token)):
            raise web.HTTPForbidden(text="this is not the token\n")
        answer = web.json_response({"ok": True})
        secure = self.tls is not None
        answer.set_cookie(COOKIE, self.cookie, httponly=True, samesite="Strict", path="/", secure=secure)
        return answer

    def require_changes(self) -> None:
        """Raises 403 where the configuration does not allow changes."""
        if not self.allow_changes:
            raise web.HTTPForbidden(text="changes are off: [dashboard] allow_changes = true allows them\n")


def certified(request: web.Request) -> str:
    """Common name of the client certificate that TLS has verified; "?" where it has none, "" without a certificate."""
    found = request.transport.get_extra_info("peercert") if request.transport else None
    if not found:
        return ""
    return next((value for part in found.get("subject", ()) for key, value in part if key == "commonName"), "?")


def _tls(settings: Settings, base: Path) -> ssl.SSLContext | None:
    """What the listener wraps its connections in. Raises `BadInput` for files that are of no use."""
    if settings.tls_certificate is None or settings.tls_key is None:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    certificate, key = base / settings.tls_certificate, base / settings.tls_key
    try:
        context.load_cert_chain(certificate, key, password=lambda: b"")
    except (OSError, ValueError) as error:
        raise BadInput(f"{certificate}, {key}: cannot use as the page's certificate and key: {_why(error)}") from error
    if settings.tls_client_ca is not None:
        authority = base / settings.tls_client_ca
        try:
            context.load_verify_locations(authority)
        except (OSError, ValueError) as error:
            raise BadInput(f"{authority}: cannot use as authority of client certificates: {_why(error)}") from error
        context.verify_mode = ssl.CERT_OPTIONAL if settings.token_file else ssl.CERT_REQUIRED
    return context


def _why(error: Exception) -> str:
    reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or str(error)
    return str(reason).lower().replace("_", " ")


def _read(file: Path) -> str:
    try:
        token = file.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{file}: cannot read the page's token: {error}") from error
    if len(token) < SHORTEST_TOKEN:
        raise BadInput(f"{file}: the page's token: {len(token)} characters: expected at least {SHORTEST_TOKEN}")
    return token


def _host(request: web.Request) -> str:
    host = request.headers.get("Host", "")
    return host[: host.index("]") + 1] if host.startswith("[") and "]" in host else host.partition(":")[0]


def _same(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "surrogateescape"), wanted.encode())
