"""The waves that a solution lacks of one effect that repeats: what stands out of what is left, few at a time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from edge_daemon.balance.evening import Evening, evening_of
from edge_daemon.effects.drive_waves import LOAD
from edge_daemon.effects.effect import Effect, Wave
from edge_daemon.effects.order_names import per_output_turn
from edge_daemon.identify.block_least_squares import free_sums, held_out
from edge_daemon.identify.regression import RegressionProblem, independent_samples
from edge_daemon.identify.solution import Solution
from edge_daemon.motion.left_over import LeftOver
from edge_daemon.motion.order_spectrum import LineFit, OrderLine, OrderSamples, spectrum
from edge_daemon.motion.residual_statistics import surely
from edge_daemon.records import Array
from edge_daemon.search.line_names import (
    DIGIT,
    SLOW,
    TEMPERED,
    FoundLine,
    known_cause,
    length,
    named,
    per_input_turn,
    pulled,
    round_waves,
    strongest_of,
    suits,
    turns_so,
)

MOST_WAVES = 6
"""Most orders that one effect is given at a time (guess: a real joint showed five)."""
MOST_TRIED = 7
"""Most names of one line that are fitted to tell the angles apart."""
MOST_LINES = 9
"""Most lines that are looked at for them: some are another effect's."""
LEAST_FALL = 0.01
"""Share of what is left that a line must take to be worth its numbers (guess)."""
LEAST_T, SATELLITE_T = 2.0, 3.0
"""Block-wise t of the fall of the held-out error by a line, which has stood out of its neighbours beyond chance
already, and by one that only tells how another swells and fades."""
MOST_MISSES = 2
"""Lines in a row that are not believed, after which no other is looked for."""
APART = 2.0
"""Widths of a line within which another one without a known cause is how the first swells and fades over the turn of
the output, and is said as a whole order of that."""
WAVE_PRICE = 0.01
"""Relative squared error that a wave must remove to be preferred to fewer."""
SLOW_FALL = 0.3
"""Share of what is left that a slow wave must take: any curve of the output's angle holds some of each (guess)."""
LEAST_SLOW = 1.5
"""Periods that such a wave must pass (guess: below, it is a bend as other laws make it)."""
LEAST_BROKEN = 2.4
"""The same of a broken order, that nothing which goes round with the output makes (guess)."""
FINE = 0.25
"""Widths of a line between orders at which such a wave is looked for: a parabola reaches any between them."""
SPREAD = 3.0
"""Width of a line in orders of the output up to which whole orders of it are told apart at all (guess)."""
LEAST_LEFT = 1e-3
"""Power over that of now that a parabola is believed to leave: a part of it may fall below nought (guess)."""
EVENED_BELOW = 0.1
"""Error over the torque below which it is asked what slow errors hide: above, whole laws are missing (guess)."""
MOST_SHARPENED = 3
"""Parabolas for one order, one after the other: where its wave began a third of a width off one does not reach it."""
BESIDE, MOST_STEPS = 0.05, 5.0
"""Widths of a line to either side of a parabola for its order, and how many of them it reaches (guesses)."""


FURTHER = "~"
"""What ends the name of a candidate that gives further orders to an effect of the model."""


def is_further(effect: Effect) -> bool:
    """Whether it is a candidate for orders beside those that the model has."""
    return effect.name.endswith(FURTHER)


class Lacking:
    """What a solution leaves, and what every effect hears of it alike."""

    def __init__(self, onto: Solution, problem: RegressionProblem) -> None:
        self.onto, self.problem, self.ratio = onto, problem, problem.motions[0].ratio
        self.left = LeftOver.of(problem.target - onto.modelled, onto.columns if onto.design is None else onto.design)
        self.first: dict[tuple[str, ...], FoundLine | None] = {}
        """by the carriers of an effect, the line that stands out most"""

    def line(self, left: LeftOver, carriers: tuple[str, ...]) -> FoundLine | None:
        """The line that stands out most of what is left, for effects that are carried so."""
        return strongest_of(self.samples(left, carriers), self.ratio)

    def samples(self, left: LeftOver, carriers: tuple[str, ...]) -> OrderSamples:
        """What a spectrum is taken of."""
        return OrderSamples(self.problem.order_scale(carriers), left)

    def first_line(self, carriers: tuple[str, ...]) -> FoundLine | None:
        """The first line of what the solution leaves."""
        if carriers not in self.first:
            self.first[carriers] = self.line(self.left, carriers)
        return self.first[carriers]

    def may_leave(self, share: float, effect: Effect) -> bool:
        """Whether waves of an effect may leave no more than a share of the rms, were the largest of so many lines apart
        from each other; those of the output alone may be too slow for any spectrum."""
        if LOAD in effect.carriers and self.problem.motions[0].transmitted_Nm is None:
            return False
        if share >= 1.0 or effect.waves[0].angle == "output":
            return True
        most = sum(spectrum(self.left.signal, self.problem.order_scale(effect.carriers)).highest(MOST_WAVES))
        return self.left.power - most <= share**2 * self.left.power

    @cached_property
    def evening(self) -> Evening | None:
        """What evens out the little that is left; None where much is."""
        target = self.problem.target
        if self.left.power > EVENED_BELOW**2 * float(target @ target):
            return None
        return evening_of(self.left.signal, self.problem.trials)


