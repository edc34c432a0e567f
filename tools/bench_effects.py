"""Every effect alone: simulated, added to a plain model, its parameters held against what the simulated drive knows.

    python tools/bench_effects.py [SEEDS] [--effect NAME ...] [--seconds S] [--diagnose] [--rig]

One line per effect: how many of its numbers are within 3 sd of the truth, the worst of them, and what a second
diagnosis says with the effect in the model. The drive shares no code with the catalogue, so a number that is off means
that one of the two has the physics wrong. `--rig` prints instead how far each number moves when the drive is stepped
sixteen times as finely: what the drive's own steps err by.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from bench_row import Row

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.gear.steps import OUTPUT_WIDTH_RAD_S, REVERSAL_WIDTH_RAD_S
from edge_daemon.rig import torsion_truth
from edge_daemon.rig.recording import simulate

SECONDS = 20.0
WITHIN_SD = 3.0
"""Distance from the truth [sd] that one of a few hundred numbers may have by chance."""

Numbers = Mapping[str, float]


def wave(size: str, phase: str, *, order: int) -> Callable[[Numbers], Numbers]:
    """Sine and cosine of `size sin(m x + phase)`."""
    return lambda p: {
        f"sine_{order}": p[size] * math.cos(p[phase]),
        f"cosine_{order}": p[size] * math.sin(p[phase]),
    }


def _kinematic(p: Numbers) -> Numbers:
    return {k: v for m in (1, 2, 4) for k, v in wave(f"order{m}_rad", f"phase{m}_rad", order=m)(p).items()}


def _piecewise(p: Numbers) -> Numbers:
    return {
        "rise_1": p["stiffness"] * (p["k2_over_k1"] - 1.0),
        "rise_2": p["stiffness"] * (p["k3_over_k1"] - p["k2_over_k1"]),
        "corner_1": p["corner1_rad"],
        "corner_gap": p["corner2_rad"] - p["corner1_rad"],
    }


def _lugre(p: Numbers) -> Numbers:
    return {
        "friction": p["level_Nm"],
        "bristle_damping": p["bristle_Nms_per_rad"],
        "presliding": p["level_Nm"] / p["bristle_Nm_per_rad"],
        "static_ratio": p["static_Nm"] / p["level_Nm"],
        "stribeck_speed": p["stribeck_rad_s"],
    }


def _mesh(p: Numbers) -> Numbers:
    size = p["stiffness"] * p["relative"]
    return {"sine_2": size * math.cos(p["phase_rad"]), "cosine_2": size * math.sin(p["phase_rad"])}


def _gravity(p: Numbers) -> Numbers:
    return {"sine": p["size_Nm"] * math.cos(p["phase_rad"]), "cosine": p["size_Nm"] * math.sin(p["phase_rad"])}


TRUTHS: Mapping[str, Callable[[Numbers], Numbers]] = {
    "polynomial_stiffness": lambda p: {"k1": p["k1_Nm_per_rad2"], "k2": p["k2_Nm_per_rad3"]},
    "piecewise_stiffness": _piecewise,
    "coulomb_friction": lambda p: {"friction": p["level_Nm"], "smoothing": REVERSAL_WIDTH_RAD_S},
    "stribeck_friction": lambda p: {
        "friction": p["level_Nm"],
        "excess": p["static_Nm"] - p["level_Nm"],
        "stribeck_speed": p["stribeck_rad_s"],
        "smoothing": REVERSAL_WIDTH_RAD_S,
    },
    "lugre_friction": _lugre,
    "dahl_friction": lambda p: {"friction": p["level_Nm"], "presliding": p["level_Nm"] / p["rest_Nm_per_rad"]},
    "load_dependent_friction": lambda p: {"coefficient": p["mu"], "smoothing": REVERSAL_WIDTH_RAD_S},
    "bouc_wen_hysteresis": lambda p: {
        "torque": p["level_Nm"],
        "width": p["knee_rad"],
        "rounding": p["beta"],
        "exponent": 1.0,
    },
    "maxwell_slip_hysteresis": lambda p: {},
    "asymmetric_hysteresis": lambda p: {},
    "backlash": lambda p: {"fraction": 1.0, "half_gap": 0.5 * p["gap_rad"]},
    "kinematic_error": _kinematic,
    "mesh_stiffness": _mesh,
    "gravity_load": _gravity,
    "constant_load": lambda p: {"load": p["load_Nm"]},
    "output_viscous_friction": lambda p: {"coefficient": p["Nms_per_rad"]},
    "output_coulomb_friction": lambda p: {"friction": p["level_Nm"], "smoothing": OUTPUT_WIDTH_RAD_S},
    "encoder_eccentricity": lambda p: {"sine_1": p["sine_rad"], "cosine_1": p["cosine_rad"]},
    "encoder_skew": lambda p: {"delay": p["delay_s"]},
    "temperature_stiffness": lambda p: {"slope": p["stiffness"] * p["relative_per_K"]},
    "temperature_friction": lambda p: {"slope": p["Nms_per_rad_K"]},
}
"""What each effect's parameters are, from what the simulated drive drew. The drive's hysteresis of slipping springs has
four elements and the catalogue's six, so that only the spring and the damper beside it can be held against the truth;
torque ripple and a wrong inertia are told by a torque sensor, which this drive has not."""


@dataclass(frozen=True, slots=True)
class Number:
    """One parameter held against the truth."""

    name: str
    value: float
    sd: float
    truth: float
    identified: bool

    @property
    def off(self) -> float:
        """Distance from the truth [sd]; NaN where the fit does not claim to know it."""
        return (self.value - self.truth) / self.sd if self.identified else math.nan


@dataclass(frozen=True, slots=True)
class Alone:
    """One effect, one seed."""

    effect: str
    seed: int
    numbers: tuple[Number, ...]
    nrmse: float
    verdict: str
    seconds: float


def alone(effect: str, seed: int, seconds: float = SECONDS, diagnosed: bool = False) -> Alone:
    """One effect simulated and added."""
    made = simulate((effect,), seconds, seed=7919 * seed + 29)
    drawn: Mapping[str, float] = made.truth["parameters"]  # type: ignore[assignment]
    base = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
    began = time.perf_counter()
    model = Model("torsion", drawn["ratio"], drawn["inertia_kg_m2"], base)
    change = add_effect(model, effect, [made])
    verdict = diagnose([made], change.model).verdict if diagnosed else ""
    own = {name.partition(".")[2]: value for name, value in drawn.items() if name.startswith(f"{effect}.")}
    own |= {"stiffness": drawn["stiffness_Nm_per_rad"]}
    truth = {(effect, name): value for name, value in TRUTHS[effect](own).items()}
    truth[BASE[0]], truth[BASE[1]] = drawn["stiffness_Nm_per_rad"], drawn["damping_Nms_per_rad"]
    numbers = tuple(_number(change.model, *key, value) for key, value in truth.items())
    return Alone(effect, seed, numbers, change.after.nrmse, verdict, time.perf_counter() - began)


BASE = (("linear_stiffness", "stiffness"), ("viscous_damping", "damping"))


def _number(model: Model, effect: str, name: str, truth: float) -> Number:
    row = next(row for row in model.effects if row.name == effect).parameters[name]
    return Number(f"{effect}.{name}" if effect in ("linear_stiffness", "viscous_damping") else name,
                  row.value, row.sd, truth, row.identified)  # fmt: skip


FINER = 16
MOST_STEP_SD = 0.3
"""The drive's steps may move a fitted number by so many of its deviations (aim)."""


