"""Model against measurement on held-out blocks: how wrong, where, in which conditions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from edge_daemon.effects.model import Model
from edge_daemon.explain.axes import axes_of, where
from edge_daemon.explain.plausibility import examine
from edge_daemon.explain.results import Check, Comparison, Error, OrderSpectrum, ParameterLine, RegimeCheck, Series
from edge_daemon.identify.deviations import numbers
from edge_daemon.identify.fit import Fitted, fit
from edge_daemon.identify.problem import unit_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.torque_lag import lag_remarked
from edge_daemon.records import Array, Mask, Recorded

DRAWS = 400
"""The smallest probability that can be told is one over so many bootstrap draws."""
SEED = 20
ORDER_STEP = 0.05
REVERSAL_S = 0.05
"""A reversal reaches so far around a sign change of the twist rate (or speed)."""


def compare(recordings: Sequence[Recorded], model: Model) -> Comparison:
    """The model, refitted to the recordings' other blocks, against each block. Raises `BadInput` in one line."""
    warnings = examine(recordings, model)
    return comparison(fit(recordings, model), warnings)


def comparison(fitted: Fitted, warnings: Sequence[str] = ()) -> Comparison:
    """What a fitted model leaves unexplained."""
    problem, solution = fitted.problem, fitted.solution
    residual = problem.held_out_residual(solution)
    return Comparison(
        error=error_of(fitted),
        where=where(residual, problem, fitted.model.teeth),
        parameters=tuple(lines(fitted)),
        model=fitted.model,
        regimes=tuple(regimes(residual, problem)),
        tests=tuple(checks(residual, problem)),
        spectra=tuple(spectra(residual, problem)),
        series=_series(residual, problem),
        warnings=(*warnings, *problem.remarks, *lag_remarked(solution, problem)),
    )


def error_of(fitted: Fitted) -> Error:
    """Held-out error beside the noise floor."""
    unit = unit_of(fitted.model, fitted.problem.trials[0].motion.extra)
    rms = fitted.problem.rms
    return Error(fitted.solution.rmse / rms, fitted.floor / rms, fitted.solution.rmse, unit)


def lines(fitted: Fitted) -> Iterator[ParameterLine]:
    """One line per fitted number."""
    for term, row, value in numbers(fitted.solution):
        effect = fitted.model.effect(term.effect.name)
        if effect is not None:
            known = effect.parameters[row.name]
            advice = fitted.advice.get((effect.name, row.name), "")
            yield ParameterLine(effect.name, row.name, value, known.sd, known.unit, known.identified, advice)


def regimes(residual: Array, problem: RegressionProblem) -> Iterator[RegimeCheck]:
    """Error by thirds of each condition, by direction and near reversals."""
    axes = axes_of(problem)
    for axis in ("speed", "torque", "twist", "temperature"):
        if axis in axes:
            column = np.abs(axes[axis]) if axis != "temperature" else axes[axis]
            edges = np.quantile(column, [0, 1 / 3, 2 / 3, 1])
            for low, high in itertools.pairwise(edges):
                inside = (column >= low) & (column <= high)
                yield _regime(axis, f"{low:.4g} to {high:.4g}", inside, residual, problem)
    rate = axes.get("twist rate", axes.get("speed"))
    if rate is not None:
        yield _regime("direction", "positive", rate > 0, residual, problem)
        yield _regime("direction", "negative", rate < 0, residual, problem)
        yield _regime("reversal", f"within {1e3 * REVERSAL_S:.0f} ms", _near_reversal(rate, problem), residual, problem)


def _near_reversal(rate: Array, problem: RegressionProblem) -> Mask:
    trial = problem.trials[0]
    reach = max(1, round(REVERSAL_S * trial.motion.rate_hz / trial.step))
    flips = np.concatenate(([0.0], (np.diff(np.sign(rate)) != 0).astype(float)))
    near: Mask = np.convolve(flips, np.ones(2 * reach + 1), mode="same") > 0
    return near


