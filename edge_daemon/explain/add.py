"""One more effect in a model: fitted before and after on the same recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.effects.catalogue import find, measured
from edge_daemon.effects.effect import Effect
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect, ModelError, Version
from edge_daemon.effects.plugin import plugins
from edge_daemon.effects.resolve import resolve
from edge_daemon.explain.compare import error_of
from edge_daemon.explain.diagnose import searched
from edge_daemon.explain.plausibility import examine
from edge_daemon.explain.results import Error, Json, number
from edge_daemon.identify.deviations import SURE_SD
from edge_daemon.identify.firm_spring import least_stiffness
from edge_daemon.identify.fit import Fitted, fit, fit_from, fit_terms
from edge_daemon.identify.gauss_newton import on_stretch
from edge_daemon.identify.identifiability import identifiability
from edge_daemon.identify.pilot_stretch import stretch_of
from edge_daemon.identify.problem import terms_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import STIFFNESS, Solution, Term
from edge_daemon.identify.structure import Structure, lawful
from edge_daemon.identify.torque_lag import lag_remarked, lagging
from edge_daemon.records import Recorded
from edge_daemon.search.free_orders import further, in_order, offered, with_orders
from edge_daemon.search.grid_fit import grid
from edge_daemon.search.hypotheses import LEAST_FLOOR, Hypothesis, shown
from edge_daemon.search.order import falls, likely
from edge_daemon.search.simulated_ranking import at_rest
from edge_daemon.search.thresholds import LEAST_GAIN
from edge_daemon.text import meant

MOVED_SD = 3.0
"""A parameter has moved when it changed by more than this many standard deviations, of before or after: of a parameter
that loses its identification the latter grow without end."""

ALIKE = 1.05
"""All of the recording tells where to begin among points whose error on the stretch is within this factor of the least
there."""
NOISE_LEFT = 1.05
"""Error over the noise floor below which a fit needs no better place to begin (guess)."""


@dataclass(frozen=True, slots=True)
class Moved:
    """A parameter that a changed structure made change."""

    effect: str
    name: str
    before: FittedParameter
    after: FittedParameter

    @property
    def lost(self) -> bool:
        """Whether the recording determined it before, and no longer does."""
        return self.before.identified and not self.after.identified

    def to_json(self) -> Json:
        """One row of `moved`."""
        return {
            "effect": self.effect,
            "name": self.name,
            "before": number(self.before.value),
            "before_sd": number(self.before.sd),
            "after": number(self.after.value),
            "after_sd": number(self.after.sd),
            "unit": self.after.unit,
            "identified_before": self.before.identified,
            "identified": self.after.identified,
        }


@dataclass(frozen=True, slots=True)
class StructureChange:
    """What adding or removing an effect did."""

    name: str
    model: Model
    """refitted, with one more line of lineage"""
    before: Error
    after: Error
    moved: tuple[Moved, ...]
    helps: bool
    """whether the held-out error falls beyond chance, and by enough to be worth the effect's numbers"""
    warnings: tuple[str, ...] = ()

    def to_json(self) -> Json:
        """For `add --json` and `remove --json`."""
        return {
            "effect": self.name,
            "before": self.before.to_json(),
            "after": self.after.to_json(),
            "helps": self.helps,
            "moved": [row.to_json() for row in self.moved],
            "warnings": list(self.warnings),
        }


def with_added(model: Model, name: str, expression: str | None = None, unit: str | None = None) -> Model:
    """The model with the effect, not yet fitted; names joined with `+` add several. Raises `ModelError`."""
    for part in name.split("+"):
        if model.effect(part) is not None:
            raise ModelError(f"{part}: the model has it already")
        if expression is None and part not in plugins():
            find(part, model.balance)
        model = model.with_effect(ModelEffect(part, {}, expression, unit))
    return model


