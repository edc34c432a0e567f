"""Whether a condition has drifted since commissioning: a control chart for each, and the fault that fits them all."""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec
import numpy as np

from edge_daemon.faults.conditions import CONDITIONS, KNOWN, Condition
from edge_daemon.faults.posterior import EVEN, NONE, posterior
from edge_daemon.health.alarms import Finding
from edge_daemon.health.control_chart import (
    BATCH,
    FALSE_ALARMS_PER_YEAR,
    HOURS_PER_YEAR,
    RECENT,
    WINDOW_H,
    Chart,
    freeze,
    judge,
    regressors,
    threshold,
)
from edge_daemon.quantities import of_topic
from edge_daemon.records import NE107, Array, Estimate, Status
from edge_daemon.usage.gears import Gear

COMMISSION_H = 500.0
"""Three weeks hold several working weeks and weather: long enough to know the residuals' own long-run variance."""
RATED_NM, RATED_RPM = 50.0, 2000.0
"""Load and speed are scaled by these where the gear is unknown."""


class _State(msgspec.Struct):
    key: tuple[str, str]
    charts: dict[str, Chart]
    sums: dict[str, tuple[float, float]]
    hours: float
    observed_h: float
    changed_h: float = math.nan


class ConditionWatch:
    """`update` with every block's estimates; `findings` go to the health judge."""

    def __init__(self, drive: str, gear: Gear | None = None, commission_h: float = COMMISSION_H) -> None:
        self.drive = drive
        self.gear = gear
        self.commission_h = commission_h
        self.observed_h = 0.0
        batches = HOURS_PER_YEAR / (WINDOW_H * BATCH)
        self.limit = threshold(FALSE_ALARMS_PER_YEAR, batches, 2 * len(CONDITIONS))
        self._charts: dict[str, Chart] = {}
        self._sums: dict[str, tuple[float, float]] = {}
        self._hours = 0.0
        self._changed_h = math.nan
        """observed hours when another model came"""

    def update(self, hours: float, estimates: Mapping[str, Estimate]) -> None:
        """Take in estimates that held for `hours`. Unusable ones do not count.

        Used: the names of `CONDITIONS`, and `temperature`, `torque_rms`, `speed_in` as what they hang on.
        """
        self._hours += hours
        for name in (*(row.name for row in CONDITIONS), "temperature", "torque_rms", "speed_in"):
            estimate = estimates.get(name)
            if estimate is not None and estimate.usable:
                total, weight = self._sums.get(name, (0.0, 0.0))
                self._sums[name] = (total + estimate.value * hours, weight + hours)
        if self._hours >= WINDOW_H:
            self._close_window()

    def model_changed(self) -> None:
        """Another model sees other numbers in the same gear: what the motion tells gets a baseline anew. A stiffness
        comes referred to the first model, and goes on."""
        for name in {row.name for row in of_topic("stiffness")} - {"stiffness"}:
            self._charts.pop(name, None)
            self._sums.pop(name, None)
        self._changed_h = self.observed_h

    def _close_window(self) -> None:
        means = {name: total / weight for name, (total, weight) in self._sums.items() if weight > 0.0}
        self.observed_h += self._hours
        self._hours, self._sums = 0.0, {}
        state = state_of(means, self.gear)
        for condition in CONDITIONS:
            value = means.get(condition.name)
            if value is None or (condition.relative and value <= 0.0):
                continue
            y = math.log(value) if condition.relative else value
            chart = self._charts.setdefault(condition.name, Chart())
            if chart.weights:
                judge(chart, condition.matters, regressors(np.array([state]))[0], y, self.limit)
            else:
                chart.rows.append((*state, y))
                if len(chart.rows) * WINDOW_H >= self.commission_h:
                    freeze(chart)

    def drifts(self) -> dict[str, tuple[float, float]]:
        """Condition -> (drift since it began to move, its sd), in the units of `Condition`."""
        moved = [chart for chart in self._charts.values() if chart.drifted]
        span = max((chart.moving for chart in moved), default=1)
        found = {}
        for name, chart in self._charts.items():
            recent = chart.recent[-min(span, RECENT) :]
            if recent:
                found[name] = (float(np.mean(recent)), chart.batch_sd / math.sqrt(len(recent)))
        return found

    def scaled(self) -> dict[str, tuple[float, float]]:
        """The drifts in units of what matters of each condition."""
        return {n: (drift / KNOWN[n].matters, sd / KNOWN[n].matters) for n, (drift, sd) in self.drifts().items()}

    def findings(self) -> tuple[Finding, ...]:
        """What has drifted, in one finding with the fault pattern that fits."""
        moved = [row for row in CONDITIONS if row.name in self._charts and self._charts[row.name].drifted]
        if not moved:
            return (Finding("drift", NE107.MAINTENANCE_REQUIRED, False, False, "", latching=True),)
        drifts = self.drifts()
        worst = sorted(moved, key=lambda row: -abs(drifts[row.name][0]) / row.matters)
        faults = posterior(self.scaled())
        sure, advice = faults.kinds[NONE] < EVEN, faults.given_a_fault().in_words()
        told = ", ".join(_told(row, *drifts[row.name]) for row in worst[:3])
        since = "" if math.isnan(self._changed_h) else f" (another model since {self._changed_h:.0f} h)"
        text = f"drifted since commissioning{since}: {told}; {advice}"
        return (Finding("drift", NE107.MAINTENANCE_REQUIRED, sure, True, text, latching=True),)

    def state(self) -> bytes:
        """Everything that `restore` needs."""
        key = (self.drive, self.gear.name if self.gear else "")
        return msgspec.msgpack.encode(
            _State(key, self._charts, self._sums, self._hours, self.observed_h, self._changed_h)
        )

    def restore(self, blob: bytes) -> bool:
        """True if taken over; False, and nothing changed, if broken or of another drive or gear."""
        try:
            saved = msgspec.msgpack.decode(blob, type=_State)
        except msgspec.MsgspecError:
            return False
        if saved.key != (self.drive, self.gear.name if self.gear else ""):
            return False
        self._charts, self._sums = saved.charts, saved.sums
        self._hours, self.observed_h, self._changed_h = saved.hours, saved.observed_h, saved.changed_h
        return True


