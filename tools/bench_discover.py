"""How well formulas are found for laws that no catalogue lists, judged on another motion of the same gear.

    python tools/bench_discover.py [SEEDS] [--bits 24 20] [--draw NAME] [--law NAME ...] [--alone] [--known N]

A formula, or the effect that is named instead, is right where the model with it, fitted again on a recording of another
motion, leaves at most three noise floors or 5 % of the error. `--known N`: so many healthy and catalogued recordings,
on which none may be believed that competes with the right answer. `--alone`: without the diagnosis before. `--rival`:
what a simple greedy search finds instead (`greedy_formulas`), beside ours on the same laws. Times are of the processor.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from bench_explain import SINGLES, base_model
from bench_row import Row
from composed_laws import COMPOSED
from drawn_laws import drawn
from engineered_laws import ENGINEERED
from fresh_laws import FIRST_DRIVE, FIRST_TORSION, SECOND_DRIVE, SECOND_TORSION
from greedy_formulas import greedy
from imagined_laws import CLOSED, OPEN
from outside_laws import DRIVE, LAST_DRIVE, LAST_TORSION, LATER_DRIVE, LATER_TORSION, TORSION
from published_laws import PUBLISHED

from edge_daemon.discover.discover import discover
from edge_daemon.discover.proposals import proposals
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.results import Diagnosis
from edge_daemon.identify.fit import fit
from edge_daemon.rig.drive_truth import DriveTruth
from edge_daemon.rig.recording import Simulated, simulate
from edge_daemon.rig.truths import Truth

LAST = (*LAST_TORSION, *LAST_DRIVE)
LAWS = (*TORSION, *DRIVE, *LATER_TORSION, *LATER_DRIVE, *LAST)
DRAWS = {
    "all": LAWS,
    "later": (*LATER_TORSION, *LATER_DRIVE),
    "last": LAST,
    "first": (*FIRST_TORSION, *FIRST_DRIVE),
    "second": (*SECOND_TORSION, *SECOND_DRIVE),
    "third": drawn(3),
    "fourth": drawn(4),
    "open": OPEN,
    "closed": CLOSED,
    "fifth": COMPOSED,
    "sixth": ENGINEERED,
    "seventh": PUBLISHED,
}
"""Sets of laws by the time at which they were written; `first` and `second` after all others, `third` and `fourth`
drawn at random after those, `open` and `closed` imagined then, `fifth` composed, `sixth` written at a desk
and `seventh` after published effects, after those."""
FLOORS, SHARE = 3.0, 0.05
"""of the noise, or of the error without: what a right formula leaves on another motion at the most"""
BELIEVED, SURE = 0.5, 0.9


@dataclass(frozen=True, slots=True)
class Case:
    """One law of one gear, and how it is recorded."""

    law: Truth | DriveTruth
    bits: int
    seed: int

    @property
    def balance(self) -> str:
        """Which of the two."""
        return "drive" if isinstance(self.law, DriveTruth) else "torsion"

    def recording(self) -> Simulated:
        """The recording that is searched."""
        return simulate(seed=self.seed, bits_out=self.bits, laws=(self.law,), balance=self.balance)

    def other(self, first: Simulated) -> Simulated:
        """Another motion of the same gear."""
        same: dict[str, float] = first.truth["parameters"]  # type: ignore[assignment]
        return simulate(
            seed=self.seed + 5000, bits_out=self.bits, laws=(self.law,), balance=self.balance, parameters=same
        )


@dataclass(frozen=True, slots=True)
class Found:
    """What came of one case."""

    verdict: str
    expression: str
    probability: float
    floors: float
    """error on the other motion"""
    share: float
    """of the error without"""
    seconds: float

    @property
    def right(self) -> bool:
        """Whether the formula holds on the other motion."""
        return bool(self.expression) and (self.floors <= FLOORS or self.share <= SHARE)


def model_of(recording: Simulated) -> Model:
    """What the user begins with."""
    if recording.truth["balance"] == "drive":
        return Model("drive", recording.truth["parameters"]["ratio"], np.nan, (ModelEffect("inertia"),))  # type: ignore[index]
    return base_model(recording)


def tried(case: Case, alone: bool = False, rival: bool = False) -> Found:
    """One case searched, and its first formula held against another motion."""
    recording = case.recording()
    model = model_of(recording)
    start = time.process_time()
    if rival:
        return _held(case, model, recording, greedy([recording], model), time.process_time() - start)
    if alone:
        verdict, found = "-", proposals([recording], model, lambda what, share: None)
    else:
        diagnosis = discover([recording], model)
        verdict, found = diagnosis.verdict, diagnosis.proposals
    seconds = time.process_time() - start
    if found:
        name, belief = found[0].expression, found[0].probability
        larger = model.with_effect(ModelEffect("law", {}, found[0].expression))
    elif verdict == "missing":
        name, belief = diagnosis.candidates[0].effect, diagnosis.candidates[0].probability
        larger = add_effect(model, name, [recording]).model
    else:
        return Found(verdict, "", 0.0, np.inf, np.inf, seconds)
    return Found(verdict, name, belief, *_error(case, model, larger, recording), seconds)


def _held(case: Case, model: Model, recording: Simulated, expression: str, seconds: float) -> Found:
    """What the simple search comes to, which believes whatever it finds."""
    if not expression:
        return Found("-", "", 0.0, np.inf, np.inf, seconds)
    larger = model.with_effect(ModelEffect("law", {}, expression))
    return Found("-", expression, 1.0, *_error(case, model, larger, recording), seconds)


def _error(case: Case, model: Model, larger: Model, recording: Simulated) -> tuple[float, float]:
    """Of the larger model on another motion: over the noise floor, and over that of the model."""
    other = case.other(recording)
    before, after = fit([other], model), fit([other], larger)
    return after.solution.rmse / after.floor, after.solution.rmse / before.solution.rmse


def competing(diagnosis: Diagnosis, truth: Sequence[str]) -> bool:
    """Whether a formula is believed where the catalogue has the answer, or nothing is missing."""
    believed = diagnosis.proposals and diagnosis.proposals[0].probability > BELIEVED
    return bool(believed) and not (truth and diagnosis.proposals[0].resembles in truth)


def known(count: int, bits: int) -> Iterator[tuple[str, Diagnosis, Sequence[str]]]:
    """Healthy and catalogued recordings, half of each, diagnosed thoroughly."""
    for i in range(count):
        effects = () if i < count // 2 else (SINGLES[i % len(SINGLES)],)
        recording = simulate(effects, 30.0, seed=7919 * i + 13, bits_out=bits)
        found = discover([recording], base_model(recording), thorough=True)
        yield "+".join(effects) or "none", found, recording.truth["effects"]  # type: ignore[misc]


def rows() -> Iterator[Row]:
    """The figures."""
    found = [tried(Case(law, bits, 3)) for bits in (24, 20) for law in LAWS]
    yield Row("laws outside the catalogue: right on another motion", np.mean([f.right for f in found]), "1", 0.9, True)
    wrong = sum(f.probability > SURE and not f.right for f in found)
    yield Row("of them believed above 0.9 and wrong", wrong, "1", 0)
    yield Row("time of one, slowest", max(f.seconds for f in found), "s", 15)
    believed = sum(competing(diagnosis, truth) for _, diagnosis, truth in known(40, 24))
    yield Row("healthy or catalogued, and a formula believed", believed, "1", 0)


def main() -> None:
    """The table, case by case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", type=int, nargs="?", default=1)
    parser.add_argument("--bits", type=int, nargs="+", default=[24, 20])
    parser.add_argument("--law", nargs="+", default=[])
    parser.add_argument("--known", type=int, default=0)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--rival", action="store_true")
    parser.add_argument("--draw", choices=DRAWS, default="all")
    arguments = parser.parse_args()
    if arguments.known:
        for name, diagnosis, truth in known(arguments.known, arguments.bits[0]):
            best = diagnosis.proposals[0] if diagnosis.proposals else None
            told = f"{best.probability:.2f} {best.expression[:80]}" if best else "-"
            mark = "COMPETES" if competing(diagnosis, truth) else ""
            print(f"{name:24} {diagnosis.verdict:12} {told} {mark}", flush=True)
        return
    laws = [law for law in DRAWS[arguments.draw] if not arguments.law or law.name in arguments.law]
    right = []
    for bits in arguments.bits:
        for law in laws:
            for seed in range(3, 3 + arguments.seeds):
                found = tried(Case(law, bits, seed), arguments.alone, arguments.rival)
                right.append(found.right)
                print(
                    f"{law.name:22} {bits} {'right' if found.right else 'WRONG':6} {found.verdict:12} "
                    f"p {found.probability:.2f} {found.floors:6.2f} floors {found.share:6.1%} "
                    f"{found.seconds:5.1f} s {found.expression[:110]}",
                    flush=True,
                )
    print(f"right: {sum(right)} of {len(right)}")


if __name__ == "__main__":
    main()
