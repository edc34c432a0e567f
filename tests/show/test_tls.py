"""The page over TLS: who gets in with which certificate. The authority is made here and thrown away."""

from __future__ import annotations

import shutil
import ssl
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from edge_daemon.config.reading import SettingsError, load
from edge_daemon.config.settings import DashboardSettings as Settings
from edge_daemon.errors import BadInput
from edge_daemon.records import NE107, GatewayState, Snapshot
from edge_daemon.show.dashboard import DashboardServer
from edge_daemon.show.page_api import PageApi

pytestmark = [
    pytest.mark.timeout(60),
    pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl"),
]
TOKEN = "a-token-of-sufficient-length"
TLS = {"tls_certificate": "server.pem", "tls_key": "server.key"}


def openssl(folder: Path, name: str, subject: str, *more: str) -> None:
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-keyout", f"{name}.key", "-out", f"{name}.pem", "-days", "2", "-subj", f"/CN={subject}", *more]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=20)


@pytest.fixture(scope="module")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority with a server and a person, and a person of another authority."""
    folder = tmp_path_factory.mktemp("pki")
    for authority in ("ca", "other"):
        openssl(folder, authority, authority)
    server = ["-addext", "subjectAltName=IP:127.0.0.1"]
    leaf = ["-addext", "basicConstraints=critical,CA:false"]
    openssl(folder, "server", "127.0.0.1", "-CA", "ca.pem", "-CAkey", "ca.key", *server, *leaf)
    openssl(folder, "ida", "Ida", "-CA", "ca.pem", "-CAkey", "ca.key", *leaf)
    openssl(folder, "eve", "Eve", "-CA", "other.pem", "-CAkey", "other.key", *leaf)
    (folder / "token").write_text(TOKEN)
    return folder


class Visitor:
    """Requests to one page, with or without a certificate."""

    def __init__(self, pki: Path, port: int, acknowledged: list[str]) -> None:
        self.pki, self.port, self.acknowledged = pki, port, acknowledged

    def context(self, person: str | None) -> ssl.SSLContext:
        context = ssl.create_default_context(cafile=str(self.pki / "ca.pem"))
        if person:
            context.load_cert_chain(self.pki / f"{person}.pem", self.pki / f"{person}.key")
        return context

    async def get(self, path: str, person: str | None = None, scheme: str = "https", **headers: str) -> int | None:
        """The status; None where no connection was granted."""
        url = f"{scheme}://127.0.0.1:{self.port}{path}"
        connector = aiohttp.TCPConnector(ssl=self.context(person))
        async with aiohttp.ClientSession(connector=connector) as session:
            try:
                async with session.get(url, headers=headers) as answer:
                    return answer.status
            except aiohttp.ClientError:
                return None

    async def acknowledge(self, person: str, who: str) -> int:
        url = f"https://127.0.0.1:{self.port}"
        async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(ssl=self.context(person))) as session:
            async with session.get(f"{url}/api/session") as answer:
                found = await answer.json()
            headers = {found["header"]: found["secret"]}
            body = {"drive": "left", "alarm": "life", "who": who}
            async with session.post(f"{url}/api/acknowledge", json=body, headers=headers) as answer:
                return answer.status


@asynccontextmanager
async def served(pki: Path, **settings: Any) -> AsyncIterator[Visitor]:
    state = GatewayState(
        "s", "g", "1", 0.0, 100.0, {"left": Snapshot("left", 1, 99.5, NE107.OK, (), {})}, (), (), (), ()
    )
    acknowledged: list[str] = []

    def acknowledge(drive: str, alarm: str | None, who: str) -> int:
        acknowledged.append(f"{drive}/{alarm} by {who}")
        return 1

    page_api = PageApi(
        drive_view=lambda _: None, what_if=lambda drive, factor: {}, history=lambda drive, query: [],
        trend=lambda drive, query: {}, newest_s=lambda: 0.0, events=lambda limit: [], acknowledge=acknowledge,
        model_file=lambda drive: pki / "m.toml", folder=pki, store=pki / "none.sqlite",
    )  # fmt: skip
    page = DashboardServer(Settings(port=0, **{**TLS, **settings}), lambda: state, None, page_api)
    port = await page.start()
    try:
        yield Visitor(pki, port, acknowledged)
    finally:
        await page.stop()


async def test_with_a_certificate_of_its_own_the_page_is_served_over_tls_alone(pki: Path) -> None:
    async with served(pki) as page:
        assert await page.get("/api/state") == 200
        assert await page.get("/api/state", scheme="http") is None


async def test_beyond_loopback_only_a_certificate_of_the_authority_opens_the_page(pki: Path) -> None:
    async with served(pki, host="0.0.0.0", tls_client_ca="ca.pem") as page:
        assert await page.get("/api/state", "ida") == 200
        assert await page.get("/", None) is None, "nothing at all without a certificate"
        assert await page.get("/api/state", "eve") is None


async def test_with_both_either_a_certificate_or_the_token_opens_the_page(pki: Path) -> None:
    async with served(pki, host="0.0.0.0", tls_client_ca="ca.pem", token_file="token") as page:
        assert await page.get("/api/state", "ida") == 200
        assert await page.get("/api/state") == 401
        assert await page.get("/api/state", Authorization=f"Bearer {TOKEN}") == 200
        assert await page.get("/api/state", "eve") is None


async def test_the_name_on_the_certificate_stands_above_the_typed_one(pki: Path) -> None:
    async with served(pki, host="0.0.0.0", tls_client_ca="ca.pem", allow_changes=True) as page:
        assert await page.acknowledge("ida", "somebody else") == 200
        assert page.acknowledged == ["left/life by Ida"]


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"tls_certificate": "none.pem"}, "none.pem"),
        ({"tls_key": "ida.key"}, "certificate and key"),
        ({"tls_certificate": "token"}, "certificate and key"),
        ({"tls_client_ca": "token"}, "authority"),
    ],
)
def test_files_that_are_no_certificates_are_refused_in_one_line(pki: Path, files: dict[str, str], words: str) -> None:
    with pytest.raises(BadInput, match=words) as caught:
        served_settings = Settings(**{**TLS, **files})  # type: ignore[arg-type]
        DashboardServer(served_settings, lambda: None, None, _nothing(pki))  # type: ignore[arg-type,return-value]
    assert "\n" not in str(caught.value)


def _nothing(folder: Path) -> Any:
    return type("Nothing", (), {"folder": folder})()


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ('tls_certificate = "c.pem"', "dashboard.tls_key: missing"),
        ('tls_key = "c.key"', "dashboard.tls_certificate: missing"),
        ('tls_client_ca = "ca.pem"', "dashboard.tls_certificate: missing"),
        ('host = "0.0.0.0"\ntls_certificate = "c.pem"\ntls_key = "c.key"', "dashboard.token_file: missing"),
        ('host = "0.0.0.0"\ntls_certificate = "c.pem"\ntls_key = "c.key"\ntls_client_ca = "ca.pem"', None),
    ],
)
def test_settings_that_do_not_fit_together_are_named(tmp_path: Path, lines: str, problem: str | None) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(f'[dashboard]\n{lines}\n[[drive]]\nname = "a"\nmodbus_device_id = 1\nmodel = "m"\nchannels = []\n')
    if problem is None:
        assert load(file).dashboard.scheme == "https"
        return
    with pytest.raises(SettingsError, match=problem):
        load(file)
