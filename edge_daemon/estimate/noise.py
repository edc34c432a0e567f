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
from edge_daemon.estimate.spectrum import BLUR, Spectrum
from edge_daemon.records import Array

Mask = NDArray[np.bool_]

BETAS = np.arange(5)
TOLERANCE = 1e-3
"""the normal equations are left to the likelihood when the modelled spectrum changes by less than this share"""
TOLERANCE_SD = 0.01
"""iteration ends when the coefficients move by less than this share of their joint standard deviation"""
LEAST_CURVATURE = 0.2
"""of the observed over the expected information, in its worst direction, for a step to trust it"""
MAX_HALVINGS = 30
MAX_ITERATIONS = 50
DAMPING = 1e-3
"""first regularisation of the normal equations, columns normalised to one; a tenth of it each iteration after"""
IDENTIFIED_SD = 1 / 3
"""a coefficient counts as identified when its sd is below this share of it: zero is then three sd away"""
TONE_FALSE_ALARM = 1e-3
"""chance that a spectrum without tones shows one"""
TONE_HALF_WIDTH = 2
"""bins of a Hann main lobe to either side of its centre"""
LOBE_FLOOR = 0.01
"""power of a tone's neighbour over its own from which it is a tone: side lobes of the window are a thousandth"""
DIP = 0.1
"""two tones are told apart where the power between them falls to this share of the weaker"""
TONE_PASSES = 6
"""iterations in which bins may still be left out or taken back"""
FEW_BINS = 3.0
"""times its relative variance: one coefficient from m bins of one average has an sd too small by about 1 + 3 / m"""
CHANCE_SD = 4.0
"""scatter and correlation of bins count as seen from this many of their sd"""
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

    @property
    def averages_needed(self) -> Array:
        """(5,) averages that would identify each coefficient in this band, were it as large as it seems here."""
        short = self.sd / (IDENTIFIED_SD * np.maximum(np.abs(self.value), 1e-300))
        return np.asarray(self.averages * short**2)

    def psd(self, frequency_hz: Array) -> Array:
        """(n,) the model at `frequency_hz`."""
        return terms(frequency_hz, self.reference_hz) @ self.value


def terms(frequency_hz: Array, reference_hz: float) -> Array:
    """(n, 5) columns (f / f0)^-b."""
    columns, inverse = np.ones((len(frequency_hz), len(BETAS))), reference_hz / frequency_hz
    for beta in BETAS[1:]:
        columns[:, beta] = columns[:, beta - 1] * inverse
    return columns


def blurred_terms(frequency_hz: Array, reference_hz: float, bin_hz: float) -> Array:
    """(n, 5) what a Hann window of `bin_hz` makes of the columns: a steep spectrum fills the bins above its own."""
    if bin_hz <= 0:
        return terms(frequency_hz, reference_hz)
    rows = [
        share * terms(frequency_hz + bins * bin_hz, reference_hz) for bins, share in zip((-1, 0, 1), BLUR, strict=True)
    ]
    return np.asarray(sum(rows))


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


@dataclass(frozen=True, slots=True)
class _Bins:
    """What the likelihood sees of a spectrum."""

    columns: Array
    """(n, 5)"""
    power: Array
    """(n,)"""
    averages: Array
    """(n,)"""

    def chosen(self, kept: Mask) -> _Bins:
        return _Bins(self.columns[kept], self.power[kept], self.averages[kept])

    def cost(self, model: Array) -> float:
        """Negative log likelihood of a spectrum that scatters as a Gamma law; inf where the model is not positive."""
        if not np.all(model > 0):
            return math.inf
        return float(np.sum(self.averages * (self.power / model + np.log(model))))

    def covariance(self, model: Array) -> Array:
        """(5, 5) after Fisher, for independent bins.

        Where few bins decide, a fit that comes out low states a low sd with it, and misses the truth too often: the
        information is that of a model raised by a few times its own variance.
        """
        rows = self.columns * (np.sqrt(self.averages) / model)[:, None]
        norm = np.sqrt((rows**2).sum(axis=0))
        orthogonal, upper = np.linalg.qr(rows / norm)
        doubt = (orthogonal**2).sum(axis=1) / self.averages
        raised = orthogonal / (1 + FEW_BINS * doubt)[:, None]
        back = np.linalg.inv(upper) / norm[:, None]
        return np.asarray(back @ np.linalg.inv(raised.T @ raised) @ back.T)


