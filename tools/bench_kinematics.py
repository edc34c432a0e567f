"""The articles' differences and moving average beside what is used: stiffness from the same encoder readings."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

import article_route as route  # noqa: E402
from bench_row import Row  # noqa: E402

from edge_daemon.effects.model import ModelEffect  # noqa: E402
from edge_daemon.identify.fit import fit  # noqa: E402
from tests.motion import simulated_joint as rig  # noqa: E402

RUNS = 20
SECONDS = 20.0
WIDTH = 9
CYCLE_S = 1.0
TONES = ((5.0, 0.4), (9.0, 0.4), (14.0, 0.4), (19.0, 0.4))
"""whole numbers of hertz: the motion repeats every second"""
SWEEP = (1.0, 1.2)
CASES = (
    ("no kinematic error, 24 bits", rig.Joint(out_bits=24, kinematic_pp=0.0)),
    ("no kinematic error, 20 bits", rig.Joint(out_bits=20, kinematic_pp=0.0)),
    ("1 arc-min, 20 bits", rig.Joint(out_bits=20)),
)


class Recorded:
    """A recording in memory."""

    def __init__(self, theta_in: np.ndarray, theta_out: np.ndarray) -> None:
        self.time_s = np.arange(len(theta_in)) / rig.RATE_HZ
        self.columns = {"theta_in_rad": theta_in, "theta_out_rad": theta_out}


def used(joint: rig.Joint, theta_in: np.ndarray, theta_out: np.ndarray) -> float:
    """What `fit` says, kinematic error in the model."""
    model = rig.model_of(joint)
    model = replace(model, effects=(*model.effects, ModelEffect("kinematic_error")))
    found = fit([Recorded(theta_in, theta_out)], model)
    return found.solution.amplitude("linear_stiffness", "stiffness")


def articles(joint: rig.Joint, theta_in: np.ndarray, theta_out: np.ndarray) -> float:
    """Their route, all samples."""
    seen = route.kinematics(theta_in, theta_out, joint.ratio, rig.RATE_HZ, WIDTH)
    return route.stiffness(seen, joint.inertia).stiffness_Nm_per_rad


def cycles(joint: rig.Joint, theta_in: np.ndarray, theta_out: np.ndarray) -> float:
    """Their route on the mean of the repeated motion."""
    seen = route.kinematics(theta_in, theta_out, joint.ratio, rig.RATE_HZ, WIDTH)
    return route.stiffness_of_cycles(seen, joint.inertia, round(CYCLE_S * rig.RATE_HZ)).stiffness_Nm_per_rad


ROUTES: tuple[tuple[str, Callable[..., float]], ...] = (
    ("articles' route", articles),
    ("articles' route on mean cycles", cycles),
    ("used: one filter on both sides", used),
)


def rows() -> list[Row]:
    """RMS error of the stiffness in per cent of it, per case and route."""
    out = []
    for label, joint in CASES:
        errors: dict[str, list[float]] = {name: [] for name, _ in ROUTES}
        for seed in range(RUNS):
            theta_in, theta_out = rig.linear(joint, rig.Path(TONES, SWEEP, seed, SECONDS))
            zero = np.random.default_rng(seed).uniform(0.0, 1.0)
            seen_in = rig.quantised(theta_in + joint.ratio * zero, joint.in_bits)
            seen_out = rig.quantised(theta_out + zero, joint.out_bits)
            for name, measure in ROUTES:
                errors[name].append(measure(joint, seen_in, seen_out) / joint.stiffness - 1)
        rms = {name: 100 * math.sqrt(float(np.mean(np.square(found)))) for name, found in errors.items()}
        reference = rms[ROUTES[0][0]]
        for name, value in rms.items():
            limit = 0.1 * reference if name == ROUTES[2][0] else math.nan
            out.append(
                Row(f"{label}: {name}", value, "% of K", limit, peer=f"bias {100 * np.mean(errors[name]):+.2f} %")
            )
    return out
