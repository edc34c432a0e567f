"""What is missing: every catalogued effect tried on held-out blocks, with what cannot be told apart.

The verdict is `adequate` when nothing improves the held-out error beyond chance, `missing` when an effect or a pair
does and most of the error goes, `unexplained` when structure is left that no effect removes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from edge_daemon.balance.twist_zero import locked
from edge_daemon.effects import plugin
from edge_daemon.effects.catalogue import measured, of_balance
from edge_daemon.effects.effect import Effect
from edge_daemon.effects.model import Model, ModelEffect, ModelError
from edge_daemon.effects.torque_source import LOAD_SIDE, MOTOR_SIDE, OUTPUT_FRICTION
from edge_daemon.explain.apart import told_apart
from edge_daemon.explain.leaping_friction import (
    A_PART,
    AS_GOOD,
    FAR_BETTER,
    as_motors,
    better_of,
    by_motor,
    explains_lag,
    is_asked,
    least_left,
    may_be_motors,
    may_hide_zero,
    may_leap,
    told_beside,
    too_late,
    without_motors,
)
from edge_daemon.explain.plan import MotionLimits
from edge_daemon.explain.plausibility import examine
from edge_daemon.explain.results import Diagnosis
from edge_daemon.explain.verdict import Verdict
from edge_daemon.identify.fit import fit_terms, floor_of
from edge_daemon.identify.problem import problem_of, ready_once, terms_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import Solution, Term
from edge_daemon.identify.torque_lag import STEADY, ZERO, lag_remarked, lagging
from edge_daemon.records import Recorded
from edge_daemon.search.free_orders import further
from edge_daemon.search.hypotheses import LOAD_FRICTION, LOADS, NEAR_FLOOR, Hypothesis, Progress, without_level
from edge_daemon.search.search import Search
from edge_daemon.search.several import MOST_EFFECTS
from edge_daemon.search.thresholds import EXPLAINED_FLOORS

WAITING = frozenset(row.name for row in of_balance("drive") if row.refines and not row.loaded)
"""What waits for its plain form is weighed without it where nothing else is found: a joint that hardly moves never
slips, and dry friction alone is none of its laws."""
ROWS_PER_NUMBER = 4
"""Each number that an effect is fitted by needs so many samples that know the direction (guess)."""
LEAST_TURNS = 2.0
"""Turns of a motor below which nothing is seen to repeat with it: any curve of the angle would."""
NEAR_BEST, MOST_BESIDE = 1.3, 3
"""Explanations so near the best, and how many at most, beside which a torque may be seen to be late (guesses)."""
LEAST_WARMING_K = 1.0
"""Within this spread of the temperature no effect of it can be seen."""
TURNED = "speed_ripple"
"""What a late torque seems to be beside a ripple."""


def diagnose(
    recordings: Sequence[Recorded],
    model: Model,
    on_progress: Progress | None = None,
    limits: MotionLimits | None = None,
) -> Diagnosis:
    """What the model lacks on these recordings. Raises `BadInput` in one line.

    Several recordings share one structure and one set of parameters; selection then leaves one recording out. `limits`:
    of the motion that is proposed.
    """
    found = _found(recordings, model, on_progress, limits)
    if found.verdict != "unexplained":
        return found
    return replace(found, warnings=(*found.warnings, *told_apart(recordings, model)))


def _found(
    recordings: Sequence[Recorded], model: Model, on_progress: Progress | None, limits: MotionLimits | None
) -> Diagnosis:
    """The same of all recordings as one joint."""
    warnings, recordings = examine(recordings, model), ready_once(recordings)
    asked = partial(_diagnosis, recordings, warnings=warnings, on_progress=on_progress, limits=limits)
    if model.balance == "torsion":
        found = sensors_or_motors(asked, recordings, model)
        if may_leap(found, recordings, model):
            reached = FAR_BETTER * least_left(found)
            beside = asked(model.with_effect(ModelEffect(OUTPUT_FRICTION)), reached=reached)[1]
            return told_beside(found, beside, OUTPUT_FRICTION)
        if may_hide_zero(found, recordings, model):
            within = AS_GOOD if found.verdict == "unexplained" else A_PART
            beside = asked(model.with_effect(ModelEffect(STEADY)), reached=within * least_left(found))[1]
            return told_beside(found, beside, STEADY, within) if beside.verdict == "missing" else found
        return found
    search, first = asked(model)
    if first.verdict == "unexplained":
        _, again = asked(model, wanted=WAITING, earlier=search)
        return again if again.verdict == "missing" else first
    return first


def sensors_or_motors(
    asked: Callable[..., tuple[Search, Diagnosis]], recordings: Sequence[Recorded], model: Model
) -> Diagnosis:
    """What is missing if the torque is a sensor's or, where something speaks for that, the motor's: where that explains
    it, no more than two effects are looked for beside a sensor's."""
    other = asked(by_motor(model))[1] if may_be_motors(recordings, model) else None
    said = other if other is not None and other.verdict != "unexplained" else None
    reached = least_left(said) / A_PART if said else math.inf
    search, first = asked(model, most=2 if said else MOST_EFFECTS, reached=reached)
    if not is_asked(first, search.regression, search.base.solution):
        return first
    other = other or asked(by_motor(model))[1]
    rest = without_motors(as_motors(first, other, A_PART), first, recordings, model)
    late = too_late(search.base.solution)
    return rest or better_of(first, other, late, late and explains_lag(first, recordings))


