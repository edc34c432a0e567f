"""Who may read and change what: the page's door as an attacker meets it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from yarl import URL

from edge_daemon.config.reading import load
from edge_daemon.config.settings import DashboardSettings as Settings
from edge_daemon.config.settings import SettingsError
from edge_daemon.errors import BadInput
from edge_daemon.records import NE107, Event, GatewayState, Snapshot
from edge_daemon.service.model_versions import change_version, versions
from edge_daemon.show.dashboard import DashboardServer
from edge_daemon.show.guard import HEADER
from edge_daemon.show.page_api import PageApi

pytestmark = pytest.mark.timeout(240)
TOKEN = "a-token-of-sufficient-length"
MODEL = (
    '[joint]\nbalance = "torsion"\nratio = 100.0\noutput_inertia_kg_m2 = 0.05\n[[effect]]\nname = "linear_stiffness"\n'
    '[[effect]]\nname = "viscous_damping"\n'
)


class Door:
    """One served page over a folder of its own, and requests to it."""

    def __init__(self, session: aiohttp.ClientSession, port: int, folder: Path) -> None:
        self.session, self.port, self.folder = session, port, folder
        self.acknowledged: list[tuple[str, str | None, str]] = []
        self.pages: Callable[[], int] = lambda: 0

    async def get(self, path: str, **headers: str) -> int:
        async with self.session.get(f"http://127.0.0.1:{self.port}{path}", headers=headers) as answer:
            return answer.status

    async def post(self, path: str, body: Any, **headers: str) -> tuple[int, str]:
        url = f"http://127.0.0.1:{self.port}{path}"
        async with self.session.post(url, json=body, headers=headers) as answer:
            return answer.status, await answer.text()

    async def secret(self) -> dict[str, str]:
        async with self.session.get(f"http://127.0.0.1:{self.port}/api/session") as answer:
            return {HEADER: (await answer.json())["secret"]}


@asynccontextmanager
async def door(folder: Path, **settings: Any) -> AsyncIterator[Door]:
    (folder / "m.toml").write_text(MODEL)
    snapshot = Snapshot("left", 1, 99.5, NE107.OK, (), {})
    state = GatewayState("s", "g", "1", 0.0, 100.0, {"left": snapshot}, (), (), (), ())
    opened: list[Door] = []

    def acknowledge(drive: str, alarm: str | None, who: str) -> int:
        opened[0].acknowledged.append((drive, alarm, who))
        return 1

    page_api = PageApi(
        drive_view=lambda _: None,
        what_if=lambda drive, factor: {"factor": factor},
        history=lambda drive, query: [
            {"name": "stiffness", "time_s": 1.0, "value": float("nan"), "sd": 1.0, "asked": query}
        ],
        trend=lambda drive, query: {"time_s": [], "value": {}, "sd": {}},
        newest_s=lambda: 100.0,
        events=lambda limit: [Event("left", 50.0, NE107.OK, "daemon", "begun")],
        acknowledge=acknowledge,
        model_file=lambda drive: folder / "m.toml" if drive == "left" else None,
        folder=folder,
        store=folder / "none.sqlite",
        versions=versions,
        change_version=change_version,
    )
    page = DashboardServer(Settings(port=0, **settings), lambda: state, None, page_api)
    port = await page.start()
    try:
        jar = aiohttp.CookieJar(unsafe=True)
        async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=10), cookie_jar=jar) as session:
            opened.append(Door(session, port, folder))
            opened[0].pages = lambda: page.open_pages
            yield opened[0]
    finally:
        await page.stop()


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "", "[::2]"])
async def test_a_name_that_points_here_does_not_open_the_page(tmp_path: Path, host: str) -> None:
    async with door(tmp_path) as site:
        assert await site.get("/api/state", Host=host) in (400, 403)
        assert await site.get("/api/state", Host="localhost:9999") == 200


async def test_nothing_is_started_without_the_pages_own_secret(tmp_path: Path) -> None:
    body = {"drive": "left"}
    async with door(tmp_path, allow_changes=True) as site:
        secret = await site.secret()
        assert (await site.post("/api/acknowledge", body))[0] == 403
        assert (await site.post("/api/acknowledge", body, **{HEADER: "guess"}))[0] == 403
        assert (await site.post("/api/acknowledge", body, **secret, **{"Sec-Fetch-Site": "cross-site"}))[0] == 403
        url = f"http://127.0.0.1:{site.port}/api/acknowledge"
        async with site.session.post(url, data={"drive": "left"}, headers=secret) as form:
            assert form.status == 415
        assert site.acknowledged == []
        assert (await site.post("/api/acknowledge", body, **secret))[0] == 200
        assert site.acknowledged == [("left", None, "someone at the page")]


async def test_changes_are_off_unless_allowed(tmp_path: Path) -> None:
    before = MODEL
    async with door(tmp_path) as site:
        secret = await site.secret()
        for path in ("/api/add", "/api/version", "/api/acknowledge"):
            status, text = await site.post(path, {"drive": "left", "effect": "coulomb_friction"}, **secret)
            assert status == 403 and "allow_changes" in text
        assert site.acknowledged == []
    assert (tmp_path / "m.toml").read_text() == before


async def test_beyond_loopback_a_token_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "token").write_text(TOKEN + "\n")
    async with door(tmp_path, host="0.0.0.0", token_file="token") as site:
        closed = (
            "/api/state",
            "/api/session",
            "/api/live",
            "/api/history?drive=left",
            "/metrics",
            "/status",
            "/health",
        )
        assert [await site.get(path) for path in closed] == [401] * len(closed)
        assert (await site.post("/api/look", {"drive": "left"}))[0] == 401
        assert await site.get("/") == await site.get("/app.js") == 200
        assert await site.get("/api/state", Authorization="Bearer wrong") == 401
        assert await site.get("/api/state", Authorization=f"Bearer {TOKEN}") == 200
        assert (await site.post("/api/login", {"token": "wrong"}))[0] == 403
        assert (await site.post("/api/login", {"token": TOKEN}))[0] == 200
        assert await site.get("/api/state") == 200, "the cookie opens what the token opened"
        cookie = next(iter(site.session.cookie_jar))
        assert cookie["httponly"] and cookie["samesite"] == "Strict" and TOKEN not in cookie.value


def test_a_page_beyond_loopback_without_a_token_is_not_a_configuration(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(
        '[dashboard]\nhost = "0.0.0.0"\n[[drive]]\nname = "a"\nmodbus_device_id = 1\nmodel = "m"\nchannels = []\n'
    )
    with pytest.raises(SettingsError, match=r"dashboard.token_file: missing"):
        load(file)


@pytest.mark.parametrize("text", ["", "short", None])
def test_a_token_that_can_be_guessed_is_refused(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / "token").write_text(text)
    with pytest.raises(BadInput, match="token"):
        DashboardServer(Settings(host="0.0.0.0", token_file=str(tmp_path / "token")), lambda: None)  # type: ignore[arg-type,return-value]


@pytest.mark.parametrize(
    "body",
    [
        {"drive": "left", "recording": "../../etc/passwd"},
        {"drive": "left", "recording": "/etc/passwd"},
        {"drive": "left", "recording": "m.toml"},
        {"drive": "left", "recording": ["a.csv"]},
        {"drive": "left", "seconds": "5; rm -rf /"},
        {"drive": "left", "seconds": 1e9},
        {"drive": "left", "seconds": float("nan")},
        {"drive": "../left"},
        {"drive": None},
        [],
    ],
)
async def test_no_request_reaches_a_file_that_is_not_offered(tmp_path: Path, body: Any) -> None:
    async with door(tmp_path) as site:
        status, text = await site.post("/api/look", body, **await site.secret())
        assert status == 400 and text.count("\n") == 1


@pytest.mark.slow
async def test_a_name_or_a_formula_never_becomes_an_option_or_code(tmp_path: Path) -> None:
    """The formula goes to a child as one argument, and its evaluator knows no names but channels and parameters."""
    from edge_daemon.cli import main

    assert main(["simulate", "--out", str(tmp_path / "r.csv"), "--seconds", "10"]) == 0
    async with door(tmp_path, allow_changes=True) as site:
        secret = await site.secret()
        assert (await site.post("/api/look", {"drive": "left", "recording": "r.csv"}, **secret))[0] == 200
        assert not (await _ended(site))["error"]
        for effect in ("--write", "a b", "A", "a;b", "", "../x", "a" * 200):
            assert (await site.post("/api/try", {"drive": "left", "effect": effect}, **secret))[0] == 400
        for formula in ("__import__('os').system('touch hacked')", "().__class__", "a * exec('1')"):
            body = {"drive": "left", "effect": "mine", "expression": formula}
            assert (await site.post("/api/try", body, **secret))[0] == 200
            assert (await _ended(site))["error"], formula
        assert (await site.post("/api/try", {**body, "expression": "a" * 9999}, **secret))[0] in (400, 413)
    assert (tmp_path / "m.toml").read_text() == MODEL and not (tmp_path / "hacked").exists()


@pytest.mark.slow
async def test_an_added_effect_can_be_taken_back_to_the_byte(tmp_path: Path) -> None:
    from edge_daemon.cli import main

    arguments = ["simulate", "--effect", "coulomb_friction", "--out", str(tmp_path / "r.csv"), "--seconds", "10"]
    assert main(arguments) == 0
    async with door(tmp_path, allow_changes=True) as site:
        secret = await site.secret()
        assert (await site.post("/api/add", {"drive": "left", "effect": "coulomb_friction"}, **secret))[0] == 400
        await site.post("/api/look", {"drive": "left", "recording": "r.csv"}, **secret)
        assert (await site.post("/api/look", {"drive": "left"}, **secret))[0] == 400, "one at a time"
        await _ended(site)
        assert (await site.post("/api/report", {"drive": "left"}, **secret))[0] == 200
        assert await site.get("/api/report") == 404, "not before it is made"
        assert not (await _ended(site))["error"]
        async with site.session.get(f"http://127.0.0.1:{site.port}/api/report") as answer:
            page = await answer.text()
            assert answer.headers["Content-Disposition"] == 'attachment; filename="left-report.html"'
        assert page.count("<svg") >= 3 and "m.toml against r.csv" in page and "Missing: " in page
        await site.post("/api/add", {"drive": "left", "effect": "coulomb_friction"}, **secret)
        assert not (await _ended(site))["error"]
        assert "coulomb_friction" in (tmp_path / "m.toml").read_text()
        assert (await site.post("/api/between", {"drive": "left", "versions": ["now", "x"]}, **secret))[0] == 400
        assert (await site.post("/api/version", {"drive": "left", "do": "undo"}, **secret))[0] == 200
        assert (tmp_path / "m.toml").read_text() == MODEL
        status, text = await site.post("/api/version", {"drive": "left", "do": "undo"}, **secret)
        assert status == 400 and "nothing to undo" in text


async def _ended(site: Door) -> dict[str, Any]:
    """The job's last status, asked for as the page does."""
    async with asyncio.timeout(200):
        while True:
            async with site.session.get(f"http://127.0.0.1:{site.port}/api/job") as answer:
                job: dict[str, Any] = (await answer.json())["job"]
            if not job["running"]:
                return job
            await asyncio.sleep(0.05)


