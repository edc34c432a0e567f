"""Commands that leave the torsional resonance at rest: zero-vibration shapers.

ZV: two impulses half a damped period apart (Smith 1957; Singer & Seering 1990, J. Dyn. Sys. Meas. Control 112(1)); ZVD:
three, which also forgive an error of the frequency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.effects.model import Model, ModelError
from edge_daemon.records import Array


@dataclass(frozen=True, slots=True)
class Resonance:
    """Of the output on its gear, with the motor held by its drive."""

    frequency_hz: float
    damping: float


def resonance(model: Model) -> Resonance:
    """Raises `ModelError` where stiffness or inertia are not known."""
    stiffness, inertia = model.value("linear_stiffness", "stiffness"), model.output_inertia_kg_m2
    if not stiffness > 0.0 or not inertia > 0.0:
        raise ModelError("joint: a shaper needs output_inertia_kg_m2 and a fitted linear_stiffness")
    damping = max(model.value("viscous_damping", "damping", 0.0), 0.0)
    ratio = min(0.5 * damping / math.sqrt(stiffness * inertia), 0.95)
    return Resonance(math.sqrt(stiffness / inertia) / (2.0 * math.pi), ratio)


def impulses(found: Resonance, kind: str = "ZVD") -> tuple[Array, Array]:
    """Times [s] and shares (sum 1) of the shaper's impulses."""
    damped = math.sqrt(1.0 - found.damping**2)
    half_s = 0.5 / (found.frequency_hz * damped)
    k = math.exp(-math.pi * found.damping / damped)
    shares = np.array([1.0, k] if kind == "ZV" else [1.0, 2.0 * k, k * k])
    return half_s * np.arange(float(len(shares))), np.asarray(shares / shares.sum())


def shaped(target: Array, rate_hz: float, found: Resonance, kind: str = "ZVD") -> Array:
    """A command (n,) passed through the shaper; before its first sample it stood still."""
    times, shares = impulses(found, kind)
    instants = np.arange(len(target)) / rate_hz
    delayed = [np.interp(instants - delay, instants, target) for delay in times]
    return np.asarray(sum(share * row for share, row in zip(shares, delayed, strict=True)))
