"""Noise that no floor foretold: what a model of a drive leaves where that follows nothing of the motion."""

from __future__ import annotations

import numpy as np

from edge_daemon.balance.torque_noise import DRIVEN, TWISTED, is_noise
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import Solution
from edge_daemon.motion.corrected import senses
from edge_daemon.motion.left_over import LeftOver
from edge_daemon.motion.order_spectrum import OrderSamples, strongest
from edge_daemon.records import Array

ABOVE_FLOOR = 1.25
"""At this error over the noise floor nothing more is heard than was foretold."""


def heard_noise(problem: RegressionProblem, solution: Solution, floor: float) -> float:
    """rms of what a solution leaves, where that is nothing but noise of a motor's torque or of a torque sensor, else 0:
    such noise may be of any colour, of which no quiet band knows."""
    drive = all(term.effect.balance == "drive" for term in solution.terms)
    measured = drive or senses(problem.trials[0].motion)
    if not measured or solution.rmse <= ABOVE_FLOOR * floor:
        return 0.0
    left, courses = problem.held_out_residual(solution), DRIVEN if drive else TWISTED
    rows = zip(problem.trials, np.split(left, problem.ends), strict=True)
    noise = all(is_noise(trial.motion, trial.rows, part, courses) for trial, part in rows)
    noise = noise and not _repeats(left, problem)
    return solution.rmse if noise else 0.0


def _repeats(left: Array, problem: RegressionProblem) -> bool:
    """Whether an order stands out: a ripple of many waves between two instants of like motion differs there as well."""
    nothing = LeftOver.of(left, np.zeros((len(left), 0)))
    return strongest(OrderSamples(problem.order_scale(("",)), nothing)) is not None
