"""What a line of the order spectrum is called: it is one function of the motion on all three angles, and is given to
the angle on which it is said most briefly, among the orders that the data cannot tell from it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from edge_daemon.effects.drive_waves import LOAD
from edge_daemon.effects.effect import Effect, Wave
from edge_daemon.effects.order_names import POLES, cause_of, known_waves, per_output_turn
from edge_daemon.motion.order_spectrum import LineFit, OrderLine, OrderSamples, strongest

TEMPERED = 0.5
"""Power of a likelihood between two names of a line: a real line swells and fades, and neighbours pull at it, which
moves it by a quarter of its width (seen on a robot's wrist)."""
HELD = 0.5
"""Share of a line's power that a name must hold to be tried for it."""
SLOW = 0.25
"""Order per turn of the input below which nothing in a gear's input turns: whatever repeats so is the output's."""
LEAST_ORDER = 2
"""Order per turn of the output below which it is a weight."""
NEARBY = 1.5
"""Widths of a line within which a name is tried for it: lines that overlap move each other."""
PULLED = 0.5
"""Standard deviation of that move in widths: half of one is what no spectrum resolves (Rayleigh)."""
DECIMALS: dict[str, tuple[int, ...]] = {"input": (0, 1, 2, 3), "difference": (0, 1), "output": (0, 1)}
"""How finely an order of each angle may be said; of the output, where nothing in the input turns so slowly."""
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


def strongest_of(samples: OrderSamples, ratio: float) -> FoundLine | None:
    """The line that stands out most, named."""
    line = strongest(samples)
    return None if line is None else FoundLine(named(line, samples, ratio), line)


def named(line: OrderLine, samples: OrderSamples, ratio: float) -> tuple[Wave, ...]:
    """The waves that may be a line, the most probable first, as far as its neighbours' power tells."""
    fit = LineFit(samples, line.order)
    best, exact = fit.fall(line.order), Wave("input", round(line.order, 4))
    near = {*round_waves(line.order, ratio), *known_waves(ratio)}
    near = {wave for wave in near if abs(per_input_turn(wave, ratio) - line.order) < NEARBY * fit.width}
    falls = {wave: fit.fall(per_input_turn(wave, ratio)) for wave in {*near, exact}}

    def price(wave: Wave) -> float:
        lost = (best - falls[wave]) / line.usual
        return TEMPERED * lost + DIGIT * length(wave, ratio) + pulled(wave, line, fit.width, ratio)

    return tuple(sorted((wave for wave in falls if wave == exact or falls[wave] >= HELD * best), key=price))


def pulled(wave: Wave, line: OrderLine, width: float, ratio: float) -> float:
    """What it costs that a line is not where a wave is: neighbours may have moved it by a part of its width."""
    return 0.5 * ((per_input_turn(wave, ratio) - line.order) / (PULLED * width)) ** 2


def per_input_turn(wave: Wave, ratio: float) -> float:
    """Order of a wave per turn of the input."""
    return per_output_turn(wave, ratio) / abs(ratio)


def round_waves(order: float, ratio: float) -> Iterator[Wave]:
    """Waves of few digits near an order of the input."""
    for angle, places in DECIMALS.items():
        own = order / per_input_turn(Wave(angle, 1.0), ratio)
        for digits in places if angle != "output" or order < SLOW else places[:1]:
            if round(own, digits) > 0:
                yield Wave(angle, round(own, digits))


def length(wave: Wave, ratio: float) -> float:
    """Digits that it takes to say a wave."""
    text = f"{wave.order:.6g}"
    part = text.partition(".")[2]
    digits = max(len(text.replace(".", "").lstrip("0")), len(part))
    return digits + DEARER[wave.angle] - KNOWN_CAUSE * known_cause(wave, ratio)


def known_cause(wave: Wave, ratio: float) -> bool:
    """Whether something in a gear turns so often, or goes round with its output."""
    slow = wave.angle == "output" and wave.order % 1 == 0 and per_input_turn(wave, ratio) < SLOW
    return slow or turns_so(wave, ratio)


def turns_so(wave: Wave, ratio: float) -> bool:
    """Whether something in a gear turns so often."""
    cause = cause_of(wave, ratio, None)
    poles = wave.angle == "input" and wave.order in POLES
    return poles or (cause is not None and cause.angle == wave.angle)


def suits(effect: Effect, wave: Wave, ratio: float) -> bool:
    """Whether a wave may be of an effect: what is slower than anything in the input is of the output encoder alone,
    whose errors come again with each turn, or of what turns with a joint that has one encoder, geared or not, if it is
    no weight."""
    slow = per_input_turn(wave, ratio) < SLOW
    if effect.balance == "drive" and slow:
        return wave.angle == "output" and wave.order >= LEAST_ORDER and LOAD not in effect.carriers
    of_output = effect.waves[0].angle == "output"
    return slow == of_output and not (of_output and wave.order % 1)
