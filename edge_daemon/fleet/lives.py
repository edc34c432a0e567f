"""What a fleet's lives teach, those that go on included: the exponent of damage and a Weibull law.

A drive's use is the sum of its turns, weighed by (torque / rated torque)^m. Uses at failure follow a Weibull law; a
drive that has not failed says that its own is larger. m, shape and scale have the posterior of a flat prior on a grid
(the likelihood of right-censored lives: Meeker and Escobar 1998, Statistical Methods for Reliability Data, eq. 7.8 and
17.5; a hazard per hour is that per use times the use per hour of late).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.fleet.past import DrivePast
from edge_daemon.fleet.prior import USUAL_RPM
from edge_daemon.prognose.learn import FEWEST
from edge_daemon.records import NE107, Array
from edge_daemon.usage.gears import Gear

EXPONENTS = np.arange(0.0, 16.01, 0.1)
SHAPES = np.geomspace(0.3, 12.0, 120)
SCALES = np.linspace(-6.0, 6.0, 97)
"""The logarithm of the scale is looked at on this grid around its best value, in standard errors."""
INTERVAL = 0.9
WELL = 0.8
"""A drive that says `failure` with more than this of its health has lost a sensor, not its gear (guess)."""
TURN_RAD = 2.0 * math.pi


@dataclass(frozen=True, slots=True)
class FleetLife:
    """One drive's life until it failed or was last heard of."""

    drive: str
    hours: float
    failed: bool
    torque_Nm: Array
    """(n,) bins"""
    share: Array
    """(n,) of the hours in each"""
    speed_rpm: float


@dataclass(frozen=True, slots=True)
class WeibullLaw:
    """Posterior over exponent, shape and scale: (cells,) values and weights."""

    exponent: Array
    shape: Array
    log_scale: Array
    """logarithm of the characteristic life [h] at rated torque and `USUAL_RPM`"""
    weight: Array

    def told(self, name: str) -> dict[str, float]:
        """Median, sd and central 90 % interval."""
        values = getattr(self, name)
        order = np.argsort(values, kind="stable")
        levels, last = np.unique(values[order][::-1], return_index=True)
        mass = np.cumsum(self.weight[order])[len(values) - 1 - last]
        middle = mass - 0.5 * np.diff(mass, prepend=0.0)
        edge = (1.0 - INTERVAL) / 2.0
        low, median, high = (float(np.interp(p, middle, levels)) for p in (edge, 0.5, 1.0 - edge))
        mean = float(self.weight @ values)
        sd = math.sqrt(max(float(self.weight @ (values - mean) ** 2), 0.0))
        return {"median": median, "sd": sd, "from": low, "to": high}


def lives_of(drives: Sequence[DrivePast]) -> tuple[list[FleetLife], list[str]]:
    """The lives of drives whose load and hours are known, and the drives left out, each with the reason."""
    lives, out = [], []
    for past in drives:
        torque, share = past.torques_Nm()
        hours = past.newest("operating_hours")
        if not math.isfinite(hours):
            hours = (past.last_s - past.first_s) / 3600.0
        if not np.isfinite(torque).all() or not torque.max() > 0.0:
            out.append(f"{past.drive}: no torque is known")
        elif not (math.isfinite(hours) and hours > 0.0):
            out.append(f"{past.drive}: no hours are known")
        else:
            speed = abs(past.mean("speed_in")) * 60.0 / TURN_RAD
            speed = speed if math.isfinite(speed) and speed > 0.0 else USUAL_RPM
            lives.append(FleetLife(past.drive, hours, has_failed(past), torque, share, speed))
    return lives, out


def has_failed(past: DrivePast) -> bool:
    """By its last word: nothing is left of its health, or the state `failure` of a gear that was not well."""
    state, health, damage = (past.newest(name) for name in ("ne107", "health_index", "damage"))
    return health <= 0.0 or damage >= 1.0 or (state == NE107.FAILURE and not health >= WELL)


def weibull_law(lives: Sequence[FleetLife], rated_Nm: float) -> WeibullLaw:
    """Raises `BadInput` for fewer than five failures."""
    failed = np.array([life.failed for life in lives], dtype=bool)
    if failed.sum() < FEWEST:
        raise BadInput(
            f"{int(failed.sum())} of {len(lives)} drives have failed: expected at least {FEWEST} to learn from"
        )
    count = int(failed.sum())
    use = np.array([_log_use(life, rated_Nm) for life in lives])
    rate = use - np.log([[life.hours] for life in lives])
    shape = SHAPES[:, None]
    cells = np.empty((len(EXPONENTS), len(SHAPES), len(SCALES)))
    scales = np.empty_like(cells)
    for i in range(len(EXPONENTS)):
        x = use[:, i]
        top = float(x.max())
        power = np.exp(SHAPES[:, None] * (x - top)[None]).sum(axis=1)
        best = top + np.log(power / count) / SHAPES
        """(shapes,) where the likelihood of the scale is highest"""
        log_scale = best[:, None] + SCALES / (SHAPES[:, None] * math.sqrt(count))
        total = count * (np.log(shape) - shape * log_scale) + (shape - 1.0) * x[failed].sum() + rate[failed, i].sum()
        spent = np.exp(shape * (top - log_scale)) * power[:, None]
        cells[i] = (
            total - spent - np.log(SHAPES[:, None])
        )  # flat in the logarithm of scale: cells are as wide as 1/shape
        scales[i] = log_scale
    cells += np.log(np.gradient(SHAPES))[None, :, None]
    weight = np.exp(cells - cells.max())
    grid = np.broadcast_to(EXPONENTS[:, None, None], cells.shape), np.broadcast_to(SHAPES[:, None], cells.shape)
    return WeibullLaw(grid[0].ravel(), grid[1].ravel(), scales.ravel(), weight.ravel() / weight.sum())


def _log_use(life: FleetLife, rated_Nm: float) -> Array:
    """(exponents,) logarithm of the hours at rated torque and usual speed that cost as much."""
    load = np.log(life.torque_Nm / rated_Nm)
    weighed = np.exp(EXPONENTS[:, None] * (load - load.max())) @ life.share
    hours = life.hours * life.speed_rpm / USUAL_RPM
    return np.asarray(EXPONENTS * load.max() + np.log(weighed) + math.log(hours))


def learned_json(lives: Sequence[FleetLife], law: WeibullLaw, gear: Gear, out: Sequence[str]) -> dict[str, Any]:
    """What was learned, for a file."""
    scale = law.told("log_scale")
    return {
        "gear": gear.name,
        "drives": len(lives),
        "failed": sum(life.failed for life in lives),
        "censored": sum(not life.failed for life in lives),
        "left_out": list(out),
        "weibull_shape": law.told("shape"),
        "damage_exponent": law.told("exponent"),
        "characteristic_life_h": {
            **{name: math.exp(scale[name]) for name in ("median", "from", "to")},
            "sd": math.exp(scale["median"]) * scale["sd"],
        },
        "at": {"torque_Nm": gear.rated_torque_Nm, "speed_in_rpm": USUAL_RPM},
    }
