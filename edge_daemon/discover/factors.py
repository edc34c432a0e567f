"""The grammar that formulas are made of: factors of one axis each, and products of them with an amplitude.

A factor is a row of one table: how it is computed, how it is written in an expression and said in words, and which of
its inner numbers a search begins with. A sine brings its cosine along, so that phases stay linear.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from edge_daemon.discover.past_axes import allowed, family, reads, row_of
from edge_daemon.records import Array

AxisCourses = Mapping[str, Array]
"""From an axis to its course (n,)."""
InnerNumbers = tuple[float, ...]

LINEAR, SCALED = "linear", "scaled"
"""An inner number is searched by itself in units of the axis, or by its logarithm."""


@dataclass(frozen=True, slots=True)
class Span:
    """How far an axis went in the recording."""

    low: float
    high: float
    rms: float
    quantiles: tuple[float, ...]
    """at every tenth of the samples, from 0.1 to 0.9"""

    @classmethod
    def of(cls, column: Array) -> Span:
        """Of a course (n,)."""
        tenths = np.quantile(column, np.arange(1, 10) / 10)
        return cls(
            float(column.min()), float(column.max()), math.sqrt(float(np.mean(column**2))), tuple(tenths.tolist())
        )

    @property
    def width(self) -> float:
        """From end to end."""
        return self.high - self.low

    @property
    def two_sided(self) -> bool:
        """Whether zero lies well inside."""
        return self.low < -0.1 * self.width and self.high > 0.1 * self.width


@dataclass(frozen=True, slots=True)
class FactorKind:
    """One row of the grammar."""

    name: str
    columns: Callable[[Array, InnerNumbers], tuple[Array, ...]]
    texts: Callable[[str, Sequence[str]], tuple[str, ...]]
    """the same columns as expressions over a name and written numbers"""
    words: str
    """with {x} for the axis and {0}, {1} for the numbers"""
    grid: Callable[[Span], list[InnerNumbers]]
    """where its inner numbers are looked for first"""
    search: tuple[str, ...] = ()
    """LINEAR or SCALED of each inner number"""


NARROW = 0.02
"""Width of a window's ends, over that of its axis, where its search begins: a place begins somewhere."""
LEAST_POWER = 0.2
"""Exponent below which an odd power is a direction, which has a kind of its own."""


def _odd_power(x: str, exponent: float) -> str:
    return f"{x}*abs({x})" if exponent == 2.0 else f"sign({x})*abs({x})**{exponent:g}"


def _power(exponent: int) -> FactorKind:
    text = "{x}" if exponent == 1 else f"{{x}}**{exponent}"
    words = {1: "{x}", 2: "the square of {x}", 3: "the cube of {x}"}[exponent]
    return FactorKind(
        f"power_{exponent}",
        lambda x, p: (x**exponent,),
        lambda x, p: (text.format(x=x),),
        words,
        lambda span: [()],
    )


def _one_way(name: str, sign: str, way: float, word: str) -> FactorKind:
    return FactorKind(
        name,
        lambda x, p: (1.0 + way * np.tanh(x / p[0]),),
        lambda x, p: (f"(1 {sign} tanh({x}/{p[0]}))",),
        f"what acts where {{x}} is {word} zero alone, in full from about {{0}}",
        lambda span: [(share * span.rms,) for share in (0.01, 0.1)] if span.two_sided else [],
        (SCALED,),
    )


def _half_wave(name: str, word: str, wave: Callable[[Array], Array]) -> FactorKind:
    return FactorKind(
        name,
        lambda x, p: (wave(p[0] * x),),
        lambda x, p: (f"{word}({p[0]}*{x})",),
        "a sine of {0} times {x}",
        lambda span: [(reach / max(-span.low, span.high),) for reach in (1.0, 2.0, 3.0)],
        (LINEAR,),
    )


def _inside(span: Span) -> list[float]:
    return [*span.quantiles]


def _saturating(span: Span) -> list[InnerNumbers]:
    return [(share * span.rms,) for share in (0.01, 0.1, 0.4, 1.2)] if span.two_sided else []


def _bumps(span: Span) -> list[InnerNumbers]:
    return [(c, share * span.width) for c in _inside(span) for share in (0.03, 0.1, 0.25)]


