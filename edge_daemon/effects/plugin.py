"""Effects that other packages bring: Python entry points of the group `edge_daemon.effects`.

An entry point is named after its effect and loads an `Effect`. Only an installed package can add one: a model file
names an effect, it never brings code.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points

from edge_daemon.effects.effect import Effect
from edge_daemon.effects.model import ModelError

GROUP = "edge_daemon.effects"


@cache
def plugins() -> dict[str, EntryPoint]:
    """The entry points of installed packages by effect name; nothing is imported yet."""
    return {point.name: point for point in entry_points(group=GROUP)}


def load(name: str) -> Effect:
    """The effect behind an entry point. Raises `ModelError` when it is absent, fails to load, or is no `Effect`."""
    point = plugins().get(name)
    if point is None:
        raise ModelError(f"{name!r}: no installed package brings an effect of that name")
    try:
        effect = point.load()
    except Exception as error:
        raise ModelError(f"{name!r}: {point.value} fails to load: {error}") from error
    if not isinstance(effect, Effect):
        raise ModelError(f"{name!r}: {point.value} is {type(effect).__name__}: expected an Effect")
    return effect
