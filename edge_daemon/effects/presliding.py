"""How far the dry friction of a joint with one encoder has built up after a reversal.

The asperities of one contact carry all its dry friction: what it has more at creep or under load builds up over the
same angle as its Coulomb level does (Al-Bender, Lampaert & Swevers 2005, IEEE TAC 50(11)), and does not leap while that
slides.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from edge_daemon.effects.effect import Effect
from edge_daemon.records import Array

DRY = "coulomb_friction"
"""What leaps, and slides in step with nothing: its share of all dry friction leaps still."""


def builds_up(effects: Collection[Effect]) -> bool:
    """Whether friction among some effects is told by how far presliding among them has come."""
    return any(effect.slips for effect in effects) and any(effect.rubs for effect in effects)


def built_up(made: Iterable[tuple[Effect, Array, Array]]) -> Array | None:
    """(n,) how far dry friction has built up, -1 to 1, by the columns (n, k) and amplitudes (k,) of a joint's effects;
    None where none of it slides before it slips."""
    dry = [row for row in made if row[0].slips or row[0].name == DRY]
    force = sum(float(np.sum(amplitudes)) for _, _, amplitudes in dry)
    if force <= 0.0 or not any(effect.slips for effect, _, _ in dry):
        return None
    return np.asarray(np.sum([columns @ amplitudes for _, columns, amplitudes in dry], axis=0) / force)
