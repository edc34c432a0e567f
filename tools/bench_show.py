"""The page: how soon it is usable, how much travels, and what open pages cost the daemon.

The browser figures need chromium and chromium-driver and are left out without them.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import shutil
import sqlite3
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
from bench_row import Row

from edge_daemon.config.settings import StoreSettings
from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import NE107, Estimate, GatewayState, Snapshot, Status
from edge_daemon.service.history import History
from edge_daemon.show import charts
from edge_daemon.show.dashboard import FILES
from edge_daemon.show.feed import overview
from edge_daemon.store.hours import HourMeans, hour_of
from edge_daemon.store.seal import seal

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "show"))

INTERACTIVE_LIMIT_S = 0.5
PAYLOAD_LIMIT_KB = 100.0
PAGES = 3
PAGES_LIMIT_CORES = 0.05
MEMORY_LIMIT_MIB = 200.0
MEASURE_S = 20.0
DRIVES = 50
UPDATE_LIMIT_MS = 200.0
UPDATES = 60
TEN_MINUTES = 600
"""updates at the daemon's own pace of one a second"""
WARM = 30
FILL_S = 120.0
GROWTH_LIMIT_MIB = 3.0
"""that still counts as flat: a leak of a kilobyte an update would make 0.6 in ten minutes, one of a frame 15"""
NOW_S = 1_763_700_000.0
SECONDS_STORED = 10_800
QUANTITIES_SHOWN = tuple(QUANTITIES)[:10]
TREND_LIMIT_KB = 50.0
TIMED = """
window.updates = [];
const add = EventSource.prototype.addEventListener;
EventSource.prototype.addEventListener = function (type, listener, ...rest) {
  if (type !== "state") return add.call(this, type, listener, ...rest);
  return add.call(this, type, (event) => {
    const made_ms = 1000 * JSON.parse(event.data).now_s;
    listener(event);
    const note = () => window.updates.push([performance.now() - event.timeStamp, Date.now() - made_ms]);
    requestAnimationFrame(() => setTimeout(note));
  }, ...rest);
};"""
"""notes for each update how long it took until it was on the screen: since it arrived, and since it was made [ms]"""


def rows(minutes: float = 0.0) -> list[Row]:
    """Payload and processor with a daemon on a simulated drive; the browser's own figures where there is one.

    `minutes` above 0 adds what memory does in so long a run at the daemon's own pace.
    """
    found = [*_many_drives(), *_past()]
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        return found
    found += _fed()
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
            took_s, busy = _interactive_s(browser, site.port), f"a machine {_busy():.1f} times taken"
            found.append(Row("page interactive", took_s, "s", INTERACTIVE_LIMIT_S, peer=busy))
        if minutes > 0:
            found += _long_run(site, minutes)
    return found


def _fed() -> list[Row]:
    """Fifty drives in the browser: five updates a second, each timed; then ten minutes' worth of them, for memory."""
    from browser import browsing, fed_page

    with tempfile.TemporaryDirectory() as folder, browsing() as browser:
        browser.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": TIMED})
        with fed_page(Path(folder), DRIVES, 0.2) as port:
            browser.driver.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
            browser.go(port)
            first = len(browser.wait("the first", lambda: _enough(browser, 5), 120.0))
            began_s = _main_thread_s(browser)
            updates = browser.wait("updates", lambda: _enough(browser, UPDATES), 120.0)
            own_ms = 1000 * (_main_thread_s(browser) - began_s) / (len(updates) - first)
        with fed_page(Path(folder), DRIVES, 0.02) as port, _Readers(port, PAGES - 1, "d5"):
            browser.go(port)
            browser.wait("the first updates", lambda: _enough(browser, WARM), 120.0)
            before = _heap_mib(browser)
            browser.wait("ten minutes' updates", lambda: _enough(browser, WARM + TEN_MINUTES), 300.0)
            grown = _heap_mib(browser) - before
        busy = f"a machine {_busy():.1f} times taken"
    paint, whole = (sorted(column)[int(0.95 * len(column))] for column in zip(*updates, strict=True))
    return [
        Row(f"an update of {DRIVES} drives in the browser, its own time", own_ms, "ms", UPDATE_LIMIT_MS),
        Row(
            f"an update of {DRIVES} drives in the browser, p95 from arrival to painted",
            paint,
            "ms",
            UPDATE_LIMIT_MS,
            peer=busy,
        ),
        Row("the same, p95 from made in the daemon to painted", whole, "ms", UPDATE_LIMIT_MS, peer=busy),
        Row(f"the page's heap, growth over {TEN_MINUTES} updates", grown, "MiB", GROWTH_LIMIT_MIB),
    ]


def _busy() -> float:
    """How much longer than its own time a second of arithmetic takes now: others want the processor too."""
    began, own = time.perf_counter(), time.thread_time()
    while time.thread_time() - own < 1.0:
        sum(range(1000))
    return (time.perf_counter() - began) / (time.thread_time() - own)


