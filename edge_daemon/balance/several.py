"""What several recordings of one joint, made ready, say of each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion, from_zero
from edge_daemon.motion.corrected import senses
from edge_daemon.motion.residual_statistics import LOOKS, independent, lags_at
from edge_daemon.records import Array, Motion

OWN_SHARE = 0.5
"""Share of a channel's range over all recordings that one, or all others, must hold to tell what depends on it (guess).
"""
LEFT_BY_ZEROS = 0.5
"""Each recording has a zero of its own where these leave less than this share of the squared error (guess)."""
ZERO_ROUNDS = 4
"""So often zeros are looked for again with the twist from those found, since a spring that bends moves them."""
BESIDE_ZEROS = ((False, 1, False), (False, 1, True), (False, 3, True), (True, 5, True))
"""What zeros are looked for beside, the plainest first: whether each recording has a spring of its own, the highest
power of the twist, and whether a weight hangs on an output without a torque sensor."""
PLAIN = 1.05
"""Zeros are read beside the plainest of these that leaves at most so many times the least squared error: what a finer
one takes then moves no zero by a quarter of what is left (guess)."""


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


def with_their_zeros(trials: Sequence[PreparedMotion], beside: Sequence[Array]) -> Sequence[PreparedMotion]:
    """Recordings whose twists each count from a zero of their own, where that takes most of the error that a spring of
    any curve, a weight, frictions of each recording and what else is `beside` them, (m, k) each, leave."""
    one, moved = _beside_zeros(trials, beside, BESIDE_ZEROS[-1], apart=False).left, trials
    for _ in range(ZERO_ROUNDS):
        found = [_beside_zeros(moved, beside, structure) for structure in BESIDE_ZEROS]
        least = min(row.left for row in found)
        zeros = next(row for row in found if row.left <= PLAIN * least)
        if not least < LEFT_BY_ZEROS * one or not np.isfinite(zeros.zeros_rad).all():
            return trials
        moved = [from_zero(trial, trial.zero_rad + zero) for trial, zero in zip(moved, zeros.zeros_rad, strict=True)]
    unsure = "" if senses(moved[0].motion) else " (or their steady loads over the stiffness)"
    zeros_rad = np.array([trial.zero_rad for trial in moved])
    sd_rad = math.hypot(*zeros.sd_rad[[zeros_rad.argmin(), zeros_rad.argmax()]])
    apart = f"{np.ptp(zeros_rad):.2g} +- {sd_rad:.1g} rad"
    told = f"the zeros of the encoders{unsure} differ by {apart} between the recordings: taken out"
    return [replace(moved[0], remarks=(*moved[0].remarks, told)), *moved[1:]]


class _Zeros(NamedTuple):
    """Zeros of recordings."""

    left: float
    """squared error beside them"""
    zeros_rad: Array
    """(r,)"""
    sd_rad: Array


def _beside_zeros(
    trials: Sequence[PreparedMotion], beside: Sequence[Array], structure: tuple[bool, int, bool], apart: bool = True
) -> _Zeros:
    """One zero of all or one of each recording, in a structure of `BESIDE_ZEROS`."""
    own_spring, powers, weight = structure
    rows = []
    for i, (trial, more) in enumerate(zip(trials, beside, strict=True)):
        own, shared = _of_recording(trial.motion), _of_all(trial.motion, powers, weight)
        placed = np.zeros((len(trial.rows), len(trials), own.shape[1]))
        placed[:, i] = trial.project(own)
        zero = np.zeros((len(placed), len(trials) if apart else 1))
        zero[:, i if apart else 0] = 1.0
        stiff = np.zeros((len(placed), len(trials) if own_spring else 1))
        stiff[:, i if own_spring else 0] = trial.project(trial.motion.twist_rad[:, None])[:, 0]
        rows.append(np.hstack((zero, stiff, placed.reshape(len(placed), -1), trial.project(shared), more)))
    x, y = np.vstack(rows), np.concatenate([trial.target for trial in trials])
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-300
    found = np.linalg.lstsq(x / size, y, rcond=1e-9)[0] / size
    steady, stiffness = np.split(found, [zero.shape[1], zero.shape[1] + stiff.shape[1]])[:2]
    left, inverse = y - x @ found, np.linalg.pinv((x / size).T @ (x / size), rcond=1e-12, hermitian=True)
    lags = lags_at(trials[0].motion.rate_hz / trials[0].step)
    power = float(np.mean(left**2))
    whole = power * len(y) / independent(left, np.concatenate([trial.block for trial in trials]), lags)
    sd = np.hypot(np.sqrt(np.maximum(np.diagonal(inverse), 0.0) * whole) / size, math.sqrt(power / LOOKS))
    firm = np.where(stiffness > 0, stiffness, np.nan)
    return _Zeros(float(left @ left), -steady / firm, sd[: len(steady)] / firm)


def _of_recording(motion: Motion) -> Array:
    """(n, 4) what a recording has of its own: another temperature gives other frictions."""
    rate, speed = motion.twist_rate_rad_s, motion.velocity_out_rad_s
    return np.stack((rate, np.sign(rate), speed, np.sign(speed)), axis=1)


def _of_all(motion: Motion, powers: int, weight: bool) -> Array:
    """(n, k) of a spring that bends and of a weight."""
    size = float(np.std(motion.twist_rad)) + 1e-300
    columns = [(motion.twist_rad / size) ** power for power in range(2, powers + 1)]
    if weight and not senses(motion):
        columns += [np.sin(motion.theta_out_rad), np.cos(motion.theta_out_rad)]
    return np.stack(columns, axis=1) if columns else np.empty((len(motion), 0))
