"""Which orders an effect that repeats is tried with: those that stand out of what is left, few at a time.

A line of the order spectrum is one function of the motion on all three angles. It is given to the angle on which it is
said most briefly, among the orders that the data cannot tell from it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from edge_daemon.balance.evening import Evening, evening_of
from edge_daemon.effects.effect import Effect, Wave
from edge_daemon.effects.order_names import POLES, cause_of, known_waves, per_output_turn
from edge_daemon.identify.block_least_squares import free_sums, held_out
from edge_daemon.identify.order_spectrum import LEAST_TURNS, LineFit, OrderLine, OrderSamples, strongest
from edge_daemon.identify.regression import RegressionProblem, Solution, independent_samples
from edge_daemon.motion.residual_statistics import surely
from edge_daemon.records import Array, Motion

FURTHER = "~"
"""What ends the name of a candidate that gives further orders to an effect of the model."""
LOAD = "load"
"""The carrier that is the torque which passes the gear, without its sign."""
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
TEMPERED = 0.5
"""Power of a likelihood between two names of a line: a real line swells and fades, and neighbours pull at it, which
moves it by a quarter of its width (seen on a robot's wrist)."""
HELD = 0.5
"""Share of a line's power that a name must hold to be tried for it."""
APART = 2.0
"""Widths of a line within which another one without a known cause is how the first swells and fades over the turn of
the output, and is said as a whole order of that."""
WAVE_PRICE = 0.01
"""Relative squared error that a wave must remove to be preferred to fewer."""
SLOW = 0.25
"""Order per turn of the input below which nothing in a gear's input turns: whatever repeats so is the output's."""
SLOW_FALL = 0.3
"""Share of what is left that a slow wave must take: any curve of the output's angle holds some of each (guess)."""
LEAST_ORDER = 2
"""Order per turn of the output below which it is a weight."""
NEARBY = 1.5
"""Widths of a line within which a name is tried for it: lines that overlap move each other."""
PULLED = 0.5
"""Standard deviation of that move in widths: half of one is what no spectrum resolves (Rayleigh)."""
SPREAD = 3.0
"""Width of a line in orders of the output up to which whole orders of it are told apart at all (guess)."""
LEAST_LEFT = 1e-3
"""Power over that of now that a parabola is believed to leave: a part of it may fall below nought (guess)."""
EVENED_BELOW = 0.1
"""Error over the torque below which it is asked what slow errors hide: above, whole laws are missing (guess)."""
BESIDE, MOST_STEPS = 0.05, 5.0
"""Widths of a line to either side of a parabola for its order, and how many of them it reaches (guesses)."""
DECIMALS: dict[str, tuple[int, ...]] = {"input": (0, 1, 2, 3), "difference": (0, 1), "output": (0,)}
"""How finely an order of each angle may be said."""
DEARER = {"input": 0.0, "difference": 0.5, "output": 0.75}
"""Digits that an angle must save to be named before the input (guess)."""
DIGIT = math.log(10)
"""Logarithm of the odds that a digit costs: so many more names there are."""
KNOWN_CAUSE = 1.0
"""Digits that an order with a known cause saves (guess)."""


class FoundLine(NamedTuple):
    """A line and what it is called."""

    waves: tuple[Wave, ...]
    """what it may be, the most probable first"""
    line: OrderLine

    @property
    def wave(self) -> Wave:
        """What it is called."""
        return self.waves[0]


def lines(residual: Array, problem: RegressionProblem, fitted: Array) -> Iterator[FoundLine]:
    """The lines of a residual (m,) that the columns `fitted` (m, p) left, the strongest first, each taken out before
    the next is looked for."""
    ratio = problem.motions[0].ratio
    samples = samples_of(residual, problem, ("",), fitted)
    for _ in range(MOST_LINES):
        found = strongest_of(samples, ratio)
        if found is None:
            return
        yield found
        wave = found.line.order * samples.angle_rad
        columns = np.hstack((samples.fitted, np.sin(wave)[:, None], np.cos(wave)[:, None]))
        samples = samples._replace(residual=left_by(columns, residual), fitted=columns)


def strongest_of(samples: OrderSamples, ratio: float) -> FoundLine | None:
    """The line that stands out most, named."""
    line = strongest(samples)
    return None if line is None else FoundLine(named(line, samples, ratio), line)


def left_by(columns: Array, target: Array) -> Array:
    """(m,) what least squares over the columns (m, p) leaves of a target."""
    return np.asarray(target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0])


