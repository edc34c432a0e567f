"""Noise that no floor foretold: what a model of a drive leaves where that follows nothing of the motion."""

from __future__ import annotations

import numpy as np

from edge_daemon.balance.torque_noise import is_noise
from edge_daemon.identify.regression import RegressionProblem, Solution

ABOVE_FLOOR = 1.25
"""At this error over the noise floor nothing more is heard than was foretold."""


def heard_noise(problem: RegressionProblem, solution: Solution, floor: float) -> float:
    """rms of what a solution leaves, where with one encoder that is nothing but noise, else 0: a current's noise may be
    of any colour, of which no quiet band knows."""
    drive = all(term.effect.balance == "drive" for term in solution.terms)
    if not drive or solution.rmse <= ABOVE_FLOOR * floor:
        return 0.0
    edges = np.cumsum([len(trial.rows) for trial in problem.trials])[:-1]
    parts = np.split(solution.held_out_residual(problem), edges)
    noise = all(is_noise(t.motion, t.rows, part) for t, part in zip(problem.trials, parts, strict=True))
    return solution.rmse if noise else 0.0
