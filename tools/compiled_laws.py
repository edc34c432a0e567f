"""Laws that are written as one line of Python, compiled: a recording takes tenths of a second instead of many.

The line `lambda i, p, j: ...` of `outside_laws` is taken from its file, and what it reads of the instant, of its
numbers and of the joint is put in by place, so that plain numbers are all that is left.
"""

from __future__ import annotations

import ast
import inspect
import warnings
from collections.abc import Callable
from functools import lru_cache
from math import exp
from pathlib import Path
from types import FunctionType
from typing import Any

WARM_UP_K, WARM_UP_S = 15.0, 12.0
"""of the simulated recording"""
SLOPE_STEP_RAD_S = 1e-6
HEATS_S, CREEPS_S = 3.0, 0.2
"""Times over which a gear warms by its own motion, and over which its twist creeps."""
SEEN = ("phi", "dphi", "speed", "angle", "motor", "time_s", "warmer_K")
PAST = ("since_s", "way_rad", "heat", "crept")
TEMPLATE = f"""
def torque(p, time_s, since_s, way_rad, heat, crept, phi, dphi, speed, angle):
    motor = p[{{ratio}}] * (angle + phi)
    warmer_K = {WARM_UP_K} * (1.0 - exp(-max(time_s, 0.0) / {WARM_UP_S}))
    return {{law}}

def at(p, z, step_s, phi, dphi, speed, angle):
    {{seen}}
    still, slope = torque(p, time_s, since_s, way_rad, heat, crept, phi, dphi, speed, angle), 0.0
    if {{steep}}:
        step = {SLOPE_STEP_RAD_S}
        moved = torque(p, time_s, since_s, way_rad, heat, crept, phi, dphi + step, speed - step, angle)
        slope = (moved - still) / step
    return still, slope

def grow(p, z, step_s, dphi):
    {{grown}}
    z[0] += step_s
"""
MEMORIES = {
    "time": ("time_s, since_s, way_rad, heat, crept = z[0] + 0.5 * step_s, 0.0, 0.0, 0.0, 0.0", "pass"),
    "past": (
        "z[5], z[6], time_s, since_s, way_rad, heat, crept = speed, phi, z[0] + 0.5 * step_s, z[1], z[2], z[3], z[4]",
        "z[1] = 0.0 if z[5] * z[7] < 0.0 else z[1] + step_s; z[2] += step_s * abs(z[5]); "
        f"z[3] += step_s / {HEATS_S} * (z[5] ** 2 - z[3]); z[4] += step_s / {CREEPS_S} * (z[6] - z[4]); z[7] = z[5]",
    ),
}
"""What a law sees of what it remembers, and how that grows: the rules of `Stepwise` and of `Remembering`."""


class _Plain(ast.NodeTransformer):
    """Puts names and numbers for what a law reads; whatever else it does with i, p or j is left, and found later."""

    def __init__(self, places: dict[str, int]) -> None:
        self.places = places

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        owner = node.value.id if isinstance(node.value, ast.Name) else ""
        if owner == "i" and node.attr in (*SEEN, *PAST):
            return ast.Name(node.attr, ast.Load())
        return self._number(f"j.{node.attr}") if owner == "j" else self.generic_visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        if isinstance(node.value, ast.Name) and node.value.id == "p" and isinstance(node.slice, ast.Constant):
            return self._number(f"p.{node.slice.value}")
        return self.generic_visit(node)

    def _number(self, name: str) -> ast.AST:
        return ast.Subscript(ast.Name("numbers", ast.Load()), ast.Constant(self.places[name]), ast.Load())


@lru_cache(maxsize=64)
def compiled_law(
    law: Callable[..., float], names: tuple[str, ...], steep: bool, remembers: str
) -> tuple[object, object] | None:
    """Torque and growth as machine code, whose numbers are those of `names`; None of a law that is no such line."""
    line = _line_of(law) if remembers in MEMORIES and isinstance(law, FunctionType) else None
    if line is None or not isinstance(law, FunctionType) or law.__closure__:
        return None
    places = {name: at for at, name in enumerate(names)}
    plain = _Plain(places).visit(ast.parse(ast.unparse(line.body), mode="eval").body)
    if {node.id for node in ast.walk(plain) if isinstance(node, ast.Name)} & {"i", "p", "j"}:
        return None
    text = ast.unparse(plain).replace("numbers[", "p[")
    seen, grown = MEMORIES[remembers]
    source = TEMPLATE.format(ratio=places["j.ratio"], law=text, steep=steep, seen=seen, grown=grown)
    return _built(source, law.__globals__)


def _built(source: str, known: dict[str, Any]) -> tuple[object, object]:
    import numba
    from numba import float64, types, void
    from numba.core.errors import NumbaExperimentalFeatureWarning

    # functions that are handed over as such are called experimental
    warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)
    made: dict[str, Any] = {"exp": exp}
    options: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
    exec(source, made)
    helpers = {name: known[name] for name in made["torque"].__code__.co_names if name in known}
    for name, value in helpers.items():
        made[name] = numba.njit(**options)(value) if isinstance(value, FunctionType) else value
    row, number = float64[::1], float64
    made["torque"] = numba.njit(**options)(made["torque"])
    torque = types.UniTuple(number, 2)(row, row, number, number, number, number, number)
    return (
        numba.cfunc(torque, error_model="numpy")(made["at"]),
        numba.cfunc(void(row, row, number, number), error_model="numpy")(made["grow"]),
    )


@lru_cache(maxsize=16)
def _lambdas(path: str) -> list[ast.Lambda]:
    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Lambda)]


def _line_of(law: Callable[..., float]) -> ast.Lambda | None:
    """The lambda in its file, by where its code stands."""
    places = [row for row in law.__code__.co_positions() if None not in row and row[2:] != (0, 0)]
    for node in _lambdas(inspect.getfile(law)):
        body, words = node.body, [argument.arg for argument in node.args.args]
        ends = (body.lineno, body.end_lineno, body.col_offset, body.end_col_offset)
        if words == ["i", "p", "j"] and ends in places:
            return node
    return None
