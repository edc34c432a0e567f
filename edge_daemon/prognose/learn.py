"""What histories of failed gears teach: the prior of the forecast, and the constants of the damage law.

The prior is learned by Monte-Carlo expectation maximisation over gears (empirical Bayes): each failed gear's posterior
is drawn with the prior so far and its known end; the pooled mean and spread are the next prior.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.special import log_ndtr

from edge_daemon.errors import BadInput
from edge_daemon.prognose.damage import CYCLES_PER_TURN, MOST_LOSS
from edge_daemon.prognose.evidence import evidence_of
from edge_daemon.prognose.forecast import BROAD, NORMAL_PRIOR, Prior, posterior_of_failed
from edge_daemon.prognose.gears import Gear
from edge_daemon.prognose.ledger import rows_of
from edge_daemon.records import Array

ROUNDS = 20
PARTICLES = 300
LEAST_SD = 0.05
"""no belief is held more firmly than this, however alike the few gears were"""
DOUBT_LEARNED = 0.03
"""chance that a new gear is unlike all that were learned from: a guess"""
FEWEST = 5
"""failed gears that teach more than they mislead"""


class LearnError(BadInput):
    """One line: what is missing or wrong with the histories."""


@dataclass(frozen=True, slots=True)
class FailedGear:
    """A history, hourly, to its end: failure, or for the damage law also the end of observation."""

    time_h: Array
    columns: Mapping[str, Array]
    failed: bool = True
    """by fatigue of the flexspline, where the damage law is learned"""


def learn_prior(gear: Gear, lives: Sequence[FailedGear], rounds: int = ROUNDS) -> Prior:
    """The forecast's prior from gears of one kind that have failed. Raises `LearnError` for fewer than five."""
    failed = [life for life in lives if life.failed]
    if len(failed) < FEWEST:
        raise LearnError(f"{len(failed)} failed gears: expected at least {FEWEST} to learn from")
    evidence = [evidence_of(rows_of(gear, life.time_h, _hours(life.time_h), life.columns)) for life in failed]
    prior = BROAD
    for turn in range(rounds):
        draws = [
            posterior_of_failed(gear, one, prior, seed=1000 * turn + i, particles=PARTICLES)
            for i, one in enumerate(evidence)
        ]
        pooled = np.concatenate(draws)
        cover = np.cov(pooled.T) + LEAST_SD**2 * np.eye(pooled.shape[1])
        prior = Prior(pooled.mean(axis=0)[None], cover[None], np.ones(1), DOUBT_LEARNED)
    return prior


def prior_to_bytes(prior: Prior) -> bytes:
    """A learned prior as JSON, to keep beside the configuration."""
    return msgspec.json.encode(
        {
            "parameters": list(NORMAL_PRIOR),
            "mean": prior.mean.tolist(),
            "cover": prior.cover.tolist(),
            "weight": prior.weight.tolist(),
            "doubt": prior.doubt,
        }
    )


class _PriorFile(msgspec.Struct, forbid_unknown_fields=True):
    parameters: list[str]
    mean: list[list[float]]
    cover: list[list[list[float]]]
    weight: list[float]
    doubt: float


def prior_from_bytes(blob: bytes) -> Prior:
    """The prior of `prior_to_bytes`. Raises `LearnError` if it is broken or has other parameters."""
    try:
        saved = msgspec.json.decode(blob, type=_PriorFile)
        prior = Prior(np.array(saved.mean), np.array(saved.cover), np.array(saved.weight), saved.doubt)
        np.linalg.cholesky(prior.cover)
    except (msgspec.MsgspecError, ValueError, np.linalg.LinAlgError) as error:
        raise LearnError(f"learned prior: {error}") from error
    kinds, size = len(prior.weight), len(NORMAL_PRIOR)
    shapes = prior.mean.shape == (kinds, size) and prior.cover.shape == (kinds, size, size)
    if saved.parameters != list(NORMAL_PRIOR) or not shapes:
        raise LearnError(f"learned prior: expected the parameters {', '.join(NORMAL_PRIOR)}")
    if not (0.0 <= prior.doubt < 1.0 and np.all(prior.weight > 0.0) and abs(float(prior.weight.sum()) - 1.0) < 1e-6):
        raise LearnError("learned prior: expected weights above 0 that add up to 1, and a doubt from 0 to below 1")
    return prior


def _hours(time_h: Array) -> Array:
    steps = np.diff(time_h)
    return np.concatenate(([float(np.median(steps)) if steps.size else 1.0], steps))


@dataclass(frozen=True, slots=True)
class LearnedLaw:
    """Damage law of a kind of gear: weighted grid over (m, gamma, log C, scatter), (n,) each."""

    m: Array
    gamma: Array
    log_C: Array
    scatter: Array
    """sd of the logarithm of C between gears"""
    weight: Array
    ultimate_Nm: float

    def interval(self, name: str, probability: float = 0.9) -> tuple[float, float]:
        """Central interval of `m`, `gamma`, `log_C` or `scatter`."""
        edge = (1.0 - probability) / 2.0
        return self.quantile(name, edge), self.quantile(name, 1.0 - edge)

    def quantile(self, name: str, probability: float) -> float:
        """Quantile of one parameter's marginal."""
        values = getattr(self, name)
        order = np.argsort(values, kind="stable")
        above = np.cumsum(self.weight[order])
        levels, last = np.unique(values[order][::-1], return_index=True)
        mass = above[len(above) - 1 - last]
        # a grid value stands for a cell: half of its mass lies below it
        middle = mass - 0.5 * np.diff(mass, prepend=0.0)
        return float(np.interp(probability, middle, levels))


