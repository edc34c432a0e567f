"""Gears that run to failure by laws that the product does not assume: the truth for `bench_life`.

Nothing here is imported from the package but the catalogue's figures of a gear. Every gear has its own capacity, its
own amount of wear at failure and its own shape of it; damage feeds back on itself, wear comes in jumps, sensors have
coloured noise and follow the temperature. `FAMILIES` differ in what wear looks like from outside.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATED_NM, RATED_RPM, L50_H = 52.0, 2000.0, 50_000.0
"""of CSG-20-100"""
STIFFNESS_NM_PER_RAD = 1.6e4


@dataclass(frozen=True, slots=True)
class Life:
    """A whole life, hourly: columns as in a history file; the gear fails at `life_h`."""

    time_h: Array
    columns: dict[str, Array]
    life_h: float
    cause: str
    """`fatigue` or `bearing`"""
    again: Callable[[Generator, int], float] | None = None
    """the end [h] of the very same gear if after so many rows its loads and its luck were drawn anew; None: unknown"""

    def until(self, share: float) -> tuple[Array, dict[str, Array]]:
        """The history as it stood when `share` of the life was over."""
        rows = max(int(share * self.time_h.size), 1)
        return self.time_h[:rows], {name: values[:rows] for name, values in self.columns.items()}


@dataclass(frozen=True, slots=True)
class Wear:
    """What is seen of a gear: functions of the used shares of flexspline and bearing, (n,) arrays in [0, 1]."""

    lost: Callable[[Array, Array], Array]
    """relative stiffness lost"""
    gained: Callable[[Array, Array], Array]
    """logarithm of the noise coefficients' growth"""


def coloured(rng: Generator, n: int, sd: float, hours: float) -> Array:
    """First-order autoregressive noise with a correlation time."""
    from scipy.signal import lfilter

    keep = math.exp(-1.0 / hours)
    white = rng.normal(size=n) * sd * math.sqrt(1.0 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], white))


def jumping(rng: Generator, share: Array, jumps: float) -> Array:
    """Wear that comes in random portions: a gamma process around `share` (mean unchanged, ends at about 1)."""
    if share.size < 2:
        return share
    portions = np.diff(share, prepend=0.0)
    drawn = rng.gamma(np.maximum(portions, 1e-12) * jumps) / jumps
    return np.asarray(np.clip(np.cumsum(drawn), 0.0, 1.5))


def fleet(rng: Generator) -> Wear:
    """Gears of one machine type: partly linear, partly accelerating wear up to one limit of stiffness or noise."""
    loss, bend, line = 0.2 * rng.lognormal(0.0, 0.06), rng.uniform(1.3, 1.7), rng.uniform(0.25, 0.35)
    return _partly_linear(rng, loss, bend, line, rng.uniform(3.5, 4.5), rng.uniform(1.3, 1.6))


def mixed(rng: Generator) -> Wear:
    """Partly linear, partly accelerating, each gear its own; the bearing is heard by saturating growth."""
    loss, bend, line = 0.2 * rng.lognormal(0.0, 0.15), rng.uniform(1.6, 2.6), rng.uniform(0.2, 0.4)
    return _partly_linear(rng, loss, bend, line, rng.uniform(3.0, 5.0), rng.uniform(1.3, 2.0))


def _partly_linear(rng: Generator, loss: float, bend: float, line: float, loud: float, rise: float) -> Wear:
    side, hum = 0.02 * rng.lognormal(0.0, 0.3), rng.uniform(0.1, 0.4)
    return Wear(
        lambda f, b: loss * (line * f + (1 - line) * f**bend) + side * b**2,
        lambda f, b: np.log1p(loud * b**rise) + hum * f**2,
    )


def article(rng: Generator) -> Wear:
    """Stiffness falls with a power of damage, noise grows with the square of bearing wear."""
    loss, bend, loud = rng.uniform(0.1, 0.3), rng.uniform(1.0, 3.0), rng.uniform(1.0, 6.0)
    return Wear(lambda f, b: loss * f**bend, lambda f, b: np.log1p(loud * b**2))


def exponential(rng: Generator) -> Wear:
    """Both grow exponentially."""
    loss, k, loud, q = rng.uniform(0.1, 0.3), rng.uniform(2.0, 6.0), rng.uniform(0.5, 2.5), rng.uniform(2.0, 6.0)
    return Wear(
        lambda f, b: loss * np.expm1(k * f) / math.expm1(k),
        lambda f, b: loud * np.expm1(q * b) / math.expm1(q),
    )


def crossed(rng: Generator) -> Wear:
    """Each kind of wear shows in both, as where one damage number drives a simulation."""
    loss, bend, loud = rng.uniform(0.12, 0.28), rng.uniform(1.0, 2.5), rng.uniform(0.5, 2.0)
    return Wear(
        lambda f, b: loss * np.maximum(f, b) ** bend,
        lambda f, b: loud * np.maximum(f, b) ** bend,
    )


def spall(rng: Generator) -> Wear:
    """Nothing until a crack or a spall starts, then fast growth."""
    start, loss, loud, begin = (
        rng.uniform(0.3, 0.7),
        rng.uniform(0.1, 0.3),
        rng.uniform(1.0, 2.5),
        rng.uniform(0.3, 0.7),
    )
    return Wear(
        lambda f, b: loss * (0.15 * f + 0.85 * (np.maximum(f - start, 0.0) / (1.0 - start)) ** 1.5),
        lambda f, b: loud * (0.1 * b + 0.9 * (np.maximum(b - begin, 0.0) / (1.0 - begin)) ** 1.5),
    )


