"""Standard deviations of what was fitted, and a word on each number that a recording does not determine.

Those of a sandwich over blocks of more than a second (Liang & Zeger 1986): residuals may be correlated and of any
spectrum within a block. What a model leaves above the noise floor is the error of a law, the same in every block: it
widens them further.
"""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.balance.torsion_floor import noise_products
from edge_daemon.effects.effect import Parameter
from edge_daemon.effects.torque_source import MOTOR_SIDE
from edge_daemon.identify.load_fit import with_friction_of_load
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import DAMPING, SPRING_AND_DAMPER, STIFFNESS, Solution, Term
from edge_daemon.motion.residual_statistics import LOOKS
from edge_daemon.records import Array
from edge_daemon.text import number

TIED_SHARE = 1e-12
"""Columns count as tied where a change of their numbers takes less than this share of the torque's square: rounding."""
IDENTIFIED_SD = 1 / 3
"""A parameter counts as identified below this relative sd: three sigma from zero."""
SURE_SD = 2.0
"""So many standard deviations around a value hold the truth 19 times in 20."""
COLLINEAR = 30.0
"""Above this variance inflation another motion, not more signal, is what a parameter needs."""
EXACT_FLOORS = 1.1
"""A model counts as exact up to this error over the noise floor."""
INEXACT_FLOORS = 0.3
"""A simulated law's steps and smoothing leave this error over the noise floor."""
SHAPE_STEP = 0.02
"""A shape's column is found by a finite difference of this relative step."""
LEAST_TOLD, UNTOLD = 0.3, 0.01
"""Share of what columns say along a direction that must not be noise for them to tell it, and what is then left of it:
a hundred times the deviation (guesses)."""


def numbers(solution: Solution) -> list[tuple[Term, Parameter, float]]:
    """Every fitted number: amplitudes and free shapes, effect by effect."""
    out = []
    for term in solution.terms:
        for row, value in zip(term.effect.amplitudes, solution.amplitudes[term.effect.name], strict=True):
            out.append((term, row, float(value)))
        for row in term.effect.free_shapes:
            out.append((term, row, float(term.shapes.get(row.name, row.start))))
    return out


def excess_power(solution: Solution, floor: float) -> float:
    """Held-out mean square that sensor noise does not explain: of a law that is not quite the gear's. A simulated law
    is never quite exact, even where its error is hidden in the noise."""
    hidden = INEXACT_FLOORS * floor if solution.simulated is not None else 0.0
    return max(solution.rmse**2 - (EXACT_FLOORS * floor) ** 2, hidden**2)


def deviations(solution: Solution, problem: RegressionProblem, excess: float = 0.0) -> tuple[Array, Array]:
    """(q,) standard deviation and variance inflation of each of `numbers`.

    A wrong law errs the same way in every block, which scatter between blocks cannot show: its `excess` mean square
    counts as if only a few looks at it were independent, and is shared by collinear parameters as noise would be.
    """
    covariance, inflation = spread(solution, problem, excess)
    return np.sqrt(np.maximum(np.diagonal(covariance), 0.0)), inflation


def spread(solution: Solution, problem: RegressionProblem, excess: float) -> tuple[Array, Array]:
    """(q, q) covariance and (q,) variance inflation of `numbers`, by a sandwich over blocks, widened as `deviations`
    says; nan where the torque does not depend on a number at all (the width of an element without force), or only on a
    sum of it with others (a damper beside a damper)."""
    design = _design(solution, problem)
    residual = problem.target - solution.modelled
    unseen = ~design.any(axis=0)
    scale = np.sqrt(np.mean(design**2, axis=0)) + unseen
    x = design / scale
    values, vectors = np.linalg.eigh(x.T @ x)
    heard = _of_noise(solution, problem) / np.outer(scale, scale)
    told = values - len(x) * np.einsum("ik,ij,jk->k", vectors, heard, vectors)
    values = np.where(told < LEAST_TOLD * values, UNTOLD * values, values)
    nothing = values <= TIED_SHARE * values[-1]
    tied = np.square(vectors[:, nothing]).sum(axis=1) > math.sqrt(TIED_SHARE)
    inverse = (vectors[:, ~nothing] / values[~nothing]) @ vectors[:, ~nothing].T
    starts = np.concatenate(([0], np.flatnonzero(np.diff(problem.block)) + 1))
    scores = np.add.reduceat(x * residual[:, None], starts, axis=0)
    blocks, width = len(starts), x.shape[1]
    factor = blocks / max(blocks - width, 1)
    covariance = inverse @ (scores.T @ scores) @ inverse * factor + excess / LOOKS * len(x) * inverse
    inflation = np.where(tied & ~unseen, np.inf, np.diagonal(inverse) * len(x))
    covariance[unseen | tied, unseen | tied] = np.nan
    return covariance / np.outer(scale, scale), inflation


