"""What is looked for once more beside friction that leaps where the output turns round, of the motor side or of the
output, or beside the zero of a torque sensor, and told if it is the better explanation.

Robots log the current of a joint in units of its output. Friction of the motor side is still in it: it looks like a
sensor that answers later than any does, and hides what else is missing. Friction of the output beside a torque of the
inertia leaves its reversals, which friction of the twist imitates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.effects.torque_source import MOTOR_SIDE, OUTPUT_FRICTION
from edge_daemon.explain.results import Candidate, Diagnosis
from edge_daemon.identify.fit import fit, fit_terms
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import Solution, Term
from edge_daemon.identify.structure import lawful
from edge_daemon.identify.torque_lag import LATE, STEADY, lagging, least_lag_s
from edge_daemon.motion.corrected import senses
from edge_daemon.records import Recorded
from edge_daemon.search.thresholds import EXACT_FLOORS, LEAST_GAIN

UNLIKELY_S = 4e-3
"""So late is hardly any torque sensor (a filter of 40 Hz, guess)."""
A_PART = 0.95
"""Error beside friction of the motor side over that without from which on a torque may be the motor's, and beside
friction of the output or the zero of a sensor from which on another law is looked for beside it (guess)."""
AS_GOOD, FAR_BETTER = 1.05, 0.5
"""Error as the motor's torque over that as a sensor's up to which it is believed: where a sensor would be that late,
and elsewhere (guesses)."""
MOST_LEFT = 0.3
"""Error of an explanation over that before below which it says most: another torque, or its zero, must then take a part
of what is left, not of what there was, and floors above the noise may be a sensor's that drifts (guess)."""
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
    best, state = explained(found, problem), problem.state
    terms = base.terms if best is None else lagging(terms_of(best, problem), problem)
    base = base if best is None else fit_terms(problem, terms)
    unlike = too_late(base)
    if not unlike and least_left(found) >= EXACT_FLOORS * found.error.noise_floor_nrmse:
        plain = (term for term in terms if term.effect not in LATE)
        beside = fit_terms(problem, lagging((*plain, Term(MOTOR_SIDE, {})), problem))
        unlike = beside.rmse < A_PART * base.rmse
    problem.restore(state)
    return unlike


def explained(found: Diagnosis, problem: RegressionProblem) -> Model | None:
    """The model with the best explanation where that takes most of what there was, and no law of the twist, which may
    imitate friction of the motor side, or a zero; None where there is none."""
    if found.verdict != "missing" or found.with_first is None or least_left(found) > MOST_LEFT * found.error.nrmse:
        return None
    return None if lawful(terms_of(found.with_first, problem)) else found.with_first


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


def explains_lag(found: Diagnosis, recordings: Sequence[Recorded]) -> bool:
    """Whether a sensor is no longer too late beside the best explanation: what is missing made it look so."""
    return found.with_first is not None and not too_late(fit(recordings, found.with_first).solution)


def better_of(sensor: Diagnosis, motor: Diagnosis, late: bool, explained: bool = False) -> Diagnosis:
    """What is told: that of a sensor's torque, or what is missing beside the motor side, with that. `late`: no sensor
    is so late; `explained`: beside what else is missing, it is not."""
    return as_motors(sensor, motor, (A_PART if explained else AS_GOOD) if late else FAR_BETTER)


def as_motors(sensor: Diagnosis, motor: Diagnosis, within: float) -> Diagnosis:
    """What is missing beside the motor side, with that, where it leaves less than a part of what a sensor's does."""
    return told_beside(sensor, motor, MOTOR_SIDE.name, within)


