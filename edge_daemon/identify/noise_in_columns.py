"""What sensor noise adds to the normal equations: an amplitude of a noisy column would be too small without it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.balance.torsion_floor import noise_products
from edge_daemon.effects.algebra import inertia_of, own_power
from edge_daemon.effects.effect import Effect
from edge_daemon.effects.torque_source import MOTOR_SIDE
from edge_daemon.identify.block_least_squares import MOST_NOISE, BlockSums, taken_out
from edge_daemon.identify.solution import DAMPING, INERTIA, STIFFNESS, Shapes, Term
from edge_daemon.records import Array

ROUNDED = 1e-9
"""An eigenvalue of columns of unit size is no less than nought but for rounding below this."""
ROTOR = next(i for i, row in enumerate(MOTOR_SIDE.amplitudes) if row.name == "inertia")
"""Place of the rotor's inertia among what the motor side takes."""

TURNING_INERTIA = "varying_inertia"
"""The effect that feels the acceleration, by the place of the output."""


@dataclass(frozen=True, slots=True)
class NoiseInColumns:
    """Of the columns of some trials; none of no trial."""

    trials: tuple[PreparedMotion, ...] = ()
    encoders: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """mean products of what the encoders' noise makes of twist, twist rate and acceleration"""
    products: dict[str, tuple[float, float]] = field(default_factory=dict)
    """effect -> mean square of the noise in its column, and its mean product with that in the torque"""
    turning: dict[str, Array] = field(default_factory=dict)
    """what was computed of an inertia that turns"""

    def within(self, sums: BlockSums, effects: Sequence[Effect]) -> BlockSums:
        """Normal equations of these effects' columns, with what of them is noise."""
        power = sums.matrix.sum(axis=0) / sums.count.sum()
        matrix, vector = np.zeros_like(power), np.zeros(len(power))
        starts = _starts(effects)
        for name in starts.keys() & self.products.keys():
            i, (own, cross) = starts[name], self.products[name]
            matrix[i, i] = taken_out(own, own_power(power, i) if name == INERTIA[0] else float(power[i, i]))
            vector[i] = cross * matrix[i, i] / own if own else 0.0
        sums = replace(sums, noise_matrix=matrix, noise_vector=vector)
        return self._with_rotor(self._with_turning(sums, effects, starts), starts)

    def _with_turning(self, sums: BlockSums, effects: Sequence[Effect], start: Mapping[str, int]) -> BlockSums:
        """With what the acceleration's noise makes of an inertia that turns beside one that does not: taken out of that
        alone, it would seem to be larger, and what turns smaller by as much."""
        turns = next((effect for effect in effects if effect.name == TURNING_INERTIA), None)
        if turns is None or not {INERTIA[0]} <= start.keys() & self.products.keys():
            return sums
        if turns.name not in self.turning:
            products = [_turning_products(turns, trial) for trial in self.trials]
            rows = [len(trial.target) for trial in self.trials]
            self.turning[turns.name] = np.average(products, axis=0, weights=rows)
        at = [start[INERTIA[0]], *range(start[turns.name], start[turns.name] + len(turns.amplitudes))]
        noise = sums.noise_matrix.copy()
        noise[np.ix_(at, at)] = self.products[INERTIA[0]][0] * self.turning[turns.name]
        return _if_more(sums, noise)

    def _with_rotor(self, sums: BlockSums, start: Mapping[str, int]) -> BlockSums:
        """With what the motor's encoder makes of the rotor's acceleration as noise: a rotor that is heard as noise
        alone seems to have no inertia, and the spring takes the place of it."""
        if MOTOR_SIDE.name not in start:
            return sums
        noise, rotor, spring = sums.noise_matrix.copy(), start[MOTOR_SIDE.name] + ROTOR, start.get(STIFFNESS[0])
        noise[rotor, rotor] = self.encoders[2, 2]
        if spring is not None:
            noise[spring, rotor] = noise[rotor, spring] = self.encoders[0, 2]
        return _if_more(sums, noise)

    def hushed(self, terms: Sequence[Term], shapes: Callable[[Effect, Shapes], Shapes]) -> Array | None:
        """(p, p) what an effect that filters the acceleration, at all its `shapes`, takes out of the noise of the
        inertia; None without."""
        start = _starts([term.effect for term in terms])
        own = next((term for term in terms if term.effect.filters), None)
        if own is None or own.effect.filters is None or not {INERTIA[0]} <= start.keys() & self.products.keys():
            return None
        values, cross, alone = shapes(own.effect, own.shapes), 0.0, 0.0
        rows = sum(len(trial.target) for trial in self.trials)
        for trial in self.trials:
            gain = own.effect.filters(trial.heard_hz, values)
            power = len(trial.target) / rows * trial.acceleration_noise * trial.heard
            cross, alone = cross + float(power @ gain.real), alone + float(power @ np.abs(gain) ** 2)
        i, j = start[INERTIA[0]], start[own.effect.name]
        width = sum(len(term.effect.amplitudes) for term in terms)
        hushed = np.zeros((width, width))
        hushed[i, j] = hushed[j, i] = -cross
        hushed[j, j] = -alone
        return hushed


def _turning_products(turns: Effect, trial: PreparedMotion) -> Array:
    """(k, k) mean products of what an inertia and one that turns make of one unit of acceleration."""
    ones, nought = np.ones(len(trial.motion)), np.zeros(len(trial.motion))
    still = replace(trial.motion, acceleration_out_rad_s2=ones, velocity_out_rad_s=nought)
    columns = np.column_stack((ones, turns.columns(still, turns.start, None)[0]))[trial.rows]
    return columns.T @ columns / len(columns)


def _if_more(sums: BlockSums, noise: Array) -> BlockSums:
    """With a noise of its columns (p, p), unless some mixture of them is hardly more than that."""
    every = sums.matrix.sum(axis=0)
    if not np.isfinite(every).all():
        return sums
    scale = np.sqrt(np.diagonal(every))
    scale[scale == 0.0] = 1.0  # a column of nothing
    whole, heard = every / np.outer(scale, scale), noise * sums.count.sum() / np.outer(scale, scale)
    least = np.linalg.eigvalsh(whole - heard / MOST_NOISE)[0]
    return replace(sums, noise_matrix=noise) if least > -ROUNDED else sums


def noise_in_columns(trials: Sequence[PreparedMotion]) -> NoiseInColumns:
    """Of the columns of some trials, each counting by its rows."""
    rows = sum(len(trial.target) for trial in trials)
    shares = [len(trial.target) / rows for trial in trials]
    encoders = np.average([noise_products(trial) for trial in trials], axis=0, weights=shares)
    cross = bent = 0.0
    for share, trial in zip(shares, trials, strict=True):
        cross += share * trial.moments[1] * trial.sensors.theta_out_rad**2 * inertia_of(trial.motion)
        bent += share * trial.acceleration_noise
    twist, rate = float(encoders[0, 0]), float(encoders[1, 1])
    of_drive, of_twist = {INERTIA[0]: (bent, 0.0)}, {STIFFNESS[0]: (twist, cross), DAMPING[0]: (rate, 0.0)}
    return NoiseInColumns(tuple(trials), encoders, of_drive if bent else of_twist)


def _starts(effects: Sequence[Effect]) -> dict[str, int]:
    """Of each effect its first column."""
    ends = np.cumsum([0, *(len(effect.amplitudes) for effect in effects)]).tolist()
    return dict(zip([effect.name for effect in effects], ends, strict=False))