M_GRID = np.arange(3.0, 16.01, 0.25)
GAMMA_GRID = np.arange(0.0, 3.01, 0.25)
SCATTER_GRID = np.geomspace(0.05, 1.5, 16)
LEVEL_GRID = np.linspace(-5.0, 5.0, 41)
"""of log C around its best value, in standard errors"""
TORQUE_CELLS, LOSS_CELLS = 60, 24


def learn_law(gear: Gear, lives: Sequence[FailedGear]) -> LearnedLaw:
    """C, m, gamma and the scatter of C between gears, with uncertainty, from flat priors on a grid.

    A gear fails when its own damage reaches 1; one that still runs, or failed otherwise, counts as censored.
    Raises `LearnError` for fewer than five failures.
    """
    failed = np.array([life.failed for life in lives])
    if failed.sum() < FEWEST:
        raise LearnError(f"{int(failed.sum())} failed gears: expected at least {FEWEST} to learn from")
    ultimate = gear.buckling_Nm or gear.momentary_peak_Nm or 4.0 * gear.rated_torque_Nm
    use = np.array([_log_use(life, ultimate) for life in lives])
    count = int(failed.sum())
    middle = use[failed].mean(axis=0)
    spread = use[failed].std(axis=0)
    scatter = SCATTER_GRID[:, None]
    error = np.sqrt(SCATTER_GRID**2 + np.mean(spread) ** 2)[:, None] / math.sqrt(count)
    log_weight = np.empty((len(M_GRID), len(GAMMA_GRID), len(SCATTER_GRID), len(LEVEL_GRID)))
    log_C = np.empty_like(log_weight)
    for i, j in np.ndindex(len(M_GRID), len(GAMMA_GRID)):
        level = middle[i, j] + LEVEL_GRID * error
        total = np.log(error) - np.log(scatter)
        for life in range(len(lives)):
            z = (use[life, i, j] - level) / scatter
            total = total + (-0.5 * z**2 - np.log(scatter) if failed[life] else log_ndtr(-z))
        log_weight[i, j] = total
        log_C[i, j] = -level
    weight = np.exp(log_weight - log_weight.max())
    grids = np.meshgrid(M_GRID, GAMMA_GRID, SCATTER_GRID, indexing="ij")
    m, gamma, width = (np.repeat(grid[..., None], len(LEVEL_GRID), axis=-1).ravel() for grid in grids)
    return LearnedLaw(m, gamma, log_C.ravel(), width, weight.ravel() / weight.sum(), ultimate)


def _log_use(life: FailedGear, ultimate_Nm: float) -> Array:
    """(m, gamma) grid of log sum of cycles * (tau / (tau_ult (1 - gamma dK)))^m over a life."""
    torque = np.abs(life.columns["torque_cubic_mean_Nm"])
    cycles = CYCLES_PER_TURN * 60.0 * np.abs(life.columns["speed_in_rpm"]) * _hours(life.time_h)
    stiffness = life.columns.get("stiffness_Nm_per_rad")
    loss = _loss(stiffness) if stiffness is not None else np.zeros_like(torque)
    log_torque = np.log(np.maximum(torque, 1e-6) / ultimate_Nm)
    good = np.isfinite(log_torque) & np.isfinite(cycles) & np.isfinite(loss) & (cycles > 0.0)
    cells, edges_t, edges_s = np.histogram2d(
        log_torque[good], loss[good], bins=(TORQUE_CELLS, LOSS_CELLS), weights=cycles[good]
    )
    t, s = (0.5 * (edges[1:] + edges[:-1]) for edges in (edges_t, edges_s))
    weaker = 1.0 - np.clip(GAMMA_GRID[:, None] * s, 0.0, MOST_LOSS)
    answer = np.empty((len(M_GRID), len(GAMMA_GRID)))
    for i, m in enumerate(M_GRID):
        by_loss = np.exp(m * t) @ cells
        answer[i] = np.log(weaker**-m @ by_loss)
    return answer


def _loss(stiffness: Array) -> Array:
    """Relative loss of stiffness, smoothed over a fortieth of the life; the first twentieth is the baseline."""
    known = np.isfinite(stiffness)
    if known.sum() < 40:
        return np.zeros_like(stiffness)
    index = np.arange(len(stiffness))
    filled = np.interp(index, index[known], stiffness[known])
    width = max(len(filled) // 40, 1)
    kernel = np.ones(width) / width
    padded = np.pad(filled, (width // 2, width - 1 - width // 2), mode="edge")
    smooth = functools.reduce(np.convolve, (padded, kernel))[width - 1 : width - 1 + len(filled)]
    base = float(np.mean(filled[: max(len(filled) // 20, 1)]))
    return np.asarray(np.clip(1.0 - smooth / base, 0.0, MOST_LOSS))
