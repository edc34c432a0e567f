"""Other ways to forecast the same gears, for `bench_life`: Bayesian exponential degradation, ProgPy's particle filter
and gradient boosting. All learn from the same failed gears as the product and see the same daily means; the first two
get two signals, stiffness lost and noise gained, and call the end when the first reaches the level at which the learned
gears failed.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from simulated_gears import Array, Life

SAMPLES = 1000
POINTS = 60
RATE_WALK = 10.0
"""how fast ProgPy's particles may change their log rate, per 1e4 h; best of 1, 3, 10, 20, 40 on gears learned from"""


def signals(time_h: Array, columns: dict[str, Array]) -> tuple[Array, Array]:
    """(k,) hours and (2, k) stiffness lost and noise gained since the first twentieth, each a mean over its stretch."""
    warm = columns["temperature_degC"] - 30.0
    known = [_filled(columns[name]) for name in ("stiffness_Nm_per_rad", *(f"noise_a{i}" for i in range(5)))]
    raw = np.stack((-np.log(known[0]), np.mean(np.log(known[1:]), axis=0)))
    early = slice(0, max(time_h.size // 20, 48))
    slope = [np.polyfit(warm[early] - warm[early].mean(), row[early] - row[early].mean(), 1)[0] for row in raw]
    level = raw - np.array(slope)[:, None] * warm
    level -= level[:, early].mean(axis=1, keepdims=True)
    parts = np.array_split(np.arange(time_h.size), min(POINTS, time_h.size))
    return np.array([time_h[p].mean() for p in parts]), np.array([[row[p].mean() for p in parts] for row in level])


def _filled(values: Array) -> Array:
    """Hours that were not measured lie between their neighbours: these ways take no gaps."""
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(values.size), known, values[known])


@dataclass(frozen=True, slots=True)
class Learned:
    """What failed gears teach: per signal, the law of (log size at onset, log rate per 1e4 h)."""

    mean: Array
    """(2, 2)"""
    cover: Array
    """(2, 2, 2)"""
    noise: Array
    """(2,) sd of the logarithm around a line"""
    log_end: Array
    """(2, 2) mean and sd of the logarithm of the signal at failure"""
    linear: Array
    """(2, 2) per signal: mean and sd of the log of a straight line's rate per 1e4 h"""
    linear_noise: Array
    """(2,) sd around a straight line"""
    log_life: Array
    """(2,) mean and sd of the logarithm of the whole life, for gears that show nothing yet"""


ONSET = np.array([0.008, 0.12])
"""a signal is followed from where it passes this for good: before, its logarithm is noise"""


def onset(y: Array, level: float) -> int:
    """Index from which the signal stays above the level; its length if it does not."""
    below = np.flatnonzero(y < level)
    return int(below[-1]) + 1 if below.size else 0


def _line(t: Array, y: Array, level: float) -> tuple[Array, Array] | None:
    """Hours since onset in 1e4 h and the signal's logarithm, or None if there are not three points."""
    first = onset(y, level)
    if len(t) - first < 3:
        return None
    return (t[first:] - t[first]) / 1e4, np.log(y[first:])


def learn(lives: Sequence[Life]) -> Learned:
    """Lines through the logarithm of each signal; the level counts for the signal that belongs to the cause."""
    fits: list[list[Array]] = [[], []]
    noise: list[list[float]] = [[], []]
    ends: list[list[float]] = [[], []]
    slopes: list[list[tuple[float, float]]] = [[], []]
    for life in lives:
        t, y = signals(life.time_h, life.columns)
        own = 0 if life.cause == "fatigue" else 1
        ends[own].append(float(np.log(max(y[own, -2:].mean(), ONSET[own]))))
        for i in range(2):
            line = _line(t, y[i], float(ONSET[i]))
            if line is None:
                continue
            slope, level = np.polyfit(line[0], np.exp(line[1]), 1)
            slopes[i].append((np.log(max(slope, 1e-4)), float(np.std(np.exp(line[1]) - level - slope * line[0]))))
            rate, start = np.polyfit(*line, 1)
            if rate > 0:
                fits[i].append(np.array([start, np.log(rate)]))
                noise[i].append(float(np.std(line[1] - start - rate * line[0])))
    logs = np.log([life.life_h for life in lives])
    return Learned(
        np.array([np.mean(rows, axis=0) for rows in fits]),
        np.array([np.cov(np.array(rows).T) for rows in fits]),
        np.array([np.mean(rows) for rows in noise]),
        np.array([[np.mean(rows), max(float(np.std(rows)), 0.05)] for rows in ends]),
        np.array([[np.mean([row[0] for row in rows]), np.std([row[0] for row in rows])] for rows in slopes]),
        np.array([np.mean([row[1] for row in rows]) for rows in slopes]),
        np.array([logs.mean(), logs.std()]),
    )


def _unseen(rng: Generator, learned: Learned, age_h: float) -> Array:
    """Remaining lives of gears that have shown nothing: lives of the learned ones, given the age."""
    lives = np.exp(rng.normal(learned.log_life[0], learned.log_life[1], 50 * SAMPLES))
    left = lives[lives > age_h] - age_h
    return left[:SAMPLES] if left.size >= SAMPLES else np.resize(left if left.size else np.array([age_h]), SAMPLES)


def exponential(rng: Generator, learned: Learned, time_h: Array, columns: dict[str, Array]) -> Array:
    """(n,) remaining lives: posterior of a line through the logarithm since onset (Gebraeel et al. 2005), its prior and
    the level at failure as learned, by importance sampling."""
    t, y = signals(time_h, columns)
    left = []
    for i in range(2):
        line = _line(t, y[i], float(ONSET[i]))
        if line is None:
            continue
        start, log_rate = rng.multivariate_normal(learned.mean[i], learned.cover[i], 20 * SAMPLES).T
        rate = np.exp(log_rate)
        off = line[1] - start[:, None] - rate[:, None] * line[0]
        score = -0.5 * np.sum((off / learned.noise[i]) ** 2, axis=1)
        weight = np.exp(score - score.max())
        chosen = rng.choice(start.size, SAMPLES, p=weight / weight.sum())
        end = rng.normal(learned.log_end[i][0], learned.log_end[i][1], SAMPLES)
        onset_h = t[-1] - line[0][-1] * 1e4
        left.append(onset_h + (end - start[chosen]) / rate[chosen] * 1e4 - time_h[-1])
    return np.clip(np.minimum.reduce(left), 0.0, 1e5) if left else _unseen(rng, learned, time_h[-1])


def progpy_filter() -> Any:
    """A function like `exponential` on ProgPy's particle filter; None if ProgPy is not installed."""
    try:
        from progpy import PrognosticsModel
        from progpy.state_estimators import ParticleFilter
        from progpy.uncertain_data import UnweightedSamples
    except ImportError:
        return None

    class Growth(PrognosticsModel):  # type: ignore[misc]
        """A signal that grows at its own unknown, slowly changing rate."""

        inputs: list[str] = []  # noqa: RUF012
        states = ["size", "log_rate"]  # noqa: RUF012
        outputs = ["seen"]  # noqa: RUF012
        events = ["failure"]  # noqa: RUF012
        is_vectorized = True

        def dx(self, x: Any, u: Any) -> Any:
            rate = np.atleast_1d(np.exp(np.asarray(x["log_rate"], dtype=float)))
            return self.StateContainer(np.array([rate, 0.0 * rate]))

        def output(self, x: Any) -> Any:
            return self.OutputContainer(np.array([np.atleast_1d(x["size"])]))

    def track(rng: Generator, learned: Learned, i: int, t: Array, y: Array) -> tuple[Array, Array]:
        """Particles of size and rate at the last point."""
        rates = rng.normal(learned.linear[i][0], learned.linear[i][1], SAMPLES)
        sizes = rng.normal(y[0], learned.linear_noise[i], SAMPLES)
        model = Growth(process_noise={"size": 0.0, "log_rate": RATE_WALK}, measurement_noise=0)
        start = UnweightedSamples([{"size": a, "log_rate": b} for a, b in zip(sizes, rates, strict=True)])
        tracker = ParticleFilter(
            model, start, t0=-1e-9, num_particles=SAMPLES, measurement_noise={"seen": float(learned.linear_noise[i])}
        )
        for now, seen in zip(t, y, strict=True):
            tracker.estimate(float(now), {}, {"seen": float(seen)}, dt=1e9)
        particles = tracker.particles
        return np.asarray(particles["size"], dtype=float), np.exp(np.asarray(particles["log_rate"], dtype=float))

    def run(rng: Generator, learned: Learned, time_h: Array, columns: dict[str, Array]) -> Array:
        t, y = signals(time_h, columns)
        np.random.seed(int(rng.integers(2**31)))  # ProgPy draws from the global generator
        left = []
        for i in range(2):
            line = _line(t, y[i], float(ONSET[i]))
            if line is None:
                continue
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                size, rate = track(rng, learned, i, line[0], np.exp(line[1]))
            end = np.exp(rng.normal(learned.log_end[i][0], learned.log_end[i][1], SAMPLES))
            left.append((end - size) / rate * 1e4 - (time_h[-1] - t[-1]))
        return np.clip(np.minimum.reduce(left), 0.0, 1e5) if left else _unseen(rng, learned, time_h[-1])

    return run


MANY_GEARS, MANY_INSTANTS = 300, 12
"""So many failed gears, far more than anybody has, teach at least this much: a lower bound of what can be known."""


def bound(lives: Sequence[Life]) -> Any:
    """A function like `exponential` on extremely randomised trees of hundreds of gears; None without scikit-learn.

    The features are those of `boosting`; leaves hold enough gears for their spread to be the forecast's.
    """
    try:
        from sklearn.ensemble import ExtraTreesRegressor
    except ImportError:
        return None
    shares = np.linspace(0.1, 0.97, MANY_INSTANTS)
    cuts = [(life, *life.until(share)) for life in lives for share in shares]
    x = np.array([_by_hand(time_h, columns) for _, time_h, columns in cuts])
    y = np.array([np.log(max(life.life_h - time_h[-1], 1.0) / time_h[-1]) for life, time_h, _ in cuts])
    fit = ExtraTreesRegressor(200, min_samples_leaf=8, max_features=None, random_state=0).fit(x, y)
    leaves = fit.apply(x)

    def run(rng: Generator, time_h: Array, columns: dict[str, Array]) -> Array:
        own = fit.apply(_by_hand(time_h, columns)[None])[0]
        like = (leaves == own) / np.maximum((leaves == own).sum(axis=0), 1)
        weight = like.sum(axis=1) / like.sum()
        return np.asarray(time_h[-1] * np.exp(y[rng.choice(y.size, 400, p=weight)]))

    return run


BOOSTED_AT = (0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95)
"""quantiles that are boosted; between them the ensemble is interpolated"""


def _by_hand(time_h: Array, columns: dict[str, Array]) -> Array:
    """Fourteen features as an engineer would make them in an afternoon."""
    _, y = signals(time_h, columns)
    warm, points = columns["temperature_degC"], y.shape[1]
    quarters = [y[:, int(share * points) :].mean(axis=1) for share in (0.5, 0.75, 0.9)]
    slope = [np.polyfit(np.arange(points - points // 2), row[points // 2 :], 1)[0] for row in y]
    load, speed = columns["torque_cubic_mean_Nm"], columns["speed_in_rpm"]
    few = max(time_h.size // 10, 1)
    rest = [np.log(time_h[-1]), np.log(load.mean()), np.log(speed.mean()), np.log(np.sum(load**3 * speed))]
    return np.concatenate((*quarters, slope, rest, [warm[-few:].mean() - warm[:few].mean(), y[1].max()]))


def boosting(lives: Sequence[Life]) -> Any:
    """A function like `exponential` on gradient boosted trees; None if scikit-learn is not installed."""
    try:
        from sklearn.ensemble import GradientBoostingRegressor
    except ImportError:
        return None
    shares = np.linspace(0.1, 0.97, 16)
    cuts = [(life, *life.until(share)) for life in lives for share in shares]
    x = np.array([_by_hand(time_h, columns) for _, time_h, columns in cuts])
    y = np.array([np.log(max(life.life_h - time_h[-1], 1.0) / time_h[-1]) for life, time_h, _ in cuts])
    ways = {"n_estimators": 120, "max_depth": 3, "learning_rate": 0.06, "subsample": 0.7, "random_state": 0}
    fits = [GradientBoostingRegressor(loss="quantile", alpha=q, **ways).fit(x, y) for q in BOOSTED_AT]

    def run(rng: Generator, time_h: Array, columns: dict[str, Array]) -> Array:
        told = np.sort([float(fit.predict(_by_hand(time_h, columns)[None])[0]) for fit in fits])
        levels = (np.arange(200) + 0.5) / 200
        return np.asarray(time_h[-1] * np.exp(np.interp(levels, BOOSTED_AT, told)))

    return run