def without_motors(
    told: Diagnosis, sensor: Diagnosis, recordings: Sequence[Recorded], model: Model
) -> Diagnosis | None:
    """What is told beside the motor side, without that where the rest explains as much of a sensor's torque: two laws
    at once may be found beside it alone, since it takes a part of what either leaves. None where it does not."""
    best = next(iter(told.candidates), None)
    rest = [name for name in _left(best.effect).split("+") if model.effect(name) is None] if best else []
    if told is sensor or best is None or not any(rest):
        return None
    larger = told.with_first or replace(model, effects=(*model.effects, *map(ModelEffect, rest)))
    alone = fit(recordings, larger.without(MOTOR_SIDE.name))
    if alone.nrmse > AS_GOOD * min(best.nrmse_after, least_left(sensor)):
        return None
    rows = [(row, _left(row.effect)) for row in told.candidates if _left(row.effect)]
    candidates = tuple(
        replace(row, effect=effect, confused_with=tuple(filter(None, map(_left, row.confused_with))),
                parameters={key: v for key, v in row.parameters.items() if not key.startswith(f"{MOTOR_SIDE.name}.")})
        for row, effect in rows
    )  # fmt: skip
    return replace(told, candidates=candidates, warnings=sensor.warnings)


def _left(names: str) -> str:
    """Names joined with `+` without the motor side."""
    return "+".join(name for name in names.split("+") if name != MOTOR_SIDE.name)


def may_leap(found: Diagnosis, recordings: Sequence[Recorded], model: Model) -> bool:
    """Whether it is to be asked if friction of the output is missing with another law: it is listed and leaves more
    than noise, as it does where nothing tells which way it acts, and takes a part of what there is elsewhere."""
    listed = any(OUTPUT_FRICTION in row.effect.split("+") for row in found.candidates)
    left = least_left(found) > EXACT_FLOORS * found.error.noise_floor_nrmse
    if found.verdict == "adequate" or not (listed and left) or model.effect(OUTPUT_FRICTION) is not None:
        return False
    without, beside = _fitted_beside(recordings, model, OUTPUT_FRICTION)
    return beside.rmse < A_PART * without.rmse


def _fitted_beside(recordings: Sequence[Recorded], model: Model, name: str) -> tuple[Solution, Solution]:
    """The model without an effect and with it, both by the rows that one with it is judged by."""
    rows = (model, model.with_effect(ModelEffect(name)))
    problem = problem_of(recordings, rows[1])
    without, beside = (fit_terms(problem, lagging(terms_of(row, problem), problem)) for row in rows)
    return without, beside


def may_hide_zero(found: Diagnosis, recordings: Sequence[Recorded], model: Model) -> bool:
    """Whether it is to be asked what is missing beside the zero of a torque sensor: it is not told, and the zero, which
    any sensor has, takes something of what there is."""
    told = found.verdict == "missing" and STEADY in found.candidates[0].effect.split("+")
    if found.verdict == "adequate" or told or model.effect(STEADY) is not None:
        return False
    problem = problem_of(recordings, model)
    if not senses(problem.trials[0].motion):
        return False
    without, beside = _fitted_beside(recordings, explained(found, problem) or model, STEADY)
    return beside.rmse < (1 - LEAST_GAIN) * without.rmse


def told_beside(found: Diagnosis, beside: Diagnosis, name: str, within: float = FAR_BETTER) -> Diagnosis:
    """What is told: what was found, or what is missing beside an effect of this name, with that, where it leaves less
    than a part of it."""
    if least_left(beside) > within * least_left(found):
        return found
    if beside.verdict == "adequate":
        taken = 1.0 - (beside.error.nrmse / found.error.nrmse) ** 2  # what is left may be of another law
        alone = Candidate(name, found.error.nrmse, beside.error.nrmse, taken, (), {})
        return replace(found, verdict="missing", candidates=(alone,), next_experiment=None, warnings=beside.warnings)
    rows = tuple(
        replace(row, effect=_joined(row.effect, name), nrmse_before=found.error.nrmse,
                confused_with=tuple(_joined(other, name) for other in row.confused_with))
        for row in beside.candidates
    )  # fmt: skip
    return replace(beside, error=found.error, candidates=rows)


def _joined(names: str, name: str) -> str:
    return "+".join(sorted((*names.split("+"), name)))
