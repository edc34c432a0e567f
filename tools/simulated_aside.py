"""Gears that fail by laws nothing was chosen by, for `bench_life`: neither the product's nor those of other families.

Each has its own loads, sensors and way to end. Their figures are those of the first run; whoever changes the forecast
by looking at one of them moves it to `simulated_failures` and writes another.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from scipy.special import gammaincinv
from simulated_gears import RATED_NM, Array, Life

LOOKED_AT = ("film", "shocked", "threshold")
"""Since the first run the score and the stages by which members are weighed were chosen with the first two in sight;
features that were then not taken were tried on all three."""
LONGEST_H, SHORTEST_H = 25_000, 500
Course = tuple[Array, Array, Array, int, str]
"""Relative stiffness, noise over that of a new gear, kelvins gained, hours until the end, and the cause."""


def _threshold(rng: Generator, torque: Array, speed: Array, luck: Array) -> Course:
    """A crack through the wall that rests below a threshold (Klesnil and Lukas) and goes faster near its end (Forman);
    beside it a raceway whose pits widen in steps, each hour's chance by the torque's cube."""
    length, hour = 0.3 * rng.lognormal(0.0, 0.12), 0
    rate, tough = 6e-5 * rng.lognormal(0.0, 0.2), 7.5 * rng.lognormal(0.0, 0.04)
    pits, lasts = 0, int(rng.integers(28, 36))
    pitting = 1.3e-3 * rng.lognormal(0.0, 0.35)
    lengths, areas = np.zeros(len(torque)), np.zeros(len(torque))
    while hour < len(torque) - 1 and pits < lasts:
        pull = 2.2 * torque[hour] / RATED_NM * np.sqrt(length)
        if pull >= 0.93 * tough:
            break
        length += rate * max(pull**2.6 - 0.8, 0.0) / (1.0 - pull / tough) * speed[hour] / 1400.0
        chance = pitting * (torque[hour] / RATED_NM) ** 3 * speed[hour] / 1400.0 * (1.0 + 0.25 * pits)
        pits += int(luck[0, hour] < -np.expm1(-chance))
        lengths[hour], areas[hour] = length, pits
        hour += 1
    opened = lengths[:hour] - lengths[0]
    return (
        1.0 - 0.035 * opened,
        1.0 + 0.12 * areas[:hour],
        0.08 * areas[:hour],
        hour,
        "pits" if pits >= lasts else "crack",
    )


def _film(rng: Generator, torque: Array, speed: Array, luck: Array) -> Course:
    """Teeth wear by Archard where the oil film breaks; particles wear on, until a change of grease slows it; the gear
    ratchets once the teeth are too low for its own largest load."""
    film = (speed / 1400.0) ** 0.7 * (torque / RATED_NM) ** -0.2 * 1.6 * rng.lognormal(0.0, 0.1)
    bare = 1.0 / (1.0 + film**3)
    hard = 7e-4 * rng.lognormal(0.0, 0.25)
    changed = int(rng.uniform(1500, 4000))
    worn, dirt, height = 0.0, 0.0, np.zeros(len(torque))
    limit = 1.0 - 0.25 * float(np.quantile(torque, 0.99)) / (2.0 * RATED_NM)
    hour = 0
    while hour < len(torque) and worn < limit:
        step = hard * bare[hour] * torque[hour] / RATED_NM * (1.0 + 2.5 * dirt)
        worn, dirt = worn + step, 0.0 if hour % changed == 0 else dirt + step
        height[hour] = worn
        hour += 1
    worn_so_far = height[:hour]
    return 1.0 - 0.12 * worn_so_far**1.3, 1.0 + 0.9 * worn_so_far, 4.0 * worn_so_far, hour, "teeth"


def _shocked(rng: Generator, torque: Array, speed: Array, luck: Array) -> Course:
    """Collisions at random, each takes some of the strength; what is left shows little: hardly to be foreseen."""
    struck = luck[0] < 1.0 / 450.0
    left = 1.0 - np.cumsum(np.where(struck, 0.11 * gammaincinv(0.8, luck[1]), 0.0))
    hour = max(int(np.argmax(left <= 0.0)), 1)
    left = left[:hour]
    return 1.0 - 0.05 * (1.0 - left), np.exp(0.5 * (1.0 - left)), 0.0 * left, hour, "shock"


ASIDE: dict[str, Callable[[Generator, Array, Array, Array], Course]] = {
    "threshold": _threshold,
    "film": _film,
    "shocked": _shocked,
}


def run_aside(rng: Generator, family: str) -> Life:
    """One life, hourly. Shifts and weekends make the load; temperature follows it; sensors scatter."""
    while True:
        seed, fresh = int(rng.integers(2**62)), np.random.default_rng(int(rng.integers(2**62)))
        course = _course(seed, fresh)
        soft, loud, warm, rows, cause = ASIDE[family](np.random.default_rng(seed), *course)
        if SHORTEST_H < rows < LONGEST_H - 1:
            break
    torque, speed, _ = course
    hours = np.arange(1.0, LONGEST_H + 1.0)
    heat = 24.0 + 12.0 * torque[:rows] / RATED_NM + 3.0 * np.sin(hours[:rows] / 8766.0 * 2.0 * np.pi) + warm
    heat += rng.normal(0.0, 0.6, rows)
    stiffness = 1.5e4 * rng.lognormal(0.0, 0.06) * soft * (1.0 - 6e-4 * (heat - 30.0)) * rng.normal(1.0, 0.008, rows)
    columns = {
        "speed_in_rpm": speed[:rows],
        "torque_cubic_mean_Nm": torque[:rows],
        "torque_peak_Nm": torque[:rows] * 1.7,
        "temperature_degC": heat,
        "stiffness_Nm_per_rad": stiffness,
    }
    for beta, share in enumerate(rng.uniform(0.5, 1.0, 5)):
        level = 10.0 ** (-2.5 - beta) * rng.lognormal(0.0, 0.4) * (speed[:rows] / 1400.0) ** 0.3
        columns[f"noise_a{beta}"] = level * loud**share * np.exp(0.005 * (heat - 30.0)) * rng.lognormal(0.0, 0.1, rows)

    def again(fresh: Generator, seen: int) -> float:
        then = _course(seed, fresh)
        other = [
            np.concatenate((was[..., :seen], now[..., seen:]), axis=-1) for was, now in zip(course, then, strict=True)
        ]
        return float(ASIDE[family](np.random.default_rng(seed), *other)[3])

    return Life(hours[:rows], columns, float(rows), cause, again)


def _course(seed: int, fresh: Generator) -> tuple[Array, Array, Array]:
    """Torque [N m], speed [rpm] and luck (2, n) of every hour; the levels are those of a gear's seed."""
    own, hours = np.random.default_rng(seed + 1), np.arange(1.0, LONGEST_H + 1.0)
    shift = np.where(hours % 24 < own.uniform(10.0, 20.0), 1.0, own.uniform(0.4, 0.8))
    week = np.repeat(fresh.uniform(0.8, 1.2, LONGEST_H // 168 + 1), 168)[:LONGEST_H]
    torque = RATED_NM * own.uniform(0.6, 1.1) * shift * week * fresh.lognormal(0.0, 0.08, LONGEST_H)
    speed = own.uniform(900.0, 1900.0) * shift * fresh.lognormal(0.0, 0.05, LONGEST_H)
    return torque, speed, fresh.uniform(size=(2, LONGEST_H))
