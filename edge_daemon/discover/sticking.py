"""Dry friction of the twist, whatever it is multiplied by: the twist is simulated with plain friction, and what that
leaves is searched on the rate that was simulated. A measured rate does not carry where friction sticks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge_daemon.discover.factors import Factor, Product, direction
from edge_daemon.discover.leftover import Leftover
from edge_daemon.effects.friction import SMOOTHING
from edge_daemon.effects.model import ModelEffect
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.problem import terms_of
from edge_daemon.identify.solution import Solution
from edge_daemon.identify.structure import Structure
from edge_daemon.records import Array

FRICTION, RATE = "coulomb_friction", "twist_rate_rad_s"
LEAST_SHARE = 0.1
"""Share of the leftover's square that plain friction takes, on the rate as measured, for it to be simulated (guess:
it was 0.45 and more in the laws that this was tried on)."""
LEAST_GAIN = 0.8
"""Error with plain friction over that without, above which none is there to be modulated (guess)."""
FULL = 0.999999
"""Direction that counts as full."""


class Sticking(Leftover):
    """What a model leaves, on the twist rate that a simulation with plain friction says."""

    simulated = True

    def __init__(self, measured: Leftover, rates: Sequence[Array], width: float) -> None:
        super().__init__(measured.problem, measured.base, measured.model)
        self.axes = tuple({**own, RATE: rate} for own, rate in zip(self.axes, rates, strict=True))
        self.product = Product((Factor(direction(width), RATE),))


def sticking(leftover: Leftover) -> Sticking | None:
    """None where no plain friction of the twist shows, or it never turns round in the simulation."""
    if leftover.model.balance != "torsion" or FRICTION not in leftover.catalogued or RATE not in leftover.names:
        return None
    basis = leftover.catalogued[FRICTION]
    if float(np.sum((basis.T @ leftover.left) ** 2)) < LEAST_SHARE * leftover.square:
        return None
    problem, state = leftover.problem, leftover.problem.state
    larger = leftover.model.with_effect(ModelEffect("friction", {}, f"a*tanh({RATE}/{SMOOTHING.start:g})"))
    try:
        found = fit_terms(problem, terms_of(larger, problem))
        if found.rmse >= LEAST_GAIN * leftover.base.rmse:
            return None
        rates = _rates(leftover, found, SMOOTHING.start)
        turns = (np.ptp(rate[trial.rows]) > 0.0 for rate, trial in zip(rates, problem.trials, strict=True))
        return Sticking(leftover, rates, SMOOTHING.start) if all(turns) else None
    finally:
        problem.restore(state)


def _rates(leftover: Leftover, solution: Solution, width: float) -> Sequence[Array]:
    """(n,) of each trial: the rate whose direction is the mean of that of the steps about each sample."""
    structure, out = Structure(leftover.problem, solution), []
    for i, trial in enumerate(leftover.problem.trials):
        fine = structure.simulated(i, solution.terms, solution.amplitudes).rate_rad_s
        times = len(fine) // len(trial.motion)
        odd = times + 1 - times % 2
        about = np.convolve(np.tanh(fine / width), np.full(odd, 1 / odd), "same")
        out.append(width * np.arctanh(np.clip(about[::times], -FULL, FULL)))
    return out
