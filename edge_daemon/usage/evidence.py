"""What a ledger says about a gear's end: clocks of use, trends of condition, and the load to expect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from edge_daemon.records import Array
from edge_daemon.usage.bearing import LOAD_EXPONENT
from edge_daemon.usage.ledger import EXPONENTS, STIFFNESS_PER_K_SD, Ledger, merge

BINS = 40
"""A trend of so many points shows its curvature, and averaging has removed the noise of an hour."""
FUTURE_H = 1000.0
FUTURE_SHARE = 0.2
"""The load to come is that of the last 1000 h or the last fifth of the life, whichever is longer (guess)."""
LEAST_SD = 5e-4
"""No condition is known better than this, relatively."""
WANDER_SHARE = 0.045
WANDER_SPAN = 0.15
"""No real trend follows a formula: it wanders slowly by this share of its own size, correlated over this share of its
length (guess, checked by coverage in the bench of life)."""
LEVEL_SD = 3.0
"""The logarithm of a trend's starting level is unknown by this sd, which is as good as flat."""
WARMTH_SD = {"stiffness": STIFFNESS_PER_K_SD, "noise": 2e-2}
"""Warmth alone may change a condition by this sd per kelvin, relatively (guess; the record decides)."""


@dataclass(frozen=True, slots=True)
class TrendEvidence:
    """A condition over life, ready for a Gaussian likelihood with level and warmth already integrated out."""

    rows: NDArray[np.intp]
    """(k,) which rows of the clocks it belongs to"""
    y: Array
    """(k,) share lost since the mean where `relative`, else the logarithm less its mean"""
    whitener: Array
    """(k, k) maps a residual y - model to independent standard normal numbers"""
    relative: bool
    """a share is lost of it, as of stiffness; else it grows by factors, as noise does"""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Clocks at the middle of each of n rows, their value now and their expected rate per hour to come."""

    age_h: float
    rated_h: Array
    """(n,) bearing: hours at rated load"""
    rated_now_h: float
    rated_rate: float
    strain_h: Array
    """(5, n) flexspline, for each of `ledger.EXPONENTS`: hours at the mean load of the life so far; now = `age_h`"""
    strain_rate: Array
    """(5,) 1 if the load to come is that of the past"""
    fatigue_rate: float
    """damage per hour by the maker's law over the life so far; where there is none, of the load to come"""
    fatigue_log_sd: float
    """sd of its logarithm, as far as the loss of stiffness is not known exactly"""
    stiffness: TrendEvidence | None
    noise: TrendEvidence | None


def evidence_of(ledger: Ledger, before_h: float = 0.0, load_factor: float = 1.0) -> Evidence:
    """Evidence of a ledger that is not empty.

    `before_h` hours that the gear ran before the ledger began count at the ledger's mean load. A plan of
    `load_factor` times the torque changes the rates to come.
    """
    rows = merge(ledger, BINS)
    hours = float(np.sum(rows.hours))
    recent = np.cumsum(ledger.hours[::-1])[::-1] <= max(FUTURE_H, FUTURE_SHARE * hours)
    recent[-1] = True
    recent_h = float(np.sum(ledger.hours[recent]))
    age_h = before_h + hours
    rated = _clock(rows.rated_h, before_h / hours)
    strain = np.sum(rows.strain, axis=1, keepdims=True) / hours
    strain = np.where(strain > 0.0, strain, 1.0)
    strained = [_clock(row, before_h / hours)[0] for row in rows.strain / strain]
    exponents = np.array(EXPONENTS)
    return Evidence(
        age_h=age_h,
        rated_h=rated[0],
        rated_now_h=rated[1],
        rated_rate=float(np.sum(ledger.rated_h[recent])) / recent_h * load_factor**LOAD_EXPONENT,
        strain_h=np.array(strained),
        strain_rate=np.sum(ledger.strain[:, recent], axis=1) / recent_h / strain[:, 0] * load_factor**exponents,
        fatigue_rate=float(np.sum(ledger.fatigue)) / hours,
        fatigue_log_sd=float(np.sum(ledger.fatigue_sd)) / max(float(np.sum(ledger.fatigue)), 1e-300),
        stiffness=_trend(rows, rows.log_mean[0], rows.count[0], rows.log_scatter[0], WARMTH_SD["stiffness"], True),
        noise=_noise_trend(rows),
    )


