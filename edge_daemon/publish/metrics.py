"""The gateway's state for Prometheus. Labels come from the configuration and the vocabulary only, never from data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from edge_daemon.quantities import QUANTITIES, Quantity
from edge_daemon.records import Estimate, GatewayState, Snapshot

PREFIX = "strainwave"

UNIT_SUFFIXES = {
    "1": ("", 1.0),
    "1/Hz": ("_per_hertz", 1.0),
    "h": ("_seconds", 3600.0),
    "s": ("_seconds", 1.0),
    "rad": ("_radians", 1.0),
    "rad/s": ("_radians_per_second", 1.0),
    "N m": ("_newton_metres", 1.0),
    "N m/rad": ("_newton_metres_per_radian", 1.0),
    "N m s/rad": ("_newton_metre_seconds_per_radian", 1.0),
    "J": ("_joules", 1.0),
    "Pa": ("_pascals", 1.0),
    "degC": ("_celsius", 1.0),
    "K": ("_kelvins", 1.0),
}
"""Base units at the end of a metric's name, in the plural, as Prometheus' naming conventions ask."""
STATUS_CODES = {"valid": 0, "not_excited": 1, "warming_up": 2, "invalid": 3, "unknown": 4}
SOURCE_STATES = {"ok": 0, "starting": 1, "degraded": 2, "down": 3, "off": 4}


class Metrics:
    """Keeps the newest state and renders it when it is scraped; rows of drives and sources that went are gone."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        self._collector = _Collector()
        self._registry.register(self._collector)
        ProcessCollector(registry=self._registry)

    def update(self, state: GatewayState) -> None:
        """Take over a new state; cheap, nothing is rendered."""
        self._collector.state = state

    def render(self, state: GatewayState | None = None) -> bytes:
        """The text that Prometheus reads (text format 0.0.4), of `state` or else of the last update."""
        if state is not None:
            self.update(state)
        return generate_latest(self._registry)


class _Collector(Collector):
    def __init__(self) -> None:
        self.state: GatewayState | None = None

    def collect(self) -> Iterator[Metric]:
        if self.state is None:
            return
        yield from _gateway(self.state)
        yield from _drives(self.state)
        yield from _estimates(self.state.snapshots.values())
        yield from _model_errors(self.state.snapshots.values())
        yield from _sources(self.state)
        yield from _tasks(self.state)
        yield from _links(self.state)

    def describe(self) -> Iterable[Metric]:
        """Nothing at registration: the families depend on the configuration."""
        return ()


def _gateway(state: GatewayState) -> Iterator[Metric]:
    info = {"site": state.site, "gateway": state.gateway, "version": state.version}
    yield InfoMetricFamily(f"{PREFIX}_gateway", "which gateway this is", value=info)
    up = GaugeMetricFamily(f"{PREFIX}_up_seconds", "since the daemon started")
    up.add_metric([], state.now_s - state.started_s)
    yield up


def _drives(state: GatewayState) -> Iterator[Metric]:
    ne107 = GaugeMetricFamily(
        f"{PREFIX}_drive_state",
        "NAMUR NE 107: 0 ok, 1 maintenance required, 2 out of specification, 3 function check, 4 failure",
        labels=["drive"],
    )
    age = GaugeMetricFamily(
        f"{PREFIX}_data_age_seconds", "age of the newest data; NaN before the first", labels=["drive"]
    )
    blocks = CounterMetricFamily(f"{PREFIX}_blocks", "blocks processed", labels=["drive"])
    for drive, snapshot in state.snapshots.items():
        ne107.add_metric([drive], int(snapshot.state))
        age.add_metric([drive], state.now_s - snapshot.time_s)
        blocks.add_metric([drive], snapshot.sequence)
    yield from (ne107, age, blocks)


