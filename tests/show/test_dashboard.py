"""The page as a browser and as an attacker meet it."""

from __future__ import annotations

import asyncio
import json
import math
import re
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import aiohttp
import pytest

from edge_daemon.config.settings import DashboardSettings as Settings
from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import NE107, Estimate, Event, GatewayState, LinkHealth, Snapshot, SourceHealth, Status
from edge_daemon.service.supervisor import TaskHealth
from edge_daemon.show import charts
from edge_daemon.show.dashboard import FILES, DashboardServer, health
from edge_daemon.show.feed import overview
from edge_daemon.show.page import rounded

pytestmark = pytest.mark.timeout(30)


def state(
    *, now_s: float = 100.0, drive_state: NE107 = NE107.OK, source: str = "ok", message: str = "started"
) -> GatewayState:
    rows = {
        "stiffness": Estimate("stiffness", 31_234.56, 12.34, "N m/rad", Status.VALID, 99.0),
        "damping": Estimate("damping", math.nan, math.nan, "N m s/rad", Status.INVALID, math.nan),
    }
    return GatewayState(
        site="hall-2", gateway="gw-1", version="0.1.0", started_s=10.0, now_s=now_s,
        snapshots={"left": Snapshot("left", 42, 99.5, drive_state, ("stiffness fell",) if drive_state else (), rows)},
        sources=(SourceHealth("can0", source, "bus off" if source == "down" else "", 99.0, {"readings": 1000}),),
        tasks=(TaskHealth("drive left", "running", 0, ""),),
        events=(Event("left", 50.0, NE107.OK, "daemon", message),),
        links=(LinkHealth("zenoh", "off", "", {}),),
    )  # fmt: skip


class Site:
    def __init__(self, session: aiohttp.ClientSession, port: int) -> None:
        self.session = session
        self.port = port

    async def get(self, path: str, method: str = "GET") -> tuple[int, str, aiohttp.typedefs.LooseHeaders]:
        async with self.session.request(method, f"http://127.0.0.1:{self.port}{path}") as answer:
            return answer.status, await answer.text(), dict(answer.headers)


@asynccontextmanager
async def serving(current: GatewayState | None = None) -> AsyncIterator[Site]:
    page = DashboardServer(
        Settings(port=0), lambda: current or state(), lambda now: f"drives {len(now.snapshots)}\n".encode()
    )
    port = await page.start()
    try:
        async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=5.0)) as session:
            yield Site(session, port)
    finally:
        await page.stop()