def _windows(span: Span) -> list[InnerNumbers]:
    ends = [span.low, *span.quantiles, span.high]
    pairs = [(i, j) for i in range(1, 9) for j in range(i + 1, min(i + 5, 10))]
    return [(ends[i], ends[j], NARROW * span.width) for i, j in pairs]


def _ends(span: Span) -> list[InnerNumbers]:
    return [(c, NARROW * span.width) for c in _inside(span)]


def _kinks(span: Span) -> list[InnerNumbers]:
    return [(c,) for c in _inside(span)]


KINDS: dict[str, FactorKind] = {
    row.name: row
    for row in (
        _power(1),
        _power(2),
        _power(3),
        FactorKind(
            "affine",
            lambda x, p: (np.ones_like(x), x),
            lambda x, p: ("1", x),
            "a straight line of {x}",
            lambda span: [] if span.two_sided else [()],
        ),
        FactorKind(
            "size",
            lambda x, p: (np.abs(x) ** p[0],),
            lambda x, p: (f"abs({x})" if float(p[0]) == 1.0 else f"abs({x})**{p[0]}",),
            "the size of {x} to the power {0}",
            lambda span: [(0.5,), (1.0,), (1.5,), (3.0,)] if span.two_sided else [(0.5,), (1.5,)],
            (SCALED,),
        ),
        FactorKind(
            "capped",
            lambda x, p: (np.minimum(np.abs(x) / p[0], 1.0) ** p[1],),
            lambda x, p: (f"minimum(abs({x})/{p[0]}, 1)" + ("" if float(p[1]) == 1.0 else f"**{p[1]}"),),
            "the size of {x} up to {0}, to the power {1}",
            lambda span: [(share * span.rms, power) for share in (1.0, 2.0) for power in (1.0, 2.0)],
            (SCALED, SCALED),
        ),
        FactorKind(
            "odd_power",
            lambda x, p: (np.sign(x) * np.abs(x) ** max(p[0], LEAST_POWER),),
            lambda x, p: (_odd_power(x, max(float(p[0]), LEAST_POWER)),),
            "the direction of {x} times its size to the power {0}",
            lambda span: [(0.5,), (1.5,), (2.0,)] if span.two_sided else [],
            (SCALED,),
        ),
        FactorKind(
            "saturation",
            lambda x, p: (np.tanh(x / p[0]),),
            lambda x, p: (f"tanh({x}/{p[0]})",),
            "the direction of {x}, full from about {0}",
            _saturating,
            (SCALED,),
        ),
        _one_way("forward", "+", 1.0, "above"),
        _one_way("backward", "-", -1.0, "below"),
        FactorKind(
            "full_size",
            lambda x, p: (np.tanh(np.abs(x) / p[0]),),
            lambda x, p: (f"tanh(abs({x})/{p[0]})",),
            "the size of {x}, full from about {0}",
            lambda span: [(share * span.rms,) for share in (0.4, 1.2)] if span.two_sided else [],
            (SCALED,),
        ),
        FactorKind(
            "step",
            lambda x, p: (np.tanh((x - p[0]) / p[1]),),
            lambda x, p: (f"tanh(({x} - {p[0]})/{p[1]})",),
            "a step where {x} is {0}, {1} wide",
            lambda span: [(c, share * span.width) for c in span.quantiles[::2] for share in (0.02, 0.15)],
            (LINEAR, SCALED),
        ),
        FactorKind(
            "exponential",
            lambda x, p: (np.exp(np.clip(p[0] * x, -60.0, 60.0)),),
            lambda x, p: (f"exp({p[0]}*{x})",),
            "an exponential of {0} times {x}",
            lambda span: [(s * share / span.width,) for s in (1, -1) for share in (1.0, 3.0, 8.0)],
            (LINEAR,),
        ),
        FactorKind(
            "size_exponential",
            lambda x, p: (np.exp(-np.abs(x) / p[0]),),
            lambda x, p: (f"exp(-abs({x})/{p[0]})",),
            "what fades with the size of {x} over {0}",
            lambda span: [(share * span.rms,) for share in (0.1, 0.4, 1.2)] if span.two_sided else [],
            (SCALED,),
        ),
        FactorKind(
            "bump",
            lambda x, p: (np.exp(-(((x - p[0]) / p[1]) ** 2)),),
            lambda x, p: (f"exp(-(({x} - {p[0]})/{p[1]})**2)",),
            "a bump where {x} is {0}, {1} wide",
            _bumps,
            (LINEAR, SCALED),
        ),
        FactorKind(
            "spot",
            lambda x, p: (np.exp(2.0 * (np.cos(x - p[0]) - 1.0) / p[1] ** 2),),
            lambda x, p: (f"exp(2*(cos({x} - {p[0]}) - 1)/{p[1]}**2)",),
            "a spot of the turn where {x} is {0}, {1} wide",
            _bumps,
            (LINEAR, SCALED),
        ),
        FactorKind(
            "window",
            lambda x, p: (np.tanh((x - p[0]) / p[2]) - np.tanh((x - p[1]) / p[2]),),
            lambda x, p: (f"(tanh(({x} - {p[0]})/{p[2]}) - tanh(({x} - {p[1]})/{p[2]}))",),
            "a stretch where {x} is between {0} and {1}, its ends {2} wide",
            _windows,
            (LINEAR, LINEAR, SCALED),
        ),
        FactorKind(
            "beyond",
            lambda x, p: (1.0 + np.tanh((x - p[0]) / p[1]),),
            lambda x, p: (f"(1 + tanh(({x} - {p[0]})/{p[1]}))",),
            "a stretch where {x} is beyond {0}, its end {1} wide",
            _ends,
            (LINEAR, SCALED),
        ),
        FactorKind(
            "short_of",
            lambda x, p: (1.0 - np.tanh((x - p[0]) / p[1]),),
            lambda x, p: (f"(1 - tanh(({x} - {p[0]})/{p[1]}))",),
            "a stretch where {x} is short of {0}, its end {1} wide",
            _ends,
            (LINEAR, SCALED),
        ),
        FactorKind(
            "above",
            lambda x, p: (np.maximum(x - p[0], 0.0),),
            lambda x, p: (f"maximum({x} - {p[0]}, 0)",),
            "what {x} is above {0}",
            _kinks,
            (LINEAR,),
        ),
        FactorKind(
            "below",
            lambda x, p: (np.maximum(p[0] - x, 0.0),),
            lambda x, p: (f"maximum({p[0]} - {x}, 0)",),
            "what {x} is below {0}",
            _kinks,
            (LINEAR,),
        ),
        FactorKind(
            "dead_zone",
            lambda x, p: (x - np.clip(x, -abs(p[0]), abs(p[0])),),
            lambda x, p: (f"(maximum({x} - {p[0]}, 0) + minimum({x} + {p[0]}, 0))",),
            "what {x} is beyond {0} to either side",
            lambda span: [(share * span.rms,) for share in (0.3, 1.0)] if span.two_sided else [],
            (SCALED,),
        ),
        FactorKind(
            "beyond_size",
            lambda x, p: (np.maximum(np.abs(x) - p[0], 0.0),),
            lambda x, p: (f"maximum(abs({x}) - {p[0]}, 0)",),
            "what the size of {x} is beyond {0}",
            lambda span: [(share * span.rms,) for share in (0.3, 1.0)] if span.two_sided else [],
            (SCALED,),
        ),
        FactorKind(
            "half_turn",
            lambda x, p: (np.maximum(np.cos(x - p[0]), 0.0),),
            lambda x, p: (f"maximum(cos({x} - {p[0]}), 0)",),
            "half a turn about {0} of {x}",
            lambda span: [(phase * math.pi / 4,) for phase in range(8)] if span.width > math.pi / 2 else [],
            (LINEAR,),
        ),
        FactorKind(
            "reciprocal",
            lambda x, p: (1.0 / (1.0 + np.abs(x) / p[0]),),
            lambda x, p: (f"1/(1 + abs({x})/{p[0]})",),
            "what falls as one over 1 plus the size of {x} over {0}",
            lambda span: [(share * span.rms,) for share in (0.1, 0.4, 1.2)],
            (SCALED,),
        ),
        FactorKind(
            "resonance",
            lambda x, p: (1.0 / (1.0 + (x / p[0]) ** 2),),
            lambda x, p: (f"1/(1 + ({x}/{p[0]})**2)",),
            "what falls as one over 1 plus the square of {x} over {0}",
            lambda span: [(share * span.rms,) for share in (0.1, 0.4, 1.2)] if span.two_sided else [],
            (SCALED,),
        ),
        FactorKind(
            "sine",
            lambda x, p: (np.sin(p[0] * x), np.cos(p[0] * x)),
            lambda x, p: tuple(f"{f}({x})" if float(p[0]) == 1.0 else f"{f}({p[0]}*{x})" for f in ("sin", "cos")),
            "a sine of {0} times {x}",
            lambda span: [],
            (LINEAR,),
        ),
        _half_wave("odd_wave", "sin", np.sin),
        _half_wave("even_wave", "cos", np.cos),
    )
}
"""Every factor that a formula may hold. A sine has no grid: its order is read off a spectrum."""


