"""A headless Chromium that remembers what it asked for and complained about, and a daemon it can look at."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import tomlkit
from selenium import webdriver
from selenium.common.exceptions import NoSuchElementException, StaleElementReferenceException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

from edge_daemon.demo.gateway import prepare
from edge_daemon.rig.child import RigProcess

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
SCREENSHOTS = Path(__file__).parents[2] / "build" / "screenshots"
WITHIN_S = 45.0
"""bound of a wait on a machine that others use too; an idle one needs a tenth"""
SIZE = "1280,1800"
LAPTOP_PX, PHONE_PX = 1366, 390
LOCAL = ("data", "blob", "chrome", "file")
NOT_READY = (NoSuchElementException, StaleElementReferenceException, IndexError, ValueError, TypeError)


class Browser:
    """`go` to a view, `wait` for what it shows."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver
        self.asked: list[str] = []

    def go(self, port: int, view: str = "") -> None:
        self.driver.get(f"http://127.0.0.1:{port}/#/{view}")
        self.wait("the page", lambda: self.texts("#main > div"))

    def one(self, selector: str) -> WebElement:
        found: WebElement = self.driver.find_element(By.CSS_SELECTOR, selector)
        return found

    def texts(self, selector: str) -> list[str]:
        """What a person reads in each, top to bottom; empty where it is hidden. One question, however many rows."""
        script = """
        const read = (node) => (node.offsetParent ? node.innerText.replace(/[ \\t]+/g, " ").trim() : "");
        return [...document.querySelectorAll(arguments[0])].map(read);"""
        return list(self.driver.execute_script(script, selector))

    def wait(self, what: str, ready: Callable[[], Any], within_s: float = WITHIN_S) -> Any:
        """Until `ready()` is true; an element that is not there yet or was replaced counts as not ready."""
        until = time.monotonic() + within_s
        while time.monotonic() < until:
            with contextlib.suppress(*NOT_READY):
                found = ready()
                if found:
                    return found
            time.sleep(0.05)
        self.shoot(f"failed-{what.replace(' ', '-')}")
        raise AssertionError(f"not within {within_s:.0f} s: {what}\n{self.one('body').text[:2000]}")

    def shoot(self, name: str) -> Path:
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        self.driver.save_screenshot(str(SCREENSHOTS / f"{name}.png"))
        return SCREENSHOTS / f"{name}.png"

    @contextlib.contextmanager
    def seen_as(self, form: str, height_px: int = 900) -> Iterator[None]:
        """As on a `laptop`, on a `phone`, or on a laptop in the `dark`."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if form == "dark" else "light"}
        phone = form == "phone"
        size = {"width": PHONE_PX if phone else LAPTOP_PX, "height": height_px, "deviceScaleFactor": 1, "mobile": phone}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        try:
            yield
        finally:
            self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
            self.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})

    def settle(self) -> None:
        """Until plots are drawn to a new width."""
        self.driver.execute_async_script("setTimeout(arguments[0], 700)")

    def inked(self, plot: str) -> int:
        """How many pixels of a plot's canvas something was drawn on."""
        script = """
        const canvas = document.querySelector(arguments[0] + " canvas");
        if (!canvas || !canvas.width) return 0;
        const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
        copy.drawImage(canvas, 0, 0);
        const pixels = copy.getImageData(0, 0, canvas.width, canvas.height).data;
        let inked = 0;
        for (let i = 3; i < pixels.length; i += 4) if (pixels[i] > 0) inked++;
        return inked;"""
        return int(self.driver.execute_script(script, plot))

    def complaints(self) -> list[str]:
        """What the console said since the last call, connections to a stopped daemon aside."""
        rows = [row["message"] for row in self.driver.get_log("browser") if row["level"] in ("SEVERE", "WARNING")]
        return [row for row in rows if "ERR_CONNECTION_REFUSED" not in row and "ERR_INCOMPLETE_CHUNKED" not in row]

    def hosts(self) -> set[str]:
        """Hosts that anything was asked of since the last call."""
        rows = [json.loads(row["message"])["message"] for row in self.driver.get_log("performance")]
        asked = [row["params"]["request"]["url"] for row in rows if row["method"] == "Network.requestWillBeSent"]
        return {urlsplit(url).hostname or "" for url in asked if urlsplit(url).scheme not in LOCAL}


@contextlib.contextmanager
def browsing() -> Iterator[Browser]:
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for argument in (
        "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", f"--window-size={SIZE}",
        "--disable-background-networking", "--disable-component-update", "--no-first-run",
    ):  # fmt: skip
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    try:
        yield Browser(driver)
    finally:
        driver.quit()


class Gateway:
    """The daemon as a process on a simulated drive; it can be stopped and started again while the drive runs on."""

    def __init__(self, folder: Path, rig: RigProcess) -> None:
        self.folder = folder
        self.truth: dict[str, Any] = rig.ready["drives"][0]["truth"]
        self.file = prepare(folder, rig.ready, 1, free_ports=True)
        document: Any = tomlkit.parse(self.file.read_text())
        document["dashboard"]["allow_changes"] = True
        document["drive"][0]["estimation"]["warm_up_s"] = 1.5
        self.file.write_text(tomlkit.dumps(document))
        self.port = int(document["dashboard"]["port"])
        self.model = folder / "axis.model.toml"
        self.scratch = folder / "scratch"
        self.scratch.mkdir()
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        command = [sys.executable, str(Path(__file__).parent / "page_daemon.py"), str(self.file)]
        with (self.folder / "daemon.log").open("ab") as log:
            self._process = subprocess.Popen(command, stderr=log, env={**os.environ, "TMPDIR": str(self.scratch)})
        until = time.monotonic() + WITHIN_S
        while not self._listens():
            if self._process.poll() is not None or time.monotonic() > until:
                raise AssertionError(f"the daemon does not serve its page: {(self.folder / 'daemon.log').read_text()}")
            time.sleep(0.05)

    def _listens(self) -> bool:
        with socket.socket() as probe:
            probe.settimeout(1.0)
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def stop(self) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.wait(20)
            self._process = None


@contextlib.contextmanager
def gateway(folder: Path) -> Iterator[Gateway]:
    with RigProcess(["--drives", "1"]) as rig:
        found = Gateway(folder, rig)
        found.start()
        try:
            yield found
        finally:
            found.stop()


@contextlib.contextmanager
def fed_page(folder: Path, drives: int, every_s: float = 1.0, token_file: Path | None = None) -> Iterator[int]:
    """The port of a page over an invented gateway (see `fed_page.py`)."""
    words = [str(folder), str(drives), str(every_s), *([str(token_file)] if token_file else [])]
    command = [sys.executable, str(Path(__file__).parent / "fed_page.py"), *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield int(process.stdout.readline())
    finally:
        process.terminate()
        process.wait(20)