def samples_of(residual: Array, problem: RegressionProblem, carriers: Sequence[str], fitted: Array) -> OrderSamples:
    """What the spectrum of a residual (m,) beside `fitted` columns (m, p) is taken of."""

    def joined(of: Callable[[int], Array]) -> Array:
        return np.concatenate([of(i)[trial.rows] for i, trial in enumerate(problem.trials)])

    motions, first = problem.motions, problem.trials[0]
    speed = joined(lambda i: motions[i].velocity_out_rad_s) * motions[0].ratio / (2 * math.pi)
    fixed = {"": np.ones(len(speed)), "direction": np.sign(speed)}
    if LOAD in carriers:
        fixed[LOAD] = np.abs(joined(partial(_field, motions, "transmitted_Nm")))
    carried = [fixed[name] if name in fixed else joined(partial(_field, motions, name)) for name in carriers]
    angle = joined(lambda i: motions[i].theta_in_rad)
    return OrderSamples(
        residual,
        np.array(carried),
        angle,
        np.abs(speed),
        first.fir.cutoff_hz,
        first.motion.rate_hz,
        fitted,
        problem.ends,
    )


def _field(motions: Sequence[Motion], name: str, i: int) -> Array:
    return np.asarray(getattr(motions[i], name))


def named(line: OrderLine, samples: OrderSamples, ratio: float) -> tuple[Wave, ...]:
    """The waves that may be a line, the most probable first, as far as its neighbours' power tells."""
    fit = LineFit(samples, line.order)
    best, exact = fit.fall(line.order), Wave("input", round(line.order, 4))
    near = {*_round(line.order, ratio), *known_waves(ratio)}
    near = {wave for wave in near if abs(of_input(wave, ratio) - line.order) < NEARBY * fit.width}
    falls = {wave: fit.fall(of_input(wave, ratio)) for wave in {*near, exact}}

    def price(wave: Wave) -> float:
        lost = (best - falls[wave]) / line.usual
        return TEMPERED * lost + DIGIT * _length(wave, ratio) + _pulled(wave, line, fit.width, ratio)

    return tuple(sorted((wave for wave in falls if wave == exact or falls[wave] >= HELD * best), key=price))


def _pulled(wave: Wave, line: OrderLine, width: float, ratio: float) -> float:
    """What it costs that a line is not where a wave is: neighbours may have moved it by a part of its width."""
    return 0.5 * ((of_input(wave, ratio) - line.order) / (PULLED * width)) ** 2


def of_input(wave: Wave, ratio: float) -> float:
    """Order of a wave per turn of the input."""
    return per_output_turn(wave, ratio) / abs(ratio)


def _round(order: float, ratio: float) -> Iterator[Wave]:
    """Waves of few digits near an order of the input."""
    for angle, places in DECIMALS.items():
        own = order / of_input(Wave(angle, 1.0), ratio)
        for digits in places:
            if round(own, digits) > 0:
                yield Wave(angle, round(own, digits))


def _length(wave: Wave, ratio: float) -> float:
    """Digits that it takes to say a wave."""
    text = f"{wave.order:.6g}"
    part = text.partition(".")[2]
    digits = max(len(text.replace(".", "").lstrip("0")), len(part))
    return digits + DEARER[wave.angle] - KNOWN_CAUSE * _known(wave, ratio)


def _known(wave: Wave, ratio: float) -> bool:
    """Whether something in a gear turns so often."""
    cause = cause_of(wave, ratio, None)
    slow = wave.angle == "output" and of_input(wave, ratio) < SLOW
    poles = wave.angle == "input" and wave.order in POLES
    return slow or poles or (cause is not None and cause.angle == wave.angle)


def suits(effect: Effect, wave: Wave, ratio: float) -> bool:
    """Whether a wave may be of an effect: what is slower than anything in the input is of the output encoder alone, or
    of what turns with a joint that has one encoder, if it is no weight."""
    slow = of_input(wave, ratio) < SLOW
    if effect.balance == "drive" and slow:
        return wave.angle == "output" and wave.order >= LEAST_ORDER and LOAD not in effect.carriers
    return slow == (effect.waves[0].angle == "output")


def further(effect: Effect) -> Effect:
    """An effect that a model has already, as a candidate for orders beside its own."""

    def over(waves: tuple[Wave, ...]) -> Effect:
        assert effect.over is not None
        return replace(effect.over(waves), name=effect.name + FURTHER, over=over)

    return over(effect.waves)


def plain(name: str) -> str:
    """The name of an effect, be it for further orders."""
    return name.removesuffix(FURTHER)


