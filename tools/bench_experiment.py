"""How often the closed loop ends with the right cause, on the simulated drive, which shares no code with the model.

    python tools/bench_experiment.py [FIRST [LAST]]     cases FIRST to LAST of 30; all by default

Each case hides an effect and begins with one sine; every motion that the loop plans is simulated on the same gear.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass

from bench_explain import SINGLES, Case, base_model, judge
from bench_row import Row

from edge_daemon.explain.closed_loop import MOST_MOTIONS, ClosedLoop, Step, named
from edge_daemon.explain.results import Experiment
from edge_daemon.rig.motion import custom
from edge_daemon.rig.recording import Simulated, simulate

CASES = [Case((SINGLES[k % len(SINGLES)],), 24, "poor", 40 + k) for k in range(30)]
LEAST_RIGHT = 28


@dataclass(frozen=True, slots=True)
class Loop:
    """One loop that was followed to its end."""

    case: Case
    steps: list[Step]
    right: bool
    sure: bool
    """named with a probability of 0.9 or more, and wrong"""
    words: str
    seconds: float


def follow(case: Case) -> Loop:
    """One sine with a hidden effect, and then what the loop asks for."""
    began = time.process_time()
    first = case.recording()
    model, truth = base_model(first), [str(name) for name in first.truth["effects"]]  # type: ignore[attr-defined]
    parameters: Mapping[str, float] = first.truth["parameters"]  # type: ignore[assignment]
    loop = ClosedLoop(model, [first])

    def move(plan: Experiment) -> Simulated:
        motion, seed = custom(plan.tones_hz, plan.speeds_in_rad_s), 1000 * case.seed + len(loop.steps)
        return simulate(truth, plan.seconds, seed, bits_out=case.bits_out, motion=motion, parameters=parameters)

    answers = [named(loop.found), *(named(step.after) for step in loop.follow(move))]
    judged = judge(case, truth, loop.found)
    words = f"{' -> '.join(answers)}; {loop.ending}"
    return Loop(case, loop.steps, judged.right, judged.confidently_wrong, words, time.process_time() - began)


def rows() -> list[Row]:
    """The table of all cases."""
    return table_of([follow(case) for case in CASES])


def table_of(loops: list[Loop]) -> list[Row]:
    """Right, confidently wrong, motions and time."""
    least = LEAST_RIGHT if len(loops) == len(CASES) else 0.0
    missed = "; ".join(f"{row.case.name} {row.case.seed}: {row.words}" for row in loops if not row.right)
    most = max(len(row.steps) for row in loops)
    return [
        Row(f"right cause, of {len(loops)}", float(sum(row.right for row in loops)), "cases", least, True, missed),
        Row("confidently wrong", float(sum(row.sure for row in loops)), "cases", 0.0),
        Row("motions, most", float(most), "motions", float(MOST_MOTIONS)),
        Row("motions, mean", sum(len(row.steps) for row in loops) / len(loops), "motions"),
        Row("processor time of a loop, longest", max(row.seconds for row in loops), "s"),
    ]


def apart(plan: Experiment) -> str:
    """By how much the motion parts two causes; nothing where it was made to judge them all."""
    return f", x{plan.separation:.3g}" if plan.separates else ""


def main() -> None:
    """Prints each loop as it ends."""
    given = [int(word) for word in sys.argv[1:]]
    for k in range(given[0] if given else 0, given[1] if len(given) > 1 else len(CASES)):
        row = follow(CASES[k])
        word = "right" if row.right else "WRONG"
        bits = ", ".join(
            f"expected {s.expects_bits:.2f}{apart(s.plan)}, learned {s.learned_bits:.2f}" for s in row.steps
        )
        print(f"{k:2} {row.case.name} {row.case.seed}: {word} after {len(row.steps)}: {row.words} ({bits}; "
              f"{row.seconds:.0f} s)", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
