"""The articles' own way from angles to stiffness, kept as the reference that ours is measured against.

Central differences of the angles, a moving average over the acceleration, torque as inertia times acceleration, and
ordinary least squares; or the mean of repeated cycles first ("averaging multiple measurements", first article). Its
weak points, all measured in tools/bench_kinematics.py: the average weakens the acceleration but not the twist, noise of
the twist stands in the regressor, and the kinematic error is not in the model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.records import Array, Mask

LEAST_CYCLES = 3


class ArticleRouteError(BadInput):
    """One line: what is wrong, what was expected."""


@dataclass(frozen=True, slots=True)
class ArticleMotion:
    """(m,) each: what differences and moving averages leave of two angles, ends cut off."""

    twist_rad: Array
    twist_rate_rad_s: Array
    acceleration_out_rad_s2: Array


@dataclass(frozen=True, slots=True)
class Stiffness:
    """Least squares of torque on twist and twist rate."""

    stiffness_Nm_per_rad: float
    damping_Nms_per_rad: float
    sd_Nm_per_rad: float
    """of the stiffness; from the scatter over cycles where there are any, else as if residuals were white"""


def central_difference(values: Array, rate_hz: float) -> Array:
    """(n - 2,) rate of change [1/s] of (n,) samples, at the inner ones."""
    return np.asarray((values[2:] - values[:-2]) * (rate_hz / 2))


def moving_average(values: Array, width: int) -> Array:
    """(n - width + 1,) mean over `width` samples, an odd number: centred."""
    if width < 1 or width % 2 == 0:
        raise ArticleRouteError(f"moving average over {width} samples: expected an odd number, or it shifts in time")
    total = np.concatenate(([0.0], np.cumsum(values)))
    return np.asarray((total[width:] - total[:-width]) / width)


def kinematics(theta_in_rad: Array, theta_out_rad: Array, ratio: float, rate_hz: float, width: int) -> ArticleMotion:
    """Twist, its rate and the output acceleration of two angles (n,); only the acceleration is averaged.

    Raises `ArticleRouteError` for fewer samples than the differences and the average take.
    """
    if len(theta_out_rad) < width + 6:
        raise ArticleRouteError(f"{len(theta_out_rad)} samples: expected at least {width + 6}")
    twist = theta_in_rad / ratio - theta_out_rad
    rate = central_difference(twist, rate_hz)[1:-1]
    acceleration = central_difference(central_difference(theta_out_rad, rate_hz), rate_hz)
    half = width // 2
    inner = slice(half, len(acceleration) - half)
    return ArticleMotion(twist[2:-2][inner], rate[inner], moving_average(acceleration, width))


def stiffness(seen: ArticleMotion, inertia_kg_m2: float) -> Stiffness:
    """Ordinary least squares, one row per sample."""
    design = np.column_stack((seen.twist_rad, seen.twist_rate_rad_s))
    torque = inertia_kg_m2 * seen.acceleration_out_rad_s2
    products = design.T @ design
    solved = np.linalg.solve(products, design.T @ torque)
    residual = torque - design @ solved
    covariance = np.linalg.inv(products) * float(residual @ residual) / (len(torque) - 2)
    return Stiffness(float(solved[0]), float(solved[1]), math.sqrt(covariance[0, 0]))


def stiffness_of_cycles(seen: ArticleMotion, inertia_kg_m2: float, samples: int) -> Stiffness:
    """The same on the mean of repeated cycles of `samples` each: noise in the regressor falls with their number.

    The standard deviation is a jackknife over cycles (Efron & Stein 1981). A cycle repeats only if the motor comes
    back to the same angle. Raises `ArticleRouteError` for fewer than three whole cycles.
    """
    cycles = len(seen.twist_rad) // samples
    if cycles < LEAST_CYCLES:
        raise ArticleRouteError(f"{cycles} whole cycles of {samples} samples: expected at least {LEAST_CYCLES}")
    rows = [_folded(column, cycles, samples) for column in (seen.twist_rad, seen.twist_rate_rad_s)]
    torque = inertia_kg_m2 * _folded(seen.acceleration_out_rad_s2, cycles, samples)

    def solve(kept: Mask) -> Array:
        design = np.column_stack([row[kept].mean(axis=0) for row in rows])
        return np.asarray(np.linalg.lstsq(design, torque[kept].mean(axis=0), rcond=None)[0])

    whole = solve(np.ones(cycles, dtype=bool))
    without = np.array([solve(np.arange(cycles) != i)[0] for i in range(cycles)])
    sd = math.sqrt((cycles - 1) / cycles * float(np.sum((without - without.mean()) ** 2)))
    return Stiffness(float(whole[0]), float(whole[1]), sd)


def _folded(column: Array, cycles: int, samples: int) -> Array:
    """(cycles, samples)."""
    return np.asarray(column[: cycles * samples].reshape(cycles, samples))
