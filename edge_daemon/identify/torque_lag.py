"""A torque sensor that answers late, by its amplifier or its converter: taken out beside a model, as the encoders'
zeros are.

A filter of first order reads r where T dr/dt + r = tau, so that what it reads lacks T dr/dt; one of second order, or a
delay of T, lacks B d2r/dt2 besides, with B the product of two time constants or half of T squared. Beside a spring
alone the lag is damping that gives power instead of taking it, and is seen only where it outweighs the gear's own;
beside friction or a gap it bends the law by tens of noise floors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from edge_daemon.effects.algebra import dearer_by, derivative, stack
from edge_daemon.effects.catalogue import find
from edge_daemon.effects.effect import Effect, EffectState, Parameter
from edge_daemon.effects.torque_source import MOTOR_SIDE
from edge_daemon.identify.block_least_squares import MUCH_NOISE
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import DAMPING, STIFFNESS, Solution, Term
from edge_daemon.motion.corrected import senses
from edge_daemon.records import Array, Motion

LONGEST_S = 0.01
"""A filter of 16 Hz is slower than any sensor for a moving joint."""
UNLIKELY = 1e-4
"""A lag is held near zero by this share of its column's power: of a lag and a damper that the motion cannot tell apart
it is the damper that is there, while a bent law, a hundredth of that power, still shows it."""
WORTH_SAYING_S = 2e-5
"""Below it no sensor's data sheet speaks of a lag."""
STEADY = "constant_load"
ZERO = replace(find(STEADY, "torsion"), name="encoder_zero", meaning="what is unknown of the difference of the zeros")
"""Of encoders that do not agree only the recording tells by how much, and not from a steady load."""


def _late(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(-derivative(motion.torque_Nm, motion.rate_hz)), state


def _later(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    rate_hz = motion.rate_hz
    return stack(-derivative(derivative(motion.torque_Nm, rate_hz), rate_hz)), state


TORQUE_LAG = Effect(
    name="torque_lag",
    balance="torsion",
    kind="measurement",
    meaning="the torque sensor answers later than the encoders",
    equation="-T dtau/dt",
    source="a filter of first order",
    amplitudes=(Parameter("lag", "s", "time constant of the filter, or delay", 0.0, LONGEST_S),),
    shapes=(),
    columns=_late,
    needs=("torque_out_Nm",),
)
TORQUE_DELAY = replace(
    TORQUE_LAG,
    name="torque_delay",
    meaning="the torque sensor answers later than a filter of first order would",
    equation="-B d2tau/dt2",
    source="a delay's Taylor series, or a filter of second order",
    amplitudes=(Parameter("square", "s^2", "half the square of the delay", 0.0, LONGEST_S**2),),
    columns=_later,
)
LATE = (TORQUE_LAG, TORQUE_DELAY)
BESIDE = (*(row.name for row in LATE), MOTOR_SIDE.name, ZERO.name)
"""What is fitted beside a model, and is no part of it."""


def zeroed(terms: Sequence[Term], problem: RegressionProblem) -> tuple[Term, ...]:
    """The terms with that of the encoders' zeros, where these are unknown: that of all recordings, if it is one."""
    steady = any(term.effect.name in (STEADY, ZERO.name) for term in terms)
    zeros = {trial.zero_rad for trial in problem.trials}
    return tuple(terms) if steady or len(zeros) > 1 or zeros <= {0.0} else (*terms, Term(ZERO, {}))


def lagging(terms: Sequence[Term], problem: RegressionProblem) -> tuple[Term, ...]:
    """The terms as `zeroed`, with that of the lag, where all recordings hold a measured torque, or that of the motor
    side, where the torque or the model says that it is the motor's."""
    terms = zeroed(terms, problem)
    if any(trial.by_motor for trial in problem.trials) or any(term.effect is MOTOR_SIDE for term in terms):
        return (*(term for term in terms if term.effect is not MOTOR_SIDE), Term(MOTOR_SIDE, {}))
    if not all(senses(trial.motion) for trial in problem.trials):
        return tuple(terms)
    if TORQUE_LAG.name not in problem.noise.products:
        problem.noise.products.update(_noise_of_late(problem))
    late = (Term(row, {}) for row in LATE if row.name in problem.noise.products)
    return (*(term for term in terms if term.effect not in LATE), *late)


def _noise_of_late(problem: RegressionProblem) -> dict[str, tuple[float, float]]:
    """Of the lag, and of what a delay adds to it, the noise that is taken out of its column, as in `NoiseInColumns`. A
    second derivative of the torque holds that torque's own noise, which it would explain: without the delay where
    much of it is noise."""
    lag, delay = (float(np.mean(problem.columns(row, {}) ** 2)) for row in LATE)
    rows = [len(trial.target) for trial in problem.trials]
    noise = [trial.sensors.torque**2 * np.array(trial.moments) for trial in problem.trials]
    _, cross, own = np.average(noise, axis=0, weights=rows).tolist()
    out = {TORQUE_LAG.name: (-UNLIKELY * lag, 0.0)}
    return out | {TORQUE_DELAY.name: (own - UNLIKELY * delay, cross)} if own < MUCH_NOISE * delay else out


def least_lag_s(solution: Solution) -> float:
    """What the sensor answers late at the least: the lag that was found less what a damper makes of it."""
    stiffness, damping = solution.amplitude(*STIFFNESS, 0.0), solution.amplitude(*DAMPING, 0.0)
    lag_s = solution.amplitude(TORQUE_LAG.name, "lag", 0.0)
    return lag_s - damping / stiffness if stiffness > 0 else 0.0


def lag_remarked(solution: Solution, problem: RegressionProblem) -> tuple[str, ...]:
    """One line where the torque is the motor's, or its lag beyond doubt."""
    if {MOTOR_SIDE.name, STIFFNESS[0]} <= set(solution.names):
        dry, viscous, inertia = solution.amplitudes[MOTOR_SIDE.name]
        start = np.cumsum([0, *(len(term.effect.amplitudes) for term in solution.terms)])
        spring, motor = (int(start[solution.names.index(name)]) for name in (STIFFNESS[0], MOTOR_SIDE.name))
        dearer = dearer_by(solution.columns, spring, slice(motor, motor + len(MOTOR_SIDE.amplitudes)))
        taken = f"less {dry:.3g} N m and {viscous:.3g} N m s/rad of friction and {inertia:.3g} kg m^2 of the motor side"
        by_motor = any(trial.by_motor for trial in problem.trials)
        source = "torque is torque_in_Nm times the ratio" if by_motor else "torque_out_Nm is the motor's"
        return (f"{source}, {taken}: K is {dearer:.2g} times less sure than by a sensor",)
    least_s = least_lag_s(solution)
    if not least_s > WORTH_SAYING_S:
        return ()
    told = f"torque_out_Nm answers at least {1e3 * least_s:.2g} ms after the encoders: taken out"
    return (f"{told}; damping cannot be told from such a lag",)
