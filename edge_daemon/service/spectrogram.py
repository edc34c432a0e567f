"""The sound of months as a picture: levels over time and frequency, small enough for a page, and what changed in it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edge_daemon.records import Array
from edge_daemon.sound.kept_sound import CURRENT, HourSpectrum, heard, regime_of
from edge_daemon.store.reader import StoreReader
from edge_daemon.text import short, shorts

MOST_SLOTS, MOST_BANDS = 180, 64
"""The picture has at most so many columns and rows: 12 000 levels, about 20 kB as they travel."""
HOUR_S = 3600.0
COMPARED_SHARE = 0.2
"""What changed is told from the first to the last fifth of the sound (guess)."""
LEAST_SLOTS = 3
"""A scatter is not told from fewer slots than these at each end."""
SURE_SD = 4.0
"""The loudest of sixty bands changes by three deviations in a year without a fault; by four in a hundred years."""


def sound_picture(store: Path, drive: str, asked: Mapping[str, str]) -> dict[str, Any]:
    """The kept sound of a drive over `since_s` to `until_s`, at one `regime` of speed. Raises ValueError."""
    since_s, until_s = (_number(asked, name, least) for name, least in (("since_s", 0.0), ("until_s", math.inf)))
    with StoreReader(store) as reader:
        spectra = heard(reader.states(f"{drive}/{CURRENT}"))
    within = [one for one in spectra if since_s <= one.time_s <= until_s]
    return picture(within, int(_number(asked, "regime", math.nan)) if asked.get("regime") else None)


def picture(spectra: Sequence[HourSpectrum], regime: int | None = None) -> dict[str, Any]:
    """`level_dB` (slots, bands) in decibels of 1/Hz over `time_s` and `frequency_hz`, at the regime most was heard in
    where none is asked for; `regimes` with their mean speeds; `change` of the band that changed most surely."""
    speeds: dict[int, list[float]] = {}
    for one in spectra:
        speeds.setdefault(regime_of(one.speed_rad_s), []).append(one.speed_rad_s)
    regimes = [[number, short(float(np.mean(known))), len(known)] for number, known in sorted(speeds.items())]
    if not speeds:
        return {"time_s": [], "frequency_hz": [], "level_dB": [], "regimes": [], "regime": None, "change": None}
    chosen = regime if regime in speeds else max(speeds, key=lambda number: (len(speeds[number]), number))
    own = [one for one in spectra if regime_of(one.speed_rad_s) == chosen]
    time_s, frequency_hz, level = _levels(own)
    return {
        "time_s": [round(at) for at in time_s.tolist()],
        "frequency_hz": shorts(frequency_hz),
        "level_dB": [[None if math.isnan(v) else round(2.0 * v) / 2.0 for v in row] for row in level.tolist()],
        "regimes": regimes,
        "regime": chosen,
        "change": _change(frequency_hz, level),
    }


def _levels(spectra: Sequence[HourSpectrum]) -> tuple[Array, Array, Array]:
    """Middles of slots and bands, and the mean density in each as a level; NaN where nothing was heard."""
    grid = np.unique(np.concatenate([one.frequency_hz for one in spectra]))
    per_band, hours = math.ceil(grid.size / MOST_BANDS), np.array([one.time_s for one in spectra]) // HOUR_S
    per_slot = max(math.ceil((hours[-1] - hours[0] + 1) / MOST_SLOTS), 1)
    slots, place = np.unique((hours - hours[0]) // per_slot, return_inverse=True)
    bands = math.ceil(grid.size / per_band)
    power, weight = np.zeros((slots.size, bands)), np.zeros((slots.size, bands))
    for slot, one in zip(place, spectra, strict=True):
        known = np.isfinite(one.psd)
        band = np.searchsorted(grid, one.frequency_hz[known]) // per_band
        np.add.at(power[slot], band, one.averages * one.psd[known])
        np.add.at(weight[slot], band, one.averages)
    with np.errstate(divide="ignore", invalid="ignore"):
        level = 10.0 * np.log10(power / weight)
    middle = [math.sqrt(part[0] * part[-1]) for part in np.split(grid, range(per_band, grid.size, per_band))]
    time_s = HOUR_S * (hours[0] + per_slot * (slots + 0.5))
    return time_s, np.array(middle), np.where(np.isfinite(level), level, np.nan)


def _change(frequency_hz: Array, level: Array) -> dict[str, Any] | None:
    """The band that changed most surely from the first to the last slots [dB], with its sd; None for too few."""
    few = int(COMPARED_SHARE * len(level))
    if few < LEAST_SLOTS:
        return None
    early, late = level[:few], level[-few:]
    known = np.isfinite(early).all(axis=0) & np.isfinite(late).all(axis=0)
    if not known.any():
        return None
    moved = np.mean(late, axis=0) - np.mean(early, axis=0)
    sd = np.sqrt((np.var(early, axis=0, ddof=1) + np.var(late, axis=0, ddof=1)) / few) + 0.1
    most = int(np.argmax(np.where(known, np.abs(moved) / sd, -1.0)))
    at = {
        "frequency_hz": short(float(frequency_hz[most])),
        "dB": short(float(moved[most])),
        "sd_dB": short(float(sd[most])),
    }
    return {**at, "sure": bool(abs(moved[most]) > SURE_SD * sd[most])}


def _number(asked: Mapping[str, str], name: str, otherwise: float) -> float:
    text = asked.get(name)
    try:
        number = otherwise if text is None else float(text)
    except ValueError as error:
        raise ValueError(f"{name}: {text!r}: expected a number") from error
    if text is not None and not math.isfinite(number):
        raise ValueError(f"{name}: {text!r}: expected a finite number")
    return number