def direction(width: float) -> FactorKind:
    """A direction whose width is known."""
    return FactorKind(
        "direction",
        lambda x, p: (np.tanh(x / width),),
        lambda x, p: (f"tanh({x}/{width:g})",),
        f"the direction of {{x}}, full from about {width:g} rad/s",
        lambda span: [],
    )


def fade(after_s: float, start_s: float) -> FactorKind:
    """What follows with a time forgets from a start on, which is not asked for where a recording counts from zero."""
    start_s = 0.0 if 0.0 <= start_s < after_s else start_s
    past = f"maximum({{x}} - {start_s:.6g}, 0)" if start_s else "{x}"
    return FactorKind(
        FADE,
        lambda x, p: (np.exp(-np.maximum(x - start_s, 0.0) / after_s),),
        lambda x, p: (f"exp(-{past.format(x=x)}/{after_s:.6g})",),
        f"what fades with {after_s:.3g} s from the beginning",
        lambda span: [],
    )


FADE = "fade"
"""The kind of what was before the beginning, of which there is no grid."""
HALF_TURN, SPOT = "half_turn", "spot"
"""The kinds of what touches on one side of the output's turn, or at one place of it: of nothing but its angle."""
ONE_WAY = ("forward", "backward")
"""Kinds of what acts in one direction alone, or on one flank: of nothing but a speed or the twist."""
SIMPLE_CURVES = ("affine", "power_1", "power_2", "power_3", "exponential")
"""Loads of the output's angle alone that are the same law at any other."""
STRETCHES = ("window", "beyond", "short_of")
"""Kinds that are all or nothing along an axis."""
EVENTS = ("step", "bump", "above", "below", *STRETCHES)
"""Kinds that along the time are something that happened once."""
USUAL = {
    "theta_in_rad": ("sine",),
    "theta_out_rad": ("sine", "odd_wave", "even_wave", "power_1", "power_2", "affine", "above", "below", SPOT,
                      "step", "window", HALF_TURN),
    "twist_rad": ("power_1", "power_2", "power_3", "size", "above", "below", "saturation", "capped", "full_size",
                  "dead_zone", "beyond_size", *ONE_WAY),
    "twist_rate_rad_s": (
        "power_1", "size", "odd_power", "saturation", "direction", "above", "below", "size_exponential", "dead_zone",
        *ONE_WAY,
    ),
    "velocity_out_rad_s": (
        "power_1", "power_2", "size", "odd_power", "saturation", "exponential", "size_exponential", "resonance",
        "above", "below", "reciprocal", "capped", "full_size", "dead_zone", "beyond_size", *ONE_WAY,
    ),
    "temperature_degC": ("affine", "exponential", "step"),
    "time_s": ("power_1", "affine", "exponential", "reciprocal", "sine", "step", "beyond", "short_of", FADE),
}  # fmt: skip
"""What machines are known to do along each axis; of other channels any kind is as good."""
NEVER = {
    "theta_out_rad": ("bump",),
    "temperature_degC": (
        "capped",
        "power_1",
        "power_2",
        "power_3",
        "size",
        "reciprocal",
        "odd_wave",
        "even_wave",
        "beyond_size",
        *STRETCHES,
    ),
    "time_s": ("capped", "size", "beyond_size", "power_3", "odd_wave", "even_wave", "bump", "window"),
    "twist_rad": ("odd_wave", "even_wave", "step", *STRETCHES),
    "twist_rate_rad_s": ("odd_wave", "even_wave", "step", *STRETCHES),
    "velocity_out_rad_s": ("step", *STRETCHES),
    "acceleration_out_rad_s2": STRETCHES,
}
"""What has no meaning where zero is a convention."""


