"""How long a gear still lives: one posterior from the maker's data, the load so far and the observed wear.

Two risks compete: fatigue of the flexspline and wear of the wave generator bearing, each a clock of use that ends at
an unknown capacity. Wear shows as stiffness lost and noise gained; both grow as w z + (1 - w) z^p with the used share
z of a capacity. An ensemble of gears with unknown capacities, sizes and shapes is drawn from the prior and moved to
the posterior by tempered sequential Monte Carlo (Del Moral, Doucet and Jasra 2006), which needs no tuning per gear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.special import ndtr, ndtri

from edge_daemon.prognose.bearing import Weibull, bearing_law
from edge_daemon.prognose.evidence import Evidence, Trend
from edge_daemon.prognose.gears import Gear
from edge_daemon.records import Array

PARTICLES = 1500
MOVES = 3
"""Metropolis steps after each resampling"""
MOST_STAGES = 40
MOST_LIFE_H = 1e6
"""a longer life is told as this one: a century, beyond any use"""
SEED = 1993

NORMAL_PRIOR = {
    # name: mean, sd of a parameter on its unbounded scale; guesses, replaced by what histories of one's own teach
    "log_fatigue": (0.0, 0.8),
    "log_loss": (-1.8, 0.5),
    "logit_line": (-1.0, 1.2),
    "log_bend": (0.7, 0.6),
    "log_noise": (0.2, 0.6),
    "logit_noise_line": (-1.0, 1.2),
    "log_noise_bend": (0.7, 0.6),
    "log_bearing_loss": (-3.5, 1.0),
    "log_fatigue_noise": (-1.0, 0.8),
}
"""fatigue capacity over the maker's law; stiffness lost at failure and its shape; noise gained (logarithm) and its
shape; stiffness that bearing wear costs; noise that fatigue makes"""
DOUBT = 0.35
"""prior chance that the maker's fatigue law is far off for this load; only stiffness measurements can tell"""
DOUBT_LIFE_H = 30_000.0
DOUBT_SD = 1.3
"""what is then believed of the fatigue life at the present load: the order of a bearing's life"""

_NAMES = ("log_bearing", *NORMAL_PRIOR)
_COLUMN = {name: column for column, name in enumerate(_NAMES)}


@dataclass(frozen=True, slots=True)
class Forecast:
    """The posterior as equally likely gears, (n,) each."""

    remaining_h: Array
    fatigue_used: Array
    """share of the flexspline's capacity that is used"""
    bearing_used: Array
    bearing_first: Array
    """1 where the bearing fails before the flexspline"""

    def quantile_h(self, probability: float) -> float:
        """Remaining life [h] that the fraction `probability` of such gears does not reach."""
        return float(np.quantile(self.remaining_h, probability))

    def failure_probability(self, within_h: float) -> float:
        """Chance of failure in the next `within_h` hours."""
        return float(np.mean(self.remaining_h <= within_h))


def forecast(gear: Gear, evidence: Evidence, seed: int = SEED, particles: int = PARTICLES) -> Forecast:
    """The posterior of a gear's end. Deterministic for a given seed."""
    problem = _Problem(gear, evidence)
    gears = _sample(problem, np.random.default_rng(seed), particles)
    fatigue = np.exp(gears[:, _COLUMN["log_fatigue"]])
    bearing = np.exp(gears[:, _COLUMN["log_bearing"]])
    with np.errstate(divide="ignore", over="ignore"):
        fatigue_h = (fatigue - evidence.fatigue_now) / evidence.fatigue_rate if evidence.fatigue_rate else np.inf
        bearing_h = (bearing - evidence.rated_now_h) / evidence.rated_rate if evidence.rated_rate else np.inf
    left = np.clip(np.minimum(fatigue_h, bearing_h), 0.0, MOST_LIFE_H) * np.ones(len(gears))
    return Forecast(
        left,
        evidence.fatigue_now / fatigue,
        evidence.rated_now_h / bearing,
        np.asarray(bearing_h < fatigue_h, dtype=float) * np.ones(len(gears)),
    )