def _diagnosis(
    recordings: Sequence[Recorded],
    model: Model,
    *,
    warnings: Sequence[str],
    on_progress: Progress | None,
    limits: MotionLimits | None,
    wanted: Collection[str] = (),
    most: int = MOST_EFFECTS,
    earlier: Search | None = None,
    reached: float = math.inf,
) -> tuple[Search, Diagnosis]:
    search, found = searched(recordings, model, on_progress, wanted, most, earlier, reached=reached)
    closest = min((search.base, *found), key=lambda h: h.error).solution  # what is missing may look like a lag
    remarks = (*search.regression.remarks, *lag_remarked(closest, search.regression))
    return search, Verdict(model, search, limits).diagnosis(found, (*warnings, *remarks))


def searched(
    recordings: Sequence[Recorded],
    model: Model,
    on_progress: Progress | None = None,
    wanted: Collection[str] = (),
    most: int = MOST_EFFECTS,
    earlier: Search | None = None,
    alone: bool = False,
    reached: float = math.inf,
) -> tuple[Search, list[Hypothesis]]:
    """The search for what the model lacks, and all that it found, best first; what is `wanted` waits for no plainer
    form, and `alone` nothing else is looked for; of a gear with two encoders `most` effects are told at once. An
    `earlier` search of the same that wanted less need not fit the same effects again; `reached`: error over the rms of
    the torque that another reading of it comes to. Raises `BadInput`."""
    if not model.effects:
        raise ModelError("effect: missing: expected at least one [[effect]] to start from")
    progress = on_progress or (lambda what, share: None)
    ready = ready_once(recordings)
    known = () if earlier is None else earlier.tried
    problem = earlier.regression if earlier is not None and known else problem_of(ready, model)
    search = _begun(problem, model, progress, wanted, alone)
    search.elsewhere = reached * problem.rms
    found = _run(search, partial(search.run, most, known))
    if model.balance == "drive" and may_be_late(search, found):
        sound = [h for h in found if search.carried(h)]
        near = [h.solution.terms for h in sound if h.error < NEAR_BEST * sound[0].error][:MOST_BESIDE]
        near += [rest for terms in near[:1] if (rest := _unturned(terms)) != terms]
        one = [h.solution.terms for h in sound if len(h.added) < 2][:1]
        again = problem_of(ready, model, [search.base.solution.terms, *near, *one], held_against=True)
        if again.late_s != problem.late_s:
            later = _begun(again, model, progress, wanted, alone)
            asked = sorted(found, key=lambda h: set(h.added) != set(wanted))
            moved = _run(later, partial(later.resumed, search, asked))
            if least_of(later, moved) < least_of(search, sound):
                return later, moved
    return search, found


def least_of(search: Search, found: Sequence[Hypothesis]) -> float:
    """Error of the best of a search, over the rms of its torque."""
    return min(h.error for h in (search.base, *found)) / search.regression.rms


def may_be_late(search: Search, found: Sequence[Hypothesis]) -> bool:
    """Whether a torque that is late may be what is left, or named: it sounds like noise, and like a second law beside
    one that leaves little, turns the phase of a ripple with the speed, and follows as what swings on a spring does."""
    if any(_unturned(h.solution.terms) != h.solution.terms or _swings(h) for h in found[:1]):
        return True
    levels = {h.added: h.error / search.floor(h.solution) for h in (search.base, *found)}
    alone = min(level for added, level in levels.items() if len(added) < 2)
    return min(levels.values()) > NEAR_FLOOR or NEAR_FLOOR < alone < EXPLAINED_FLOORS


def _swings(hypothesis: Hypothesis) -> bool:
    """Whether it adds what swings on a spring."""
    return any(term.effect.filters for term in hypothesis.solution.terms if term.effect.name in hypothesis.added)


