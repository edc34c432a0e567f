"""What a fleet has taught, as a gear's prior: a version, a Weibull law over use, and how use counts torque.

The maker's law says how long a gear lives at its load; the fleet's law says it with its own exponent. What is believed
of a drive is therefore worked out at that drive's own load. A gateway reads this file too: no heavy library here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec
import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.prognose.forecast import BROAD, FailureKind, Prior
from edge_daemon.prognose.history import usable
from edge_daemon.prognose.learn import DOUBT_LEARNED, LEAST_SD
from edge_daemon.records import Array
from edge_daemon.usage.gears import Gear
from edge_daemon.usage.ledger import EXPONENTS, Ledger, rows_of

SCHEMA = "strainwave/prior"
SCHEMA_VERSION = 1
EULER = 0.5772156649015329
"""The mean of the logarithm of a Weibull life lies this over the shape below that of its scale."""
USUAL_RPM = 1000.0
"""This speed is assumed where none is known: it moves the scale, not shape and exponent."""
LARGEST, LEAST_SHAPE = 700.0, 1e-3
"""No logarithm of a time is larger, and no gear's exponent; lives of a flatter shape are spread over all times."""


class FleetPrior(msgspec.Struct, frozen=True):
    """Equally likely laws: (n,) each."""

    schema: str
    schema_version: int
    gear: str
    number: int
    """of this prior: a later one is larger"""
    drives: int
    failed: int
    exponent: list[float]
    shape: list[float]
    log_scale: list[float]
    """logarithm of the characteristic life [h] at the gear's rated torque and `USUAL_RPM`"""

    def to_bytes(self) -> bytes:
        """For `prior_from`."""
        return msgspec.json.encode(self)

    def at(self, ledger: Ledger) -> Prior:
        """What is believed of a drive with this load so far (one row or more); how wear shows, as of any gear."""
        exponent, shape, log_scale = (np.array(row) for row in (self.exponent, self.shape, self.log_scale))
        hours = float(np.sum(ledger.hours))
        rate = np.log(np.maximum(np.sum(ledger.strain, axis=1) / hours, 1e-300))
        usual = math.log(60.0 * USUAL_RPM)
        life = log_scale + usual - np.interp(exponent, EXPONENTS, rate)
        beyond = np.clip(exponent - EXPONENTS[-1], 0.0, None) + np.clip(exponent - EXPONENTS[0], None, 0.0)
        slope = (rate[-1] - rate[0]) / (EXPONENTS[-1] - EXPONENTS[0])
        mean = life - slope * beyond - EULER / shape + math.log(max(float(np.sum(ledger.fatigue)) / hours, 1e-300))
        within = math.pi / (math.sqrt(6.0) * shape)
        sd = math.sqrt(float(np.mean(within**2) + np.var(mean)))
        (kind,) = BROAD.kinds
        belief = FailureKind((float(np.mean(mean)), max(sd, LEAST_SD)), kind.stiffness, kind.noise, kind.alone, "fleet")
        return Prior((belief,), DOUBT_LEARNED)


def prior_from(blob: bytes) -> FleetPrior | None:
    """The prior of `FleetPrior.to_bytes`; None for another file. Raises `BadInput` if it is broken."""
    if SCHEMA.encode() not in blob[:200]:
        return None
    try:
        found = msgspec.json.decode(blob, type=FleetPrior)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"fleet's prior: {error}") from error
    sizes = {len(found.exponent), len(found.shape), len(found.log_scale)}
    numbers = np.array([*found.exponent, *found.shape, *found.log_scale])
    if found.schema_version != SCHEMA_VERSION:
        raise BadInput(f"fleet's prior: of version {found.schema_version}: expected {SCHEMA_VERSION}")
    if len(sizes) != 1 or not numbers.size or not (np.abs(numbers) <= LARGEST).all() or min(found.shape) < LEAST_SHAPE:
        sizes_told = f"numbers up to {LARGEST:g}, a shape of at least {LEAST_SHAPE:g}"
        raise BadInput(f"fleet's prior: expected laws with an exponent, a shape and a scale each: {sizes_told}")
    return found


def prior_at(blob: bytes, gear: Gear, time_h: Array, columns: Mapping[str, Array]) -> Prior | None:
    """What is believed of a drive with this history, (n,) each; None for a file that is no fleet's prior. Raises
    `BadInput` where it is broken or of another gear."""
    fleet = prior_from(blob)
    if fleet is None:
        return None
    of_this_gear(fleet.gear, gear)
    if not time_h.size:
        return fleet.at(as_rated(gear))
    used_h, used = usable(time_h, columns, gear)
    steps = np.diff(used_h)
    usual = float(np.median(steps)) if steps.size else 1.0
    return fleet.at(rows_of(gear, used_h, np.concatenate(([usual], steps)), used))


def of_this_gear(name: str, gear: Gear) -> None:
    """Raises `BadInput` where a prior was learned from gears of another name."""
    if name != gear.name:
        raise BadInput(f"was learned from gears of {name}: this is a {gear.name}")


def as_rated(gear: Gear) -> Ledger:
    """An hour at rated torque and speed: what is expected of a drive that has not run."""
    hour = np.ones(1)
    used = {"speed_in_rpm": hour * gear.rated_speed_rpm, "torque_cubic_mean_Nm": hour * gear.rated_torque_Nm}
    used_h, used = usable(hour, used, gear)
    return rows_of(gear, used_h, hour, used)
