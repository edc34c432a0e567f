"""How far the dry friction of a joint with one encoder has built up after a reversal.

The asperities of one contact carry all its dry friction: what it has more at creep or under load builds up over the
same angle as its Coulomb level does (Al-Bender, Lampaert & Swevers 2005, IEEE TAC 50(11)), and does not leap while that
slides. Slipping elements keep their angle, so that they are as much stiffer under load; bristles keep their stiffness,
and take as much longer to the level that load and creep give them (Canudas de Wit et al. 1995, IEEE TAC 40(3)).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from edge_daemon.effects.algebra import bristle_state
from edge_daemon.effects.effect import Effect, EffectState
from edge_daemon.effects.friction import stribeck_bump
from edge_daemon.records import Array, Motion

DRY = "coulomb_friction"
"""What leaps, and slides in step with nothing: its share of all dry friction leaps still."""
LEAST_LEVEL = 0.1
"""Of bristles, over their Coulomb level: below it noise of a friction that falls would turn their direction (guess)."""


KnownEffect = tuple[Effect, Mapping[str, float], Array]
"""An effect of a model, its shapes, and what its amplitudes (k,) are known to be."""


class Bent(NamedTuple):
    """What bristles do, (n,) each."""

    share: Array
    """how far they are bent, -1 to 1"""
    level: Array
    """what they carry alone, over their Coulomb level"""
    state: EffectState


def bristles(motion: Motion, shape: Mapping[str, float], state: EffectState) -> Bent:
    """w dz = dtheta_out - |dtheta_out| z / g, where g is their own level and that of what rubs beside them."""
    level = _level(motion, shape)
    whole = level if motion.rubs_beside is None else np.maximum(level + motion.rubs_beside, LEAST_LEVEL)
    z, state = bristle_state(motion.theta_out_rad, np.full(len(motion), shape["width"]), whole, state)
    return Bent(z / whole, level, state)


def _level(motion: Motion, shape: Mapping[str, float]) -> Array:
    if "static_ratio" not in shape:
        return np.ones(len(motion))
    return 1 + (shape["static_ratio"] - 1) * stribeck_bump(motion.velocity_out_rad_s, shape)


def builds_up(effects: Collection[Effect]) -> bool:
    """Whether friction among some effects is told by how far presliding among them has come."""
    slides = any(effect.slips or effect.is_bristles for effect in effects)
    return slides and any(effect.rubs for effect in effects)


def with_friction_built_up(motion: Motion, told: Sequence[KnownEffect]) -> Motion:
    """The motion with how far dry friction has built up, by a joint's effects, whose loads it holds."""
    if not builds_up([effect for effect, _, _ in told]):
        return replace(motion, rubs_beside=None, built_up=None)
    motion = with_level_of_bristles(motion, told)
    columns = [effect.columns(motion, shape, None)[0] if _is_dry(effect) else None for effect, shape, _ in told]
    return replace(motion, built_up=built_up(motion, told, columns))


def with_level_of_bristles(motion: Motion, told: Sequence[KnownEffect]) -> Motion:
    """The motion with the level of all that rubs beside bristles, over their Coulomb level."""
    force = next((float(amplitudes[0]) for effect, _, amplitudes in told if effect.is_bristles), 0.0)
    rows = [row for row in told if row[0].rubs]
    if force <= 0.0 or not rows:
        return replace(motion, rubs_beside=None)
    full, none = (replace(motion, built_up=np.full(len(motion), share)) for share in (1.0, 0.0))
    parts = [(effect.columns(full, shape, None)[0] - effect.columns(none, shape, None)[0]) @ amplitudes
             for effect, shape, amplitudes in rows]  # fmt: skip
    return replace(motion, rubs_beside=np.sum(parts, axis=0) / force)


def built_up(motion: Motion, told: Sequence[KnownEffect], columns: Sequence[Array | None]) -> Array | None:
    """(n,) how far dry friction has built up, -1 to 1, by the columns (n, k) of a joint's effects; None where none of
    it slides before it slips."""
    dry, force = np.zeros(len(motion)), 0.0
    for (effect, shape, amplitudes), made in zip(told, columns, strict=True):
        if made is not None and effect.is_bristles:
            return np.asarray(made[:, 0] / _level(motion, shape))
        if made is not None and _is_dry(effect):
            dry, force = dry + made @ amplitudes, force + float(np.sum(amplitudes))
    return dry / force if force > 0.0 else None


def _is_dry(effect: Effect) -> bool:
    return bool(effect.slips) or effect.is_bristles or effect.name == DRY
