"""A user's own effect as an expression over channels, evaluated without ever running code.

The text is parsed to a syntax tree of which only arithmetic, names and a table of functions pass. Names that are
channels stand for the recording; every other name is a parameter. A parameter that enters linearly is an amplitude,
any other a shape: that is read off the tree, not guessed from values. All numbers are floats, so no power can grow
without end.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.channels import CHANNELS
from edge_daemon.effects.algebra import followed
from edge_daemon.effects.angles import TIED_SHAPES, TIED_TO, felt_error
from edge_daemon.effects.effect import Balance, Effect, EffectState, Parameter
from edge_daemon.effects.friction import SMOOTHING
from edge_daemon.effects.model import ModelEffect, ModelError
from edge_daemon.integrator.laws import LOADED, Element
from edge_daemon.records import Array, Motion
from edge_daemon.text import syntax_tree

MAX_LENGTH = 800
"""A torque law on one screen line is below 150 characters."""
MAX_NODES = 250
MAX_DEPTH = 30
SEARCH_DECADES, FAR_DECADES = 3.0, 6.0
"""A shape parameter of a user's effect is searched this far around its stated value, or the second around 1 if none
(guess)."""


def _tent(x: Array, left: Array, peak: Array, right: Array) -> Array:
    """1 at the peak, 0 from `left` down and from `right` up, straight between; a side without width stays 1."""
    rising = np.where(peak > left, (x - left) / np.where(peak > left, peak - left, 1.0), 1.0)
    falling = np.where(right > peak, (right - x) / np.where(right > peak, right - peak, 1.0), 1.0)
    return np.clip(np.minimum(rising, falling), 0.0, 1.0)


FUNCTIONS: dict[str, tuple[int, Callable[..., Array]]] = {
    "sin": (1, np.sin),
    "cos": (1, np.cos),
    "tan": (1, np.tan),
    "atan": (1, np.arctan),
    "tanh": (1, np.tanh),
    "exp": (1, np.exp),
    "log": (1, np.log),
    "sqrt": (1, np.sqrt),
    "abs": (1, np.abs),
    "sign": (1, np.sign),
    "minimum": (2, np.minimum),
    "maximum": (2, np.maximum),
    "clip": (3, np.clip),
    "tent": (4, _tent),
}
Remembered = tuple[float, ...]
FormulaMemory = dict[str, Remembered]
"""By the text of a call, what its function takes from one stretch of time to the next."""


def _since(carried: Remembered, time_s: Array, x: Array) -> tuple[Array, Remembered]:
    """(n,) time since `x` last changed its sign, or since the beginning; a sample at zero changes nothing."""
    time_s, x = np.broadcast_arrays(np.atleast_1d(time_s), np.nan_to_num(x))
    sides = np.sign(np.concatenate([carried[1:] or (0.0,), x]))
    sides = sides[np.maximum.accumulate(np.where(sides != 0.0, np.arange(len(sides)), 0))]
    began = np.where(sides[1:] * sides[:-1] < 0, time_s, carried[0] if carried else time_s[0])
    began = np.maximum.accumulate(began)
    return time_s - began, (float(began[-1]), float(sides[-1]))


def _way(carried: Remembered, x: Array) -> tuple[Array, Remembered]:
    """(n,) way that `x` has gone since the beginning, there and back; none over a gap."""
    gone, before = carried or (0.0, float(np.atleast_1d(x)[0]))
    way = gone + np.cumsum(np.abs(np.nan_to_num(np.diff(np.atleast_1d(x), prepend=before))))
    return way, (float(way[-1]), float(np.atleast_1d(x)[-1]))


def _lag(carried: Remembered, time_s: Array, x: Array, after_s: Array) -> tuple[Array, Remembered]:
    """(n,) `x` as what follows it with a time has it, from its first value on."""
    time_s, x, after_s = np.broadcast_arrays(np.atleast_1d(time_s), np.nan_to_num(x), np.maximum(after_s, 1e-9))
    began, before = carried or (float(time_s[0]), float(x[0]))
    out = followed(x, np.exp(-np.maximum(np.diff(time_s, prepend=began), 0.0) / after_s), before)
    return out, (float(time_s[-1]), float(out[-1]))


MOST_KEPT = 4000
"""Samples that a delay takes along from one stretch to the next: of more, one in each of so many parts of it."""


def _delay(carried: Remembered, time_s: Array, x: Array, late_s: Array) -> tuple[Array, Remembered]:
    """(n,) `x` as it was a time before; before the beginning its first value."""
    time_s, x, late_s = np.broadcast_arrays(np.atleast_1d(time_s), np.nan_to_num(x), late_s)
    before = np.reshape(carried, (2, -1))
    times, values = np.concatenate((before[0], time_s)), np.concatenate((before[1], x))
    out = np.interp(time_s - late_s, times, values)
    longest_s = max(float(np.max(late_s)), 1e-9)
    last = max(int(np.searchsorted(times, time_s[-1] - longest_s, "right")) - 1, 0)
    kept = np.diff(np.floor(times[last:] * (MOST_KEPT / longest_s)), prepend=-np.inf) != 0
    kept[-1] = True
    return out, (*times[last:][kept].tolist(), *values[last:][kept].tolist())


Remember = Callable[..., tuple[Array, Remembered]]
REMEMBERING: dict[str, tuple[int, Remember]] = {
    "since": (2, _since),
    "way": (1, _way),
    "lag": (3, _lag),
    "delay": (3, _delay),
}
"""Functions whose value depends on samples before: `since(time_s, velocity_out_rad_s)`, `way(theta_out_rad)`,
`lag(time_s, twist_rad, 0.2)`, `delay(time_s, temperature_degC, 2.0)`."""
ARGUMENTS = {name: count for name, (count, _) in (*FUNCTIONS.items(), *REMEMBERING.items())}
CONSTANTS = {"pi": math.pi}
LETTERS = "abcdfghjkmnpqrstuvw"
"""Amplitudes of formulas that are written here, in order of appearance."""
LOAD, MOTOR = TOLD = "transmitted_Nm", "motor_Nm"
"""Of a joint with one encoder the torque that passes the gear, and that which the motor makes, all friction within, as
the rest of the model tells them, in its torque's unit."""
TWIST_RATE, DIRECTION = "twist_rate_rad_s", "_direction"
"""The channel whose direction dry friction of the twist follows, and a name that no user can give, for it."""
MOTION_NAMES = (
    "time_s",
    "theta_in_rad",
    "theta_out_rad",
    "twist_rad",
    "twist_rate_rad_s",
    "velocity_out_rad_s",
    "acceleration_out_rad_s2",
    "torque_Nm",
    "temperature_degC",
    *TOLD,
)
_ARITHMETIC: dict[type[ast.operator], Callable[[Array, Array], Array]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
}


