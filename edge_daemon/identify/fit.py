"""A model's parameters from recordings, with honest standard deviations and a word on each that is not determined.

Amplitudes by least squares, shapes by search over them (variable projection, Golub & Pereyra 1973). Noise of the
encoders stands in the twist and would bias the stiffness: its known power is taken out of the normal equations (bias
compensation, Soderstrom 2007, Automatica 43(6)). Standard deviations are those of a sandwich over blocks of more
than a second (Liang & Zeger 1986): residuals may be correlated and of any spectrum within a block. What a model leaves
above the noise floor is the error of a law, the same in every block: it widens them further.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.channel_delay import TORQUES, aligned, moved, retimed
from edge_daemon.balance.prepared import (
    BLOCK_S,
    LEAST_BLOCKS,
    SHORTER_BLOCKS_S,
    PreparedMotion,
    blocks_of,
    channel_noise,
    enough,
    from_zero,
    noise_floor,
    noise_products,
)
from edge_daemon.balance.several import foretold, numbered_on, with_their_zeros
from edge_daemon.balance.twist_zero import one_zero
from edge_daemon.effects.catalogue import find, measured
from edge_daemon.effects.drive_waves import leads
from edge_daemon.effects.effect import Effect, Parameter, Wave
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect, ModelError
from edge_daemon.effects.resolve import resolve
from edge_daemon.effects.torque_source import LEAPING, MOTOR_SIDE
from edge_daemon.identify.block_least_squares import folds, folds_of_phase, repeats_after
from edge_daemon.identify.firm_spring import firm
from edge_daemon.identify.formula_start import LARGEST_COLUMN, begun
from edge_daemon.identify.gauss_newton import LoopProblem, gauss_newton, nan_last
from edge_daemon.identify.heard_noise import heard_noise
from edge_daemon.identify.load_fit import with_its_load
from edge_daemon.identify.output_error import Sharp, sharpened
from edge_daemon.identify.regression import DAMPING, SPRING_AND_DAMPER, STIFFNESS, RegressionProblem, Solution, Term
from edge_daemon.identify.structure import lawful
from edge_daemon.identify.torque_lag import BESIDE, lagging, zeroed
from edge_daemon.integrator.laws import CURVES, PATHS
from edge_daemon.motion.corrected import senses
from edge_daemon.records import Array, Recorded
from edge_daemon.text import number

MEASUREMENT_ROUNDS = 6
"""Tied shapes and twist correction are repeated so often: the error of an ignored kinematic error falls fivefold in
each."""
LOADED_ROUNDS = 4
"""Repetitions of the transmitted torque: friction of a tenth of it takes nine tenths of the error off in each."""
TIED_SHARE = 1e-12
"""Columns count as tied where a change of their numbers takes less than this share of the torque's square: rounding."""
IDENTIFIED_SD = 1 / 3
"""A parameter counts as identified below this relative sd: three sigma from zero."""
MOST_SEARCHES, AT_REST = 4, 0.99
"""Searches of a model's shapes at the most, and the error over that before from which on they have come to rest
(guess)."""
SURE_SD = 2.0
"""So many standard deviations around a value hold the truth 19 times in 20."""
COLLINEAR = 30.0
"""Above this variance inflation another motion, not more signal, is what a parameter needs."""
EXACT_FLOORS = 1.1
"""A model counts as exact up to this error over the noise floor."""
INEXACT_FLOORS = 0.3
"""A simulated law's steps and smoothing leave this error over the noise floor."""
LOOKS = 10.0
"""A recording gives so many independent looks at the error of a law (calibrated on friction and hysteresis fitted with
other laws: errors over their sd scatter by about one)."""
SHAPE_STEP = 0.02
"""A shape's column is found by a finite difference of this relative step."""
RICH_TONES = 2.0
"""With fewer effective tones in the motor speed a motion ties causes that other motions part."""
OTHER_WIDTH = 2.3
"""A loop of several elements had two best widths so far apart on a simulated joint (guess)."""
TONE_WIDTH_HZ = 0.2
TONE_BINS = 4
"""A tone is as wide as the window's main lobe, which counts in a short recording."""


@dataclass(frozen=True, slots=True)
class ReadyOnce:
    """A recording that several models of one gear are held against: made ready for the first of them."""

    recording: Recorded
    ready: dict[tuple[object, ...], PreparedMotion] = field(default_factory=dict)

    @property
    def time_s(self) -> Array:
        """(n,) as recorded."""
        return self.recording.time_s

    @property
    def columns(self) -> Mapping[str, Array]:
        """(n,) each, as recorded."""
        return self.recording.columns

    def aligned(self, model: Model, block_s: float = BLOCK_S) -> PreparedMotion:
        """The recording as this model wants it: of its effects only friction that leaps makes a difference."""
        leaps = tuple(name for name in LEAPING if model.effect(name) is not None)
        key = model.balance, model.ratio, str(model.output_inertia_kg_m2), block_s, leaps
        if key not in self.ready:
            self.ready[key] = aligned(self.time_s, self.columns, model, block_s)
        return self.ready[key]


