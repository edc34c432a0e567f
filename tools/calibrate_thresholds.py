"""Derives again the thresholds of `explain` that were measured, from simulated recordings, and prints them beside the
values in use.

    python tools/calibrate_thresholds.py [RECORDINGS]

The recordings are those of `tools/bench_belief.py`, drawn with another seed: what is learned here is judged there. The
numbers are those under which the true causes are most likely (maximum likelihood); a recording whose truth is not
among the explanations counts for `none of them`.

With one encoder the steps of stories are learned from (`tools/story_steps.py`), of drawn joints and of real machines:
the numbers of a grid under which beliefs err least in the worse of the two, and nothing wrong is believed at 0.9. Each
real machine is also left out once and judged by what the others chose.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from bench_belief import base_model, drawn, truth_of
from bench_row import Row
from scipy.optimize import minimize
from story_steps import Step, real, steps
from story_steps import drawn as drawn_joints

from edge_daemon.explain.diagnose import searched
from edge_daemon.explain.verdict import Verdict
from edge_daemon.identify.problem import RICH_TONES, tones
from edge_daemon.records import Array
from edge_daemon.search.belief import beliefs, far_odds, samples, scatter, unexplained
from edge_daemon.search.thresholds import MEASURED, NUMBER_PRICE, TABLE

SEED = 77
"""Of the recordings to learn from."""
RECORDINGS = 150
JOINTS = 96
"""Drawn joints with one encoder to learn from."""
STEPS = "STEP_"
"""How the names of the numbers of one encoder's stories begin."""
GRID = tuple(itertools.product((0.3, 0.35, 0.4, 0.45, 0.5), (0.07, 0.085, 0.1), (1.0, 1.5, 2.0)))
"""Of STEP_TEMPER, STEP_ODDS and STEP_POWER."""
BINS, BOLD = 5, 0.9
LEAST_SHARE = 1e-3
"""Probability at the least: one recording that no numbers explain must not rule the rest."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What beliefs of one recording are made of."""

    apart_sd: Array
    """(k,) of each explanation from the best"""
    shy: Array
    """(k,) logarithm of the weight that the order leaves it"""
    numbers: Array
    """(k,) fitted for it"""
    left: float
    """share of the error's power that is left, times the odds of a law that leaves none"""
    far: float
    """odds of none of them by what the best leaves above the noise"""
    poor: bool
    truth: int
    """place of the truth; k where it is none of them"""


def learned(i: int) -> Learned | None:
    """Of one recording; None where nothing is to be named."""
    made = drawn(i, SEED)
    model = base_model(made)
    search, found = searched([made], model)
    verdict = Verdict(model, search)
    worth = verdict.kept(verdict.ordered(found))
    if not worth or search.base.level <= 1:
        return None
    scatters = np.array([scatter(h) for h in worth])
    scatters = np.minimum.accumulate(scatters[::-1])[::-1]
    counts = np.array([samples(h, search.regression) for h in worth])
    truth, best = truth_of(made), worth[0]
    return Learned(
        np.sqrt(2 * counts * (scatters - scatters.min())),
        np.log([verdict.complexity_weight(h, worth) for h in worth]),
        np.array([h.parameters for h in worth], dtype=float),
        unexplained(best, float(counts[0])) * (best.error / search.base.error) ** 2,
        far_odds(best),
        tones(search.regression.trials) < RICH_TONES,
        next((k for k, h in enumerate(worth) if frozenset(h.added) == truth), len(worth)),
    )


def surprise(point: Array, rows: Sequence[Learned]) -> float:
    """Negative log likelihood of what is true."""
    temper, price, none, poor = np.exp(point)
    total = 0.0
    for row in rows:
        weights = np.minimum.accumulate(-temper * row.apart_sd + row.shy - price * row.numbers)
        odds = max(none * row.left + row.far + poor * row.poor, 1e-300)
        shares = beliefs(weights - weights[0], [math.log(odds)])
        share = 1.0 - shares.sum() if row.truth == len(shares) else shares[row.truth]
        total -= math.log(max(float(share), LEAST_SHARE))
    return total


