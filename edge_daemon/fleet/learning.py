"""From a dataset to what it teaches of a gear: the posterior of its lives, and the prior that gateways take."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.fleet.lives import FleetLife, WeibullLaw, learned_json, lives_of, weibull_law
from edge_daemon.fleet.past import of_one_gear, pasts
from edge_daemon.fleet.prior import SCHEMA, SCHEMA_VERSION, FleetPrior
from edge_daemon.usage.gears import Gear, find_gear

MOST_CELLS = 400
"""The posterior is kept as so many equally likely laws."""


def fleet_prior(gear: Gear, law: WeibullLaw, lives: Sequence[FleetLife], number: int) -> FleetPrior:
    """The laws of a posterior, drawn evenly by their weight."""
    levels = (np.arange(MOST_CELLS) + 0.5) / MOST_CELLS
    cells = np.searchsorted(np.cumsum(law.weight), levels).clip(0, len(law.weight) - 1)
    return FleetPrior(
        SCHEMA,
        SCHEMA_VERSION,
        gear.name,
        number,
        len(lives),
        sum(life.failed for life in lives),
        law.exponent[cells].tolist(),
        law.shape[cells].tolist(),
        law.log_scale[cells].tolist(),
    )


def learned(folder: Path, named: str | None, scheduler: str | None, out: Path | None) -> dict[str, Any]:
    """What a dataset teaches of a gear, with its prior written to `out`. Raises `BadInput`."""
    named = find_gear(named).name if named else ""
    name, drives = of_one_gear(pasts(folder, scheduler), named)
    gear = find_gear(name)
    lives, left_out = lives_of(drives)
    law = weibull_law(lives, gear.rated_torque_Nm)
    if out:
        try:
            out.write_bytes(fleet_prior(gear, law, lives, int(time.time())).to_bytes())
        except OSError as error:
            raise BadInput(f"{out}: cannot write: {error.strerror}") from error
    return learned_json(lives, law, gear, left_out)
