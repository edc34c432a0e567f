"""Whether a number has drifted from its baseline, at a stated rate of false alarms.

Hourly means are regressed on temperature, load, speed and the operating regime over the commissioning time, so a warm
afternoon or a heavier shift is no fault; then the regression is frozen, and a two-sided CUSUM (Page 1954) runs over
batch means of what is left. Its threshold follows from the false-alarm rate by Siegmund's approximation of the average
run length (1985, eq. 2.55); the noise is scaled by its long-run variance, because residuals of neighbouring hours are
alike. Two false alarms of a CUSUM are told apart from a fault by what matters: an allowance of half the smallest change
worth telling, plus two standard deviations of the baseline itself.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from edge_daemon.records import Array

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


class Chart(msgspec.Struct):
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


def regressors(states: Array) -> Array:
    """(n, 4 + regimes) of (n, 3) warmth, load, speed: level, slopes and the regime's own offset."""
    level = np.clip((REGIMES * states[:, 1:]).astype(int), 0, REGIMES - 1)
    regime = np.eye(REGIMES**2)[REGIMES * level[:, 0] + level[:, 1]]
    return np.column_stack((np.ones(len(states)), states, regime))


def freeze(chart: Chart) -> None:
    """Fit the baseline and how far its batch means scatter; forget the rows."""
    rows = np.array(chart.rows)
    x, y = regressors(rows[:, :3]), rows[:, 3]
    middle = float(np.median(y))
    noise = max(1.4826 * float(np.median(np.abs(np.diff(y)))) / math.sqrt(2.0), 1e-9)
    for _ in range(3):
        q, r = np.linalg.qr(np.vstack((x / noise, np.diag(1.0 / PRIOR_SD))))  # numbers that never change are no trouble
        weights = np.linalg.solve(r, q[: len(y)].T @ (y - middle) / noise)
        left = y - middle - x @ weights
        noise = max(float(np.std(left)), 1e-9)
    long_run = _long_run_variance(left)
    weights[0] += middle
    chart.weights = weights.tolist()
    root = np.linalg.inv(r)
    chart.covariance = (root @ root.T * max(long_run / noise**2, 1.0)).tolist()
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


def judge(chart: Chart, matters: float, x: Array, y: float, limit: float) -> None:
    sure = math.sqrt(max(float(x @ np.array(chart.covariance) @ x), 0.0))  # rounding may leave less than nothing
    if sure > max(UNKNOWN_SD, 3.0 * chart.batch_sd):
        return
    chart.batch.append((y - float(x @ np.array(chart.weights)), sure))
    if len(chart.batch) < BATCH:
        return
    residual, sure = (float(part) for part in np.median(np.array(chart.batch), axis=0))
    chart.batch = []
    slack = max(ALLOWANCE * matters, 2.0 * sure) + REFERENCE * chart.batch_sd
    ceiling = 2.0 * limit
    chart.up = min(max(0.0, chart.up + (residual - slack) / chart.batch_sd), ceiling)
    chart.down = min(max(0.0, chart.down + (-residual - slack) / chart.batch_sd), ceiling)
    chart.recent = [*chart.recent[1 - RECENT :], residual]
    most = max(chart.up, chart.down)
    chart.moving = chart.moving + 1 if most > 0.0 else 0
    chart.drifted = most > limit or (chart.drifted and most > 0.0)