MISREAD = "error_of_output"
"""Around all of an expression: it is the angle [rad] that the output's encoder reads too much, and no torque."""


class ExpressionError(ModelError):
    """What is wrong with a formula; `at`: the letter from which on, counted from 0."""

    def __init__(self, message: str, at: int = 0) -> None:
        super().__init__(message)
        self.at = at


@dataclass(frozen=True, slots=True)
class Expression:
    """A parsed expression; names in order of appearance."""

    text: str
    tree: ast.expr
    channels: tuple[str, ...]
    amplitudes: tuple[str, ...]
    shapes: tuple[str, ...]
    misread: bool = False
    """whether it is an error of the output's encoder"""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Amplitudes, then shapes."""
        return self.amplitudes + self.shapes

    @property
    def by_clock(self) -> bool:
        """Whether the time itself enters, not only what passed since something, or what follows with a time."""
        calls = (node for node in ast.walk(self.tree) if isinstance(node, ast.Call))
        passed = sum(ast.unparse(call.func) in REMEMBERING and _is_clock(call.args[0]) for call in calls)
        return sum(map(_is_clock, ast.walk(self.tree))) > passed


def _is_clock(node: ast.AST) -> bool:
    return isinstance(node, ast.Name) and node.id == "time_s"


def parse(text: str, columns: Collection[str] = ()) -> Expression:
    """The expression; `columns` are further channel names that the recording has. Raises `ExpressionError`."""
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"{len(text)} characters: expected at most {MAX_LENGTH}")
    try:
        tree = syntax_tree(text.strip())
    except SyntaxError as error:
        raise ExpressionError(*_unread(text, error)) from error
    inner = _misread(tree)
    tree = inner or tree
    _inspect(tree, 0, len(text) - len(text.lstrip()))
    if sum(1 for _ in ast.walk(tree)) > MAX_NODES:
        raise ExpressionError(f"{_short(text)}: more than {MAX_NODES} parts: expected a shorter expression")
    names = list(dict.fromkeys(_names(tree)))
    known = {*MOTION_NAMES, *CHANNELS, *columns}
    channels = tuple(name for name in names if name in known)
    parameters = [name for name in names if name not in known and name not in CONSTANTS]
    amplitudes = _amplitudes(tree, parameters)
    if not amplitudes:
        raise ExpressionError(
            f"{_short(text)}: no parameter enters linearly: expected an amplitude, e.g. a * sin(time_s)"
        )
    if _order(tree, frozenset(amplitudes)) != 1:
        raise ExpressionError(
            f"{_short(text)}: a term without amplitude: expected one of {', '.join(amplitudes)} in each"
        )
    shapes = tuple(p for p in parameters if p not in amplitudes)
    return Expression(text, tree, channels, amplitudes, shapes, inner is not None)


def _misread(tree: ast.expr) -> ast.expr | None:
    """What the output's encoder reads too much, where a formula says so of all of it."""
    match tree:
        case ast.Call(func=ast.Name(id=name), args=[inner], keywords=[]) if name == MISREAD:
            return inner
    return None


