"""Laws of one twist, in numbers that a compiled loop can carry: what the rows of the catalogue are simulated by.

An effect that a simulation of the gear should carry lists its torque as a sum of elements, each a kind, a size that is
linear in the amplitudes, and up to three further numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

SIGN, BUMP, LOADED, CLIP, SPRING, STOP, BOUC_WEN, BRISTLE, RUB = range(9)
"""The first three follow the sign of the twist rate."""
CURVES, PATHS = frozenset({CLIP, SPRING}), frozenset({STOP, BOUC_WEN, BRISTLE})
"""Kinds of the twist alone, and of the path that it took."""


class Element(NamedTuple):
    """One summand of a torque [N m] over twist x, twist rate v and what it remembers, z."""

    kind: int
    """SIGN: size tanh(v / a). BUMP: size exp(-(v / b)^2) tanh(v / a). LOADED: size load tanh(v / a),
    the load the size of the transmitted torque where b is 0, else factor b of those that the effect multiplies by.
    CLIP: size clip(x, -a, a). SPRING: size x + a x^2 + b x^3. STOP: size z, a dz = dx while |z| < 1 + b x,
    which stays above 0 (`LEAST_LIMIT`).
    BOUC_WEN: size z, a dz = dx - (b |dx| sgn z + (1 - b) dx) |z|^c.
    BRISTLE: size z, a dz = dx - |dx| z / g, g = 1 + (b - 1) exp(-(v / c)^2). RUB: size a dz/dt, z as of BRISTLE"""
    size: float
    a: float = 1.0
    b: float = 0.0
    c: float = 1.0


LEAST_LIMIT = 0.05
"""However far a search lets the limit taper, a stop holds this share of what it holds without."""

InLoop = Callable[[Mapping[str, float], Sequence[float]], tuple[Element, ...]]
"""(shape, amplitudes) -> the elements; their sum is columns @ amplitudes"""

GAIN, OF_RATE, END_RATE, END_MEAN = range(4)
"""The places in what a step is made of: with its mean twist rate m, and the twist x and twist rate v at its start,
gain m + torque of the laws = push - stiffness x + of_rate v, and the rate at its end is end_rate v + end_mean m."""