def score_step(bins: _Bins, value: Array) -> tuple[Array, float]:
    """(5,) coefficients after one step of Newton's, and how many of their joint sd it went.

    Fisher scoring (least squares with weights averages / S_model^2), turned by the curvature that was observed where
    that is positive: few averages would else take many steps. A step that would make the spectrum negative anywhere or
    the likelihood worse is halved.
    """
    model = bins.columns @ value
    weight = np.sqrt(bins.averages)
    rows = bins.columns * (weight / model)[:, None]
    norm = np.sqrt((rows**2).sum(axis=0))
    orthogonal, upper = np.linalg.qr(rows / norm)
    away = bins.power / model - 1
    onto = orthogonal.T @ (weight * away)
    curvature = orthogonal.T @ (orthogonal * (1 + 2 * away)[:, None])
    trusted = np.linalg.eigvalsh(curvature)[0] > LEAST_CURVATURE
    onto = np.asarray(np.linalg.solve(curvature, onto) if trusted else onto)
    step = np.linalg.solve(upper, onto) / norm
    cost = bins.cost(model)
    for halving in range(MAX_HALVINGS):
        if bins.cost(bins.columns @ (value + step * 0.5**halving)) <= cost:
            return value + step * 0.5**halving, 0.5**halving * float(np.linalg.norm(onto))
    return value, 0.0


def fit_noise(
    frequency_hz: Array,
    psd: Array,
    averages: float | Array,
    reference_hz: float = 300.0,
    *,
    known_tones_hz: tuple[float, ...] = (),
    bin_correlation: float = 1.0,
    bin_hz: float = 0.0,
) -> NoiseFit:
    """The noise model of a spectrum: (n,) ascending frequencies [Hz] and densities [unit^2/Hz].

    `averages` behind all bins or behind each, `bin_correlation` and `bin_hz` as in `Spectrum`. `known_tones_hz` (shaft
    orders) are left out of the fit, and so are tones found. Raises `NoiseError` when fewer than MIN_BINS positive
    finite bins remain.
    """
    behind = np.broadcast_to(np.asarray(averages, dtype=float), psd.shape)
    good = np.isfinite(frequency_hz) & np.isfinite(psd) & (frequency_hz > 0) & (psd > 0) & (behind > 0)
    frequency, power, behind = frequency_hz[good], psd[good], behind[good]
    if len(frequency) < MIN_BINS:
        raise NoiseError(f"{len(frequency)} usable bins: expected at least {MIN_BINS}")
    level = float(np.median(power))
    bins = _Bins(blurred_terms(frequency, reference_hz, bin_hz), power / level, behind)
    quiet = ~_near(frequency, known_tones_hz)
    quiet = quiet if quiet.sum() >= MIN_BINS else np.ones(len(frequency), dtype=bool)
    start = five_point_start(frequency[quiet], bins.power[quiet], reference_hz)
    value, kept, iterations = _without_tones(bins, quiet, start)
    model = bins.columns @ value
    scatter, beyond = _seen_scatter(bins, model, kept)
    wider = max(bin_correlation * (scatter if beyond else 1.0), _seen_correlation(bins, model, kept) * scatter)
    covariance = bins.chosen(kept).covariance(model[kept]) * wider
    width = np.gradient(frequency)
    weights = width @ bins.columns
    square = max(float(weights @ value), 0.0)
    rms_sd = 0.5 * math.sqrt(max(float(weights @ covariance @ weights), 0.0) / square) if square > 0 else math.nan
    return NoiseFit(
        reference_hz=reference_hz,
        value=value * level,
        covariance=covariance * level**2,
        averages=float(np.median(behind)),
        iterations=iterations,
        tones=_tones(frequency, power, model * level, ~kept, width),
        low_hz=float(frequency[0]),
        high_hz=float(frequency[-1]),
        rms=math.sqrt(square * level),
        rms_sd=rms_sd * math.sqrt(level),
    )


def _without_tones(bins: _Bins, quiet: Mask, start: Array) -> tuple[Array, Mask, int]:
    """Fit, leaving out what stands above the fit by more than chance: value, bins kept, iterations."""
    each, of_bin = np.unique(bins.averages, return_inverse=True)
    limit = (gammaincinv(each, 1 - TONE_FALSE_ALARM / len(bins.power)) / each)[of_bin]
    if not np.all(bins.columns @ start > 0):
        start = positive_start(bins.columns[quiet], bins.power[quiet], start)
    model = bins.columns @ start
    if not np.all(model > 0):
        model = np.maximum(model, 1e-3 * np.abs(model).max())
    kept = _enough(quiet & ~_widened(bins.power > 3 * limit * model), quiet)
    weight = np.sqrt(bins.averages) / model
    value, count = regularised(bins.columns[kept], bins.power[kept], weight[kept], start)
    if not np.all(bins.columns @ value > 0):
        value = positive_start(bins.columns[kept], bins.power[kept], value)
    for turn in range(MAX_ITERATIONS):
        before, model = kept, bins.columns @ value
        if turn < TONE_PASSES:
            kept = _enough(quiet & ~_widened(bins.power > limit * np.maximum(model, 1e-300)), kept)
        value, moved = score_step(bins.chosen(kept), value)
        count += 1
        if moved < TOLERANCE_SD and np.array_equal(before, kept):
            break
    return value, kept, count