class FoundWaves(NamedTuple):
    """Waves beside what a solution has, and what they leave."""

    waves: tuple[Wave, ...]
    held_out: Array
    """(b,) squared error of each block"""

    @property
    def price(self) -> float:
        """What to choose by: the logarithm of the held-out error, dearer for each wave."""
        return math.log(float(self.held_out.sum())) + WAVE_PRICE * len(self.waves)


class WaveSearch:
    """The waves of one effect that a solution lacks. `evened`: where each row counts for what it tells, so that slow
    errors of other laws do not hide a fast wave."""

    def __init__(self, effect: Effect, lacking: Lacking, evened: Evening | None = None) -> None:
        self.effect, self.lacking, self.evened = effect, lacking, evened
        self.problem, self.ratio = lacking.problem, lacking.ratio
        self.left = lacking.left
        if evened is not None:
            self.left = LeftOver.of(self._even(self.left.signal), self._even(self.left.basis))
        self._columns: dict[Wave, Array] = {}
        beside = [term.effect.waves for term in lacking.onto.terms if term.effect.balance == "drive"]
        self.had = (*(effect.waves if is_further(effect) else ()), *itertools.chain(*beside))
        turns = np.ptp(np.concatenate([motion.theta_in_rad for motion in self.problem.motions])) / (2 * math.pi)
        self.width = 1 / max(float(turns), 1e-9)

    def _even(self, rows: Array) -> Array:
        """(m,) or (m, k) rows as they count."""
        if self.evened is None:
            return rows
        return self.evened.of(rows) if rows.ndim == 1 else np.stack([self.evened.of(row) for row in rows.T], axis=1)

    @property
    def evening(self) -> Evening | None:
        """What evens out the little that is left of a joint with one encoder, for ripple of the plain form."""
        plain = self.effect.balance == "drive" and "" in self.effect.carriers
        return self.lacking.evening if plain else None

    def run(self, begin: tuple[Wave, ...]) -> FoundWaves:
        """The waves that stand out one after the other beside some, and that blocks which they were not fitted to need:
        each by itself, or with those before it that did not, since lines that overlap are one only together."""
        left, tried, waves = self._beside(begin), begin, begin
        before, misses = self._held_out(left), 0
        for _ in range(MOST_LINES):
            found = self._slow(left) or self._line(left, tried)
            if found is None or len(waves) >= MOST_WAVES + len(begin) or misses > MOST_MISSES:
                break
            wave = self._followed(found, left, tried)
            left, tried = left.beside(self._of(wave)), (*tried, wave)
            after, misses = self._held_out(left), misses + 1
            if not self._sayable(wave, tried[:-1]):
                before = after
            elif _fell(before, after, LEAST_T):
                waves, before, misses = tried, after, 0
                if (again := self._untangled(tried, len(begin))) != tried:
                    left, tried, waves = self._beside(again), again, again
                    before = self._held_out(left)
        waves = tuple(wave for i, wave in enumerate(waves) if i < len(begin) or self._sayable(wave, waves[:i]))
        waves = tuple(wave for i, wave in enumerate(self._renamed(waves)) if i < len(begin) or self._passed(wave))
        return self._pruned(FoundWaves(waves, self._held_out(self._beside(waves))))

    def needed(self, waves: tuple[Wave, ...], more: Sequence[Wave]) -> tuple[Wave, ...]:
        """Those of more waves that blocks which they were not fitted to need beside others, one after the other."""
        told: tuple[Wave, ...] = ()
        for wave in more:
            before, after = (self._held_out(self._beside((*waves, *told, *last))) for last in ((), (wave,)))
            told += (wave,) if _fell(before, after, LEAST_T) else ()
        return told

    def _untangled(self, waves: tuple[Wave, ...], known: int) -> tuple[Wave, ...]:
        """The waves, those of few periods over the output's travel where they are beside the newest: their broad lines
        pull at each other."""
        slow = [row for row in waves[known:-1] if per_input_turn(row, self.ratio) < SLOW]
        for wave in slow if self.effect.balance == "drive" else ():
            again = self._sharpened(wave, self._beside(row for row in waves if row != wave))
            waves = tuple(again if row == wave and again not in waves else row for row in waves)
        return waves

    def _beside(self, waves: Iterable[Wave]) -> LeftOver:
        """What is left beside some waves."""
        left = self.left
        for wave in waves:
            left = left.beside(self._of(wave))
        return left

    def _sayable(self, wave: Wave, before: Sequence[Wave]) -> bool:
        """Whether a wave may be of this effect, and is one of its own or a whole order of the output beside one. What
        grows with the load is said of a wave of the model itself, not of how that swells over the output."""
        told = wave.angle == "output" and self.width * abs(self.ratio) < SPREAD
        told &= LOAD not in self.effect.carriers or not self._satellite(wave, ())
        fits = self._passed(wave) and suits(self.effect, wave, self.ratio)
        return fits and (told or not self._satellite(wave, before))

    def _passed(self, wave: Wave) -> bool:
        """Whether enough periods of a wave of the output were seen: any curve of its angle is a part of one."""
        periods = per_input_turn(wave, self.ratio) / self.width
        return wave.angle != "output" or periods > (LEAST_BROKEN if wave.order % 1 else LEAST_SLOW)

    def _line(self, left: LeftOver, tried: Sequence[Wave]) -> FoundLine | None:
        """The line that stands out most of what is left beside some waves: of none it is the same for every effect that
        is carried alike."""
        carriers = self.effect.carriers
        return (
            self.lacking.line(left, carriers) if tried or self.evened is not None else self.lacking.first_line(carriers)
        )

    def _slow(self, left: LeftOver) -> FoundLine | None:
        """A wave of few periods over the output's travel that takes much of what is left of a joint with one encoder:
        its broad line hides in those of its neighbours."""
        own = per_output_turn(Wave("input", 1.0), self.ratio)
        least, step = LEAST_SLOW * own * self.width, max(round(FINE * own * self.width, 1), 0.1)
        orders = [Wave("output", round(float(n), 1)) for n in np.arange(math.ceil(least), SLOW * own, step)]
        orders = [wave for wave in orders if suits(self.effect, wave, self.ratio)]
        if not orders or self.effect.balance != "drive" or self.evened is not None:
            return None
        fit = LineFit(self.lacking.samples(left, ("",)), per_input_turn(orders[-1], self.ratio))
        falls = [fit.fall(per_input_turn(wave, self.ratio)) for wave in orders]
        top = int(np.argmax(falls))
        line = OrderLine(per_input_turn(orders[top], self.ratio), falls[top], 1.0, 0.0)
        return FoundLine((orders[top],), line) if falls[top] > SLOW_FALL * left.power else None

    def _renamed(self, waves: tuple[Wave, ...]) -> tuple[Wave, ...]:
        """The same waves, each located anew beside all others: those that were found later had pulled at it."""
        for i, wave in enumerate(waves):
            others = tuple(row for row in waves if row != wave)
            if self._satellite(wave, waves[:i]) or not any(self._near(wave, other) for other in others):
                continue
            left = self._beside(others)
            samples = self.lacking.samples(left, self.effect.carriers)
            fit = LineFit(samples, per_input_turn(wave, self.ratio))
            order = fit.sharpest()
            line = OrderLine(order, fit.fall(order), math.inf, 0.0)
            again = self._followed(FoundLine(named(line, samples, self.ratio), line), left, ())
            waves = tuple(again if row == wave and again not in others else row for row in waves)
        return waves

    def _pruned(self, found: FoundWaves) -> FoundWaves:
        """Without the waves that the others can do without."""
        for wave in found.waves:
            fewer = tuple(row for row in found.waves if row != wave)
            less = FoundWaves(fewer, self._held_out(self._beside(fewer)))
            least_t = SATELLITE_T if self._satellite(wave, fewer) else LEAST_T
            if not _fell(less.held_out, found.held_out, least_t):
                found = less
        return found

    def _of(self, wave: Wave) -> Array:
        """(m, k) columns of one wave."""
        if wave not in self._columns:
            assert self.effect.over is not None
            self._columns[wave] = self._even(self.problem.kept_columns(self.effect.over((wave,)), {}))
        return self._columns[wave]

    def _near(self, wave: Wave, other: Wave) -> bool:
        apart = per_input_turn(wave, self.ratio) - per_input_turn(other, self.ratio)
        return abs(apart) < APART * self.width

    def may_hide(self, waves: Iterable[Wave], found: Collection[Wave]) -> bool:
        """Whether any of some waves that were not found lies so near one that was that the two overlap."""
        missing = set(waves) - set(found)
        return any(self._near(wave, other) for wave in missing for other in found)

    def _satellite(self, wave: Wave, waves: Sequence[Wave]) -> bool:
        """Whether a wave is how one of others, or of the model's, swells and fades. A wave that the model has may
        grow with the load besides."""
        if wave in self.had and not is_further(self.effect):
            return False
        return not known_cause(wave, self.ratio) and any(self._near(wave, other) for other in (*self.had, *waves))

    def _followed(self, found: FoundLine, left: LeftOver, beside: Sequence[Wave]) -> Wave:
        """The most probable name of a line: by its likelihood, from so many samples as are independent, and by the
        digits that it takes. A gear that twists tells the angles apart, where their spectrum does not; and columns that
        passed the balance's filter tell an order more sharply than waves that did not."""
        tries = set(found.waves[:MOST_TRIED])
        tries = {wave for wave in tries if suits(self.effect, wave, self.ratio)} or tries
        whole = {wave for wave in tries if wave.angle == "output" or not self._satellite(wave, beside)}
        price = self._prices(whole - set(beside) or tries, left, found.line.order)
        return self._sharpened(min(price, key=lambda wave: price[wave]), left)

    def heard(self, waves: tuple[Wave, ...]) -> tuple[Wave, ...]:
        """Waves of another form of the same ripple, each where this one hears it beside the others."""
        for wave in waves:
            again = self._sharpened(wave, self._beside(row for row in waves if row != wave))
            waves = tuple(again if row == wave and again not in waves else row for row in waves)
        return waves

    def _sharpened(self, wave: Wave, left: LeftOver) -> Wave:
        """A wave of that name, or of another where the columns put it, unless something turns so often."""
        for _ in range(MOST_SHARPENED):
            order = None if turns_so(wave, self.ratio) else self._sharper(per_input_turn(wave, self.ratio), left)
            if order is None:
                break
            names = {*round_waves(order, self.ratio), Wave("input", round(order, 4))}
            names = {name for name in names if suits(self.effect, name, self.ratio)} or names
            price = self._prices({*names, wave}, left, order)
            before, wave = wave, min(price, key=lambda row: price[row])
            if wave == before:
                break
        return wave

    def _left_by(self, wave: Wave, left: LeftOver) -> Array:
        """(m,) what a wave leaves of what is left."""
        return left.left_by(self._of(wave))

    def _looks(self, left: Array) -> float:
        """What a logarithm of power counts for."""
        return 0.5 * TEMPERED * independent_samples(left, self.problem)

    def _prices(self, tries: Iterable[Wave], left: LeftOver, order: float) -> dict[Wave, float]:
        """What each name of a line costs: its likelihood, its digits, and how far it is from where the line stands."""
        rows = {wave: self._left_by(wave, left) for wave in sorted(tries)}
        looks = self._looks(min(rows.values(), key=_power))
        line = OrderLine(order, 0.0, 1.0, 0.0)

        def price(wave: Wave) -> float:
            digits = DIGIT * length(wave, self.ratio) + pulled(wave, line, self.width, self.ratio)
            return digits + looks * math.log(_power(rows[wave]))

        return {wave: price(wave) for wave in rows}

    def _sharper(self, order: float, left: LeftOver) -> float | None:
        """Where the power that is left is least, by a parabola through it, if a name there is worth a digit more."""
        step = BESIDE * self.width
        rows = [self._left_by(Wave("input", order + k * step), left) for k in (-1, 0, 1)]
        low, middle, high = map(_power, rows)
        bent = low - 2 * middle + high
        if bent <= 0 or abs(moved := 0.5 * (low - high) / bent) > MOST_STEPS:
            return None
        least = max(middle - 0.25 * (low - high) * moved, LEAST_LEFT * middle)
        return order + moved * step if self._looks(rows[1]) * math.log(middle / least) > DIGIT else None

    def _held_out(self, left: LeftOver) -> Array:
        return np.asarray(held_out(free_sums(left.basis, self.left.signal, self.problem.block), self.problem.fold))


def _power(residual: Array) -> float:
    return float(residual @ residual)


def _fell(before: Array, after: Array, least_t: float) -> bool:
    enough = float(after.sum()) < (1 - LEAST_FALL) * float(before.sum())
    return enough and surely(before, after) > least_t
