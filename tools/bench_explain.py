"""How well diagnosis names what is missing, on recordings of the simulated drive, which shares no code with it.

    python tools/bench_explain.py [SEEDS] [--bits 24 20] [--motion rich poor] [--case NAME ...]

One line per case: success, `adequate` or `unexplained` where due, error after `add` over that of the true model, time.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from bench_row import Row

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect, with_added
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.results import Diagnosis
from edge_daemon.identify.fit import fit
from edge_daemon.rig.motion import custom
from edge_daemon.rig.recording import Simulated, simulate

SINGLES = (
    "coulomb_friction",
    "stribeck_friction",
    "hysteresis",
    "backlash",
    "polynomial_stiffness",
    "piecewise_stiffness",
    "kinematic_error",
    "gravity_load",
    "constant_load",
    "encoder_skew",
    "encoder_eccentricity",
    "temperature_stiffness",
    "temperature_friction",
)
PAIRS = (
    ("kinematic_error", "coulomb_friction"),
    ("gravity_load", "coulomb_friction"),
    ("kinematic_error", "hysteresis"),
    ("encoder_skew", "kinematic_error"),
)
PARTNERS = (
    {"gravity_load", "encoder_eccentricity"},
    {"encoder_skew", "output_viscous_friction"},
    {"bouc_wen_hysteresis", "maxwell_slip_hysteresis"},
    {"backlash", "piecewise_stiffness"},
)
"""one function of the motion, or one law under two names: either may be first if it lists the other"""
MOST_PARTNERS = 3


@dataclass(frozen=True, slots=True)
class Case:
    """What is hidden, and how it is recorded."""

    effects: tuple[str, ...]
    bits_out: int
    motion: str
    seed: int

    @property
    def name(self) -> str:
        """Effects joined, or `none`."""
        return "+".join(self.effects) or "none"

    def recording(self) -> Simulated:
        """The recording, the same for the same case."""
        return simulate(self.effects, 30.0, seed=7919 * self.seed + 13, bits_out=self.bits_out, motion=self.motion)


def cases(seeds: int, bits: Sequence[int], motions: Sequence[str], names: Sequence[str] = ()) -> Iterator[Case]:
    """Every hidden case, `seeds` times each."""
    hidden: list[tuple[str, ...]] = [(), *((name,) for name in SINGLES), *PAIRS, ("outside",)]
    for motion in motions:
        for bit in bits:
            for effects in hidden:
                if not names or "+".join(effects) in names or (not effects and "none" in names):
                    for seed in range(seeds):
                        yield Case(effects, bit, motion, seed)


def base_model(recording: Simulated) -> Model:
    """What the user knows: inertia, ratio, a linear spring with damping."""
    parameters: Mapping[str, float] = recording.truth["parameters"]  # type: ignore[assignment]
    inertia = parameters["inertia_kg_m2"]
    base = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
    return Model("torsion", parameters["ratio"], inertia, base)


@dataclass(frozen=True, slots=True)
class Judgement:
    """Whether a diagnosis is right."""

    right: bool
    exact: bool
    confidently_wrong: bool
    answer: str


def judge(case: Case, truth: Sequence[str], diagnosis: Diagnosis) -> Judgement:
    """`right`: named first, or listed by a true partner; `confidently_wrong`: p >= 0.9 for something else."""
    first = diagnosis.candidates[0] if diagnosis.candidates else None
    answer = first.effect if first and diagnosis.verdict == "missing" else diagnosis.verdict
    if not case.effects:
        return Judgement(diagnosis.verdict == "adequate", True, diagnosis.verdict == "missing", answer)
    if case.effects == ("outside",):
        sure = first is not None and first.probability >= 0.9
        return Judgement(diagnosis.verdict == "unexplained", True, sure, answer)
    if first is None or diagnosis.verdict != "missing":
        return Judgement(False, False, False, answer)
    exact = set(first.effect.split("+")) == set(truth)
    listed = [set(name.split("+")) for name in first.confused_with]
    partner = same(set(first.effect.split("+")), set(truth))
    shared = partner and set(truth) in listed and len(listed) <= MOST_PARTNERS
    either = "hysteresis" in case.effects and partner
    wrong = not (exact or shared or either or set(truth) in listed) and first.probability >= 0.9
    return Judgement(exact or shared or either, exact, wrong, answer)


def same(one: set[str], other: set[str]) -> bool:
    """Whether two sets of effects differ only by partners."""
    extra, missing = one - other, other - one
    return len(extra) == len(missing) and all(
        any(name in group and group & missing for group in PARTNERS) for name in extra
    )


@dataclass(frozen=True, slots=True)
class Trial:
    """One case, one seed."""

    case: Case
    judgement: Judgement
    ratio: float
    """held-out error after `add` over that of the true model; NaN where nothing is to be added"""
    seconds: float


def run(case: Case, with_add: bool = True) -> Trial:
    """One recording diagnosed and judged."""
    recording = case.recording()
    model = base_model(recording)
    truth = [str(name) for name in recording.truth["effects"]]  # type: ignore[attr-defined]
    start = time.perf_counter()
    diagnosis = diagnose([recording], model)
    seconds = time.perf_counter() - start
    judgement = judge(case, truth, diagnosis)
    ratio = float("nan")
    if with_add and diagnosis.verdict == "missing" and case.effects and case.effects != ("outside",):
        added = add_effect(model, diagnosis.candidates[0].effect, [recording]).after.nrmse
        ratio = added / true_error(model, truth, recording, diagnosis)
    return Trial(case, judgement, ratio, seconds)


def true_error(model: Model, truth: Sequence[str], recording: Simulated, diagnosis: Diagnosis) -> float:
    """Least held-out error of the true structure, however it was reached: fitted from where its effects start, added
    step by step, or in the search. What `add` reaches is held against that, so that a poor minimum shows."""
    name = "+".join(truth)
    found = [row.nrmse_after for row in diagnosis.candidates if set(row.effect.split("+")) == set(truth)]
    tries = [fit([recording], with_added(model, name)).nrmse, add_effect(model, name, [recording]).after.nrmse]
    return min([*tries, *found])


CHANGED = {"gravity_load", "encoder_skew"}
"""what vanishes when an advice other than a motion is followed: axis upright, encoders latched by one signal"""


@dataclass(frozen=True, slots=True)
class Followed:
    """A proposed experiment done on the true plant."""

    case: Case
    pair: tuple[str, str]
    motion: str
    predicted: float
    separated: bool
    right: bool
    """whether the truth, or what is one function of any motion with it, then comes first"""
    answer: str


def follow(case: Case) -> Followed | None:
    """The experiment that the diagnosis of a case proposes, simulated, and both recordings diagnosed together; None
    where nothing was confused."""
    recording = case.recording()
    model = base_model(recording)
    truth = {str(name) for name in recording.truth["effects"]}  # type: ignore[attr-defined]
    before = diagnose([recording], model)
    plan = before.next_experiment
    if plan is None:
        return None
    changed = plan.motion.startswith("repeat")
    effects = sorted(truth - CHANGED) if changed else sorted(truth)
    own: Mapping[str, float] = recording.truth["parameters"]  # type: ignore[assignment]
    kept = {name: value for name, value in own.items() if "." not in name or name.split(".")[0] in effects}
    motion = custom(plan.tones_hz, plan.speeds_in_rad_s)
    new = simulate(effects, plan.seconds, seed=case.seed + 71, bits_out=case.bits_out, motion=motion, parameters=kept)
    if changed:
        after = diagnose([new], model)
        differ = set(plan.separates[0].split("+")) ^ set(plan.separates[1].split("+"))
        gone = not any(differ & set(row.effect.split("+")) for row in after.candidates[:1])
        separated = right = gone == bool(truth & CHANGED & differ or not truth & differ)
    else:
        after = diagnose([recording, new], model)
        separated, right = apart(after, plan.separates), judge(case, sorted(truth), after).right
    first = after.candidates[0].effect if after.candidates else after.verdict
    return Followed(case, plan.separates, plan.motion, plan.separation, separated, right, first)


def apart(diagnosis: Diagnosis, pair: tuple[str, str]) -> bool:
    """Whether one of a pair is no longer as good as the other: first without it, or both behind something else."""
    if not diagnosis.candidates:
        return False
    first = diagnosis.candidates[0]
    alike = {first.effect, *first.confused_with}
    return not set(pair) <= alike


def experiments(seeds: int, bits: Sequence[int], names: Sequence[str] = ()) -> list[Followed]:
    """Every experiment that is proposed after one sine, and after the rich motion where only a change helps."""
    every = [*cases(seeds, bits, ["poor"], names), *cases(seeds, bits, ["rich"], names or ONLY_CHANGE)]
    done = (follow(case) for case in every if case.effects and case.effects != ("outside",))
    return [row for row in done if row is not None]


ONLY_CHANGE = ("gravity_load", "encoder_eccentricity", "encoder_skew")
"""cases that no motion tells from their partners"""


DAILY = ("none", "coulomb_friction", "hysteresis", "backlash", "kinematic_error", "gravity_load",
         "encoder_skew", "kinematic_error+coulomb_friction", "outside")  # fmt: skip
"""cases of the daily figures, one recording each at 24 and 20 bits; `main` runs all"""
LONGEST_S = 5.0
LARGEST_MIB = 500.0


def rows() -> list[Row]:
    """Success, error after `add`, time and memory over the daily cases."""
    run(Case((), 24, "rich", 99), False)  # compiles the loop once, so that the times below are warm
    done = {bits: [run(case) for case in cases(1, [bits], ["rich"], DAILY)] for bits in (24, 20)}
    out = []
    for bits, trials in done.items():
        right = sum(trial.judgement.right for trial in trials) / len(trials)
        missed = [f"{t.case.name}: {t.judgement.answer}" for t in trials if not t.judgement.right]
        least = 0.98 if bits == 24 else 0.95
        out.append(Row(f"named rightly, {bits} bits", right, "1", least, True, "; ".join(missed)))
    every = [trial for trials in done.values() for trial in trials]
    ratios = [trial.ratio for trial in every if np.isfinite(trial.ratio)]
    slowest = max(every, key=lambda trial: trial.seconds)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return [
        *out,
        Row("confidently wrong", float(sum(trial.judgement.confidently_wrong for trial in every)), "cases", 0.0),
        Row("error after add over the true model's, median", float(np.median(ratios)), "1", 1.2),
        Row("the same, 90th percentile", float(np.quantile(ratios, 0.9)), "1", 1.5),
        Row("diagnosis of 30 s, median", float(np.median([t.seconds for t in every])), "s", LONGEST_S),
        Row("diagnosis of 30 s, longest", slowest.seconds, "s", LONGEST_S, peer=slowest.case.name),
        Row("peak memory", peak, "MiB", LARGEST_MIB),
    ]


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", type=int, nargs="?", default=1)
    parser.add_argument("--bits", type=int, nargs="+", default=[24, 20])
    parser.add_argument("--motion", nargs="+", default=["rich", "poor"])
    parser.add_argument("--case", nargs="+", default=[])
    parser.add_argument("--no-add", action="store_true")
    parser.add_argument("--experiment", action="store_true", help="follow the proposed experiments instead")
    given = parser.parse_args()
    if given.experiment:
        followed(experiments(given.seeds, given.bits, given.case))
        return
    done: list[Trial] = []
    for case in cases(given.seeds, given.bits, given.motion, given.case):
        row = run(case, not given.no_add)
        done.append(row)
        if not row.judgement.right or row.judgement.confidently_wrong:
            print(
                f"  missed: {case.motion} {case.bits_out} {case.name} seed {case.seed}: {row.judgement.answer}",
                flush=True,
            )
    for motion in given.motion:
        for bits in given.bits:
            summary(
                [row for row in done if row.case.motion == motion and row.case.bits_out == bits],
                f"{motion} {bits} bits",
            )


def followed(rows: Sequence[Followed]) -> None:
    """What following the proposed experiments led to."""
    for row in rows:
        case = f"{row.case.motion} {row.case.bits_out} {row.case.name} seed {row.case.seed}"
        word = "apart" if row.separated else "NOT APART"
        print(f"  {case:44} {' / '.join(row.pair)}: {word} ({row.predicted:.3g} predicted), then {row.answer}")
    for kind, own in (
        ("by a motion", [row for row in rows if not row.motion.startswith("repeat")]),
        ("by a change", [row for row in rows if row.motion.startswith("repeat")]),
    ):
        separated, right = (sum(getattr(row, key) for row in own) for key in ("separated", "right"))
        print(f"{kind}: {separated} of {len(own)} confused pairs come apart, {right} then named rightly")


def summary(rows: Sequence[Trial], title: str) -> None:
    """One block of the table."""
    print(f"\n{title}: {sum(r.judgement.right for r in rows)} of {len(rows)} right, "
          f"{sum(r.judgement.confidently_wrong for r in rows)} confidently wrong")  # fmt: skip
    for name in dict.fromkeys(row.case.name for row in rows):
        own = [row for row in rows if row.case.name == name]
        ratios = [row.ratio for row in own if np.isfinite(row.ratio)]
        times = [row.seconds for row in own]
        text = f"{np.median(ratios):.2f}" if ratios else "-"
        right, exact = (sum(getattr(row.judgement, key) for row in own) for key in ("right", "exact"))
        line = f"  {name:36} right {right}/{len(own)} exact {exact}  after add / true {text:>5}"
        print(f"{line}  {np.median(times):5.1f} s (max {max(times):.1f})")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"  peak memory {peak:.0f} MiB")


if __name__ == "__main__":
    main()
