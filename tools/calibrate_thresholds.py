"""Derives again the thresholds of `explain` that were measured, from simulated recordings, and prints them beside the
values in use.

    python tools/calibrate_thresholds.py [RECORDINGS]

The recordings are those of `tools/bench_belief.py`, drawn with another seed: what is learned here is judged there. The
numbers are those under which the true causes are most likely (maximum likelihood); a recording whose truth is not
among the explanations counts for `none of them`.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from bench_belief import base_model, drawn, truth_of
from bench_row import Row
from scipy.optimize import minimize

from edge_daemon.explain.belief import beliefs, far_odds, samples, scatter, unexplained
from edge_daemon.explain.diagnose import searched
from edge_daemon.explain.thresholds import MEASURED, TABLE
from edge_daemon.explain.verdict import Verdict
from edge_daemon.identify.motion_richness import RICH_TONES, tones
from edge_daemon.records import Array

SEED = 77
"""Of the recordings to learn from."""
RECORDINGS = 150
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
    verdict = Verdict(model, search.problem, search)
    worth = verdict.kept(verdict.ordered(found))
    if not worth or search.base.level <= 1:
        return None
    scatters = np.array([scatter(h) for h in worth])
    scatters = np.minimum.accumulate(scatters[::-1])[::-1]
    counts = np.array([samples(h, search.problem) for h in worth])
    truth, best = truth_of(made), worth[0]
    return Learned(
        np.sqrt(2 * counts * (scatters - scatters.min())),
        np.log([verdict.modesty(h, worth) for h in worth]),
        np.array([h.parameters for h in worth], dtype=float),
        unexplained(best, float(counts[0])) * (best.error / search.base.error) ** 2,
        far_odds(best, search.base),
        tones(search.problem.trials) < RICH_TONES,
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
    known = [row for row in TABLE if row.kind == MEASURED]
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


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=int, nargs="?", default=RECORDINGS)
    for row in calibrated(parser.parse_args().recordings):
        print(f"{row.name:50} {row.value:10.3g} {row.unit:4} {row.peer}")


if __name__ == "__main__":
    main()
