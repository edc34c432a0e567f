"""How long a gear still lives: one posterior from the maker's data, the load so far and the observed wear.

Two risks compete: fatigue of the flexspline and wear of the wave generator bearing, each a clock of use that ends at
an unknown capacity. Wear shows as stiffness lost and noise gained, and feeds back on its own rate. An ensemble of gears
with unknown capacities, sizes and shapes is drawn from the prior and moved to the posterior by tempered sequential
Monte Carlo (Del Moral, Doucet and Jasra 2006), which needs no tuning per gear.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.random import Generator
from scipy.special import logsumexp, ndtr, ndtri

from edge_daemon.prognose.bearing import Weibull, bearing_law
from edge_daemon.prognose.evidence import Evidence, Trend
from edge_daemon.prognose.gears import Gear
from edge_daemon.prognose.ledger import EXPONENTS
from edge_daemon.records import Array

PARTICLES = 2000
MOST_MOVES, ENOUGH_MOVES = 32, 5.0
"""Metropolis steps after each resampling: at most, and how many each gear should have taken on average"""
REACHES = (2.4, 1.2, 0.5)
"""of the steps, in optimal ones for a round posterior (2.38 / sqrt(2 d), ter Braak 2006): shorter on a ridge"""
CROSSINGS = (1.0, 0.3, 0.6, 0.3)
"""share of the parameters that a step changes"""
JITTER = 1e-3
"""of each step: lets gears that were copies part"""
MOST_STAGES = 40
MOST_LIFE_H = 1e6
"""a longer life is told as this one: a century, beyond any use"""
SEED = 1993


@dataclass(frozen=True, slots=True)
class Prior:
    """What is believed of a gear before its own history speaks: normal on each parameter's unbounded scale."""

    mean: Array
    """(kinds, k) in the order of `NORMAL_PRIOR`: one row for each kind of gear that may have been built in"""
    cover: Array
    """(kinds, k, k) covariance"""
    weight: Array
    """(kinds,) how likely each kind is; their sum is 1"""
    doubt: float
    """chance, for each part, that these beliefs say nothing of this gear; see `DOUBT_AFTER_H`"""


NORMAL_PRIOR = {
    # name: mean, sd; guesses, replaced by what histories of one's own teach (`learn`)
    "log_fatigue": (0.0, 0.8),
    "log_exponent": (2.0, 0.35),
    "log_loss": (-1.65, 0.4),
    "feedback": (1.8, 1.5),
    "log_rise": (0.5, 0.5),
    "log_noise": (0.2, 0.6),
    "noise_feedback": (1.3, 1.5),
    "log_noise_rise": (0.5, 0.5),
    "log_bearing_loss": (-3.5, 1.0),
    "log_fatigue_noise": (-1.0, 0.8),
}
"""fatigue life over that of the maker's law and its exponent of torque; stiffness lost at failure and its shape;
noise gained (logarithm) and its shape; stiffness that bearing wear costs; noise that fatigue makes"""
DOUBT = 0.9
DOUBT_AFTER_H = 1000.0
"""prior chance, for each part, that the maker's law says nothing of this gear (mounting, lubricant, an unknown load):
0 for a new gear, `DOUBT` for an old one, half of it at `DOUBT_AFTER_H`; only if its condition is measured. Then
nothing is known but the age, and a life twice the present age is as likely as not (Gott 1993): density ~ T^-2. Guesses,
checked by the coverage that the bench of life measures over unlike families of gears."""
BROAD = Prior(
    np.array([[row[0] for row in NORMAL_PRIOR.values()]]),
    np.diag([row[1] ** 2 for row in NORMAL_PRIOR.values()])[None],
    np.ones(1),
    DOUBT,
)
"""one wide kind of gear: what learning from failed gears begins with"""