def add_effect(
    model: Model,
    name: str,
    recordings: Sequence[Recorded],
    recording_name: str = "",
    expression: str | None = None,
    unit: str | None = None,
) -> StructureChange:
    """The model with `name` (or several joined with `+`), refitted, and what that did. Raises `BadInput`.

    The fit goes on from what the diagnosis finds, so that it does not fall short of what that promises.
    """
    warnings = examine(recordings, model)
    repeated = [] if expression else [part for part in name.split("+") if repeats(model, part)]
    new = [part for part in name.split("+") if part not in repeated or model.effect(part) is None]
    larger = with_added(model, "+".join(new), expression, unit) if new else model
    before = fit(recordings, model)
    turning, others = [part for part in new if part in repeated], [part for part in new if part not in repeated]
    beside = fit(recordings, with_added(model, "+".join(others))) if repeated and others else before
    larger = over_orders(larger, turning, beside)
    larger = over_further_orders(larger, [part for part in repeated if part not in new], beside)
    after = extended(larger, before, recordings)
    if gone := emptied(after, new):
        less = fit(recordings, without(after.model, "+".join(gone)))
        if less.solution.rmse < (1 + LEAST_GAIN) * after.solution.rmse:
            after, warnings = less, (*warnings, f"{', '.join(gone)}: left out, nothing is left of it beside {name}")
    return _changed(f"add {name}", name, before, after, recording_name, warnings)


def emptied(fitted: Fitted, new: Sequence[str]) -> list[str]:
    """Load friction of a model of which nothing is left beside a new form of it: zero would do as well."""
    loaded = [term.effect for term in fitted.solution.terms if term.effect.loaded]
    usual = {row for effect in loaded if effect.name in new for row in (*effect.refines, *effect.yields_to)}
    usual &= {effect.name for effect in loaded} - set(new)
    told = {row.name: row.parameters for row in fitted.model.effects}
    rows = {effect.name: [told[effect.name][row.name] for row in effect.amplitudes]
            for effect in loaded if effect.name in usual}  # fmt: skip
    return [name for name, row in rows.items() if all(abs(p.value) <= SURE_SD * p.sd or not p.value for p in row)]


def repeats(model: Model, name: str) -> bool:
    """Whether an effect repeats with an angle, so that it takes orders."""
    return name not in plugins() and find(name, model.balance).over is not None


def over_orders(model: Model, names: Sequence[str], before: Fitted) -> Model:
    """The model with the effects over the orders that stand out of what the rest of it leaves, those of another form of
    a ripple as the diagnosis offers that: over the ripple's."""
    for name in names:
        own, had = find(name, model.balance), [term.effect for term in before.solution.terms]
        ripple = [further(effect) for effect in had if effect.name == own.waves_of]
        ripple = ripple or [find(own.waves_of, model.balance)] if own.waves_of else []
        rows = offered([own, *ripple], before.solution, before.problem)
        effect, row = grown(next((found for found in rows if found.name == name), own), before), model.effect(name)
        if row is not None and effect.waves != own.waves:
            model = model.with_effect(replace(row, waves=effect.waves))
    return model


def grown(effect: Effect, before: Fitted) -> Effect:
    """An effect with the orders that are seen only beside its own, the stiffness beside an error of the angles being
    found; as it is where these take next to nothing."""
    if effect.over is None:
        return effect
    problem, state = before.problem, before.problem.state
    alone = fit_terms(problem, [*before.solution.terms, Term(effect, effect.start)])
    more = with_orders(further(effect), alone, problem)
    problem.restore(state)  # beside one order alone the stiffness may have gone
    wider = effect if more is None else effect.over(in_order((*effect.waves, *more.waves), effect))
    both = fit_terms(problem, [*before.solution.terms, Term(wider, wider.start)]) if more is not None else alone
    problem.restore(state)
    return wider if falls(alone, both) else effect


def over_further_orders(model: Model, names: Sequence[str], before: Fitted) -> Model:
    """The model with the effects over further orders beside their own. Raises `ModelError` where none stands out."""
    for name in names:
        row = model.effect(name)
        assert row is not None
        effect = resolve(row, model.balance)
        more = with_orders(further(effect), before.solution, before.problem)
        if more is None:
            raise ModelError(f"{name}: the model has it already, and no further order stands out of what is left")
        model = model.with_effect(replace(row, waves=in_order((*effect.waves, *more.waves), effect)))
    return model


