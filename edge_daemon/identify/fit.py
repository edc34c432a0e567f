"""A model's parameters from recordings, with honest standard deviations and a word on each that is not determined.

Amplitudes by least squares, shapes by search over them (variable projection, Golub & Pereyra 1973). Noise of the
encoders stands in the twist and would bias the stiffness: its known power is taken out of the normal equations (bias
compensation, Soderstrom 2007, Automatica 43(6)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.balance.torsion_floor import channel_noise, noise_floor
from edge_daemon.effects.catalogue import find
from edge_daemon.effects.drive_waves import leads
from edge_daemon.effects.effect import Effect, Parameter, Wave
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect, ModelError
from edge_daemon.effects.presliding import builds_up
from edge_daemon.effects.torque_source import MOTOR_SIDE
from edge_daemon.identify.deviations import EXACT_FLOORS, IDENTIFIED_SD, advised, deviations, excess_power, numbers
from edge_daemon.identify.formula_start import begun
from edge_daemon.identify.gauss_newton import LoopProblem, gauss_newton, nan_last
from edge_daemon.identify.heard_noise import heard_noise
from edge_daemon.identify.load_fit import with_its_load
from edge_daemon.identify.output_error import Sharp, sharpened
from edge_daemon.identify.problem import LOADED_ROUNDS, problem_of, ready_once, terms_of, unit_of
from edge_daemon.identify.regression import RegressionProblem, heading
from edge_daemon.identify.solution import DAMPING, STIFFNESS, Solution, Term
from edge_daemon.identify.structure import lawful
from edge_daemon.identify.torque_lag import BESIDE, lagging, zeroed
from edge_daemon.integrator.laws import CURVES, PATHS
from edge_daemon.motion.corrected import senses
from edge_daemon.records import Recorded

MEASUREMENT_ROUNDS = 6
"""Tied shapes and twist correction are repeated so often: the error of an ignored kinematic error falls fivefold in
each."""
MOST_SEARCHES, AT_REST = 4, 0.99
"""Searches of a model's shapes at the most, and the error over that before from which on they have come to rest
(guess)."""
OTHER_WIDTH = 2.3
"""A loop of several elements had two best widths so far apart on a simulated joint (guess)."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A model fitted to recordings."""

    model: Model
    solution: Solution
    problem: RegressionProblem
    floor: float
    """rms that sensor noise alone would leave, unit of the balance"""
    advice: Mapping[tuple[str, str], str]
    """(effect, parameter) -> what would identify it; only those that are not identified"""
    sharp: Sharp | None = None
    """what the simulated angles say; None where the model leaves more than noise"""

    @property
    def nrmse(self) -> float:
        """Held-out rms error over rms of the measured torque, both filtered."""
        return self.solution.rmse / self.problem.rms


def _looked_for(model: Model, problem: RegressionProblem) -> Sequence[Term]:
    """The model's effects, the formulas whose shapes the file leaves open where a first look finds them."""
    terms, unstated = terms_of(model, problem), {}
    for row, term in zip(model.effects, terms, strict=True):
        names = [shape.name for shape in term.effect.free_shapes if shape.name not in row.parameters]
        if row.expression is not None and names:
            unstated[row.name] = names
    return begun(problem, terms, unstated, _rounds(terms)) if unstated else terms


def _rounds(terms: Sequence[Term]) -> int:
    """Repetitions that terms without search take."""
    if any(term.effect.kind == "measurement" for term in terms):
        return MEASUREMENT_ROUNDS
    effects = [term.effect for term in terms]
    told = builds_up(effects) or any(effect.loaded or leads(effect) for effect in effects)
    return LOADED_ROUNDS if told else 2


def fit_terms(problem: RegressionProblem, terms: Sequence[Term]) -> Solution:
    """A whole structure fitted: ties and corrections repeated, shapes searched, friction simulated in the loop."""
    return _settled(problem, _begun(problem, terms))


