"""Whether a condition has drifted since commissioning, at a stated rate of false alarms.

For each condition: hourly means are regressed on temperature, load, speed and the operating regime over the
commissioning time, so a warm afternoon or a heavier shift is no fault; then the regression is frozen, and a two-sided
CUSUM (Page 1954) runs over batch means of what is left. Its threshold follows from the false-alarm rate by Siegmund's
approximation of the average run length (1985, eq. 2.55); the noise is scaled by its long-run variance, because
residuals of neighbouring hours are alike. Two false alarms of a CUSUM are told apart from a fault by what matters: an
allowance of half the smallest change worth telling, plus two standard deviations of the baseline itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec
import numpy as np

from edge_daemon.faults.conditions import CONDITIONS, KNOWN, Condition
from edge_daemon.faults.posterior import EVEN, NONE, posterior
from edge_daemon.prognose.alarms import Finding
from edge_daemon.quantities import of_topic
from edge_daemon.records import NE107, Array, Estimate, Status
from edge_daemon.usage.gears import Gear

COMMISSION_H = 500.0
"""Three weeks hold several working weeks and weather: long enough to know the residuals' own long-run variance."""
WINDOW_H = 1.0
BATCH = 24
"""A batch mean is over a day of windows, so that what a day repeats cancels."""
FALSE_ALARMS_PER_YEAR = 0.2
"""A drive with all conditions measured raises so many false alarms."""
REFERENCE = 0.5
"""CUSUM reference value in standard deviations of a batch mean: tuned to a shift of one"""
ALLOWANCE = 0.4
"""A residual may stand off by this share of what matters without counting."""
REGIMES = 3
"""So many levels of load and of speed have a baseline of their own, in thirds of the rated value."""
PRIOR_SD = np.array([30.0, 0.01, 0.3, 0.3, *([0.05] * REGIMES**2)])
"""Level, slope per kelvin, slopes over load and speed (rated = 1) and regimes' offsets are unknown by this much,
relatively (guess, wide)."""
UNKNOWN_SD = 0.02
"""A window whose baseline is less sure than this, times what the residuals scatter if that is more, is not judged."""
LONG_RUN_LAGS = 48
"""Residuals are taken to be alike over so many windows (Newey and West 1987)."""
HOURS_PER_YEAR = 8766.0
RECENT = 30
"""A drift is measured over at most so many batches."""
RATED_NM, RATED_RPM = 50.0, 2000.0
"""Load and speed are scaled by these where the gear is unknown."""


def threshold(false_alarms_per_year: float, batches_per_year: float, tests: int) -> float:
    """CUSUM limit [sd] at which `tests` one-sided charts together ring so often.

    Siegmund: average run length = (exp(2 k b) - 2 k b - 1) / (2 k^2), b = limit + 1.166.
    """
    run = batches_per_year * tests / false_alarms_per_year
    low, high = 0.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        twice = 2.0 * REFERENCE * (middle + 1.166)
        low, high = (middle, high) if (math.exp(twice) - twice - 1.0) / (2.0 * REFERENCE**2) < run else (low, middle)
    return high


class _Chart(msgspec.Struct):
    """Baseline and CUSUM of one condition."""

    rows: list[tuple[float, float, float, float]] = msgspec.field(default_factory=list)
    """(warmth, load, speed, value) of the commissioning time, dropped when it ends"""
    weights: list[float] = msgspec.field(default_factory=list)
    covariance: list[list[float]] = msgspec.field(default_factory=list)
    batch_sd: float = 0.0
    batch: list[tuple[float, float]] = msgspec.field(default_factory=list)
    """(residual, baseline sd) of the open batch"""
    up: float = 0.0
    down: float = 0.0
    recent: list[float] = msgspec.field(default_factory=list)
    """the newest residual batch means"""
    moving: int = 0
    """batches since the CUSUM that is larger left zero"""
    drifted: bool = False