def never(axis: str) -> tuple[str, ...]:
    """Kinds that a law never holds of an axis."""
    kinds = allowed(axis)
    if kinds is not None:
        return tuple(kind for kind in KINDS if kind not in kinds)
    turn = () if axis == PLACE else (HALF_TURN, SPOT)
    way = () if axis in TWO_WAY else ONE_WAY
    return (*NEVER.get(_temperature(axis), ()), *turn, *way)


def _temperature(axis: str) -> str:
    """Any temperature by one name; other axes by their own."""
    return "temperature_degC" if axis.isidentifier() and axis.endswith("_degC") else axis


BENT, STRAINED = ("saturation", "forward", "backward", "full_size", "size_exponential", "reciprocal", "resonance"), 5.0
"""Kinds that a width bends, and its size over the reach of their axis from which on it bends nothing (guess)."""
NARROWEST = 1e-5
"""Its size below which it bends at zero alone, as a power does that is none there (guess)."""
LEAST_EXPONENT = 0.05
"""Exponent of a size below which it is one wherever anything moves (guess)."""
STEEPEST = 12.0
"""Logarithm of the ratio of an exponential's ends beyond which it is nothing but at one extreme (guess)."""
LEAST_PART = 0.05
"""Share of the recording that what began or ended once lasts, or lasted, at least: blocks tell no less (guess)."""
WIDEST_END = 0.3
"""Width of a stretch's end over that of its axis beyond which it is no end: it takes the whole axis to come (guess)."""
PLACE, CLOCK, TWO_WAY = "theta_out_rad", "time_s", ("velocity_out_rad_s", "twist_rate_rad_s", "twist_rad")
ANGLES = ("theta_in_rad", PLACE)
"""Axes that are one turn, but for the ratio and the twist."""
HALF_WAVES = ("odd_wave", "even_wave")
"""Waves without a phase, by which sines of less than a wave are found."""
ODD = 2.0
"""What an unusual factor costs more, in numbers (guess): enough to decide between forms that do equally well."""


