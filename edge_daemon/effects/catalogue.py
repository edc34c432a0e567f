"""The catalogue: every effect the product knows, by balance and name."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.effects import (
    angles,
    drive,
    drive_load,
    drive_waves,
    friction,
    hysteresis,
    loads,
    stiffness,
    torque_source,
)
from edge_daemon.effects.effect import Balance, Effect
from edge_daemon.effects.model import Model, ModelError
from edge_daemon.records import Motion
from edge_daemon.text import meant

CATALOGUE: dict[tuple[Balance, str], Effect] = {
    (row.balance, row.name): row
    for row in (
        *stiffness.ROWS,
        *friction.ROWS,
        *hysteresis.ROWS,
        *angles.ROWS,
        *loads.ROWS,
        *torque_source.ROWS,
        *drive.ROWS,
        *drive_load.ROWS,
        *drive_waves.ROWS,
    )
}


def of_balance(balance: Balance) -> tuple[Effect, ...]:
    """The catalogued effects of one balance, in order."""
    return tuple(row for row in CATALOGUE.values() if row.balance == balance)


def find(name: str, balance: Balance) -> Effect:
    """The effect of that name. Raises `ModelError` that names the closest match."""
    row = CATALOGUE.get((balance, name))
    if row is None:
        raise ModelError(f"{name!r} is no effect of the {balance} balance: {meant(name, _names(balance))}")
    return row


def _names(balance: Balance) -> list[str]:
    return [name for place, name in CATALOGUE if place == balance]


def shape_of(model: Model, effect: Effect) -> dict[str, float]:
    """Every shape parameter of one effect of a model: tied ones from their effect, fitted ones, else the start."""
    own = model.effect(effect.name)
    shape = {}
    for row in effect.shapes:
        if row.name in effect.tied:
            value = model.value(*effect.tied[row.name])
        else:
            value = own.value(row.name) if own is not None else math.nan
        shape[row.name] = value if math.isfinite(value) else row.start
    return shape


def measured(motion: Motion, need: str) -> bool:
    """Whether a channel or a field of `Motion` was measured: present and finite somewhere."""
    column = motion.extra.get(need)
    if column is None:
        column = getattr(motion, need, None)
    return column is not None and bool(np.isfinite(column).any())