def _begun(problem: RegressionProblem, terms: Sequence[Term]) -> Solution:
    """Friction on the twist as measured."""
    seen, solution = carried_as_measured(problem, terms), problem.fit(terms, search=False, rounds=_rounds(terms))
    if any(term.effect.free_shapes and (seen or term.effect.in_loop is None) for term in terms):
        solution = come_to_rest(problem, solution)
    return with_its_load(problem, solution)


def come_to_rest(problem: RegressionProblem, solution: Solution) -> Solution:
    """A solution with its shapes searched to the end, from wherever a search may begin."""
    rounds = 3 if _rounds(solution.terms) > 2 else 1
    found = _searched(problem, solution, rounds)
    others = (_searched(problem, other, rounds) for other in _elsewhere(found))
    return min((found, *others), key=lambda row: row.rmse)


def _elsewhere(solution: Solution) -> Iterator[Solution]:
    """Where else a search may begin: several elements that slip fit a loop at more than one width, and what is one of
    few values may be another."""
    for i, term in enumerate(solution.terms):
        several = len(term.effect.slips) > 1
        moved = [{"width": apart * term.shapes["width"]} for apart in (1 / OTHER_WIDTH, OTHER_WIDTH) if several]
        rows = [(row.name, value) for row in term.effect.free_shapes for value in row.choices]
        moved += [{name: value} for name, value in rows if value != term.shapes.get(name)]
        for shapes in moved:
            there = replace(term, shapes={**term.shapes, **shapes})
            yield replace(solution, terms=(*solution.terms[:i], there, *solution.terms[i + 1 :]))


def _searched(problem: RegressionProblem, solution: Solution, rounds: int) -> Solution:
    """Its shapes searched, again from where a search ended as long as that takes more, and from where these are
    heading: two that pull at each other, or one at what builds up with it or at an error of the angles, come to rest
    late, and all that is added then would seem to be missing."""
    effects = [term.effect for term in solution.terms]
    pull = builds_up(effects) or any(effect.is_angle_error for effect in effects)
    searched, ends = sum(len(effect.searched_shapes) for effect in effects), list[tuple[Term, ...]]()
    for _ in range(MOST_SEARCHES):
        before = solution.rmse
        solution = problem.fit(solution.terms, rounds=rounds)
        if searched + pull < 2 or solution.rmse > AT_REST * before:
            break
        ends.append(solution.terms)
        if pull and len(ends) > 2:
            solution = _further(problem, solution, heading(*ends[-3:]))
    return solution


def _further(problem: RegressionProblem, solution: Solution, terms: Sequence[Term]) -> Solution:
    """A solution at other shapes, if it leaves less there."""
    there = problem.fit(terms, search=False, rounds=_rounds(terms))
    if there.rmse < solution.rmse:
        return there
    problem.learn(solution)
    return solution


def carried_as_measured(problem: RegressionProblem, terms: Sequence[Term]) -> bool:
    """Whether the measured twist carries every law among the terms: beside a torque sensor curves of the twist, and
    what remembers its path where it is better known than that torque. Inside a gap such a torque does not even say
    where the twist goes, so that the loop could not."""
    laws = {element.kind for term in terms for element in term.effect.law}
    if not senses(problem.trials[0].motion):
        return False
    return laws <= CURVES or (laws <= {*CURVES, *PATHS} and all(map(_twist_is_surer, problem.trials)))


def _twist_is_surer(trial: PreparedMotion) -> bool:
    """Whether noise of the encoders is less, over the twist, than that of the torque sensor is over the torque."""
    noise, motion, rows = trial.sensors, trial.motion, trial.rows
    twist = math.hypot(noise.theta_in_rad / motion.ratio, noise.theta_out_rad) / float(np.std(motion.twist_rad[rows]))
    return twist < noise.torque / float(np.std(motion.torque_Nm[rows]))


