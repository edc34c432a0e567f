"""Which orders an effect that repeats is tried with: those that stand out of what is left, few at a time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from edge_daemon.effects.drive_waves import LOAD, leads
from edge_daemon.effects.effect import Effect, Wave
from edge_daemon.effects.order_names import per_output_turn
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import Solution
from edge_daemon.motion.left_over import LeftOver
from edge_daemon.motion.order_spectrum import OrderSamples
from edge_daemon.records import Array
from edge_daemon.search.line_names import FoundLine, strongest_of
from edge_daemon.search.wave_search import FURTHER, MOST_LINES, Lacking, WaveSearch, is_further

LEAST_PERIODS = 0.5
"""Periods of a wave that the output must pass for it to come after the usual ones (guess: on 0.12 of one any curve of a
tone's twist was taken for an error of the encoder, and arms showed theirs on 0.9)."""


def lines(residual: Array, problem: RegressionProblem, fitted: Array) -> Iterator[FoundLine]:
    """The lines of a residual (m,) that the columns `fitted` (m, p) left, the strongest first, each taken out before
    the next is looked for."""
    scale, left = problem.order_scale(("",)), LeftOver.of(residual, fitted)
    for _ in range(MOST_LINES):
        found = strongest_of(OrderSamples(scale, left), problem.motions[0].ratio)
        if found is None:
            return
        yield found
        wave = found.line.order * scale.angle_rad
        left = left.beside(np.stack((np.sin(wave), np.cos(wave)), axis=1))


def further(effect: Effect) -> Effect:
    """An effect that a model has already, as a candidate for orders beside its own."""

    def over(waves: tuple[Wave, ...]) -> Effect:
        assert effect.over is not None
        return replace(effect.over(waves), name=effect.name + FURTHER, over=over)

    return over(effect.waves)


def plain(name: str) -> str:
    """The name of an effect, be it for further orders."""
    return name.removesuffix(FURTHER)


def offered(
    effects: Sequence[Effect], onto: Solution, problem: RegressionProblem, to_leave: float = 1.0
) -> list[Effect]:
    """The effects, those that repeat over the waves that stand out of what a solution leaves; as they are where their
    own suffice. What has its waves already is left out where none is new, and what cannot leave so small a share of the
    rms; and what grows with the load where its line takes less than that of the ripple which it yields to. Other
    forms of one repeat as that does, where the solution has it or a line stands out."""
    lacking = Lacking(onto, problem)
    carriers = {effect.name: effect.carriers for effect in effects}
    own = [effect for effect in effects if not effect.waves_of and not _outdone(effect, carriers, lacking)]
    worth = [effect for effect in own if effect.over is None or lacking.may_leave(to_leave, effect)]
    found = [with_orders(effect, onto, problem, lacking) for effect in worth]
    rows = [effect for effect in found if effect is not None]
    had = [term.effect for term in onto.terms]
    heard = {plain(effect.name) for effect in rows if lacking.first.get(effect.carriers) is not None}
    heard |= {effect.name for effect in had}
    forms = [form for form in effects if form.waves_of in heard]
    return rows + [_another(form, [*rows, *had], WaveSearch(form, lacking)) for form in forms]


def _outdone(effect: Effect, carriers: Mapping[str, tuple[str, ...]], lacking: Lacking) -> bool:
    """Whether the line that stands out most takes more as a ripple that is offered too than as one of the load."""
    usual = [carriers[name] for name in effect.yields_to if name in carriers]
    if not usual or LOAD not in effect.carriers or lacking.problem.motions[0].transmitted_Nm is None:
        return False
    own, *others = (lacking.first_line(row) for row in (effect.carriers, *usual))
    return own is not None and any(other is not None and other.line.fall > own.line.fall for other in others)


def _another(form: Effect, beside: Sequence[Effect], look: WaveSearch) -> Effect:
    """An effect that repeats as another does, with the waves that this is offered with, or has, where it hears them."""
    assert form.over is not None
    same = [effect.waves for effect in beside if plain(effect.name) == form.waves_of]
    return form.over(in_order(look.heard(tuple(dict.fromkeys(itertools.chain(*same)))), form))


def with_orders(
    effect: Effect, onto: Solution, problem: RegressionProblem, lacking: Lacking | None = None
) -> Effect | None:
    """One effect as `offered`. Lines that overlap hide each other, so that the search begins with the effect's own
    waves as well where one of them may be hidden."""
    if effect.over is None:
        return effect
    lacking = Lacking(onto, problem) if lacking is None else lacking
    if not lacking.may_leave(1.0, effect):
        return None
    if effect.balance != "drive" or effect.loaded or leads(effect):  # a solution tells what carries its waves
        return _with_orders(effect, lacking)
    laws = tuple((term.effect.key, *term.shapes.values()) for term in onto.terms)
    key = effect.name, effect.key, laws, onto.rmse
    if key not in problem.asked:
        made = _with_orders(effect, lacking)
        problem.asked[key] = made, {row: line for row, line in lacking.first.items() if row == effect.carriers}
    found: Effect | None
    found, first = problem.asked[key]
    lacking.first.update(first)
    return found


def _with_orders(effect: Effect, lacking: Lacking) -> Effect | None:
    """The same, looked for."""
    look = WaveSearch(effect, lacking)
    found = look.run(())
    if not found.waves and (evening := look.evening) is not None:
        look = WaveSearch(effect, lacking, evening)
        found = look.run(())
    own = set(effect.waves)
    assert effect.over is not None
    if is_further(effect):
        new = set(found.waves or _later(effect, lacking.problem)) - own
        return effect.over(in_order(new, effect)) if new else None
    best = found
    if not set(found.waves) <= own and look.may_hide(own, found.waves):
        best = min(found, look.run(effect.waves), key=lambda row: row.price)
    waves = effect.waves if set(best.waves) <= own else best.waves
    waves += look.needed(waves, [wave for wave in _later(effect, lacking.problem) if wave not in waves])
    return effect if set(waves) <= own else effect.over(in_order(waves, effect))


def _later(effect: Effect, problem: RegressionProblem) -> list[Wave]:
    """The waves that come after an effect's usual ones, as far as the output passes enough of a period: a small part of
    one is any curve."""
    turns = float(np.ptp(np.concatenate([motion.theta_out_rad for motion in problem.motions]))) / (2 * math.pi)
    return [wave for wave in effect.later if per_output_turn(wave, problem.motions[0].ratio) * turns > LEAST_PERIODS]


def in_order(waves: Iterable[Wave], effect: Effect) -> tuple[Wave, ...]:
    """Waves of an effect's own angle first, each angle's orders rising."""
    home = effect.waves[0].angle
    return tuple(sorted(set(waves), key=lambda wave: (wave.angle != home, wave)))