def _makers() -> Prior:
    """The kinds of `kinds.toml`, equally likely; the fatigue life is the maker's law's, in doubt."""
    table = tomllib.loads(resources.files(__package__).joinpath("kinds.toml").read_text())
    kinds = [row for row in table.values() if isinstance(row, dict)]
    mean, sd = NORMAL_PRIOR["log_fatigue"]
    return Prior(
        np.array([[mean, *kind["mean"]] for kind in kinds]),
        np.array([np.diag(np.square([sd, *kind["sd"]])) for kind in kinds]),
        np.full(len(kinds), 1.0 / len(kinds)),
        DOUBT,
    )


MAKERS = _makers()
"""what is believed of a gear whose like has never been seen to fail"""

END_SD = 0.01
"""relative: how well the life of a gear that has failed is known"""

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


def forecast(
    gear: Gear, evidence: Evidence, prior: Prior = MAKERS, seed: int = SEED, particles: int = PARTICLES
) -> Forecast:
    """The posterior of a gear's end. Deterministic for a given seed."""
    problem = _Problem(gear, evidence, prior)
    gears = _sample(problem, np.random.default_rng(seed), particles)
    fatigue_h = np.exp(gears[:, _COLUMN["log_fatigue"]])
    bearing_h = np.exp(gears[:, _COLUMN["log_bearing"]])
    strain_rate = np.interp(problem.exponent(gears), EXPONENTS, evidence.strain_rate)
    fatigue_left = np.minimum((fatigue_h - evidence.age_h) / np.maximum(strain_rate, 1e-9), 2.0 * MOST_LIFE_H)
    bearing_left = np.minimum((bearing_h - evidence.rated_now_h) / max(evidence.rated_rate, 1e-9), MOST_LIFE_H)
    return Forecast(
        np.maximum(np.minimum(fatigue_left, bearing_left), 0.0),
        evidence.age_h / fatigue_h,
        evidence.rated_now_h / bearing_h,
        np.asarray(bearing_left < fatigue_left, dtype=float),
    )


