"""The few seconds of a recording on which the loop is first brought to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.balance.reversals import unknown_directions
from edge_daemon.identify.regression import RegressionProblem

STRETCH_S = 6.0
"""The loop is first brought to rest on so much: some hundred reversals."""
LEAD_S = 0.3
"""So much is left out at either end of it: the loop's transient and the filter's reach."""
STARTS = 12
"""So many beginnings of a stretch are compared, within its own length."""


def stretch_of(problem: RegressionProblem) -> RegressionProblem:
    """The few seconds of the first trial in which the torque is largest."""
    return sub_problem(problem, STRETCH_S, LEAD_S)


def sub_problem(problem: RegressionProblem, seconds: float, lead_s: float) -> RegressionProblem:
    """A bench of the `seconds` of the first trial in which the torque is largest, rows within `lead_s` of either end
    left out."""
    trial = problem.trials[0]
    rate, samples = trial.motion.rate_hz, len(trial.motion)
    reach = min(round(seconds * rate), samples)
    a = busiest(trial, reach, round(lead_s * rate))
    inside = (trial.rows >= a + lead_s * rate) & (trial.rows < a + reach - lead_s * rate)
    block = np.unique(trial.block[inside], return_inverse=True)[1].astype(np.intp)
    rows, unsure = trial.rows[inside] - a, trial.unsure[a : a + reach]
    part = replace(
        trial, motion=trial.motion.between(a, a + reach), rows=rows, block=block, target=trial.target[inside],
        input_rad_s=trial.input_rad_s[a : a + reach], unsure=unsure,
        unknown=unknown_directions(unsure, rows, trial.fir.value),
    )  # fmt: skip
    if part.unknown:
        part = replace(part, target=part.project(part.motion.torque_Nm))
    small = RegressionProblem([part])
    small.tied, small.motions = dict(problem.tied), (problem.motions[0].between(a, a + reach),)
    return small


def busiest(trial: PreparedMotion, reach: int, lead: int) -> int:
    """Sample at which the `reach` samples begin whose torque sums up to most (its size, not its square: no single shock
    decides), `lead` left out at either end: what is not linear shows there."""
    size = np.zeros(len(trial.motion) + 1)
    size[trial.rows + 1] = np.abs(trial.target)
    total = np.cumsum(size)
    starts = np.arange(0, len(trial.motion) - reach + 1, max(reach // STARTS, 1))
    return int(starts[np.argmax(total[starts + reach - lead] - total[starts + lead])])
