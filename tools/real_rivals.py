"""What other methods leave of the real machines: BAM's ladder M1 to M6 written out, PySINDy, gradient boosting.

All on the same samples, behind the same filter and held out by the same folds as `compare`, so that the errors of
`bench_real` stand beside them. Run `python tools/real_rivals.py [PART OF A NAME ...]`.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable, Iterator

import numpy as np
from bench_real import MACHINES, Machine
from pysindy import STLSQ
from sklearn.ensemble import HistGradientBoostingRegressor

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.problem import problem_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.records import Array, Motion
from edge_daemon.text import table

SPEEDS, EXPONENTS = (0.05, 0.15, 0.4, 1.2, 2.5), (1.0, 2.0, 3.0)
"""Of the ladder's Stribeck curve, shares of the rms speed and powers."""
SPARSITY = (0.0, 0.003, 0.01, 0.03)
Fit = Callable[[Array, Array], Callable[[Array], Array]]


def carried(motion: Motion) -> list[Array]:
    """What inertia, weight and the controller's own model are made of."""
    known = [motion.extra[name] for name in ("torque_model_Nm",) if name in motion.extra]
    angle = motion.theta_out_rad
    return [motion.acceleration_out_rad_s2, np.ones(len(motion)), np.sin(angle), np.cos(angle), *known]


def ladder(motion: Motion, level: int, external: Array, motor: Array, curve: Array) -> list[Array]:
    """Columns of friction of BAM's models (Duclusaud & Passault 2024), M1 to M6, beside torques of load and motor."""
    speed = motion.velocity_out_rad_s
    sign, gap = np.sign(speed), np.abs(motor - external)
    drives = np.abs(motor) > np.abs(external)
    rows = [[sign, speed], [sign * curve], [sign * gap], [sign * gap * curve]]
    rows.append([sign * np.abs(motor), sign * np.abs(external), sign * curve * np.abs(external)])
    rows.append([sign * curve * external**2 * drives, sign * curve * motor**2 * ~drives])
    chosen = {1: (0,), 2: (0, 1), 3: (0, 2), 4: (0, 1, 2, 3), 5: (0, 1, 4), 6: (0, 1, 4, 5)}[level]
    return [column for i in chosen for column in rows[i]]


def held_out(problem: RegressionProblem, columns: Array, fit: Fit) -> float:
    """Error over the rms of the torque, each fold by a fit to the others."""
    left, fold = np.empty(len(problem.target)), problem.fold[problem.block]
    for f in np.unique(fold):
        left[fold == f] = problem.target[fold == f] - fit(columns[fold != f], problem.target[fold != f])(
            columns[fold == f]
        )
    return math.sqrt(float(np.mean(left**2))) / problem.rms


def least_squares(x: Array, y: Array) -> Callable[[Array], Array]:
    """As it says."""
    found = np.linalg.lstsq(x, y, rcond=1e-9)[0]
    return lambda new: np.asarray(new @ found)


def sparse(threshold: float) -> Fit:
    """PySINDy's sequentially thresholded least squares over columns of one size."""

    def fit(x: Array, y: Array) -> Callable[[Array], Array]:
        size, scale = np.sqrt(np.mean(x**2, axis=0)) + 1e-300, float(y.std())
        found = STLSQ(threshold=threshold, alpha=1e-6).fit(x / size, y[:, None] / scale).coef_.ravel()
        return lambda new: np.asarray(new / size @ found * scale)

    return fit


def boosted(x: Array, y: Array) -> Callable[[Array], Array]:
    """Gradient boosting of trees."""
    return lambda new: np.asarray(HistGradientBoostingRegressor(random_state=0).fit(x, y).predict(new))


def projected(problem: RegressionProblem, of: Callable[[Motion], list[Array]]) -> Array:
    """(m, k) of columns behind the filter."""
    return np.vstack([trial.project(np.column_stack(of(trial.motion))) for trial in problem.trials])


def rungs(problem: RegressionProblem) -> Iterator[float]:
    """The error of M1 to M6. The torques of load and motor are those of a first fit: beside the measured one friction
    of their difference would be given what it is to explain."""

    def plain(motion: Motion) -> list[Array]:
        return [*carried(motion), *ladder(motion, 1, *(motion.torque_Nm,) * 3)]

    x = projected(problem, plain)
    first = np.linalg.lstsq(x, problem.target, rcond=1e-9)[0]
    rms = math.sqrt(float(np.mean(np.concatenate([m.velocity_out_rad_s for m in problem.motions]) ** 2)))
    for level in range(1, 7):
        shapes = itertools.product(SPEEDS, EXPONENTS) if level not in (1, 3) else [(1.0, 1.0)]

        def columns(motion: Motion, speed: float, power: float, level: int = level) -> list[Array]:
            base = carried(motion)
            external = np.column_stack(base[2:]) @ first[2 : len(base)]
            curve = np.exp(-(np.abs(motion.velocity_out_rad_s / (speed * rms)) ** power))
            return [*base, *ladder(motion, level, external, np.column_stack(plain(motion)) @ first, curve)]

        yield min(
            held_out(problem, projected(problem, lambda m, s=s, p=p: columns(m, s, p)), least_squares)  # type: ignore[misc]
            for s, p in shapes
        )


def library(motion: Motion) -> list[Array]:
    """What PySINDy chooses from."""
    speed, sign, angle = motion.velocity_out_rad_s, np.sign(motion.velocity_out_rad_s), motion.theta_in_rad
    known = motion.extra.get("torque_model_Nm", motion.acceleration_out_rad_s2)
    waves = [wave(m * angle) for m in (1, 2, 4, 7, 8, 12) for wave in (np.sin, np.cos)]
    friction = [speed, sign, sign * np.sqrt(np.abs(speed)), sign * np.abs(speed) ** (2 / 3), speed * np.abs(speed)]
    return [*carried(motion), *friction, sign * np.abs(known), *waves]


def features(motion: Motion) -> list[Array]:
    """What trees are grown over: the same quantities, not projected."""
    turns = [wave(motion.theta_in_rad) for wave in (np.sin, np.cos)]
    return [*carried(motion), motion.velocity_out_rad_s, motion.theta_out_rad, *turns]


def row(machine: Machine) -> tuple[str, ...]:
    """One line of the table."""
    problem = problem_of(machine.read(), Model("drive", machine.ratio, math.nan, (ModelEffect("inertia"),)))
    many = projected(problem, library)
    trees = np.vstack([np.column_stack(features(trial.motion))[trial.rows] for trial in problem.trials])
    sindy = min(held_out(problem, many, sparse(threshold)) for threshold in SPARSITY)
    errors = [*rungs(problem), sindy, held_out(problem, trees, boosted)]
    return (machine.name, *(f"{error:.4f}" for error in errors))


def main() -> None:
    """The table, errors over the rms of the torque; `bench_real` gives ours, in ampere where it says so."""
    wanted = [
        m for m in MACHINES if "inertia" in m.start and (not sys.argv[1:] or any(p in m.name for p in sys.argv[1:]))
    ]
    head = ("recording", *(f"M{level}" for level in range(1, 7)), "PySINDy", "boosting")
    print(table(head, [row(machine) for machine in wanted]))


if __name__ == "__main__":
    main()