class _Problem:
    """Prior and likelihood over (n, 11) parameters, columns as in `_NAMES`."""

    def __init__(self, gear: Gear, evidence: Evidence, prior: Prior, ended: bool = False) -> None:
        self.ended = ended
        self.evidence = evidence
        self.bearing: Weibull = bearing_law(gear)
        self.mean = prior.mean.copy()
        self.log_weight = np.log(prior.weight)
        self.lower = np.linalg.cholesky(prior.cover[:, 1:, 1:])
        self.unlower = np.linalg.inv(self.lower)
        self.whiten = np.concatenate([matrix.T for matrix in self.unlower], axis=1)
        self.whitened_mean = np.einsum("kij,kj->ki", self.unlower, self.mean[:, 1:]).ravel()
        self.log_weight += np.log(np.diagonal(self.unlower, axis1=1, axis2=2)).sum(axis=1)
        # the fatigue life is drawn given the rest
        self.lean = np.linalg.solve(prior.cover[:, 1:, 1:], prior.cover[:, 1:, :1])[..., 0]
        self.fatigue_sd = np.sqrt(prior.cover[:, 0, 0] - np.sum(prior.cover[:, 0, 1:] * self.lean, axis=1))
        self.weight = prior.weight
        self.mean[:, 0] -= np.log(max(evidence.fatigue_rate, 0.1 / MOST_LIFE_H))
        doubt = prior.doubt * evidence.age_h / (evidence.age_h + DOUBT_AFTER_H)
        self.doubt_bearing = doubt if evidence.noise is not None and evidence.rated_now_h > 0.0 else 0.0
        self.doubt_fatigue = doubt if evidence.stiffness is not None else 0.0
        with np.errstate(divide="ignore"):
            self.log_strain = np.log(evidence.strain_h)
            self.log_rated = np.log(evidence.rated_h)
            self.log_age, self.log_used = np.log(evidence.age_h), np.log(evidence.rated_now_h)

    def exponent(self, gears: Array) -> Array:
        """(n,) of torque in fatigue, within the range of the clocks."""
        return np.clip(np.exp(gears[:, _COLUMN["log_exponent"]]), EXPONENTS[0], EXPONENTS[-1])

    def strain(self, gears: Array) -> Array:
        """(n, k) logarithm of each gear's own clock of fatigue."""
        place = np.interp(self.exponent(gears), EXPONENTS, np.arange(len(EXPONENTS)))
        below = np.minimum(place.astype(int), len(EXPONENTS) - 2)
        part = (place - below)[:, None]
        return np.asarray((1.0 - part) * self.log_strain[below] + part * self.log_strain[below + 1])

    def draw(self, rng: Generator, count: int) -> Array:
        """Gears from the prior that have survived their use so far."""
        gears = np.empty((count, len(_NAMES)))
        kind = rng.choice(len(self.weight), count, p=self.weight)
        scattered = np.einsum("nij,nj->ni", self.lower[kind], rng.standard_normal((count, self.mean.shape[1] - 1)))
        gears[:, 2:] = self.mean[kind, 1:] + scattered
        used = self.evidence.rated_now_h
        uniform, doubtful = rng.uniform(size=(2, count))
        gears[:, 0] = np.log(used + np.maximum(self.bearing.remaining(used, uniform), 1e-9))
        other = rng.uniform(size=count) < self.doubt_bearing
        gears[other, 0] = self.log_used - np.log1p(-doubtful[other])
        means, survivors = self._fatigue_given(gears)
        mean, survivors = means[np.arange(count), kind], survivors[np.arange(count), kind]
        z = -ndtri(np.maximum(survivors * rng.uniform(size=count), 1e-300))
        gears[:, 1] = np.maximum(mean + self.fatigue_sd[kind] * z, self.log_age + 1e-9)
        other = rng.uniform(size=count) < self.doubt_fatigue
        gears[other, 1] = self.log_age - np.log1p(-rng.uniform(size=int(np.sum(other))))
        return gears

    def _fatigue_given(self, gears: Array) -> tuple[Array, Array]:
        """(n, kinds) mean of the log fatigue life given the other parameters, and the chance to have lived till now."""
        mean = self.mean[:, 0] + gears[:, 2:] @ self.lean.T - np.sum(self.mean[:, 1:] * self.lean, axis=1)
        return np.asarray(mean), np.maximum(ndtr((mean - self.log_age) / self.fatigue_sd), 1e-300)

    def log_prior(self, gears: Array) -> Array:
        """(n,) up to a constant; minus infinity for a gear that should have failed already."""
        mean, survivors = self._fatigue_given(gears)
        shape, scale_h = self.bearing.shape, self.bearing.scale_h
        with np.errstate(divide="ignore", over="ignore"):
            used = shape * (gears[:, 0] - np.log(scale_h))
            bearing = shape * np.exp(used - np.exp(used) + (self.evidence.rated_now_h / scale_h) ** shape)
            short = np.exp(self.log_used - gears[:, 0])
            total = np.log((1.0 - self.doubt_bearing) * bearing + self.doubt_bearing * short)
            law = np.exp(-0.5 * ((gears[:, 1:2] - mean) / self.fatigue_sd) ** 2)
            law /= self.fatigue_sd * np.sqrt(2.0 * np.pi) * survivors
            short = np.exp(self.log_age - gears[:, 1:2])
            parts = np.log((1.0 - self.doubt_fatigue) * law + self.doubt_fatigue * short) + self.log_weight
        off = (gears[:, 2:] @ self.whiten - self.whitened_mean).reshape(len(gears), len(self.mean), -1)
        parts -= 0.5 * np.einsum("nkj,nkj->nk", off, off)
        total += logsumexp(parts, axis=1)
        dead = (gears[:, 0] <= self.log_used) | (gears[:, 1] <= self.log_age)
        return np.where(dead | ~np.isfinite(total), -np.inf, total)

    def log_likelihood(self, gears: Array) -> Array:
        """(n,) of the observed trends."""
        total = np.zeros(len(gears))
        stiffness, noise = self.evidence.stiffness, self.evidence.noise
        if self.ended:
            left = np.minimum(gears[:, 0] - self.log_used, gears[:, 1] - self.log_age)
            total -= 0.5 * (left / END_SD) ** 2
        if stiffness is None and noise is None:
            return total
        column = {name: gears[:, i : i + 1] for name, i in _COLUMN.items()}
        fatigue = _grown(self.strain(gears), column["log_fatigue"], column["feedback"], column["log_rise"])
        wear = _grown(
            self.log_rated[None, :], column["log_bearing"], column["noise_feedback"], column["log_noise_rise"]
        )
        if stiffness is not None:
            lost = np.exp(column["log_loss"]) * fatigue + np.exp(column["log_bearing_loss"]) * wear
            total += _fit(stiffness, np.log1p(-np.minimum(lost, 0.95)))
        if noise is not None:
            gained = np.exp(column["log_noise"]) * wear + np.exp(column["log_fatigue_noise"]) * fatigue
            total += _fit(noise, gained)
        return total


