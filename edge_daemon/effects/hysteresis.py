"""Torques that remember the twist."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from edge_daemon.effects.algebra import bouc_wen_state, followed, stack, stop_operator, stop_operators
from edge_daemon.effects.effect import Effect, EffectState, Parameter, Twin
from edge_daemon.integrator.laws import BOUC_WEN, STOP, Element
from edge_daemon.records import Array, Motion

STARTS = (1.8, 1.1, 0.65, 0.4, 0.24, 0.14)
"""A search begins at these slip widths of the Maxwell elements over the rms twist: from the largest twists of a motion
down to where an element is as good as dry friction (guess: six follow the virgin curve of a gear to a per mille)."""


def _bouc_wen(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    z, state = bouc_wen_state(motion.twist_rad, shape["width"], shape["rounding"], state, shape.get("exponent", 1.0))
    return stack(z), state


def _maxwell(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    states = state if state is not None else (None,) * len(STARTS)
    widths = [shape[f"width_{i}"] for i in range(1, len(STARTS) + 1)]
    parts = stop_operators(motion.twist_rad, widths, states)
    return stack(*[z for z, _ in parts]), tuple(after for _, after in parts)


def _taper(shape: Mapping[str, float]) -> float:
    """By how much the limits grow with the twist [1/rad]."""
    return (shape["asymmetry"] - 1.0) / (shape["asymmetry"] + 1.0) / shape["width_1"]


def _asymmetric(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    states = state if state is not None else (None,) * len(STARTS)
    taper = _taper(shape)
    parts = [
        stop_operator(motion.twist_rad, shape[f"width_{i}"], before, taper) for i, before in enumerate(states, start=1)
    ]
    return stack(*[z for z, _ in parts]), tuple(after for _, after in parts)


def _asymmetric_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return tuple(row._replace(b=_taper(shape)) for row in _maxwell_law(shape, a))


def _bouc_wen_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return (Element(BOUC_WEN, a[0], shape["width"], shape["rounding"], shape.get("exponent", 1.0)),)


def _maxwell_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return tuple(Element(STOP, size, shape[f"width_{i}"]) for i, size in enumerate(a, start=1))


def relaxed(twist_rad: Array, rate_hz: float, time_s: float) -> Array:
    """(n,) twist that a damper in series with a spring has given way by, following the whole twist with a time."""
    return followed(twist_rad, np.full(len(twist_rad), math.exp(-1.0 / (rate_hz * time_s))), float(twist_rad.mean()))


def _creep(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    given_way = relaxed(motion.twist_rad, motion.rate_hz, shape["time"])
    begun = np.exp((motion.time_s[0] - motion.time_s) / shape["time"])
    return stack(-given_way, begun), state


_SLIPPING = tuple(
    Parameter(f"torque_{i}", "N m", f"slip torque of element {i}", 0.0, 1e5) for i in range(1, len(STARTS) + 1)
)
_WIDTHS = tuple(
    Parameter(f"width_{i}", "rad", f"twist at which element {i} slips", 1e-7, 1e-2, 1e-4 * at, "twist_rad", (at,))
    for i, at in enumerate(STARTS, start=1)
)

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
                "hysteresis_width",
            ),
            Parameter("rounding", "1", "beta / (beta + gamma): 0.5 unloads straight", 0.3, 1.0, 0.6, "", (0.6,)),
            Parameter("exponent", "1", "n: how sharply the loop turns from stick to slip", 0.7, 5.0, 1.0, "", (1.0,)),
        ),
        columns=_bouc_wen,
        in_loop=_bouc_wen_law,
        needs=("twist_rad",),
        state_quantity="hysteresis_state",
        refines=("dahl_friction",),
    ),
    Effect(
        name="maxwell_slip_hysteresis",
        balance="torsion",
        kind="torque",
        meaning="hysteresis of parallel springs, each of which slips at its own torque",
        equation="sum_i F_i z_i, w_i dz_i = dphi while |z_i| < 1",
        source="Prandtl (1928), Z. Angew. Math. Mech. 8(2); Ishlinskii (1944); Iwan (1966), J. Appl. Mech. 33(4); "
        "Al-Bender, Lampaert & Swevers (2005), IEEE TAC 50(11); a Preisach operator (1935) whose weights depend on the "
        "width of a relay alone",
        amplitudes=_SLIPPING,
        shapes=_WIDTHS,
        columns=_maxwell,
        in_loop=_maxwell_law,
        needs=("twist_rad",),
        twins=(Twin("bouc_wen_hysteresis"),),
    ),
    Effect(
        name="asymmetric_hysteresis",
        balance="torsion",
        kind="torque",
        meaning="hysteresis of slipping springs whose grip grows with the twist in one direction",
        equation="sum_i F_i z_i, w_i dz_i = dphi while |z_i| < 1 + phi (s - 1) / ((s + 1) w_1)",
        source="stops of a generalised Prandtl-Ishlinskii operator, whose limits depend on the input: Al Janaideh, "
        "Rakheja & Su (2009), Smart Mater. Struct. 18, 045001; a loop of unequal limits that stay is a symmetric "
        "one and a constant",
        amplitudes=_SLIPPING,
        shapes=(
            *_WIDTHS,
            Parameter(
                "asymmetry",
                "1",
                "half height of the loop at the twist width_1, over that at as much twist the other way",
                0.2,
                5.0,
                1.0,
                "",
                (0.6, 1.6),
            ),
        ),
        columns=_asymmetric,
        in_loop=_asymmetric_law,
        needs=("twist_rad",),
        refines=("maxwell_slip_hysteresis",),
    ),
)

CREEP = Effect(
    name="creep",
    balance="torsion",
    kind="torque",
    meaning="a part of the stiffness that gives way in time",
    equation="-dK psi, T dpsi/dt = phi - psi",
    source="standard linear solid: a spring beside a spring and damper in series (Zener 1948)",
    amplitudes=(
        Parameter("stiffness", "N m/rad", "what relaxes", 0.0, 1e7),
        Parameter("before", "N m", "what the twist before the recording left"),
    ),
    shapes=(
        Parameter("time", "s", "after which two thirds of it have given way", 0.02, 30.0, 1.0, "", (0.1, 0.4, 1.6)),
    ),
    columns=_creep,
)
"""A torque that remembers the twist for seconds: creep of flexspline and grease. Above the frequency of its own time it
is what a speed makes, a skew of the encoders or a brake on the output; below it, it relaxes. It is no row and no
candidate; but where it does better than the best of them, that one is not what is missing."""