def extended(larger: Model, before: Fitted, recordings: Sequence[Recorded]) -> Fitted:
    """The larger model fitted, from the best of where its grids and the diagnosis of the smaller one begin; from the
    latter too where a fit that found nothing new leaves little, as the smaller one did."""
    after = fit(recordings, begun_well(larger, before))
    if after.solution.rmse < NOISE_LEFT * after.floor and helps(before, after):
        return after
    written = any(row.expression for row in larger.effects if before.model.effect(row.name) is None)
    found = None if written else diagnosed(larger, before, recordings)
    return found if found is not None and found.solution.rmse < after.solution.rmse else after


def remove_effect(model: Model, name: str, recordings: Sequence[Recorded], recording_name: str = "") -> StructureChange:
    """The model without `name`, refitted, and what that did. Raises `BadInput`."""
    warnings = examine(recordings, model)
    smaller = without(model, name)
    before, after = fit(recordings, model), fit(recordings, smaller)
    return _changed(f"remove {name}", name, before, after, recording_name, warnings)


def without(model: Model, name: str) -> Model:
    """The model less one effect, or several joined with `+`. Raises `ModelError`."""
    for part in name.split("+"):
        if model.effect(part) is None:
            raise ModelError(f"{part}: the model does not have it: {meant(part, [row.name for row in model.effects])}")
        model = model.without(part)
    if not model.effects:
        raise ModelError(f"{name}: nothing would be left of the model: expected another effect beside it")
    return model


def _changed(
    change: str, name: str, before: Fitted, after: Fitted, recording_name: str, warnings: Sequence[str]
) -> StructureChange:
    """The lineage gains a line for the model before, if it has none for it, and one for the model after."""
    lineage = list(before.model.lineage) or [Version("fit", recording_name, before.nrmse)]
    lineage.append(Version(change, recording_name, after.nrmse))
    return StructureChange(
        name,
        replace(after.model, lineage=tuple(lineage)),
        error_of(before),
        error_of(after),
        moved(before, after),
        helps(before, after),
        (*warnings, *after.problem.remarks, *lag_remarked(after.solution, after.problem)),
    )


def helps(before: Fitted, after: Fitted) -> bool:
    """Whether the held-out error falls beyond chance, and by enough to be worth an effect's numbers: as a diagnosis
    asks it."""
    known, found = before.solution, after.solution
    if len(before.problem.target) != len(after.problem.target):  # a torque that is moved may lose samples
        known = fit_terms(after.problem, terms_of(before.model, after.problem))
    if falls(known, found):
        return True
    new = tuple(name for name in found.names if name not in known.names)
    base, larger = Hypothesis((), known, before.floor), Hypothesis(new, found, after.floor)
    return after.model.balance == "drive" and likely(base, larger, after.problem)


def diagnosed(larger: Model, before: Fitted, recordings: Sequence[Recorded]) -> Fitted | None:
    """The larger model fitted on from where the diagnosis of the smaller one finds what is new; None where it does
    not find it, or where a fit needs no start: an effect without shapes, which is not simulated, has one minimum."""
    new = {row.name for row in larger.effects if before.model.effect(row.name) is None}
    effects = [find(name, larger.balance) for name in new if name not in plugins()]
    if not any(effect.free_shapes or effect.in_loop for effect in effects):
        return None
    for alone in (True, False):
        search, found = searched(recordings, before.model, wanted=new, alone=alone)
        start = next((row for row in found if set(row.added) == new), None)
        if start is not None:
            return fit_from(larger, search.regression, start.solution)
    return None


def begun_well(larger: Model, before: Fitted) -> Model:
    """The larger model with the shapes of what is new where the best point of their grids comes to rest, on a stretch
    and in the loop where they can be simulated: a search that starts elsewhere may settle elsewhere. What has no shapes
    is there first, of the rest what explains most."""
    problem, solution = before.problem, before.solution
    if "linear_stiffness" not in solution.names:
        return larger
    new = _new(larger, before)
    plain = [Term(effect, effect.start) for effect in new if not effect.free_shapes]
    terms = lagging([*solution.terms, *plain], problem)
    if len(terms) > len(solution.terms):
        solution = fit_terms(problem, terms)
    shaped = [effect for effect in new if effect.free_shapes]
    part = stretch_of(problem)
    while shaped:
        found = [_best_start(effect, solution, problem, part, before.floor) for effect in shaped]
        best = min(found, key=lambda row: (row.level, row.error(problem)))
        solution, effect = best.solution, best.solution.terms[-1].effect
        larger = _with_shapes(larger, effect, best.shapes)
        shaped.remove(effect)
    return larger


