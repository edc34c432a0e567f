"""The noise model S(f) = sum of a_b (f / f0)^-b, b = 0..4, fitted to a spectrum, with standard deviations.

Three steps. Five points give a start (article 1); regularised normal equations refine it (article 2); the maximum
likelihood fit ends it: an averaged periodogram scatters as a Gamma law with sd S / sqrt(n), which plain least
squares ignores (Whittle, Estimation and information in stationary time series, Ark. Mat. 2 (1953)). Everything
happens at f / f0 with normalised columns: in hertz the five-point matrix has condition 1e9.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from edge_daemon.errors import BadInput
from edge_daemon.estimate.spectrum import Spectrum
from edge_daemon.records import Array

Mask = NDArray[np.bool_]

BETAS = np.arange(5)
TOLERANCE = 1e-6
"""iteration ends when the modelled spectrum changes by less than this share"""
MAX_ITERATIONS = 50
DAMPING = 1e-3
"""first regularisation of the normal equations, columns normalised to one; a tenth of it each iteration after"""
IDENTIFIED_SD = 1 / 3
"""a coefficient counts as identified when its sd is below this share of it: zero is then three sd away"""
TONE_FALSE_ALARM = 1e-3
"""chance that a spectrum without tones shows one"""
TONE_HALF_WIDTH = 2
"""bins of a Hann main lobe to either side of its centre"""
TONE_PASSES = 6
MIN_BINS = 8
"""five coefficients want more than five points to have an error"""


class NoiseError(BadInput):
    """One line: why this spectrum cannot be fitted."""


@dataclass(frozen=True, slots=True)
class Tone:
    frequency_hz: float
    level: float
    """rms, sensor unit"""


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

    def psd(self, frequency_hz: Array) -> Array:
        """(n,) the model at `frequency_hz`."""
        return terms(frequency_hz, self.reference_hz) @ self.value


def terms(frequency_hz: Array, reference_hz: float) -> Array:
    """(n, 5) columns (f / f0)^-b."""
    return np.asarray((frequency_hz / reference_hz)[:, None] ** -BETAS[None, :].astype(float))


def five_point_start(frequency_hz: Array, psd: Array, reference_hz: float) -> Array:
    """(5,) coefficients through five points (article 1, eq. F A = S).

    The points are Chebyshev nodes of log f, which keeps the matrix well conditioned; each is the median of psd over
    its neighbourhood, tilted to the node, so that neither a tone nor the scatter of one bin decides.
    """
    span = np.log(frequency_hz)
    middle, half = (span[0] + span[-1]) / 2, (span[-1] - span[0]) / 2
    nodes = middle + half * np.cos(np.pi * (2 * np.arange(5)[::-1] + 1) / 10)
    edges = np.searchsorted(span, np.concatenate([[span[0]], (nodes[1:] + nodes[:-1]) / 2, [span[-1] + 1]]))
    points, levels = [], []
    for node, low, high in zip(nodes, edges[:-1], edges[1:], strict=True):
        near = np.arange(low, max(high, low + 1)).clip(0, len(span) - 1)
        closest = near[np.argsort(np.abs(span[near] - node), kind="stable")[: max(3, len(near) // 4)]]
        points.append(float(np.exp(np.median(span[closest]))))
        levels.append(float(np.median(psd[closest])))
    matrix = terms(np.array(points), reference_hz) / np.array(levels)[:, None]
    return np.asarray(np.linalg.lstsq(matrix, np.ones(5), rcond=None)[0])


def regularised(columns: Array, psd: Array, weight: Array, start: Array) -> tuple[Array, int]:
    """(5,) coefficients by (J'J + lambda I) delta = J'(S - S_model) (article 2), and the number of iterations.

    `weight` (n,) multiplies the rows; columns are normalised, and lambda fades, so that it ends unbiased.
    """
    rows = columns * weight[:, None]
    norm = np.sqrt((rows**2).sum(axis=0))
    rows = rows / norm
    normal, target = rows.T @ rows, psd * weight
    scaled, damping, count = start * norm, DAMPING, 0
    while count < MAX_ITERATIONS:
        count += 1
        step = np.linalg.solve(normal + damping * np.eye(5), rows.T @ (target - rows @ scaled))
        scaled = scaled + step
        damping /= 10
        if np.max(np.abs(rows @ step)) < TOLERANCE * np.max(np.abs(target)):
            break
    return np.asarray(scaled / norm), count


def positive_start(columns: Array, psd: Array, start: Array) -> Array:
    """(5,) non-negative coefficients near `start` whose spectrum is positive everywhere.

    Multiplicative steps that never leave the positive side (Fevotte, Bertin & Durrieu, Neural Computation 21 (2009),
    Itakura-Saito divergence).
    """
    floor = 1e-3 * np.median(psd / columns.sum(axis=1))
    value = np.maximum(start, floor)
    for _ in range(20):
        model = columns @ value
        value = value * np.sqrt((columns.T @ (psd / model**2)) / (columns.T @ (1 / model)))
    return np.asarray(value)


def likelihood(columns: Array, psd: Array, start: Array) -> tuple[Array, Array, int]:
    """(5,) coefficients that maximise the Gamma likelihood, (5, 5) Fisher information per average, iterations.

    Fisher scoring is least squares with weights 1 / S_model^2; a step that would make the spectrum negative anywhere
    or the likelihood worse is halved.
    """
    value = start if np.all(columns @ start > 0) else positive_start(columns, psd, start)
    model = columns @ value
    cost = float(np.sum(psd / model + np.log(model)))
    count = 0
    while count < MAX_ITERATIONS:
        count += 1
        rows = columns / model[:, None]
        norm = np.sqrt((rows**2).sum(axis=0))
        orthogonal, upper = np.linalg.qr(rows / norm)
        step = np.linalg.solve(upper, orthogonal.T @ (psd / model - 1)) / norm
        value, model, new_cost, moved = _damped(columns, psd, value, step, cost)
        done = moved < TOLERANCE or cost - new_cost < TOLERANCE**2 * len(psd)
        cost = new_cost
        if done:
            break
    rows = columns / model[:, None]
    return value, rows.T @ rows, count


def _damped(columns: Array, psd: Array, value: Array, step: Array, cost: float) -> tuple[Array, Array, float, float]:
    """The longest of step, step/2, ... that lowers the cost: new value, spectrum, cost, largest relative change."""
    before = columns @ value
    for halving in range(30):
        trial = value + step * 0.5**halving
        model = columns @ trial
        if np.all(model > 0):
            new_cost = float(np.sum(psd / model + np.log(model)))
            if new_cost <= cost:
                return trial, model, new_cost, float(np.max(np.abs(model / before - 1)))
    return value, before, cost, 0.0


def fit_noise(
    frequency_hz: Array,
    psd: Array,
    averages: float,
    reference_hz: float = 300.0,
    *,
    known_tones_hz: tuple[float, ...] = (),
    bin_correlation: float = 1.0,
) -> NoiseFit:
    """The noise model of a spectrum: (n,) ascending frequencies [Hz] and densities [unit^2/Hz].

    `known_tones_hz` (shaft orders) are left out of the fit, and so are tones found. Raises `NoiseError` when fewer
    than MIN_BINS positive finite bins remain.
    """
    good = np.isfinite(frequency_hz) & np.isfinite(psd) & (frequency_hz > 0) & (psd > 0)
    frequency, power = frequency_hz[good], psd[good]
    if len(frequency) < MIN_BINS or not averages > 0:
        raise NoiseError(f"{len(frequency)} usable bins, {averages} averages: expected at least {MIN_BINS} bins")
    level = float(np.median(power))
    power = power / level
    columns = terms(frequency, reference_hz)
    quiet = ~_near(frequency, known_tones_hz)
    quiet = quiet if quiet.sum() >= MIN_BINS else np.ones(len(frequency), dtype=bool)
    start = five_point_start(frequency[quiet], power[quiet], reference_hz)
    value, information, kept, iterations = _without_tones(columns, power, quiet, start, averages)
    model = columns @ value
    covariance = _inverse(information * averages / bin_correlation)
    width = np.gradient(frequency)
    weights = width @ columns
    square = max(float(weights @ value), 0.0)
    rms_sd = 0.5 * math.sqrt(max(float(weights @ covariance @ weights), 0.0) / square) if square > 0 else math.nan
    return NoiseFit(
        reference_hz=reference_hz,
        value=value * level,
        covariance=covariance * level**2,
        averages=averages,
        iterations=iterations,
        tones=_tones(frequency, power * level, model * level, ~kept, width),
        low_hz=float(frequency[0]),
        high_hz=float(frequency[-1]),
        rms=math.sqrt(square * level),
        rms_sd=rms_sd * math.sqrt(level),
    )


def _without_tones(
    columns: Array, power: Array, quiet: Mask, start: Array, averages: float
) -> tuple[Array, Array, Mask, int]:
    """Fit, leave out what stands above the fit by more than chance, fit again: value, information, kept, iterations."""
    limit = float(gammaincinv(averages, 1 - TONE_FALSE_ALARM / len(power))) / averages
    model = columns @ start
    if np.any(model <= 0):
        start = positive_start(columns[quiet], power[quiet], start)
        model = columns @ start
    kept = quiet & ~_widened(power > 3 * limit * model)
    kept = kept if kept.sum() >= max(MIN_BINS, len(power) // 2) else quiet
    weight = 1 / model[kept]
    value, count = regularised(columns[kept], power[kept], weight, start)
    for _ in range(TONE_PASSES):
        value, information, more = likelihood(columns[kept], power[kept], value)
        count += more
        keep = quiet & ~_widened(power > limit * np.maximum(columns @ value, 1e-300))
        if np.array_equal(keep, kept) or keep.sum() < max(MIN_BINS, len(power) // 2):
            break
        kept = keep
    return value, information, kept, count


def _inverse(information: Array) -> Array:
    """Inverse of a badly scaled symmetric matrix."""
    norm = np.sqrt(np.diag(information))
    inverse: Array = np.linalg.pinv(information / np.outer(norm, norm), hermitian=True) / np.outer(norm, norm)
    return inverse


def _near(frequency: Array, tones_hz: tuple[float, ...]) -> Mask:
    width = float(np.median(np.diff(frequency)))
    near = np.zeros(len(frequency), dtype=bool)
    for tone_hz in tones_hz:
        near |= np.abs(frequency - tone_hz) < (TONE_HALF_WIDTH + 0.5) * width
    return near


def _widened(marks: Mask) -> Mask:
    """Marks with the window's main lobe around them; a spectrum of few bands has none."""
    if not marks.any() or len(marks) < 100:
        return marks
    wide: Mask = np.convolve(marks, np.ones(2 * TONE_HALF_WIDTH + 1), mode="same") > 0.5
    return wide


def _tones(frequency: Array, psd: Array, model: Array, marked: Mask, width: Array) -> tuple[Tone, ...]:
    """One tone per run of marked bins: where it peaks and its rms above the noise; strongest first."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(np.int8), [0]])))
    found = []
    for low, high in zip(edges[::2], edges[1::2], strict=True):
        excess = (psd - model)[low:high]
        square = float(excess @ width[low:high])
        if square > 0:
            found.append(Tone(float(frequency[low + int(np.argmax(excess))]), math.sqrt(square)))
    return tuple(sorted(found, key=lambda tone: -tone.level))


def fit_spectrum(spectrum: Spectrum, reference_hz: float, known_tones_hz: tuple[float, ...] = ()) -> NoiseFit:
    """`fit_noise` of an averaged spectrum. Raises `NoiseError`."""
    return fit_noise(
        spectrum.frequency_hz,
        spectrum.psd,
        spectrum.averages,
        reference_hz,
        known_tones_hz=known_tones_hz,
        bin_correlation=spectrum.bin_correlation,
    )


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