def _enough(browser: Any, count: int) -> Any:
    """The timed updates once there are so many."""
    if browser.driver.execute_script("return window.updates.length") < count:
        return None
    return browser.driver.execute_script("return window.updates")


def _main_thread_s(browser: Any) -> float:
    """Processor time of the page's main thread so far: scripts, layout and paint."""
    rows = browser.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return float(next(row["value"] for row in rows if row["name"] == "TaskDuration"))


def _heap_mib(browser: Any) -> float:
    """Of the page, after its garbage is collected."""
    for _ in range(2):
        browser.driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
    return float(browser.driver.execute_cdp_cmd("Runtime.getHeapUsage", {})["usedSize"]) / 2**20


def _long_run(site: Any, minutes: float) -> list[Row]:
    """A live page and two more streams for so long, after two minutes in which caches and queues fill."""
    from browser import browsing

    with browsing() as browser, _Readers(site.port, PAGES - 1):
        browser.go(site.port, "drive/axis-1")
        time.sleep(FILL_S)
        heap, daemon, rows = _heap_mib(browser), _memory_mib(site.pid), []
        until = time.monotonic() + 60.0 * minutes
        while time.monotonic() < until:
            time.sleep(min(60.0, max(until - time.monotonic(), 0.0)))
            rows.append((_heap_mib(browser), _memory_mib(site.pid)))
            print(f"  heap {rows[-1][0]:.2f} MiB, daemon {rows[-1][1]:.1f} MiB", file=sys.stderr, flush=True)
    name = f"growth in {minutes:g} minutes with {PAGES} pages open"
    return [
        Row(f"the page's heap, {name}", rows[-1][0] - heap, "MiB", GROWTH_LIMIT_MIB),
        Row(f"the daemon, {name}", rows[-1][1] - daemon, "MiB", GROWTH_LIMIT_MIB),
    ]


def _past() -> list[Row]:
    """What the trends of ten quantities over three spans take, from a year of hours and three hours of seconds."""
    with tempfile.TemporaryDirectory() as folder:
        history = History(StoreSettings(file="s.sqlite", max_mib=512), Path(folder))
        _fill(Path(folder) / "s.sqlite", history)
        found = []
        for name, span_s in (("ten minutes", 600.0), ("a month", 30 * 86_400.0), ("a year", 365 * 86_400.0)):
            asked = {"names": ",".join(QUANTITIES_SHOWN), "since_s": f"{NOW_S - span_s}", "until_s": f"{NOW_S}"}
            times = []
            for _ in range(7):
                began = (time.thread_time(), time.perf_counter())
                size = len(gzip.compress(json.dumps(history.trend("d0", asked)).encode()))
                times.append((1000 * (time.thread_time() - began[0]), 1000 * (time.perf_counter() - began[1])))
            own, wall = (sorted(column)[3] for column in zip(*times, strict=True))
            name = f"trends over {name}, median of its own time"
            found.append(Row(name, own, "ms", UPDATE_LIMIT_MS, peer=f"{wall:.0f} ms by the clock"))
        found.append(Row("trends over a year, compressed", size / 1000, "kB", TREND_LIMIT_KB))
        history.close()
    return found


def _fill(file: Path, history: History) -> None:
    rng = np.random.default_rng(1)

    def snapshot(time_s: float) -> Snapshot:
        rows = {
            name: Estimate(name, float(value), 0.1, "1", Status.VALID, time_s)
            for name, value in zip(QUANTITIES, rng.normal(100.0, 1.0, len(QUANTITIES)), strict=True)
        }
        return Snapshot("d0", int(time_s), time_s, NE107.OK, (), rows)

    for second in range(SECONDS_STORED):
        history.add_snapshot(snapshot(NOW_S - SECONDS_STORED + second))
        if second % 1000 == 999:
            history.commit()
    history.commit()
    first = hour_of(NOW_S) - 365 * 24
    with sqlite3.connect(file) as database:
        database.execute("DELETE FROM hour")
        for hour in range(first, hour_of(NOW_S)):
            means = HourMeans(hour, {})
            means.add(snapshot(hour * 3600.0))
            row = (1, hour, means.encode())
            database.execute("INSERT INTO hour (drive, hour, data, crc) VALUES (?, ?, ?, ?)", (*row, seal(*row)))


def _payload_kb(port: int) -> float:
    """Of all that the page is made of: a browser asks for no more before the first view stands."""
    total = 0
    for path in {*FILES, *charts.FILES, "/api/session"} - {"/page.css", "/page.js", "/charts/LICENSE"}:
        request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", headers={"Accept-Encoding": "gzip"})
        with urllib.request.urlopen(request, timeout=10) as answer:
            total += len(answer.read())
    return total / 1000


class _Readers:
    """As many event streams as pages, read at once; in threads, so that the bench's own work is not the daemon's."""

    def __init__(self, port: int, count: int, drive: str = "axis-1") -> None:
        url = f"http://127.0.0.1:{port}/api/live?drive={drive}"
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

    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--minutes", type=float, default=0.0, help="of a real run in which memory is watched")
    print(table(HEAD, [cells(row) for row in rows(arguments.parse_args().minutes)]))
