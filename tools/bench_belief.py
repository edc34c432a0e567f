"""Whether diagnosis is right as often as it believes: recordings of the simulated drive, some of which tell little.

    python tools/bench_belief.py [RECORDINGS] [--first N]

Effects, sizes, encoders, motions and lengths are drawn; among them are laws outside the catalogue, one tone, slow
motions and nine seconds at 18 bits. One bin a line: how far the first cause was believed, and how often it was right.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from bench_row import Row

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.results import Diagnosis
from edge_daemon.rig.recording import HIDDEN_CASES, Simulated, simulate

SEED = 90
"""Of the recordings; those of the calibration are drawn with another."""
DAILY = 40
"""Recordings of the daily figures."""
BINS = 5
"""Of the reliability diagram: narrower ones would hold a handful each, and scatter by more than is asked for."""
BITS, MOTIONS, SECONDS = (24, 22, 20, 18), ("rich", "rich", "poor", "slow", "wide"), (9.0, 12.0, 20.0, 30.0)
BASE = ("linear_stiffness", "viscous_damping")


@dataclass(frozen=True, slots=True)
class Belief:
    """What was believed of one recording, and whether it is so."""

    case: str
    verdict: str
    answer: str
    probability: float
    right: bool


def drawn(i: int, seed: int = SEED) -> Simulated:
    """The recording of that number."""
    rng = np.random.default_rng([i, seed])
    effects = HIDDEN_CASES[int(rng.integers(len(HIDDEN_CASES)))]
    bits, motion, seconds = int(rng.choice(BITS)), str(rng.choice(MOTIONS)), float(rng.choice(SECONDS))
    return simulate(effects, seconds, seed=int(rng.integers(2**31)), bits_out=bits, motion=motion)


def base_model(made: Simulated) -> Model:
    """What the user knows: ratio, inertia, a linear spring with damping."""
    sizes = made.truth["parameters"]
    return Model("torsion", sizes["ratio"], sizes["inertia_kg_m2"], tuple(map(ModelEffect, BASE)))  # type: ignore[index]


def truth_of(made: Simulated) -> frozenset[str]:
    """The effects that are in a recording beside the base."""
    return frozenset(map(str, made.truth["effects"])) - set(BASE)  # type: ignore[call-overload]


def believed(made: Simulated, found: Diagnosis) -> Belief:
    """Of the first cause; what is adequate is not believed to be anything."""
    truth = truth_of(made)
    first = found.candidates[0] if found.candidates else None
    answer = first.effect if first else found.verdict
    outside = any(name.startswith("outside") for name in truth)
    right = frozenset(answer.split("+")) == truth if first else not truth or (outside and answer == "unexplained")
    return Belief("+".join(sorted(truth)) or "none", found.verdict, answer, first.probability if first else 1.0, right)


def beliefs(numbers: Sequence[int]) -> Iterator[tuple[int, Belief]]:
    """Every recording diagnosed."""
    for i in numbers:
        made = drawn(i)
        yield i, believed(made, diagnose([made], base_model(made)))


def diagram(rows: Sequence[Belief]) -> list[tuple[float, float, int]]:
    """Mean belief, share that was right and number, of each bin that holds anything."""
    bins = [min(int(row.probability * BINS), BINS - 1) for row in rows]
    own = [[row for row, bin_ in zip(rows, bins, strict=True) if bin_ == k] for k in range(BINS)]
    return [
        (float(np.mean([r.probability for r in part])), float(np.mean([r.right for r in part])), len(part))
        for part in own
        if part
    ]


def calibration_error(rows: Sequence[Belief]) -> float:
    """Expected calibration error (Naeini et al. 2015): belief less frequency, over bins by how many they hold."""
    return sum(n * abs(belief - right) for belief, right, n in diagram(rows)) / max(len(rows), 1)


def named(rows: Sequence[Belief]) -> list[Belief]:
    """Those where a cause was listed."""
    return [row for row in rows if row.verdict != "adequate" and row.answer != row.verdict]


def rows() -> list[Row]:
    """Calibration over the daily recordings."""
    every = [row for _, row in beliefs(range(DAILY))]
    causes = named(every)
    sure = [row for row in causes if row.probability >= 0.9]
    wrong = [f"{row.case}: {row.answer}" for row in sure if not row.right]
    doubtful = [row for row in causes if 0.3 <= row.probability < 0.7]
    shares = ", ".join(f"{belief:.2f} -> {right:.2f} ({n})" for belief, right, n in diagram(causes))
    return [
        Row("expected calibration error of the first cause", calibration_error(causes), "1", 0.05, peer=shares),
        Row("believed at 0.9 or more and wrong", float(len(wrong)), "causes", 0.0, peer="; ".join(wrong)),
        Row("believed at 0.3 to 0.7", float(len(doubtful)), "causes"),
    ]


def main() -> None:
    """Prints each recording and the reliability diagram."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=int, nargs="?", default=DAILY)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    done = []
    for i, row in beliefs(range(given.first, given.first + given.recordings)):
        done.append(row)
        mark = "" if row.right else "WRONG" if row.probability >= 0.9 else "wrong"
        print(f"{i:4} {row.case:36} {row.verdict:12} {row.answer:44} {row.probability:.2f} {mark}", flush=True)
    causes = named(done)
    for belief, right, n in diagram(causes):
        print(f"believed {belief:.2f}  right {right:.2f}  of {n}")
    print(f"expected calibration error {calibration_error(causes):.3f} over {len(causes)} causes")


if __name__ == "__main__":
    main()