FAMILIES: dict[str, Callable[[Generator], Wear]] = {
    row.__name__: row for row in (fleet, mixed, article, exponential, crossed, spall)
}


ALIKE = {"fleet": ((1.5, 2.5), 0.04)}
UNLIKE = ((1.0, 4.0), 0.15)
"""of a family: range of damage's feedback on its own rate, and spread of torque between campaigns"""


def run_to_failure(rng: Generator, family: str = "mixed", longest_h: int = 60_000) -> Life:
    """One life of a CSG-20-100 at a load of its own. Lives that would outlast `longest_h` are drawn again."""
    while True:
        hours = np.arange(1.0, longest_h + 1.0)
        (low, high), spread = ALIKE.get(family, UNLIKE)
        torque, peak, speed, temperature = _load(rng, hours, spread)
        feedback, exponent = rng.uniform(low, high), rng.uniform(5.0, 9.0)
        fatigue_life = 30_000.0 * rng.lognormal(0.0, 0.5)
        strain = np.cumsum((torque / (1.1 * RATED_NM)) ** exponent * speed / 1500.0) / fatigue_life
        # dD/du = 1 + feedback D^2 in the clock u that ends at 1
        root = math.sqrt(feedback)
        end = math.atan(root) / root
        fatigue = np.tan(np.minimum(strain * end, end) * root) / root
        capacity = L50_H * 1.368 * rng.weibull(1.17)
        rated = np.cumsum((torque / RATED_NM) ** 3 * speed / RATED_RPM) / capacity
        snowball = rng.uniform(0.2, 1.0)
        bearing = np.expm1(np.minimum(rated, 1.0) * math.log1p(snowball)) / snowball
        fails = np.minimum(_first(strain, 1.0), _first(rated, 1.0))
        if 1000 < fails < longest_h:
            break
    rows = int(fails)
    cause = "fatigue" if _first(strain, 1.0) <= _first(rated, 1.0) else "bearing"
    wear = FAMILIES[family](rng)
    f, b = (jumping(rng, share[:rows], 3000.0) for share in (fatigue, bearing))
    columns = _sensed(rng, wear, np.clip(f, 0.0, 1.0), np.clip(b, 0.0, 1.0), temperature[:rows])
    columns |= {
        "speed_in_rpm": speed[:rows],
        "torque_cubic_mean_Nm": torque[:rows],
        "torque_peak_Nm": peak[:rows],
        "temperature_degC": temperature[:rows],
    }
    return Life(hours[:rows], columns, float(rows), cause)


def _first(clock: Array, level: float) -> int:
    return int(np.searchsorted(clock, level))


def _load(rng: Generator, hours: Array, spread: float) -> tuple[Array, Array, Array, Array]:
    """Torque (cubic mean, peak) [N m], speed [rpm] and temperature [degC] with shifts, days, seasons and campaigns."""
    n = hours.size
    campaign = np.ones(n)
    for start in rng.integers(0, n, rng.integers(0, 4)):
        campaign[start:] = rng.uniform(1.0 - spread, 1.0 + spread)
    shift = np.where((hours % 24 > 6) & (hours % 24 < 22), 1.0, 0.8)
    torque = rng.uniform(0.85, 1.3) * RATED_NM * campaign * shift * np.exp(coloured(rng, n, 0.08, 8.0))
    peak = torque * rng.uniform(1.4, 1.9) * np.exp(0.05 * np.abs(rng.normal(size=n)))
    speed = rng.uniform(1000.0, 2000.0) * np.exp(coloured(rng, n, 0.1, 8.0))
    ambient = (
        22 + 5 * np.sin(2 * np.pi * (hours - 9) / 24) + 6 * np.sin(2 * np.pi * hours / 8766 + rng.uniform(0, 6.28))
    )
    temperature = ambient + 12 * (torque / RATED_NM) * speed / 1500 + coloured(rng, n, 1.0, 30.0)
    return torque, peak, speed, temperature


def _sensed(rng: Generator, wear: Wear, f: Array, b: Array, temperature: Array) -> dict[str, Array]:
    """Stiffness and noise coefficients as an estimator would give them."""
    n = f.size
    stiffness = STIFFNESS_NM_PER_RAD * rng.lognormal(0.0, 0.05) * (1.0 - wear.lost(f, b))
    stiffness *= (1.0 - 4e-4 * (temperature - 25.0)) * np.exp(
        coloured(rng, n, 0.003, 40.0) + 0.008 * rng.normal(size=n)
    )
    columns = {"stiffness_Nm_per_rad": stiffness}
    grown = wear.gained(f, b)
    for beta, share in enumerate((1.0, 0.8, 0.6, 0.9, 0.7)):
        noise = 1e-4 * rng.lognormal(0.0, 0.5) * np.exp(share * grown + 0.01 * (temperature - 25.0))
        columns[f"noise_a{beta}"] = noise * np.exp(coloured(rng, n, 0.05, 60.0) + 0.15 * rng.normal(size=n))
    return columns
