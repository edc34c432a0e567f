"""A torque that was recorded as the output's and is the motor's: what is missing is looked for once more as beside
that, and the better of the two explanations is told.

Robots log the current of a joint in units of its output. Friction of the motor side is still in it: it looks like a
sensor that answers later than any does, and hides what else is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.effects.torque_source import MOTOR_SIDE
from edge_daemon.explain.results import Candidate, Diagnosis
from edge_daemon.identify.fit import Recorded, fit_terms, problem_of, terms_of
from edge_daemon.identify.regression import RegressionProblem, Solution, Term
from edge_daemon.identify.torque_lag import TORQUE_LAG, lagging, least_lag_s
from edge_daemon.motion.corrected import senses
from edge_daemon.search.thresholds import EXACT_FLOORS

UNLIKELY_S = 4e-3
"""So late is hardly any torque sensor (a filter of 40 Hz, guess)."""
A_PART = 0.95
"""Error beside friction of the motor side alone over that without from which on a torque may be the motor's (guess)."""
AS_GOOD, FAR_BETTER = 1.05, 0.5
"""Error as the motor's torque over that as a sensor's up to which it is believed: where a sensor would be that late,
and elsewhere (guesses)."""
ASKED_FIRST = 0.7
"""Error beside friction of the motor side over that without below which the motor's is looked at first (guess)."""


def too_late(base: Solution) -> bool:
    """Whether the torque of a fit is later than a sensor behind the gear may be."""
    return least_lag_s(base) > UNLIKELY_S


def is_asked(found: Diagnosis, problem: RegressionProblem, base: Solution) -> bool:
    """Whether it is to be asked if a recorded torque is the motor's: a sensor would be too late, or what is missing was
    not found and friction of the motor side alone takes a part of it."""
    if found.verdict == "adequate" or not senses(problem.trials[0].motion) or MOTOR_SIDE.name in base.names:
        return False
    if too_late(base):
        return True
    if least_left(found) < EXACT_FLOORS * found.error.noise_floor_nrmse:
        return False
    terms, state = [term for term in base.terms if term.effect is not TORQUE_LAG], problem.state
    beside = fit_terms(problem, lagging((*terms, Term(MOTOR_SIDE, {})), problem))
    problem.restore(state)
    return beside.rmse < A_PART * base.rmse


def may_be_motors(recordings: Sequence[Recorded], model: Model) -> bool:
    """Whether friction of the motor side takes a good part of what a model leaves of a recorded torque."""
    problem = problem_of(recordings, model)
    if not senses(problem.trials[0].motion) or model.effect(MOTOR_SIDE.name):
        return False
    sensors, motors = (fit_terms(problem, lagging(terms_of(row, problem), problem)) for row in (model, by_motor(model)))
    return motors.rmse < ASKED_FIRST * sensors.rmse


def by_motor(model: Model) -> Model:
    """The model with a torque that is the motor's."""
    return model.with_effect(ModelEffect(MOTOR_SIDE.name))


def least_left(found: Diagnosis) -> float:
    """Error that the best explanation leaves."""
    return min((row.nrmse_after for row in found.candidates), default=found.error.nrmse)


def better_of(sensor: Diagnosis, motor: Diagnosis, late: bool) -> Diagnosis:
    """What is told: that of a sensor's torque, or what is missing beside the motor side, with that. `late`: no sensor
    is so late."""
    if least_left(motor) > (AS_GOOD if late else FAR_BETTER) * least_left(sensor):
        return sensor
    if motor.verdict == "adequate":
        taken = 1.0 - (motor.error.nrmse / sensor.error.nrmse) ** 2  # what is left may be of another law
        alone = Candidate(MOTOR_SIDE.name, sensor.error.nrmse, motor.error.nrmse, taken, (), {})
        return replace(sensor, verdict="missing", candidates=(alone,), next_experiment=None, warnings=motor.warnings)
    rows = tuple(
        replace(row, effect=_beside(row.effect), nrmse_before=sensor.error.nrmse,
                confused_with=tuple(map(_beside, row.confused_with)))
        for row in motor.candidates
    )  # fmt: skip
    return replace(motor, error=sensor.error, candidates=rows)


def _beside(names: str) -> str:
    return "+".join(sorted((*names.split("+"), MOTOR_SIDE.name)))