def _of_noise(solution: Solution, problem: RegressionProblem) -> Array:
    """(q, q) mean products of the encoders' noise in the columns of spring and rotor. An arm's weight, inertia and
    rotor, and an eccentric encoder, are told apart by that alone where nothing else is: a rotor of no inertia leaves
    less, for it does not hear the acceleration's."""
    rows = [(term.effect.name, parameter.name) for term, parameter, _ in numbers(solution)]
    out, wanted = np.zeros((len(rows), len(rows))), (STIFFNESS, DAMPING, (MOTOR_SIDE.name, "inertia"))
    at = [rows.index(row) if row in rows else -1 for row in wanted]
    for trial in problem.trials if at[2] >= 0 else ():
        products = noise_products(trial) * (len(trial.rows) / len(problem.target))
        known = [k for k in range(3) if at[k] >= 0]
        out[np.ix_([at[k] for k in known], [at[k] for k in known])] += products[np.ix_(known, known)]
    return out


def _design(solution: Solution, problem: RegressionProblem) -> Array:
    """(m, q) derivative of the modelled torque by each of `numbers`."""
    if solution.design is not None:
        stretch = np.array([_stretch(term, row, value) for term, row, value in numbers(solution)])
        return np.asarray(solution.design * stretch)
    parts, i, columns = [], 0, with_friction_of_load(problem, solution)
    corrected = any(term.effect.is_angle_error for term in solution.terms)
    for term in solution.terms:
        width = len(term.effect.amplitudes)
        own = columns[:, i : i + width]
        # errors of the angles are tied to the spring and damper, which act on the twist that is put right
        parts.append(problem.felt(term.effect) if corrected and term.effect.name in SPRING_AND_DAMPER else own)
        i += width
        a = solution.amplitudes[term.effect.name]
        for row in term.effect.free_shapes:
            value = term.shapes.get(row.name, row.start)
            step = SHAPE_STEP * (abs(value) or 1.0)
            up, down = ({**term.shapes, row.name: value + sign * step} for sign in (1, -1))
            change = problem.columns(term.effect, up) - problem.columns(term.effect, down)
            parts.append((change @ a / (2 * step))[:, None])
    return np.hstack(parts)


def _stretch(term: Term, row: Parameter, value: float) -> float:
    """Change of a coordinate of the search by its number: of a logarithm where a shape is searched for by it."""
    return 1 / value if row in term.effect.free_shapes and row.lower > 0 else 1.0


def advised(value: float, sd: float, inflation: float) -> str:
    """What would identify a parameter."""
    if not math.isfinite(sd) or sd == 0.0:
        return "this recording does not excite it: another motion is needed"
    if inflation > COLLINEAR:
        return f"it moves together with other parameters (inflation {inflation:.0f}): another motion is needed"
    if value == 0.0:
        return "at its bound: nothing of it is seen; more torque would show less of it"
    seen, told = abs(value), ""
    if seen < SURE_SD * sd:
        seen = (seen + SURE_SD * sd) / 2
        told = f"zero would do as well; it is below {2 * seen:.2g}, and to tell half of that "
    times = sd / (IDENTIFIED_SD * seen)
    torque, length = number(times, 2), number(times**2, 2)
    return f"{told}{torque} times more torque, a finer encoder, or {length} times the recording is needed"
