"""Recordings made ready for a fit: aligned, from one zero, with blocks to hold out, and a model's effects on them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.channel_delay import MODELLED, aligned, moved, retimed
from edge_daemon.balance.prepared import (
    BLOCK_S,
    LEAST_BLOCKS,
    SHORTER_BLOCKS_S,
    PreparedMotion,
    blocks_of,
    enough,
    from_zero,
)
from edge_daemon.balance.several import foretold, numbered_on
from edge_daemon.balance.twist_zero import one_zero
from edge_daemon.balance.zeros import with_their_zeros
from edge_daemon.channels import MOTOR_TORQUES
from edge_daemon.effects.catalogue import measured
from edge_daemon.effects.effect import Effect, Parameter
from edge_daemon.effects.model import Model, ModelError
from edge_daemon.effects.resolve import resolve
from edge_daemon.effects.torque_source import leaping
from edge_daemon.identify.block_least_squares import folds, folds_of_phase, repeats_after
from edge_daemon.identify.firm_spring import firm
from edge_daemon.identify.formula_start import LARGEST_COLUMN
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import DAMPING, SPRING_AND_DAMPER, STIFFNESS, Term
from edge_daemon.records import Array, Recorded

LOADED_ROUNDS = 4
"""Repetitions of the transmitted torque: friction of a tenth of it takes nine tenths of the error off in each."""
RICH_TONES = 2.0
"""With fewer effective tones in the motor speed a motion ties causes that other motions part."""
TONE_WIDTH_HZ = 0.2
TONE_BINS = 4
"""A tone is as wide as the window's main lobe, which counts in a short recording."""
MANY_BLOCKS = 12
"""Blocks of a drive's only recording, if need be shorter ones: each of six holds motion that no other has (guess)."""

NO_ODDER = 1.1
"""Error with the stretches that a first look could not tell, over that without, up to which a model tells them (guess).
"""


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
        leaps = leaping(model) if model.balance == "torsion" else ()
        key = model.balance, model.ratio, str(model.output_inertia_kg_m2), block_s, leaps
        if key not in self.ready:
            self.ready[key] = aligned(self.time_s, self.columns, model, block_s)
        return self.ready[key]


def ready_once(recordings: Sequence[Recorded]) -> list[ReadyOnce]:
    """Recordings that are made ready once, however many models they are held against."""
    return [row if isinstance(row, ReadyOnce) else ReadyOnce(row) for row in recordings]


def unit_of(model: Model, columns: Mapping[str, Array]) -> str:
    """Unit of the balance."""
    return "A" if model.balance == "drive" and "torque_in_Nm" not in columns else "N m"


def problem_of(
    recordings: Sequence[Recorded],
    model: Model,
    beside: Sequence[Sequence[Term]] = (),
    as_read: bool = False,
    held_against: bool = False,
) -> RegressionProblem:
    """The recordings made ready, the richest motion first, since the loop is brought to rest on it. Raises `BadInput`.

    Of several, whole recordings are held out; blocks where the others would not determine a model. A drive's
    torque is moved where it is late beside the model, or beside the likeliest of some other structures of effects;
    never `as_read`, and sooner where what it then leaves is `held_against` all that may be missing instead.
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
        structures, read_by = beside or (terms_of(model, problem),), [ready[i] for i in order]
        problem = _retimed(problem, read_by, model, richness, structures, held_against)
        return _with_all(problem, read_by, model, richness, structures)
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
    back = {name: -late_s for name, late_s in trial.late_s.items() if name in (*MOTOR_TORQUES, MODELLED)}
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
    structures: Sequence[Sequence[Term]], held_against: bool,
) -> RegressionProblem:  # fmt: skip
    """The problem, a torque moved by what is late beside structures of effects, if the best of them does better so."""
    fits = [problem.fit(terms, search=False, rounds=LOADED_ROUNDS) for terms in structures]
    loaded = any(term.effect.name == "model_torque" for terms in structures for term in terms)
    trials = retimed(problem.trials, recordings, model, [row.columns for row in fits], loaded, held_against)
    if trials is None:
        return problem
    again = _joined(trials, richness)
    later = [again.fit(terms, search=False, rounds=LOADED_ROUNDS) for terms in structures]
    return again if min(row.rmse for row in later) < min(row.rmse for row in fits) else problem


def _with_all(
    problem: RegressionProblem, recordings: Sequence[Recorded], model: Model, richness: Mapping[int, float],
    structures: Sequence[Sequence[Term]],
) -> RegressionProblem:  # fmt: skip
    """The problem with the stretches that a first look could not tell, if the best of some structures of effects tells
    them as well as the rest: a law that such a look does not know shows most where the motion is fastest."""
    if not any(trial.odd for trial in problem.trials):
        return problem
    trials = [
        moved(trial, row.time_s, row.columns, model, {}, all_of_it=True) if trial.odd else trial
        for trial, row in zip(problem.trials, recordings, strict=True)
    ]
    again = _joined(trials, richness)
    best = min((problem.fit(terms, search=False, rounds=LOADED_ROUNDS) for terms in structures), key=lambda f: f.rmse)
    with_all = again.fit(best.terms, search=False, rounds=LOADED_ROUNDS)
    return again if with_all.rmse < NO_ODDER * best.rmse else problem


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
