"""What a simulated recording is, whichever balance it serves: its columns and its truth, its warm-up, its encoders."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.rig.motion import Array

WARM_UP_K = 15.0
WARM_UP_S = 12.0
"""a small gear under load; quicker than life so that half a minute shows it (chosen)"""
ENCODER_NOISE_STEPS = 0.25
"""sd of an encoder's noise before rounding, in its steps (guess; also keeps rounding errors independent)"""
RATIO = 100.0

Temperature = float | tuple[float, float]


class UnknownEffect(BadInput):
    """A name that the simulated drive does not have."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        names = [*known]
        close = difflib.get_close_matches(name, names, n=1)
        hint = f"did you mean {close[0]!r}? It" if close else "the simulated drive"
        super().__init__(f"effect {name!r}: {hint} has: {', '.join(names)}")


@dataclass(frozen=True, slots=True)
class Simulated:
    """A recording and what is true about it."""

    time_s: Array
    columns: dict[str, Array]
    truth: dict[str, object]
    """`effects`, `parameters` (base and effects, `effect.name` -> SI value), `seed` and how it was recorded"""


def temperature_at(time_s: Array, span: tuple[float, float]) -> Array:
    """(n,) [degC] of a warm-up from the first to (nearly) the second."""
    start, end = span
    return np.asarray(start + (end - start) * -np.expm1(-np.maximum(time_s, 0.0) / WARM_UP_S))


def quantised(angle_rad: Array, bits: int, rng: np.random.Generator) -> Array:
    """(n,) what an encoder of `bits` per turn says, noise before rounding; unchanged for 0 bits."""
    if bits == 0:
        return angle_rad
    step = 2 * math.pi / 2**bits
    noise = rng.normal(0.0, ENCODER_NOISE_STEPS, len(angle_rad))
    return np.asarray(np.rint(angle_rad / step + noise) * step)