def _regime(axis: str, text: str, inside: Mask, residual: Array, problem: RegressionProblem) -> RegimeCheck:
    if not inside.any():
        return RegimeCheck(axis, text, 0.0, math.nan, math.nan)
    rmse = math.sqrt(float(np.mean(residual[inside] ** 2)))
    rms = math.sqrt(float(np.mean(problem.target[inside] ** 2)))
    return RegimeCheck(axis, text, float(inside.mean()), rmse, rmse / rms if rms else math.nan)


def checks(residual: Array, problem: RegressionProblem) -> Iterator[Check]:
    """Whiteness beyond the filter's memory, and independence from the inputs, each against blocks with random signs."""
    axes = axes_of(problem)
    trial = problem.trials[0]
    lag = max(1, round(0.025 * trial.motion.rate_hz / trial.step))
    lagged = np.concatenate((np.zeros(lag), residual[:-lag]))
    yield _sign_test("whiteness at 25 ms", residual * lagged, problem)
    for axis in ("twist", "twist rate", "speed", "torque", "temperature"):
        if axis in axes:
            yield _sign_test(f"independence of {axis}", residual * (axes[axis] - axes[axis].mean()), problem)


def _sign_test(name: str, product: Array, problem: RegressionProblem) -> Check:
    """Sum of products per block; blocks get random signs (Wu 1986, wild bootstrap)."""
    starts = np.concatenate(([0], np.flatnonzero(np.diff(problem.block)) + 1))
    sums = np.add.reduceat(product, starts)
    size = math.sqrt(float(np.sum(sums**2))) or 1.0
    statistic = float(sums.sum()) / size
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], size=(DRAWS, len(sums)))
    drawn = np.abs(signs @ sums) / size
    return Check(name, statistic, float((1 + (drawn >= abs(statistic)).sum()) / (1 + DRAWS)))


def spectra(residual: Array, problem: RegressionProblem) -> Iterator[OrderSpectrum]:
    """Amplitude of the residual by frequency, and by order of either angle."""
    trial = problem.trials[0]
    count = len(trial.rows)
    time, first = trial.motion.time_s[trial.rows], residual[:count]
    yield _periodogram("frequency", time, first, trial.motion.rate_hz / trial.step)
    motion = problem.motions[0]
    for axis, angle, top in (("input order", motion.theta_in_rad, 12.0), ("output order", motion.theta_out_rad, 40.0)):
        turns = angle[trial.rows] / (2 * math.pi)
        orders = np.arange(ORDER_STEP if axis == "input order" else 0.5, top, ORDER_STEP * (1 if top < 20 else 5))
        wave = np.exp(-2j * math.pi * np.outer(orders, turns))
        yield OrderSpectrum(axis, orders, 2 * np.abs(wave @ first) / count)


def _periodogram(axis: str, time: Array, signal: Array, rate_hz: float) -> OrderSpectrum:
    grid = np.arange(time[0], time[-1], 1 / rate_hz)
    window = np.hanning(len(grid))
    amplitude = 2 * np.abs(np.fft.rfft(np.interp(grid, time, signal) * window)) / window.sum()
    return OrderSpectrum(axis, np.asarray(np.fft.rfftfreq(len(grid), 1 / rate_hz), dtype=float), amplitude)


def _series(residual: Array, problem: RegressionProblem) -> Series:
    def joined(name: str) -> Array:
        pairs = zip(problem.trials, problem.motions, strict=True)
        return np.concatenate([getattr(motion, name)[trial.rows] for trial, motion in pairs])

    return Series(
        time_s=joined("time_s"),
        torque=problem.target,
        modelled=problem.target - residual,
        residual=residual,
        twist_rad=joined("twist_rad"),
        twist_rate_rad_s=joined("twist_rate_rad_s"),
        speed_out_rad_s=joined("velocity_out_rad_s"),
        theta_in_rad=joined("theta_in_rad"),
        theta_out_rad=joined("theta_out_rad"),
        temperature_degC=joined("temperature_degC"),
    )
