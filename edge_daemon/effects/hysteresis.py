"""Torques that remember the twist."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from edge_daemon.effects.algebra import bouc_wen_state, stack, stop_operator
from edge_daemon.effects.effect import Effect, Parameter, State
from edge_daemon.effects.laws import BOUC_WEN, STOP, Element
from edge_daemon.records import Array, Motion

ELEMENTS = (1.0, 0.75, 0.5, 0.25)
"""slip widths of the Maxwell elements over the widest (guess: four suffice for the virgin curve of a gear)"""


def _bouc_wen(motion: Motion, shape: Mapping[str, float], state: State) -> tuple[Array, State]:
    z, state = bouc_wen_state(motion.twist_rad, shape["width"], shape["rounding"], state, shape.get("exponent", 1.0))
    return stack(z), state


def _maxwell(motion: Motion, shape: Mapping[str, float], state: State) -> tuple[Array, State]:
    states = state if state is not None else (None,) * len(ELEMENTS)
    parts = [
        stop_operator(motion.twist_rad, shape["width"] * share, before)
        for share, before in zip(ELEMENTS, states, strict=True)
    ]
    return stack(*[z for z, _ in parts]), tuple(after for _, after in parts)


def _bouc_wen_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return (Element(BOUC_WEN, a[0], shape["width"], shape["rounding"], shape.get("exponent", 1.0)),)


def _maxwell_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return tuple(Element(STOP, size, shape["width"] * share) for size, share in zip(a, ELEMENTS, strict=True))


ROWS = (
    Effect(
        name="bouc_wen_hysteresis",
        balance="torsion",
        kind="torque",
        meaning="smooth hysteresis of the flexspline",
        equation="F z, w dz = dphi - (r |dphi| sgn z + (1 - r) dphi) |z|^n",
        source="Wen (1976), J. Eng. Mech. Div. 102(2), scaled to |z| <= 1",
        amplitudes=(Parameter("torque", "N m", "half height of the loop", 0.0, 1e5),),
        shapes=(
            Parameter(
                "width",
                "rad",
                "twist over which the loop closes, 1 / (beta + gamma)",
                1e-7,
                1e-2,
                1e-4,
                "twist_rad",
                (0.1, 0.2, 0.4, 0.8),
            ),
            Parameter("rounding", "1", "beta / (beta + gamma): 0.5 unloads straight", 0.3, 1.0, 0.6, "", (0.6,)),
            Parameter("exponent", "1", "n: how sharply the loop turns from stick to slip", 0.7, 5.0, 1.0, "", (1.0,)),
        ),
        columns=_bouc_wen,
        in_loop=_bouc_wen_law,
        needs=("twist_rad",),
    ),
    Effect(
        name="maxwell_slip_hysteresis",
        balance="torsion",
        kind="torque",
        meaning="hysteresis of parallel springs, each of which slips at its own torque",
        equation="sum_i F_i z_i, dz_i = dphi / (w a_i) while |z_i| < 1, a = 1, 3/4, 1/2, 1/4",
        source="Iwan (1966), J. Appl. Mech. 33(4); Al-Bender, Lampaert & Swevers (2005), IEEE TAC 50(11)",
        amplitudes=tuple(
            Parameter(f"torque_{i}", "N m", f"slip torque of the element of width w * {share:g}", 0.0, 1e5)
            for i, share in enumerate(ELEMENTS, start=1)
        ),
        shapes=(
            Parameter(
                "width",
                "rad",
                "twist at which the widest element slips",
                1e-7,
                1e-2,
                1e-4,
                "twist_rad",
                (0.25, 0.5, 1.0, 1.8),
            ),
        ),
        columns=_maxwell,
        in_loop=_maxwell_law,
        needs=("twist_rad",),
    ),
)