def state_of(means: Mapping[str, float], gear: Gear | None) -> tuple[float, float, float]:
    """Warmth, load and speed that a condition hangs on, of an hour's means."""
    load = means.get("torque_rms", 0.0) / (gear.rated_torque_Nm if gear else RATED_NM)
    speed = means.get("speed_in", 0.0) / (gear.rated_speed_rpm if gear else RATED_RPM) * 30.0 / math.pi
    return (means.get("temperature", 25.0) - 25.0, load, speed)


def watched(time_h: Array, columns: Mapping[str, Array], gear: Gear) -> ConditionWatch:
    """A history (n,) as the live watch would have seen it; its first third is the commissioning, at most."""
    names = {
        "stiffness_Nm_per_rad": "stiffness",
        "temperature_degC": "temperature",
        "torque_cubic_mean_Nm": "torque_rms",
    }
    known = {names.get(name, name): values for name, values in columns.items()}
    if "speed_in_rpm" in columns:
        known["speed_in"] = np.abs(columns["speed_in_rpm"]) * math.pi / 30.0
    hours = np.diff(time_h, prepend=time_h[0] - (float(np.median(np.diff(time_h))) if time_h.size > 1 else 1.0))
    watch = ConditionWatch("history", gear, min(COMMISSION_H, float(np.sum(hours)) / 3.0))
    for row, passed in enumerate(hours.tolist()):
        told = {name: float(values[row]) for name, values in known.items() if math.isfinite(values[row])}
        watch.update(passed, {n: Estimate(n, v, 0.0, "", Status.VALID, 0.0) for n, v in told.items()})
    return watch


def _told(condition: Condition, drift: float, sd: float) -> str:
    amount = f"{math.expm1(drift):+.1%}" if condition.relative else f"{drift:+.1f}"
    return f"{condition.meaning} {amount} ({abs(drift) / sd:.0f} sd)" if sd > 0.0 else f"{condition.meaning} {amount}"