def _enough(wanted: Mask, otherwise: Mask) -> Mask:
    return wanted if wanted.sum() >= max(MIN_BINS, len(wanted) // 2) else otherwise


def _seen_scatter(bins: _Bins, model: Array, kept: Mask) -> tuple[float, bool]:
    """Variance of the bins about the fit over that of the Gamma law; whether it is more than chance allows."""
    some = bins.chosen(kept)
    square = float(np.sum(some.averages * (some.power / model[kept] - 1) ** 2)) / max(1, kept.sum() - 5)
    chance = math.sqrt(float(np.mean(2 + 6 / some.averages)) / kept.sum())
    return square, square > 1 + CHANCE_SD * chance


def _seen_correlation(bins: _Bins, model: Array, kept: Mask) -> float:
    """`bin_correlation` from neighbours that hang together, as those of any window do; 1 unless it is beyond chance."""
    away = np.where(kept, np.sqrt(bins.averages) * (bins.power / model - 1), 0.0)
    together = [float(away[lag:] @ away[:-lag]) / max(float(away @ away), 1e-300) for lag in (1, 2)]
    return 1 + 2 * sum(together) if together[0] > CHANCE_SD / math.sqrt(kept.sum()) else 1.0


def _near(frequency: Array, tones_hz: tuple[float, ...]) -> Mask:
    near = np.zeros(len(frequency), dtype=bool)
    for tone_hz in tones_hz:
        at = int(np.clip(np.searchsorted(frequency, tone_hz), 1, len(frequency) - 1))
        width = frequency[at] - frequency[at - 1]
        near |= np.abs(frequency - tone_hz) < (TONE_HALF_WIDTH + 0.5) * width
    return near


def _widened(marks: Mask) -> Mask:
    """Marks with the window's main lobe around them; a spectrum of few bands has none."""
    if not marks.any() or len(marks) < 100:
        return marks
    wide: Mask = np.convolve(marks, np.ones(2 * TONE_HALF_WIDTH + 1), mode="same") > 0.5
    return wide


def _tones(frequency: Array, psd: Array, model: Array, marked: Mask, width: Array) -> tuple[Tone, ...]:
    """The tones in runs of marked bins, each where its power has its middle, with its rms above the noise; strongest
    first."""
    excess = psd - model
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(np.int8), [0]])))
    found = []
    for low, high in zip(edges[::2], edges[1::2], strict=True):
        for part in _lobes(excess, int(low), int(high)):
            square = float(excess[part] @ width[part])
            top = part.start + int(np.argmax(excess[part]))
            lobe = slice(max(part.start, top - TONE_HALF_WIDTH), min(part.stop, top + TONE_HALF_WIDTH + 1))
            power = np.maximum(excess[lobe], 0.0) * width[lobe]
            if square > 0 and power.any():
                found.append(Tone(float(power @ frequency[lobe] / power.sum()), math.sqrt(square)))
    return tuple(sorted(found, key=lambda tone: -tone.level))


def _lobes(excess: Array, low: int, high: int) -> list[slice]:
    """The run cut where it dips far below what stands to either side: two tones that touch."""
    top = low + int(np.argmax(excess[low:high]))
    for side in (range(top + TONE_HALF_WIDTH, high), range(top - TONE_HALF_WIDTH, low, -1)):
        far = [i for i in side if excess[i] > LOBE_FLOOR * excess[top]]
        if len(side) <= 1 or not far:
            continue
        peak = max(far, key=lambda i: float(excess[i]))
        first, last = sorted((top, peak))
        dip = first + int(np.argmin(excess[first : last + 1]))
        if low < dip < high and excess[dip] < DIP * excess[peak]:
            return [*_lobes(excess, low, dip), *_lobes(excess, dip, high)]
    return [slice(low, high)]


def fit_spectrum(spectrum: Spectrum, reference_hz: float, known_tones_hz: tuple[float, ...] = ()) -> NoiseFit:
    """`fit_noise` of an averaged spectrum. Raises `NoiseError`."""
    return fit_noise(
        spectrum.frequency_hz,
        spectrum.psd,
        spectrum.averages,
        reference_hz,
        known_tones_hz=known_tones_hz,
        bin_correlation=spectrum.bin_correlation,
        bin_hz=spectrum.bin_hz,
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