class _State(msgspec.Struct):
    key: tuple[str, str]
    charts: dict[str, _Chart]
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
        self._charts: dict[str, _Chart] = {}
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
        load = means.get("torque_rms", 0.0) / (self.gear.rated_torque_Nm if self.gear else RATED_NM)
        speed = means.get("speed_in", 0.0) / (self.gear.rated_speed_rpm if self.gear else RATED_RPM) * 30.0 / math.pi
        state = (means.get("temperature", 25.0) - 25.0, load, speed)
        for condition in CONDITIONS:
            value = means.get(condition.name)
            if value is None or (condition.relative and value <= 0.0):
                continue
            y = math.log(value) if condition.relative else value
            chart = self._charts.setdefault(condition.name, _Chart())
            if chart.weights:
                _judge(chart, condition, _regressors(np.array([state]))[0], y, self.limit)
            else:
                chart.rows.append((*state, y))
                if len(chart.rows) * WINDOW_H >= self.commission_h:
                    _freeze(chart)

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


def _regressors(states: Array) -> Array:
    """(n, 4 + regimes) of (n, 3) warmth, load, speed: level, slopes and the regime's own offset."""
    level = np.clip((REGIMES * states[:, 1:]).astype(int), 0, REGIMES - 1)
    regime = np.eye(REGIMES**2)[REGIMES * level[:, 0] + level[:, 1]]
    return np.column_stack((np.ones(len(states)), states, regime))


def _freeze(chart: _Chart) -> None:
    """Fit the baseline and how far its batch means scatter; forget the rows."""
    rows = np.array(chart.rows)
    x, y = _regressors(rows[:, :3]), rows[:, 3]
    middle = float(np.median(y))
    noise = max(1.4826 * float(np.median(np.abs(np.diff(y)))) / math.sqrt(2.0), 1e-9)
    for _ in range(3):
        information = x.T @ x / noise**2 + np.diag(PRIOR_SD**-2.0)
        weights = np.linalg.solve(information, x.T @ (y - middle) / noise**2)
        left = y - middle - x @ weights
        noise = max(float(np.std(left)), 1e-9)
    long_run = _long_run_variance(left)
    weights[0] += middle
    chart.weights = weights.tolist()
    chart.covariance = (np.linalg.inv(information) * max(long_run / noise**2, 1.0)).tolist()
    chart.batch_sd = math.sqrt(long_run / BATCH)
    chart.rows = []


def _long_run_variance(left: Array) -> float:
    """Variance that a long mean of the residuals has, times its length (Newey-West); at least the plain variance."""
    n = left.size
    lags = min(LONG_RUN_LAGS, n // 4)
    total = float(left @ left) / n
    plain = total
    for lag in range(1, lags + 1):
        total += 2.0 * (1.0 - lag / (lags + 1)) * float(left[lag:] @ left[:-lag]) / n
    return max(total, plain, 1e-18)


def _judge(chart: _Chart, condition: Condition, x: Array, y: float, limit: float) -> None:
    sure = math.sqrt(float(x @ np.array(chart.covariance) @ x))
    if sure > max(UNKNOWN_SD, 3.0 * chart.batch_sd):
        return
    chart.batch.append((y - float(x @ np.array(chart.weights)), sure))
    if len(chart.batch) < BATCH:
        return
    residual, sure = (float(part) for part in np.median(np.array(chart.batch), axis=0))
    chart.batch = []
    slack = max(ALLOWANCE * condition.matters, 2.0 * sure) + REFERENCE * chart.batch_sd
    ceiling = 2.0 * limit
    chart.up = min(max(0.0, chart.up + (residual - slack) / chart.batch_sd), ceiling)
    chart.down = min(max(0.0, chart.down + (-residual - slack) / chart.batch_sd), ceiling)
    chart.recent = [*chart.recent[1 - RECENT :], residual]
    most = max(chart.up, chart.down)
    chart.moving = chart.moving + 1 if most > 0.0 else 0
    chart.drifted = most > limit or (chart.drifted and most > 0.0)