def _clock(used: Array, before: float) -> tuple[Array, float]:
    total = float(np.sum(used))
    start = before * total
    return start + np.cumsum(used) - used / 2.0, start + total


def _noise_trend(rows: Ledger) -> TrendEvidence | None:
    """The five coefficients as one: their mean, each by how well it is known."""
    sd = np.array([_spread(rows.log_mean[i], rows.count[i], rows.log_scatter[i]) for i in range(1, 6)])
    known = np.isfinite(sd)
    if not known.any():
        return None
    weight = np.where(known, 1.0 / np.where(known, np.maximum(sd, LEAST_SD), 1.0) ** 2, 0.0)
    seen = rows.count[1:6] > 0
    level = np.sum(np.nan_to_num(rows.log_mean[1:6]), axis=1) / np.maximum(np.sum(seen, axis=1), 1)
    y = rows.log_mean[1:6] - level[:, None]
    has = seen * weight[:, None]
    total = has.sum(axis=0)
    mean = np.sum(np.nan_to_num(y) * has, axis=0) / np.where(total > 0, total, np.nan)
    count = np.max(rows.count[1:6], axis=0)
    pooled = 1.0 / np.sum(weight)
    return _trend(rows, mean, count, pooled * np.maximum(count, 0.0), WARMTH_SD["noise"], False)


def _spread(mean: Array, count: Array, scatter: Array) -> float:
    """Standard deviation of one hour's value around its row's mean; NaN if nothing is known.

    Rows without inner scatter (one value each) are judged by second differences, which a slow trend does not move.
    """
    known = count > 0
    freedom = float(np.sum(count[known] - 1.0))
    if freedom >= 10.0:
        return float(np.sqrt(np.sum(scatter[known]) / freedom))
    values = mean[known]
    if values.size < 4:
        return float("nan") if not values.size else 0.02
    bends = np.diff(values, 2)
    return float(np.sqrt(np.mean(bends**2) / 6.0) * np.sqrt(np.mean(count[known])))


def _trend(
    rows: Ledger, mean: Array, count: Array, scatter: Array, warmth_sd: float, relative: bool
) -> TrendEvidence | None:
    used = np.flatnonzero((count > 0) & np.isfinite(mean))
    if used.size < 3:
        return None
    y = mean[used]
    spread = max(_spread(mean, count, scatter), LEAST_SD)
    sd = np.sqrt(spread**2 / count[used] + LEAST_SD**2)
    middle = rows.end_h[used] - rows.hours[used] / 2.0
    size = float(np.ptp(np.convolve(y, np.ones(3) / 3.0, mode="valid")))
    length = max(float(np.ptp(middle)), 1e-9)
    gap = np.abs(middle[:, None] - middle[None, :]) / (WANDER_SPAN * length)
    cover = np.diag(sd**2) + (WANDER_SHARE * size) ** 2 * np.exp(-gap)
    warmth = rows.temperature_degC[used]
    warmth = np.nan_to_num(warmth - np.nanmean(warmth)) if np.isfinite(warmth).any() else np.zeros(used.size)
    cover += LEVEL_SD**2 + warmth_sd**2 * np.outer(warmth, warmth)
    lower = linalg.cholesky(cover, lower=True)
    y = y - y.mean()
    whitener = linalg.solve_triangular(lower, np.eye(used.size), lower=True)
    return TrendEvidence(used, -np.expm1(y) if relative else y, whitener, relative)
