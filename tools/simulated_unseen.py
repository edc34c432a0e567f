"""Gears that fail in ways written before the forecast was changed last, for `bench_life`: nothing was chosen by them.

Loads, sensors and laws are their own. A sensor may miss hours, a machine may stand still for days, and work may grow
over the years. Figures are those of the first run; whoever changes the forecast by looking at one of them says so in
`LOOKED_AT` and writes another.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from simulated_gears import RATED_NM, Array, Life

LOOKED_AT: tuple[str, ...] = ("loosened", "corroded")
LONGEST_H, SHORTEST_H = 22_000, 600
Seen = tuple[Array, Array, Array, Array]
"""Relative stiffness, logarithm of noise gained (5, n), kelvins gained, and what is left until failure (ends at 0)."""


def _loosened(own: Generator, torque: Array, speed: Array, luck: Array) -> Seen:
    """Screws of the flexspline's hub lose preload where a peak makes the joint slip (Junker 1969): the less is left,
    the smaller the peaks that do. It is soft while the joint gapes; at last it slips in every cycle."""
    slip_Nm, held = RATED_NM * own.normal(2.6, 0.15), 1.0
    settles, loses = 0.06 * own.lognormal(0.0, 0.3), 1.2e-3 * own.lognormal(0.0, 0.25)
    least = own.normal(0.45, 0.03)
    left = np.zeros(len(torque))
    for hour in range(len(torque)):
        peak = torque[hour] * (1.5 + 1.1 * luck[0, hour] ** 2)
        over = max(peak / (slip_Nm * held) - 0.3, 0.0)
        held -= loses * over**2 * speed[hour] / 1500.0
        left[hour] = held - settles * (1.0 - np.exp(-hour / 150.0)) - least
        if left[hour] <= 0.0:
            break
    left = left[: hour + 1]
    gone = 1.0 - least - left
    rattle = np.outer((0.2, 0.5, 1.0, 0.7, 0.3), np.maximum(gone - 0.2, 0.0) ** 1.5 * own.lognormal(1.0, 0.1))
    return 1.0 - 0.14 * gone - 0.2 * gone**3, rattle, 1.0 * gone, left


def _corroded(own: Generator, torque: Array, speed: Array, luck: Array) -> Seen:
    """Water in the grease: rust grows while the gear rests, pits are rolled over while it runs, and a raceway whose
    pits join breaks out. Of the time at rest no load tells; tooth wear by particles of rust goes on beside it."""
    wet, rolled = 2.2e-4 * own.lognormal(0.0, 0.25), 1.3e-4 * own.lognormal(0.0, 0.25)
    rust, broken, worn = 0.0, 0.02, 0.0
    track = np.zeros((3, len(torque)))
    limit, teeth = own.lognormal(0.0, 0.06), 0.7 * own.lognormal(0.0, 0.08)
    for hour in range(len(torque)):
        runs = speed[hour] > 0.0
        rust += wet * (1.0 if not runs else 0.25) * (0.6 + 0.8 * luck[1, hour])
        load = (torque[hour] / RATED_NM) ** 3 * speed[hour] / 1500.0
        broken += rolled * load * rust * (1.0 + 4.0 * broken)
        worn += 0.7e-4 * rust * torque[hour] / RATED_NM * speed[hour] / 1500.0
        track[:, hour] = rust, broken, worn
        if broken >= limit or worn >= teeth:
            break
    rust_at, broken_at, worn_at = track[:, : hour + 1]
    heard = np.outer((0.4, 0.5, 0.7, 1.0, 1.2), 0.1 * rust_at) + np.outer((1.3, 1.2, 1.0, 0.5, 0.3), broken_at)
    left = np.minimum(limit - broken_at, teeth - worn_at)
    return 1.0 - 0.03 * broken_at - 0.17 * worn_at, heard, 5.0 * broken_at**2, left


def _silted(own: Generator, torque: Array, speed: Array, luck: Array) -> Seen:
    """Particles of wear stay in the grease and wear on; now and then it is changed, and two thirds of them leave."""
    wears, grinds = 0.9e-4 * own.lognormal(0.0, 0.25), 4.5 * own.lognormal(0.0, 0.15)
    limit, worn, dirt, clean = own.lognormal(0.0, 0.06), 0.0, 0.0, 1000.0 + 4000.0 * luck[0, 0]
    track = np.zeros((2, len(torque)))
    for hour in range(len(torque)):
        lost = wears * (torque[hour] / RATED_NM) ** 1.4 * speed[hour] / 1500.0 * (1.0 + grinds * dirt)
        worn, dirt = worn + lost, dirt + 0.9 * lost
        if hour > clean:
            dirt, clean = 0.35 * dirt, hour + 2500.0 + 2500.0 * luck[1, hour]
        track[:, hour] = worn, dirt
        if worn >= limit:
            break
    worn_at, dirt_at = track[:, : hour + 1]
    heard = np.outer((0.3, 0.5, 1.0, 0.6, 0.1), worn_at) + np.outer((1.1, 0.7, 0.0, 0.0, 0.0), dirt_at)
    return 1.0 - 0.07 * worn_at**1.2, np.log1p(heard), 4.0 * dirt_at, limit - worn_at


UNSEEN: dict[str, Callable[[Generator, Array, Array, Array], Seen]] = {
    "loosened": _loosened,
    "corroded": _corroded,
    "silted": _silted,
}
RESTS = {"loosened": 0.0, "corroded": 0.35, "silted": 0.12}
"""Share of days on which the machine stands still."""
PACES, LOUDER = {"silted": 0.12}, {"silted": 1.5}
"""How unlike the speeds of its campaigns are, as an sd of the logarithm, and the power of the speed in the noise; no
more than the hours differ, and 0.4, elsewhere."""


def run_unseen(rng: Generator, family: str) -> Life:
    """One life, hourly, of a machine whose sensors are its own; drawn again if too short or too long."""
    while True:
        seed, fresh = int(rng.integers(2**62)), np.random.default_rng(int(rng.integers(2**62)))
        course = _work(seed, fresh, family)
        soft, loud, warm, left = UNSEEN[family](np.random.default_rng(seed), *course)
        rows = len(left)
        if left[-1] <= 0.0 and rows > SHORTEST_H:
            break
    torque, speed, _ = (part[..., :rows] for part in course)
    hours, runs = np.arange(1.0, rows + 1.0), course[1][:rows] > 0.0
    season = np.sin(2.0 * np.pi * hours / 8766.0 + rng.uniform(0.0, 6.28))
    heat = 21.0 + 6.0 * season + rng.normal(0.0, 0.8, rows) + warm
    heat += np.where(runs, 14.0 * torque / RATED_NM * np.sqrt(speed / 1500.0), 0.0)
    stiffness = 1.62e4 * rng.lognormal(0.0, 0.04) * soft * (1.0 - 7e-4 * (heat - 25.0)) * rng.normal(1.0, 0.01, rows)
    # stiffness needs a motion with reversals, which not every hour has
    stiffness = np.where(runs & (rng.uniform(size=rows) < rng.uniform(0.3, 0.9)), stiffness, np.nan)
    columns = {
        "speed_in_rpm": speed,
        "torque_cubic_mean_Nm": torque,
        "torque_peak_Nm": np.where(runs, torque * 2.0, 0.0),
        "temperature_degC": heat,
        "stiffness_Nm_per_rad": stiffness,
    }
    for beta in range(5):
        level = np.log(10.0 ** (-3 - beta)) + rng.normal(0.0, 0.3) + loud[beta] + 0.006 * (heat - 30.0)
        level += LOUDER.get(family, 0.4) * np.log(np.maximum(speed, 1.0) / 1500.0) + rng.normal(0.0, 0.15, rows)
        columns[f"noise_a{beta}"] = np.where(runs, np.exp(level), np.nan)

    def again(fresh: Generator, seen: int) -> float:
        then = _work(seed, fresh, family)
        other = [
            np.concatenate((was[..., :seen], now[..., seen:]), axis=-1) for was, now in zip(course, then, strict=True)
        ]
        return float(len(UNSEEN[family](np.random.default_rng(seed), *other)[3]))

    return Life(hours, columns, float(rows), family, again)


def _work(seed: int, fresh: Generator, family: str) -> tuple[Array, Array, Array]:
    """Torque [N m], speed [rpm] and luck (2, n) of every hour: campaigns of weeks, and work that grows by the year."""
    own, days = np.random.default_rng(seed + 1), LONGEST_H // 24 + 1
    weeks = fresh.geometric(1.0 / 2.0, days)
    campaign = np.repeat(fresh.normal(1.0, 0.08, days), weeks * 7)[:days]
    stands = fresh.uniform(size=days) < RESTS[family]
    grows = np.linspace(0.0, own.uniform(-0.1, 0.3), days)
    torque = np.repeat(RATED_NM * own.uniform(0.65, 1.15) * np.clip(campaign, 0.5, 1.6) * (1.0 + grows), 24)[:LONGEST_H]
    torque = torque * fresh.lognormal(0.0, 0.1, LONGEST_H)
    speed = np.repeat(own.uniform(1000.0, 2000.0) * np.where(stands, 0.0, 1.0), 24)[:LONGEST_H]
    speed = speed * fresh.lognormal(0.0, 0.06, LONGEST_H)
    luck = fresh.uniform(size=(2, LONGEST_H))
    paces = np.repeat(np.exp(PACES.get(family, 0.0) * fresh.normal(size=days)), weeks * 7)[:days]
    return np.where(speed > 0.0, torque, 0.0), speed * np.repeat(paces, 24)[:LONGEST_H], luck
