"""What several recordings of one joint, made ready, say of each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.records import Array

OWN_SHARE = 0.5
"""Share of a channel's range over all recordings that one, or all others, must hold to tell what depends on it (guess).
"""


def numbered_on(trials: Sequence[PreparedMotion]) -> list[PreparedMotion]:
    """The recordings, the blocks of each numbered on from those before."""
    out, first = [], 0
    for trial in trials:
        if len(trial.block):
            trial = replace(trial, block=trial.block - trial.block[0] + first)
            first = int(trial.block[-1]) + 1
        out.append(trial)
    return out


def told_apart(trials: Sequence[PreparedMotion]) -> tuple[int, ...]:
    """Two recordings that a channel, as the temperature of a day and a night, tells apart by more than it changes in
    any: neither alone says what depends on that. Empty where there are none."""
    for low, high in _ranges([trial.motion.extra for trial in trials]):
        if np.max(high - low) < OWN_SHARE * (high.max() - low.min()):
            return int(low.argmin()), int(high.argmax())
    return ()


def foretold(trials: Sequence[PreparedMotion]) -> bool:
    """Whether all of some recordings but one reach about as far, in every channel and in the motion itself, as that
    does, whichever it is: else a law of it would have to be foretold from where it was hardly seen."""
    moved = [trial.motion for trial in trials]
    angles = [{"angle": motion.theta_out_rad, "speed": motion.velocity_out_rad_s} for motion in moved]
    for low, high in _ranges([{**motion.extra, **own} for motion, own in zip(moved, angles, strict=True)]):
        rest = [np.delete(high, i).max() - np.delete(low, i).min() for i in range(len(trials))]
        if min(rest) < OWN_SHARE * (high.max() - low.min()):
            return False
    return True


def _ranges(rows: Sequence[Mapping[str, Array]]) -> Iterator[tuple[Array, Array]]:
    """(r,) least and largest in each recording of each channel that all have."""
    for name in rows[0]:
        if all(name in row and np.isfinite(row[name]).any() for row in rows):
            yield np.array([np.nanmin(row[name]) for row in rows]), np.array([np.nanmax(row[name]) for row in rows])