def calibrated(count: int) -> list[Row]:
    """Each measured threshold derived again, beside the one in use."""
    rows = [row for row in map(learned, range(count)) if row is not None]
    known = [row for row in TABLE if row.kind == MEASURED and not row.name.startswith(STEPS)]
    start = np.log([row.value for row in known])
    found = minimize(surprise, start, args=(rows,), method="Nelder-Mead", options={"maxfev": 2000})
    fitted = [float(value) for value in np.exp(found.x)]
    return [
        *(
            Row(row.name, value, row.unit, peer=f"in use {row.value:g}")
            for row, value in zip(known, fitted, strict=True)
        ),
        Row("log likelihood lost by those in use, a recording", (surprise(start, rows) - found.fun) / len(rows), "1"),
    ]


def step_belief(step: Step, temper: float, odds: float, power: float) -> float:
    """Of the first cause and of what cannot be told from it, under other numbers than those in use."""
    weights = np.exp(np.minimum.accumulate(-temper * step.apart_sd + step.shy - NUMBER_PRICE * step.numbers))
    none = (odds * step.left / (1.0 - step.left)) ** power + math.exp(-temper * step.gained_sd)
    first = float(weights[step.same].sum())
    return first / (float(weights.sum()) + first * none)


def reliability(beliefs_: Array, right: Array) -> float:
    """Expected calibration error."""
    bins = np.minimum((beliefs_ * BINS).astype(int), BINS - 1)
    parts = [bins == k for k in np.unique(bins)]
    return float(sum(part.sum() * abs(beliefs_[part].mean() - right[part].mean()) for part in parts)) / len(right)


def worst(point: tuple[float, float, float], sources: Sequence[Sequence[Step]]) -> float:
    """The largest calibration error of any source, and one more for each that is wrong and bold."""
    errors, bold = [], 0
    for rows in filter(None, sources):
        told = np.array([step_belief(row, *point) for row in rows])
        right = np.array([row.right for row in rows], dtype=float)
        errors.append(reliability(told, right))
        bold += int(np.sum((told >= BOLD) & (right == 0)))
    return max(errors) + bold


def calibrated_steps(count: int) -> list[Row]:
    """The numbers of one encoder's stories."""
    simulated = [step for told in drawn_joints(count) for step in steps(told)]
    machines = [step for told in real() for step in steps(told)]
    best = min(GRID, key=lambda point: worst(point, (simulated, machines)))
    aside: list[tuple[float, bool]] = []
    for name in sorted({step.source for step in machines}):
        rest = [step for step in machines if step.source != name]
        chosen = min(GRID, key=partial(worst, sources=(simulated, rest)))
        aside += [(step_belief(step, *chosen), step.right) for step in machines if step.source == name]
    known = [row for row in TABLE if row.name.startswith(STEPS)]
    in_use = tuple(row.value for row in known)
    return [
        *(Row(row.name, v, row.unit, peer=f"in use {row.value:g}") for row, v in zip(known, best, strict=True)),
        *(
            Row(f"calibration error, {name}", worst(in_use, (rows,)), "1", 0.06, peer=f"{len(rows)} steps")
            for name, rows in (("drawn joints", simulated), ("real machines", machines))
            if rows
        ),
        *(
            [Row("the same, each real machine left out", reliability(*np.array(aside, dtype=float).T), "1")]
            if aside
            else []
        ),
    ]


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=int, nargs="?", default=RECORDINGS)
    parser.add_argument("--joints", type=int, default=JOINTS)
    given = parser.parse_args()
    gears = calibrated(given.recordings) if given.recordings else []
    for row in (*gears, *calibrated_steps(given.joints)):
        print(f"{row.name:50} {row.value:10.3g} {row.unit:4} {row.peer}")


if __name__ == "__main__":
    main()
