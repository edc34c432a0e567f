"""From a line of a model to the effect it means: a catalogued one, a user's expression, or an installed package's."""

from __future__ import annotations

from collections.abc import Collection

from edge_daemon.effects import plugin
from edge_daemon.effects.catalogue import find
from edge_daemon.effects.effect import Balance, Effect
from edge_daemon.effects.expression import user_effect
from edge_daemon.effects.model import ModelEffect, ModelError


def resolve(row: ModelEffect, balance: Balance, columns: Collection[str] = ()) -> Effect:
    """The effect of one line; `columns` are the recording's, for expressions. Raises `ModelError`."""
    if row.expression is not None:
        return user_effect(row, balance, columns)
    if row.name in plugin.plugins():
        return plugin.load(row.name)
    return rippling(find(row.name, balance), row)


def rippling(effect: Effect, row: ModelEffect) -> Effect:
    """The effect over the waves that its line names, if any. Raises `ModelError`."""
    if not row.waves:
        return effect
    if effect.over is None:
        raise ModelError(f"{row.name}: orders: this effect repeats with no angle: expected none")
    return effect.over(row.waves)
