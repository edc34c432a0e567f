"""A gear's life so far in a bounded number of rows: what it carried and how it changed.

Load is kept as sums that add up exactly however rows are merged; condition as means with the scatter around them. The
same rows come from the live daemon and from a history file, so both give the same answer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from edge_daemon.records import Array
from edge_daemon.usage.arrays import BrokenArrays, packed, unpacked
from edge_daemon.usage.bearing import bearing_use, warmth_factor
from edge_daemon.usage.damage import damage_law
from edge_daemon.usage.gears import Gear

NOISE = ("noise_a0", "noise_a1", "noise_a2", "noise_a3", "noise_a4")
CONDITIONS = ("stiffness_Nm_per_rad", *NOISE)
"""The logarithm of these conditions is kept, since relative changes count."""
PEAK_SHARE = 2e-4
"""This share of the wave generator's turns in an hour is made at the hour's peak torque (guess: 0.7 s of it)."""
EXPONENTS = (3.0, 5.0, 7.0, 9.0, 12.0)
"""Exponents of torque in fatigue go from a soft contact to a smooth steel part; between them clocks are
interpolated."""
MOST_ROWS = 480
SUMS = ("hours", "turns", "cubic_Nm3_h", "rated_h", "fatigue", "fatigue_sd", "strain")
"""These columns add up when rows are merged: the sd as well, since one baseline's error is in all of a loss."""
FIRST_ROWS, FIRST_SHARE, SMOOTHED_SHARE = 24, 0.05, 0.025
"""A history's stiffness is held against the mean of its beginning, a day of hourly rows or this share of them, and is
smoothed over the last share (guess)."""
STIFFNESS_PER_K_SD = 2e-3
"""Warmth alone may change a stiffness by this sd per kelvin, relatively (guess; the record decides)."""


@dataclass(frozen=True, slots=True)
class Ledger:
    """(n,) rows in order of time; a row covers `hours` up to `end_h`."""

    end_h: Array
    hours: Array
    turns: Array
    """of the wave generator"""
    cubic_Nm3_h: Array
    """sum of |torque|^3 * speed in turns: its mean per turn is the cubic mean's cube"""
    rated_h: Array
    """hours of use at rated load, with cool grease, that cost the bearing as much"""
    fatigue: Array
    """damage of the flexspline by the maker's law, at the stiffness lost so far where that is known"""
    fatigue_sd: Array
    """of that damage, as far as the loss of stiffness is not known exactly"""
    strain: Array
    """(5, n) sums of turns * (torque / rated torque)^m for the `EXPONENTS`: the clocks of fatigue with other m"""
    peak_Nm: Array
    temperature_degC: Array
    """NaN where unknown"""
    count: Array
    """(6, n) values behind each condition"""
    log_mean: Array
    """(6, n) mean logarithm of each of `CONDITIONS`; NaN where count is 0"""
    log_scatter: Array
    """(6, n) sum of squared deviations of the logarithm"""

    def __len__(self) -> int:
        return len(self.end_h)


def empty() -> Ledger:
    """A gear without a past."""
    none, conditions = np.empty(0), np.empty((len(CONDITIONS), 0))
    strain = np.empty((len(EXPONENTS), 0))
    return Ledger(none, none, none, none, none, none, none, strain, none, none, conditions, conditions, conditions)


def rows_of(gear: Gear, time_h: Array, hours: Array, columns: Mapping[str, Array]) -> Ledger:
    """One row per entry of `time_h`; missing columns and NaN are unknown, an unknown load counts as none.

    `columns` are those of a history file, or `stiffness_change` and its `stiffness_change_sd` instead of what
    `lost_stiffness` makes of the stiffness. The cubic mean torque stands in for the peak where that is missing, and
    the other way round.
    """
    unknown = np.full(time_h.shape, np.nan)
    speed = np.nan_to_num(np.abs(columns.get("speed_in_rpm", unknown)))
    mean = np.abs(columns.get("torque_cubic_mean_Nm", unknown))
    peak = np.abs(columns.get("torque_peak_Nm", unknown))
    mean = np.nan_to_num(np.where(np.isnan(mean), peak, mean))
    peak = np.maximum(np.where(np.isnan(peak), mean, peak), mean)
    turns = speed * 60.0 * hours
    law = damage_law(gear)
    factor, factor_sd = law.sharpened(*_loss(time_h, columns))
    per_hour = (1.0 - PEAK_SHARE) * law.per_hour(mean, speed) + PEAK_SHARE * law.per_hour(peak, speed)
    exponent = np.array(EXPONENTS)[:, None]
    load = (1.0 - PEAK_SHARE) * (mean / gear.rated_torque_Nm) ** exponent
    load = load + PEAK_SHARE * (peak / gear.rated_torque_Nm) ** exponent
    values = np.stack([columns.get(name, unknown) for name in CONDITIONS])
    known = np.isfinite(values) & (values > 0.0)
    warm = np.asarray(columns.get("temperature_degC", unknown), dtype=float)
    return Ledger(
        end_h=time_h,
        hours=hours,
        turns=turns,
        cubic_Nm3_h=mean**3 * turns,
        rated_h=bearing_use(gear, mean, speed) * warmth_factor(warm) * hours,
        fatigue=per_hour * hours * factor,
        fatigue_sd=per_hour * hours * factor_sd,
        strain=load * turns,
        peak_Nm=peak,
        temperature_degC=warm,
        count=known.astype(float),
        log_mean=np.log(np.where(known, values, 1.0)) + np.where(known, 0.0, np.nan),
        log_scatter=np.zeros_like(values),
    )


