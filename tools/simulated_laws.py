"""Gears that run to failure by laws from the books, one number of damage each: more truth for `bench_life`.

They differ in kind from `simulated_gears`: there wear of two parts is drawn in shape, here a law is integrated from
state to state, the life has nothing to do with the maker's promises, and each gear comes from a fleet of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from simulated_gears import RATED_NM, RATED_RPM, STIFFNESS_NM_PER_RAD, Array, Life, coloured

PEAK_LIMIT_NM = 191.0
"""momentary peak of CSG-20-100"""
LOSSES = (0.10, 0.15, 0.20, 0.25, 0.30, 0.35)
"""of stiffness, at which an engineer may call a gear failed"""
LONGEST_H, SHORTEST_H = 50_000, 800


@dataclass(frozen=True, slots=True)
class Course:
    """What is seen up to failure, (n,) each, before the sensors."""

    lost: Array
    """relative stiffness lost"""
    gained: Array
    """logarithm of the noise coefficients' growth"""


def law(rng: Generator, torque: Array, speed: Array, warm: Array) -> Course:
    """The articles' law with its feedback of stiffness loss; stiffness k0 (1 - c D^p), noise grows with D."""
    exponent, gamma = rng.uniform(3.0, 9.0), rng.uniform(0.3, 2.0)
    loss, bend = rng.choice(LOSSES) * rng.lognormal(0.0, 0.1), rng.choice((1.0, 1.0, 1.5, 2.0))
    life_h = _drawn_life_h(rng)
    step = (torque / RATED_NM) ** exponent * (speed / RATED_RPM) * np.exp(0.01 * (warm - 40.0))
    step /= np.mean(step) * life_h
    damage, at = np.zeros(torque.size), 0.0
    for i, one in enumerate((step * np.exp(coloured(rng, step.size, 0.3, 200.0))).tolist()):
        at += one * (1.0 - min(gamma * loss * at**bend, 0.9)) ** -exponent
        damage[i] = at
        if at >= 1.0:
            damage = damage[: i + 1]
            break
    loud, rise = rng.uniform(0.7, 2.5), rng.uniform(1.0, 3.0)
    return Course(loss * damage**bend, loud * damage**rise)


def _drawn_life_h(rng: Generator) -> float:
    return math.exp(rng.uniform(math.log(2e3), math.log(2.5e4)))


def _used(torque: Array, speed: Array, life_h: float) -> Array:
    """(n,) share of a life that the load has used up: cubic in torque, linear in speed."""
    return np.asarray(np.cumsum((torque / np.mean(torque)) ** 3 * speed / np.mean(speed)) / life_h)


def crack(rng: Generator, torque: Array, speed: Array, warm: Array) -> Course:
    """Paris and Erdogan: a crack grows with a power of its own stress intensity, slow for long and then fast."""
    exponent, start = rng.uniform(2.2, 4.0), rng.uniform(0.1, 0.4)
    life_h = _drawn_life_h(rng)
    step = (
        (torque / np.mean(torque)) ** exponent * speed / np.mean(speed) * np.exp(coloured(rng, torque.size, 0.3, 200))
    )
    used = np.cumsum(step) / life_h
    used = used[: int(np.searchsorted(used, 1.0))]
    half = exponent / 2.0 - 1.0
    size = (start**-half - used * (start**-half - 1.0)) ** (-1.0 / half)
    share = (size - start) / (1.0 - start)
    return Course(rng.choice(LOSSES) * rng.lognormal(0.0, 0.1) * share, rng.uniform(0.5, 2.0) * share)


def threshold(rng: Generator, torque: Array, speed: Array, warm: Array) -> Course:
    """Stiffness runs down as a power of time with random steps, and fails at a fixed loss; noise follows loosely."""
    limit, bend = rng.choice(LOSSES[:5]), rng.uniform(0.8, 2.5)
    life_h = _drawn_life_h(rng)
    used = _used(torque, speed, life_h)
    portions = np.diff(used**bend, prepend=0.0) * rng.uniform(150.0, 2000.0)
    path = np.cumsum(rng.gamma(np.maximum(portions, 1e-9))) / (np.sum(portions) / used[-1] ** bend)
    path = path[: int(np.searchsorted(path, 1.0))]
    return Course(limit * path, rng.uniform(0.3, 2.0) * path ** rng.uniform(0.7, 1.5))


def growth(rng: Generator, torque: Array, speed: Array, warm: Array) -> Course:
    """Both conditions grow exponentially in damage, which the load alone adds up; noise by e^k at the end."""
    life_h = _drawn_life_h(rng)
    used = _used(torque, speed, life_h)
    used = used[: int(np.searchsorted(used, 1.0))]
    k, loss = rng.uniform(1.0, 4.0), rng.choice(LOSSES)
    return Course(loss * np.expm1(k * used) / math.expm1(k), rng.uniform(1.0, 3.0) * used)


def bearing(rng: Generator, torque: Array, speed: Array, warm: Array) -> Course:
    """A bearing with Weibull life whose noise grows exponentially in the last third or half; stiffness hardly moves."""
    life_h = 1.5e4 * rng.weibull(1.8)
    used = _used(torque, speed, life_h)
    used = used[: int(np.searchsorted(used, 1.0))]
    start = rng.uniform(0.4, 0.67)
    late = np.maximum(used - start, 0.0) / (1.0 - start)
    return Course(rng.uniform(0.01, 0.06) * used, rng.uniform(1.0, 2.5) * np.expm1(2.0 * late) / math.expm1(2.0))