def offered(effects: Sequence[Effect], onto: Solution, problem: RegressionProblem) -> list[Effect]:
    """The effects, those that repeat over the waves that stand out of what a solution leaves; as they are where their
    own suffice. What has its waves already is left out where none is new. Other forms of one repeat as that does, where
    the solution has it or a line stands out."""
    first: FirstLines = {}
    found = [with_orders(effect, onto, problem, first) for effect in effects if not effect.waves_of]
    rows = [effect for effect in found if effect is not None]
    had = [term.effect for term in onto.terms]
    heard = {plain(effect.name) for effect in rows if first.get(effect.carriers) is not None}
    heard |= {effect.name for effect in had}
    forms = [form for form in effects if form.waves_of in heard]
    return rows + [_another(form, [*rows, *had], WaveSearch(form, onto, problem, {})) for form in forms]


def _another(form: Effect, beside: Sequence[Effect], look: WaveSearch) -> Effect:
    """An effect that repeats as another does, with the waves that this is offered with, or has, where it hears them."""
    assert form.over is not None
    same = [effect.waves for effect in beside if plain(effect.name) == form.waves_of]
    return form.over(in_order(look.heard(tuple(dict.fromkeys(itertools.chain(*same)))), form))


def with_orders(
    effect: Effect, onto: Solution, problem: RegressionProblem, first: FirstLines | None = None
) -> Effect | None:
    """One effect as `offered`. Lines that overlap hide each other, so that the search begins with the effect's own
    waves as well as without."""
    if effect.over is None:
        return effect
    if LOAD in effect.carriers and problem.motions[0].transmitted_Nm is None:
        return None
    look = WaveSearch(effect, onto, problem, {} if first is None else first)
    found = look.run(())
    if not found.waves and (evening := look.evening) is not None:
        look = WaveSearch(effect, onto, problem, {}, evening)
        found = look.run(())
    own = set(effect.waves)
    if is_further(effect):
        new = set(found.waves or effect.later) - own
        return effect.over(in_order(new, effect)) if new else None
    if set(found.waves) <= own:
        return effect
    best = min(found, look.run(effect.waves), key=lambda row: row.price)
    return effect if set(best.waves) <= own else effect.over(in_order(best.waves, effect))


def is_further(effect: Effect) -> bool:
    """Whether it is a candidate for orders beside those that the model has."""
    return effect.name.endswith(FURTHER)


def in_order(waves: Iterable[Wave], effect: Effect) -> tuple[Wave, ...]:
    """Waves of an effect's own angle first, each angle's orders rising."""
    home = effect.waves[0].angle
    return tuple(sorted(set(waves), key=lambda wave: (wave.angle != home, wave)))