class _Problem:
    """Prior and likelihood over (n, 10) parameters, columns as in `_NAMES`."""

    def __init__(self, gear: Gear, evidence: Evidence) -> None:
        self.evidence = evidence
        self.bearing: Weibull = bearing_law(gear)
        self.mean = np.array([row[0] for row in NORMAL_PRIOR.values()])
        self.sd = np.array([row[1] for row in NORMAL_PRIOR.values()])
        self.doubt = DOUBT if evidence.stiffness is not None and evidence.fatigue_rate > 0.0 else 0.0
        per_hour = evidence.fatigue_now / evidence.age_h if evidence.fatigue_now else 1.0
        self.doubt_mean = float(np.log(DOUBT_LIFE_H * per_hour))
        with np.errstate(divide="ignore"):
            self.log_fatigue = np.log(evidence.fatigue)
            self.log_rated = np.log(evidence.rated_h)

    def draw(self, rng: Generator, count: int) -> Array:
        """Gears from the prior that have survived their use so far."""
        gears = np.empty((count, len(_NAMES)))
        gears[:, 1:] = rng.normal(self.mean, self.sd, (count, len(self.mean)))
        used = self.evidence.rated_now_h
        uniform = rng.uniform(size=count)
        gears[:, 0] = np.log(used + np.maximum(self.bearing.remaining(used, uniform), 1e-9))
        doubtful = rng.uniform(size=count) < self.doubt
        mean = np.where(doubtful, self.doubt_mean, self.mean[0])
        sd = np.where(doubtful, DOUBT_SD, self.sd[0])
        if self.evidence.fatigue_now > 0.0:
            lowest = (np.log(self.evidence.fatigue_now) - mean) / sd
            survivors = ndtr(-lowest)
            z = -ndtri(np.maximum(survivors * rng.uniform(size=count), 1e-300))
            gears[:, 1] = np.maximum(mean + sd * z, np.log(self.evidence.fatigue_now) + 1e-9)
        return gears

    def log_prior(self, gears: Array) -> Array:
        """(n,) up to a constant; minus infinity for a gear that should have failed already."""
        capacity = self.bearing.shape * (gears[:, 0] - np.log(self.bearing.scale_h))
        total = capacity - np.exp(capacity)
        z = (gears[:, 1:] - self.mean) / self.sd
        total -= 0.5 * np.sum(z[:, 1:] ** 2, axis=1)
        law = (1.0 - self.doubt) / self.sd[0] * np.exp(-0.5 * z[:, 0] ** 2)
        other = self.doubt / DOUBT_SD * np.exp(-0.5 * ((gears[:, 1] - self.doubt_mean) / DOUBT_SD) ** 2)
        with np.errstate(divide="ignore"):
            total += np.log(law + other)
            dead = (gears[:, 0] <= np.log(self.evidence.rated_now_h)) | (
                gears[:, 1] <= np.log(self.evidence.fatigue_now)
            )
        return np.where(dead | ~np.isfinite(total), -np.inf, total)

    def log_likelihood(self, gears: Array) -> Array:
        """(n,) of the observed trends."""
        total = np.zeros(len(gears))
        stiffness, noise = self.evidence.stiffness, self.evidence.noise
        if stiffness is None and noise is None:
            return total
        column = {name: gears[:, i : i + 1] for name, i in _COLUMN.items()}
        fatigue = _grown(self.log_fatigue, column["log_fatigue"], column["logit_line"], column["log_bend"])
        wear = _grown(self.log_rated, column["log_bearing"], column["logit_noise_line"], column["log_noise_bend"])
        if stiffness is not None:
            lost = np.exp(column["log_loss"]) * fatigue + np.exp(column["log_bearing_loss"]) * wear
            total += _fit(stiffness, np.log1p(-np.minimum(lost, 0.95)))
        if noise is not None:
            gained = np.exp(column["log_noise"]) * wear + np.exp(column["log_fatigue_noise"]) * fatigue
            total += _fit(noise, gained)
        return total


def _grown(log_clock: Array, log_capacity: Array, logit_line: Array, log_bend: Array) -> Array:
    """(n, k) wear between 0 and 1: w z + (1 - w) z^p."""
    log_used = log_clock[None, :] - log_capacity
    line = 1.0 / (1.0 + np.exp(-logit_line))
    power = 1.0 + np.exp(np.clip(log_bend, -5.0, 4.0))
    return np.asarray(line * np.exp(log_used) + (1.0 - line) * np.exp(power * log_used))


def _fit(trend: Trend, model: Array) -> Array:
    residual = trend.y[None, :] - model[:, trend.rows]
    return np.asarray(-0.5 * np.sum((residual @ trend.whitener.T) ** 2, axis=1))


def _sample(problem: _Problem, rng: Generator, count: int) -> Array:
    """Tempered sequential Monte Carlo: from the prior to the posterior in steps that keep half the ensemble alive."""
    gears = problem.draw(rng, count)
    likelihood = problem.log_likelihood(gears)
    prior = problem.log_prior(gears)
    heat = 0.0
    for _ in range(MOST_STAGES):
        if heat >= 1.0:
            break
        step = _next_step(likelihood, 1.0 - heat)
        heat += step
        weight = np.exp(step * (likelihood - likelihood.max()))
        chosen = _systematic(weight / weight.sum(), rng)
        gears, likelihood, prior = gears[chosen], likelihood[chosen], prior[chosen]
        spread = np.cov(gears.T) + 1e-10 * np.eye(gears.shape[1])
        lower = np.linalg.cholesky(spread)
        for move in range(MOVES):
            reach = (0.75, 0.35, 0.15)[move % 3]
            trial = gears + reach * rng.standard_normal(gears.shape) @ lower.T
            trial_prior = problem.log_prior(trial)
            trial_likelihood = np.where(np.isfinite(trial_prior), problem.log_likelihood(trial), -np.inf)
            gain = heat * (trial_likelihood - likelihood) + trial_prior - prior
            taken = np.log(rng.uniform(size=count)) < gain
            gears[taken] = trial[taken]
            likelihood[taken], prior[taken] = trial_likelihood[taken], trial_prior[taken]
    return gears


def _next_step(likelihood: Array, most: float) -> float:
    """The largest tempering step that keeps the effective sample size above half."""

    def effective(step: float) -> float:
        weight = np.exp(step * (likelihood - likelihood.max()))
        return float(weight.sum() ** 2 / np.sum(weight**2)) / len(likelihood)

    if effective(most) >= 0.5:
        return most
    low, high = 0.0, most
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle) >= 0.5 else (low, middle)
    return max(low, 1e-6 * most)


def _systematic(weight: Array, rng: Generator) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Indices of a systematic resampling."""
    count = len(weight)
    points = (rng.uniform() + np.arange(count)) / count
    return np.asarray(np.minimum(np.searchsorted(np.cumsum(weight), points), count - 1), dtype=np.int64)