@dataclass(frozen=True, slots=True)
class Factor:
    """One factor at some inner numbers."""

    kind: FactorKind
    axis: str
    numbers: InnerNumbers = ()

    def columns(self, axes: AxisCourses) -> tuple[Array, ...]:
        """(n,) each; two where an amplitude and a phase are free."""
        return self.kind.columns(axes[self.axis], self.numbers)

    def strained(self, span: Span) -> bool:
        """Whether its bend or an end lies so far out that a simpler kind says the same."""
        far = STRAINED * max(-span.low, span.high)
        if self.kind.name == "exponential":
            return abs(self.numbers[0]) * far < 1.0 or abs(self.numbers[0]) * span.width > STEEPEST
        if self.kind.name in STRETCHES:
            inside = all(span.low < end < span.high for end in self.numbers[:-1])
            return not inside or self.numbers[-1] > WIDEST_END * span.width
        if self.kind.name == "sine":  # of which less was seen is a straight line
            return abs(self.numbers[0]) * span.width < 1.0
        if self.kind.name in ("above", "below"):
            least = LEAST_PART * span.width if self.axis == CLOCK else 0.0
            return not span.low + least < self.numbers[0] < span.high - least
        if self.kind.name in ("size", "capped") and self.numbers[-1] < LEAST_EXPONENT:
            return True
        if self.kind.name in ("dead_zone", "beyond_size", "capped"):
            return self.numbers[0] > max(-span.low, span.high)
        if self.kind.name == "step":  # beyond the reach of its axis it is an exponential
            return self.numbers[1] > span.width or not span.low < self.numbers[0] < span.high
        if self.kind.name in ("bump", SPOT):  # of which one flank was not seen is any curve
            return not span.low < self.numbers[0] - self.numbers[1] < self.numbers[0] + self.numbers[1] < span.high
        if self.kind.name in ("reciprocal", "resonance") and self.numbers[-1] * STRAINED < NARROWEST * far:
            return True
        return self.kind.name in BENT and self.numbers[-1] > far

    @property
    def oddity(self) -> float:
        """0 for what machines do along this axis."""
        usual = allowed(self.axis) or USUAL.get(_temperature(self.axis), (self.kind.name,))
        return 0.0 if self.kind.name in usual else ODD


Evaluated = dict[tuple[str, str, InnerNumbers], tuple[Array, ...]]
"""Columns by the kind, axis and numbers of their factor."""
MOST_KEPT = 100
"""Factors that are kept: those of some steps of one formula."""