async def test_a_page_that_stops_reading_is_dropped_and_slows_nobody(tmp_path: Path, monkeypatch: Any) -> None:
    """Bytes on a socket that is never read: the daemon's buffer stays bounded and the page is let go."""
    monkeypatch.setattr("edge_daemon.show.feed.EVERY_S", 0.0)
    monkeypatch.setattr("edge_daemon.show.feed.STALLED_S", 0.2)
    monkeypatch.setattr("edge_daemon.show.feed.text_of", lambda _: "x" * 200_000)
    async with door(tmp_path) as site:
        _, writer = await asyncio.open_connection("127.0.0.1", site.port, limit=1)
        writer.write(b"GET /api/live HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert await _pages(site, 1) and await site.get("/health") == 200
        assert await _pages(site, 0), "a page that takes nothing is let go"
        writer.close()


async def _pages(site: Door, count: int) -> bool:
    for _ in range(3000):
        if site.pages() == count:
            return True
        await asyncio.sleep(0.01)
    return False


async def test_what_is_not_a_number_reaches_the_page_as_null(tmp_path: Path) -> None:
    async with (
        door(tmp_path) as site,
        site.session.get(f"http://127.0.0.1:{site.port}/api/history?drive=left") as found,
    ):
        (row,) = (await found.json())["rows"]
        assert row["value"] is None and row["asked"] == {}, "the drive is no parameter of the question"
        assert await site.get("/api/history?drive=other") == 404
        assert await site.get("/api/what-if?drive=left&factor=x") == 400


async def test_an_upload_needs_permission_the_secret_and_its_own_type(tmp_path: Path) -> None:
    body = b"time_s,theta_in_rad\n0,0\n"
    stream = {"Content-Type": "application/octet-stream"}
    async with door(tmp_path) as site:
        secret = await site.secret()
        assert await _upload(site, "a.csv", body, **secret, **stream) == 403, "changes are off"
    async with door(tmp_path, allow_changes=True) as site:
        secret = await site.secret()
        assert await _upload(site, "a.csv", body, **stream) == 403
        assert await _upload(site, "a.csv", body, **secret, **{"Content-Type": "text/csv"}) == 415
        assert await _upload(site, "..%2Fa.csv", body, **secret, **stream) == 400
        assert await _upload(site, "m.csv", b"none", **secret, **stream) == 400
        (tmp_path / "own.csv").write_bytes(body)
        assert await _upload(site, "own.csv", body, **secret, **stream) == 400, "the gateway's own stay as they are"
        assert await _upload(site, "a.csv", body, **secret, **stream) == 200
        async with site.session.get(f"http://127.0.0.1:{site.port}/api/bench?drive=left") as answer:
            assert (await answer.json())["recordings"] == ["a.csv", "own.csv"]
        promised = {"Content-Length": str(2**40)}
        assert await _upload(site, "b.csv", b"", **secret, **stream, **promised) == 400, "too large before it arrives"
    assert (tmp_path / "uploads" / "a.csv").read_bytes() == body


async def _upload(site: Door, name: str, body: bytes, **headers: str) -> int:
    url = URL(f"http://127.0.0.1:{site.port}/api/upload?name={name}", encoded=True)
    async with site.session.post(url, data=body, headers=headers) as answer:
        return answer.status


async def test_one_alarm_is_acknowledged_by_a_printable_name(tmp_path: Path) -> None:
    async with door(tmp_path, allow_changes=True) as site:
        secret = await site.secret()
        body = {"drive": "left", "alarm": "life", "who": " Ida "}
        assert (await site.post("/api/acknowledge", body, **secret))[0] == 200
        assert site.acknowledged == [("left", "life", "Ida")]
        for bad in ({"who": "x" * 41}, {"who": "a\nb"}, {"who": 5}, {"alarm": 5}):
            assert (await site.post("/api/acknowledge", {**body, **bad}, **secret))[0] == 400
        assert len(site.acknowledged) == 1


async def test_half_sent_requests_do_not_keep_others_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three times as many as there are seats; a good reader gets in all the same, and they lose their seats."""
    monkeypatch.setattr("edge_daemon.show.seats.SEATS", 20)
    monkeypatch.setattr("edge_daemon.show.seats.ASKS_WITHIN_S", 0.3)
    async with door(tmp_path) as site:
        held = []
        for _ in range(60):
            reader, writer = await asyncio.open_connection("127.0.0.1", site.port)
            writer.write(b"GET /status HTTP/1.1\r\nHost: localhost\r\n")
            held.append((reader, writer))
        assert await site.get("/api/state") == 200
        ended = await asyncio.wait_for(asyncio.gather(*(_hung_up(reader) for reader, _ in held)), 10.0)
        assert all(ended)
        for _, writer in held:
            writer.close()


async def _hung_up(reader: asyncio.StreamReader) -> bool:
    with contextlib.suppress(ConnectionError):
        return await reader.read() == b""
    return True


async def test_a_body_that_trickles_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge_daemon.show.seats.UPLOAD_WITHIN_S", 0.2)
    async with door(tmp_path, allow_changes=True) as site:
        secret = await site.secret()
        lines = [f"{name}: {value}" for name, value in secret.items()]
        head = ["POST /api/upload?name=a.csv HTTP/1.1", "Host: localhost", "Content-Type: application/octet-stream"]
        reader, writer = await asyncio.open_connection("127.0.0.1", site.port)
        writer.write("\r\n".join([*head, *lines, "Content-Length: 1000", "", "time_s"]).encode())
        assert b" 408 " in await asyncio.wait_for(reader.readline(), 10.0)
        writer.close()


@pytest.mark.parametrize("value", ["\xff\xfe", "Bearer \u00e9"])
async def test_bytes_above_127_in_a_header_are_a_refusal(tmp_path: Path, value: str) -> None:
    (tmp_path / "token").write_text("a-token-of-sixteen-characters")
    async with door(tmp_path, token_file=str(tmp_path / "token")) as site:
        reader, writer = await asyncio.open_connection("127.0.0.1", site.port)
        writer.write(f"GET /api/state HTTP/1.1\r\nHost: localhost\r\nAuthorization: {value}\r\n\r\n".encode("latin-1"))
        assert (await asyncio.wait_for(reader.readline(), 10.0)).split()[1] in (b"400", b"401")
        writer.close()


@pytest.mark.parametrize(
    "query", ["/api/what-if?drive=left&factor=" + "9" * 400, "/api/history?drive=left&since_s=-1e308"]
)
async def test_numbers_beyond_all_sense_are_bad_requests(tmp_path: Path, query: str) -> None:
    async with door(tmp_path) as site:
        assert await site.get(query) in (200, 400)


async def test_brackets_without_end_are_a_bad_request(tmp_path: Path) -> None:
    async with door(tmp_path, allow_changes=True) as site:
        url, headers = f"http://127.0.0.1:{site.port}/api/acknowledge", await site.secret()
        headers["Content-Type"] = "application/json"
        async with site.session.post(url, data=b"[" * 3000, headers=headers) as answer:
            assert answer.status == 400


async def test_the_live_stream_is_not_for_other_sites(tmp_path: Path) -> None:
    async with door(tmp_path) as site:
        assert await site.get("/api/live", **{"Sec-Fetch-Site": "cross-site"}) == 403


async def test_wrong_tokens_cost_time_and_the_right_one_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edge_daemon.show.guard.GUESS_COSTS_S", 0.3)
    (tmp_path / "token").write_text("a-token-of-sixteen-characters")
    async with door(tmp_path, token_file=str(tmp_path / "token")) as site:
        asked = asyncio.get_running_loop().time()
        codes = await asyncio.gather(*(site.get("/api/state", Authorization="Bearer wrong") for _ in range(12)))
        assert asyncio.get_running_loop().time() - asked >= 0.3
        assert sorted(codes)[:3] == [401, 401, 401] and set(codes[3:]) <= {401, 429} and 429 in codes
        assert await site.get("/api/state", Authorization="Bearer a-token-of-sixteen-characters") == 200