def _estimates(snapshots: Iterable[Snapshot]) -> Iterator[Metric]:
    """A metric for each quantity, in its base unit, and one of its standard deviation."""
    drives = list(snapshots)
    status = GaugeMetricFamily(
        f"{PREFIX}_estimate_status",
        "0 valid, 1 valid but not excited now, 2 warming up, 3 invalid, 4 unknown",
        labels=["drive", "quantity"],
    )
    for row in QUANTITIES.values():
        name, scale = metric_of(row)
        value = GaugeMetricFamily(name, f"{row.meaning}; NaN unless it is usable", labels=["drive"])
        sd = GaugeMetricFamily(f"{name}_sd", f"standard deviation: {row.meaning}", labels=["drive"])
        for snapshot in drives:
            estimate = snapshot.estimates.get(row.name)
            number, spread = _numbers(estimate)
            value.add_metric([snapshot.drive], scale * number)
            sd.add_metric([snapshot.drive], scale * spread)
            code = STATUS_CODES[estimate.status.value if estimate else "unknown"]
            status.add_metric([snapshot.drive, row.name], code)
        yield from (value, sd)
    yield status


def metric_of(row: Quantity) -> tuple[str, float]:
    """Name of a quantity's metric, and what makes its base unit of ours: hours are told in seconds."""
    suffix, scale = UNIT_SUFFIXES[row.unit]
    return f"{PREFIX}_{row.name.removesuffix('_h')}{suffix}", scale


def _model_errors(snapshots: Iterable[Snapshot]) -> Iterator[Metric]:
    """Error of the model by operating regime, and of the model before it: whether adding an effect helped."""
    axes = ("speed", "direction", "torque", "temperature")
    regime = GaugeMetricFamily(f"{PREFIX}_model_error_regime", "nrmse by regime", labels=["drive", *axes])
    before = GaugeMetricFamily(f"{PREFIX}_model_error_before", "nrmse of the model before this one", labels=["drive"])
    for snapshot in snapshots:
        found = snapshot.details.get("model_error", {})
        for row in found.get("regimes", ()):
            regime.add_metric([snapshot.drive, *(str(row[axis]) for axis in axes)], row["nrmse"])
        last = found.get("before")
        if last and last["nrmse"] is not None:
            before.add_metric([snapshot.drive], last["nrmse"])
    yield from (regime, before)


def _numbers(estimate: Estimate | None) -> tuple[float, float]:
    return (estimate.value, estimate.sd) if estimate and estimate.usable else (math.nan, math.nan)


def _sources(state: GatewayState) -> Iterator[Metric]:
    level = GaugeMetricFamily(f"{PREFIX}_source_state", "0 ok, 1 starting, 2 degraded, 3 down", labels=["source"])
    age = GaugeMetricFamily(f"{PREFIX}_source_age_seconds", "since the newest reading", labels=["source"])
    counts = CounterMetricFamily(f"{PREFIX}_source_events", "readings, errors, drops, ...", labels=["source", "kind"])
    for source in state.sources:
        level.add_metric([source.source], SOURCE_STATES.get(source.state, SOURCE_STATES["down"]))
        age.add_metric([source.source], state.now_s - source.last_s)
        for kind, count in source.counters.items():
            counts.add_metric([source.source, kind], count)
    yield from (level, age, counts)


def _tasks(state: GatewayState) -> Iterator[Metric]:
    restarts = CounterMetricFamily(f"{PREFIX}_task_restarts", "restarts by the supervisor", labels=["task"])
    running = GaugeMetricFamily(f"{PREFIX}_task_running", "1 while the task runs", labels=["task"])
    for task in state.tasks:
        restarts.add_metric([task.name], task.restarts)
        running.add_metric([task.name], float(task.state == "running"))
    yield from (restarts, running)


def _links(state: GatewayState) -> Iterator[Metric]:
    level = GaugeMetricFamily(f"{PREFIX}_link_state", "0 ok, 1 starting, 2 degraded, 3 down, 4 off", labels=["link"])
    figures = GaugeMetricFamily(
        f"{PREFIX}_link_figure", "what the ways out count: published, dropped, queued, ...", labels=["link", "figure"]
    )
    for link in state.links:
        level.add_metric([link.link], SOURCE_STATES.get(link.state, SOURCE_STATES["down"]))
        for name, value in link.figures.items():
            figures.add_metric([link.link, name], value)
    yield from (level, figures)
