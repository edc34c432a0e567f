"""Cramer-Rao bounds of a simulated joint, from nothing but the simulation and the encoders' steps.

theta_out is the joint's answer to the measured theta_in plus white noise of both encoders; the derivative of the
answer to each parameter is a difference of two simulations. sd = root of the diagonal of the inverse Fisher matrix
sum_t d(t) d(t)' / sigma^2, with the encoders' zero and the orders 1, 2, 4 of kinematic error unknown as well, and on
request the twist rate within which friction turns round: an estimate that frees that width is held against a bound
that does so too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.estimate import simulated_joint as rig

STEP = 0.01
"""relative, of each difference to either side"""
WAVE_RAD = 1e-6
ORDERS = (1, 2, 4)
Simulate = Callable[[rig.Joint, rig.Path], tuple[np.ndarray, np.ndarray]]


def noise_rad(joint: rig.Joint) -> float:
    """sd of the encoders' rounding as it stands in the twist; below a tenth of the resonance both count alike."""
    steps = (2 * math.pi / 2**joint.in_bits / joint.ratio, 2 * math.pi / 2**joint.out_bits)
    return math.hypot(*steps) / math.sqrt(12)


def derivatives(joint: rig.Joint, path: rig.Path, simulate: Simulate, width: bool = False) -> dict[str, np.ndarray]:
    """Name -> (n,) change of theta_out per unit of each parameter."""

    def answer(other: rig.Joint) -> np.ndarray:
        return simulate(other, path)[1]

    def slope(name: str) -> np.ndarray:
        step = STEP * getattr(joint, name)
        up, down = (replace(joint, **{name: getattr(joint, name) + sign * step}) for sign in (1, -1))
        return (answer(up) - answer(down)) / (2 * step)

    dry = ("coulomb", "reversal") if width else ("coulomb",)
    names = ("stiffness", "damping", *(dry if joint.coulomb else ()))
    rows = {name: slope(name) for name in names}
    for order in ORDERS:
        for word, pair in (("sine", (WAVE_RAD, 0.0)), ("cosine", (0.0, WAVE_RAD))):
            up, down = (replace(joint, waves=((order, sign * pair[0], sign * pair[1]),)) for sign in (1, -1))
            rows[f"{word}_{order}"] = (answer(up) - answer(down)) / (2 * WAVE_RAD)
    rows["zero"] = np.ones_like(rows["stiffness"])
    rows["ratio"] = -rig.linear(replace(joint, kinematic_pp=0.0), path)[1] / joint.ratio
    return rows


def bounds(joint: rig.Joint, path: rig.Path, simulate: Simulate = rig.linear, width: bool = False) -> dict[str, float]:
    """Least sd of an unbiased estimate: stiffness, damping, coulomb, ratio, and peak to peak of the kinematic error;
    with `width`, the friction's is unknown and bounded as well, as `reversal`."""
    rows = derivatives(joint, path, simulate, width)
    columns = np.column_stack(list(rows.values()))
    scale = np.linalg.norm(columns, axis=0)
    fisher = (columns / scale).T @ (columns / scale) / noise_rad(joint) ** 2
    covariance = np.linalg.inv(fisher) / np.outer(scale, scale)
    names = list(rows)
    sd = dict(zip(names, np.sqrt(np.diag(covariance)), strict=True))
    at = np.linspace(0.0, 2 * math.pi, 2001)
    course = rig.kinematic(joint, at)
    top, bottom = (at[pick(course)] for pick in (np.argmax, np.argmin))
    spread = np.zeros(len(names))
    for i, name in enumerate(names):
        if name.startswith(("sine", "cosine")):
            wave, order = (np.sin if name[0] == "s" else np.cos), int(name[-1])
            spread[i] = wave(order * top) - wave(order * bottom)
    sd["kinematic_error"] = float(np.sqrt(spread @ covariance @ spread))
    wanted = ("stiffness", "damping", "coulomb", "reversal", "ratio", "kinematic_error")
    return {name: float(sd[name]) for name in wanted if name in sd}
