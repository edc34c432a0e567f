"""Shapes tracked live against the truth: Stribeck speed, hysteresis and gap, and how they follow a drift.

.venv/bin/python tools/bench_shape.py [RUNS]      Monte-Carlo runs, 20 unless told
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]

from bench_row import HEAD, Row, cells  # noqa: E402

from edge_daemon.effects.model import Model, ModelEffect  # noqa: E402
from edge_daemon.records import Estimate, Status  # noqa: E402
from edge_daemon.text import table  # noqa: E402
from edge_daemon.track import shape  # noqa: E402
from edge_daemon.track.live import DriveEstimator  # noqa: E402
from tests.motion import simulated_joint as rig  # noqa: E402
from tests.track import simulated_laws as truth  # noqa: E402

RUNS = 20
MOTIONS = 2
SECONDS = 40.0
TONES, SWEEP = ((5.37, 0.4), (9.13, 0.4), (13.77, 0.4), (19.33, 0.4)), (0.23, 1.2)
TRUE_HZ = 40_000.0
"""of friction; the others turn round softly"""
BUDGET_S = 5e-4
"""of a block of 100 ms: 200 times real time"""
RAMP = (40.0, 80.0, 0.01)
"""a Stribeck speed that grows between these instants by this share a second"""


@dataclass(frozen=True)
class Case:
    label: str
    joint: rig.Joint
    laws: truth.Laws
    effect: str
    quantity: str
    true: float


STIFF, SOFT = rig.Joint(), rig.Joint(stiffness=2e4, damping=5.0)
CASES = tuple(
    Case(f"{label}, {bits} bits", replace(joint, out_bits=bits), laws, effect, quantity, true)
    for bits in (20, 24)
    for label, joint, laws, effect, quantity, true in (
        ("Stribeck speed, 1e5", STIFF, truth.Laws(0.4, 0.4, 5e-3), "stribeck_friction", "stribeck_speed", 5e-3),
        ("Stribeck speed, 2e4", SOFT, truth.Laws(0.4, 0.4, 1e-2), "stribeck_friction", "stribeck_speed", 1e-2),
        ("hysteresis width", SOFT, truth.Laws(loop=0.6, knee=1e-4), "bouc_wen_hysteresis", "hysteresis_width", 1e-4),
        ("half of a gap", SOFT, truth.Laws(half_gap=4e-5), "backlash", "half_gap", 4e-5),
    )
)


def estimator_of(case: Case) -> DriveEstimator:
    """As at commissioning: the model file knows no value."""
    names = ("linear_stiffness", "viscous_damping", case.effect)
    model = Model("torsion", case.joint.ratio, case.joint.inertia, tuple(map(ModelEffect, names)))
    made = DriveEstimator(rig.drive_settings(case.joint, warm_up_s=2.0), model)
    if made._shape is not None:
        made._shape._rest_s = 0.0
    return made


def found(case: Case, gear: truth.Run, zeros: tuple[float, float]) -> Estimate:
    """The shape at the end of a recording."""
    estimator, rows = estimator_of(case), ()
    for block in rig.blocks(case.joint, gear.theta_in + zeros[0], gear.theta_out + zeros[1]):
        rows = estimator.update(block)
    return next(row for row in rows if row.name == case.quantity)


def truths(runs: int) -> list[Row]:
    """Error and its stated sd; each run has its own encoder zeros and so its own rounding errors."""
    rng, rows = np.random.default_rng(1), []
    gears: dict[tuple[float, truth.Laws, int], truth.Run] = {}
    for case in CASES:
        scores, errors, told = [], [], 0
        for i in range(runs):
            seed = i % MOTIONS
            key = case.joint.stiffness, case.laws, seed
            if key not in gears:
                fine_hz = TRUE_HZ if case.laws.level else 10_000.0
                gears[key] = truth.run(case.joint, rig.Path(TONES, SWEEP, seed, SECONDS), case.laws, fine_hz)
            row = found(case, gears[key], tuple(rng.uniform(0.0, 1.0, 2)))
            told += row.status is Status.VALID
            if row.status is Status.VALID:
                errors.append(row.value / case.true - 1)
                scores.append((row.value - case.true) / row.sd)
        rms = 100 * math.sqrt(np.mean(np.square(errors)))
        inside = 100 * float(np.mean(np.abs(scores) < 3))
        rows += [
            Row(f"{case.label}: rms error", rms, "%", 5.0, peer=f"{runs} runs of {SECONDS:g} s"),
            Row(f"{case.label}: rms error over sd", float(np.sqrt(np.mean(np.square(scores)))), "1", 1.3),
            Row(f"{case.label}: within 3 sd", inside, "%", 97.0, at_least=True, peer=f"valid in {told}"),
        ]
    return rows


def drift() -> list[Row]:
    """Seconds by which a growing Stribeck speed is followed late, and what is left of the lag after it."""
    begin, end, share = RAMP
    case = replace(CASES[0], joint=replace(STIFF, out_bits=22))

    def at(t: float) -> float:
        return case.true * math.exp(share * (min(max(t, begin), end) - begin))

    gear = truth.run(case.joint, rig.Path(TONES, SWEEP, 0, 120.0), case.laws, TRUE_HZ, at)
    estimator, behind, after = estimator_of(case), [], []
    for block in rig.blocks(case.joint, gear.theta_in, gear.theta_out, start_s=0.0):
        row = next(row for row in estimator.update(block) if row.name == case.quantity)
        if begin + 10 < row.time_s < end:
            behind.append(math.log(at(row.time_s) / row.value) / share)
        elif row.time_s > end + 20:
            after.append(row.value / at(row.time_s) - 1)
    return [
        Row("Stribeck speed growing by 1 %/s, without rests: lag", statistics.mean(behind), "s", 10.0),
        Row("and 20 s after it stopped: error", 100 * abs(statistics.mean(after)), "%", 3.0),
    ]


def cost() -> list[Row]:
    """A window of each law against a block's budget, spread over the rest that follows; and while it is learned."""
    rows = []
    for case in CASES[:1] + CASES[2:4]:
        gear = truth.run(case.joint, rig.Path(TONES, SWEEP, 0, SECONDS), case.laws)
        estimator = estimator_of(case)
        watch, spent = estimator._shape, []
        learn = watch._learn

        def timed(*given, learn=learn, spent=spent):
            began = time.process_time()
            learn(*given)
            spent.append(time.process_time() - began)

        watch._learn = timed
        for block in rig.blocks(case.joint, gear.theta_in, gear.theta_out):
            estimator.update(block)
        window_s = statistics.median(spent[shape.CHOICE :])
        label = case.label.split(",")[0]
        blocks = (shape.WINDOW_S + shape.REST_S) / 0.1
        rows += [
            Row(f"{label}: cost over a block's budget", 100 * window_s / blocks / BUDGET_S, "%", 10.0),
            Row(f"{label}: a window of 2 s", 1e3 * window_s, "ms", 60.0, peer=f"at first {1e3 * spent[0]:.0f} ms"),
        ]
    return rows


def rows(runs: int = RUNS) -> list[Row]:
    """All figures but the cost, which stands with that of the other estimates (`bench_estimate`)."""
    return [*drift(), *truths(runs)]


if __name__ == "__main__":
    print(table(HEAD, map(cells, rows(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS))))
