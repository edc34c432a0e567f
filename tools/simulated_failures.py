"""Gears that fail by laws the product does not have, for `bench_life`: nothing is shared with its curves of wear.

Each family draws its own constants, loads and sensors; a gear of it is one call. `creep` is held aside: nothing may be
chosen by looking at it. What a gear is comes from one generator and what befalls it from hour to hour from others, so
that the very same gear can be run into another future.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from scipy.special import gammaincinv
from simulated_gears import RATED_NM, RATED_RPM, Array, Life, coloured

LONGEST_H, SHORTEST_H = 40_000, 400
Marks = tuple[Array, Array, Array, str]
"""Share of stiffness lost, logarithm of noise gained, kelvins gained, each from 0 to past the end, and the cause; the
first of them ends where the gear does."""


def _paris(rng: Generator, torque: Array, speed: Array, temperature: Array, luck: Array) -> Marks:
    """da/dN = C (dK)^3.2 with dK ~ torque sqrt(a): the crack runs away, the stiffness falls late."""
    power = 3.2
    start, end = 0.05 * rng.lognormal(0.0, 0.15), rng.normal(1.0, 0.06)
    clock = np.cumsum((torque / RATED_NM) ** power * speed / RATED_RPM)
    size = np.linspace(start, end, 4000)
    slowness = (np.sqrt(size) * (1.0 + 0.8 * size**2)) ** -power
    reached = np.concatenate(([0.0], np.cumsum(0.5 * (slowness[1:] + slowness[:-1]) * np.diff(size))))
    use = clock * reached[-1] / (7000.0 * rng.lognormal(0.0, 0.3))
    rows = int(np.searchsorted(use, reached[-1])) + 1
    crack = np.interp(use[:rows], reached, size)
    compliance = 0.28 * crack**1.7 * rng.lognormal(0.0, 0.08)
    return compliance / (1.0 + compliance), 0.25 * crack**2, 0.0 * crack, "crack"


def _bearing(rng: Generator, torque: Array, speed: Array, temperature: Array, luck: Array) -> Marks:
    """Nothing until the first spall; then it grows with its own size and is heard, in the low coefficients first."""
    clock = np.cumsum((torque / RATED_NM) ** 3 * speed / RATED_RPM)
    born = 5500.0 * rng.weibull(3.0) + 800.0
    grows = 1500.0 * rng.lognormal(0.0, 0.25)
    spall = np.where(clock > born, np.expm1((clock - born) / grows), 0.0) + 0.15 * clock / born
    rows = int(np.searchsorted(spall, 9.0 * rng.lognormal(0.0, 0.2))) + 1
    spall = spall[:rows]
    return 0.004 * spall, 0.75 * np.log1p(spall), 0.6 * np.log1p(spall), "bearing"


def _starved(rng: Generator, torque: Array, speed: Array, temperature: Array, luck: Array) -> Marks:
    """Grease ages by Arrhenius; the film thins, friction heats the gear, which ages the grease faster."""
    fresh = 9000.0 * rng.lognormal(0.0, 0.3)
    aged, warmer, film = np.zeros(LONGEST_H), 0.0, 0.0
    heats = 9.0 * rng.lognormal(0.0, 0.15)
    power = torque / RATED_NM * speed / RATED_RPM
    rows = LONGEST_H
    for hour in range(LONGEST_H):
        film += 2.0 ** ((temperature[hour] + warmer - 40.0) / 15.0) / fresh
        warmer = heats * power[hour] ** 0.5 * film**1.5
        aged[hour] = film
        if film >= 1.6:
            rows = hour + 1
            break
    aged = aged[:rows]
    return 0.01 * aged, 0.3 * np.maximum(aged - 0.5, 0.0), heats * power[:rows] ** 0.5 * aged**1.5, "starved"


def _mixed(rng: Generator, torque: Array, speed: Array, temperature: Array, luck: Array) -> Marks:
    """Crack against bearing: both go on, the first to its end stops the gear."""
    soft, hum, _, _ = _paris(rng, torque, speed, temperature, luck)
    soft_too, loud, warm, _ = _bearing(rng, torque, speed, temperature, luck)
    rows = min(len(soft), len(loud))
    cause = "crack" if len(soft) <= len(loud) else "bearing"
    return soft[:rows] + soft_too[:rows], hum[:rows] + loud[:rows], warm[:rows], cause


def _creep(rng: Generator, torque: Array, speed: Array, temperature: Array, luck: Array) -> Marks:
    """Tooth wear: fast at first, then steady, then fast as the case hardening is gone; stiffness goes in small steps
    and the noise falls while the teeth run in."""
    slide = np.cumsum((torque / RATED_NM) ** 1.3 * speed / RATED_RPM) / (6500.0 * rng.lognormal(0.0, 0.3))
    worn = 0.25 * (1.0 - np.exp(-slide / 0.08)) + 0.45 * slide + 0.3 * np.maximum(slide / 0.75, 0.0) ** 5
    steps = np.cumsum(gammaincinv(np.maximum(np.diff(worn, prepend=0.0), 0.0) * 150.0 + 1e-12, luck)) / 150.0
    rows = int(np.searchsorted(steps, 1.45 * rng.lognormal(0.0, 0.06))) + 1
    steps = steps[:rows]
    heard = -0.2 * (1.0 - np.exp(-slide[:rows] / 0.1)) + 0.5 * steps**2
    return 0.09 * steps, heard, 3.0 * steps, "creep"


def _rivals(rng: Generator, torque: Array, speed: Array, temperature: Array, luck: Array) -> Marks:
    """A crack by Paris and Erdogan's law against a bearing whose wear feeds on itself, under `_jobs`. The first to its
    end stops the gear."""
    use = np.cumsum((torque / RATED_NM) ** 3 * speed / 1400.0)
    # da/dN = C (sigma sqrt(pi a))^3 and dw/dN = k (1 + 1.5 w), both integrated in closed form
    first, rate = 0.05 * rng.lognormal(0.0, 0.2), 2.0e-4 * rng.lognormal(0.0, 0.25) * np.pi**1.5
    crack = np.maximum(first**-0.5 - 0.5 * rate * use, 1e-3) ** -2.0
    worn = np.expm1(1.5 * 1.1e-4 * rng.lognormal(0.0, 0.25) * use) / 1.5
    rows = int(np.argmax((crack >= 1.0) | (worn >= 1.0))) + 1
    cause = "crack" if crack[rows - 1] >= 1.0 else "race"
    opened, heard = crack[:rows] - first, worn[:rows]
    return 0.25 * opened, np.log1p(2.5 * heard + 0.3 * opened), 4.0 * heard, cause


def _wandering(own: Generator, fresh: Generator) -> tuple[Array, Array]:
    """Torque [N m] and speed [rpm] that wander about levels of the gear's own."""
    torque, speed = RATED_NM * own.lognormal(-0.2, 0.15), own.uniform(900.0, 1900.0)
    wander = [np.exp(coloured(fresh, LONGEST_H, sd, hours)) for sd, hours in ((0.12, 40.0), (0.1, 60.0))]
    return torque * wander[0], speed * wander[1]


