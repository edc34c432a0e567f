"""Single-turn angles made multi-turn, where they leave no doubt."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.records import Array

TURN_RAD = 2 * math.pi
SLACK_RAD = 1e-3
"""A single-turn angle may stray so far outside its turn by rounding."""
LARGEST_STEP_RAD = 2.0
"""A larger step between samples is a jump: two thirds of what would make the direction of a jump doubtful."""


def joined(angle_rad: Array) -> tuple[Array, int]:
    """(n,) the angle with its jumps of one turn taken out, and their number; as it was where it is multi-turn.

    NaN stays. Only an angle that keeps within one turn, and whose steps are either small or almost a whole turn, is
    taken for a single-turn one.
    """
    known = np.flatnonzero(np.isfinite(angle_rad))
    if len(known) < 2:
        return angle_rad, 0
    seen = angle_rad[known]
    low, high = float(seen.min()), float(seen.max())
    within = (low > -SLACK_RAD and high < TURN_RAD + SLACK_RAD) or (
        low > -math.pi - SLACK_RAD and high < math.pi + SLACK_RAD
    )
    steps = np.diff(seen)
    jumps = np.abs(steps) > math.pi
    if not within or not jumps.any() or np.abs(np.abs(steps) - TURN_RAD * jumps).max() > LARGEST_STEP_RAD:
        return angle_rad, 0
    out = angle_rad.copy()
    out[known[1:]] -= TURN_RAD * np.cumsum(np.sign(steps) * jumps)
    return out, int(np.count_nonzero(jumps))
