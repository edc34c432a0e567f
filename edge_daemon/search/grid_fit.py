"""One more effect at the best point of its grid, by least squares on the measured motion: what the search begins with.

Measurement effects correct the twist before torque effects are computed from it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from edge_daemon.effects.effect import Effect
from edge_daemon.effects.presliding import builds_up
from edge_daemon.identify.fit import MEASUREMENT_ROUNDS, carried_as_measured, come_to_rest
from edge_daemon.identify.load_fit import with_its_load
from edge_daemon.identify.regression import START_DAMPING_NMS_PER_RAD, START_STIFFNESS_NM_PER_RAD, RegressionProblem
from edge_daemon.identify.solution import DAMPING, STIFFNESS, Solution, Term
from edge_daemon.identify.structure import lawful
from edge_daemon.search.free_orders import offered
from edge_daemon.search.hypotheses import LEAST_FLOOR, DiagnosisProblem, Hypothesis

USUAL_DAMPING_S = START_DAMPING_NMS_PER_RAD / START_STIFFNESS_NM_PER_RAD
"""An error of the angles is first fitted with this damping over stiffness: what the model has without it may be that of
its own error, hundreds of times as much, and never find back."""
MOST_CALLS = 3
"""So often at most a search goes on from where a grid does better than it did."""
ROUNDS, TIED_ROUNDS = 1, 4
"""A refined fit takes so many rounds, the latter where shapes are tied to what is fitted."""


def grid_fit(problem: DiagnosisProblem, onto: Hypothesis, effect: Effect) -> Hypothesis:
    """One more effect, at the best point of its grid of shapes."""
    if effect.kind == "measurement" and not lawful(onto.solution.terms):
        solution = _repeated(problem, onto, effect)
    else:
        solution = _on_grid(problem, onto, effect)
    return problem.hypothesis((*onto.added, effect.name), solution, onto.identifiability)


def tried(problem: DiagnosisProblem, onto: Hypothesis, effects: Sequence[Effect], within: float) -> list[Hypothesis]:
    """Each effect on top of a hypothesis at the best point of its grid; of what repeats, whose orders are dear to find,
    only what may leave less than so many times what the best of the others does."""
    once = [effect for effect in effects if effect.over is None]
    tries = [grid_fit(problem, onto, effect) for effect in once]
    tries = [with_own_load(problem, h) if effect.steady else h for effect, h in zip(once, tries, strict=True)]
    least = min((h.error for h in tries if problem.carried(h)), default=math.inf)
    again = [effect for effect in effects if effect.over is not None]
    share = min(within * least / max(onto.error, 1e-300), 1.0)
    with_orders = offered(again, onto.solution, problem.regression, share)
    return tries + [grid_fit(problem, onto, effect) for effect in with_orders]


def with_own_load(problem: DiagnosisProblem, hypothesis: Hypothesis) -> Hypothesis:
    """A load that was added beside friction of the load fitted with that friction: on the grid it is still that of
    another load, what the load must leave of a model torque is not known yet, and a steady one is nothing new."""
    loaded = any(term.effect.loaded for term in hypothesis.solution.terms)
    load = problem.known[hypothesis.added[-1]].carried
    return refined(problem, hypothesis) if load and loaded else hypothesis


def _repeated(problem: DiagnosisProblem, onto: Hypothesis, effect: Effect) -> Solution:
    """An error of the angles, fitted anew as often as it corrects the twist; from the usual stiffness where the spring
    carries nothing of the torque, since that error hides it. Where the repetition loses the spring, as beside friction
    that the model lacks, one step of it."""
    regression, state = problem.regression, problem.regression.state
    terms = [*onto.solution.terms, Term(effect, effect.start)]
    if not problem.carried(onto):
        regression.tied[STIFFNESS] = START_STIFFNESS_NM_PER_RAD
    for rounds in (MEASUREMENT_ROUNDS, 1):
        start = regression.tied[STIFFNESS]
        regression.tied[DAMPING] = start * USUAL_DAMPING_S
        solution = regression.fit(terms, search=False, rounds=rounds)
        if problem.sprung(solution.terms, solution.amplitude(*STIFFNESS)):
            break
        regression.restore(state)
        regression.tied[STIFFNESS] = start
    regression.restore(state)
    return solution


def _on_grid(problem: DiagnosisProblem, onto: Hypothesis, effect: Effect) -> Solution:
    """The best point by the error of a fit to all, of those that may be if any may: the shapes of a filter are told
    sharply, and beside them its size is far off. Blocks are held out at the best only."""
    regression, floor = problem.regression, problem.floor
    points = grid(effect, regression)

    def at(shapes: Mapping[str, float]) -> Solution:
        columns = np.hstack((onto.solution.columns, regression.kept_columns(effect, shapes)))
        return regression.solution([*onto.solution.terms, Term(effect, shapes)], columns, whole=len(points) > 1)

    if len(points) == 1:
        return at(points[0])

    def astray(solution: Solution) -> bool:
        return effect.filters is not None and problem.outweighs(solution.terms[-1], solution)

    best = min(map(at, points), key=lambda s: (astray(s), s.rmse / max(floor(s), LEAST_FLOOR)))
    return regression.solution(best.terms, best.columns)


def refined(problem: DiagnosisProblem, hypothesis: Hypothesis) -> Hypothesis:
    """Shapes searched, ties and corrections repeated; never worse than before, but where the columns of the grid are
    those of another model. What the loop can carry waits, but for what the measured twist carries as well. Stories that
    meet search the same once, and nothing is searched again where it came to."""
    done, key = problem.refined, _where(problem, hypothesis)
    if key not in done:
        done[key] = _refined(problem, hypothesis)
        done[_where(problem, done[key])] = done[key]
    return done[key]


def _where(problem: DiagnosisProblem, hypothesis: Hypothesis) -> tuple[object, ...]:
    """What a search goes on from."""
    rows = tuple((term.effect.key, *term.shapes.items()) for term in hypothesis.solution.terms)
    return hypothesis.added, rows, hypothesis.error, tuple(problem.regression.tied.items())


def _refined(problem: DiagnosisProblem, hypothesis: Hypothesis) -> Hypothesis:
    regression, terms = problem.regression, hypothesis.solution.terms
    if lawful(terms) and not carried_as_measured(regression, terms):
        return hypothesis
    told = builds_up([term.effect for term in terms]) or any(term.effect.loaded for term in terms)
    repeated = told or any(term.effect.tied for term in terms)
    state = regression.state
    if repeated:
        regression.learn(hypothesis.solution)
    solution, terms = hypothesis.solution, _called_back(problem, hypothesis.added, hypothesis.solution)
    for _ in range(MOST_CALLS):
        solution = with_its_load(regression, regression.fit(terms, rounds=TIED_ROUNDS if repeated else ROUNDS))
        terms = _called_back(problem, hypothesis.added, solution)
        if terms == solution.terms:
            break
    regression.restore(state)
    better = problem.hypothesis(hypothesis.added, solution, hypothesis.identifiability)
    return better if moves_with_fit(terms) else min(hypothesis, better, key=lambda h: h.error)


def moves_with_fit(terms: Sequence[Term]) -> bool:
    """Whether columns are those of the very fit: of the load that it makes, or of the twist that a law bends at and an
    error of the angles moves."""
    told = builds_up([term.effect for term in terms]) or any(term.effect.loaded for term in terms)
    return told or (lawful(terms) and any(term.effect.is_angle_error for term in terms))


def rested(problem: DiagnosisProblem, hypothesis: Hypothesis) -> Hypothesis:
    """The same of one encoder with several shapes, which pull at each other, or several elements that slip: searched as
    long as that takes more, as a fit is; never worse than before."""
    regression, terms = problem.regression, hypothesis.solution.terms
    shapes = sum(len(term.effect.searched_shapes) for term in terms)
    several = shapes > 1 or any(len(term.effect.slips) > 1 for term in terms)
    several |= any(row.choices for term in terms for row in term.effect.shapes)
    if not several or any(term.effect.balance != "drive" for term in terms):
        return hypothesis
    state = regression.state
    regression.learn(hypothesis.solution)
    solution = with_its_load(regression, come_to_rest(regression, hypothesis.solution))
    regression.restore(state)
    return min(hypothesis, problem.hypothesis(hypothesis.added, solution), key=lambda h: h.error)


def _called_back(problem: DiagnosisProblem, added: Collection[str], solution: Solution) -> tuple[Term, ...]:
    """The terms, each shape that the model had before where its grid does better: without what is added it may have
    gone far astray, and a search from there would not find back."""
    had = [t.effect.name for t in solution.terms if t.effect.free_shapes and t.effect.balance == "drive"]
    if not set(had) - set(added):
        return solution.terms
    best, at = problem.regression.solution(solution.terms, solution.columns, whole=True), 0
    for i, term in enumerate(best.terms):
        width = len(term.effect.amplitudes)
        old = term.effect.name in had and term.effect.name not in added
        for shapes in grid(term.effect, problem.regression) if old else ():
            columns = best.columns.copy()
            columns[:, at : at + width] = problem.regression.kept_columns(term.effect, shapes)
            terms = (*best.terms[:i], Term(term.effect, {**term.shapes, **shapes}), *best.terms[i + 1 :])
            best = min(best, problem.regression.solution(terms, columns, whole=True), key=lambda s: s.rmse)
        at += width
    return best.terms


def grid(effect: Effect, regression: RegressionProblem) -> list[dict[str, float]]:
    """Where the search for an effect's free shapes looks first."""
    empty = {row.asks for row in effect.shapes if row.asks and getattr(regression.motions[0], row.asks) is None}
    rows = [row for row in effect.free_shapes if row.asks not in empty]
    axes = []
    for row in rows:
        unit = 1.0
        if row.scale:
            column = getattr(regression.motions[0], row.scale)
            unit = math.sqrt(float(np.mean(column**2)))
        axes.append([min(max(unit * g, row.lower), row.upper) for g in row.grid] or [row.start])
    return [dict(zip([row.name for row in rows], point, strict=True)) for point in itertools.product(*axes)]