def _grown(log_clock: Array, log_capacity: Array, feedback: Array, log_rise: Array) -> Array:
    """(n, k) wear between 0 and 1 at the used share z of a capacity: D^p with D = -log(1 - z (1 - e^-f)) / f.

    D solves dD/dz ~ exp(f D), damage D = 1 at z = 1: the articles' law, whose rate grows by (1 - gamma dK)^-m, with
    the feedback f = m gamma dK at failure. A negative f is wear that settles.
    """
    feedback = np.clip(feedback, -6.0, 10.0)
    feedback = np.where(np.abs(feedback) < 1e-3, 1e-3, feedback)
    share = np.minimum(np.exp(log_clock - log_capacity), 1.0) * -np.expm1(-feedback)
    damage = -np.log1p(-share) / feedback
    return np.asarray(damage ** np.exp(np.clip(log_rise, -1.5, 2.5)))


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
        gears, likelihood, prior = _move(problem, rng, gears, likelihood, prior, heat)
    return gears


def _move(
    problem: _Problem, rng: Generator, gears: Array, likelihood: Array, prior: Array, heat: float
) -> tuple[Array, Array, Array]:
    """Metropolis steps along differences between gears of the ensemble, in some of the parameters at a time
    (ter Braak 2006; Vrugt et al. 2009): ridges and several modes are followed without knowing them."""
    count = len(gears)
    crowd, moved = gears.copy(), 0.0
    for move in range(MOST_MOVES):
        if moved > ENOUGH_MOVES:
            break
        one, other = rng.integers(count, size=(2, count))
        chosen = rng.uniform(size=gears.shape) < CROSSINGS[move % len(CROSSINGS)]
        reach = REACHES[move % len(REACHES)] / np.sqrt(2.0 * np.maximum(chosen.sum(axis=1, keepdims=True), 1))
        step = reach * (crowd[one] - crowd[other]) + JITTER * rng.standard_normal(gears.shape)
        trial = gears + np.where(chosen, step, 0.0)
        trial_prior = problem.log_prior(trial)
        possible = np.isfinite(trial_prior)
        trial_likelihood = np.full(count, -np.inf)
        trial_likelihood[possible] = problem.log_likelihood(trial[possible])
        gain = heat * (trial_likelihood - likelihood) + trial_prior - prior
        taken = np.log(rng.uniform(size=count)) < gain
        gears[taken] = trial[taken]
        likelihood[taken], prior[taken] = trial_likelihood[taken], trial_prior[taken]
        moved += float(np.mean(taken))
    return gears, likelihood, prior


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


def posterior_of_failed(gear: Gear, evidence: Evidence, prior: Prior, seed: int, particles: int) -> Array:
    """(particles, 10) parameters, in the order of `NORMAL_PRIOR`, of a gear that failed at the end of its evidence.

    The fatigue life is relative to the maker's law, as in the prior.
    """
    problem = _Problem(gear, evidence, prior, ended=True)
    gears = _sample(problem, np.random.default_rng(seed), particles)[:, 1:]
    gears[:, 0] -= problem.mean[0, 0] - prior.mean[0, 0]
    return gears