@dataclass(frozen=True, slots=True)
class Product:
    """One summand of a formula: an amplitude times its factors; a constant where there are none."""

    factors: tuple[Factor, ...]

    def columns(self, axes: AxisCourses) -> Array:
        """(n, k) one for each free amplitude."""
        return np.stack(self.courses(axes), axis=1)

    def courses(self, axes: AxisCourses, evaluated: Evaluated | None = None) -> list[Array]:
        """(n,) one for each free amplitude; `evaluated` keeps factors for the next call with the same axes."""
        evaluated = {} if evaluated is None else evaluated
        if len(evaluated) > MOST_KEPT:
            evaluated.clear()
        out: list[Array] = []
        for factor in self.factors:
            key = factor.kind.name, factor.axis, factor.numbers
            own = evaluated[key] = evaluated.get(key) or factor.columns(axes)
            out = [a * b for a in out for b in own] if out else list(own)
        return out or [np.ones(len(next(iter(axes.values()))))]

    def strained(self, spans: Mapping[str, Span]) -> bool:
        """Whether a factor of it is, or two waves of the turn beat so slowly that less than one was seen."""
        if any(factor.strained(spans[factor.axis]) for factor in self.factors):
            return True
        turns = (row for row in self.factors if row.kind.name == "sine" and row.axis in ANGLES)
        seen = [abs(row.numbers[0]) * spans[row.axis].width for row in turns]
        return any(abs(one - other) < 1.0 for one, other in itertools.combinations(seen, 2))

    def guessed(self, spans: Mapping[str, Span]) -> bool:
        """Whether it is a curve of the output's place of which no more than half a wave was seen: what another place
        does is then a guess. What begins or ends where it was seen is none, nor is a simple load of the angle alone."""
        for factor in (row for row in self.factors if row.axis == PLACE):
            alone = len(self.factors) == 1 and factor.kind.name in SIMPLE_CURVES
            if factor.kind.name == "sine" and abs(factor.numbers[0]) * spans[PLACE].width < math.pi:
                return True
            if factor.kind.name not in ("sine", SPOT, *STRETCHES, "above", "below") and not alone:
                return True
        return False

    def events(self, clocks: Collection[str]) -> frozenset[InnerNumbers]:
        """Instants at which something happened once, on the clock or on what goes on as one."""
        along = (row for row in self.factors if row.kind.name in EVENTS and set(reads(row.axis)) <= set(clocks))
        return frozenset(row.numbers for row in along)

    @property
    def tones(self) -> tuple[Factor, ...]:
        """Waves of the clock."""
        return tuple(row for row in self.factors if row.axis == CLOCK and row.kind.name == "sine")

    @property
    def moves(self) -> bool:
        """Whether it holds anything but the clock and the temperature."""
        return any(row.axis not in (CLOCK, "temperature_degC") for row in self.factors)

    @property
    def numbers(self) -> InnerNumbers:
        """All inner numbers, factor by factor."""
        return tuple(number for factor in self.factors for number in factor.numbers)

    @property
    def search(self) -> tuple[str, ...]:
        """How each of them is searched."""
        return tuple(way for factor in self.factors for way in factor.kind.search)

    @property
    def amplitudes(self) -> int:
        """How many numbers enter linearly."""
        return 1 << sum(factor.kind.name in ("sine", "affine") for factor in self.factors)

    @property
    def waves(self) -> bool:
        """Whether a factor of it is a sine."""
        return any(factor.kind.name == "sine" for factor in self.factors)

    @property
    def price(self) -> int:
        """Numbers that are free, the times of its axes among them."""
        return self.amplitudes + len(self.numbers) + sum(row_of(factor.axis) is not None for factor in self.factors)

    @property
    def signature(self) -> tuple[tuple[str, str], ...]:
        """Kinds and axes, whatever the numbers."""
        return tuple(sorted((factor.kind.name, factor.axis) for factor in self.factors))

    @property
    def alike(self) -> tuple[tuple[str, str], ...]:
        """The same whatever the times with which it follows what was."""
        return tuple(sorted((factor.kind.name, family(factor.axis)) for factor in self.factors))

    def at(self, numbers: Sequence[float]) -> Product:
        """The same at other inner numbers."""
        left = tuple(numbers)
        factors = []
        for factor in self.factors:
            own, left = left[: len(factor.numbers)], left[len(factor.numbers) :]
            factors.append(Factor(factor.kind, factor.axis, own))
        return Product(tuple(factors))
