"""A page over an invented gateway, as a process: `fed_page.py FOLDER DRIVES EVERY_S [TOKEN_FILE]` prints its port.

`d0` has two alarms, `d1` one encoder, `d2` no encoder at the motor, `d3` has never delivered anything; the disk is
full. Every other drive is well; numbers change with every frame.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import sys
import time
from pathlib import Path
from typing import Any

from edge_daemon.config.settings import DashboardSettings as Settings
from edge_daemon.records import NE107, Estimate, Event, GatewayState, LinkHealth, Snapshot, SourceHealth, Status
from edge_daemon.show import feed
from edge_daemon.show.dashboard import DashboardServer
from edge_daemon.show.page_api import PageApi

SHOWN = {
    "stiffness": (6.7e4, "N m/rad"), "model_nrmse": (0.004, "1"), "model_noise_floor": (0.002, "1"),
    "rul_p10_h": (9_900.0, "h"), "rul_p50_h": (50_000.0, "h"), "health_index": (0.98, "1"), "damage": (0.02, "1"),
    "torque_rms": (60.0, "N m"), "torque_peak": (140.0, "N m"), "ratio": (100.0, "1"),
}  # fmt: skip
OVERLOAD = "peak torque 500 N m passed the momentary limit of 400 N m: inspect the gear, lower the load"
HOT = "housing at 85 degC, grease fails above 80: lower speed or load, check lubricant"
BOTH = ["theta_in_rad", "theta_out_rad"]
CHANNELS = {"d1": ["theta_out_rad", "current_in_A"], "d2": ["theta_out_rad"]}


class Gateway:
    """Counts frames, so that something moves; remembers what was acknowledged."""

    def __init__(self, drives: int, folder: Path) -> None:
        self.names = [f"d{n}" for n in range(drives)]
        self.folder = folder
        self.started_s = time.time() - 60.0
        self.frame = itertools.count()
        self.alarms = [
            {"key": "torque momentary peak", "text": OVERLOAD, "rank": 2, "since_s": time.time() - 90,
             "acknowledged": False, "gone": True},
            {"key": "temperature", "text": HOT, "rank": 2, "since_s": time.time() - 30, "acknowledged": False,
             "gone": False},
        ]  # fmt: skip
        self.events: list[Event] = []

    def state(self) -> GatewayState:
        n, now_s = next(self.frame), time.time()
        snapshots = {name: self._snapshot(i, name, n, now_s) for i, name in enumerate(self.names)}
        links = (LinkHealth("store", "degraded", "/data/store.sqlite: no space left: what was stored is intact", {}),)
        sources = (SourceHealth("can0", "ok", "", now_s, {}),)
        return GatewayState("s", "fed", "1", self.started_s, now_s, snapshots, sources, (), tuple(self.events), links)

    def _snapshot(self, i: int, name: str, n: int, now_s: float) -> Snapshot:
        open_texts = tuple(row["text"] for row in self.alarms) if name == "d0" else ()
        worth = 1.0 + 0.01 * math.sin(0.7 * n + i)
        rows = {
            key: Estimate(key, size * worth, 0.01 * size, unit, Status.VALID, now_s)
            for key, (size, unit) in SHOWN.items()
        }
        state = NE107.OUT_OF_SPECIFICATION if name == "d0" else NE107((n // 5 + i) % 2 if i > 3 else 0)
        reasons = open_texts if name == "d0" else ("stiffness fell: plan a new gear",) if state else ()
        return Snapshot(name, n, math.nan if name == "d3" else now_s, state, reasons, {} if name == "d3" else rows)

    def drive_view(self, name: str) -> dict[str, Any]:
        model = {"balance": "drive" if name == "d1" else "torsion", "effects": ["linear_stiffness"], "lineage": []}
        return {
            "alarms": self.alarms if name == "d0" else [], "channels": CHANNELS.get(name, BOTH), "noise": None,
            "loop": None, "load": None, "model": model, "gear": None, "observed_h": 0.0,
        }  # fmt: skip

    def acknowledge(self, drive: str, key: str | None, who: str) -> int:
        seen = [row for row in self.alarms if drive == "d0" and not row["acknowledged"] and key in (None, row["key"])]
        for row in seen:
            row["acknowledged"] = True
            text = f"acknowledged by {who}: {row['text']}"
            self.events.append(Event(drive, time.time(), NE107.OK, str(row["key"]), text))
        return len(seen)

    def trend(self, drive: str, query: Any) -> dict[str, Any]:
        names = query["names"].split(",")
        none: dict[str, list[float]] = {name: [] for name in names}
        return {"time_s": [], "value": none, "sd": none}

    def sound(self, drive: str, query: Any) -> dict[str, Any]:
        """A year at two speeds: of `d0` a line at 400 Hz has come up; of the others nothing is kept."""
        hertz, slots = [20.0 * 2.0 ** (band / 6.0) for band in range(48)], range(120)
        level = [[-60.0 + (12.0 if s > 60 and 390 < hz < 440 else 0.0) + s % 3 for hz in hertz] for s in slots]
        known = {"time_s": [1.7e9 + 2.6e5 * s for s in slots], "frequency_hz": hertz, "level_dB": level}
        change = {"frequency_hz": 403.0, "dB": 12.0, "sd_dB": 0.4, "sure": True}
        regimes = [[0, 0.0, 200], [8, 150.0, 900]]
        none = {"time_s": [], "frequency_hz": [], "level_dB": [], "regimes": [], "regime": None, "change": None}
        return (
            {**known, "regimes": regimes, "regime": int(query.get("regime", 8)), "change": change}
            if drive == "d0"
            else none
        )

    def page_api(self) -> PageApi:
        return PageApi(
            drive_view=self.drive_view,
            what_if=lambda drive, factor: {}, history=lambda drive, query: [], trend=self.trend, sound=self.sound,
            newest_s=lambda: math.nan, events=lambda limit: self.events, acknowledge=self.acknowledge,
            model_file=lambda drive: self.folder / "none.toml", folder=self.folder, store=self.folder / "none.sqlite",
        )  # fmt: skip


async def main(folder: Path, drives: int, every_s: float, token_file: str | None) -> None:
    feed.EVERY_S = every_s
    gateway = Gateway(drives, folder)
    settings = Settings(port=0, allow_changes=True, token_file=token_file)
    page = DashboardServer(settings, gateway.state, None, gateway.page_api())
    print(await page.start(), flush=True)
    await asyncio.Event().wait()


asyncio.run(main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4] if sys.argv[4:] else None))