def _unread(text: str, error: SyntaxError) -> tuple[str, int]:
    """What is wrong with a text that cannot be read, and from which letter on. Python's parser says 0 for the end."""
    if not error.offset:
        return f"{_short(text)}: not an expression: it ends too early: expected a number or a name next", len(text)
    at = len(text) - len(text.lstrip()) + error.offset - 1
    why = f"it cannot go on with {text[at : at + 12]!r}: {_allowed()}" if error.msg == "invalid syntax" else error.msg
    return f"{_short(text)}: not an expression: {why}", at


def _short(text: str) -> str:
    line = " ".join(text.split())
    return repr(line if len(line) <= 60 else line[:57] + "...")


def _inspect(node: ast.expr, depth: int, lead: int) -> None:
    """Raises for anything but arithmetic on numbers, names and calls of `FUNCTIONS`. `lead`: blanks before the text."""
    at = lead + node.col_offset
    if depth > MAX_DEPTH:
        raise ExpressionError(f"nested deeper than {MAX_DEPTH}: expected a flatter expression", at)
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _ARITHMETIC:
            children: list[ast.expr] = [left, right]
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            children = [operand]
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in ARGUMENTS:
            if len(args) != ARGUMENTS[name]:
                raise ExpressionError(f"{name} takes {ARGUMENTS[name]} arguments, not {len(args)}", at)
            children = list(args)
        case ast.Name(id=name) if name not in ARGUMENTS and not name.startswith("_"):
            children = []
        case ast.Constant(value=float() | int() as value) if not isinstance(value, bool):
            _finite(value, at)
            children = []
        case _:
            raise ExpressionError(f"{_short(ast.unparse(node))}: not allowed: {_allowed()}", at)
    for child in children:
        _inspect(child, depth + 1, lead)


def _finite(value: float, at: int) -> None:
    try:
        fine = math.isfinite(float(value))
    except OverflowError:
        fine = False
    if not fine:
        raise ExpressionError("a number beyond the range of floats: expected a finite one", at)


def _allowed() -> str:
    return f"expected numbers, names, + - * / ** and {', '.join(ARGUMENTS)}, or {MISREAD} around all of it"


