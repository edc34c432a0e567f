"""One drive as a person wants to see it: spectrum, loop, loads and life, small enough to send every second.

Computed only while somebody looks. Everything is plain data with numbers of four digits, ready for JSON.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.health.alarms import Alarm
from edge_daemon.prognose.forecast import Forecast, forecast
from edge_daemon.prognose.history import unused
from edge_daemon.prognose.life import LifeFollower
from edge_daemon.records import Array
from edge_daemon.service.pipeline import Pipeline
from edge_daemon.sound.noise_estimator import NoiseEstimator
from edge_daemon.text import short, shorts
from edge_daemon.track.live import DriveEstimator
from edge_daemon.usage.evidence import evidence_of
from edge_daemon.usage.gears import Gear

SPECTRUM_BINS = 240
"""The screen has so many bins, evenly spread over the logarithm of frequency."""
LOOP_POINTS = 400
SPRING_POINTS = 41
CURVE_POINTS = 41
LOAD_BARS = 24
HORIZONS_H = (168.0, 720.0, 2190.0, 8766.0)
"""A week, a month, a quarter, a year."""
LEAST_FACTOR, MOST_FACTOR = 0.2, 3.0
"""Beyond these multiples of the load so far the fatigue law was never meant to hold (guess)."""


def drive_view(pipeline: Pipeline) -> dict[str, Any]:
    """The newest picture of a drive: `noise`, `loop`, `load`, `model`; a part that is not known is None."""
    estimator, life = pipeline.estimator, pipeline.life
    return {
        "alarms": [_alarm(row) for row in pipeline.alarms],
        "channels": sorted(row.channel for row in pipeline.drive.channels),
        "noise": _noise(pipeline.noise),
        "loop": _loop(estimator, life.gear),
        "load": _loads(life),
        "model": _model(estimator),
        "gear": life.gear.name if life.gear else None,
        "observed_h": short(life.observed_h),
        "counted": life.counted,
    }


def what_if(life: LifeFollower, load_factor: float) -> dict[str, Any]:
    """Remaining life if the torque were `load_factor` times what it was. Takes some tens of milliseconds.

    Raises `BadInput` for a drive without a gear or a factor out of range.
    """
    if life.gear is None:
        raise BadInput(f"drive {life.drive}: no gear is configured: expected `gear` in its section")
    if not LEAST_FACTOR <= load_factor <= MOST_FACTOR:
        raise BadInput(f"factor: {load_factor:g}: expected {LEAST_FACTOR:g} to {MOST_FACTOR:g}")
    planned = _forecast(life, life.gear, load_factor)
    return {
        "factor": load_factor,
        "rul_h": {f"p{q}": short(planned.quantile_h(q / 100)) for q in (10, 50, 90)},
        "failure_probability": [
            {"within_h": hours, "probability": short(planned.failure_probability(hours))} for hours in HORIZONS_H
        ],
        "basis": "observed" if len(life.ledger) else "rated",
        "curve": _curve(planned),
    }


def _curve(planned: Forecast) -> dict[str, list[float | None]]:
    """Probability of failure over the hours ahead, up to where nine of ten have failed."""
    most_h = planned.quantile_h(0.9)
    hours = np.linspace(0.0, most_h, CURVE_POINTS) if math.isfinite(most_h) else np.empty(0)
    return {
        "within_h": shorts(hours),
        "probability": [short(planned.failure_probability(at)) for at in hours.tolist()],
    }


def _alarm(row: Alarm) -> dict[str, Any]:
    return {
        "key": row.key, "text": row.text, "rank": int(row.severity), "since_s": row.since_s,
        "acknowledged": row.acknowledged, "gone": row.gone,
    }  # fmt: skip


def _forecast(life: LifeFollower, gear: Gear, load_factor: float) -> Forecast:
    if not len(life.ledger):
        return forecast(gear, unused(gear, load_factor))
    return forecast(gear, evidence_of(life.ledger, 0.0, load_factor))


def _noise(noise: NoiseEstimator | None) -> dict[str, Any] | None:
    spectrum = noise.spectrum if noise else None
    if noise is None or spectrum is None:
        return None
    frequency_hz, psd = log_binned(spectrum.frequency_hz, spectrum.psd, SPECTRUM_BINS)
    fit = noise.fit
    return {
        "frequency_hz": shorts(frequency_hz),
        "psd": shorts(psd),
        "fit": shorts(fit.psd(frequency_hz)) if fit else None,
        "reference_hz": fit.reference_hz if fit else None,
        "baseline": shorts(_curve_of(noise.baseline.known, frequency_hz / noise.reference_hz)),
        "baseline_in_s": short(max(noise.baseline.after_s - noise.baseline.heard_s, 0.0)),
        "averages": short(float(np.mean(spectrum.averages))),
        "tones": [[short(tone.frequency_hz), short(tone.level)] for tone in fit.tones] if fit else [],
    }


def _curve_of(coefficients: Array | None, f: Array) -> Array:
    """S(f) of five coefficients, at frequencies relative to the reference; empty where they are not known."""
    if coefficients is None:
        return np.empty(0)
    return np.asarray(sum(a * f**-b for b, a in enumerate(coefficients.tolist())))


def log_binned(frequency_hz: Array, psd: Array, bins: int) -> tuple[Array, Array]:
    """Means of a density over bins that are equally wide in log frequency; empty bins are left out."""
    good = frequency_hz > 0
    frequency_hz, psd = frequency_hz[good], psd[good]
    if len(frequency_hz) <= bins:
        return frequency_hz, psd
    place = np.log(frequency_hz / frequency_hz[0]) / math.log(frequency_hz[-1] / frequency_hz[0]) * (bins - 1)
    number = place.round().astype(int)
    count = np.bincount(number, minlength=bins)
    filled = count > 0
    sums = (np.bincount(number, weights=values, minlength=bins)[filled] for values in (frequency_hz, psd))
    middle, mean = (total / count[filled] for total in sums)
    return middle, mean


def _loop(estimator: DriveEstimator, gear: Gear | None) -> dict[str, Any] | None:
    if estimator.model.balance != "torsion":
        return None
    twist, torque = estimator.loop()
    if not len(twist):
        return None
    every = max(1, len(twist) // LOOP_POINTS)
    reach = float(np.nanmax(np.abs(twist))) if np.isfinite(twist).any() else 0.0
    return {
        "twist_rad": shorts(twist[::every]),
        "torque_Nm": shorts(torque[::every]),
        "spring": _spring(estimator, reach),
        "maker": _maker(gear),
        "maker_name": gear.name if gear else None,
    }


def _spring(estimator: DriveEstimator, reach_rad: float) -> dict[str, list[float | None]] | None:
    """The stiffness curve with two standard deviations to either side, over the twists seen now."""
    twist = np.linspace(-reach_rad, reach_rad, SPRING_POINTS)
    found = estimator.spring(twist) if reach_rad > 0 else None
    if found is None:
        return None
    torque, sd = found
    return {
        "twist_rad": shorts(twist), "torque_Nm": shorts(torque),
        "low_Nm": shorts(torque - 2 * sd), "high_Nm": shorts(torque + 2 * sd),
    }  # fmt: skip


def _maker(gear: Gear | None) -> list[list[float | None]] | None:
    """Corners of the maker's curve as (twist [rad], torque [N m]) from zero up to the last known limit."""
    if gear is None or gear.stiffness_1_Nm_per_rad is None:
        return None
    k1, t1 = gear.stiffness_1_Nm_per_rad, gear.corner_1_Nm
    if t1 is None:
        return [[0.0, 0.0], [short(gear.rated_torque_Nm / k1), gear.rated_torque_Nm]]
    rows: list[list[float | None]] = [[0.0, 0.0], [short(t1 / k1), t1]]
    at, from_Nm = t1 / k1, t1
    ends = ((gear.stiffness_2_Nm_per_rad, gear.corner_2_Nm), (gear.stiffness_3_Nm_per_rad, gear.repeated_peak_Nm))
    for stiffness, until in ends:
        if stiffness is None or until is None or until <= from_Nm:
            break
        at += (until - from_Nm) / stiffness
        from_Nm = until
        rows.append([short(at), until])
    return rows


def _loads(life: LifeFollower) -> dict[str, Any] | None:
    """Cycles by torque range: middle of each bar [N m] and how many."""
    ranges, counts = life.cycles.cycles()
    if not len(ranges):
        return None
    width = float(ranges[-1]) / LOAD_BARS or 1.0
    number = np.minimum((ranges / width).astype(int), LOAD_BARS - 1)
    total = np.bincount(number, weights=counts, minlength=LOAD_BARS)
    middle: Array = np.asarray((np.arange(LOAD_BARS) + 0.5) * width, dtype=float)
    gear = life.gear
    limits = [[name, limit] for name, limit in gear.limits] if gear else []
    return {
        "range_Nm": shorts(middle),
        "cycles": shorts(total.astype(float)),
        "peak_Nm": short(life.peak_Nm),
        "rated_Nm": gear.rated_torque_Nm if gear else None,
        "limits": limits,
    }


def _model(estimator: DriveEstimator) -> dict[str, Any]:
    model = estimator.model
    return {
        "balance": model.balance,
        "effects": [row.name for row in model.effects],
        "lineage": [{"change": row.change, "nrmse": short(row.nrmse)} for row in model.lineage],
    }