@dataclass(frozen=True, slots=True)
class _Start:
    """A point of an effect's grid, and what it came to on a part of the recording."""

    solution: Solution
    """at that point, on all"""
    level: float
    """error in noise floors where it came to rest; below the noise nothing is better than anything else"""
    rested: Solution
    """its numbers there"""

    @property
    def shapes(self) -> Mapping[str, float]:
        """Of what was added last, where it came to rest."""
        return self.rested.terms[-1].shapes

    @np.errstate(over="ignore", invalid="ignore")
    def error(self, problem: RegressionProblem) -> float:
        """Mean square on all of the recording, of what came to rest on a part of it; infinite where it runs away."""
        if self.rested is self.solution:
            return self.solution.rmse**2
        loop = Structure(problem, self.rested)
        error = float(np.mean((problem.target - loop.modelled(loop.point, derive=False)[0]) ** 2))
        return error if math.isfinite(error) else math.inf


def _best_start(
    effect: Effect, solution: Solution, problem: RegressionProblem, part: RegressionProblem, floor: float
) -> _Start:
    """Of the grid's points that come to rest alike, a corner that is not met on the stretch, say, all of the recording
    tells the best."""
    rows = [_rested(part, start, floor) for start in _starts(effect, solution, problem)]
    least = min(row.level for row in rows)
    return min((row for row in rows if row.level <= ALIKE * least), key=lambda row: row.error(problem))


def _new(larger: Model, before: Fitted) -> list[Effect]:
    """The catalogued effects that only the larger model has, and that the recording can show."""
    motion = before.problem.trials[0].motion
    rows = [row for row in larger.effects if before.model.effect(row.name) is None and row.expression is None]
    effects = [resolve(row, larger.balance, tuple(motion.extra)) for row in rows]
    return [effect for effect in effects if all(measured(motion, need) for need in effect.needs)]


def _starts(effect: Effect, onto: Solution, problem: RegressionProblem) -> list[Solution]:
    """The solution with the effect, at each point of the effect's grid."""
    out = []
    for shapes in grid(effect, problem):
        columns = np.hstack((onto.columns, problem.columns(effect, shapes)))
        out.append(problem.solution([*onto.terms, Term(effect, shapes)], columns))
    return out


def _rested(part: RegressionProblem, start: Solution, floor: float) -> _Start:
    """The loop at rest on a part of the recording, where there is something to simulate. Where it would take up any
    torque, or has taken the spring's place, there is no explanation."""
    floor = max(floor, LEAST_FLOOR)
    if not lawful(start.terms) or not start.amplitude(*STIFFNESS) > 0:
        return _Start(start, start.rmse / floor, start)
    loop = on_stretch(part, start)
    rested = at_rest(start, loop)
    spring = rested.terms[rested.names.index(STIFFNESS[0])].effect
    carried = rested.amplitude(*STIFFNESS) > least_stiffness(part, spring)
    level = shown(loop.rms / floor, identifiability(part, rested)) if carried else math.inf
    return _Start(start, max(level, 1.0), rested)


def _with_shapes(model: Model, effect: Effect, shapes: Mapping[str, float]) -> Model:
    known = {row.name: FittedParameter(shapes[row.name], np.nan, row.unit, False) for row in effect.free_shapes}
    rows = [replace(row, parameters={**row.parameters, **known}) if row.name == effect.name else row
            for row in model.effects]  # fmt: skip
    return replace(model, effects=tuple(rows))


def moved(before: Fitted, after: Fitted) -> tuple[Moved, ...]:
    """Parameters of both models that changed beyond chance, or that only one of them determines."""
    rows = []
    for effect in before.model.effects:
        row = after.model.effect(effect.name)
        for name, old in effect.parameters.items() if row is not None else ():
            new = row.parameters.get(name, old) if row is not None else old
            sd = min((sd for sd in (old.sd, new.sd) if math.isfinite(sd)), default=0.0)
            if abs(new.value - old.value) > MOVED_SD * sd or new.identified != old.identified:
                rows.append(Moved(effect.name, name, old, new))
    return tuple(rows)
