"""The noise model S(f) = sum of a_b (f / f0)^-b, b = 0..4, fitted to a spectrum, with standard deviations.

How the coefficients are found is in `noise_steps`; here tones are left out of them, and it is said how far to trust
them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.records import Array, Mask
from edge_daemon.sound.noise_steps import (
    BETAS,
    MAX_ITERATIONS,
    Bins,
    blurred_terms,
    five_point_start,
    positive_start,
    regularised,
    score_step,
    terms,
)
from edge_daemon.sound.spectrum import Spectrum
from edge_daemon.sound.tones import Tone, chance_limit, near, tones_in, widened

TOLERANCE_SD = 0.01
"""Iteration ends when the coefficients move by less than this share of their joint standard deviation."""
IDENTIFIED_SD = 1 / 3
"""A coefficient counts as identified when its sd is below this share of it: zero is then three sd away."""
TONE_PASSES = 6
"""Bins may still be left out or taken back in so many iterations."""
CHANCE_SD = 4.0
"""Scatter and correlation of bins count as seen from this many of their sd."""
MIN_BINS = 8
"""Five coefficients want more than five points to have an error."""


class NoiseError(BadInput):
    """One line: why this spectrum cannot be fitted."""


@dataclass(frozen=True, slots=True)
class NoiseFit:
    reference_hz: float
    value: Array
    """(5,) a_0..a_4 at f / reference_hz [unit^2/Hz]"""
    covariance: Array
    """(5, 5)"""
    averages: float
    iterations: int
    """of the regularised normal equations and of the likelihood together"""
    tones: tuple[Tone, ...]
    low_hz: float
    high_hz: float
    rms: float
    """of the modelled noise in the fitted band, tones left out"""
    rms_sd: float

    @property
    def sd(self) -> Array:
        """(5,) standard deviations of `value`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def identified(self) -> Mask:
        """(5,) whether the spectrum determines each coefficient."""
        identified: Mask = self.sd < IDENTIFIED_SD * np.abs(self.value)
        return identified

    @property
    def averages_needed(self) -> Array:
        """(5,) averages that would identify each coefficient in this band, were it as large as it seems here."""
        short = self.sd / (IDENTIFIED_SD * np.maximum(np.abs(self.value), 1e-300))
        return np.asarray(self.averages * short**2)

    def psd(self, frequency_hz: Array) -> Array:
        """(n,) the model at `frequency_hz`."""
        return terms(frequency_hz, self.reference_hz) @ self.value


def fit_noise(spectrum: Spectrum, reference_hz: float = 300.0, known_tones_hz: tuple[float, ...] = ()) -> NoiseFit:
    """The noise model of a spectrum whose frequencies ascend.

    `known_tones_hz` (shaft orders) are left out of the fit, and so are tones found. Raises `NoiseError` when fewer than
    MIN_BINS positive finite bins remain.

    A floor of 2e-8 and a part that falls with the square of the frequency, 3e-8 at 300 Hz, each value scattering as an
    average of 400 does:

    >>> rng, frequency_hz = np.random.default_rng(1), np.arange(10.0, 10_000.0, 10.0)
    >>> psd = (2e-8 + 3e-8 * (frequency_hz / 300.0) ** -2) * rng.gamma(400.0, 1 / 400.0, len(frequency_hz))
    >>> fit = fit_noise(Spectrum(frequency_hz, psd, averages=400.0))
    >>> bool(np.all(abs(fit.value - [2e-8, 0.0, 3e-8, 0.0, 0.0]) < 3 * fit.sd))
    True
    >>> round(float(fit.sd[0] / fit.value[0]), 4)
    0.0027
    """
    frequency, power, averages = _usable(spectrum)
    level = float(np.median(power))
    bins = Bins(blurred_terms(frequency, reference_hz, spectrum.bin_hz), power / level, averages)
    quiet = ~near(frequency, known_tones_hz)
    quiet = quiet if quiet.sum() >= MIN_BINS else np.ones(len(frequency), dtype=bool)
    start = five_point_start(frequency[quiet], bins.power[quiet], reference_hz)
    value, kept, iterations = _without_tones(bins, quiet, start)
    model = bins.columns @ value
    wider = _variance_factor(bins, model, kept, spectrum.bin_correlation)
    covariance = bins.chosen(kept).covariance(model[kept]) * wider
    width = np.gradient(frequency)
    square, rms_sd = _power(width @ bins.columns, value, covariance)
    return NoiseFit(
        reference_hz=reference_hz,
        value=value * level,
        covariance=covariance * level**2,
        averages=float(np.median(averages)),
        iterations=iterations,
        tones=tones_in(frequency, power, model * level, ~kept, width),
        low_hz=float(frequency[0]),
        high_hz=float(frequency[-1]),
        rms=math.sqrt(square * level),
        rms_sd=rms_sd * math.sqrt(level),
    )