LAWS: dict[str, Callable[[Generator, Array, Array, Array], Course]] = {
    row.__name__: row for row in (law, crack, threshold, growth, bearing)
}


def run_by_law(rng: Generator, name: str) -> Life:
    """One life, hourly. Lives too short or too long to be one are drawn again."""
    while True:
        hours = np.arange(1.0, LONGEST_H + 1.0)
        torque, peak, speed, warm = _duty(rng, hours)
        course = LAWS[name](rng, torque, speed, warm)
        rows = course.lost.size
        if SHORTEST_H < rows < LONGEST_H:
            break
    columns = _sensed(rng, course, warm[:rows])
    columns |= {
        "speed_in_rpm": speed[:rows],
        "torque_cubic_mean_Nm": torque[:rows],
        "torque_peak_Nm": peak[:rows],
        "temperature_degC": warm[:rows],
    }
    return Life(hours[:rows], columns, float(rows), "bearing" if name == "bearing" else "fatigue")


def _duty(rng: Generator, hours: Array) -> tuple[Array, Array, Array, Array]:
    """Torque (cubic mean, peak) [N m], speed [rpm], temperature [degC]; days and a slow drift of the production."""
    n = hours.size
    day = 1.0 + rng.uniform(0.0, 0.2) * np.sin(2 * np.pi * hours / 24)
    torque = rng.uniform(0.3, 1.2) * RATED_NM * day * np.exp(coloured(rng, n, 0.1, 300.0) + 0.05 * rng.normal(size=n))
    peak = np.minimum(torque * rng.uniform(1.3, 2.2) * np.exp(0.05 * rng.normal(size=n)), PEAK_LIMIT_NM)
    speed = rng.uniform(500.0, 2500.0) * np.exp(0.1 * rng.normal(size=n))
    warm = rng.uniform(25.0, 45.0) + 6 * np.sin(2 * np.pi * hours / 24) + coloured(rng, n, 1.5, 50.0)
    return torque, peak, speed, warm


def _sensed(rng: Generator, course: Course, warm: Array) -> dict[str, Array]:
    """Stiffness that loses a tenth of a percent per kelvin, noise coefficients that share one growth, all noisy."""
    n = course.lost.size
    stiffness = STIFFNESS_NM_PER_RAD * rng.lognormal(0.0, 0.05) * (1.0 - course.lost) * (1.0 - 1e-3 * (warm - 30.0))
    columns = {"stiffness_Nm_per_rad": stiffness * (1.0 + rng.uniform(0.002, 0.02) * rng.normal(size=n))}
    scatter = rng.uniform(0.03, 0.2)
    for beta in range(5):
        grown = course.gained * rng.uniform(0.5, 1.0)
        level = 10.0 ** rng.uniform(-6.0, -2.0)
        columns[f"noise_a{beta}"] = level * np.exp(grown + scatter * rng.normal(size=n))
    return columns


@dataclass(frozen=True, slots=True)
class Constants:
    """Of dD/dN = C (torque / ultimate / (1 - gamma dK))^m; `scatter` is the sd of log C between gears."""

    log_C: float
    m: float
    gamma: float
    scatter: float


CYCLES_PER_TURN, LOSS_AT_FAILURE = 2.0, 0.2


def draw_constants(rng: Generator, ultimate_Nm: float) -> Constants:
    """Of a fleet whose gears live about 5000 h at 60 N m and 1500 rpm."""
    m = rng.uniform(5.0, 10.0)
    log_C = -math.log(5000.0 * 60.0 * CYCLES_PER_TURN * 1500.0) - m * math.log(60.0 / ultimate_Nm)
    return Constants(log_C, m, rng.uniform(0.5, 2.0), rng.uniform(0.2, 0.4))


def run_by_constants(rng: Generator, constants: Constants, ultimate_Nm: float) -> tuple[Array, dict[str, Array], bool]:
    """Hours, columns and whether it failed within `LONGEST_H`; stiffness falls with D^1.5 by a fifth.

    The law is separable: the sum of what the load does is a tabled function of D.
    """
    hours = np.arange(1.0, LONGEST_H + 1.0)
    torque = rng.uniform(0.8, 1.5) * RATED_NM * np.exp(0.15 * rng.normal(size=hours.size))
    speed = rng.uniform(1000.0, 2000.0)
    level = constants.log_C + constants.scatter * rng.normal()
    clock = np.cumsum(60.0 * CYCLES_PER_TURN * speed * np.exp(level + constants.m * np.log(torque / ultimate_Nm)))
    damage = np.linspace(0.0, 1.0, 2001)
    slow = (1.0 - constants.gamma * LOSS_AT_FAILURE * damage**1.5) ** constants.m
    table = np.concatenate(([0.0], np.cumsum(0.5 * (slow[1:] + slow[:-1]) * np.diff(damage))))
    rows = min(int(np.searchsorted(clock, table[-1])) + 1, hours.size)
    lost = LOSS_AT_FAILURE * np.interp(clock[:rows], table, damage) ** 1.5
    columns = {
        "torque_cubic_mean_Nm": torque[:rows],
        "speed_in_rpm": np.full(rows, speed),
        "stiffness_Nm_per_rad": STIFFNESS_NM_PER_RAD * (1.0 - lost) * (1.0 + 0.01 * rng.normal(size=rows)),
    }
    return hours[:rows], columns, rows < hours.size