def _names(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.Name(id=name):
            yield name
        case ast.BinOp(left=left, right=right):
            yield from _names(left)
            yield from _names(right)
        case ast.UnaryOp(operand=operand):
            yield from _names(operand)
        case ast.Call(args=args):
            for argument in args:
                yield from _names(argument)


def _amplitudes(tree: ast.expr, parameters: list[str]) -> tuple[str, ...]:
    """The largest set, in order of appearance, in which the expression is jointly linear."""
    chosen: frozenset[str] = frozenset()
    for name in parameters:
        if _degree(tree, chosen | {name}) <= 1:
            chosen |= {name}
    return tuple(name for name in parameters if name in chosen)


def _degree(node: ast.AST, among: frozenset[str]) -> int:
    """Polynomial degree in the names `among`: 0, 1, or 2 for anything that is not affine."""
    match node:
        case ast.Name(id=name):
            return int(name in among)
        case ast.UnaryOp(operand=operand):
            return _degree(operand, among)
        case ast.BinOp(left=left, op=op, right=right):
            a, b = _degree(left, among), _degree(right, among)
            if isinstance(op, ast.Add | ast.Sub):
                return max(a, b)
            if isinstance(op, ast.Mult):
                return min(a + b, 2)
            return a if b == 0 and (isinstance(op, ast.Div) or a == 0) else 2
        case ast.Call(args=args):
            return 2 if any(_degree(argument, among) for argument in args) else 0
    return 0


def _order(node: ast.AST, among: frozenset[str]) -> int | None:
    """1 when every term holds exactly one of the names, 0 when none does, None when terms differ."""
    match node:
        case ast.Name(id=name):
            return int(name in among)
        case ast.UnaryOp(operand=operand):
            return _order(operand, among)
        case ast.BinOp(left=left, op=op, right=right):
            a, b = _order(left, among), _order(right, among)
            if isinstance(op, ast.Add | ast.Sub):
                return a if a == b else None
            return None if a is None or b is None else a + b
    return 0


def evaluate(
    node: ast.expr,
    values: Mapping[str, Array | float],
    memory: FormulaMemory | None = None,
    remembered: dict[str, Array] | None = None,
) -> Array:
    """The expression's value; names from `values`. Only trees that `parse` let through.

    `memory`: what functions that remember took along from the stretch before; it is brought up to date. `remembered`:
    what they came to on this stretch, since each goes on once, however often a formula holds it.
    """
    memory = {} if memory is None else memory
    remembered = {} if remembered is None else remembered
    match node:
        case ast.Name(id=name):
            return np.asarray(values[name] if name in values else CONSTANTS[name], dtype=float)
        case ast.Constant(value=value):
            return np.asarray(float(value), dtype=float)  # type: ignore[arg-type]
        case ast.UnaryOp(op=op, operand=operand):
            inner = evaluate(operand, values, memory, remembered)
            return -inner if isinstance(op, ast.USub) else inner
        case ast.BinOp(left=left, op=op, right=right):
            sides = (evaluate(side, values, memory, remembered) for side in (left, right))
            return _ARITHMETIC[type(op)](*sides)
        case ast.Call(func=ast.Name(id=name), args=args):
            given, call = [evaluate(argument, values, memory, remembered) for argument in args], ast.unparse(node)
            if name in FUNCTIONS:
                return FUNCTIONS[name][1](*given)
            if call not in remembered:
                remembered[call], memory[call] = REMEMBERING[name][1](memory.get(call, ()), *given)
            return remembered[call]
    raise ModelError(f"{_short(ast.unparse(node))}: not allowed: {_allowed()}")


def user_effect(row: ModelEffect, balance: Balance, columns: Collection[str] = ()) -> Effect:
    """The effect that a model's expression declares; `columns` are the recording's. Raises `ModelError`.

    A shape is searched three decades to either side of the value that the model states, six to either side of 1 if
    it states none.
    """
    if row.expression is None:
        raise ModelError(f"{row.name}: no expression")
    parsed = parse(row.expression, columns)
    if parsed.misread:
        return _error_of_output(row, parsed, balance)
    told = [name for name in parsed.channels if name in TOLD]
    if told and balance != "drive":
        raise ModelError(f"{row.name}: {told[0]}: a model tells it with one encoder: expected torque_Nm or twist_rad")
    unit, friction = row.unit or "N m", _twist_friction(parsed) if balance == "torsion" else None
    return Effect(
        name=row.name,
        balance=balance,
        kind="torque",
        meaning="a user's own effect",
        equation=parsed.text,
        source="the model file",
        amplitudes=tuple(Parameter(name, unit, "enters linearly") for name in parsed.amplitudes),
        shapes=tuple(_shape(name, row.value(name)) for name in parsed.shapes),
        columns=_columns(parsed),
        needs=tuple(name for name in parsed.channels if name not in TOLD),
        loaded=bool(told),
        of_motor=MOTOR in told,
        in_loop=None if friction is None else friction.in_loop,
        factors=None if friction is None else friction.factors,
    )


def _error_of_output(row: ModelEffect, parsed: Expression, balance: Balance) -> Effect:
    """What the output's encoder reads too much: the twist lacks it, and a torque that is computed from it has more."""
    if balance != "torsion":
        raise ModelError(f"{row.name}: {MISREAD}: one encoder does not tell its own error: expected a torque")
    if parsed.shapes:
        raise ModelError(f"{row.name}: {MISREAD}: {parsed.shapes[0]}: expected a number, it enters non-linearly")
    angle = _columns(parsed)

    def columns(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
        e, state = angle(motion, {}, state)
        return felt_error(motion, e, shape["stiffness"], shape["damping"]), state

    return Effect(
        name=row.name,
        balance=balance,
        kind="torque",
        meaning="a user's own error of the output's encoder",
        equation=parsed.text,
        source="the model file",
        amplitudes=tuple(Parameter(name, row.unit or "rad", "enters linearly") for name in parsed.amplitudes),
        shapes=TIED_SHAPES,
        columns=columns,
        needs=("twist_rad", *parsed.channels),
        tied=TIED_TO,
        told_by="angle",
    )


@dataclass(frozen=True, slots=True)
class _TwistFriction:
    """Dry friction of the twist in every term: a simulation carries where it sticks, a measured rate does not."""

    level: Expression
    """the friction with its direction as a number"""
    smoothing: float
    """twist rate at which the direction has reached tanh(1) [rad/s]"""

    def in_loop(self, shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
        """One element for each amplitude, with a factor of its own."""
        return tuple(Element(LOADED, size, self.smoothing, j) for j, size in enumerate(a, start=1))

    def factors(self, motion: Motion) -> Array:
        """(n, k) what each amplitude is multiplied by beside the direction."""
        return _columns(self.level)(motion, {DIRECTION: 1.0}, None)[0]


def _twist_friction(parsed: Expression) -> _TwistFriction | None:
    """The expression as such a friction; None where it is none, or where other numbers than amplitudes are open."""
    widths: set[float] = set()
    tree = _directed(parsed.tree, widths)
    direction = frozenset({DIRECTION})
    whole = len(widths) == 1 and TWIST_RATE not in _names(tree) and _degree(tree, direction) == 1
    if parsed.shapes or not whole or _order(tree, direction) != 1 or not 0 < max(widths) <= SMOOTHING.upper:
        return None
    channels = tuple(name for name in parsed.channels if name != TWIST_RATE)
    return _TwistFriction(replace(parsed, tree=tree, channels=channels, shapes=(DIRECTION,)), widths.pop())


def _directed(node: ast.expr, widths: set[float]) -> ast.expr:
    """The tree with a name in place of each direction of the twist rate, whose widths are added to `widths`."""
    match node:
        case ast.Call(
            func=ast.Name(id="tanh"), args=[ast.BinOp(ast.Name(id="twist_rate_rad_s"), ast.Div(), ast.Constant(width))]
        ):
            widths.add(float(width))  # type: ignore[arg-type]
            return ast.Name(DIRECTION)
        case ast.Call(func=ast.Name(id="sign"), args=[ast.Name(id="twist_rate_rad_s")]):
            widths.add(SMOOTHING.start)
            return ast.Name(DIRECTION)
        case ast.BinOp(left=left, op=op, right=right):
            return ast.BinOp(_directed(left, widths), op, _directed(right, widths))
        case ast.UnaryOp(op=op, operand=operand):
            return ast.UnaryOp(op, _directed(operand, widths))
    return node


def _shape(name: str, stated: float) -> Parameter:
    start, far = (1.0, 10.0**FAR_DECADES) if math.isnan(stated) else (stated, 10.0**SEARCH_DECADES)
    ends = sorted((start / far, start * far)) if start else (-far, far)
    return Parameter(name, "1", "enters non-linearly", ends[0], ends[1], start)


def _columns(parsed: Expression) -> Callable[[Motion, Mapping[str, float], EffectState], tuple[Array, EffectState]]:
    def columns(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
        values: dict[str, Array | float] = {name: _channel(motion, name) for name in parsed.channels}
        values |= {name: shape[name] for name in parsed.shapes}
        out = np.empty((len(motion), len(parsed.amplitudes)))
        memory, remembered = dict(state or {}), dict[str, Array]()
        with np.errstate(all="ignore"):
            for j, name in enumerate(parsed.amplitudes):
                unit = {other: float(other == name) for other in parsed.amplitudes}
                out[:, j] = evaluate(parsed.tree, {**values, **unit}, memory, remembered)
        return out, memory or state

    return columns


def _channel(motion: Motion, name: str) -> Array:
    column = getattr(motion, name) if name in MOTION_NAMES else motion.extra.get(name)
    if column is None and name in TOLD:  # nothing tells it yet
        return np.zeros(len(motion))
    if column is None:
        raise ModelError(f"{name}: the recording has no such column")
    return np.asarray(column, dtype=float)