class Texts(HTMLParser):
    """data-name -> text, and every address the page loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: dict[str, str] = {}
        self.loads: list[str] = []
        self.layout = ""
        self._name: str | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        fields = dict(attrs)
        self._name = fields.get("data-name")
        if self._name is not None:
            self.found[self._name] = ""
        self.layout = fields.get("data-layout") or self.layout
        self.loads += [value for name in ("src", "href") if tag != "a" and (value := fields.get(name))]

    def handle_data(self, data: str) -> None:
        if self._name is not None:
            self.found[self._name] += data

    def handle_endtag(self, tag: str) -> None:
        self._name = None


async def test_the_page_shows_each_estimate_with_its_sd_and_status() -> None:
    async with serving() as site:
        status, text, _ = await site.get("/status")
    page = Texts(text)
    assert status == 200
    row = [page.found[f"drive.left.stiffness.{part}"] for part in ("value", "sd", "unit", "status")]
    assert row == ["31235", "12", "N m/rad", "valid"]
    assert page.found["drive.left.damping.value"] == "–"
    assert page.found["drive.left.damping.status"] == "invalid"
    assert page.found["drive.left.ratio.status"] == "unknown"
    assert all(f"drive.left.{name}.value" in page.found for name in QUANTITIES)
    assert page.found["drive.left.state"] == "ok"
    assert page.found["source.can0.state"] == "ok"
    assert page.found["event.0.message"] == "started"


async def test_the_script_finds_every_text_of_the_page_and_loads_again_only_when_rows_change() -> None:
    async with serving() as site:
        page = Texts((await site.get("/status"))[1])
        _, text, _ = await site.get("/api/state")
    answer = json.loads(text)
    assert {name: shown for name, (shown, _) in answer["page"]["texts"].items()} == page.found
    assert answer["page"]["layout"] == page.layout
    async with serving(state(message="another text")) as site:
        assert Texts((await site.get("/status"))[1]).layout == page.layout
    async with serving(GatewayState("s", "g", "1", 0.0, 1.0, {}, (), (), (), ())) as site:
        assert Texts((await site.get("/status"))[1]).layout != page.layout


async def test_api_state_is_json_with_null_for_what_is_not_known() -> None:
    async with serving(state(drive_state=NE107.MAINTENANCE_REQUIRED)) as site:
        _, text, headers = await site.get("/api/state")
    assert "NaN" not in text and "Infinity" not in text
    answer = json.loads(text)
    left = answer["drives"]["left"]
    assert left["state"] == "maintenance_required" and left["reasons"] == ["stiffness fell"]
    assert left["estimates"]["damping"]["value"] is None
    assert left["estimates"]["stiffness"]["sd"] == 12.34
    assert headers["Content-Type"].startswith("application/json")


@pytest.mark.parametrize(("up_s", "told", "rank"), [(1.0, "starting", 0), (60.0, "no data", 5)])
def test_a_gateway_that_has_just_begun_raises_no_alarm_for_data_that_cannot_be_there_yet(
    up_s: float, told: str, rank: int
) -> None:
    new = Snapshot("left", 0, math.nan, NE107.OK, (), {})
    row = overview(replace(state(now_s=10.0 + up_s), snapshots={"left": new}), 5.0)["drives"][0]
    assert (row["state"], row["rank"]) == (told, rank)


async def test_stale_data_is_not_shown_as_if_it_were_current() -> None:
    async with serving(state(now_s=200.0)) as site:
        page = Texts((await site.get("/status"))[1])
    assert page.found["drive.left.stiffness.value"] == "–"
    assert page.found["drive.left.stiffness.status"] == "stale"
    assert page.found["drive.left.state"].startswith("no data for 100 s")


async def test_text_from_outside_cannot_become_markup() -> None:
    hostile = '<script>alert(1)</script>" onload="x'
    async with serving(state(message=hostile)) as site:
        _, text, _ = await site.get("/status")
    assert "<script>alert" not in text
    assert Texts(text).found["event.0.message"] == hostile


async def test_the_page_loads_nothing_from_elsewhere_and_its_policy_forbids_it() -> None:
    async with serving() as site:
        _, text, headers = await site.get("/status")
        page = Texts(text)
        assert page.loads == ["/page.css", "/page.js"]
        for path, kind in (("/page.css", "text/css"), ("/page.js", "text/javascript")):
            status, body, file_headers = await site.get(path)
            assert status == 200 and file_headers["Content-Type"].startswith(kind)
            assert not re.search(r"https?://", body)
    policy = dict(part.strip().partition(" ")[::2] for part in headers["Content-Security-Policy"].split(";"))
    assert policy["default-src"] == "'none'" and policy["script-src"] == "'self'" and "unsafe" not in str(policy)
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert "style=" not in text and "<script>" not in text


@pytest.mark.parametrize("path", [
    "/../pyproject.toml", "/%2e%2e/pyproject.toml", "/..%2f..%2fetc/passwd", "/page.js/../page.py", "/page.py",
    "//etc/passwd",
])  # fmt: skip
async def test_no_path_leads_to_a_file_that_is_not_the_pages_own(path: str) -> None:
    """Bytes on a socket: a client library would tidy the path first."""
    async with serving() as site:
        reader, writer = await asyncio.open_connection("127.0.0.1", site.port)
        writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
        answer = await asyncio.wait_for(reader.read(), 5.0)
        writer.close()
    assert answer.startswith((b"HTTP/1.1 404", b"HTTP/1.1 400")), answer[:200]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
async def test_nothing_can_be_changed(method: str) -> None:
    async with serving() as site:
        found = [(await site.get(path, method))[0] for path in ("/", "/status", "/api/state", "/metrics", "/health")]
    assert set(found) == ({403} if method == "POST" else {405})


async def test_metrics_are_those_of_the_current_state() -> None:
    async with serving() as site:
        status, text, headers = await site.get("/metrics")
    assert (status, text) == (200, "drives 1\n")
    assert headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"


@pytest.mark.parametrize(
    ("current", "status", "problem"),
    [
        (state(), 200, None),
        (state(drive_state=NE107.MAINTENANCE_REQUIRED), 200, None),
        (state(drive_state=NE107.FAILURE), 503, "drive left: stiffness fell"),
        (state(source="down"), 503, "source can0: bus off"),
        (state(now_s=200.0), 503, "drive left: no data"),
        (GatewayState("s", "g", "1", 0.0, 1.0, {}, (), (), (), ()), 503, "no drive has been processed yet"),
    ],
)
async def test_health_tells_a_load_balancer_whether_the_gateway_does_its_job(
    current: GatewayState, status: int, problem: str | None
) -> None:
    assert health(current) == ([problem] if problem else [])
    async with serving(current) as site:
        assert (await site.get("/health"))[0] == status


def test_a_wheel_carries_every_file_that_the_page_serves() -> None:
    package = Path(charts.__file__).parent.parent
    project = tomllib.loads((package.parent / "pyproject.toml").read_text())
    patterns = project["tool"]["setuptools"]["package-data"]["edge_daemon"]
    carried = {path for pattern in patterns for path in package.glob(pattern)}
    served = {package / "show" / name for name, _ in FILES.values()}
    if (charts.folder() / "version").exists():
        served |= {charts.folder() / name for name, _ in charts.FILES.values()}
    assert served <= carried and all(path.is_file() for path in served)


async def test_an_address_in_use_is_an_error_that_names_it() -> None:
    async with serving() as site:
        with pytest.raises(
            OSError, match=f"cannot listen on 127.0.0.1:{site.port}: Address already in use: another program"
        ):
            await DashboardServer(Settings(port=site.port), state).start()


@pytest.mark.parametrize(
    ("value", "sd", "shown"),
    [
        (31_234.56, 12.34, ("31235", "12")), (100.0, 0.0, ("100", "0")), (0.05123, 0.00042, ("0.05123", "0.00042")),
        (1.5e-7, 2.0e-9, ("1.500e-07", "2.0e-09")), (12_345.0, 400.0, ("12340", "400")), (0.0, 0.5, ("0.00", "0.50")),
        (3.2e9, 1.0e7, ("3.200e+09", "1.0e+07")), (-8.7e-5, 0.025, ("0.000", "0.025")),
        (-4.2e-7, 1.2e-6, ("-4e-07", "1.2e-06")), (5e-4, 2e-3, ("0.0005", "0.0020")),
    ],
)  # fmt: skip
def test_values_are_shown_to_two_digits_of_their_sd(value: float, sd: float, shown: tuple[str, str]) -> None:
    assert rounded(value, sd) == shown
