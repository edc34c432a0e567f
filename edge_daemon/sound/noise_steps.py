"""The columns of the noise model, and the three steps by which their coefficients are found.

Five points give a start (article 1); regularised normal equations refine it (article 2); the maximum likelihood fit
ends it: an averaged periodogram scatters as a Gamma law with sd S / sqrt(n), which plain least squares ignores
(Whittle, Estimation and information in stationary time series, Ark. Mat. 2 (1953)). Everything happens at f / f0 with
normalised columns: in hertz the five-point matrix has condition 1e9.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.records import Array, Mask
from edge_daemon.sound.spectrum import BLUR

BETAS = np.arange(5)
MAX_ITERATIONS = 50
TOLERANCE = 1e-3
"""The normal equations are left to the likelihood when the modelled spectrum changes by less than this share."""
DAMPING = 1e-3
"""First regularisation of the normal equations, columns normalised to one; a tenth of it each iteration after."""
LEAST_CURVATURE = 0.2
"""A step trusts the observed information where it is this share of the expected one in its worst direction."""
MAX_HALVINGS = 30
FEW_BINS = 3.0
"""One coefficient from m bins of one average has an sd too small by about 1 + 3 / m, which this times its relative
variance makes up for."""


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
class Bins:
    """What the likelihood sees of a spectrum."""

    columns: Array
    """(n, 5)"""
    power: Array
    """(n,)"""
    averages: Array
    """(n,)"""

    def chosen(self, kept: Mask) -> Bins:
        return Bins(self.columns[kept], self.power[kept], self.averages[kept])

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


def score_step(bins: Bins, value: Array) -> tuple[Array, float]:
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
