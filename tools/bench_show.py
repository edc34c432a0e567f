"""The page: how soon it is usable, how much travels, and what open pages cost the daemon.

The browser figures need chromium and chromium-driver and are left out without them.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

from bench_row import Row

from edge_daemon.records import NE107, Estimate, GatewayState, Snapshot, Status
from edge_daemon.show.feed import overview

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "show"))

INTERACTIVE_LIMIT_S = 1.5
PAYLOAD_LIMIT_KB = 300.0
PAGES = 3
PAGES_LIMIT_CORES = 0.05
MEMORY_LIMIT_MIB = 200.0
MEASURE_S = 20.0
DRIVES = 50
UPDATE_LIMIT_MS = 200.0
MODULES = ("app", "texts", "dom", "plots", "live", "compare", "life", "events")
STATIC = ("/", "/app.css", "/charts/uPlot.css", "/charts/uPlot.js", "/icon.svg", "/api/session")
FILES = (*STATIC, *(f"/{name}.js" for name in MODULES))
"""what the browser asks for before the first view stands"""


def rows() -> list[Row]:
    """Payload and processor with a daemon on a simulated drive; the browser's own figures where there is one."""
    found = [*_many_drives()]
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        return found
    from browser import browsing, gateway

    with tempfile.TemporaryDirectory() as folder, gateway(Path(folder)) as site:
        found.append(Row("first payload, compressed", _payload_kb(site.port), "kB", PAYLOAD_LIMIT_KB))
        time.sleep(10.0)  # the spectrum and the first estimates are there
        pid = site.pid
        alone = _share(pid)
        with _Readers(site.port, PAGES):
            found.append(Row(f"processor of {PAGES} open pages", _share(pid) - alone, "cores", PAGES_LIMIT_CORES))
            found.append(Row("memory with pages open", _memory_mib(pid), "MiB", MEMORY_LIMIT_MIB))
        with browsing() as browser:
            browser.go(site.port, "drive/axis-1")  # the browser's own start is not the page's
            browser.driver.get("about:blank")
            found.append(Row("page interactive", _interactive_s(browser, site.port), "s", INTERACTIVE_LIMIT_S))
    return found


def _payload_kb(port: int) -> float:
    total = 0
    for path in FILES:
        request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", headers={"Accept-Encoding": "gzip"})
        with urllib.request.urlopen(request, timeout=10) as answer:
            total += len(answer.read())
    return total / 1000


class _Readers:
    """As many event streams as pages, read at once; in threads, so that the bench's own work is not the daemon's."""

    def __init__(self, port: int, count: int) -> None:
        url = f"http://127.0.0.1:{port}/api/live?drive=axis-1"
        self._streams = [urllib.request.urlopen(url, timeout=30) for _ in range(count)]
        for stream in self._streams:
            threading.Thread(target=_drain, args=(stream,), daemon=True).start()

    def __enter__(self) -> _Readers:
        return self

    def __exit__(self, *_: object) -> None:
        for stream in self._streams:
            stream.fp.raw._sock.shutdown(2)


def _drain(stream: Any) -> None:
    try:
        while stream.readline():
            pass
    except (OSError, ValueError):
        return


def _interactive_s(browser: Any, port: int) -> float:
    """From the request until the drive's state stands on the page and a plot is drawn, median of five."""
    times = []
    for n in range(5):
        browser.driver.get("about:blank")
        began = time.perf_counter()
        browser.driver.get(f"http://127.0.0.1:{port}/?{n}#/drive/axis-1")
        browser.wait("a state", lambda: browser.texts(".state b") not in ([], ["Waiting for data …"]))
        times.append(time.perf_counter() - began)
    return sorted(times)[2]


def _many_drives() -> list[Row]:
    """How long an update of fifty drives takes to make; what else a page waits for is the second between two."""
    names = ("stiffness", "model_nrmse", "rul_p10_h", "health_index")
    estimates = {name: Estimate(name, 1.0, 0.1, "1", Status.VALID, 0.0) for name in names}
    snapshots = {f"d{n}": Snapshot(f"d{n}", n, 0.0, NE107(n % 5), ("x: y",), estimates) for n in range(DRIVES)}
    state = GatewayState("s", "g", "1", 0.0, 1.0, snapshots, (), (), (), ())
    waits = []
    for _ in range(200):
        began = time.perf_counter()
        json.dumps(overview(state, 5.0))
        waits.append(1000 * (time.perf_counter() - began))
    name = f"an update of {DRIVES} drives, p95 of making it"
    return [Row(name, sorted(waits)[190], "ms", UPDATE_LIMIT_MS)]


def _share(pid: int) -> float:
    first = _cpu_s(pid)
    time.sleep(MEASURE_S)
    return (_cpu_s(pid) - first) / MEASURE_S


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_mib(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    from bench_row import HEAD, cells

    from edge_daemon.text import table

    print(table(HEAD, [cells(row) for row in rows()]))