def _settled(problem: RegressionProblem, solution: Solution, hopeless: float = math.inf) -> Solution:
    if carried_as_measured(problem, solution.terms):  # a simulated twist is compared in units of a stiffness, which
        return solution  # such a law may take all of
    settled = gauss_newton(problem, solution, hopeless)
    tries = [solution, settled, *([_as_felt(problem, settled)] if senses(problem.trials[0].motion) else [])]
    best = min(tries, key=lambda row: nan_last(float(row.held_out.sum())))
    problem.learn(best)
    return best


def _as_felt(problem: RegressionProblem, settled: Solution) -> Solution:
    """Laws of the loop on the twist as measured: a torque sensor's noise moves a simulated one."""
    state = problem.state
    found = problem.fit(settled.terms, search=False, rounds=_rounds(settled.terms))
    problem.restore(state)
    return found


def refitted(problem: RegressionProblem, solution: Solution, hopeless: float = math.inf) -> Solution:
    """What a search has found, fitted on to the end from there, or until an rms of `hopeless` is out of reach; never
    worse, unless a law was not yet asked of the twist that an error of the angles beside it leaves."""
    problem.learn(solution)
    if solution.design is not None:
        return _settled(problem, solution, hopeless)
    again = _settled(problem, _begun(problem, solution.terms), hopeless)
    apart = lawful(solution.terms) and any(term.effect.is_angle_error for term in solution.terms)
    return again if apart else min(solution, again, key=lambda row: row.rmse)


def sharpest(problem: RegressionProblem, terms: Sequence[Term]) -> tuple[Solution, Sharp | None]:
    """A whole structure fitted, its numbers from simulated angles where the model leaves nothing but noise. Most laws
    then need not be settled in the balance before."""
    solution = _begun(problem, terms)
    sharp = sharpened(problem, solution) if lawful(terms) else None
    if sharp is None:
        solution = _settled(problem, solution)
        sharp = sharpened(problem, solution)
    return (solution if sharp is None else _moved(problem, solution, sharp)), sharp


def _moved(problem: RegressionProblem, solution: Solution, sharp: Sharp) -> Solution:
    """The solution at a sharp point, its error held out in the balance as ever."""
    terms, amplitudes = LoopProblem(problem, solution).split(sharp.point)
    solution = replace(solution, terms=tuple(terms), amplitudes=amplitudes)
    problem.learn(solution)
    if lawful(terms):
        loop = LoopProblem(problem, solution)
        return loop.solution(*loop.modelled(loop.point))
    return replace(problem.solve(terms), amplitudes=amplitudes)


def floor_of(problem: RegressionProblem, model: Model, solution: Solution) -> float:
    """rms that sensor noise alone leaves in the balance, unit of the balance."""
    powers = []
    for trial in problem.trials:
        if model.balance == "drive":
            powers.append(trial.drive_floor**2)
        elif "torque_out_Nm" in trial.motion.extra:
            powers.append(channel_noise(trial) ** 2)
        if model.balance == "torsion":
            inertia = 0.0 if "torque_out_Nm" in trial.motion.extra else model.output_inertia_kg_m2
            stiffness, damping = solution.amplitude(*STIFFNESS, 0.0), solution.amplitude(*DAMPING, 0.0)
            rotor = solution.amplitude(MOTOR_SIDE.name, "inertia", 0.0)
            powers.append(noise_floor(trial, inertia, stiffness, damping, rotor) ** 2)
    return math.sqrt(sum(powers) / len(problem.trials))