def _usable(spectrum: Spectrum) -> tuple[Array, Array, Array]:
    """(m,) frequencies, densities and averages behind them where there is something to fit. Raises `NoiseError`."""
    frequency, power = spectrum.frequency_hz, spectrum.psd
    behind = np.broadcast_to(np.asarray(spectrum.averages, dtype=float), power.shape)
    good = np.isfinite(frequency) & np.isfinite(power) & (frequency > 0) & (power > 0) & (behind > 0)
    if good.sum() < MIN_BINS:
        raise NoiseError(f"{good.sum()} usable bins: expected at least {MIN_BINS}")
    return frequency[good], power[good], behind[good]


def _without_tones(bins: Bins, quiet: Mask, start: Array) -> tuple[Array, Mask, int]:
    """Fit, leaving out what stands above the fit by more than chance: value, bins kept, iterations."""
    limit = chance_limit(bins.averages)
    if not np.all(bins.columns @ start > 0):
        start = positive_start(bins.columns[quiet], bins.power[quiet], start)
    model = bins.columns @ start
    if not np.all(model > 0):
        model = np.maximum(model, 1e-3 * np.abs(model).max())
    kept = _enough(quiet & ~widened(bins.power > 3 * limit * model), quiet)
    weight = np.sqrt(bins.averages) / model
    value, count = regularised(bins.columns[kept], bins.power[kept], weight[kept], start)
    if not np.all(bins.columns @ value > 0):
        value = positive_start(bins.columns[kept], bins.power[kept], value)
    for turn in range(MAX_ITERATIONS):
        before, model = kept, bins.columns @ value
        if turn < TONE_PASSES:
            kept = _enough(quiet & ~widened(bins.power > limit * np.maximum(model, 1e-300)), kept)
        value, moved = score_step(bins.chosen(kept), value)
        count += 1
        if moved < TOLERANCE_SD and np.array_equal(before, kept):
            break
    return value, kept, count


def _enough(wanted: Mask, otherwise: Mask) -> Mask:
    return wanted if wanted.sum() >= max(MIN_BINS, len(wanted) // 2) else otherwise


def _variance_factor(bins: Bins, model: Array, kept: Mask, bin_correlation: float) -> float:
    """How much wider than of independent bins after the Gamma law the coefficients scatter, as far as it is seen."""
    scatter, beyond = _seen_scatter(bins, model, kept)
    return max(bin_correlation * (scatter if beyond else 1.0), _seen_correlation(bins, model, kept) * scatter)


def _seen_scatter(bins: Bins, model: Array, kept: Mask) -> tuple[float, bool]:
    """Variance of the bins about the fit over that of the Gamma law; whether it is more than chance allows."""
    some = bins.chosen(kept)
    square = float(np.sum(some.averages * (some.power / model[kept] - 1) ** 2)) / max(1, kept.sum() - 5)
    chance = math.sqrt(float(np.mean(2 + 6 / some.averages)) / kept.sum())
    return square, square > 1 + CHANCE_SD * chance


def _seen_correlation(bins: Bins, model: Array, kept: Mask) -> float:
    """`bin_correlation` from neighbours that hang together, as those of any window do; 1 unless it is beyond chance."""
    away = np.where(kept, np.sqrt(bins.averages) * (bins.power / model - 1), 0.0)
    together = [float(away[lag:] @ away[:-lag]) / max(float(away @ away), 1e-300) for lag in (1, 2)]
    return 1 + 2 * sum(together) if together[0] > CHANCE_SD / math.sqrt(kept.sum()) else 1.0


def _power(weights: Array, value: Array, covariance: Array) -> tuple[float, float]:
    """The noise's mean square in the band, and the sd of its root; `weights` (5,) integrate the columns."""
    square = max(float(weights @ value), 0.0)
    if square == 0:
        return 0.0, math.nan
    return square, 0.5 * math.sqrt(max(float(weights @ covariance @ weights), 0.0) / square)


def noise_json(fit: NoiseFit, unit: str = "1/Hz") -> Mapping[str, object]:
    """The fit as published by `edge-daemon noise --json`; `unit` of the coefficients."""
    coefficients = [
        {
            "beta": int(beta),
            "value": float(value),
            "sd": float(sd),
            "identified": bool(identified),
            "value_hz": float(value * fit.reference_hz**beta),
        }
        for beta, value, sd, identified in zip(BETAS, fit.value, fit.sd, fit.identified, strict=True)
    ]
    return {
        "reference_hz": fit.reference_hz,
        "coefficients": coefficients,
        "averages": fit.averages,
        "iterations": fit.iterations,
        "tones": [{"frequency_hz": tone.frequency_hz, "level": tone.level} for tone in fit.tones],
        "unit": unit,
    }
