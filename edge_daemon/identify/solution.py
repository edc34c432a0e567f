"""A structure of effects with their shapes, and what a fit of it found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.effects.effect import Effect
from edge_daemon.identify.block_least_squares import BlockSums
from edge_daemon.motion.corrected import SKEW
from edge_daemon.records import Array

STIFFNESS = ("linear_stiffness", "stiffness")
DAMPING = ("viscous_damping", "damping")
INERTIA = ("inertia", "inertia")
SPRING_AND_DAMPER = (STIFFNESS[0], DAMPING[0])
DELAY = (SKEW, "delay")
Shapes = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Term:
    """One effect of a structure, with its shapes."""

    effect: Effect
    shapes: Shapes


@dataclass(frozen=True, slots=True)
class Solution:
    """A fitted structure."""

    terms: tuple[Term, ...]
    amplitudes: Mapping[str, Array]
    """effect name -> (k,)"""
    held_out: Array
    """(b,) squared error of each block under a fit to the others, summed over its rows"""
    fitted: Array
    """(b,) squared error of each block under the fit to all"""
    count: Array
    """(b,) rows"""
    columns: Array
    """(m, p) of all terms, in order"""
    block_sums: BlockSums
    design: Array | None = None
    """(m, q) derivative of the modelled torque by every coordinate of `block_sums`, shapes included, where they
    were fitted together"""
    point: Array | None = None
    """(q,) where in the coordinates of `block_sums` the solution lies; None: at its amplitudes"""
    simulated: Array | None = None
    """(m,) modelled torque where the loop simulated it; None: columns times amplitudes"""

    @property
    def names(self) -> tuple[str, ...]:
        """The effects, in order."""
        return tuple(term.effect.name for term in self.terms)

    @property
    def vector(self) -> Array:
        """(p,) all amplitudes in the order of the columns."""
        return np.concatenate([self.amplitudes[name] for name in self.names]) if self.terms else np.empty(0)

    @property
    def modelled(self) -> Array:
        """(m,) torque of the model, filtered."""
        return self.columns @ self.vector if self.simulated is None else self.simulated

    @property
    def rmse(self) -> float:
        """Held-out rms of measured minus modelled."""
        return math.sqrt(float(self.held_out.sum() / self.count.sum()))

    def amplitude(self, effect: str, parameter: str, otherwise: float = math.nan) -> float:
        """One fitted amplitude."""
        for term in self.terms:
            if term.effect.name == effect:
                names = [row.name for row in term.effect.amplitudes]
                return float(self.amplitudes[effect][names.index(parameter)])
        return otherwise


def delayed(solution: Solution, stiffness: float) -> Solution:
    """The solution with the delay of a skew beside the stiffness that was found, instead of the one that its column
    held."""
    own = solution.amplitude(*STIFFNESS)
    if SKEW not in solution.names or not own > 0:
        return solution
    row = next(term.effect.amplitudes[0] for term in solution.terms if term.effect.name == SKEW)
    delay = np.clip(solution.amplitudes[SKEW] * stiffness / own, row.lower, row.upper)
    return replace(solution, amplitudes={**solution.amplitudes, SKEW: delay})