def fit(recordings: Sequence[Recorded], model: Model) -> Fitted:
    """The model with every parameter fitted to the recordings. Raises `BadInput` in one line.

    A gear of 2e4 N m/rad under an inertia of 0.1 kg m^2, seen by encoders without noise:

    >>> from edge_daemon.effects.model import ModelEffect
    >>> from types import SimpleNamespace
    >>> time_s = np.arange(20_000) / 1000.0
    >>> out = sum(0.1 / f * np.sin(2 * np.pi * f * time_s) for f in (1.3, 4.7, 11.9))
    >>> torque = sum(-0.1 * 0.1 / f * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time_s) for f in (1.3, 4.7, 11.9))
    >>> columns = {"theta_in_rad": 100.0 * (out + torque / 2e4), "theta_out_rad": out}
    >>> model = Model("torsion", 100.0, 0.1, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
    >>> found = fit([SimpleNamespace(time_s=time_s, columns=columns)], model).model
    >>> round(found.value("linear_stiffness", "stiffness"), -1)
    20000.0
    """
    if not model.effects:
        raise ModelError("effect: missing: expected at least one [[effect]] to fit")
    ready = ready_once(recordings)
    fitted = _fit(problem_of(ready, model), model)
    foretold = floor_of(fitted.problem, model, fitted.solution)  # what is late sounds like noise too
    if model.balance == "drive" and fitted.solution.rmse > EXACT_FLOORS * foretold:
        again = problem_of(ready, model, (fitted.solution.terms,))
        return fitted if again.late_s == fitted.problem.late_s else _fit(again, model)
    return fitted


def _fit(problem: RegressionProblem, model: Model) -> Fitted:
    """The same of recordings that are ready."""
    terms = _looked_for(model, problem)
    late = lagging(terms, problem)
    solution, sharp = sharpest(problem, late if lawful(terms) or problem.trials[0].by_motor else zeroed(terms, problem))
    if len(late) > len(solution.terms) and not solution.amplitude(*DAMPING, 1.0) > 0:
        solution, sharp = sharpest(problem, late)
    return fitted_model(model, solution, problem, sharp)


def fit_from(model: Model, problem: RegressionProblem, start: Solution) -> Fitted:
    """The model with every parameter fitted on from where a search has come to rest."""
    solution = refitted(problem, start)
    sharp = sharpened(problem, solution)
    return fitted_model(model, solution if sharp is None else _moved(problem, solution, sharp), problem, sharp)


def fitted_model(model: Model, solution: Solution, problem: RegressionProblem, sharp: Sharp | None = None) -> Fitted:
    """The solution written into the model: values, standard deviations, and what is not identified."""
    floor = floor_of(problem, model, solution)
    floor = max(floor, heard_noise(problem, solution, floor))
    excess = excess_power(solution, floor) if model.balance == "torsion" else 0.0
    sd, inflation = deviations(solution, problem, excess) if sharp is None else (sharp.sd, sharp.inflation)
    advice: dict[tuple[str, str], str] = {}
    known = {row.name: row for row in model.effects}
    rows = []
    for i, (term, parameter, value) in enumerate(numbers(solution)):
        if term.effect.name in BESIDE and term.effect.name not in known:
            continue
        identified = bool(sd[i] < IDENTIFIED_SD * abs(value)) and inside(parameter, value)
        if not identified:
            advice[term.effect.name, parameter.name] = advised(value, float(sd[i]), float(inflation[i]))
        newtons = unit_of(model, problem.trials[0].motion.extra) == "N m"
        unit = parameter.unit if newtons else parameter.unit.replace("N m", "A")
        rows.append((term.effect, parameter.name, FittedParameter(value, float(sd[i]), unit, identified)))
    effects = []
    for term in (term for term in solution.terms if term.effect.name not in BESIDE or term.effect.name in known):
        own = {name: fitted for effect, name, fitted in rows if effect.name == term.effect.name}
        row = known.get(term.effect.name, ModelEffect(term.effect.name))
        effects.append(replace(row, parameters=own, waves=_waves_to_say(term.effect, row)))
    return Fitted(replace(model, effects=tuple(effects)), solution, problem, floor, advice, sharp)


def _waves_to_say(effect: Effect, row: ModelEffect) -> tuple[Wave, ...]:
    """The waves of an effect where they are not those of the catalogue, or the model named them."""
    said = row.waves or (find(effect.name, effect.balance).waves if effect.over else ())
    return row.waves if set(said) == set(effect.waves) else effect.waves


def inside(row: Parameter, value: float) -> bool:
    """Whether a value is off its bounds: one at a bound was not found but stopped."""
    return row.lower * (1 + 1e-9) < value < row.upper * (1 - 1e-9) if row.lower > 0 else row.lower < value < row.upper