def of_the_steps(effect: str, seed: int, seconds: float) -> tuple[float, str]:
    """The most that a number moves [sd] when the drive takes finer steps, and which."""
    usual = alone(effect, seed, seconds)
    step_s = torsion_truth.SUBSTEP_S
    torsion_truth.SUBSTEP_S = step_s / FINER
    try:
        finer = alone(effect, seed, seconds)
    finally:
        torsion_truth.SUBSTEP_S = step_s
    pairs = zip(usual.numbers, finer.numbers, strict=True)
    return max(((abs(a.value - b.value) / b.sd, a.name) for a, b in pairs if b.identified), default=(0.0, "none"))


def every(effects: Sequence[str], seeds: int, seconds: float, diagnosed: bool) -> Iterator[Alone]:
    """Each effect, `seeds` times."""
    for effect in effects or TRUTHS:
        for seed in range(seeds):
            yield alone(effect, seed, seconds, diagnosed)


def summary(effect: str, done: Sequence[Alone]) -> str:
    """One line of the table, and one for each number that is off more often than by chance."""
    numbers = [number for row in done for number in row.numbers if number.identified]
    off = [number for number in numbers if not abs(number.off) <= WITHIN_SD]
    worst = max(numbers, key=lambda number: abs(number.off), default=None)
    said = f"  worst {worst.name} {worst.off:+.1f} sd" if worst else ""
    verdicts = ", ".join(f"{row.verdict}" for row in done if row.verdict not in ("", "adequate"))
    unknown = sorted({n.name for row in done for n in row.numbers if not n.identified})
    line = f"{effect:26} {len(numbers) - len(off)}/{len(numbers)} within 3 sd{said}"
    line += f"  not identified: {', '.join(unknown)}" if unknown else ""
    line += f"  then: {verdicts}" if verdicts else ""
    return f"{line}  {np.median([row.seconds for row in done]):.1f} s"


def rows() -> list[Row]:
    """Every effect over three seeds."""
    done = list(every((), 3, SECONDS, False))
    numbers = [number for row in done for number in row.numbers if number.identified]
    share = sum(abs(number.off) <= WITHIN_SD for number in numbers) / len(numbers)
    worst = max(((row, n) for row in done for n in row.numbers if n.identified), key=lambda pair: abs(pair[1].off))
    said = f"worst {worst[0].effect} {worst[1].name} {worst[1].off:+.1f} sd"
    return [Row("an effect alone, numbers within 3 sd", share, "1", 0.98, True, said)]


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", type=int, nargs="?", default=20)
    parser.add_argument("--effect", nargs="+", default=[])
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--diagnose", action="store_true", help="say what a diagnosis finds beside the effect")
    parser.add_argument("--every", action="store_true", help="print every number")
    parser.add_argument("--rig", action="store_true", help="what the simulated drive's own steps err by")
    given = parser.parse_args()
    for effect in (given.effect or TRUTHS) if given.rig else ():
        most, name = max(of_the_steps(effect, seed, given.seconds) for seed in range(given.seeds))
        print(
            f"{effect:26} {name} moves by {most:.3f} sd (aim {MOST_STEP_SD:g}){' MISSED' * (most > MOST_STEP_SD)}",
            flush=True,
        )
    for effect in () if given.rig else given.effect or TRUTHS:
        done = list(every([effect], given.seeds, given.seconds, given.diagnose))
        print(summary(effect, done), flush=True)
        for row in done if given.every else ():
            for n in row.numbers:
                print(f"    {row.seed} {n.name:26} {n.value:12.6g} {n.sd:9.2g} {n.truth:12.6g} {n.off:+7.2f}")


if __name__ == "__main__":
    main()
