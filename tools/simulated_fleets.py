"""Gears of many fleets that run to failure, for `bench_life`: a fleet has a law, a limit and a load of its own.

Where `simulated_gears` and `simulated_laws` fix a law and let its limit vary from gear to gear, here all that a fleet's
gears share is drawn once per fleet: what an engineer meets who knows nothing of the machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from simulated_gears import L50_H, RATED_NM, RATED_RPM, STIFFNESS_NM_PER_RAD, Array, Life, coloured

LONGEST_H, SHORTEST_H = 40_000, 500
LIMITS, CHANCES = (0.10, 0.15, 0.20, 0.25, 0.30, 0.40), (0.1, 0.2, 0.25, 0.15, 0.2, 0.1)
"""of stiffness lost at failure"""


@dataclass(frozen=True, slots=True)
class Fleet:
    """What the gears of a fleet have in common, and how far they scatter (sd of logarithms)."""

    law: str
    limit: float
    limit_sd: float
    power: float
    power_sd: float
    exponent: float
    """of torque"""
    gamma: float
    growth: float
    life_h: float
    life_sd: float
    loud: float
    """logarithm of the noise at failure"""
    loud_power: float
    loud_sd: float
    stiffness_noise: float
    noise_noise: float
    bearing: bool
    """whether the bearing competes"""
    same: bool
    """whether noise follows fatigue even then"""
    load: float
    load_sd: float


def draw_fleet(rng: Generator) -> Fleet:
    """A fleet of any kind."""
    return Fleet(
        law=str(rng.choice([*GROWTHS, "power"])),
        limit=float(rng.choice(LIMITS, p=CHANCES)),
        limit_sd=rng.uniform(0.03, 0.15),
        power=rng.uniform(1.0, 3.0),
        power_sd=rng.uniform(0.03, 0.12),
        exponent=rng.uniform(3.0, 10.0),
        gamma=rng.uniform(0.5, 2.0),
        growth=rng.uniform(1.5, 4.5),
        life_h=math.exp(rng.uniform(math.log(3e3), math.log(2.5e4))),
        life_sd=rng.uniform(0.15, 0.45),
        loud=rng.uniform(0.3, 2.3),
        loud_power=rng.uniform(1.0, 3.0),
        loud_sd=rng.uniform(0.05, 0.25),
        stiffness_noise=rng.uniform(0.002, 0.015),
        noise_noise=rng.uniform(0.03, 0.15),
        bearing=bool(rng.uniform() < 0.4),
        same=bool(rng.uniform() < 0.5),
        load=rng.uniform(0.4, 1.1),
        load_sd=rng.uniform(0.02, 0.2),
    )


def _law(rng: Generator, fleet: Fleet, used: Array, power: float, limit: float) -> Array:
    """dD/du = (1 - gamma dK)^-m with dK = limit D^p: the clock u as a quadrature over D, turned around."""
    damage = np.linspace(0.0, 1.0, 4001)
    slow = (1.0 - np.clip(fleet.gamma * limit * damage ** min(power, 1.5), 0.0, 0.9)) ** fleet.exponent
    clock = np.concatenate(([0.0], np.cumsum(0.5 * (slow[1:] + slow[:-1]))))
    grown = np.interp(used, clock / clock[-1], damage) ** min(power, 1.5)
    return np.where(used < 1.0, grown, 1.0)


def _crack(rng: Generator, fleet: Fleet, used: Array, power: float, limit: float) -> Array:
    start, half = 0.15 + 0.2 * rng.uniform(), 0.1 + 0.25 * power
    size = (start**-half - np.minimum(used, 1.0) * (start**-half - 1.0)) ** (-1.0 / half)
    return np.asarray((size - start) / (1.0 - start))


def _exponential(rng: Generator, fleet: Fleet, used: Array, power: float, limit: float) -> Array:
    rate = fleet.growth * rng.lognormal(0.0, 0.1)
    return np.asarray(np.expm1(rate * np.minimum(used, 1.0)) / math.expm1(rate))


def _steps(rng: Generator, fleet: Fleet, used: Array, power: float, limit: float) -> Array:
    mean = np.minimum(used, 1.2) ** power
    return np.asarray(np.cumsum(rng.gamma(np.maximum(np.diff(mean, prepend=0.0) * 300.0, 1e-9))) / 300.0)


def _power(rng: Generator, fleet: Fleet, used: Array, power: float, limit: float) -> Array:
    return np.asarray(np.minimum(used, 1.2) ** power)


GROWTHS: dict[str, Callable[[Generator, Fleet, Array, float, float], Array]] = {
    "law": _law,
    "crack": _crack,
    "exponential": _exponential,
    "steps": _steps,
    "power": _power,
}
"""loss of stiffness over that at failure, (n,), at the used shares of a life"""


def run_of_fleet(rng: Generator, fleet: Fleet | None = None) -> Life:
    """One life, hourly, of a gear of the fleet, or of a fleet of its own; again if too short or too long."""
    fleet = fleet or draw_fleet(rng)
    while True:
        n = LONGEST_H
        torque = RATED_NM * fleet.load * rng.lognormal(0.0, fleet.load_sd) * np.exp(coloured(rng, n, 0.1, 50.0))
        speed = rng.uniform(800.0, 2000.0) * np.exp(coloured(rng, n, 0.1, 50.0))
        step = (torque / RATED_NM / fleet.load) ** fleet.exponent * speed * np.exp(coloured(rng, n, 0.2, 100.0))
        used = np.cumsum(step) / step.mean() / (fleet.life_h * rng.lognormal(0.0, fleet.life_sd))
        limit = fleet.limit * rng.lognormal(0.0, fleet.limit_sd)
        power = fleet.power * rng.lognormal(0.0, fleet.power_sd)
        wear = GROWTHS[fleet.law](rng, fleet, used, power, limit)
        end, cause, bearing = int(np.searchsorted(wear, 1.0)), "fatigue", np.minimum(used, 1.0)
        if fleet.bearing:
            rated = np.cumsum((torque / RATED_NM) ** 3 * speed / RATED_RPM)
            bearing = rated / (1.368 * L50_H * rng.weibull(1.17))
            first = int(np.searchsorted(bearing, 1.0))
            end, cause = (first, "bearing") if first < end else (end, cause)
        if SHORTEST_H < end < n - 1:
            break
    hours = np.arange(1.0, n + 1.0)
    warm = 35.0 + 5.0 * np.sin(2.0 * np.pi * hours / 24.0) + coloured(rng, n, 3.0, 200.0)
    gained = _gained(rng, fleet, wear[:end], bearing[:end], power)
    stiffness = STIFFNESS_NM_PER_RAD * rng.lognormal(0.0, 0.04) * (1.0 - limit * wear) * (1.0 - 4e-4 * (warm - 25.0))
    columns = {
        "stiffness_Nm_per_rad": (stiffness * (1.0 + fleet.stiffness_noise * rng.normal(size=n)))[:end],
        "speed_in_rpm": speed[:end],
        "torque_cubic_mean_Nm": torque[:end],
        "torque_peak_Nm": 1.6 * torque[:end],
        "temperature_degC": warm[:end],
    }
    for beta in range(5):
        heard = gained * (1.0 - 0.1 * beta) + fleet.noise_noise * rng.normal(size=end)
        columns[f"noise_a{beta}"] = 1e-3 * rng.lognormal(0.0, 0.4) * np.exp(heard)
    return Life(hours[:end], columns, float(end), cause)


def _gained(rng: Generator, fleet: Fleet, wear: Array, bearing: Array, power: float) -> Array:
    """Logarithm of the noise: of fatigue, of the bearing where it competes, or the louder of the two."""
    size = fleet.loud * rng.lognormal(0.0, fleet.loud_sd)
    fatigue = size * np.clip(wear, 0.0, 1.2) ** max(fleet.loud_power / power, 0.5)
    if not fleet.bearing:
        return np.asarray(fatigue)
    worn = size * np.clip(bearing, 0.0, 1.2) ** fleet.loud_power
    return np.asarray(np.maximum(fatigue, worn) if fleet.same else worn)