def _unturned(terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """The terms without a ripple that grows with speed, where that may be how a late torque turns another."""
    turned = {term.effect.waves_of for term in terms} & {term.effect.name for term in terms}
    return tuple(term for term in terms if term.effect.name != TURNED or term.effect.waves_of not in turned)


def _run(search: Search, find: Callable[[], list[Hypothesis]]) -> list[Hypothesis]:
    """What a search finds of laws, its problem left as it was."""
    with np.errstate(over="ignore", invalid="ignore"):  # a step too far in the loop is seen by its error
        found = find()
    search.regression.restore(search.start)
    named = ((h, [term for term in h.solution.terms if term.effect.name in h.added]) for h in found)
    return [h for h, terms in named if not any(without_level(term, h.solution) for term in terms)]


def _begun(
    problem: RegressionProblem, model: Model, progress: Progress, wanted: Collection[str], alone: bool
) -> Search:
    """A search on recordings that are ready."""
    terms = lagging(terms_of(model, problem), problem)
    base = fit_terms(problem, terms)

    def floor(solution: Solution) -> float:
        return floor_of(problem, model, solution)

    later = _later(model, problem)
    waiting = waiting_effects(model, wanted) | {effect.name: beside for effect, beside in later}
    effects = [*_seen(model, problem, terms), *(effect for effect, _ in later)]
    effects = [effect for effect in effects if not alone or effect.name in wanted]
    return Search(problem, base, effects, floor, progress, waiting)


def missing_effects(
    model: Model, problem: RegressionProblem, terms: Sequence[Term] = (), wanted: Collection[str] = ()
) -> tuple[Effect, ...]:
    """The effects that the model lacks and the recordings could show, plugins included, but for those that wait.

    What repeats, and is among the `terms` of the model already, may lack further orders. In a drive balance a
    refinement waits for the plain forms that it refines, or another form of those: friction there is built up from
    simple to fine, but for what is `wanted`. What refines refinements alone waits for one of those, and what is rarer
    than plain load friction for a load beside the inertia.
    """
    waiting = waiting_effects(model, wanted)
    return tuple(effect for effect in _seen(model, problem, terms) if effect.name not in waiting)


def waiting_effects(model: Model, wanted: Collection[str] = ()) -> dict[str, tuple[str, ...]]:
    """Effects that wait, each for some plain forms that the model lacks."""
    if model.balance == "torsion":
        return {}
    rows, known = of_balance(model.balance), {row.name for row in model.effects}
    held = known.union(*(row.refines + row.yields_to for row in rows if row.name in known))
    finer = {row.name for row in rows if row.refines}
    waits_for = {row.name: set(_waits_for(row, finer)) - held for row in rows if row.name not in wanted}
    return {name: tuple(sorted(plain)) for name, plain in waits_for.items() if plain}


def _seen(model: Model, problem: RegressionProblem, terms: Sequence[Term]) -> tuple[Effect, ...]:
    """The effects that the model lacks and the recordings could show."""
    known = {row.name for row in model.effects}
    rows = [*of_balance(model.balance), *(plugin.load(name) for name in plugin.plugins())]
    motion = problem.trials[0].motion
    outside = any(row.is_outside and row.name in known for row in rows)
    loaded = any(row.loaded and row.name in known for row in rows)
    more = [further(term.effect) for term in terms if term.effect.over]
    turns = max(float(np.ptp(trial.motion.theta_in_rad[trial.rows])) for trial in problem.trials) / (2 * math.pi)
    held = all(locked(trial.motion.twist_rad, trial.motion.theta_out_rad) for trial in problem.trials)
    return tuple(
        effect
        for effect in (*rows, *more)
        if effect.balance == model.balance
        and effect.name not in known
        and all(measured(motion, need) for need in effect.needs)
        and all(source[0] in known for source in effect.tied.values())
        and _varies(effect, problem)
        and (turns >= LEAST_TURNS or not _turns_with_motor(effect))
        and not (held and (effect.name in LOAD_SIDE or effect.kind == "measurement"))
        and len(effect.amplitudes) < sum(trial.known for trial in problem.trials) / ROWS_PER_NUMBER
        and not (effect.name in LOAD_SIDE and (problem.trials[0].by_motor or MOTOR_SIDE.name in known))
        and effect is not MOTOR_SIDE
        and not (effect.name == STEADY and any(term.effect is ZERO for term in terms))
        and not (effect.loaded and effect.yields_to and not effect.waves and not outside)
        and (loaded or not (effect.carried and effect.steady))
    )


def _turns_with_motor(effect: Effect) -> bool:
    """Whether an effect repeats with the motor's turns."""
    return effect.over is not None and (effect.balance == "drive" or "theta_in_rad" in effect.needs)


def _later(model: Model, problem: RegressionProblem) -> list[tuple[Effect, tuple[str, ...]]]:
    """What is looked for only beside a load that the model lacks, or beside friction of one, each with what it waits
    for one of."""
    if model.balance != "drive":
        return []
    now, out = {row.name for row in _seen(model, problem, ())}, []
    for beside in (LOADS, LOAD_FRICTION):
        rows = _seen(model.with_effect(ModelEffect(beside[0])), problem, ())
        out += [(row, beside) for row in rows if row.name not in now and (row.loaded or row.carried)]
    return out


def _waits_for(effect: Effect, finer: Collection[str]) -> Collection[str]:
    """Plain forms that it refines; where it refines finer ones alone, those."""
    return set(effect.refines) - set(finer) or effect.refines


def _varies(effect: Effect, problem: RegressionProblem) -> bool:
    """A temperature effect needs a temperature that is not the same throughout."""
    if "temperature_degC" not in effect.needs:
        return True
    spread = [float(np.ptp(trial.motion.temperature_degC)) for trial in problem.trials]
    means = [float(np.mean(trial.motion.temperature_degC)) for trial in problem.trials]
    return max(max(spread), float(np.ptp(means))) > LEAST_WARMING_K