FirstLines = dict[tuple[str, ...], FoundLine | None]
"""By the carriers of an effect: the line that stands out most of what one solution leaves."""


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

    def __init__(
        self,
        effect: Effect,
        onto: Solution,
        problem: RegressionProblem,
        first: FirstLines,
        evened: Evening | None = None,
    ) -> None:
        self.first, self.evened = first, evened
        self.effect, self.problem, self.ratio = effect, problem, problem.motions[0].ratio
        self.base = self._even(onto.columns if onto.design is None else onto.design)
        self.left = self._even(problem.target - onto.modelled)
        self._columns: dict[Wave, Array] = {}
        beside = [term.effect.waves for term in onto.terms if term.effect.balance == "drive"]
        self.had = (*(effect.waves if is_further(effect) else ()), *itertools.chain(*beside))
        turns = np.ptp(np.concatenate([motion.theta_in_rad for motion in problem.motions])) / (2 * math.pi)
        self.width = 1 / max(float(turns), 1e-9)

    def _even(self, rows: Array) -> Array:
        """(m,) or (m, k) rows as they count."""
        if self.evened is None:
            return rows
        return self.evened.of(rows) if rows.ndim == 1 else np.stack([self.evened.of(row) for row in rows.T], axis=1)

    @property
    def evening(self) -> Evening | None:
        """What evens out the little that is left of a joint with one encoder, for ripple of the plain form."""
        if self.effect.balance != "drive" or "" not in self.effect.carriers:
            return None
        left = left_by(self.base, self.left)
        if _power(left) > EVENED_BELOW**2 * _power(self.problem.target):
            return None
        return evening_of(left, self.problem.trials)

    def run(self, begin: tuple[Wave, ...]) -> FoundWaves:
        """The waves that stand out one after the other beside some, and that blocks which they were not fitted to need:
        each by itself, or with those before it that did not, since lines that overlap are one only together."""
        columns, tried, waves = np.hstack((self.base, *map(self._of, begin))), begin, begin
        before, misses = self._held_out(columns), 0
        for _ in range(MOST_LINES):
            found = self._slow(columns) or (self._line(columns) if len(tried) else self._first())
            if found is None or len(waves) >= MOST_WAVES + len(begin) or misses > MOST_MISSES:
                break
            wave = self._followed(found, columns, tried)
            columns, tried = np.hstack((columns, self._of(wave))), (*tried, wave)
            after, misses = self._held_out(columns), misses + 1
            if not self._sayable(wave, tried[:-1]):
                before = after
            elif _fell(before, after, LEAST_T):
                waves, before, misses = tried, after, 0
        waves = tuple(wave for i, wave in enumerate(waves) if i < len(begin) or self._sayable(wave, waves[:i]))
        waves = self._renamed(waves)
        found_waves = FoundWaves(waves, self._held_out(np.hstack((self.base, *map(self._of, waves)))))
        return self._pruned(found_waves)

    def _sayable(self, wave: Wave, before: Sequence[Wave]) -> bool:
        """Whether a wave may be of this effect, and is one of its own or a whole order of the output beside one. What
        grows with the load is said of a wave of the model itself, not of how that swells over the output."""
        told = wave.angle == "output" and self.width * abs(self.ratio) < SPREAD
        told &= LOAD not in self.effect.carriers or not self._satellite(wave, ())
        return suits(self.effect, wave, self.ratio) and (told or not self._satellite(wave, before))

    def _first(self) -> FoundLine | None:
        """The first line of what the solution leaves, which is the same for every effect that is carried alike."""
        if self.effect.carriers not in self.first:
            self.first[self.effect.carriers] = self._line(self.base)
        return self.first[self.effect.carriers]

    def _line(self, columns: Array) -> FoundLine | None:
        """The line that stands out most of what some columns leave."""
        residual = left_by(columns, self.left)
        return strongest_of(samples_of(residual, self.problem, self.effect.carriers, columns), self.ratio)

    def _slow(self, columns: Array) -> FoundLine | None:
        """A wave of few periods over the output's travel that takes much of what some columns leave of a joint with one
        encoder: its broad line hides in those of its neighbours."""
        own = per_output_turn(Wave("input", 1.0), self.ratio)
        orders = [Wave("output", n) for n in range(math.ceil(LEAST_TURNS * own * self.width), math.ceil(SLOW * own))]
        orders = [wave for wave in orders if suits(self.effect, wave, self.ratio)]
        if not orders or self.effect.balance != "drive" or self.evened is not None:
            return None
        residual = left_by(columns, self.left)
        fit = LineFit(samples_of(residual, self.problem, ("",), columns), of_input(orders[-1], self.ratio))
        falls = [fit.fall(of_input(wave, self.ratio)) for wave in orders]
        top = int(np.argmax(falls))
        line = OrderLine(of_input(orders[top], self.ratio), falls[top], 1.0, 0.0)
        return FoundLine((orders[top],), line) if falls[top] > SLOW_FALL * _power(residual) else None

    def _renamed(self, waves: tuple[Wave, ...]) -> tuple[Wave, ...]:
        """The same waves, each located anew beside all others: those that were found later had pulled at it."""
        for i, wave in enumerate(waves):
            others = tuple(row for row in waves if row != wave)
            if self._satellite(wave, waves[:i]) or not any(self._near(wave, other) for other in others):
                continue
            columns = np.hstack((self.base, *map(self._of, others)))
            samples = samples_of(left_by(columns, self.left), self.problem, self.effect.carriers, columns)
            fit = LineFit(samples, of_input(wave, self.ratio))
            order = fit.sharpest()
            line = OrderLine(order, fit.fall(order), math.inf, 0.0)
            again = self._followed(FoundLine(named(line, samples, self.ratio), line), columns, ())
            waves = tuple(again if row == wave and again not in others else row for row in waves)
        return waves

    def _pruned(self, found: FoundWaves) -> FoundWaves:
        """Without the waves that the others can do without."""
        for wave in found.waves:
            fewer = tuple(row for row in found.waves if row != wave)
            less = FoundWaves(fewer, self._held_out(np.hstack((self.base, *map(self._of, fewer)))))
            least_t = SATELLITE_T if self._satellite(wave, fewer) else LEAST_T
            if not _fell(less.held_out, found.held_out, least_t):
                found = less
        return found

    def _of(self, wave: Wave) -> Array:
        """(m, k) columns of one wave."""
        if wave not in self._columns:
            assert self.effect.over is not None
            self._columns[wave] = self._even(self.problem.columns(self.effect.over((wave,)), {}))
        return self._columns[wave]

    def _near(self, wave: Wave, other: Wave) -> bool:
        return abs(of_input(wave, self.ratio) - of_input(other, self.ratio)) < APART * self.width

    def _satellite(self, wave: Wave, waves: Sequence[Wave]) -> bool:
        """Whether a wave is how one of others, or of the model's, swells and fades. A wave that the model has may
        grow with the load besides."""
        if wave in self.had and not is_further(self.effect):
            return False
        return not _known(wave, self.ratio) and any(self._near(wave, other) for other in (*self.had, *waves))

    def _followed(self, found: FoundLine, columns: Array, beside: Sequence[Wave]) -> Wave:
        """The most probable name of a line: by its likelihood, from so many samples as are independent, and by the
        digits that it takes. A gear that twists tells the angles apart, where their spectrum does not; and columns that
        passed the balance's filter tell an order more sharply than waves that did not."""
        left = self._left_of(columns)
        tries = set(found.waves[:MOST_TRIED])
        whole = {wave for wave in tries if wave.angle == "output" or not self._satellite(wave, beside)}
        price = self._prices(whole - set(beside) or tries, left, found.line.order)
        return self._sharpened(min(price, key=lambda wave: price[wave]), left)

    def heard(self, waves: tuple[Wave, ...]) -> tuple[Wave, ...]:
        """Waves of another form of the same ripple, each where this one hears it beside the others."""
        for wave in waves:
            others = [self._of(row) for row in waves if row != wave]
            again = self._sharpened(wave, self._left_of(np.hstack((self.base, *others))))
            waves = tuple(again if row == wave and again not in waves else row for row in waves)
        return waves

    def _sharpened(self, wave: Wave, left: Callable[[Wave], Array]) -> Wave:
        """A wave of that name, or of another where the columns put it, unless something turns so often."""
        order = None if _known(wave, self.ratio) else self._sharper(of_input(wave, self.ratio), left)
        if order is None:
            return wave
        price = self._prices({*_round(order, self.ratio), Wave("input", round(order, 4)), wave}, left, order)
        return min(price, key=lambda row: price[row])

    def _left_of(self, columns: Array) -> Callable[[Wave], Array]:
        """What a wave leaves of the residual beside some columns."""
        basis = np.linalg.qr(columns / (np.linalg.norm(columns, axis=0) + 1e-300))[0]

        def apart(rows: Array) -> Array:
            return np.asarray(rows - basis @ (basis.T @ rows))

        residual = apart(self.left)
        return lambda wave: left_by(apart(self._of(wave)), residual)

    def _looks(self, left: Array) -> float:
        """What a logarithm of power counts for."""
        return 0.5 * TEMPERED * independent_samples(left, self.problem)

    def _prices(self, tries: Iterable[Wave], left_of: Callable[[Wave], Array], order: float) -> dict[Wave, float]:
        """What each name of a line costs: its likelihood, its digits, and how far it is from where the line stands."""
        left = {wave: left_of(wave) for wave in sorted(tries)}
        looks = self._looks(min(left.values(), key=_power))
        line = OrderLine(order, 0.0, 1.0, 0.0)

        def price(wave: Wave) -> float:
            length = DIGIT * _length(wave, self.ratio) + _pulled(wave, line, self.width, self.ratio)
            return length + looks * math.log(_power(left[wave]))

        return {wave: price(wave) for wave in left}

    def _sharper(self, order: float, left_of: Callable[[Wave], Array]) -> float | None:
        """Where the power that is left is least, by a parabola through it, if a name there is worth a digit more."""
        step = BESIDE * self.width
        rows = [left_of(Wave("input", order + k * step)) for k in (-1, 0, 1)]
        low, middle, high = map(_power, rows)
        bent = low - 2 * middle + high
        if bent <= 0 or abs(moved := 0.5 * (low - high) / bent) > MOST_STEPS:
            return None
        least = max(middle - 0.25 * (low - high) * moved, LEAST_LEFT * middle)
        return order + moved * step if self._looks(rows[1]) * math.log(middle / least) > DIGIT else None

    def _held_out(self, columns: Array) -> Array:
        return np.asarray(held_out(free_sums(columns, self.left, self.problem.block), self.problem.fold))


def _power(residual: Array) -> float:
    return float(residual @ residual)


def _fell(before: Array, after: Array, least_t: float) -> bool:
    enough = float(after.sum()) < (1 - LEAST_FALL) * float(before.sum())
    return enough and surely(before, after) > least_t