def _loss(time_h: Array, columns: Mapping[str, Array]) -> tuple[Array, Array]:
    """(n,) share of stiffness lost and its sd; 0 and 0 where nothing is known of it."""
    lost, sd = lost_stiffness(columns, time_h.size)
    if "stiffness_change" in columns:
        lost = -columns["stiffness_change"]
        sd = np.broadcast_to(columns.get("stiffness_change_sd", np.zeros(1)), lost.shape)
    return np.maximum(np.nan_to_num(lost), 0.0), np.where(np.isfinite(lost), np.nan_to_num(sd), 0.0)


def lost_stiffness(columns: Mapping[str, Array], rows: int) -> tuple[Array, Array]:
    """(n,) share of stiffness lost since a history's beginning, smoothed over the past, and its sd; NaN if unknown."""
    stiffness = columns.get("stiffness_Nm_per_rad", np.empty(0))
    known = np.flatnonzero(np.isfinite(stiffness) & (stiffness > 0.0))
    first = max(FIRST_ROWS, int(FIRST_SHARE * known.size))
    if known.size <= 2 * first:
        return np.full(rows, np.nan), np.full(rows, np.nan)
    values, width = stiffness[known], max(int(SMOOTHED_SHARE * known.size), FIRST_ROWS)
    total = np.concatenate(([0.0], np.cumsum(values)))
    since = np.maximum(np.arange(1, known.size + 1) - width, 0)
    count = np.arange(1, known.size + 1) - since
    level, base = (total[1:] - total[since]) / count, float(np.mean(values[:first]))
    scatter = 1.4826 * float(np.median(np.abs(np.diff(values)))) / math.sqrt(2.0)
    warm = columns.get("temperature_degC", np.full(rows, np.nan))[known]
    off = np.nan_to_num(warm - np.nanmean(warm[:first])) if np.isfinite(warm[:first]).any() else np.zeros(known.size)
    sd = np.hypot(scatter / base * np.sqrt(1.0 / count + 1.0 / first), STIFFNESS_PER_K_SD * off)
    lost = np.where(np.arange(known.size) < first, 0.0, np.maximum(1.0 - level / base, 0.0))
    at = np.maximum(np.searchsorted(known, np.arange(rows), side="right") - 1, 0)
    return np.asarray(lost[at]), np.asarray(sd[at])


def join(older: Ledger, newer: Ledger) -> Ledger:
    """Both, one after the other, merged to at most `MOST_ROWS` rows."""
    both = Ledger(*(np.concatenate((getattr(older, f.name), getattr(newer, f.name)), axis=-1) for f in fields(Ledger)))
    if len(both) <= MOST_ROWS:
        return both
    return merge(both, MOST_ROWS // 2)


def merge(rows: Ledger, most: int) -> Ledger:
    """At most `most` rows of about equal duration. Sums stay exact."""
    if len(rows) <= most:
        return rows
    until = np.cumsum(rows.hours)
    edges = np.searchsorted(until, until[-1] * np.arange(1, most) / most)
    starts = np.unique(np.concatenate(([0], edges)))
    starts = starts[starts < len(rows)]
    ends = np.append(starts[1:], len(rows)) - 1

    def total(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, starts, axis=-1))

    count = total(rows.count)
    filled = np.nan_to_num(rows.log_mean)
    mean = total(filled * rows.count) / np.where(count > 0, count, np.nan)
    wide = np.repeat(mean, np.diff(np.append(starts, len(rows))), axis=-1)
    scatter = total(rows.log_scatter + np.nan_to_num(rows.count * (filled - wide) ** 2))
    warm = np.isfinite(rows.temperature_degC)
    weight = total(np.where(warm, rows.hours, 0.0))
    heat = total(np.where(warm, rows.temperature_degC, 0.0) * rows.hours)
    return replace(
        rows,
        end_h=rows.end_h[ends],
        **{name: total(getattr(rows, name)) for name in SUMS},
        peak_Nm=np.maximum.reduceat(rows.peak_Nm, starts),
        temperature_degC=heat / np.where(weight > 0, weight, np.nan),
        count=count,
        log_mean=mean,
        log_scatter=scatter,
    )


def to_bytes(rows: Ledger) -> bytes:
    """For a checkpoint."""
    return packed(**{f.name: getattr(rows, f.name) for f in fields(Ledger)})


def from_bytes(blob: bytes) -> Ledger | None:
    """The ledger of `to_bytes`; None if the bytes are not one."""
    try:
        saved = unpacked(blob)
        kept = {f.name: saved[f.name] for f in fields(Ledger) if f.name != "fatigue_sd"}
        rows = Ledger(**kept, fatigue_sd=saved.get("fatigue_sd", 0.0 * kept["fatigue"]))
    except (BrokenArrays, KeyError, TypeError):
        return None
    length = rows.end_h.shape
    flat = all(getattr(rows, f.name).shape[-1:] == length for f in fields(Ledger))
    return rows if flat and rows.count.shape[:-1] == (len(CONDITIONS),) else None