def _jobs(own: Generator, fresh: Generator) -> tuple[Array, Array]:
    """Loads in blocks of hours, as jobs change by chance (a Markov chain of four levels)."""
    levels, pace = np.array([0.55, 0.75, 0.95, 1.1]) * own.lognormal(0.0, 0.1), np.array([0.57, 0.86, 1.14, 1.0])
    share = own.dirichlet((2, 4, 4, 2))
    begins = np.flatnonzero(np.append(True, fresh.uniform(size=LONGEST_H - 1) > 0.9))
    job = np.repeat(fresh.choice(4, begins.size, p=share), np.diff(np.append(begins, LONGEST_H)))
    torque = RATED_NM * levels[job] * fresh.lognormal(0.0, 0.05, LONGEST_H)
    return torque, 1400.0 * pace[job] * fresh.lognormal(0.0, 0.03, LONGEST_H)


LOADS = {"rivals": _jobs}
"""Of families whose loads do not just wander."""
FAILURES: dict[str, Callable[[Generator, Array, Array, Array, Array], Marks]] = {
    "paris": _paris,
    "bearing": _bearing,
    "starved": _starved,
    "mixed": _mixed,
    "rivals": _rivals,
    "creep": _creep,
}
HELD_ASIDE = "creep"
NOISE_SHARES = {"bearing": (1.0, 0.9, 0.6, 0.3, 0.2)}
"""Share of the gained noise that each coefficient shows; all of it elsewhere."""


def run_to_end(rng: Generator, family: str) -> Life:
    """One life, hourly, at a load of its own; drawn again if too short or too long to be a history."""
    while True:
        seed, fresh = int(rng.integers(2**62)), np.random.default_rng(int(rng.integers(2**62)))
        course = _course(family, seed, fresh)
        soft, loud, warm, cause = FAILURES[family](np.random.default_rng(seed), *course)
        rows = len(soft)
        if SHORTEST_H < rows < LONGEST_H:
            break
    torque, speed, around, _ = course
    heat = around[:rows] + warm
    stiffness = 1.55e4 * rng.lognormal(0.0, 0.05) * (1.0 - soft) * (1.0 - 5e-4 * (heat - 30.0))
    columns = {
        "speed_in_rpm": speed[:rows],
        "torque_cubic_mean_Nm": torque[:rows],
        "torque_peak_Nm": torque[:rows] * rng.uniform(1.5, 2.0),
        "temperature_degC": heat,
        "stiffness_Nm_per_rad": stiffness * (1.0 + 0.012 * rng.normal(size=rows)),
    }
    for beta, share in enumerate(NOISE_SHARES.get(cause, (1.0,) * 5)):
        told = share * loud + 0.008 * (heat - 30.0) + 0.12 * rng.normal(size=rows)
        columns[f"noise_a{beta}"] = 10.0 ** (-3 - beta) * rng.lognormal(0.0, 0.3) * np.exp(told)

    def again(fresh: Generator, seen: int) -> float:
        other = [
            np.append(was[:seen], now[seen:]) for was, now in zip(course, _course(family, seed, fresh), strict=True)
        ]
        return float(len(FAILURES[family](np.random.default_rng(seed), *other)[0]))

    return Life(np.arange(1.0, rows + 1.0), columns, float(rows), cause, again)


def _course(family: str, seed: int, fresh: Generator) -> tuple[Array, Array, Array, Array]:
    """Torque [N m], speed [rpm], air [degC] and luck [0, 1] of every hour; the levels are those of a gear's seed."""
    own, hours = np.random.default_rng(seed + 1), np.arange(1.0, LONGEST_H + 1.0)
    torque, speed = LOADS.get(family, _wandering)(own, fresh)
    around = own.normal(32.0, 3.0) + 4.0 * np.sin(2 * np.pi * hours / 24.0) + coloured(fresh, LONGEST_H, 3.0, 150.0)
    return torque, speed, around, fresh.uniform(size=LONGEST_H)