def ready_once(recordings: Sequence[Recorded]) -> list[ReadyOnce]:
    """Recordings that are made ready once, however many models they are held against."""
    return [row if isinstance(row, ReadyOnce) else ReadyOnce(row) for row in recordings]


LEAST_TOLD, UNTOLD = 0.3, 0.01
"""Share of what columns say along a direction that must not be noise for them to tell it, and what is then left of it:
a hundred times the deviation (guesses)."""
MANY_BLOCKS = 12
"""Blocks of a drive's only recording, if need be shorter ones: each of six holds motion that no other has (guess)."""


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


def unit_of(model: Model, columns: Mapping[str, Array]) -> str:
    """Unit of the balance."""
    return "A" if model.balance == "drive" and "torque_in_Nm" not in columns else "N m"


def problem_of(
    recordings: Sequence[Recorded], model: Model, beside: Sequence[Sequence[Term]] = (), as_read: bool = False
) -> RegressionProblem:
    """The recordings made ready, the richest motion first, since the loop is brought to rest on it. Raises `BadInput`.

    Of several, whole recordings are held out; blocks where the others would not determine a model. A drive's
    torque is moved where it is late beside the model, or beside the likeliest of some other structures of effects;
    never `as_read`.
    """
    ready = ready_once(recordings)
    trials = [row.aligned(model) for row in ready]
    for block_s in SHORTER_BLOCKS_S:
        if blocks_of(trials) < (MANY_BLOCKS if model.balance == "drive" and len(ready) == 1 else LEAST_BLOCKS):
            trials = [row.aligned(model, block_s) for row in ready]
    enough(trials)
    kept = [i for i, trial in enumerate(trials) if len(trial.rows)]
    richness = {i: tones([trials[i]]) for i in kept} if len(kept) > 1 else dict.fromkeys(kept, RICH_TONES)
    order = sorted(kept, key=lambda i: (-richness[i], i))
    read = {i: _as_read(trials[i], ready[i], model) if as_read else trials[i] for i in kept}
    if model.balance == "torsion" and len(kept) > 1:  # what tells nothing tells no zero either
        read = dict(zip(kept, _with_one_zero(list(read.values())), strict=True))
    problem = _joined([read[i] for i in order], richness)
    if model.balance == "torsion" and len(order) > 1:
        return _joined(with_their_zeros(problem.trials, _own_columns(model, problem)), richness)
    if as_read:
        return problem
    if model.balance == "drive" and (beside or len(model.effects) > 1):
        structures = beside or (terms_of(model, problem),)
        return _retimed(problem, [ready[i] for i in order], model, richness, structures)
    return problem


def _with_one_zero(trials: Sequence[PreparedMotion]) -> list[PreparedMotion]:
    """Recordings of one joint, their twists from one zero where its encoders kept theirs."""
    return list(map(from_zero, trials, one_zero([trial.zero_rad for trial in trials])))


def _own_columns(model: Model, problem: RegressionProblem) -> list[Array]:
    """(m, k) of each recording, what the model has beside spring and damper."""
    terms = [row for row in terms_of(model, problem) if row.effect.name not in SPRING_AND_DAMPER]
    columns = [problem.columns(row.effect, row.shapes) for row in terms]
    return np.split(np.hstack([np.empty((len(problem.target), 0)), *columns]), problem.ends)


def _as_read(trial: PreparedMotion, recording: Recorded, model: Model) -> PreparedMotion:
    """A recording with its torque at the instants at which it was recorded."""
    back = {name: -late_s for name, late_s in trial.late_s.items() if name in TORQUES}
    return moved(trial, recording.time_s, recording.columns, model, back) if back else trial


def _joined(trials: Sequence[PreparedMotion], richness: Mapping[int, float]) -> RegressionProblem:
    """One problem of trials, their blocks numbered on, blocks held out where not two of them are rich."""
    numbered = numbered_on(trials)
    problem = RegressionProblem(numbered)
    if len(trials) == 1 and trials[0].drive_floor:
        problem.fold = _folds_of_phase(numbered[0])
    if len(trials) > 1 and (sorted(richness.values())[-2] < RICH_TONES or not foretold(trials)):
        problem.fold = folds(len(np.unique(problem.block)))
    return problem


def _folds_of_phase(trial: PreparedMotion) -> NDArray[np.intp]:
    """(b,) fold of each block of a drive, whose laws are never quite the gear's: by phase where a motion repeats."""
    rate_hz = trial.motion.rate_hz
    start_s = trial.rows[np.flatnonzero(np.diff(trial.block, prepend=-1))] / rate_hz
    return folds_of_phase(start_s, repeats_after(rate_hz, trial.motion.theta_out_rad), BLOCK_S)


