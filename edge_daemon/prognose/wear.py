"""How well a trend of condition fits each possible end: curves of wear on a grid, their size integrated out.

Wear at the used share z of a capacity is a D^p with D = -log(1 - z (1 - e^-f)) / f. D solves dD/dz ~ exp(f D), D = 1 at
z = 1: the articles' law, whose rate grows by (1 - gamma dK)^-m, with the feedback f = m gamma dK at failure. A negative
f is wear that settles. The size a at failure has a lognormal prior and a Gaussian likelihood; its integral is
Laplace's, which needs no sampling, so that the same history always gives the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge_daemon.records import Array
from edge_daemon.usage.evidence import TrendEvidence

FEEDBACKS = np.array([-4.0, -2.5, -1.2, 0.001, 1.0, 2.0, 3.0, 4.5, 6.5])
LOG_RISES = np.linspace(-0.8, 1.9, 15)
SHAPES = np.stack(np.meshgrid(FEEDBACKS, LOG_RISES, indexing="ij"), axis=-1).reshape(-1, 2)
"""(shapes, 2) feedback f and log p: a step of p is below what a trend over half a life tells apart"""
NEWTON_STEPS = 5
LONGEST_STEP = 1.0
LARGEST = 0.95
"""No relative loss is larger: nothing loses more than it has."""


@dataclass(frozen=True, slots=True)
class Belief:
    """Normal belief on (feedback, log p, log size at failure) of one condition."""

    mean: Array
    """(3,)"""
    cover: Array
    """(3, 3)"""


@dataclass(frozen=True, slots=True)
class Curves:
    """All curves of wear against one trend, (ends, shapes) each."""

    dot: Array
    """whitened trend times whitened curve: log likelihood = dot a - precision a^2 / 2 + constant"""
    precision: Array
    middle: Array
    """mean of the curve where the condition is told relative to its mean; 0 where it is a logarithm"""
    constant: float
    """log likelihood of no wear at all"""


@dataclass(frozen=True, slots=True)
class Weights:
    """Of each end and shape, (ends, shapes): log evidence, and what is then known of the log size."""

    log: Array
    log_size: Array
    variance: Array

    def ends(self) -> Array:
        """(ends,) log evidence of each end."""
        return log_sum(self.log, axis=1)


def curves_of(
    trend: TrendEvidence, used: Array, left: Array, other: Array | None = None, other_sd: float = 0.0
) -> Curves:
    """Curves of a trend whose clock stood at the shares `used` (n,) of its present value; one end for each entry of
    `left`, remaining over used life. `other` (k,): a course that may add itself to the trend, `other_sd` times."""
    share = used[trend.rows][None, None, :] / (1.0 + left)[:, None, None]
    reach = np.expm1(-FEEDBACKS)[None, :, None]
    damage = np.log(1.0 + share * reach) / -FEEDBACKS[None, :, None]
    log_damage = np.log(np.maximum(damage, 1e-12))[:, :, None, :]
    curve = np.exp(np.exp(LOG_RISES)[None, None, :, None] * log_damage).reshape(left.size, len(SHAPES), -1)
    whitener, constant = trend.whitener, 0.0
    if other is not None and other_sd > 0.0:
        along = other_sd * (whitener @ other)
        length = float(along @ along)
        if length > 0.0:
            whitener = whitener - (1.0 - (1.0 + length) ** -0.5) / length * np.outer(along, along @ whitener)
            constant = -0.5 * float(np.log1p(length))
    white = curve.reshape(-1, curve.shape[-1]) @ whitener.T
    seen = whitener @ trend.y
    shape = curve.shape[:2]
    return Curves(
        (white @ seen).reshape(shape),
        np.einsum("ij,ij->i", white, white).reshape(shape),
        curve.mean(axis=-1) if trend.relative else np.zeros(shape),
        constant - 0.5 * float(seen @ seen),
    )


def weigh(curves: Curves, belief: Belief) -> Weights:
    """The belief applied to every curve."""
    shape_cover, lean = belief.cover[:2, :2], np.linalg.solve(belief.cover[:2, :2], belief.cover[:2, 2])
    off = SHAPES - belief.mean[:2]
    log_shape = -0.5 * np.einsum("ij,ij->i", off @ np.linalg.inv(shape_cover), off)
    log_shape -= log_sum(log_shape, axis=0)
    mean = belief.mean[2] + off @ lean
    sd = float(np.sqrt(belief.cover[2, 2] - belief.cover[2, :2] @ lean))
    near = log_shape > log_shape.max() - 20.0
    dot, precision, middle = (part[:, near] for part in (curves.dot, curves.precision, curves.middle))
    log_size = _start(dot, precision, middle, mean[near], sd)
    for _ in range(NEWTON_STEPS):
        size, slope = _amplitude(log_size, middle)
        pull = (dot - precision * size) * slope - (log_size - mean[near]) / sd**2
        step = pull / (precision * slope**2 + sd**-2.0)
        log_size = log_size + np.clip(step, -LONGEST_STEP, LONGEST_STEP)
    size, slope = _amplitude(log_size, middle)
    least = precision * slope**2 + sd**-2.0
    bend = np.maximum(least - (dot - precision * size) * slope * (1.0 + 2.0 * size * middle), 0.3 * least)
    fit = (dot - 0.5 * precision * size) * size - 0.5 * ((log_size - mean[near]) / sd) ** 2
    log = np.full(curves.dot.shape, -np.inf)
    log[:, near] = fit - np.log(sd) - 0.5 * np.log(bend) + log_shape[near] + curves.constant
    sizes, variance = np.zeros_like(log), np.zeros_like(log)
    sizes[:, near], variance[:, near] = log_size, 1.0 / bend
    return Weights(log, sizes, variance)


def _start(dot: Array, precision: Array, middle: Array, mean: Array, sd: float) -> Array:
    """Log size between the fitted one and the believed one, by how well each is known."""
    fitted = np.maximum(dot / precision, 1e-6)
    log_fitted = np.log(fitted / (1.0 + fitted * middle))
    known = precision * (fitted * (1.0 + fitted * middle)) ** 2 * (dot > 0.0)
    return np.asarray((known * log_fitted + mean / sd**2) / (known + sd**-2.0))


def _amplitude(log_size: Array, middle: Array) -> tuple[Array, Array]:
    """What multiplies the curve in a trend told relative to its mean, a / (1 - a middle), and its slope over log a."""
    size = np.exp(log_size)
    size = size / (1.0 - np.minimum(size * middle, LARGEST))
    return size, size * (1.0 + size * middle)


def log_sum(log: Array, axis: int) -> Array:
    """Logarithm of the sum of exponentials; minus infinity where there is nothing."""
    most = np.max(log, axis=axis, keepdims=True)
    most = np.where(np.isfinite(most), most, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.squeeze(most, axis) + np.log(np.sum(np.exp(log - most), axis=axis)))
