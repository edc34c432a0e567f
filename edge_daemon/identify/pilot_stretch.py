"""The few seconds of a recording on which the loop is first brought to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.balance.reversals import unknown_directions
from edge_daemon.balance.several import numbered_on, told_apart
from edge_daemon.identify.regression import RegressionProblem

STRETCH_S = 6.0
"""The loop is first brought to rest on so much: some hundred reversals."""
LEAD_S = 0.3
"""So much is left out at either end of it: the loop's transient and the filter's reach."""
STARTS = 12
"""So many beginnings of a stretch are compared, within its own length."""


def stretch_of(problem: RegressionProblem) -> RegressionProblem:
    """The few seconds of the first trial in which the torque is largest; or a part of them each of two trials that a
    channel tells apart, since either alone says nothing of what depends on that."""
    chosen = told_apart(problem.trials) or (0,)
    begun = [(i, *_part(problem.trials[i], STRETCH_S / len(chosen))) for i in chosen]
    rows = [row for row in begun if len(row[2].rows)] or begun
    small = RegressionProblem(numbered_on([part for *_, part in rows]))
    small.tied = dict(problem.tied)
    small.motions = tuple(problem.motions[i].between(a, a + len(part.motion)) for i, a, part in rows)
    return small


def _part(trial: PreparedMotion, seconds: float) -> tuple[int, PreparedMotion]:
    """Where the `seconds` of a trial begin in which the torque is largest, and these, rows near either end left out."""
    rate, samples = trial.motion.rate_hz, len(trial.motion)
    reach = min(round(seconds * rate), samples)
    a = busiest(trial, reach)
    inside = (trial.rows >= a + LEAD_S * rate) & (trial.rows < a + reach - LEAD_S * rate)
    block = np.unique(trial.block[inside], return_inverse=True)[1].astype(np.intp)
    rows, unsure = trial.rows[inside] - a, trial.unsure[a : a + reach]
    part = replace(
        trial, motion=trial.motion.between(a, a + reach), rows=rows, block=block, target=trial.target[inside],
        input_rad_s=trial.input_rad_s[a : a + reach], unsure=unsure,
        unknown=unknown_directions(unsure, rows, trial.fir.value),
    )  # fmt: skip
    return a, replace(part, target=part.project(part.motion.torque_Nm)) if part.unknown else part


def busiest(trial: PreparedMotion, reach: int) -> int:
    """Sample at which the `reach` samples begin whose torque sums up to most (its size, not its square: no single shock
    decides), but for their ends: what is not linear shows there."""
    lead = round(LEAD_S * trial.motion.rate_hz)
    size = np.zeros(len(trial.motion) + 1)
    size[trial.rows + 1] = np.abs(trial.target)
    total = np.cumsum(size)
    starts = np.arange(0, len(trial.motion) - reach + 1, max(reach // STARTS, 1))
    return int(starts[np.argmax(total[starts + reach - lead] - total[starts + lead])])