def _retimed(
    problem: RegressionProblem, recordings: Sequence[Recorded], model: Model, richness: Mapping[int, float],
    structures: Sequence[Sequence[Term]],
) -> RegressionProblem:  # fmt: skip
    """The problem, a torque moved by what is late beside structures of effects, if the best of them does better so."""
    fits = [problem.fit(terms, search=False, rounds=LOADED_ROUNDS) for terms in structures]
    trials = retimed(problem.trials, recordings, model, [row.columns for row in fits])
    if trials is None:
        return problem
    again = _joined(trials, richness)
    later = [again.fit(terms, search=False, rounds=LOADED_ROUNDS) for terms in structures]
    return again if min(row.rmse for row in later) < min(row.rmse for row in fits) else problem


def terms_of(model: Model, problem: RegressionProblem) -> tuple[Term, ...]:
    """The model's effects with their shapes as the file states them. Raises `ModelError` for what is not recorded."""
    motion = problem.trials[0].motion
    terms = []
    for row in model.effects:
        effect = resolve(row, model.balance, tuple(motion.extra))
        missing = [need for need in effect.needs if not measured(motion, need)]
        if missing:
            raise ModelError(f"{effect.name}: needs {', '.join(missing)}: the recording has no such column")
        shapes = {p.name: row.value(p.name, start_of(p, problem)) for p in effect.free_shapes}
        if row.expression is not None:
            _refuse_endless(effect, shapes, problem)
        terms.append(Term(effect, shapes))
    problem.begin_at({key: model.value(*key) for key in (STIFFNESS, DAMPING)})
    return firm(terms, problem)


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
    return LOADED_ROUNDS if any(term.effect.loaded or leads(term.effect) for term in terms) else 2


def _refuse_endless(effect: Effect, shapes: Mapping[str, float], problem: RegressionProblem) -> None:
    """A user's formula must give a number for every row, at least where its search starts."""
    for trial in problem.trials:
        columns, _ = effect.columns(trial.motion, problem.shapes(effect, shapes), None)
        wrong = int(np.count_nonzero(~np.isfinite(columns).all(axis=1)))
        if wrong or float(np.max(np.abs(columns), initial=0.0)) > LARGEST_COLUMN:
            rows = f"{wrong} of {len(columns)} rows" if wrong else "some rows"
            raise ModelError(f"{effect.name}: {effect.equation}: no usable number in {rows}: expected one for each row")


def start_of(row: Parameter, problem: RegressionProblem) -> float:
    """Where a shape search starts: the middle of the parameter's grid in the recording's own scale."""
    if row.asks or not row.grid:
        return row.start
    value = row.grid[len(row.grid) // 2]
    if row.scale:
        value *= math.sqrt(float(np.mean(getattr(problem.motions[0], row.scale) ** 2)))
    return min(max(value, row.lower), row.upper)


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
    """Its shapes searched, again from where a search ended as long as that takes more: two that pull at each other come
    to rest late, and all that is added then would seem to be missing."""
    for _ in range(MOST_SEARCHES):
        before = solution.rmse
        solution = problem.fit(solution.terms, rounds=rounds)
        if sum(len(term.effect.searched_shapes) for term in solution.terms) < 2 or solution.rmse > AT_REST * before:
            break
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
            advice[term.effect.name, parameter.name] = _advice(value, float(sd[i]), float(inflation[i]))
        unit = (
            parameter.unit
            if unit_of(model, problem.trials[0].motion.extra) == "N m"
            else parameter.unit.replace("N m", "A")
        )
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
    parts, i = [], 0
    corrected = any(term.effect.is_angle_error for term in solution.terms)
    for term in solution.terms:
        width = len(term.effect.amplitudes)
        own = solution.columns[:, i : i + width]
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


def _advice(value: float, sd: float, inflation: float) -> str:
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


def tones(trials: Sequence[PreparedMotion]) -> float:
    """Effective number of tones in the motor speed, summed over recordings: (sum p)^2 / sum p^2 over power in bins of
    0.2 Hz or a lobe."""
    total = 0.0
    for trial in trials:
        speed = np.gradient(trial.motion.theta_in_rad)[trial.rows[0] : trial.rows[-1]]
        power = np.abs(np.fft.rfft((speed - speed.mean()) * np.hanning(len(speed)))) ** 2
        width = max(TONE_BINS, round(TONE_WIDTH_HZ * len(speed) / trial.motion.rate_hz))
        bins = power[: len(power) // width * width].reshape(-1, width).sum(axis=1)
        total += float(bins.sum() ** 2 / max(float((bins**2).sum()), 1e-300))
    return total
